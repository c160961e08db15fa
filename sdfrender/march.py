"""The walk of a ray through bricks and cells to its first hit.

In: rays in grid coordinates (a cell has side 1) and the tables of a grid field. Out: for every ray the cell of the
first hit and the place in it. A ray passes empty cubes of cells or of absent bricks in one step; in a cell that may
hold surface, its slab decides at a glance, else `sdfrender.cell`. No step length is guessed and no epsilon is tuned:
every step ends on a face of the cube that it leaves.
"""

from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.cell import Bracket, Polynomial, isolate, ray_polynomial, refine
from sdfrender.skips import MOST
from sdfrender.stride import (
    HIT,
    SOLVE,
    WALK,
    Ray,
    Walk,
    Way,
    behind,
    ends_in_cell,
    enter_box,
    in_lattice,
    leave_cube,
    moved_on,
    prepared,
    turned,
)
from sdfrender.tables import SHIFT, SIDE, Cell, Found, Tables, base_of, stencil, three
from sdfrender.vector import Vector, select


class _March(NamedTuple):
    """State of a ray: where it is and, once it has hit, the polynomial there and the bracket of the root."""

    walk: Walk
    bracket: Bracket
    polynomial: Polynomial


class Leaving(NamedTuple):
    """The places on the surface that rays leave, and which rays do."""

    active: Array
    cell: Cell


def march(xp: Engine, tables: Tables, p: Vector, d: Vector, active: Array, start: Leaving | None = None) -> Found:
    """Find first hits.

    Parameters
    ----------
    xp
        The engine.
    tables
        The grid.
    p, d
        Origins and directions, grid coordinates; t is in units of the direction's length.
    active
        Rays that ask; the others miss.
    start
        The places that rays leave, where they start on the surface: there the interpolant's residue is subtracted
        from the first cell's polynomial, so that the known root is at s = 0 exactly and is not met again.
    """
    ray, end = _walked(xp, tables, p, d, active, start, xp.full(p[0], float("inf")))
    hit, nothing = end.walk.status == HIT, xp.full(p[0], 0.0)
    found = Found(hit, nothing, turned(xp, tables, ray, end.walk.cell), (nothing, nothing, nothing), xp.full(p[0], 0))

    def place(state: tuple[Found, Ray, _March]) -> tuple[Found, Ray, _March]:
        found, ray, end = state
        s = refine(xp, end.polynomial, end.bracket)
        way = leave_cube(xp, ray, end.walk.t, end.walk.cell, behind(end.walk.cell))
        enter, leave = ends_in_cell(xp, ray, end.walk, way)
        u = in_lattice(xp, ray, three(xp.fma(leave[a] - enter[a], s, enter[a]) for a in range(3)))
        t = xp.fma(way.t - end.walk.t, s, end.walk.t)
        base = base_of(xp, tables, found.cell, found.hit)
        return found._replace(t=t, u=u, base=base), ray, end

    return xp.among(hit, place, (found, ray, end))[0]


def meets(
    xp: Engine, tables: Tables, p: Vector, d: Vector, active: Array, start: Leaving | None, until: Array
) -> Array:
    """Say which rays meet something before a parameter: `march` that goes no further than it has to.

    Only a root in the cell in which the ray ends needs to be known to the last digit.
    """
    ray, end = _walked(xp, tables, p, d, active, start, until)
    way = leave_cube(xp, ray, end.walk.t, end.walk.cell, behind(end.walk.cell))
    whole = way.t < until
    s = refine(xp, end.polynomial, end.bracket._replace(found=end.bracket.found & ~whole))
    hit = end.walk.status == HIT
    return hit & (whole | (xp.fma(way.t - end.walk.t, s, end.walk.t) < until))


def _walked(
    xp: Engine, tables: Tables, p: Vector, d: Vector, active: Array, start: Leaving | None, until: Array
) -> tuple[Ray, _March]:
    """Walk to the first cell with a root on the ray's way, or out of the lattice, or to the ray's end."""
    nothing, nobody = xp.full(p[0], 0.0), xp.full(p[0], False)
    t, cell, inside = enter_box(xp, tables, p, d)
    leaving = nobody
    if start is not None:
        leaving = start.active
        t, cell = xp.where(leaving, 0.0, t), select(xp, leaving, start.cell, cell)
        inside = inside | leaving
    ray = prepared(xp, tables, p, d, leaving, until)
    asks = active & inside & (t < until)
    walk = Walk(xp.integer(asks) * WALK, t, turned(xp, tables, ray, cell), (nobody, nobody, nobody), nothing)
    polynomial = tuple(nothing for _ in range(3 * tables.kernel.degree + 1))
    state = _March(walk, Bracket(nobody, nothing, nothing, nothing), polynomial)

    def advance(state: _March, ray: Ray) -> _March:
        return _solve(xp, tables, state._replace(walk=_pass_empty(xp, tables, state.walk, ray)), ray)

    return ray, xp.while_loop(lambda s: (s.walk.status == WALK) | (s.walk.status == SOLVE), advance, state, ray)


