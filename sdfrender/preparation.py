"""What a march looks up of a grid, made when the grid is loaded.

In: a grid, a kernel, an engine. Out: `Tables`, and the rounding bound of the interpolant along a ray
(docs/tracing.md). Every step is a program over all bricks: `stencils`, `slabs`, `skips`.
"""

import numpy as np
from jaxtyping import Float, Int

from sdfbake.bricks import REACH, SIDE, Bricks
from sdfbake.engine import Array, Engine
from sdfbake.grid import Grid
from sdfrender.cell import tolerance
from sdfrender.kernels import Kernel
from sdfrender.skips import FIELD, OCTANTS, brick_sides, cell_sides
from sdfrender.slabs import Slabs, greatest_row, slabs
from sdfrender.stencils import Blocks, stencils
from sdfrender.tables import INCOMPLETE, Tables

_FARTHEST = REACH + 3**0.5 * SIDE  # voxels, of a sample from the surface: a diagonal beyond the nearest
_ONE_AHEAD = sum(1 << (FIELD * octant) for octant in range(OCTANTS))  # the sides of a cube that is a brick


def prepare(grid: Grid, kernel: Kernel, engine: Engine) -> tuple[Tables, float]:
    """Prepare what a march looks up, and the greatest of its rounding bounds.

    What is made of a brick depends on the bricks around it alone, and on where bricks are: where all of these were
    loaded, the rest of the grid changes no bit of it.

    Parameters
    ----------
    grid
        The asset.
    kernel
        The kernel.
    engine
        The engine that traces.
    """
    blocks = Blocks.of(engine, grid.bricks, grid.lattice.shape)
    made = stencils(engine, grid.distance, blocks, kernel)
    # A cell counts as empty only where no rounding of its neighbours' polynomials reaches: twice their bound.
    reach, per_size = _reach(grid, kernel), tolerance(engine.eps, kernel, 1.0)
    found = slabs(engine, made, blocks, kernel, reach, 2 * per_size * greatest_row(kernel) ** 3 * reach)
    bounds = per_size * found.largest
    nx, ny, nz = (engine.uniform(int(n)) for n in grid.bricks.slot.shape)
    prepared = Tables(
        kernel,
        engine.table(_slots(engine, grid.bricks)),
        _cells(engine, blocks, made.complete, found),
        _as(engine, found.plane),
        _as(engine, found.delta),
        made.coefficients,
        blocks.samples,
        (nx, ny, nz),
        engine.table(bounds),
    )
    return prepared, float(bounds.max())


def _reach(grid: Grid, kernel: Kernel) -> Float[np.ndarray, " k"]:
    """Bound, per brick, the coefficients of its cells and their neighbours.

    Of a distance it is known beforehand, so that bricks that were not loaded do not matter: a brick has a sample within
    reach. A coefficient next to the lattice continues two samples along an axis: 2 v - w.
    """
    bricks, values = grid.bricks, grid.distance
    if len(bricks) == 0:
        return np.zeros(1)
    known = 0.0 if grid.metadata.source == "dense" else _FARTHEST * grid.lattice.spacing
    greatest = max(known, float(values.max()), -float(values.min()))
    outer, middle, _ = kernel.prefilter
    leaves = (bricks.index == 0).any(axis=1) | ((bricks.index + 2) * SIDE > np.array(grid.lattice.shape)).any(axis=1)
    growth = np.where(leaves, 3.0, abs(middle) + 2 * abs(outer))
    reach: Float[np.ndarray, " k"] = growth**3 * greatest
    return reach


def _slots(xp: Engine, bricks: Bricks) -> Int[np.ndarray, "bx by bz"]:
    """Return the slot of every brick, or how far there are none ahead: those that were not loaded are there, too."""
    present = bricks.slot >= 0
    if bricks.left_out is None:
        return np.where(present, bricks.slot, -1 - brick_sides(xp, present))
    sides = np.where(bricks.left_out, _ONE_AHEAD, brick_sides(xp, present | bricks.left_out))
    return np.where(present, bricks.slot, -1 - sides)


def _as(xp: Engine, table: Array) -> Array:
    """Return a table of single precision in that of the engine."""
    return table if xp.precision == 32 else xp.real(table)


def _cells(xp: Engine, blocks: Blocks, complete: Array, found: Slabs) -> Array:
    """Return per cell -1 - the number of its slab, or how far it is empty and whether its stencil is whole."""
    rank = xp.lanes(max(found.size, 1))
    number = xp.scattered(blocks.size * SIDE**3, 0, found.cell, -1 - rank, rank < xp.uniform(found.size))

    def empty(lane: Array) -> tuple[tuple[Array]]:
        bits = xp.full(lane, 0)
        for z in range(SIDE):
            bits = bits | (xp.integer(xp.gather(number, (lane << 3) + z, True) == 0) << z)
        return ((bits,),)

    (rows,) = xp.tabulated(blocks.size * SIDE**2, empty)
    sides = cell_sides(xp, rows, blocks.slot, blocks.size)

    def value(lane: Array) -> tuple[tuple[Array]]:
        own = xp.gather(number, lane, True)
        whole = (xp.gather(complete, lane >> 3, True) >> (lane & 7)) & 1
        side = xp.gather(sides, lane, True) | (INCOMPLETE - whole * INCOMPLETE)
        return ((xp.where(own < 0, own, side),),)

    (cells,) = xp.tabulated(blocks.size * SIDE**3, value)
    return cells
