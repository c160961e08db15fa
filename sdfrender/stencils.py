"""Bricks of samples turned into what a kernel reads at render time.

In: a channel of a grid and a kernel. Out: per brick the coefficients of its 8^3 cells with the apron that their
stencils need, prefiltered; and which cells may hold surface, certified by the Bezier net.

A stencil that leaves the lattice continues linearly. A stencil that reaches an absent brick is incomplete: by the
band's width such a cell holds no surface (Galim 2018 stores all samples; here only those near the surface exist).
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import reduce
from itertools import product
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Integer, Num

from sdfbake.bricks import SIDE, Bricks
from sdfrender.kernels import Kernel

HALO_LOW, HALO_HIGH = 2, 3  # samples beyond a brick's own that the widest stencil and its prefilter touch
PADDED = SIDE + HALO_LOW + HALO_HIGH
INCOMPLETE, EMPTY, OCCUPIED = 0, 1, 2  # what a cell can be
_CHUNK = 128  # bricks at once: 2.3 MB of padded float64 samples stay in the caches

Result = TypeVar("Result")
FloatType = type[np.float32] | type[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Stencils:
    """What a kernel reads of the bricks of one channel.

    Attributes
    ----------
    coefficients
        (k, S, S, S), S = 7 + taps: coefficients of a brick's cells, starting at the kernel's first tap.
    cells
        (k, 8, 8, 8) uint8: INCOMPLETE, EMPTY or OCCUPIED.
    largest
        Greatest sum of |weight x coefficient| behind a control point of the occupied cells' nets.
    """

    coefficients: Float[np.ndarray, "k S S S"]
    cells: Integer[np.ndarray, "k 8 8 8"]
    largest: float


@dataclass(frozen=True, slots=True, eq=False)
class _Source:
    """A channel and where its bricks are: the tables have a rim, so that every brick has neighbours."""

    values: Num[np.ndarray, "k 8 8 8"]
    slot: Integer[np.ndarray, "bx by bz"]
    far: Float[np.ndarray, "bx by bz"]
    shape: tuple[int, int, int]

    @staticmethod
    def of(values: Num[np.ndarray, "k 8 8 8"], bricks: Bricks, shape: tuple[int, int, int]) -> "_Source":
        return _Source(values, np.pad(bricks.slot, 1, constant_values=-1), np.pad(bricks.far, 1), shape)


def stencils(
    values: Float[np.ndarray, "k 8 8 8"], bricks: Bricks, shape: tuple[int, int, int], kernel: Kernel, kind: FloatType
) -> Stencils:
    """Prepare the distance channel: coefficients and occupied cells.

    Parameters
    ----------
    values
        Signed distances, world units.
    bricks
        Where the bricks lie.
    shape
        Samples of the lattice.
    kernel
        The kernel.
    kind
        Float type that will trace: of the coefficients, and its rounding widens the test for surface.
    """
    size, eps = SIDE - 1 + kernel.taps, float(np.finfo(kind).eps)
    coefficients = np.empty((len(bricks), size, size, size), kind)
    cells = np.empty((len(bricks), SIDE, SIDE, SIDE), np.uint8)
    source = _Source.of(values, bricks, shape)

    def prepare(rows: slice) -> float:
        index = bricks.index[rows]
        exact = _coefficients(_padded(source, index, absent="nan"), kernel)
        undecided = ~_one_sided(exact, kernel, eps)
        kinds = np.full((len(exact), SIDE, SIDE, SIDE), EMPTY, np.uint8)
        kinds[undecided], largest = _classify(exact[undecided], kernel, eps)
        kinds[~_has_cell(index, shape)] = INCOMPLETE
        unknown = np.isnan(exact)
        holed = unknown.any(axis=(1, 2, 3))
        bound = _window(_padded(source, index[holed], absent="far"), kernel)
        exact[holed] = np.where(unknown[holed], bound, exact[holed])
        coefficients[rows], cells[rows] = exact, kinds
        return largest

    largest = max(_by_chunks(prepare, len(bricks)), default=0.0)
    return Stencils(coefficients, cells, largest)


def channel_coefficients(
    values: Float[np.ndarray, "k 8 8 8"], bricks: Bricks, shape: tuple[int, int, int], kernel: Kernel, kind: FloatType
) -> Float[np.ndarray, "k S S S"]:
    """Prepare another channel (a texture coordinate): its coefficients, 0 where a stencil is incomplete."""
    size = SIDE - 1 + kernel.taps
    out = np.empty((len(bricks), size, size, size), kind)
    source = _Source.of(values, bricks, shape)

    def prepare(rows: slice) -> None:
        exact = _coefficients(_padded(source, bricks.index[rows], absent="nan"), kernel)
        out[rows] = np.nan_to_num(exact, nan=0.0)

    _by_chunks(prepare, len(bricks))
    return out


def mixed_cells(
    ids: Integer[np.ndarray, "k 8 8 8"], bricks: Bricks, shape: tuple[int, int, int], kernel: Kernel
) -> Integer[np.ndarray, "k 8 8 8"]:
    """Say of every cell, as uint8, whether the samples behind its coefficients have different ids (a seam)."""
    out = np.empty((len(bricks), SIDE, SIDE, SIDE), np.uint8)
    source = _Source.of(ids, bricks, shape)
    reach = 1 if kernel.filtered else 0
    first, width = HALO_LOW + kernel.first - reach, kernel.taps + 2 * reach

    def prepare(rows: slice) -> None:
        padded = _padded(source, bricks.index[rows], absent="nan")
        whole = padded.reshape(len(padded), -1)
        several = np.fmin.reduce(whole, axis=1) != np.fmax.reduce(whole, axis=1)  # most bricks see one chart only
        least = most = padded[several]
        for axis in (1, 2, 3):
            starts = [(slice(None),) * axis + (slice(first + o, first + o + SIDE),) for o in range(width)]
            least, most = (
                reduce(pick, [bound[start] for start in starts]) for bound, pick in ((least, np.fmin), (most, np.fmax))
            )
        out[rows] = 0
        out[rows][several] = least != most

    _by_chunks(prepare, len(bricks))
    return out


def _by_chunks(prepare: Callable[[slice], Result], count: int) -> list[Result]:
    """Run a function on slices of the bricks, over threads (NumPy lets go of the interpreter in its loops)."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(prepare, [slice(start, start + _CHUNK) for start in range(0, count, _CHUNK)]))


