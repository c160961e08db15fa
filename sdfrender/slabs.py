"""Cells that may hold surface, and between which two planes the interpolant stays there.

In: the coefficients of every brick. Out: the occupied cells, and a slab for each: on the cell, f lies in
c + g . (x - 1/2) +- delta. The interpolant minus an affine function lies in the hull of its Bezier net minus that
function's values at the Greville points (r/d, s/d, t/d), because Bernstein polynomials reproduce affine functions.

A ray whose two ends in a cell are beyond the same plane does not meet the surface there, and needs no polynomial.
"""

from functools import reduce
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sdfbake.bricks import SIDE
from sdfbake.engine import Array, Engine
from sdfrender.kernels import Kernel
from sdfrender.stencils import Blocks, Stencils, brick_row, coefficient, in_lattice, lost, width

_SINGLE = float(np.finfo(np.float32).eps)
_UP = 1 + 8 * _SINGLE  # more than what turning a bound into single precision, and adding to it, takes off

Cube = dict[tuple[int, ...], Array]  # entries by their place along x, y, z


class Slabs(NamedTuple):
    """The cells that may hold surface; everywhere else |f| > margin, by certificate.

    Attributes
    ----------
    size
        How many there are; the arrays have an entry all the same if there are none.
    cell
        Numbers of the cells among those of all bricks, 512 slot + 64 i + 8 j + k, ascending.
    plane
        Rows of four: c, g per cell; g per voxel; single precision, as delta.
    delta
        Half the slab's width, with the rounding of all that computes and reads the slab.
    largest
        Per brick, on the host: greatest sum of |weight x coefficient| behind a control point of its cells' nets; 0
        where it has none of these cells.
    """

    size: int
    cell: Array
    plane: Array
    delta: Array
    largest: Float[np.ndarray, " k"]


def slabs(
    xp: Engine,
    made: Stencils,
    blocks: Blocks,
    kernel: Kernel,
    reach: Float[np.ndarray, " k"],
    least: Float[np.ndarray, " k"],
) -> Slabs:
    """Find the cells that may hold surface.

    The nets are computed in single precision whatever traces: their rounding widens the slabs by a millionth. What is
    found in a brick depends on the bricks around it alone: it is the same where others were not loaded.

    Parameters
    ----------
    xp
        The engine.
    made, blocks
        Coefficients of every brick.
    kernel
        The kernel.
    reach, least
        Per brick: bound of the coefficients of its cells, and the least |f| of a cell that is empty.
    """
    least = least * _UP
    asked = _asked(xp, made, blocks, kernel, (least, reach))
    count = len(asked)
    if count == 0:
        return _nothing(xp, blocks.size)
    margins = xp.at(32).table(least)
    plane, delta, behind, may = xp.tabulated(
        count, lambda lane: _slab(xp, made, kernel, xp.gather(asked, lane, True), margins)
    )
    kept = xp.kept(may)
    if len(kept) == 0:
        return _nothing(xp, blocks.size)

    def chosen(lane: Array) -> tuple[tuple[Array, ...], ...]:
        number = xp.gather(kept, lane, True)
        row = xp.at(32).rows(plane, number, True)
        return (
            (xp.gather(asked, number, True),),
            row,
            (xp.gather(delta, number, True),),
            (xp.gather(behind, number, True),),
        )

    cell, plane, delta, behind = xp.tabulated(len(kept), chosen)
    return Slabs(len(kept), cell, plane, delta, _greatest(np.array(cell) >> 9, np.array(behind), blocks.size))


def _greatest(
    brick: Int[np.ndarray, " n"], behind: Float[np.ndarray, " n"], count: int
) -> Float[np.ndarray, " {count}"]:
    """Return the greatest number of every brick, those of one following each other; 0 where there is none."""
    largest, first = np.zeros(count), np.flatnonzero(np.diff(brick, prepend=-1))
    largest[brick[first]] = np.maximum.reduceat(behind, first)
    return largest * (1 + 32 * _SINGLE)


def _nothing(xp: Engine, bricks: int) -> Slabs:
    """Return no slabs; no engine likes an empty table."""
    single = xp.at(32)
    blank = single.table(np.zeros(1))
    return Slabs(0, xp.table(np.zeros(1, np.int32)), single.table(np.zeros(4)), blank, np.zeros(bricks))


