"""Bricks of samples turned into what a kernel reads at render time.

In: a channel of a grid and a kernel. Out: per brick the coefficients of its 8^3 cells with the apron that their
stencils need, prefiltered; and which cells have a whole stencil.

A stencil that leaves the lattice continues linearly. A stencil that reaches an absent brick is incomplete: by the
band's width such a cell holds no surface (Galim 2018 stores all samples; here only those near the surface exist).

Lanes are rows of samples along z, which lie next to each other. Every sample is prefiltered once, by the brick that it
is in; aprons are copied.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Integer

from sdfbake.bricks import SIDE, Bricks
from sdfbake.engine import Array, Engine
from sdfrender.kernels import Kernel

AROUND = 27  # a brick and its neighbours: 9 x + 3 y + z, each 0, 1 or 2; the brick itself is the middle one

APRON = 2  # coefficients beyond a brick's own that the widest kernel reads


class Blocks(NamedTuple):
    """Bricks on an engine, with those around each.

    Attributes
    ----------
    size
        How many there are.
    first
        First sample of every brick in the lattice, by axis.
    slot
        27 numbers per brick: the slot of a brick around it, -1 where there is none.
    absent
        Per brick 27 bits: a brick around it is missing although it would lie in the lattice.
    far
        27 floats per brick, single precision: signed bound of an absent brick around it.
    border
        How many bricks have an apron that leaves the lattice, and which; None if there are none.
    samples
        Samples of the lattice, uniform.
    """

    size: int
    first: tuple[Array, Array, Array]
    slot: Array
    absent: Array
    far: Array
    border: tuple[int, Array] | None
    samples: tuple[Array, Array, Array]

    @staticmethod
    def of(xp: Engine, bricks: Bricks, shape: tuple[int, int, int]) -> "Blocks":
        """Bring the bricks of a lattice to an engine; there is always one, be it an empty one."""
        index = bricks.index if len(bricks) else np.zeros((1, 3), np.int32)
        slot = around(bricks.slot, index, -2)
        far = around(bricks.far, index, 0)
        bits = ((slot == -1) << np.arange(AROUND)).sum(axis=1, dtype=np.int32)
        x, y, z = (xp.table(index[:, axis] * SIDE) for axis in range(3))
        nx, ny, nz = (xp.uniform(int(n)) for n in shape)
        leaves = (index == 0).any(axis=1) | ((index + 1) * SIDE + APRON > np.array(shape)).any(axis=1)
        some = np.flatnonzero(leaves)
        border = (len(some), xp.table(some)) if len(some) else None
        return Blocks(len(index), (x, y, z), xp.table(slot), xp.table(bits), xp.at(32).table(far), border, (nx, ny, nz))


class Stencils(NamedTuple):
    """What a kernel reads of the bricks of one channel.

    Attributes
    ----------
    coefficients
        S^3 per brick, S = 7 + taps: coefficients of its cells, starting at the kernel's first tap.
    complete
        64 bytes per brick, one for each row of cells, one bit for each cell: it lies in the lattice and no coefficient
        of it was read from an absent brick.
    """

    coefficients: Array
    complete: Array


def around(
    table: Integer[np.ndarray, "bx by bz"] | Float[np.ndarray, "bx by bz"], index: Int[np.ndarray, "m 3"], outside: int
) -> np.ndarray:
    """Return the 27 entries of a table around each of some places: (m, 27)."""
    padded = np.pad(table, 1, constant_values=outside)
    _, ny, nz = padded.shape
    x, y, z = index.astype(np.int64).T
    step = np.arange(3)
    offset = ((step[:, None, None] * ny + step[:, None]) * nz + step).ravel()
    found: np.ndarray = padded.take(((x * ny + y) * nz + z)[:, None] + offset)
    return found


def stencils(xp: Engine, values: Float[np.ndarray, "k 8 8 8"], blocks: Blocks, kernel: Kernel) -> Stencils:
    """Prepare the distance channel; see `coefficients`."""
    made = coefficients(xp, values, blocks, kernel)
    (complete,) = xp.tabulated(blocks.size * SIDE**2, lambda lane: ((_complete(xp, blocks, kernel, lane),),))
    return Stencils(made, complete)


def coefficients(xp: Engine, values: Float[np.ndarray, "k 8 8 8"], blocks: Blocks, kernel: Kernel) -> Array:
    """Prefilter a channel; where a sample would be needed that is not there, the sample itself or a bound stands in.

    Parameters
    ----------
    xp
        The engine; the coefficients are of its precision, and computed in float64 all the same.
    values
        Samples, float32.
    blocks
        Where the bricks lie; an absent one is as far as it says.
    kernel
        The kernel.
    """
    samples = xp.at(32).table(values if len(values) else np.zeros(SIDE**3, np.float32))
    own = _filtered(xp, samples, blocks, kernel) if kernel.filtered else samples
    (inside,) = xp.tabulated(
        blocks.size * width(kernel) ** 3,
        lambda lane: ((_in_lattice(xp, (own, samples), blocks, kernel, lane),),),
    )
    return _continued(xp, samples, blocks, kernel, inside)


def width(kernel: Kernel) -> int:
    """Return the number of coefficients of a brick along each axis."""
    return SIDE - 1 + kernel.taps


def _filtered(xp: Engine, samples: Array, blocks: Blocks, kernel: Kernel) -> Array:
    """Prefilter every sample of every brick; anything where one that it needs is absent.

    At the lattice's first and last sample the prefilter of a linear continuation is the sample itself.
    """
    fine = xp.at(64)
    outer, middle, _ = kernel.prefilter

    def edges(brick: Array, axis: int, place: Array) -> Array:
        at = xp.gather(blocks.first[axis], brick, True) + place
        return (at == 0) | (at == blocks.samples[axis] - 1)

    def row(lane: Array) -> tuple[tuple[Array, ...]]:
        brick, x, y = brick_row(lane)
        edge_x, edge_y = edges(brick, 0, x), edges(brick, 1, y)
        step_x, step_y = xp.integer(~edge_x), xp.integer(~edge_y)
        total: list[Array] = []
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                weight = _tap(fine, edge_x, i, (outer, middle)) * _tap(fine, edge_y, j, (outer, middle))
                entries = _row_of(xp, samples, blocks, brick, (x + step_x * i, y + step_y * j))
                terms = [fine.real(entry) for entry in entries]
                total = [
                    fine.fma(weight, term, so_far)
                    for term, so_far in zip(terms, total or [fine.full(lane, 0.0)] * len(terms), strict=True)
                ]
        out = []
        for z in range(SIDE):
            value = middle * total[z + 1] + outer * (total[z] + total[z + 2])
            out.append(xp.real(fine.where(edges(brick, 2, xp.full(lane, z)), total[z + 1], value)))
        return (tuple(out),)

    (own,) = xp.tabulated(blocks.size * SIDE**2, row)
    return own


def brick_row(lane: Array) -> tuple[Array, Array, Array]:
    """Return the brick of a row of its 64, and the row's place."""
    return lane >> 6, (lane >> 3) & 7, lane & 7


