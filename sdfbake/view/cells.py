"""Which cells of a grid may hold surface, and how far a ray may go from those that do not.

In: signed distances in bricks. Out: per cell 0 where some kernel's interpolant may have a root, else a cube of empty
cells around it. A polynomial lies within the range of its Bernstein coefficients (the Bezier net of the cell), so a
cell whose net has one sign holds none.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import reduce

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import distance_transform_cdt

from sdfbake.bricks import SIDE, Bricks

HALO = 2  # samples before a brick's first cell that a prefiltered cubic reads; three after its last
BLOCK = SIDE + 2 * HALO + 1
_CHUNK = 16  # bricks at once: their nets are a megabyte and stay in the caches
_SLACK = 1e-5  # of the largest magnitude: more than float32 loses in a net
# Bernstein coefficients of a cell from its four taps: cubic B-spline, Catmull-Rom of tension 1/2, linear.
_BEZIER = {
    "bspline": np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6,
    "catmull-rom": np.array([[0, 6, 0, 0], [-1, 6, 1, 0], [0, 1, 6, -1], [0, 0, 6, 0]]) / 6,
    "linear": np.array([[0, 1, 0, 0], [0, 0, 1, 0]], float),
}


def gaps(
    bricks: Bricks, distance: Float[np.ndarray, "k 8 8 8"], shape: tuple[int, int, int]
) -> UInt8[np.ndarray, "k 8 8 8"]:
    """Return per cell g: 0 if it may hold surface, else all cells less than g away along every axis hold none.

    Parameters
    ----------
    bricks, distance
        The grid's bricks and samples, in any unit.
    shape
        Samples of the lattice.

    Returns
    -------
    gap
        At most 4, since a cube stays in its brick.
    """
    empty = ~np.concatenate([np.zeros((0, SIDE, SIDE, SIDE), bool), *_occupied(bricks, distance, shape)])
    gap = np.zeros(empty.shape, np.uint8)
    while empty.any():
        gap += empty
        empty = _eroded(empty)
    return gap


def brick_gaps(bricks: Bricks) -> Int[np.ndarray, "bx by bz"]:
    """Return per absent brick g: all bricks less than g away along every axis are absent, too; 0 where one is."""
    absent = np.pad(bricks.slot < 0, 1)  # what is outside the lattice counts as present: no cube leaves it
    distance = distance_transform_cdt(absent, metric="chessboard")
    gap: Int[np.ndarray, "bx by bz"] = np.asarray(distance)[1:-1, 1:-1, 1:-1].astype(np.int32)
    return gap


def _occupied(
    bricks: Bricks, distance: Float[np.ndarray, "k 8 8 8"], shape: tuple[int, int, int]
) -> Iterator[Bool[np.ndarray, "c 8 8 8"]]:
    """Yield, chunk by chunk, which cells may hold a root for some kernel; chunks run on threads."""
    padded = np.pad(bricks.slot, 1, constant_values=-2)

    def chunk(start: int) -> Bool[np.ndarray, "c 8 8 8"]:
        index = bricks.index[start : start + _CHUNK]
        around = _around(padded, index)[..., None, None, None]
        block = _blocks(np.where(around >= 0, distance[around[..., 0, 0, 0]], 0)).astype(np.float32)
        known = _blocks(np.broadcast_to(around != -1, (*around.shape[:4], SIDE, SIDE, SIDE)))
        possible = _possible(np.ascontiguousarray(np.moveaxis(_continued(block, index, shape), 0, -1)))
        found: Bool[np.ndarray, "c 8 8 8"] = np.moveaxis(possible, -1, 0) & _whole(known) & _cells(index, shape)
        return found

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield from pool.map(chunk, range(0, len(bricks), _CHUNK))


def _possible(block: Float[np.ndarray, "13 13 13 c"]) -> Bool[np.ndarray, "8 8 8 c"]:
    """Say which cells' nets do not have one sign, for some kernel."""
    slack = _SLACK * np.abs(block).max()
    found = np.zeros((SIDE, SIDE, SIDE, block.shape[3]), bool)
    for name, bezier in _BEZIER.items():
        low, high = _net(_prefiltered(block) if name == "bspline" else block[1:-1, 1:-1, 1:-1], bezier)
        found |= (low <= slack) & (high >= -slack)
    return found


def _around(padded: Int[np.ndarray, "X Y Z"], index: Int[np.ndarray, "c 3"]) -> Int[np.ndarray, "c 3 3 3"]:
    """Return the slots of bricks and their neighbours: -1 absent, -2 outside the lattice."""
    x, y, z = (index[:, axis, None] + np.arange(3) for axis in range(3))
    slots: Int[np.ndarray, "c 3 3 3"] = padded[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]]
    return slots


def _blocks(parts: np.ndarray) -> np.ndarray:
    """Return samples -2 to 10 of bricks from 27 bricks of samples: (c, 3, 3, 3, 8, 8, 8) to (c, 13, 13, 13)."""
    whole = parts.transpose(0, 1, 4, 2, 5, 3, 6).reshape(len(parts), *[3 * SIDE] * 3)
    kept = slice(SIDE - HALO, SIDE - HALO + BLOCK)
    return whole[:, kept, kept, kept]


