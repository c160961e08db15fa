"""The walk of a ray through bricks and cells to its first hit.

In: rays in grid coordinates (a cell has side 1) and the tables of a grid field. Out: for every ray the cell of the
first hit and the place in it. A ray passes absent bricks in one step and cells without surface one by one; in a cell
that may hold surface, `sdfrender.cell` decides. No step length is guessed and no epsilon is tuned: every step ends on
a face of the cell or brick that it leaves.
"""

from dataclasses import dataclass
from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.cell import Bracket, Polynomial, isolate, ray_polynomial, refine
from sdfrender.kernels import Kernel
from sdfrender.stencils import OCCUPIED
from sdfrender.vector import Vector

Cell = tuple[Array, Array, Array]  # integer coordinates of a cell's lower sample
DONE, WALK, SOLVE, HIT = 0, 1, 2, 3
SHIFT, SIDE = 3, 8  # a brick has 2^3 cells per axis


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """What a march looks up, as engine arrays.

    Attributes
    ----------
    kernel
        The kernel the coefficients are for.
    slots
        Per brick of the lattice its slot, or -1.
    cells
        Per cell of every slot INCOMPLETE, EMPTY or OCCUPIED.
    coefficients
        (taps + 7)^3 per slot.
    samples
        Samples per axis, uniform integers.
    bricks
        Bricks per axis, uniform integers.
    bound
        Rounding bound of a Bernstein coefficient, uniform.
    """

    kernel: Kernel
    slots: Array
    cells: Array
    coefficients: Array
    samples: Cell
    bricks: Cell
    bound: Array

    @property
    def width(self) -> int:
        """Coefficients of a brick per axis."""
        return SIDE - 1 + self.kernel.taps

    def with_(self, coefficients: Array) -> "Tables":
        """Return the same cells with another channel's coefficients."""
        return Tables(self.kernel, self.slots, self.cells, coefficients, self.samples, self.bricks, self.bound)


class Found(NamedTuple):
    """First hits: mask, ray parameter, cell, place in the cell (0 to 1), index of the cell's first coefficient."""

    hit: Array
    t: Array
    cell: Cell
    u: Vector
    base: Array

    def nearest(self, xp: Engine) -> Cell:
        """Return the sample nearest to the place."""
        x, y, z = (c + xp.integer(u >= 0.5) for c, u in zip(self.cell, self.u, strict=True))
        return x, y, z


class _Ray(NamedTuple):
    """What does not change along a ray."""

    p: Vector
    d: Vector
    inverse: Vector
    leaving: Array  # mask: starts on the surface


class _March(NamedTuple):
    """State of a ray: where it is and, once it has hit, the polynomial and the bracket of the root."""

    status: Array
    t: Array
    cell: Cell
    sign: Array
    end: Array
    bracket: Bracket
    polynomial: Polynomial


class _Walk(NamedTuple):
    """The part of the state that passing empty space changes."""

    status: Array
    t: Array
    cell: Cell


def brick_of(xp: Engine, tables: Tables, cell: Cell, active: Array) -> tuple[Array, Array]:
    """Return the slot of a cell's brick (-1 where absent) and the cell's number inside the brick."""
    x, y, z = (c >> SHIFT for c in cell)
    slot = xp.gather(tables.slots, (x * tables.bricks[1] + y) * tables.bricks[2] + z, active)
    a, b, c = (c & (SIDE - 1) for c in cell)
    return slot, (((a << SHIFT) | b) << SHIFT) | c


def sample(xp: Engine, tables: Tables, channel: Array, at: Cell, active: Array) -> Array:
    """Look up a channel at a sample; anything where not active or where its brick is absent."""
    slot, local = brick_of(xp, tables, at, active)
    return xp.gather(channel, slot * SIDE**3 + local, active & (slot >= 0))


def base_of(xp: Engine, tables: Tables, cell: Cell, active: Array) -> Array:
    """Return the index of a cell's first coefficient, 0 where its brick is absent."""
    slot, _ = brick_of(xp, tables, cell, active)
    a, b, c = (c & (SIDE - 1) for c in cell)
    s = tables.width
    return xp.where(active & (slot >= 0), ((slot * s + a) * s + b) * s + c, 0)


