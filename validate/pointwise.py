"""A kernel's jets from float64 samples of an exact shape, point by point.

In: an exact distance, a lattice, a kernel, points. Out: value, gradient and Hessian of the interpolant. Each point asks
for its own stencil of samples alone, so that the finest lattice costs no more than the coarsest; nothing is stored, so
that what is measured is the method, not the rounding of float32 samples. Galim 2018, eq. 8 to 19, as tensor products.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from sdfbake.lattice import Lattice
from sdfrender.kernels import Kernel

Distance = Callable[[Float[np.ndarray, "m 3"]], Float[np.ndarray, " m"]]


def jets(
    distance: Distance, lattice: Lattice, kernel: Kernel, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
    """Interpolate.

    Parameters
    ----------
    distance
        Exact, float64; asked beyond the lattice too, where a stencil reaches there.
    lattice
        Where the samples lie.
    kernel
        How they are interpolated, with its prefilter.
    points
        World positions, in the lattice's box.

    Returns
    -------
    value, gradient, hessian
        Of the interpolant, world units.
    """
    place = (points - lattice.origin) / lattice.spacing
    cell = np.floor(place)
    first, rows = _filtered(kernel)
    weights = [_weights(rows, kernel, place - cell, order) for order in range(3)]
    node = cell[:, None] + (first + np.arange(weights[0].shape[2]))[:, None]
    x, y, z = (lattice.origin[a] + lattice.spacing * node[:, :, a] for a in range(3))
    at = np.stack(np.broadcast_arrays(x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]), axis=-1)
    samples = distance(at.reshape(-1, 3)).reshape(at.shape[:-1])

    def contracted(orders: tuple[int, int, int]) -> Float[np.ndarray, " n"]:
        factors = [weights[order][:, axis] for axis, order in enumerate(orders)]
        total = np.einsum("nijk,ni,nj,nk->n", samples, *factors, optimize=True)
        return np.asarray(total / lattice.spacing ** sum(orders))

    once = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    twice = [(a[0] + b[0], a[1] + b[1], a[2] + b[2]) for a in once for b in once]
    gradient = np.stack([contracted(orders) for orders in once], axis=1)
    hessian = np.stack([contracted(orders) for orders in twice], axis=1)
    return contracted((0, 0, 0)), gradient, hessian.reshape(-1, 3, 3)


def _filtered(kernel: Kernel) -> tuple[int, Float[np.ndarray, "samples taps"]]:
    """The first sample that a cell sees through the prefilter, and what each sample adds to each coefficient."""
    if not kernel.filtered:
        return kernel.first, np.eye(kernel.taps)
    rows = np.zeros((kernel.taps + 2, kernel.taps))
    for tap in range(kernel.taps):
        rows[tap : tap + 3, tap] = kernel.prefilter
    return kernel.first - 1, rows


def _weights(
    rows: Float[np.ndarray, "samples taps"], kernel: Kernel, u: Float[np.ndarray, "n 3"], order: int
) -> Float[np.ndarray, "n 3 samples"]:
    """Weights of samples, or a derivative of them, at places in a cell."""
    terms = kernel.derivative(order)
    return np.asarray((u[..., None] ** np.arange(terms.shape[1])) @ terms.T @ rows.T)
