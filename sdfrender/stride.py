"""A ray's steps through cubes of cells, from face to face.

In: a ray in grid coordinates and a cube of cells that begins where the ray is. Out: the face on which it leaves, the
cell behind it, and where in a cell the ray enters and leaves.

Cells are counted along the ray: where a direction falls, from the far end of the lattice's bricks. So every ray goes
up on every axis, and a cube ahead always begins at the cell and ends before another.
"""

from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.skips import FIELD
from sdfrender.tables import SHIFT, SIDE, Cell, Tables, cell_of, clamp, three
from sdfrender.vector import Vector

DONE, WALK, SOLVE, HIT = 0, 1, 2, 3


class Ray(NamedTuple):
    """What does not change along a ray; cells are counted along it.

    Attributes
    ----------
    p, d, inverse
        Origin, direction and 1 / d.
    parallel
        Masks: d is 0 on the axis, or so small that 1 / d overflows.
    turn, first
        A coordinate x is at first + turn * x along the ray; turn is 1 or -1.
    top
        Last cell of the lattice on every axis.
    step, corner, flip
        Where a brick is in the table, corner + step . brick; and what turns a cell's number in its brick.
    field
        Bit where the ray's octant begins in packed sides.
    leaving
        Mask: starts on the surface.
    """

    p: Vector
    d: Vector
    inverse: Vector
    parallel: Vector
    turn: Vector
    first: Vector
    top: Cell
    step: Cell
    corner: Array
    flip: Array
    field: Array
    leaving: Array


class Walk(NamedTuple):
    """Where a ray is: the cell it is in, and through which faces it came (bits 0, 1, 2 for x, y, z).

    The sign is that of the interpolant where it was last certain; 0 before.
    """

    status: Array
    t: Array
    cell: Cell
    came: Array
    sign: Array


class Way(NamedTuple):
    """The way through a cube: the parameter where it ends, the cell behind, and through which faces."""

    t: Array
    cell: Cell
    exits: Vector


def enter_box(xp: Engine, tables: Tables, p: Vector, d: Vector) -> tuple[Array, Cell, Array]:
    """Clip rays to the lattice: parameter and cell where a ray enters, and whether it does.

    A ray along a face of the box is inside; one that starts inside enters at t = 0.
    """
    first, last = xp.full(p[0], 0.0), xp.full(p[0], float("inf"))
    inside = xp.full(p[0], True)
    for axis in range(3):
        top = xp.real(tables.samples[axis] - 1)
        parallel = _is_parallel(xp, d[axis])
        inside = inside & (~parallel | ((p[axis] >= 0) & (p[axis] <= top)))
        inverse = 1.0 / xp.where(parallel, 1.0, d[axis])
        a, b = -p[axis] * inverse, (top - p[axis]) * inverse
        first = xp.where(parallel, first, xp.maximum(first, xp.minimum(a, b)))
        last = xp.where(parallel, last, xp.minimum(last, xp.maximum(a, b)))
    inside = inside & (first <= last)
    t = xp.where(inside, first, 0.0)
    return t, cell_of(xp, tables, (p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2])), inside


def _is_parallel(xp: Engine, d: Array) -> Array:
    return xp.abs(d) < (2.0**-126 if xp.precision == 32 else 2.0**-1022)


def prepared(xp: Engine, tables: Tables, p: Vector, d: Vector, leaving: Array) -> Ray:
    """Prepare a ray."""
    axes, bricks = range(3), tables.bricks
    falls, parallel = [xp.integer(c < 0) for c in d], three(_is_parallel(xp, c) for c in d)
    strides = (bricks[1] * bricks[2], bricks[2], 1)
    corner, flip, octant = (xp.full(p[0], 0) for _ in axes)
    for a in axes:
        corner = corner + falls[a] * ((bricks[a] - 1) * strides[a])
        flip = flip | (falls[a] * ((SIDE - 1) << (SHIFT * (2 - a))))
        octant = octant | (falls[a] << a)
    last = [n - 2 for n in tables.samples]
    return Ray(
        p,
        d,
        three(1.0 / xp.where(parallel[a], 1.0, d[a]) for a in axes),
        parallel,
        three(1.0 - 2.0 * xp.real(falls[a]) for a in axes),
        three(xp.real(falls[a] * (bricks[a] << SHIFT)) for a in axes),
        three(falls[a] * ((bricks[a] << SHIFT) - 1 - last[a]) + last[a] for a in axes),
        three((1 - 2 * falls[a]) * strides[a] for a in axes),
        corner,
        flip,
        octant * FIELD,
        leaving,
    )


