"""Which setups nothing else beats: the Pareto front of error against cost.

In: points (error, cost). Out: the indices of those that no other point matches or beats in both.
"""

import numpy as np
from jaxtyping import Float, Int


def pareto(error: Float[np.ndarray, " n"], cost: Float[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
    """Indices of the undominated points, by rising cost; of equal points the first.

    Examples
    --------
    >>> pareto(np.array([3.0, 1.0, 2.0, 2.5]), np.array([1.0, 4.0, 2.0, 3.0])).tolist()
    [0, 2, 1]
    """
    order = np.lexsort((np.arange(len(error)), error, cost))
    best = np.minimum.accumulate(error[order])
    front = np.concatenate([[True], error[order][1:] < best[:-1]]) if len(order) else np.zeros(0, bool)
    return np.asarray(order[front])