def _apron_row(lane: Array, kernel: Kernel) -> tuple[Array, Array, Array]:
    """Return the brick of a row of coefficients, and the place of the row's samples."""
    size = width(kernel)
    brick = lane // size**2
    x = lane // size - brick * size
    y = lane - (brick * size + x) * size
    return brick, x + kernel.first, y + kernel.first


def _tap(xp: Engine, edge: Array, step: int, weights: tuple[float, float]) -> Array:
    """Return the prefilter's weight of a tap: all of it is in the middle where the lattice ends."""
    outer, middle = weights
    return xp.where(edge, 1.0 if step == 0 else 0.0, xp.full(edge, middle if step == 0 else outer))


def _row_of(xp: Engine, samples: Array, blocks: Blocks, brick: Array, at: tuple[Array, Array]) -> list[Array]:
    """Return a row of a brick and one sample beyond it at either end; anything where a brick is absent."""
    column = brick * AROUND + _part(at[0]) * 9 + _part(at[1]) * 3
    place = ((at[0] & 7) << 3) | (at[1] & 7)
    below, here, above = (xp.gather(blocks.slot, column + z, True) for z in range(3))
    single = xp.at(32)
    low = xp.gather(samples, (((below << 6) | place) << 3) + 7, below >= 0)
    high = xp.gather(samples, ((above << 6) | place) << 3, above >= 0)
    first = ((here << 6) | place) << 1
    own = [*single.rows(samples, first, here >= 0), *single.rows(samples, first + 1, here >= 0)]
    return [low, *own, high]