def _padded(source: _Source, index: Integer[np.ndarray, "m 3"], absent: str) -> Float[np.ndarray, "m 13 13 13"]:
    """Gather bricks with their neighbours' samples around them; absent ones are NaN or the far bound."""
    out = np.empty((len(index), PADDED, PADDED, PADDED))
    spans = {
        -1: (slice(0, HALO_LOW), slice(SIDE - HALO_LOW, SIDE)),
        0: (slice(HALO_LOW, HALO_LOW + SIDE), slice(0, SIDE)),
        1: (slice(HALO_LOW + SIDE, PADDED), slice(0, HALO_HIGH)),
    }
    for offset in product((-1, 0, 1), repeat=3):
        neighbour = tuple((index + 1 + np.array(offset)).T)
        slot = source.slot[neighbour]
        (to_x, from_x), (to_y, from_y), (to_z, from_z) = (spans[o] for o in offset)
        block = out[:, to_x, to_y, to_z]
        block[...] = source.values[np.maximum(slot, 0), from_x, from_y, from_z]
        missing = slot < 0
        if missing.any():
            block[missing] = source.far[neighbour][missing][:, None, None, None] if absent == "far" else np.nan
    for axis in range(3):
        _continue_linearly(out, index[:, axis] * SIDE - HALO_LOW, source.shape[axis], axis + 1)
    return out


def _continue_linearly(
    padded: Float[np.ndarray, "m 13 13 13"], first: Integer[np.ndarray, " m"], count: int, axis: int
) -> None:
    """Continue blocks of one caller's array past the lattice's first and last sample along an axis, in place."""
    blocks = np.moveaxis(padded, axis, 1)
    for start in np.unique(first[(first < 0) | (first + PADDED > count)]):
        rows = first == start
        part = blocks[rows]
        at = start + np.arange(PADDED)
        for outside, edge, inner in ((at < 0, 0, 1), (at >= count, count - 1, count - 2)):
            if not outside.any():
                continue
            step = (at[outside] - edge) * (edge - inner)
            base, slope = part[:, edge - start, None], part[:, edge - start, None] - part[:, inner - start, None]
            part[:, outside] = base + step[:, None, None] * slope
        blocks[rows] = part


def _coefficients(padded: Float[np.ndarray, "m 13 13 13"], kernel: Kernel) -> Float[np.ndarray, "m S S S"]:
    """Prefilter along each axis and keep what the kernel reads."""
    if kernel.filtered:
        outer, middle, _ = kernel.prefilter
        for axis in (1, 2, 3):
            low, centre, high = (
                padded[(slice(None),) * axis + (part,)] for part in (slice(0, -2), slice(1, -1), slice(2, None))
            )
            inner = low + high
            inner *= outer
            inner += middle * centre
            padded = inner
        first = HALO_LOW - 1 + kernel.first
        kept = slice(first, first + SIDE - 1 + kernel.taps)
        return np.ascontiguousarray(padded[:, kept, kept, kept])
    return _window(padded, kernel)


def _window(padded: Float[np.ndarray, "m 13 13 13"], kernel: Kernel) -> Float[np.ndarray, "m S S S"]:
    first = HALO_LOW + kernel.first
    kept = slice(first, first + SIDE - 1 + kernel.taps)
    return np.ascontiguousarray(padded[:, kept, kept, kept])


