"""How well kernels interpolate a grid: its error bar, brick by brick.

In: signed distances in bricks, and exact ones at the centres of some cells with surface. Out: per brick and kernel the
greatest difference. At its centre every kernel is one filter of six samples per axis.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from sdfbake.bricks import SIDE, Bricks
from sdfbake.engine import Array, Engine
from sdfbake.grid import KERNELS

# Taps -2 to 3 of a cell for its centre: Galim 2018, eq. 9; eq. 21 with tension 1/2; and the cubic B-spline's
# (1, 23, 23, 1) / 48 after its prefilter (-1, 8, -1) / 6.
TAPS = {
    "linear": np.array([0, 0, 1, 1, 0, 0]) / 2,
    "catmull-rom": np.array([0, -1, 9, 9, -1, 0]) / 16,
    "bspline": np.convolve([1, 23, 23, 1], [-1, 8, -1]) / 288,
}
_WIDTH = 6


def brick_errors(
    xp: Engine,
    bricks: Bricks,
    distance: Float[np.ndarray, "k 8 8 8"],
    centre: Float[np.ndarray, "k 4 4 4"],
    spacing: float,
) -> Float[np.ndarray, "k 3"]:
    """Compare interpolated with exact distances.

    Parameters
    ----------
    xp
        The engine.
    bricks, distance
        The grid; world units.
    centre
        Exact distances, signed or not, at the centres of every other cell along each axis (first samples 0, 2, 4, 6);
        NaN where nothing is to be compared.
    spacing
        World units per voxel.

    Returns
    -------
    error
        Voxels, float32, one column for each of `KERNELS`; 0 where nothing was compared. Magnitudes are compared.
    """
    error = np.zeros((len(bricks), len(KERNELS)), np.float32)
    slot, *half = np.nonzero(~np.isnan(centre))
    if len(slot) == 0:
        return error
    first = bricks.index[slot] * SIDE + 2 * np.stack(half, axis=-1).astype(np.int32)
    found = xp.run(_program(xp, bricks, distance), list(first.T))
    exact = np.abs(centre[(slot, *half)])
    starts = np.flatnonzero(np.diff(slot, prepend=-1))
    for column, name in enumerate(KERNELS):
        off = np.abs(np.abs(found[name]) - exact) / spacing
        error[slot[starts], column] = np.maximum.reduceat(off, starts)
    return error


def _program(xp: Engine, bricks: Bricks, distance: Float[np.ndarray, "k 8 8 8"]) -> Callable[..., dict[str, Array]]:
    """Return a program from the first samples of cells to what every kernel makes of the centre."""
    slots, samples = xp.table(bricks.slot), xp.table(distance)
    weights = [xp.table(np.einsum("i,j,k", *[TAPS[name]] * 3)) for name in KERNELS]
    counts = [xp.uniform(int(n)) for n in bricks.slot.shape]

    def sample(xp: Engine, x: Array, y: Array, z: Array) -> Array:
        slot = xp.gather(slots, ((x >> 3) * counts[1] + (y >> 3)) * counts[2] + (z >> 3), True)
        place = ((slot * SIDE + (x & 7)) * SIDE + (y & 7)) * SIDE + (z & 7)
        return xp.gather(samples, place, slot >= 0)

    def program(xp: Engine, *first: Array) -> dict[str, Array]:
        def body(state: tuple[Array, ...], at: Any) -> tuple[Array, ...]:
            number, *sums = state
            steps = (number // _WIDTH**2, number // _WIDTH % _WIDTH, number % _WIDTH)
            value = sample(xp, *(coordinate + step - 2 for coordinate, step in zip(at, steps, strict=True)))
            for n, table in enumerate(weights):
                sums[n] = sums[n] + value * xp.gather(table, number, True)
            return number + 1, *sums

        begin = (xp.full(first[0], 0), *(xp.full(first[0], 0.0) for _ in KERNELS))
        _, *sums = xp.while_loop(lambda state: state[0] < _WIDTH**3, body, begin, first)
        return dict(zip(KERNELS, sums, strict=True))

    return program