def turned(xp: Engine, ray: Ray, cell: Cell) -> Cell:
    """Turn cells of the lattice into cells along the ray, or back."""
    return three(xp.where(ray.turn[a] < 0, xp.integer(ray.first[a]) - 1 - cell[a], cell[a]) for a in range(3))


def behind(cell: Cell) -> Cell:
    """Return the cell diagonally behind: where a cube of this one alone ends."""
    return cell[0] + 1, cell[1] + 1, cell[2] + 1


def leave_cube(xp: Engine, ray: Ray, t: Array, cell: Cell, end: tuple[Array, ...]) -> Way:
    """Leave a cube that begins at a cell and ends before others, all counted along the ray.

    Always advances at least one cell along the axes of the faces and never moves back along another, so that the walk
    ends whatever the rounding; nor does it leave the lattice but through a face.
    """
    end = tuple(xp.minimum(end[a], ray.top[a] + 1) for a in range(3))
    crossing = []
    for a in range(3):
        plane = xp.fma(ray.turn[a], xp.real(end[a]), ray.first[a])
        crossing.append(xp.where(ray.parallel[a], float("inf"), (plane - ray.p[a]) * ray.inverse[a]))
    first = xp.minimum(xp.minimum(crossing[0], crossing[1]), crossing[2])
    after = xp.maximum(first, t)
    by_x, by_y = crossing[0] <= first, crossing[1] <= first
    # Through some face, even if a direction is not a number.
    exits = (by_x, by_y, (crossing[2] <= first) | ~(by_x | by_y))
    following = []
    for a in range(3):
        place = xp.fma(ray.turn[a], xp.fma(ray.d[a], after, ray.p[a]), ray.first[a])
        at = clamp(xp, xp.integer(place), cell[a], end[a] - 1)
        following.append(xp.where(exits[a], end[a], at))
    return Way(after, three(following), exits)


def ends_in_cell(xp: Engine, ray: Ray, walk: Walk, way: Way) -> tuple[Vector, Vector]:
    """Return where a ray enters and leaves its cell, in the cell's coordinates.

    On the faces that it passes these are 0 or 1 exactly, so that no root is lost between a cell and an empty one.
    """
    enter, leave = [], []
    for a in range(3):
        # By the cell's middle, which does not depend on which way the cells are counted.
        low = xp.fma(ray.turn[a], xp.real(walk.cell[a]) + 0.5, ray.first[a]) - 0.5
        anchored, half = ray.p[a] - low, 0.5 * ray.turn[a]
        begin, end = xp.fma(ray.d[a], walk.t, anchored), xp.fma(ray.d[a], way.t, anchored)
        enter.append(xp.where((walk.came & (1 << a)) != 0, 0.5 - half, clamp(xp, begin, 0.0, 1.0)))
        leave.append(xp.where(way.exits[a], 0.5 + half, clamp(xp, end, 0.0, 1.0)))
    return three(enter), three(leave)


def moved_on(xp: Engine, ray: Ray, way: Way, sign: Array) -> Walk:
    """Go on behind a cube, if the lattice does."""
    x, y, z = way.cell
    inside = (x <= ray.top[0]) & (y <= ray.top[1]) & (z <= ray.top[2])
    by_x, by_y, by_z = (xp.integer(exits) for exits in way.exits)
    came = by_x | (by_y << 1) | (by_z << 2)
    return Walk(xp.integer(inside) * WALK, way.t, way.cell, came, sign)
