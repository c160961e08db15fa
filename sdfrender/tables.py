"""What a march looks up of a grid, as engine arrays, and the places that it finds there.

In: cells of a grid as integer coordinates. Out: the slot of their brick, their coefficients, samples of a channel.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.kernels import Kernel
from sdfrender.skips import MOST
from sdfrender.vector import Vector

Cell = tuple[Array, Array, Array]  # integer coordinates of a cell's lower sample
SHIFT, SIDE = 3, 8  # a brick has 2^3 cells per axis
INCOMPLETE = MOST + 1  # the bit that the field of octant 0 leaves free


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """What a march looks up, as engine arrays.

    Attributes
    ----------
    kernel
        The kernel the coefficients are for.
    slots
        Per brick of the lattice its slot; where absent -1 - the packed sides of the empty cubes ahead, in bricks.
    cells
        Per cell of every slot -1 - the number of its slab where it may hold surface, else the packed sides of the empty
        cubes ahead (`sdfrender.skips`) and INCOMPLETE where a coefficient is not from samples.
    planes, deltas
        Per slab c, g and half its width (`sdfrender.slabs`).
    coefficients
        (taps + 7)^3 per slot.
    samples
        Samples per axis, uniform integers.
    bricks
        Bricks per axis, uniform integers.
    bounds
        Per slot the rounding bound of a Bernstein coefficient of its cells.
    """

    kernel: Kernel
    slots: Array
    cells: Array
    planes: Array
    deltas: Array
    coefficients: Array
    samples: Cell
    bricks: Cell
    bounds: Array

    @property
    def width(self) -> int:
        """Coefficients of a brick per axis."""
        return SIDE - 1 + self.kernel.taps

    def with_(self, coefficients: Array) -> "Tables":
        """Return the same cells with another channel's coefficients."""
        return replace(self, coefficients=coefficients)


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


def brick_of(xp: Engine, tables: Tables, cell: Cell, active: Array) -> tuple[Array, Array]:
    """Return the slot of a cell's brick (-1 where absent) and the cell's number inside the brick."""
    x, y, z = (c >> SHIFT for c in cell)
    slot = xp.gather(tables.slots, (x * tables.bricks[1] + y) * tables.bricks[2] + z, active)
    a, b, c = (c & (SIDE - 1) for c in cell)
    return slot, (((a << SHIFT) | b) << SHIFT) | c


def is_complete(xp: Engine, tables: Tables, slot: Array, local: Array, active: Array) -> Array:
    """Say whether the stencil of a cell of a present brick is made of samples alone."""
    value = xp.gather(tables.cells, (slot << (3 * SHIFT)) + local, active)
    return (value < 0) | ((value & INCOMPLETE) == 0)


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


def stencil(xp: Engine, tables: Tables, base: Array, active: Array) -> Array:
    """Gather the taps^3 coefficients of a cell, for the engine's sums over a cube."""
    return xp.stencil(tables.coefficients, base, tables.kernel.taps, tables.width, active)


def cell_of(xp: Engine, tables: Tables, p: Vector) -> Cell:
    """Return the cell of a point, that of the nearest face for points outside the lattice."""
    return three(clamp(xp, xp.integer(xp.floor(p[a])), 0, tables.samples[a] - 2) for a in range(3))


def place_in(xp: Engine, p: Vector, cell: Cell) -> Vector:
    """Return cell coordinates, clamped to [0, 1]."""
    return three(clamp(xp, p[a] - xp.real(cell[a]), 0.0, 1.0) for a in range(3))


def clamp(xp: Engine, x: Array, low: Array, high: Array) -> Array:
    """Return the number in [low, high] nearest to x."""
    return xp.least((xp.most((x, low)), high))


def three(parts: Iterable[Array]) -> Vector:
    """Make a vector of its components."""
    x, y, z = parts
    return x, y, z
