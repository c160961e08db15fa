"""Bricks of samples turned into what a kernel reads at render time.

In: a channel of a grid and a kernel. Out: per brick the coefficients of its 8^3 cells with the apron that their
stencils need, prefiltered; and which cells have a whole stencil.

A stencil that leaves the lattice continues linearly. A stencil that reaches an absent brick is incomplete: by the
band's width such a cell holds no surface (Galim 2018 stores all samples; here only those near the surface exist).
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import reduce
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int, Integer, Num

from sdfbake.bricks import SIDE, Bricks
from sdfrender.kernels import Kernel

HALO_LOW, HALO_HIGH = 2, 3  # samples beyond a brick's own that the widest stencil and its prefilter touch
PADDED = SIDE + HALO_LOW + HALO_HIGH
_CHUNK = 32  # bricks at once: 0.6 MB of padded float64 samples and their temporaries stay in the caches

Result = TypeVar("Result")
FloatType = type[np.float32] | type[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Stencils:
    """What a kernel reads of the bricks of one channel.

    Attributes
    ----------
    coefficients
        (k, S, S, S), S = 7 + taps: coefficients of a brick's cells, starting at the kernel's first tap.
    complete
        (k, 8, 8, 8): whether the cell lies in the lattice and no coefficient of it was read from an absent brick.
    """

    coefficients: Float[np.ndarray, "k S S S"]
    complete: Bool[np.ndarray, "k 8 8 8"]


def _places() -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Say of every sample of a padded brick which of the 27 bricks it is in, and where in there."""
    brick, inside = np.divmod(np.arange(-HALO_LOW, SIDE + HALO_HIGH), SIDE)
    x, y, z = np.ix_(brick + 1, brick + 1, brick + 1)
    i, j, k = np.ix_(inside, inside, inside)
    return ((x * 3 + y) * 3 + z).ravel(), ((i * SIDE + j) * SIDE + k).ravel()


_BRICK, _INSIDE = _places()


@dataclass(frozen=True, slots=True, eq=False)
class _Source:
    """A channel and where its bricks are.

    Attributes
    ----------
    values
        All samples, and after them a brick of NaN that stands for every absent one.
    slot, far
        Tables of the bricks with a rim, so that every brick has neighbours.
    shape
        Samples of the lattice.
    """

    values: Float[np.ndarray, " n"]
    slot: Int[np.ndarray, "bx by bz"]
    far: Float[np.ndarray, "bx by bz"]
    shape: tuple[int, int, int]

    @staticmethod
    def of(values: Num[np.ndarray, "k 8 8 8"], bricks: Bricks, shape: tuple[int, int, int]) -> "_Source":
        kind = values.dtype if values.dtype.kind == "f" else np.float64
        absent = len(values)
        flat = np.full((absent + 1) * SIDE**3, np.nan, kind)
        flat[: values.size] = values.ravel()
        slot = np.where(bricks.slot < 0, absent, bricks.slot)
        return _Source(flat, np.pad(slot, 1, constant_values=absent), np.pad(bricks.far, 1), shape)

    def around(self, index: Integer[np.ndarray, "m 3"]) -> Int[np.ndarray, "m 27"]:
        """Return where in the tables the 27 neighbours of bricks are."""
        _, ny, nz = self.slot.shape
        x, y, z = index.astype(np.int64).T
        step = np.arange(3)
        offset = ((step[:, None, None] * ny + step[:, None]) * nz + step).ravel()
        at: Int[np.ndarray, "m 27"] = ((x * ny + y) * nz + z)[:, None] + offset
        return at


def stencils(
    values: Float[np.ndarray, "k 8 8 8"], bricks: Bricks, shape: tuple[int, int, int], kernel: Kernel, kind: FloatType
) -> Stencils:
    """Prepare the distance channel: coefficients, with the signed bound of an absent brick in place of its samples.

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
        Float type of the coefficients; they are computed in float64 all the same.
    """
    size = SIDE - 1 + kernel.taps
    coefficients = np.empty((len(bricks), size, size, size), kind)
    complete = np.empty((len(bricks), SIDE, SIDE, SIDE), bool)
    source = _Source.of(values, bricks, shape)

    def prepare(rows: slice) -> None:
        index = bricks.index[rows]
        padded = _padded(source, index)
        made = _coefficients(_continued(padded.astype(np.float64), index, shape), kernel).astype(kind)
        whole = _has_cell(index, shape)
        holed = (source.slot.take(source.around(index)) == len(values)).any(axis=1)
        if holed.any():
            missing, bound = np.isnan(made[holed]), _bounded(source, padded[holed], index[holed], kernel)
            made[holed] = np.where(missing, bound, made[holed])
            whole[holed] &= ~_any_tap(missing, kernel)
        coefficients[rows], complete[rows] = made, whole

    _by_chunks(prepare, len(bricks))
    return Stencils(coefficients, complete)