def _part(place: Array) -> Array:
    """Return which of three bricks a place near the middle one is in."""
    return (place >> 3) + 1


def _in_lattice(xp: Engine, tables: tuple[Array, Array], blocks: Blocks, kernel: Kernel, lane: Array) -> Array:
    """Return a coefficient of a brick or its apron; anything outside the lattice."""
    own, samples = tables
    brick, (x, y, z) = coefficient(lane, kernel)
    near = brick * AROUND + _part(x) * 9 + _part(y) * 3 + _part(z)
    slot = xp.gather(blocks.slot, near, True)
    there = slot >= 0
    at = (slot << 9) | ((x & 7) << 6) | ((y & 7) << 3) | (z & 7)
    alone = lost(xp, blocks, kernel, brick, (x, y))(z)
    value = xp.gather(own, at, there & ~alone)
    if kernel.filtered:
        value = xp.where(alone, xp.real(xp.gather(samples, at, there & alone)), value)
    return xp.where(there, xp.real(value), xp.real(xp.gather(blocks.far, near, ~there)))


def coefficient(lane: Array, kernel: Kernel) -> tuple[Array, tuple[Array, Array, Array]]:
    """Return the brick of a coefficient, and its place."""
    size = width(kernel)
    row = lane // size
    brick, x, y = _apron_row(row, kernel)
    return brick, (x, y, lane - row * size + kernel.first)


def _missing(
    xp: Engine, blocks: Blocks, brick: Array, place: tuple[Array, Array], reach: tuple[int, int]
) -> Callable[[Array | int], Array]:
    """Return whether samples from `reach[0]` to `reach[1]` about a place are in absent bricks, as a function of its z.

    What lies outside the lattice is continued from samples that are about the place as well.
    """
    absent, one = xp.gather(blocks.absent, brick, True), xp.full(brick, 1)

    def bits(unit: Array | int, p: Array | int, step: int) -> Array | int:
        return (unit << (_part(p + reach[0]) * step)) | (unit << (_part(p + reach[1]) * step))

    columns = bits(one, place[0], 9) * bits(one, place[1], 3)  # every product of two bits is a bit of its own
    known: dict[Array | int, Array] = {}

    def at(z: Array | int) -> Array:
        if not isinstance(z, int):
            return (absent & (columns * bits(one, z, 1))) != 0
        need = bits(1, z, 1)
        if need not in known:
            known[need] = (absent & (columns * need)) != 0
        return known[need]

    return at


def lost(
    xp: Engine, blocks: Blocks, kernel: Kernel, brick: Array, place: tuple[Array, Array]
) -> Callable[[Array | int], Array]:
    """Return whether the coefficients of a row are not made of samples, as a function of their z."""
    halo = _halo(kernel)
    return _missing(xp, blocks, brick, place, (-halo, halo))