def _one_sided(coefficients: Float[np.ndarray, "m S S S"], kernel: Kernel, eps: float) -> Bool[np.ndarray, " m"]:
    """Say which bricks hold no surface at a glance: weights that are never negative stay on the side of their taps.

    Never true where a tap is NaN.
    """
    if kernel.overlap > 1:
        return np.zeros(len(coefficients), bool)
    taps = coefficients.reshape(len(coefficients), -1)
    low, high = taps.min(axis=1), taps.max(axis=1)
    sided: Bool[np.ndarray, " m"] = (low > 64 * eps * np.abs(high)) | (high < -64 * eps * np.abs(low))
    return sided


def _classify(
    coefficients: Float[np.ndarray, "m S S S"], kernel: Kernel, eps: float
) -> tuple[Integer[np.ndarray, "m 8 8 8"], float]:
    """Say of every cell whether it may hold surface; also what its rounding is relative to.

    First by intervals, one axis after the other; what is left, by the Bezier net itself: surface only if the net
    reaches from below m to above -m, m = 64 eps max |net|, its rounding.
    """
    low, high = _hull(coefficients, kernel)
    widened = 64 * eps * np.maximum(np.abs(low), np.abs(high))
    kinds = np.where(np.isnan(low), INCOMPLETE, EMPTY).astype(np.uint8)
    asked = np.flatnonzero((low - widened <= 0) & (high + widened >= 0))
    net_of_taps = np.kron(np.kron(kernel.bezier, kernel.bezier), kernel.bezier).T
    magnitudes = np.abs(net_of_taps)
    largest = 0.0
    for start in range(0, len(asked), 16384):
        cells = asked[start : start + 16384]
        taps = _taps(coefficients, cells, kernel.taps)
        net = taps @ net_of_taps
        least, most = net.min(axis=1), net.max(axis=1)
        size = np.maximum(np.abs(least), np.abs(most))
        may = (least <= 64 * eps * size) & (most >= -64 * eps * size)
        kinds.ravel()[cells[may]] = OCCUPIED
        largest = max(largest, float((np.abs(taps[may]) @ magnitudes).max(initial=0.0)))
    return kinds, largest


def _taps(
    coefficients: Float[np.ndarray, "m S S S"], cells: Integer[np.ndarray, " n"], taps: int
) -> Float[np.ndarray, "n taps3"]:
    """Gather the coefficients of cells given by their number in the bricks, z fastest."""
    size = coefficients.shape[-1]
    brick, i, j, k = np.unravel_index(cells, (len(coefficients), SIDE, SIDE, SIDE))
    tap = np.arange(taps)
    offset = ((tap[:, None, None] * size + tap[:, None]) * size + tap).ravel()
    cubes: Float[np.ndarray, "n taps3"] = coefficients.reshape(-1)[
        (((brick * size + i) * size + j) * size + k)[:, None] + offset
    ]
    return cubes


def _hull(
    coefficients: Float[np.ndarray, "m S S S"], kernel: Kernel
) -> tuple[Float[np.ndarray, "m 8 8 8"], Float[np.ndarray, "m 8 8 8"]]:
    """Bound the net of every cell by intervals, the Bezier form of one axis after the other; NaN where a tap is."""
    low = high = coefficients
    for axis in (1, 2, 3):
        lows, highs = (
            [bound[(slice(None),) * axis + (slice(tap, tap + SIDE),)] for tap in range(kernel.taps)]
            for bound in (low, high)
        )
        rows = [_interval(row, lows, highs) for row in kernel.bezier]
        low, high = rows[0]
        for least, most in rows[1:]:
            low, high = np.minimum(low, least), np.maximum(high, most)
    return low, high


def _interval(
    weights: Float[np.ndarray, " taps"], lows: list[np.ndarray], highs: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Combine intervals with weights of either sign."""
    used = [tap for tap, weight in enumerate(weights) if abs(weight) > 1e-15]  # what rounding left of a zero
    if len(used) == 1 and weights[used[0]] == 1:
        return lows[used[0]], highs[used[0]]
    sums = []
    for near, far in ((lows, highs), (highs, lows)):
        ends = [(near if weights[tap] > 0 else far)[tap] for tap in used]
        total = weights[used[0]] * ends[0]
        for tap, end in zip(used[1:], ends[1:], strict=True):
            total += weights[tap] * end
        sums.append(total)
    return sums[0], sums[1]


def _has_cell(index: Integer[np.ndarray, "m 3"], shape: tuple[int, int, int]) -> np.ndarray:
    """Say which cells of some bricks lie in the lattice: cell i reaches from sample i to i + 1."""
    x, y, z = ((index[:, axis, None] * SIDE + np.arange(SIDE)) < shape[axis] - 1 for axis in range(3))
    inside: np.ndarray = x[:, :, None, None] & y[:, None, :, None] & z[:, None, None, :]
    return inside
