"""Texture coordinates chart by chart: right on both sides of a cut, and no mesh is needed.

In: the layers of a grid. Out: at a place, the trilinear interpolant of one chart: of those that look along the normal
there, the one that the place is deepest inside of, or least far outside.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Shaped

from sdfbake.bricks import SIDE
from sdfbake.engine import Array, Engine
from sdfbake.grid import Grid
from sdfbake.layers import FULL
from sdfrender.field import Mapped
from sdfrender.layertable import CORNERS, PADDED, padded, rows_of
from sdfrender.tables import Found, Tables, brick_of
from sdfrender.vector import Vector, dot

_WHOLE = 255  # all eight corners of a cell
# Ranks of rows: border distances stay within 8 voxels, so these keep the three kinds apart.
_AWAY, _TORN = 100.0, 1000.0


class _Search(NamedTuple):
    """The row to look at next, the end of them, the best so far (-1 for none) and its rank: less is better."""

    row: Array
    end: Array
    best: Array
    rank: Array


@dataclass(frozen=True, slots=True, eq=False)
class LayerMap:
    """Layers ready to be looked up: every brick's rows, padded to the corners of all its cells.

    Attributes
    ----------
    tables
        The grid's cells.
    first
        The rows of brick b are first[b] to first[b + 1] - 1; they ascend by chart.
    chart
        Virtual chart per row.
    uv
        Per row and corner u + 2^16 v, 16 bits each; 0 where the row says nothing.
    border
        Per row and corner the signed distance to the chart's border, voxels; 0 where the row says nothing.
    cells
        Per row and cell: bits 0 to 7, which corners the row has; then the mean normal of those, 127 times, as three
        bytes from -128.
    decode
        Per virtual chart: offset and scale / 65535 of u, then of v.
    atlas
        Chart of the atlas per virtual chart.
    per_voxel
        1 / spacing.
    """

    tables: Tables
    first: Array
    chart: Array
    uv: Array
    border: Array
    cells: Array
    decode: Array
    atlas: Array
    per_voxel: Array

    @staticmethod
    def of(grid: Grid, tables: Tables, engine: Engine, per_voxel: Array) -> "LayerMap":
        """Prepare the layers of a grid that has them."""
        assert grid.layers is not None
        layers = grid.layers
        rows = rows_of(layers, grid.bricks)
        uv, border, cells = padded(layers, rows)
        step = layers.scale / FULL
        decode = np.stack([layers.offset[:, 0], step[:, 0], layers.offset[:, 1], step[:, 1]], axis=1)
        return LayerMap(
            tables,
            engine.table(rows.first),
            engine.table(_some(rows.chart)),
            engine.table(_some(uv)),
            engine.table(_some(border)),
            engine.table(_some(cells)),
            engine.table(_some(decode)),
            engine.table(_some(layers.of)),
            per_voxel,
        )

    def uv_at(self, xp: Engine, found: Found, p: Vector, n: Vector | None) -> Mapped:
        """Texture coordinates of the chart at a place, and their gradient as interpolated.

        Parameters
        ----------
        xp, found
            The engine, and the place in its cell.
        p, n
            The position, which the cell says already; and the unit normal there.

        Returns
        -------
        Mapped
            With `seam` where no chart has all corners of the cell: there the mean of those that the fullest one has,
            or 0 if there is none at all.
        """
        assert n is not None
        slot, local = brick_of(xp, self.tables, found.cell, found.hit)
        known = found.hit & (slot >= 0)
        a, b, c = (i & (SIDE - 1) for i in found.cell)
        corner = (a * PADDED + b) * PADDED + c
        row = self._choose(xp, slot, known, local, corner, found.u, n)
        return self._interpolated(xp, row, known & (row >= 0), local, corner, found)

    def _choose(
        self, xp: Engine, slot: Array, known: Array, local: Array, corner: Array, u: Vector, n: Vector
    ) -> Array:
        """Return the row with the least rank, -1 where the brick has none."""
        first, end = xp.gather(self.first, slot, known), xp.gather(self.first, slot + 1, known)
        first, end = xp.where(known, first, 0), xp.where(known, end, 0)

        def look(state: _Search, constants: tuple[Array, Array, Vector, Vector]) -> _Search:
            local, corner, u, n = constants
            asked = state.row < state.end
            word = xp.gather(self.cells, state.row * SIDE**3 + local, asked)
            whole = (word & _WHOLE) == _WHOLE
            mean = tuple(xp.real(((word >> shift) & 255) - 128) for shift in (8, 16, 24))
            away = dot((mean[0], mean[1], mean[2]), n) <= 0
            border = self._border(xp, state.row, corner, u, asked & whole)
            rank = xp.where(whole, border + xp.where(away, _AWAY, 0.0), _TORN - _count(xp, word))
            wins = asked & (rank < state.rank)
            best, rank = xp.where(wins, state.row, state.best), xp.where(wins, rank, state.rank)
            return _Search(state.row + 1, state.end, best, rank)

        start = _Search(first, end, xp.full(local, -1), xp.full(u[0], 2 * _TORN))
        return xp.while_loop(lambda search: search.row < search.end, look, start, (local, corner, u, n)).best

    def _border(self, xp: Engine, row: Array, corner: Array, u: Vector, active: Array) -> Array:
        """Interpolate a row's border distance."""
        values = [xp.gather(self.border, row * PADDED**3 + (corner + _offset(at)), active) for at in CORNERS]
        for w in u:
            half = len(values) // 2
            values = [xp.fma(high - low, w, low) for low, high in zip(values[:half], values[half:], strict=True)]
        return values[0]

    def _interpolated(self, xp: Engine, row: Array, known: Array, local: Array, corner: Array, found: Found) -> Mapped:
        """Interpolate a row's texture coordinates, as differences from one corner: those are exact."""
        word = xp.gather(self.cells, row * SIDE**3 + local, known)
        present = xp.where(known, word & _WHOLE, 0)
        whole = present == _WHOLE
        w = tuple(xp.where(whole, u, 0.5) for u in found.u)
        codes = [xp.gather(self.uv, row * PADDED**3 + (corner + _offset(at)), known) for at in CORNERS]
        base = codes[-1]
        for number in reversed(range(7)):
            base = xp.where((present & (1 << number)) != 0, codes[number], base)
        weights = _weights(xp, w, present)
        inverse = 1.0 / xp.where(present == 0, 1.0, _total(weights[0]))
        chart = xp.gather(self.chart, row, known)
        out = []
        for axis, shift in enumerate((0, 16)):
            first = (base >> shift) & FULL
            steps = [xp.real(((code >> shift) & FULL) - first) for code in codes]
            value = _dot(xp, weights[0], steps) * inverse
            slopes = [(_dot(xp, d, steps) - value * _total(d)) * inverse for d in weights[1:]]
            offset, scale = (xp.gather(self.decode, chart * 4 + (2 * axis + i), known) for i in (0, 1))
            there = known & (present != 0)
            per_unit = scale * self.per_voxel
            x, y, z = (xp.where(there, slope * per_unit, 0.0) for slope in slopes)
            out.append((xp.where(there, offset + scale * (xp.real(first) + value), 0.0), (x, y, z)))
        of = xp.where(known, xp.gather(self.atlas, chart, known), 0)
        return Mapped(out[0][0], out[1][0], out[0][1], out[1][1], of, found.hit & ~whole)


