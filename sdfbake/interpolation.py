"""How well kernels interpolate a grid: its error bar, brick by brick.

In: signed distances in bricks, and exact ones at two places of some cells with surface. Out: per brick and kernel the
greatest difference. At a fixed place of its cell every kernel is one filter of six samples per axis.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from sdfbake.band import PROBES
from sdfbake.bricks import SIDE, Bricks
from sdfbake.engine import Array, Engine
from sdfbake.grid import KERNELS


def taps(name: str, t: float) -> Float[np.ndarray, " 6"]:
    """Return the weights of samples -2 to 3 for a place in a cell: Galim 2018, eq. 9 and 21; and the cubic B-spline's.

    The tension is 1/2; the B-spline's weights go with its prefilter (-1, 8, -1) / 6.
    """
    powers = np.array([1, t, t**2, t**3])
    if name == "linear":
        return np.array([0, 0, 1 - t, t, 0, 0])
    if name == "catmull-rom":
        basis = np.array([[0, -1, 2, -1], [2, 0, -5, 3], [0, 1, 4, -3], [0, 0, -1, 1]]) / 2
        return np.concatenate([[0], basis @ powers, [0]])
    basis = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6
    return np.convolve(basis @ powers, np.array([-1, 8, -1]) / 6)


_WIDTH = 6


def brick_errors(
    xp: Engine,
    bricks: Bricks,
    distance: Float[np.ndarray, "k 8 8 8"],
    probe: Float[np.ndarray, "k 4 4 4 p"],
    spacing: float,
) -> Float[np.ndarray, "k 3"]:
    """Compare interpolated with exact distances.

    Parameters
    ----------
    xp
        The engine.
    bricks, distance
        The grid; world units.
    probe
        Exact distances, signed or not, at the `PROBES` of every other cell along each axis (first samples 0, 2, 4,
        6); NaN where nothing is to be compared.
    spacing
        World units per voxel.

    Returns
    -------
    error
        Voxels, float32, one column for each of `KERNELS`; 0 where nothing was compared. Magnitudes are compared.
    """
    error = np.zeros((len(bricks), len(KERNELS)), np.float32)
    slot, *half = np.nonzero(~np.isnan(probe[..., 0]))
    if len(slot) == 0:
        return error
    first = bricks.index[slot] * SIDE + 2 * np.stack(half, axis=-1).astype(np.int32)
    found = xp.run(_program(xp, bricks, distance), list(first.T))
    exact = np.abs(probe[(slot, *half)])
    starts = np.flatnonzero(np.diff(slot, prepend=-1))
    for column, name in enumerate(KERNELS):
        of_probes = [np.abs(found[_key(name, t)]) - exact[:, k] for k, t in enumerate(PROBES)]
        off = np.abs(of_probes).max(axis=0) / spacing
        error[slot[starts], column] = np.maximum.reduceat(off, starts)
    return error


def _key(name: str, t: float) -> str:
    return f"{name} at {t}"


def _program(xp: Engine, bricks: Bricks, distance: Float[np.ndarray, "k 8 8 8"]) -> Callable[..., dict[str, Array]]:
    """Return a program from the first samples of cells to what every kernel makes of the probes."""
    slots, samples = xp.table(bricks.slot), xp.table(distance)
    weights = {_key(name, t): xp.table(np.einsum("i,j,k", *[taps(name, t)] * 3)) for name in KERNELS for t in PROBES}
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
            more = [xp.gather(table, number, True) for table in weights.values()]
            return number + 1, *(total + value * weight for total, weight in zip(sums, more, strict=True))

        begin = (xp.full(first[0], 0), *(xp.full(first[0], 0.0) for _ in weights))
        _, *sums = xp.while_loop(lambda state: state[0] < _WIDTH**3, body, begin, first)
        return dict(zip(weights, sums, strict=True))

    return program
