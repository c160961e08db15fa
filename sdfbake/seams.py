"""Where charts meet: the cells in which texture coordinates must not be interpolated.

In: a grid with texture coordinates. Out: a mask. Readers without layers or faces take one chart's coordinates in such a
cell, or none.
"""

import numpy as np
from jaxtyping import Bool, Int

from sdfbake.bricks import REACH, SIDE, Bricks, in_lattice
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid


def seam_cells(grid: Grid) -> Bool[np.ndarray, "k 8 8 8"]:
    """Say of every cell, named by its first sample, whether its eight samples belong to several charts.

    Samples that name no chart, as they are out of reach or outside the lattice, are passed over.

    Raises
    ------
    BadInput
        If the grid names neither faces nor charts.
    """
    chart = _charts(grid)
    low, high = np.where(chart < 0, np.iinfo(np.int32).max, chart), chart
    for axis in range(3):
        low = np.minimum(low, _next(grid.bricks, low, axis, np.iinfo(np.int32).max))
        high = np.maximum(high, _next(grid.bricks, high, axis, -1))
    return low < high


def _charts(grid: Grid) -> Int[np.ndarray, "k 8 8 8"]:
    """Return the chart of every sample's closest point, -1 where there is none."""
    if grid.face is not None and grid.surface is not None:
        named: np.ndarray = np.concatenate([grid.surface.chart, [-1]]).astype(np.int32)[grid.face]
        return named
    if grid.uv is None:
        raise BadInput("the grid has no texture coordinates by face or by sample: bake it with --uv-mode faces")
    known = np.abs(grid.distance) < np.float32(REACH * grid.lattice.spacing)
    known &= in_lattice(grid.bricks.index, grid.lattice.shape)
    chart = np.zeros(known.shape, np.int32) if grid.chart is None else grid.chart
    return np.where(known, chart, -1).astype(np.int32)


def _next(bricks: Bricks, values: Int[np.ndarray, "k 8 8 8"], axis: int, missing: int) -> Int[np.ndarray, "k 8 8 8"]:
    """Return every sample's neighbour on the far side along an axis."""
    place = bricks.index.astype(np.int64)
    place[:, axis] += 1
    within = place[:, axis] < bricks.slot.shape[axis]
    slot = np.where(within, bricks.slot[tuple(np.where(within[:, None], place, 0).T)], -1)
    beyond = np.where((slot >= 0)[:, None, None], values.take(0, axis + 1)[slot], missing)
    inner = values.take(range(1, SIDE), axis + 1)
    return np.concatenate([inner, np.expand_dims(beyond, axis + 1)], axis=axis + 1).astype(np.int32)