def _continued(
    block: Float[np.ndarray, "c 13 13 13"], index: Int[np.ndarray, "c 3"], shape: tuple[int, int, int]
) -> Float[np.ndarray, "c 13 13 13"]:
    """Continue the samples linearly past the lattice's border, axis by axis, in the bricks that reach it."""
    out = ((index == 0) | ((index + 1) * SIDE + HALO >= np.array(shape))).any(axis=1)
    if not out.all():
        continued = block.copy()
        continued[out] = _continued(block[out], index[out], shape)
        return continued
    for axis in range(3):
        place = np.arange(BLOCK) - HALO + index[:, axis, None] * SIDE
        inside = np.clip(place, 0, shape[axis] - 1)
        over = place - inside
        here, inner = (
            (at - index[:, axis, None] * SIDE + HALO).clip(0, BLOCK - 1)
            for at in (inside, np.clip(inside - np.sign(over), 0, shape[axis] - 1))
        )
        spread = tuple(slice(None) if a in (0, axis + 1) else None for a in range(4))
        edge = np.take_along_axis(block, here[spread], axis + 1)
        block = edge + np.abs(over)[spread] * (edge - np.take_along_axis(block, inner[spread], axis + 1))
    return block.astype(np.float32)


def _prefiltered(block: Float[np.ndarray, "13 13 13 c"]) -> Float[np.ndarray, "11 11 11 c"]:
    """Return the B-spline's coefficients."""
    block = (8 * block[1:-1] - block[:-2] - block[2:]) / 6
    block = (8 * block[:, 1:-1] - block[:, :-2] - block[:, 2:]) / 6
    out: Float[np.ndarray, "11 11 11 c"] = (8 * block[:, :, 1:-1] - block[:, :, :-2] - block[:, :, 2:]) / 6
    return out


def _net(
    taps: Float[np.ndarray, "11 11 11 c"], bezier: Float[np.ndarray, "r 4"]
) -> tuple[Float[np.ndarray, "8 8 8 c"], Float[np.ndarray, "8 8 8 c"]]:
    """Return the least and the greatest Bernstein coefficient of every cell; neighbours share those between them."""
    degree, count = len(bezier) - 1, taps.shape[3]
    rows = SIDE * degree + 1
    matrix = np.zeros((rows, SIDE + 3), np.float32)
    for cell in range(SIDE):
        matrix[cell * degree : (cell + 1) * degree + 1, cell : cell + 4] = bezier
    net = (matrix @ taps.reshape(SIDE + 3, -1)).reshape(rows, SIDE + 3, -1)
    net = (matrix @ net).reshape(rows * rows, SIDE + 3, count)
    net = (matrix @ net).reshape(rows, rows, rows, count)
    return _of_cells(net, degree, np.minimum), _of_cells(net, degree, np.maximum)


def _of_cells(net: Float[np.ndarray, "n n n c"], degree: int, least: np.ufunc) -> Float[np.ndarray, "8 8 8 c"]:
    """Return the extreme of every cell's degree + 1 coefficients along each axis."""
    for axis in (2, 1, 0):
        before = (slice(None),) * axis
        parts = [net[(*before, slice(r, r + SIDE * degree - degree + 1, degree))] for r in range(degree + 1)]
        net = reduce(least, parts)
    cells: Float[np.ndarray, "8 8 8 c"] = net
    return cells


def _whole(known: Bool[np.ndarray, "c 13 13 13"]) -> Bool[np.ndarray, "c 8 8 8"]:
    """Say which cells have all samples from -2 to 3; by the band's width the others hold no surface."""
    for axis in (1, 2, 3):
        rows = np.moveaxis(known, axis, 0)
        known = np.moveaxis(np.logical_and.reduce([rows[i : i + SIDE] for i in range(6)]), 0, axis)
    return known


def _cells(index: Int[np.ndarray, "c 3"], shape: tuple[int, int, int]) -> Bool[np.ndarray, "c 8 8 8"]:
    """Say which cells the lattice has: one less than samples."""
    x, y, z = ((index[:, axis, None] * SIDE + np.arange(SIDE)) < shape[axis] - 1 for axis in range(3))
    inside: Bool[np.ndarray, "c 8 8 8"] = x[:, :, None, None] & y[:, None, :, None] & z[:, None, None, :]
    return inside


def _eroded(empty: Bool[np.ndarray, "k 8 8 8"]) -> Bool[np.ndarray, "k 8 8 8"]:
    """Keep the cells whose 26 neighbours are empty, too; a brick's border has unknown ones."""
    for axis in (1, 2, 3):
        v = np.moveaxis(empty, axis, 0)
        inner = v[:-2] & v[1:-1] & v[2:]
        empty = np.moveaxis(np.pad(inner, ((1, 1), *[(0, 0)] * 3)), 0, axis)
    return empty