class _Slab(NamedTuple):
    """A ray in a cell: whether the cell must be solved, the sign after it, and what tells where it is occupied."""

    stay: Array
    sign: Array
    occupied: Array
    number: Array
    walk: Walk
    way: Way
    ray: Ray


def _pass_empty(xp: Engine, tables: Tables, walk: Walk, ray: Ray) -> Walk:
    """Walk on until a cell whose slab the ray does not stay clear of, or out of the lattice."""

    def step(walk: Walk, ray: Ray) -> Walk:
        brick = tuple(c >> SHIFT for c in walk.cell)
        slot = xp.gather(
            tables.slots,
            ray.corner + ray.step[0] * brick[0] + ray.step[1] * brick[1] + ray.step[2] * brick[2],
            walk.status == WALK,
        )
        present = slot >= 0
        a, b, c = (c & (SIDE - 1) for c in walk.cell)
        local = ((((a << SHIFT) | b) << SHIFT) | c) ^ ray.flip
        value = xp.gather(tables.cells, (slot << (3 * SHIFT)) + local, present)
        occupied = present & (value < 0)
        side = xp.where(occupied, 1, (xp.where(present, value, -1 - slot) >> ray.field) & MOST)
        ends = tuple(xp.where(present, walk.cell[a] + side, (brick[a] + side) << SHIFT) for a in range(3))
        way = leave_cube(xp, ray, walk.t, walk.cell, ends)
        slab = _Slab(xp.full(walk.t, False), walk.sign, occupied, -1 - value, walk, way, ray)
        stay, sign, *_ = xp.among(occupied, look, slab)
        moved = moved_on(xp, ray, way, sign)
        return Walk(
            xp.where(stay, SOLVE, moved.status),
            xp.where(stay, walk.t, moved.t),
            select(xp, stay, walk.cell, moved.cell),
            select(xp, stay, walk.came, moved.came),
            sign,
        )

    def look(slab: _Slab) -> _Slab:
        return _compared(xp, tables, slab)

    return xp.while_loop(lambda w: w.status == WALK, step, walk, ray)


def _compared(xp: Engine, tables: Tables, slab: _Slab) -> _Slab:
    """Hold a ray's ends in a cell against its slab."""
    walk, ray = slab.walk, slab.ray
    enter, leave = ends_in_cell(xp, ray, walk, slab.way)
    c, *g = xp.rows(tables.planes, slab.number, slab.occupied)
    plane = (c, *(xp.where(ray.falls[a], -g[a], g[a]) for a in range(3)))
    delta = xp.gather(tables.deltas, slab.number, slab.occupied)
    first, last = _height(xp, plane, enter), _height(xp, plane, leave)
    above, below = (first > delta) & (last > delta), (first < -delta) & (last < -delta)
    clear = (above & (walk.sign >= 0)) | (below & (walk.sign <= 0))
    stay = ~clear | (ray.leaving & (walk.t == 0))
    sign = xp.where(stay, walk.sign, xp.where(above, 1.0, -1.0))
    return slab._replace(stay=stay, sign=sign)


def _height(xp: Engine, plane: tuple[Array, ...], u: Vector) -> Array:
    """Return c + g . (u - 1/2)."""
    c, x, y, z = plane
    return xp.fma(x, u[0] - 0.5, xp.fma(y, u[1] - 0.5, xp.fma(z, u[2] - 0.5, c)))


def _solve(xp: Engine, tables: Tables, state: _March, ray: Ray) -> _March:
    """Decide a cell that may hold surface: a hit, or on to the next cell."""
    walk = state.walk
    asked = walk.status == SOLVE
    way = leave_cube(xp, ray, walk.t, walk.cell, behind(walk.cell))
    enter, leave = (in_lattice(xp, ray, u) for u in ends_in_cell(xp, ray, walk, way))
    base = base_of(xp, tables, turned(xp, tables, ray, walk.cell), asked)
    taps, bound = stencil(xp, tables, base, asked), xp.gather(tables.bounds, base // tables.width**3, asked)
    polynomial = ray_polynomial(xp, tables.kernel, taps, enter, leave)
    residue = xp.where(ray.leaving & (walk.t == 0), polynomial[0], 0.0)
    polynomial = tuple(b - residue for b in polynomial)
    bracket, sign = isolate(xp, polynomial, walk.sign, bound, asked)
    hit = bracket.found & asked
    go_on = asked & ~hit
    moved = moved_on(xp, ray, way, sign)

    def settled(new: tuple[Array, ...], old: tuple[Array, ...]) -> tuple[Array, ...]:
        return tuple(xp.where(hit, a, b) for a, b in zip(new, old, strict=True))

    return _March(
        Walk(
            xp.where(hit, HIT, xp.where(go_on, moved.status, walk.status)),
            xp.where(go_on, moved.t, walk.t),
            select(xp, go_on, moved.cell, walk.cell),
            select(xp, go_on, moved.came, walk.came),
            xp.where(go_on, sign, walk.sign),
        ),
        Bracket(*settled(bracket, state.bracket)),
        settled(polynomial, state.polynomial),
    )