def greatest_row(kernel: Kernel) -> float:
    """Return the greatest sum of |weight| behind a control point of one axis."""
    return float(np.abs(kernel.bezier).sum(axis=1).max())


def _asked(xp: Engine, made: Stencils, blocks: Blocks, kernel: Kernel, bounds: tuple[np.ndarray, np.ndarray]) -> Array:
    """Return the cells that a look at the planes across x does not show to be empty: |f| > least.

    On a plane of coefficients f lies in the hull of its net along y and z. If no weight is negative, on the cell it
    lies in that of all its planes. If some are, it lies in that of the inner two, wider by a multiple of the greatest
    difference of neighbours.
    """
    (least, reach), growth, count = bounds, greatest_row(kernel), blocks.size
    planes, bound = range(kernel.taps), least + 32 * _SINGLE * growth**2 * reach
    if growth > 1 + 1e-12:
        planes = range(kernel.taps // 2 - 1, kernel.taps // 2 + 1)
        bound = bound + _overshoot(kernel) * growth**2 * _steepest(xp, blocks, made, kernel)
    limits, size = xp.at(32).table(bound * _UP), width(kernel)

    (words,) = xp.tabulated(count * size * SIDE, lambda lane: ((_beyond(xp, made, kernel, lane, limits),),))

    def near(lane: Array) -> tuple[tuple[Array]]:
        brick, x, y = brick_row(lane)
        row = ((brick * size + x) << 3) | y
        beyond = reduce(lambda a, b: a & b, [xp.gather(words, row + (i << 3), True) for i in planes])
        return ((~(beyond | (beyond >> SIDE)) & xp.gather(made.complete, lane, True),),)

    (rows,) = xp.tabulated(count * SIDE**2, near)
    (mask,) = xp.tabulated(
        count * SIDE**3, lambda lane: ((((xp.gather(rows, lane >> 3, True) >> (lane & 7)) & 1) > 0,),)
    )
    return xp.kept(mask)


def _beyond(xp: Engine, made: Stencils, kernel: Kernel, lane: Array, limits: Array) -> Array:
    """Return of which cells of a row, in a plane across x, the net is above the limit (bits 0 to 7) or below (8 to 15).

    The lane is the brick, the plane, and the cells' place along y.
    """
    size, single = width(kernel), xp.at(32)
    first = (lane >> 3) * size**2 + (lane & 7) * size
    limit = xp.gather(limits, lane // (size * SIDE), True)
    values: Cube = {
        (y, z): single.real(xp.gather(made.coefficients, first + (y * size + z), True))
        for y, z in product(range(kernel.taps), range(size))
    }
    along_y = _converted(single, values, kernel.bezier)  # places are (z, r)
    word = xp.full(lane, 0)
    for z in range(SIDE):
        taps: Cube = {(tap, r): along_y[z + tap, r] for tap, r in product(range(kernel.taps), range(kernel.degree + 1))}
        net = [*_converted(single, taps, kernel.bezier).values()]
        word = word | (xp.integer(single.least(net) > limit) << z)
        word = word | (xp.integer(single.most(net) < -limit) << (z + SIDE))
    return word


def _overshoot(kernel: Kernel) -> float:
    """Bound how far the control points of one axis leave the hull of its inner two taps, over the greatest difference.

    A row of the Bezier form is the linear interpolant at its Greville point and a sum of differences of neighbours.
    """
    lower, degree = kernel.taps // 2 - 1, kernel.degree
    rows = kernel.bezier.copy()
    place = np.arange(degree + 1) / degree
    rows[:, lower] -= 1 - place
    rows[:, lower + 1] -= place
    return float(np.abs(np.cumsum(rows, axis=1)).sum(axis=1).max())


def _steepest(xp: Engine, blocks: Blocks, made: Stencils, kernel: Kernel) -> Float[np.ndarray, " k"]:
    """Return per brick the greatest difference, along x, of neighbouring coefficients that are made of samples."""
    size = width(kernel)

    def step(lane: Array) -> tuple[tuple[Array]]:
        brick, (x, y, z) = coefficient(lane, kernel)
        known = x < kernel.first + size - 1
        for axis, p in enumerate((x, y, z)):  # a cell reads one coefficient beyond the lattice, and none farther
            known = known & (xp.gather(blocks.first[axis], brick, True) + p <= blocks.samples[axis])
        for at in (x, x + 1):
            row_x, row_y, row_z = in_lattice(xp, blocks, brick, (at, y, z))
            known = known & ~lost(xp, blocks, kernel, brick, (row_x, row_y))(row_z)
        here, there = xp.gather(made.coefficients, lane, True), xp.gather(made.coefficients, lane + size**2, known)
        return ((xp.where(known, xp.abs(there - here), 0.0),),)

    (steps,) = xp.tabulated(blocks.size * size**3, step)
    greatest: Float[np.ndarray, " k"] = np.array(steps).reshape(blocks.size, -1).max(axis=1).astype(np.float64)
    return greatest


def _slab(
    xp: Engine, made: Stencils, kernel: Kernel, cell: Array, margins: Array
) -> tuple[tuple[Array, Array, Array, Array], tuple[Array], tuple[Array], tuple[Array]]:
    """Fit a slab: the middle of the residual's range, the slope, and what is left; and say whether it comes near 0.

    The third result is the greatest sum of magnitudes behind a control point.
    """
    single, terms = xp.at(32), range(kernel.degree + 1)
    least = xp.gather(margins, cell >> 9, True)
    taps = _taps(xp, made, kernel, cell)
    net = _net(single, taps, kernel.bezier)
    slope = [_slope(net, axis, len(terms)) for axis in range(3)]
    along = [[g * (r / kernel.degree - 0.5) for r in terms] for g in slope]
    rest = [(net[r, s, t] - (along[0][r] + along[1][s])) - along[2][t] for r, s, t in product(terms, repeat=3)]
    low, high = single.least(rest), single.most(rest)
    middle, steep = (low + high) * 0.5, reduce(lambda a, b: a + b, [single.abs(g) for g in slope])
    sizes = {place: single.abs(tap) for place, tap in taps.items()}
    # Over twice what rounds (docs/tracing.md), and what an engine of either precision rounds where it reads the slab.
    rounding = single.most([*sizes.values()]) * (64 * _SINGLE * greatest_row(kernel) ** 3)
    delta = (high - low) * 0.5 + rounding + (single.abs(middle) + steep) * (4 * _SINGLE)
    behind = single.most([*_net(single, sizes, np.abs(kernel.bezier)).values()])
    # The corners of the cell are half a voxel from its centre along every axis.
    may = single.abs(middle) <= steep * 0.5 + delta + least
    within = least + rounding
    may = may & (single.least([*net.values()]) <= within) & (single.most([*net.values()]) >= -within)
    return (middle, slope[0], slope[1], slope[2]), (delta,), (behind,), (may,)


def _taps(xp: Engine, made: Stencils, kernel: Kernel, cell: Array) -> Cube:
    """Look up the coefficients of a cell, in single precision."""
    size = width(kernel)
    brick, x, y = brick_row(cell >> 3)
    base = ((brick * size + x) * size + y) * size + (cell & 7)
    return {
        (i, j, k): xp.at(32).real(xp.gather(made.coefficients, base + ((i * size + j) * size + k), True))
        for i, j, k in product(range(kernel.taps), repeat=3)
    }


def _net(xp: Engine, values: Cube, basis: Float[np.ndarray, "terms taps"]) -> Cube:
    """Turn coefficients into control points, one axis after the other."""
    for _ in range(3):
        values = _converted(xp, values, basis)
    return values


def _converted(xp: Engine, values: Cube, basis: Float[np.ndarray, "terms taps"]) -> Cube:
    """Turn the first axis into Bezier form, and make it the last."""
    rows = [[(tap, float(w)) for tap, w in enumerate(row) if abs(w) > 1e-15] for row in basis]  # not what rounding left
    return {
        (*other, r): _combined(xp, [(values[tap, *other], w) for tap, w in row])
        for other in dict.fromkeys(place[1:] for place in values)
        for r, row in enumerate(rows)
    }


def _combined(xp: Engine, terms: list[tuple[Array, float]]) -> Array:
    first, weight = terms[0]
    total = first if weight == 1 else first * weight
    for value, weight in terms[1:]:
        total = xp.fma(value, weight, total)
    return total


def _slope(net: Cube, axis: int, terms: int) -> Array:
    """Return the mean difference of the net's opposite faces."""
    near, far = (
        reduce(
            lambda a, b: a + b, [net[(*place[:axis], end, *place[axis:])] for place in product(range(terms), repeat=2)]
        )
        for end in (0, terms - 1)
    )
    return (far - near) * (1 / terms**2)
