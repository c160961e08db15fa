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
    behind,
    ends_in_cell,
    enter_box,
    leave_cube,
    moved_on,
    prepared,
    turned,
)
from sdfrender.tables import SHIFT, SIDE, Found, Tables, base_of, stencil, three
from sdfrender.vector import Vector, select


class _March(NamedTuple):
    """State of a ray: where it is and, once it has hit, the polynomial there and the bracket of the root."""

    walk: Walk
    bracket: Bracket
    polynomial: Polynomial


def march(xp: Engine, tables: Tables, p: Vector, d: Vector, active: Array, start: Found | None = None) -> Found:
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
    nothing, nobody = xp.full(p[0], 0.0), xp.full(p[0], False)
    if start is None:
        t, cell, inside = enter_box(xp, tables, p, d)
        active, leaving = active & inside, nobody
    else:
        t, cell, leaving = nothing, start.cell, active & start.hit
        active = leaving
    ray = prepared(xp, tables, p, d, leaving)
    walk = Walk(xp.integer(active) * WALK, t, turned(xp, ray, cell), xp.full(p[0], 0), nothing)
    polynomial = tuple(nothing for _ in range(3 * tables.kernel.degree + 1))
    state = _March(walk, Bracket(nobody, nothing, nothing, nothing), polynomial)

    def advance(state: _March, ray: Ray) -> _March:
        return _solve(xp, tables, state._replace(walk=_pass_empty(xp, tables, state.walk, ray)), ray)

    end = xp.while_loop(lambda s: (s.walk.status == WALK) | (s.walk.status == SOLVE), advance, state, ray)
    s = refine(xp, end.polynomial, end.bracket)
    way = leave_cube(xp, ray, end.walk.t, end.walk.cell, behind(end.walk.cell))
    enter, leave = ends_in_cell(xp, ray, end.walk, way)
    u = three(xp.fma(leave[a] - enter[a], s, enter[a]) for a in range(3))
    hit = end.walk.status == HIT
    t = xp.where(hit, xp.fma(way.t - end.walk.t, s, end.walk.t), 0.0)
    cell = turned(xp, ray, end.walk.cell)
    return Found(hit, t, cell, u, base_of(xp, tables, cell, hit))


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
        enter, leave = ends_in_cell(xp, ray, walk, way)
        plane = xp.rows(tables.planes, -1 - value, occupied)
        delta = xp.gather(tables.deltas, -1 - value, occupied)
        first, last = _height(xp, plane, enter), _height(xp, plane, leave)
        above, below = xp.minimum(first, last) > delta, xp.maximum(first, last) < -delta
        clear = (above & (walk.sign >= 0)) | (below & (walk.sign <= 0))
        stay = occupied & (~clear | (ray.leaving & (walk.t == 0)))
        passed = occupied & ~stay
        sign = xp.where(passed & above, 1.0, xp.where(passed & below, -1.0, walk.sign))
        moved = moved_on(xp, ray, way, sign)
        return Walk(
            xp.where(stay, SOLVE, moved.status),
            xp.where(stay, walk.t, moved.t),
            select(xp, stay, walk.cell, moved.cell),
            xp.where(stay, walk.came, moved.came),
            sign,
        )

    return xp.while_loop(lambda w: w.status == WALK, step, walk, ray)


def _height(xp: Engine, plane: tuple[Array, Array, Array, Array], u: Vector) -> Array:
    """Return c + g . (u - 1/2)."""
    c, x, y, z = plane
    return xp.fma(x, u[0] - 0.5, xp.fma(y, u[1] - 0.5, xp.fma(z, u[2] - 0.5, c)))


def _solve(xp: Engine, tables: Tables, state: _March, ray: Ray) -> _March:
    """Decide a cell that may hold surface: a hit, or on to the next cell."""
    walk = state.walk
    asked = walk.status == SOLVE
    way = leave_cube(xp, ray, walk.t, walk.cell, behind(walk.cell))
    enter, leave = ends_in_cell(xp, ray, walk, way)
    taps = stencil(xp, tables, base_of(xp, tables, turned(xp, ray, walk.cell), asked), asked)
    polynomial = ray_polynomial(xp, tables.kernel, taps, enter, leave)
    residue = xp.where(ray.leaving & (walk.t == 0), polynomial[0], 0.0)
    polynomial = tuple(b - residue for b in polynomial)
    bracket, sign = isolate(xp, polynomial, walk.sign, tables.bound, asked)
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
            xp.where(go_on, moved.came, walk.came),
            xp.where(go_on, sign, walk.sign),
        ),
        Bracket(*settled(bracket, state.bracket)),
        settled(polynomial, state.polynomial),
    )
