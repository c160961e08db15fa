"""Where rays leave a solid whose exact distance is known.

In: an exact shape and rays from inside it, or from its surface inward. Out: how far they go. Nothing of the renderer
takes part, so that every truth may use it.
"""

import numpy as np
from jaxtyping import Float

from datasets_synthetic import ExactShape

# Of the shape's size:
CLEAR = 1e-9  # above the rounding of a place on the surface, below whatever is looked at
SHORTEST = 1e-4  # step on the way out of a solid
ROUNDING = 1e-15  # of a place within the shape
POLISH = 64  # steps at most: half an interval of the shape's size as often is nothing


def leave(
    shape: ExactShape, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], size: float
) -> Float[np.ndarray, " n"]:
    """Find where rays from inside a solid, or from its surface inward, leave it.

    Steps as long as the distance cannot pass through the surface; but along it they come to nothing, so none is
    shorter than SHORTEST: only what a ray leaves and enters again within that length may be stepped over. Between the
    last two steps, Newton's method inside bisection.

    Parameters
    ----------
    shape
        The solid.
    o, d
        (n, 3) float64 origins and unit directions.
    size
        Diagonal of the box around the shape.

    Returns
    -------
    numpy.ndarray
        (n,) float64, in the unit of the shape.
    """
    low, high = np.zeros(len(o)), np.full(len(o), CLEAR * size)
    rows = np.arange(len(o))
    while rows.size:
        value = shape.distance(o[rows] + high[rows, None] * d[rows])
        rows, value = rows[value < 0], value[value < 0]
        low[rows] = high[rows]
        high[rows] += np.maximum(-value, SHORTEST * size)
    t, rows = high.copy(), np.arange(len(o))
    for _ in range(POLISH):
        old = t[rows]
        p = o[rows] + old[:, None] * d[rows]
        value, slope = shape.distance(p), np.sum(shape.normal(p) * d[rows], axis=1)
        low[rows], high[rows] = np.where(value < 0, old, low[rows]), np.where(value < 0, high[rows], old)
        newton = old - value / np.where(slope > 0, slope, np.nan)
        between = (newton >= low[rows]) & (newton <= high[rows])
        t[rows] = np.where(between, newton, (low[rows] + high[rows]) / 2)
        rows = rows[np.minimum(np.abs(t[rows] - old), high[rows] - low[rows]) > ROUNDING * size]
        if not rows.size:
            break
    return t