def _offset(at: tuple[int, ...]) -> int:
    """Return how far a corner of a cell is from its first one in a padded row."""
    return (at[0] * PADDED + at[1]) * PADDED + at[2]


def _count(xp: Engine, word: Array) -> Array:
    """Return the number of corners in a cell's word."""
    return xp.real(_total([(word >> number) & 1 for number in range(8)]))


def _weights(xp: Engine, u: Vector, present: Array) -> list[list[Array]]:
    """Return the trilinear weights of the corners and their three derivatives, 0 for corners that are not there.

    Where all are there the weights sum to 1 and the derivatives to 0; elsewhere the quotient rule makes up for it.
    """
    there = [(present & (1 << number)) != 0 for number in range(8)]
    value = [(1.0 - w, w) for w in u]
    slope = [(xp.full(w, -1.0), xp.full(w, 1.0)) for w in u]
    out = []
    for turn in range(4):
        x, y, z = (slope[a] if a == turn - 1 else value[a] for a in range(3))
        out.append([xp.where(mask, x[i] * y[j] * z[k], 0.0) for mask, (i, j, k) in zip(there, CORNERS, strict=True)])
    return out


def _total(values: list[Array]) -> Array:
    total = values[0]
    for value in values[1:]:
        total = total + value
    return total


def _dot(xp: Engine, weights: list[Array], values: list[Array]) -> Array:
    total = weights[0] * values[0]
    for weight, value in zip(weights[1:], values[1:], strict=True):
        total = xp.fma(weight, value, total)
    return total


def _some(table: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    """Return a table with something in it: no engine likes an empty one."""
    return table if table.size else np.zeros(4, table.dtype)
