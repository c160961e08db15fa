"""What a march looks up of a grid, made when the grid is loaded.

In: a grid, a kernel, an engine. Out: `Tables`, and the rounding bound of the interpolant along a ray
(docs/tracing.md). Every step is a program over all bricks: `stencils`, `slabs`, `skips`.
"""

import numpy as np

from sdfbake.bricks import SIDE
from sdfbake.engine import Array, Engine
from sdfbake.grid import Grid
from sdfrender.cell import tolerance
from sdfrender.kernels import Kernel
from sdfrender.skips import brick_sides, cell_sides
from sdfrender.slabs import Slabs, slabs
from sdfrender.stencils import Blocks, stencils
from sdfrender.tables import INCOMPLETE, Tables


def prepare(grid: Grid, kernel: Kernel, engine: Engine) -> tuple[Tables, float]:
    """Prepare what a march looks up, and its rounding bound.

    Parameters
    ----------
    grid
        The asset.
    kernel
        The kernel.
    engine
        The engine that traces.
    """
    table = grid.bricks.slot
    blocks = Blocks.of(engine, grid.bricks, grid.lattice.shape)
    made = stencils(engine, grid.distance, blocks, kernel)
    # A cell counts as empty only where no rounding of its neighbours' polynomials reaches: twice their bound.
    found = slabs(engine, made, blocks, kernel, lambda largest: 2 * tolerance(engine.eps, kernel, largest))
    bound = tolerance(engine.eps, kernel, found.largest)
    nx, ny, nz = (engine.uniform(int(n)) for n in table.shape)
    prepared = Tables(
        kernel,
        engine.table(np.where(table < 0, -1 - brick_sides(engine, table >= 0), table)),
        _cells(engine, blocks, made.complete, found),
        _as(engine, found.plane),
        _as(engine, found.delta),
        made.coefficients,
        blocks.samples,
        (nx, ny, nz),
        engine.uniform(bound),
    )
    return prepared, bound


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
