"""Cells that may hold surface, and between which two planes the interpolant stays there.

In: the coefficients of every brick. Out: the occupied cells, and a slab for each: on the cell, f lies in
c + g . (x - 1/2) +- delta. The interpolant minus an affine function lies in the hull of its Bezier net minus that
function's values at the Greville points (r/d, s/d, t/d), because Bernstein polynomials reproduce affine functions.

A ray whose two ends in a cell are beyond the same plane does not meet the surface there, and needs no polynomial.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake.bricks import SIDE
from sdfrender.kernels import Kernel
from sdfrender.stencils import Stencils

_CHUNK = 32  # bricks at once: their intervals and the nets of their cells stay in the caches
_CELLS = 32  # to a matrix product: BLAS starts threads of its own for larger ones, and ours are busy
_SINGLE = float(np.finfo(np.float32).eps)

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, eq=False)
class Slabs:
    """The cells that may hold surface; everywhere else |f| > margin, by certificate.

    Attributes
    ----------
    cell
        Numbers of the cells among those of all bricks, 512 slot + 64 i + 8 j + k, ascending.
    plane
        (n, 4): c, g per cell; g per voxel.
    delta
        Half the slab's width, with the rounding of all that computes and reads the slab.
    largest
        Greatest sum of |weight x coefficient| behind a control point of these cells' nets.
    """

    cell: Int[np.ndarray, " n"]
    plane: Float[np.ndarray, "n 4"]
    delta: Float[np.ndarray, " n"]
    largest: float


class _Maps(NamedTuple):
    """Matrices from the taps of a cell, in single precision.

    Attributes
    ----------
    slab
        (terms^3 + 3, taps^3): the net minus g . (x - 1/2), then g.
    magnitude
        (terms^3, taps^3): |weight| of every tap in every control point.
    rounding
        Bound of the rounding of a slab's residual, over the greatest tap: sums of taps^3 products for the residual
        and for g, whose error counts 3/2 times in the cell; as much again for the rounded taps and weights.
    """

    slab: Float[np.ndarray, "rows taps"]
    magnitude: Float[np.ndarray, "terms taps"]
    rounding: float


def slabs(made: Stencils, kernel: Kernel, margin: Callable[[float], float]) -> Slabs:
    """Find the cells that may hold surface.

    The nets are computed in single precision whatever traces: their rounding widens the slabs by a millionth.

    Parameters
    ----------
    made
        Coefficients of every brick.
    kernel
        The kernel.
    margin
        Of the greatest sum of |weight x coefficient| that any cell can have: the least |f| of a cell that is empty.
    """
    low, high = _extremes(made.coefficients)
    reach = float(np.maximum(np.abs(low), np.abs(high)).max(initial=0.0))
    overlap = float(np.abs(kernel.bezier).sum(axis=1).max()) ** 3
    least = margin(overlap * reach)
    wider = (kernel.overlap**3 - 1) / 2 * (high - low) + least
    asked = np.flatnonzero((low - wider <= 0) & (high + wider >= 0))
    maps = _maps(kernel)

    def classify(part: slice) -> Slabs:
        rows = asked[part]
        coefficients = made.coefficients[rows].astype(np.float32, copy=False)
        within = least + 64 * _SINGLE * overlap * reach
        cells = np.flatnonzero(_straddles(coefficients, kernel, within) & made.complete[rows])
        plane, delta = _planes(_taps(coefficients, cells, kernel.taps), len(cells), maps)
        # The corners of the cell are half a voxel from its centre along every axis.
        may = np.abs(plane[:, 0]) <= np.abs(plane[:, 1:]).sum(axis=1) / 2 + delta + least
        kept = cells[may]
        behind = maps.magnitude @ np.abs(_taps(coefficients, kept, kernel.taps))
        number = rows[kept // SIDE**3] * SIDE**3 + kept % SIDE**3
        return Slabs(number, plane[may], delta[may], float(behind.max(initial=0.0)))

    parts = _by_chunks(classify, len(asked))
    largest = max((part.largest for part in parts), default=0.0) * (1 + 2 * kernel.taps**3 * _SINGLE)
    nothing = Slabs(np.zeros(0, np.int64), np.zeros((0, 4), np.float32), np.zeros(0, np.float32), 0.0)
    parts = parts or [nothing]
    cell, plane, delta = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("cell", "plane", "delta")
    )
    return Slabs(cell, plane, delta, largest)


def _by_chunks(work: Callable[[slice], Result], count: int) -> list[Result]:
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(work, [slice(start, start + _CHUNK) for start in range(0, count, _CHUNK)]))


def _extremes(coefficients: Float[np.ndarray, "k S S S"]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return the least and the greatest coefficient of every brick."""
    each = (1, 2, 3)
    ends = _by_chunks(
        lambda part: (coefficients[part].min(axis=each), coefficients[part].max(axis=each)), len(coefficients)
    )
    if not ends:
        return np.zeros(0), np.zeros(0)
    low, high = (np.concatenate(side).astype(np.float64) for side in zip(*ends, strict=True))
    return low, high


