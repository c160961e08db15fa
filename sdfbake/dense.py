"""Which bricks a dense array of anybody's numbers needs.

In: values on a lattice, not necessarily distances. Out: `Bricks` that hold every stencil of every cell in which some
kernel's interpolant may have a root. A cell is a candidate if, over its stencil, the kernel's bound straddles zero.
"""

import numpy as np
from jaxtyping import Bool, Float

from sdfbake.bricks import SIDE, Bricks

# Catmull-Rom overshoots its 4^3 taps by ((1 + tau / 2)^3 - 1) / 2 of their range, tau = 1/2.
_OVERSHOOT = (1.25**3 - 1) / 2
# Above what float32 arithmetic over 64 taps can lose: 64 eps = 7.6e-6.
_SLACK = 1e-5
_TILE = 64  # cells along y and z looked at together: their samples stay in the caches
_HALO = 2  # samples beyond a cell's lower corner on the left; three on the right


def needed(values: Float[np.ndarray, "nx ny nz"]) -> Bricks:
    """Return the bricks that hold a sample of the 6^3 neighbourhood (-2..+3) of a candidate cell.

    Parameters
    ----------
    values
        Finite numbers, at least 2 along every axis.

    Returns
    -------
    Bricks
        `far` is the brick's sign times its least magnitude: a fill value, not a bound of any distance.
    """
    nx = len(values)
    touched = np.zeros(values.shape, bool)
    for first in range(0, nx - 1, SIDE):  # by slabs, so that a large array needs little more memory than it has
        last = min(first + SIDE, nx - 1)
        cells = _tiled(_continued(values, first, last))
        here = touched[max(first - 2, 0) : last + 3]
        here |= _spread(cells, first, nx)
    present = np.asarray(_blocks(touched, fill=False).any(axis=(1, 3, 5)))
    least = _blocks(np.abs(values), fill=np.inf).min(axis=(1, 3, 5))
    negative = values[::SIDE, ::SIDE, ::SIDE] < 0
    return Bricks.of(present, np.where(negative, -least, least))


def _continued(values: Float[np.ndarray, "nx ny nz"], first: int, last: int) -> Float[np.ndarray, "mx my mz"]:
    """Return the samples first - 2 .. last + 2 along x, two more on every side along y and z, continued linearly."""
    nx = len(values)
    left, right = max(_HALO - first, 0), max(last + _HALO - (nx - 1), 0)
    slab = values[max(first - _HALO, 0) : last + _HALO + 1].astype(np.float64)
    for axis, (before, after) in enumerate(((left, right), (_HALO, _HALO), (_HALO, _HALO))):
        slab = _continue_axis(slab, axis, before, after)
    return slab


def _continue_axis(v: np.ndarray, axis: int, before: int, after: int) -> np.ndarray:
    """Continue an array linearly along an axis: v[-k] = v[0] - k (v[1] - v[0])."""
    v = np.moveaxis(v, axis, 0)
    k = np.arange(1, max(before, after) + 1).reshape(-1, 1, 1)
    head = v[:1] - k[:before][::-1] * (v[1:2] - v[:1])
    tail = v[-1:] + k[:after] * (v[-1:] - v[-2:-1])
    return np.moveaxis(np.concatenate([head, v, tail]), 0, axis)


def _tiled(v: Float[np.ndarray, "mx my mz"]) -> Bool[np.ndarray, "cx cy cz"]:
    """Say which cells may hold a root, as `_candidates` does, and skip what is far from any."""
    cells = np.zeros([n - 2 * _HALO - 1 for n in v.shape], bool)
    for y in range(0, cells.shape[1], _TILE):
        for z in range(0, cells.shape[2], _TILE):
            near = v[:, y : y + _TILE + 2 * _HALO + 1, z : z + _TILE + 2 * _HALO + 1]
            low, high = near.min(), near.max()
            # The prefilter moves values by up to (1 + 5/3 + 25/9) / 3 = 1.8 times their range, more than kernels do.
            if max(low, -high) <= 2 * (high - low):
                cells[:, y : y + _TILE, z : z + _TILE] = _candidates(near)
    return cells


def _candidates(v: Float[np.ndarray, "mx my mz"]) -> Bool[np.ndarray, "cx cy cz"]:
    """Say which cells may hold a root; `v` has two samples more than the cells' corners on every side."""
    inner = v[2:-2, 2:-2, 2:-2]
    low2, high2 = _extremes(inner, 2)
    low4, high4 = _extremes(v[1:-1, 1:-1, 1:-1], 4)
    wide = _OVERSHOOT * (high4 - low4)
    coefficient = v
    for axis in range(3):
        c = np.moveaxis(coefficient, axis, 0)
        coefficient = np.moveaxis((8 * c[1:-1] - c[:-2] - c[2:]) / 6, 0, axis)
    low, high = _extremes(coefficient, 4)
    slack = _SLACK * np.maximum(np.maximum(-low, high), np.maximum(-low4, high4))
    pairs = ((low2, high2), (low4 - wide, high4 + wide), (low, high))
    found: Bool[np.ndarray, "cx cy cz"] = np.logical_or.reduce([(a <= slack) & (b >= -slack) for a, b in pairs])
    return found


def _extremes(v: np.ndarray, taps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return least and greatest of every window of taps^3 samples, taps being 2 or 4."""
    low = high = v
    for axis in range(3):
        for step in (1, 2)[: taps // 2]:  # windows of two, then two of those
            size = low.shape[axis] - step
            one, other = ((slice(None),) * axis + (slice(start, start + size),) for start in (0, step))
            low, high = np.minimum(low[one], low[other]), np.maximum(high[one], high[other])
    return low, high


def _spread(cells: Bool[np.ndarray, "cx cy cz"], first: int, nx: int) -> Bool[np.ndarray, "sx ny nz"]:
    """Mark the samples -2..+3 around every candidate's lower corner, for samples max(first - 2, 0) .. last + 2."""
    marks = cells
    for axis in range(3):
        # Sample s is touched by the cells s - 3 .. s + 2: pad five zeros on both sides, then take any of six.
        width = [(0, 0)] * 3
        width[axis] = (5, 5)
        padded = np.pad(marks, width)
        size = marks.shape[axis] + 5
        marks = padded[(slice(None),) * axis + (slice(0, size),)].copy()
        for k in range(1, 6):
            marks |= padded[(slice(None),) * axis + (slice(k, k + size),)]
    start = max(0, 2 - first)
    # Along y and z the marks run from sample -2 to n + 1 where n - 1 cells lie; the lattice has 0 .. n - 1.
    return marks[start : nx - first + 2, 2:-2, 2:-2]


def _blocks(v: np.ndarray, fill: float | bool) -> np.ndarray:
    """Cut an array into bricks: (bx, 8, by, 8, bz, 8), padded with `fill`."""
    width = [(0, -n % SIDE) for n in v.shape]
    padded = np.pad(v, width, constant_values=fill)
    bx, by, bz = (n // SIDE for n in padded.shape)
    return padded.reshape(bx, SIDE, by, SIDE, bz, SIDE)
