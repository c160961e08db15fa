"""A ray's steps through cubes of cells, from face to face.

In: a ray in grid coordinates and a cube of cells that begins where the ray is. Out: the face on which it leaves, the
cell behind it, and where in a cell the ray enters and leaves.

All is counted along the ray: where a direction falls, coordinates and cells begin at the far end of the lattice's
bricks. So every ray goes up on every axis, a cube ahead always begins at the cell and ends before another, and a cell
is entered at 0 and left at 1.
"""

from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.skips import FIELD
from sdfrender.tables import SHIFT, SIDE, Cell, Tables, cell_of, clamp, three
from sdfrender.vector import Vector

DONE, WALK, SOLVE, HIT = 0, 1, 2, 3


class Ray(NamedTuple):
    """What does not change along a ray, counted along it.

    Attributes
    ----------
    p, d
        Origin and direction; no component of the latter is negative.
    inverse, offset
        The plane x is crossed at inverse * x + offset: 1 / d and -p / d. Where d is 0, or so small that 1 / d
        overflows, 0 and infinity.
    falls
        Masks: on these axes coordinates are counted from the far end.
    end
        The cell behind the last of the lattice on every axis.
    step, corner, flip
        Where a brick is in the table, corner + step . brick; and what turns a cell's number in its brick.
    field
        Bit where the ray's octant begins in packed sides.
    leaving
        Mask: starts on the surface.
    until
        The parameter where the ray ends.
    """

    p: Vector
    d: Vector
    inverse: Vector
    offset: Vector
    falls: Vector
    end: Cell
    step: Cell
    corner: Array
    flip: Array
    field: Array
    leaving: Array
    until: Array


class Walk(NamedTuple):
    """Where a ray is: the cell it is in, and masks: through which of its faces it came.

    The sign is that of the interpolant where it was last certain; 0 before.
    """

    status: Array
    t: Array
    cell: Cell
    came: Vector
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


def prepared(xp: Engine, tables: Tables, p: Vector, d: Vector, leaving: Array, until: Array) -> Ray:
    """Prepare a ray."""
    axes, bricks = range(3), tables.bricks
    falls, parallel = three(c < 0 for c in d), three(_is_parallel(xp, c) for c in d)
    down = [xp.integer(mask) for mask in falls]
    strides = (bricks[1] * bricks[2], bricks[2], 1)
    corner, flip, octant = (xp.full(p[0], 0) for _ in axes)
    for a in axes:
        corner = corner + down[a] * ((bricks[a] - 1) * strides[a])
        flip = flip | (down[a] * ((SIDE - 1) << (SHIFT * (2 - a))))
        octant = octant | (down[a] << a)
    last = [n - 2 for n in tables.samples]
    along = three(xp.where(falls[a], xp.real(bricks[a] << SHIFT) - p[a], p[a]) for a in axes)
    size = three(xp.abs(c) for c in d)
    inverse = three(xp.where(parallel[a], 0.0, 1.0 / xp.where(parallel[a], 1.0, size[a])) for a in axes)
    return Ray(
        along,
        size,
        inverse,
        three(xp.where(parallel[a], float("inf"), -along[a] * inverse[a]) for a in axes),
        falls,
        three(down[a] * ((bricks[a] << SHIFT) - 1 - last[a]) + last[a] + 1 for a in axes),
        three((1 - 2 * down[a]) * strides[a] for a in axes),
        corner,
        flip,
        octant * FIELD,
        leaving,
        until,
    )


def turned(xp: Engine, tables: Tables, ray: Ray, cell: Cell) -> Cell:
    """Turn cells of the lattice into cells along the ray, or back."""
    return three(xp.where(ray.falls[a], (tables.bricks[a] << SHIFT) - 1 - cell[a], cell[a]) for a in range(3))


def behind(cell: Cell) -> Cell:
    """Return the cell diagonally behind: where a cube of this one alone ends."""
    return cell[0] + 1, cell[1] + 1, cell[2] + 1


def leave_cube(xp: Engine, ray: Ray, t: Array, cell: Cell, end: tuple[Array, ...]) -> Way:
    """Leave a cube that begins at a cell and ends before others.

    Always advances at least one cell along the axes of the faces and never moves back along another, so that the walk
    ends whatever the rounding; nor does it leave the lattice but through a face.
    """
    end = tuple(xp.least((end[a], ray.end[a])) for a in range(3))
    crossing = [xp.fma(xp.real(end[a]), ray.inverse[a], ray.offset[a]) for a in range(3)]
    first = xp.least(crossing)
    after = xp.most((first, t))
    by_x, by_y = crossing[0] <= first, crossing[1] <= first
    # Through some face, even if a direction is not a number.
    exits = (by_x, by_y, (crossing[2] <= first) | ~(by_x | by_y))
    following = []
    for a in range(3):
        at = clamp(xp, xp.integer(xp.fma(ray.d[a], after, ray.p[a])), cell[a], end[a] - 1)
        following.append(xp.where(exits[a], end[a], at))
    return Way(after, three(following), exits)


def ends_in_cell(xp: Engine, ray: Ray, walk: Walk, way: Way) -> tuple[Vector, Vector]:
    """Return where a ray enters and leaves its cell, 0 to 1 along the ray.

    On the faces that it passes these are 0 or 1 exactly, so that no root is lost between a cell and an empty one.
    """
    enter, leave = [], []
    for a in range(3):
        anchored = ray.p[a] - xp.real(walk.cell[a])
        begin, end = xp.fma(ray.d[a], walk.t, anchored), xp.fma(ray.d[a], way.t, anchored)
        enter.append(xp.where(walk.came[a], 0.0, clamp(xp, begin, 0.0, 1.0)))
        leave.append(xp.where(way.exits[a], 1.0, clamp(xp, end, 0.0, 1.0)))
    return three(enter), three(leave)


def in_lattice(xp: Engine, ray: Ray, u: Vector) -> Vector:
    """Turn places in a cell along the ray into those along the lattice's axes."""
    return three(xp.where(ray.falls[a], 1.0 - u[a], u[a]) for a in range(3))


def moved_on(xp: Engine, ray: Ray, way: Way, sign: Array) -> Walk:
    """Go on behind a cube, if the lattice and the ray do."""
    x, y, z = way.cell
    inside = (way.t < ray.until) & (x < ray.end[0]) & (y < ray.end[1]) & (z < ray.end[2])
    return Walk(xp.integer(inside) * WALK, way.t, way.cell, way.exits, sign)