def _maps(kernel: Kernel) -> _Maps:
    basis, terms = kernel.bezier, kernel.degree + 1
    net = np.kron(np.kron(basis, basis), basis).reshape(terms, terms, terms, -1)
    greville = np.arange(terms) / kernel.degree - 0.5
    residual, slopes = net.copy(), []
    for axis in range(3):
        ends = net.take(-1, axis) - net.take(0, axis)
        slope = ends.mean(axis=(0, 1))
        place = greville.reshape([-1 if a == axis else 1 for a in range(3)] + [1])
        residual -= place * slope
        slopes.append(slope)
    left, gradient = residual.reshape(terms**3, -1), np.stack(slopes)
    worst = np.abs(left).sum(axis=1).max() + 1.5 * np.abs(gradient).sum(axis=1).max()
    return _Maps(
        np.concatenate([left, gradient]).astype(np.float32),
        np.abs(net).reshape(terms**3, -1).astype(np.float32),
        float(2 * kernel.taps**3 * _SINGLE * worst),
    )


def _planes(
    taps: Float[np.ndarray, "blocks taps 32"], count: int, maps: _Maps
) -> tuple[Float[np.ndarray, "n 4"], Float[np.ndarray, " n"]]:
    """Fit a slab to every cell: the middle of the residual's range, the slope, and what is left."""
    rows = maps.slab @ taps
    residual, gradient = rows[:, :-3], rows[:, -3:]
    low, high = residual.min(axis=1), residual.max(axis=1)
    middle = (low + high) / 2
    rounding = maps.rounding * np.abs(taps).max(axis=1)
    # An engine of either precision: x - 1/2, three products, three sums: under 8 units of the terms' magnitudes.
    reading = 4 * _SINGLE * (np.abs(middle) + np.abs(gradient).sum(axis=1))
    delta = (high - low) / 2 + rounding + reading
    plane = np.concatenate([middle[:, None], gradient], axis=1).transpose(0, 2, 1).reshape(-1, 4)
    return plane[:count], delta.ravel()[:count]


def _straddles(
    coefficients: Float[np.ndarray, "m S S S"], kernel: Kernel, within: float
) -> Bool[np.ndarray, "m 8 8 8"]:
    """Say which cells' nets can come near 0, bounded by intervals: the Bezier form of one axis after the other."""
    low: np.ndarray = coefficients
    high = low
    for axis in (1, 2, 3):
        lows, highs = (
            [bound[(slice(None),) * axis + (slice(tap, tap + SIDE),)] for tap in range(kernel.taps)]
            for bound in (low, high)
        )
        rows = [_interval(row, lows, highs) for row in kernel.bezier]
        low, high = rows[0]
        for least, most in rows[1:]:
            low, high = np.minimum(low, least), np.maximum(high, most)
    near: Bool[np.ndarray, "m 8 8 8"] = (low <= within) & (high >= -within)
    return near


def _interval(
    weights: Float[np.ndarray, " taps"], lows: list[np.ndarray], highs: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Combine intervals with weights of either sign."""
    used = [(tap, weight) for tap, weight in enumerate(weights.tolist()) if abs(weight) > 1e-15]  # what rounding left
    if len(used) == 1 and used[0][1] == 1:
        return lows[used[0][0]], highs[used[0][0]]
    sums = []
    for near, far in ((lows, highs), (highs, lows)):
        first, *others = ((near if weight > 0 else far)[tap] * np.float32(weight) for tap, weight in used)
        sums.append(sum(others, start=first))
    return sums[0], sums[1]


def _taps(
    coefficients: Float[np.ndarray, "m S S S"], cells: Int[np.ndarray, " n"], taps: int
) -> Float[np.ndarray, "blocks taps3 32"]:
    """Gather the coefficients of cells given by their number in the bricks, z fastest, some cells to a block.

    The last block is filled up with the first cell.
    """
    size, tap = coefficients.shape[-1], np.arange(taps)
    offset = ((tap[:, None, None] * size + tap[:, None]) * size + tap).reshape(-1, 1)
    brick, local = np.divmod(cells, SIDE**3)
    base = ((brick * size + (local >> 6)) * size + ((local >> 3) & 7)) * size + (local & 7)
    base = np.concatenate([base, np.repeat(base[:1], -len(base) % _CELLS)])
    cubes: Float[np.ndarray, "blocks taps3 32"] = coefficients.reshape(-1).take(
        base.reshape(len(base) // _CELLS, 1, _CELLS) + offset
    )
    return cubes
