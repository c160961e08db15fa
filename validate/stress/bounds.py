"""What a kernel makes of errors in its samples, and of a kink, which no polynomial is: the constants behind limits.

In: a kernel. Out: the greatest sums, over a raster of places in a cell, of the magnitudes of its weights (with the
prefilter in them) times what the sample behind each may be off by.
"""

from collections.abc import Callable
from functools import reduce

import numpy as np
from jaxtyping import Float

from sdfrender.kernels import Kernel

PLACES = np.linspace(0.0, 1.0, 17)  # in a cell along every axis: both ends, the middle, and between
SAMPLE = 2.0**-24  # rounding of a float32 sample, of its size
ORDERS = {0: ((0, 0, 0),), 1: ((1, 0, 0),), 2: ((2, 0, 0), (1, 1, 0))}


def sample_weights(of: Kernel, order: int) -> Float[np.ndarray, "17 taps"]:
    """Weights, or their derivatives of an order, of the samples behind `PLACES` along one axis."""
    rows = of.derivative(order)
    taps = PLACES[:, None] ** np.arange(rows.shape[1]) @ rows.T
    return np.stack([np.convolve(row, of.prefilter) for row in taps])


def apart(of: Kernel) -> Float[np.ndarray, "17 taps"]:
    """Where those samples lie from the places, voxels."""
    return np.asarray(np.arange(of.taps + 2) + of.first - 1 - PLACES[:, None])


def amplified(of: Kernel, order: int, off: Callable[[np.ndarray], np.ndarray]) -> float:
    """Bound the error of a derivative of that order, per voxel.

    Parameters
    ----------
    of
        The kernel.
    order
        0 for the value, 1 for a component of the gradient, 2 for an entry of the Hessian.
    off
        From samples' distances from the place, voxels, to what they may be off by, voxels.
    """
    x, y, z = _spread(apart(of))
    share = off(np.sqrt(x * x + y * y + z * z))
    weights = [np.abs(sample_weights(of, number)) for number in range(3)]
    sums = [np.einsum("ai,bj,ck,abcijk->abc", *(weights[o] for o in each), share).max() for each in ORDERS[order]]
    return float(max(sums))


def kink(of: Kernel, normal: Float[np.ndarray, " 3"]) -> float:
    """The greatest value, voxels, that the interpolant of |p . normal| has at the kink, where it is off by most."""
    x, y, z = (part * along for part, along in zip(_spread(apart(of)), normal, strict=True))
    w = sample_weights(of, 0)
    return float(np.einsum("ai,bj,ck,abcijk->abc", w, w, w, np.abs(x + y + z)).max())


def kernel_error(r: float) -> float:
    """Bound the error of the B-spline's value at a ball of so many voxels, voxels.

    It is 35 / 1152 of the fourth derivatives along the three axes (Lagrange's form for quasi-interpolation on cubics),
    and these are 3 / r^3 at most: see `validate.stress.mirrored.bend_limit`.
    """
    return 3 * 35 / 1152 * 3 / r**3


def _spread(rows: Float[np.ndarray, "a taps"]) -> list[np.ndarray]:
    """The same rows along each of three axes of places, (a, a, a, taps, taps, taps) when added."""
    axes = ((1, 2, 4, 5), (0, 2, 3, 5), (0, 1, 3, 4))
    return [reduce(np.expand_dims, sorted(others), rows) for others in axes]
