"""Truth by displaced rays: derivatives per pixel from neighbouring rays, with their own error.

In: any function of a pixel offset. Out: Richardson-extrapolated central differences D = (4 D(e/2) - D(e)) / 3, of
order four, and |D - D(e/2)|, which bounds their error while the differences still converge.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Displaced = Callable[[float, float], Float[np.ndarray, "n k"]]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Derivatives per pixel step and how far they can be trusted.

    Attributes
    ----------
    d_dx, d_dy
        Derivative of the k outputs along each pixel axis; zero where it could not be had.
    error_dx, error_dy
        Its own estimated error, same unit; infinite where a displaced ray had no finite output.
    """

    d_dx: Float[np.ndarray, "n k"]
    d_dy: Float[np.ndarray, "n k"]
    error_dx: Float[np.ndarray, "n k"]
    error_dy: Float[np.ndarray, "n k"]


def richardson(function: Displaced, step: float = 0.25) -> Truth:
    """Differentiate `function` at the offset (0, 0).

    Parameters
    ----------
    function
        From an offset (dx, dy) in pixels to outputs (n, k); not finite where there is no output (a miss).
    step
        The larger of the two steps, in pixels.

    Examples
    --------
    >>> truth = richardson(lambda dx, dy: np.array([[dx**3 + 2 * dx + dy]]))
    >>> float(truth.d_dx[0, 0]), float(truth.d_dy[0, 0])
    (2.0, 1.0)
    """
    d_dx, error_dx = _axis(lambda e: function(e, 0.0), step)
    d_dy, error_dy = _axis(lambda e: function(0.0, e), step)
    return Truth(d_dx, d_dy, error_dx, error_dy)


def _axis(
    along: Callable[[float], Float[np.ndarray, "n k"]], step: float
) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, "n k"]]:
    outputs = [np.asarray(along(e), np.float64) for e in (step, -step, step / 2, -step / 2)]
    finite = np.all([np.isfinite(output) for output in outputs], axis=0)
    far, far_, near, near_ = (np.where(finite, output, 0.0) for output in outputs)
    coarse, fine = (far - far_) / (2 * step), (near - near_) / step
    value = (4 * fine - coarse) / 3
    return value, np.where(finite, np.abs(value - fine), np.inf)