def in_lattice(xp: Engine, blocks: Blocks, brick: Array, place: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Return the places of the lattice, counted from a brick's first sample, that are nearest to some."""
    first = [xp.gather(blocks.first[axis], brick, True) for axis in range(3)]
    x, y, z = (
        xp.minimum(xp.maximum(p, -low), count - 1 - low)
        for p, low, count in zip(place, first, blocks.samples, strict=True)
    )
    return x, y, z


def _halo(kernel: Kernel) -> int:
    """Return how many samples on either side the prefilter reads."""
    return 1 if kernel.filtered else 0


def _complete(xp: Engine, blocks: Blocks, kernel: Kernel, lane: Array) -> Array:
    """Return the bits of a row of cells whose stencils are whole: cell i reaches from sample i to i + 1."""
    brick, x, y = brick_row(lane)
    halo = _halo(kernel)
    missing = _missing(xp, blocks, brick, (x, y), (kernel.first - halo, kernel.first + kernel.taps - 1 + halo))
    first = [xp.gather(blocks.first[axis], brick, True) for axis in range(3)]
    inside = (first[0] + x < blocks.samples[0] - 1) & (first[1] + y < blocks.samples[1] - 1)
    bits = xp.full(lane, 0)
    for z in range(SIDE):
        whole = inside & (first[2] + z < blocks.samples[2] - 1) & ~missing(z)
        bits = bits | (xp.integer(whole) << z)
    return bits


def _continued(xp: Engine, samples: Array, blocks: Blocks, kernel: Kernel, inside: Array) -> Array:
    """Replace the coefficients outside the lattice by those of a linear continuation of the samples."""
    if blocks.border is None:
        return inside
    size, (count, border) = width(kernel), blocks.border

    def place_of(lane: Array) -> tuple[Array, tuple[Array, Array, Array], Array]:
        number, place = coefficient(lane, kernel)
        brick = xp.gather(border, number, True)
        return brick, place, lane + (brick - number) * size**3

    def is_outside(lane: Array) -> tuple[tuple[Array]]:
        brick, place, _ = place_of(lane)
        outside = xp.full(lane, False)
        for axis, p in enumerate(place):
            at = xp.gather(blocks.first[axis], brick, True) + p
            outside = outside | (at < 0) | (at >= blocks.samples[axis])
        return ((outside,),)

    (mask,) = xp.tabulated(count * size**3, is_outside)
    outside = xp.kept(mask)
    if len(outside) == 0:
        return inside

    def value(lane: Array) -> tuple[tuple[Array], tuple[Array]]:
        brick, place, at = place_of(xp.gather(outside, lane, True))
        return (at,), (_anywhere(xp, samples, blocks, kernel, (brick, place)),)

    at, values = xp.tabulated(len(outside), value)
    return xp.replaced(inside, at, values)


def _anywhere(xp: Engine, samples: Array, blocks: Blocks, kernel: Kernel, at: tuple[Array, Sequence[Array]]) -> Array:
    """Return the coefficient at a place in a brick or next to it, in the lattice or not."""
    fine = xp.at(64)
    brick, place = at
    origin = [xp.gather(blocks.first[axis], brick, True) for axis in range(3)]
    x, y, z = in_lattice(xp, blocks, brick, place)
    alone = lost(xp, blocks, kernel, brick, (x, y))(z)
    by_axis = [
        _weighted(fine, kernel, (p, first, last - 1), alone)
        for p, first, last in zip(place, origin, blocks.samples, strict=True)
    ]
    total = fine.full(brick, 0.0)
    for x, a in by_axis[0]:
        for y, b in by_axis[1]:
            for z, c in by_axis[2]:
                near = brick * AROUND + _part(x) * 9 + _part(y) * 3 + _part(z)
                slot = xp.gather(blocks.slot, near, True)
                there = slot >= 0
                sample = xp.gather(samples, (slot << 9) | ((x & 7) << 6) | ((y & 7) << 3) | (z & 7), there)
                term = xp.where(there, sample, xp.gather(blocks.far, near, ~there))
                total = fine.fma((a * b) * c, fine.real(term), total)
    return xp.real(total)


def _weighted(xp: Engine, kernel: Kernel, at: tuple[Array, Array, Array], alone: Array) -> list[tuple[Array, Array]]:
    """Return along an axis three samples, counted from a brick's first, and their weights in a coefficient.

    Beyond the lattice these continue its two last samples; inside they are the prefilter's, or the sample alone where
    others are `alone`.
    """
    place, origin, last = at
    outer, middle, _ = kernel.prefilter
    p = place + origin
    first = xp.maximum(xp.minimum(p - 1, last - 2 + place * 0), place * 0)
    low, high = p <= 0, p >= last
    below, above = xp.real(-p), xp.real(p - last)
    taps = []
    for step in range(3):
        sample = first + step
        inside = xp.where(
            sample == p, xp.where(alone, 1.0, xp.real(p * 0) + middle), _near(xp, sample - p, alone, outer)
        )
        up = xp.where(sample == last, 1.0 + above, xp.where(sample == last - 1, -above, 0.0))
        down = xp.where(sample == 0, 1.0 + below, xp.where(sample == 1, -below, 0.0))
        taps.append((sample - origin, xp.where(low, down, xp.where(high, up, inside))))
    return taps


def _near(xp: Engine, step: Array, alone: Array, outer: float) -> Array:
    """Return the weight of a tap beside the middle one; the third is that of a place at the lattice's end."""
    beside = ((step == 1) | (step == -1)) & ~alone
    return xp.where(beside, xp.real(step * 0) + outer, 0.0)