def channel_coefficients(
    values: Float[np.ndarray, "k 8 8 8"], bricks: Bricks, shape: tuple[int, int, int], kernel: Kernel, kind: FloatType
) -> Float[np.ndarray, "k S S S"]:
    """Prepare another channel (a texture coordinate): its coefficients, 0 where a stencil is incomplete."""
    size = SIDE - 1 + kernel.taps
    out = np.empty((len(bricks), size, size, size), kind)
    source = _Source.of(values, bricks, shape)

    def prepare(rows: slice) -> None:
        index = bricks.index[rows]
        exact = _coefficients(_continued(_padded(source, index).astype(np.float64), index, shape), kernel)
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
        index = bricks.index[rows]
        padded = _continued(_padded(source, index), index, shape)
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


def _padded(source: _Source, index: Integer[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 13 13 13"]:
    """Gather bricks with their neighbours' samples around them; absent ones are NaN."""
    first = source.slot.take(source.around(index)).astype(np.int64) * SIDE**3
    at = first.take(_BRICK, axis=1)
    at += _INSIDE
    padded: Float[np.ndarray, "m 13 13 13"] = source.values.take(at).reshape(-1, PADDED, PADDED, PADDED)
    return padded


def _bounded(
    source: _Source, padded: Float[np.ndarray, "m 13 13 13"], index: Integer[np.ndarray, "m 3"], kernel: Kernel
) -> Float[np.ndarray, "m S S S"]:
    """Return what stands for the coefficients that there are not: samples, or the bounds of absent bricks."""
    far = source.far.take(source.around(index)).take(_BRICK, axis=1).reshape(padded.shape)
    return _window(_continued(np.where(np.isnan(padded), far, padded), index, source.shape), kernel)


def _continued(
    padded: Float[np.ndarray, "m 13 13 13"], index: Integer[np.ndarray, "m 3"], shape: tuple[int, int, int]
) -> Float[np.ndarray, "m 13 13 13"]:
    """Continue blocks past the lattice's first and last sample linearly, one axis after the other."""
    for axis, count in enumerate(shape):
        first = index[:, axis] * SIDE - HALO_LOW
        beyond = (first < 0) | (first + PADDED > count)
        if not beyond.any():
            continue
        padded = padded.copy()
        for start in np.unique(first[beyond]):
            rows = first == start
            part = np.moveaxis(padded[rows], axis + 1, 1)
            at = start + np.arange(PADDED)
            for outside, edge, inner in ((at < 0, 0, 1), (at >= count, count - 1, count - 2)):
                if not outside.any():
                    continue
                step = (at[outside] - edge) * (edge - inner)
                base, slope = part[:, edge - start, None], part[:, edge - start, None] - part[:, inner - start, None]
                part[:, outside] = base + step[:, None, None] * slope
            padded[rows] = np.moveaxis(part, 1, axis + 1)
    return padded


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
        return padded[:, kept, kept, kept]
    return _window(padded, kernel)


def _window(padded: Float[np.ndarray, "m 13 13 13"], kernel: Kernel) -> Float[np.ndarray, "m S S S"]:
    first = HALO_LOW + kernel.first
    kept = slice(first, first + SIDE - 1 + kernel.taps)
    return padded[:, kept, kept, kept]


def _any_tap(mask: Bool[np.ndarray, "m S S S"], kernel: Kernel) -> Bool[np.ndarray, "m 8 8 8"]:
    """Say of every cell whether a mask holds at some coefficient of its stencil."""
    for axis in (1, 2, 3):
        rows = [mask[(slice(None),) * axis + (slice(tap, tap + SIDE),)] for tap in range(kernel.taps)]
        mask = reduce(np.logical_or, rows)
    return mask


def _has_cell(index: Integer[np.ndarray, "m 3"], shape: tuple[int, int, int]) -> np.ndarray:
    """Say which cells of some bricks lie in the lattice: cell i reaches from sample i to i + 1."""
    x, y, z = ((index[:, axis, None] * SIDE + np.arange(SIDE)) < shape[axis] - 1 for axis in range(3))
    inside: np.ndarray = x[:, :, None, None] & y[:, None, :, None] & z[:, None, None, :]
    return inside