def stencil(xp: Engine, tables: Tables, base: Array, active: Array) -> list[Array]:
    """Gather the taps^3 coefficients of a cell, z fastest."""
    s, taps = tables.width, range(tables.kernel.taps)
    return [
        xp.gather(tables.coefficients, base + ((i * s + j) * s + k), active) for i in taps for j in taps for k in taps
    ]


def enter_box(xp: Engine, tables: Tables, p: Vector, d: Vector) -> tuple[Array, Cell, Array]:
    """Clip rays to the lattice: parameter and cell where a ray enters, and whether it does.

    A ray along a face of the box is inside; one that starts inside enters at t = 0.
    """
    first, last = xp.full(p[0], 0.0), xp.full(p[0], float("inf"))
    inside = xp.full(p[0], True)
    for axis in range(3):
        top = xp.real(tables.samples[axis] - 1)
        parallel = d[axis] == 0
        inside = inside & (~parallel | ((p[axis] >= 0) & (p[axis] <= top)))
        inverse = 1.0 / xp.where(parallel, 1.0, d[axis])
        a, b = -p[axis] * inverse, (top - p[axis]) * inverse
        first = xp.where(parallel, first, xp.maximum(first, xp.minimum(a, b)))
        last = xp.where(parallel, last, xp.minimum(last, xp.maximum(a, b)))
    inside = inside & (first <= last)
    t = xp.where(inside, first, 0.0)
    return t, cell_of(xp, tables, (p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2])), inside


def cell_of(xp: Engine, tables: Tables, p: Vector) -> Cell:
    """Return the cell of a point, that of the nearest face for points outside the lattice."""
    x, y, z = (_clamp(xp, xp.integer(xp.floor(p[a])), 0, tables.samples[a] - 2) for a in range(3))
    return x, y, z


def place_in(xp: Engine, p: Vector, cell: Cell) -> Vector:
    """Return cell coordinates, clamped to [0, 1]."""
    x, y, z = (_clamp(xp, p[a] - xp.real(cell[a]), 0.0, 1.0) for a in range(3))
    return x, y, z


def _clamp(xp: Engine, x: Array, low: Array, high: Array) -> Array:
    return xp.minimum(xp.maximum(x, low), high)


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
    nothing = xp.full(p[0], 0.0)
    if start is None:
        t, cell, inside = enter_box(xp, tables, p, d)
        active, leaving = active & inside, xp.full(p[0], False)
    else:
        t, cell, leaving = nothing, start.cell, active & start.hit
        active = leaving
    inverse = tuple(1.0 / xp.where(d[a] == 0, 1.0, d[a]) for a in range(3))
    ray = _Ray(p, d, inverse, leaving)
    missing = Bracket(xp.full(p[0], False), nothing, nothing, nothing)
    empty = tuple(xp.full(p[0], 0.0) for _ in range(3 * tables.kernel.degree + 1))
    state = _March(xp.integer(active) * WALK, t, cell, nothing, nothing, missing, empty)

    def advance(state: _March, ray: _Ray) -> _March:
        return _solve(xp, tables, _pass_empty(xp, tables, state, ray), ray)

    end = xp.while_loop(lambda s: (s.status == WALK) | (s.status == SOLVE), advance, state, ray)
    s = refine(xp, end.polynomial, end.bracket)
    enter, leave = _ends(xp, ray, end.cell, end.t, end.end)
    u = tuple(xp.fma(leave[a] - enter[a], s, enter[a]) for a in range(3))
    hit = end.status == HIT
    t = xp.where(hit, xp.fma(end.end - end.t, s, end.t), 0.0)
    return Found(hit, t, end.cell, u, base_of(xp, tables, end.cell, hit))


def _pass_empty(xp: Engine, tables: Tables, state: _March, ray: _Ray) -> _March:
    """Walk on until a cell that may hold surface, or out of the lattice."""

    def step(walk: _Walk, ray: _Ray) -> _Walk:
        slot, local = brick_of(xp, tables, walk.cell, walk.status == WALK)
        present = slot >= 0
        kind = xp.gather(tables.cells, (slot << (3 * SHIFT)) + local, present & (walk.status == WALK))
        occupied = present & (kind == OCCUPIED)
        low = tuple(xp.where(present, c, (c >> SHIFT) << SHIFT) for c in walk.cell)
        high = tuple(xp.where(present, c + 1, ((c >> SHIFT) + 1) << SHIFT) for c in walk.cell)
        t, cell = _leave(xp, ray, walk.t, walk.cell, low, high)
        status = xp.where(occupied, SOLVE, xp.integer(_inside(tables, cell)) * WALK)
        return _Walk(status, xp.where(occupied, walk.t, t), _choose(xp, occupied, walk.cell, cell))

    walk = xp.while_loop(lambda w: w.status == WALK, step, _Walk(state.status, state.t, state.cell), ray)
    return state._replace(status=walk.status, t=walk.t, cell=walk.cell)


