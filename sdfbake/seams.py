"""Where charts meet: the cells in which texture coordinates must not be interpolated.

In: a grid with texture coordinates. Out: a mask. Readers without layers or faces take one chart's coordinates in such a
cell, or none.
"""

from itertools import product

import numpy as np
from jaxtyping import Bool, Int

from sdfbake.bricks import REACH, SIDE, Bricks, in_lattice
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid

_BRICKS = 512  # whose cells are looked at together
_MOST = np.iinfo(np.int32).max


def seam_cells(grid: Grid) -> Bool[np.ndarray, "k 8 8 8"]:
    """Say of every cell, named by its first sample, whether its eight samples belong to several charts.

    Samples that name no chart, as they are out of reach or outside the lattice, are passed over.

    Raises
    ------
    BadInput
        If the grid names neither faces nor charts.
    """
    return meeting(grid.bricks, _charts(grid))


def meeting(bricks: Bricks, chart: Int[np.ndarray, "k 8 8 8"]) -> Bool[np.ndarray, "k 8 8 8"]:
    """Say of every cell, named by its first sample, whether its corners belong to several charts; -1 is none.

    Only bricks are looked at that see several charts, with the seven that their last cells reach into.
    """
    low = np.where(chart < 0, _MOST, chart).min(axis=(1, 2, 3), initial=_MOST)
    high = chart.max(axis=(1, 2, 3), initial=-1)
    reached = _reached(bricks)
    low, high = np.append(low, _MOST), np.append(high, -1)  # what a slot of -1 finds
    several = np.flatnonzero(low[reached].min(axis=1) < high[reached].max(axis=1))
    seam = np.zeros(chart.shape, bool)
    for start in range(0, len(several), _BRICKS):
        part = several[start : start + _BRICKS]
        seam[part] = _several(chart, reached[part])
    return seam


def _reached(bricks: Bricks) -> Int[np.ndarray, "k 8"]:
    """Return the slots of every brick and of its seven neighbours on the far sides, -1 where there is none."""
    slot = np.pad(bricks.slot, (0, 1), constant_values=-1)
    found: Int[np.ndarray, "k 8"] = np.stack(
        [slot[tuple((bricks.index + step).T)] for step in product((0, 1), repeat=3)], axis=1
    )
    return found


def _several(chart: Int[np.ndarray, "k 8 8 8"], reached: Int[np.ndarray, "n 8"]) -> Bool[np.ndarray, "n 8 8 8"]:
    """Say of every cell of some bricks whether its corners belong to several charts."""
    seen = np.full((len(reached), SIDE + 1, SIDE + 1, SIDE + 1), -1, np.int32)
    for column, step in enumerate(product((0, 1), repeat=3)):
        there = reached[:, column] >= 0
        to = tuple(slice(SIDE, None) if far else slice(SIDE) for far in step)
        of = tuple(slice(1) if far else slice(None) for far in step)
        seen[(there, *to)] = chart[(reached[there, column], *of)]
    return several(seen)


def several(chart: Int[np.ndarray, "*n x y z"]) -> Bool[np.ndarray, "*n x-1 y-1 z-1"]:
    """Say of every cell whether its corners, whose charts are given, belong to several; -1 is none."""
    low, high = np.where(chart < 0, _MOST, chart), chart
    for axis in (-3, -2, -1):
        first, second = _pair(axis + chart.ndim)
        low = np.minimum(low[first], low[second])
        high = np.maximum(high[first], high[second])
    return low < high


def _pair(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return what selects all but the last, and all but the first, along an axis."""
    before = (slice(None),) * axis
    return (*before, slice(-1)), (*before, slice(1, None))


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
