"""Texture coordinates interpolated between samples (Galim 2018, eq. 22, 23).

In: the texture coordinates of the surface point closest to every sample. Out: their interpolant at a place, by the
kernel that traces. Wrong where samples of several charts meet; there a flag says so.
"""

from dataclasses import dataclass

from sdfbake.engine import Array, Engine
from sdfbake.grid import Grid
from sdfrender.field import Mapped
from sdfrender.interpolation import contract
from sdfrender.mixed import mixed_cells
from sdfrender.stencils import Blocks, coefficients
from sdfrender.tables import SIDE, Found, Tables, brick_of, sample, stencil
from sdfrender.vector import Vector


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """Sampled texture coordinates ready to be looked up.

    Attributes
    ----------
    tables
        The grid's cells.
    coefficients
        Of u and of v, laid out as the tables'.
    chart
        Chart per sample; None where there is only one.
    seams
        Per cell, whether samples of several charts stand behind its coefficients; there if `chart` is.
    per_voxel
        1 / spacing.
    """

    tables: Tables
    coefficients: tuple[Array, Array]
    chart: Array | None
    seams: Array | None
    per_voxel: Array

    @staticmethod
    def of(grid: Grid, tables: Tables, engine: Engine, per_voxel: Array) -> "GridMap":
        """Prefilter the texture coordinates and mark the seams of a grid that has them."""
        assert grid.uv is not None
        bricks, shape, kernel = grid.bricks, grid.lattice.shape, tables.kernel
        blocks = Blocks.of(engine, bricks, shape)
        u, v = (coefficients(engine, grid.uv[..., c], blocks, kernel) for c in (0, 1))
        if grid.chart is None:
            return GridMap(tables, (u, v), None, None, per_voxel)
        seams = engine.table(mixed_cells(grid.chart, bricks, shape, kernel))
        return GridMap(tables, (u, v), engine.table(grid.chart), seams, per_voxel)

    def uv_at(self, xp: Engine, found: Found, p: Vector, n: Vector | None) -> Mapped:
        """Interpolate; the position comes from the cell, and the normal has no say."""
        parts = []
        for channel in self.coefficients:
            taps = stencil(xp, self.tables.with_(channel), found.base, found.hit)
            value, x, y, z = contract(xp, self.tables.kernel, taps, found.u, 1)
            parts.append((value, (x * self.per_voxel, y * self.per_voxel, z * self.per_voxel)))
        chart, seam = self._chart(xp, found)
        return Mapped(parts[0][0], parts[1][0], parts[0][1], parts[1][1], chart, seam)

    def _chart(self, xp: Engine, found: Found) -> tuple[Array, Array]:
        """Chart of the nearest sample, and whether samples of another chart went into the texture coordinates."""
        if self.chart is None or self.seams is None:
            return xp.full(found.t, 0), xp.full(found.t, False)
        slot, local = brick_of(xp, self.tables, found.cell, found.hit)
        seam = xp.gather(self.seams, slot * SIDE**3 + local, found.hit & (slot >= 0))
        chart = sample(xp, self.tables, self.chart, found.nearest(xp), found.hit)
        return chart, (seam > 0) & found.hit