def _solve(xp: Engine, tables: Tables, state: _March, ray: _Ray) -> _March:
    """Decide a cell that may hold surface: a hit, or on to the next cell."""
    asked = state.status == SOLVE
    t, cell = _leave(xp, ray, state.t, state.cell, state.cell, tuple(c + 1 for c in state.cell))
    enter, leave = _ends(xp, ray, state.cell, state.t, t)
    taps = stencil(xp, tables, base_of(xp, tables, state.cell, asked), asked)
    polynomial = ray_polynomial(xp, tables.kernel, taps, enter, leave)
    residue = xp.where(ray.leaving & (state.t == 0), polynomial[0], 0.0)
    polynomial = tuple(b - residue for b in polynomial)
    bracket, sign = isolate(xp, polynomial, state.sign, tables.bound, asked)
    hit = bracket.found & asked
    go_on = asked & ~hit
    return _March(
        xp.where(hit, HIT, xp.where(go_on, xp.integer(_inside(tables, cell)) * WALK, state.status)),
        xp.where(go_on, t, state.t),
        _choose(xp, go_on, cell, state.cell),
        xp.where(go_on, sign, state.sign),
        xp.where(hit, t, state.end),
        Bracket(*(xp.where(hit, new, old) for new, old in zip(bracket, state.bracket, strict=True))),
        tuple(xp.where(hit, new, old) for new, old in zip(polynomial, state.polynomial, strict=True)),
    )


def _ends(xp: Engine, ray: _Ray, cell: Cell, t: Array, end: Array) -> tuple[Vector, Vector]:
    """Return where a ray enters and leaves a cell, in cell coordinates."""
    anchored = tuple(ray.p[a] - xp.real(cell[a]) for a in range(3))
    enter = tuple(_clamp(xp, xp.fma(ray.d[a], t, anchored[a]), 0.0, 1.0) for a in range(3))
    leave = tuple(_clamp(xp, xp.fma(ray.d[a], end, anchored[a]), 0.0, 1.0) for a in range(3))
    return enter, leave


def _leave(
    xp: Engine, ray: _Ray, t: Array, cell: Cell, low: tuple[Array, ...], high: tuple[Array, ...]
) -> tuple[Array, Cell]:
    """Leave the box of cells [low, high): the parameter on its face, and the next cell.

    Always advances at least one cell along the axis of the face and never moves back along another, so that the walk
    ends whatever the rounding.
    """
    never = xp.full(t, float("inf"))
    crossing = []
    for a in range(3):
        plane = xp.real(xp.where(ray.d[a] > 0, high[a], low[a]))
        crossing.append(xp.where(ray.d[a] == 0, never, (plane - ray.p[a]) * ray.inverse[a]))
    first = xp.minimum(xp.minimum(crossing[0], crossing[1]), crossing[2])
    by_x = crossing[0] <= first
    by_y = (crossing[1] <= first) & ~by_x
    by_z = ~(by_x | by_y)
    after = xp.maximum(first, t)
    following = []
    for a, exits in enumerate((by_x, by_y, by_z)):
        at = _clamp(xp, xp.integer(xp.floor(xp.fma(ray.d[a], after, ray.p[a]))), low[a], high[a] - 1)
        at = xp.where(ray.d[a] > 0, xp.maximum(at, cell[a]), xp.minimum(at, cell[a]))
        following.append(xp.where(exits, xp.where(ray.d[a] > 0, high[a], low[a] - 1), at))
    return after, (following[0], following[1], following[2])


def _inside(tables: Tables, cell: Cell) -> Array:
    x, y, z = cell
    low = (x >= 0) & (y >= 0) & (z >= 0)
    return low & (x < tables.samples[0] - 1) & (y < tables.samples[1] - 1) & (z < tables.samples[2] - 1)


def _choose(xp: Engine, mask: Array, yes: Cell, no: Cell) -> Cell:
    return xp.where(mask, yes[0], no[0]), xp.where(mask, yes[1], no[1]), xp.where(mask, yes[2], no[2])
