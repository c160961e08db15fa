"""Which charts come near which cells.

In: bricks with distances and closest faces. Out: the cells with surface in them, the charts that fold over within one,
and per brick and chart the cells that the chart comes near.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake import virtual
from sdfbake.bricks import SIDE, Bricks
from sdfbake.chartmaps import ChartMaps
from sdfbake.lattice import Lattice

# A hit lies within 0.3 voxels of the surface, and within half a diagonal of the centre of its cell.
NEAR = np.sqrt(3) / 2 + 0.3
MOST = 3  # layers that a cell keeps
_CHUNK = 256  # bricks worked on together: a few MB per array
_NOBODY = np.uint32(0xFFFFFFFF)  # the label -1, read without a sign
_BRICK = (SIDE, SIDE, SIDE)
PLACES = np.indices(_BRICK).reshape(3, -1).T.copy()  # of the samples of a brick
# Of 4^3 samples around a cell, those that can be next to a point within `NEAR` of its centre: all but the cube's edges.
_MIDDLE = np.flatnonzero(((np.indices((4, 4, 4)) % 3 == 0).sum(axis=0) < 2).reshape(-1))
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """What a grid knows before it has layers; see `sdfbake.grid.Grid`."""

    lattice: Lattice
    bricks: Bricks
    distance: Float[np.ndarray, "k 8 8 8"]
    face: Int[np.ndarray, "k 8 8 8"]


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Cells with surface.

    Attributes
    ----------
    slot
        Bricks that have some, ascending.
    mask
        Which cells, by their lowest corner.
    """

    slot: Int[np.ndarray, " m"]
    mask: Bool[np.ndarray, "m 8 8 8"]


class Rows(NamedTuple):
    """Bricks and charts, and some cells or samples of each.

    Attributes
    ----------
    slot, chart
        Brick and virtual chart; no two rows have both the same.
    mask
        Which cells (by their lowest corner) or samples.
    """

    slot: Int[np.ndarray, " r"]
    chart: Int[np.ndarray, " r"]
    mask: Bool[np.ndarray, "r 8 8 8"]


class Pairs(NamedTuple):
    """Cells and charts that may come near them.

    Attributes
    ----------
    slot, cell
        Brick, and place of the cell's lowest corner in it, 0 to 511.
    chart
        Virtual chart.
    """

    slot: Int[np.ndarray, " n"]
    cell: Int[np.ndarray, " n"]
    chart: Int[np.ndarray, " n"]


def surface_cells(samples: Samples) -> Cells:
    """Find all cells whose centre is within `NEAR` of the surface, and few others.

    The square of the distance from any set, less |x|^2, is the least of affine functions and so concave: at the centre
    of a cell it is no less than its mean over the corners, hence D(centre)^2 >= mean D^2 - 3/4. Where the mean is
    greater than NEAR^2 + 3/4 there is nothing.
    """
    most = np.float32(8 * (NEAR**2 + 0.75) * (1 + 1e-5))  # more than float32's rounding
    h, count = np.float32(samples.lattice.spacing), len(samples.bricks)

    def find(chunk: slice) -> tuple[Int[np.ndarray, " m"], Bool[np.ndarray, "m 8 8 8"]]:
        slot = np.arange(count)[chunk]
        square = (_haloed(samples, samples.distance, slot, (0, 1), np.inf) / h) ** 2
        total = square[:, 1:] + square[:, :-1]
        total = total[:, :, 1:] + total[:, :, :-1]
        mask = total[..., 1:] + total[..., :-1] <= most
        some = mask.reshape(len(mask), -1).any(axis=1)
        return slot[some], mask[some]

    slots, masks = zip((np.zeros(0, np.int64), np.zeros((0, *_BRICK), bool)), *_mapped(find, count), strict=True)
    return Cells(np.concatenate(slots), np.concatenate(masks))


def folds(
    samples: Samples, cells: Cells, normals: Float[np.ndarray, "f 3"], chart: Int[np.ndarray, " f"]
) -> Bool[np.ndarray, " charts"]:
    """Say which charts fold over within a cell with surface; see `sdfbake.virtual.folded`."""
    count = int(chart.max()) + 1
    folding, able = np.zeros(count, bool), virtual.bent(normals, chart, count)
    if not able.any():
        return folding
    # One row more, without a direction, for -1; and none for the faces of charts that cannot fold.
    normals = np.append(np.where(able[chart, None], normals, 0), np.zeros((1, 3)), axis=0).astype(np.float32)
    chart, code = np.append(chart, np.int32(0)), virtual.direction_bits(normals)

    def find(part: slice) -> Bool[np.ndarray, " charts"]:
        halo = _haloed(samples, samples.face, cells.slot[part], (0, 1), -1)
        seen = code[halo]
        for axis in (1, 2, 3):
            before, after = _apart(axis, 1)
            seen = seen[before] | seen[after]
        several = (seen & (seen - np.uint8(1))) > 0
        return virtual.folded(normals, chart, _stencil(halo, cells.mask[part] & several, 2), count)

    for found in _mapped(find, len(cells.slot)):
        folding |= found
    return folding


def near_charts(samples: Samples, cells: Cells, maps: ChartMaps) -> tuple[Rows, int]:
    """Find the charts near every cell.

    A cell's candidates are the charts of the closest faces of the 4^3 samples around it: a point within `NEAR` of the
    centre lies between them. Where there is one, it stands; where there are more, their distances from the centre say.

    Returns
    -------
    rows
        The cells near every chart.
    overflow
        Cells with more than `MOST` charts, of which they keep the nearest.
    """
    label = np.append(maps.piece, np.int32(-1))

    def find(part: slice) -> tuple[Int[np.ndarray, "m 2"], Bool[np.ndarray, "m 512"], Pairs, Pairs]:
        slot, mask = cells.slot[part], cells.mask[part]
        halo = label[_haloed(samples, samples.face, slot, (1, 2), -1)]
        flat = halo.reshape(len(slot), -1)
        most = flat.max(axis=1)
        alone = (flat.view(np.uint32).min(axis=1) == most.view(np.uint32)) & (most >= 0)
        whole = np.stack([slot[alone], most[alone]], axis=-1)
        return whole, mask[alone].reshape(-1, SIDE**3), *_candidates(slot[~alone], mask[~alone], halo[~alone])

    found = _mapped(find, len(cells.slot))
    if not found:
        return Rows(cells.slot, cells.slot, cells.mask), 0
    whole, masks, sure, doubtful = zip(*found, strict=True)
    near, overflow = _nearest(samples.bricks, maps, _joined(*doubtful))
    pairs = _joined(*sure, near)
    key, row = np.unique((pairs.slot << 32) | pairs.chart, return_inverse=True)
    mask = np.zeros((len(key), SIDE**3), bool)
    mask[row, pairs.cell] = True
    slot, chart = np.concatenate([*whole, np.stack([key >> 32, key & 0xFFFFFFFF], axis=-1)]).T
    return Rows(slot, chart, np.concatenate([*masks, mask]).reshape(-1, *_BRICK)), overflow


def _candidates(
    slot: Int[np.ndarray, " m"], mask: Bool[np.ndarray, "m 8 8 8"], halo: Int[np.ndarray, "m 11 11 11"]
) -> tuple[Pairs, Pairs]:
    """Return the cells with one chart around them, and the cells with several, each beside each of its charts."""
    most, least = halo, halo.view(np.uint32)
    for axis in (1, 2, 3):
        for step in (1, 2):  # two, then four neighbours
            before, after = _apart(axis, step)
            most, least = np.maximum(most[before], most[after]), np.minimum(least[before], least[after])
    alone = mask & (most.view(np.uint32) == least) & (most >= 0)
    brick, cell = np.divmod(np.flatnonzero(alone), SIDE**3)
    one = Pairs(slot[brick], cell, most[alone].astype(np.int64))

    rest = mask & ~alone
    brick, cell = np.divmod(np.flatnonzero(rest), SIDE**3)
    around = _stencil(halo, rest, 4)[_MIDDLE].view(np.uint32)
    found = [_nothing()]
    while len(brick):
        least = around.min(axis=0)
        some = least != _NOBODY
        brick, cell, least, around = brick[some], cell[some], least[some], around[:, some]
        found.append(Pairs(slot[brick], cell, least.astype(np.int64)))
        around = np.where(around == least, _NOBODY, around)
    return one, _joined(*found)


def _nearest(bricks: Bricks, maps: ChartMaps, pairs: Pairs) -> tuple[Pairs, int]:
    """Keep the charts within `NEAR` of the cells' centres, at most the `MOST` nearest, the lowest on ties."""
    centre = bricks.index[pairs.slot].astype(np.int64) * SIDE + PLACES[pairs.cell] + 0.5
    square, _ = maps.closest(centre, pairs.chart)
    near = np.flatnonzero(square <= NEAR**2)
    cell = pairs.slot[near] * SIDE**3 + pairs.cell[near]
    order = np.lexsort((pairs.chart[near], square[near], cell))
    near, cell = near[order], cell[order]
    first = np.flatnonzero(np.diff(cell, prepend=-1))
    rank = np.arange(len(cell)) - np.repeat(first, np.diff(first, append=len(cell)))
    return Pairs(*(column[near[rank < MOST]] for column in pairs)), int((rank == MOST).sum())


def _haloed(
    samples: Samples, values: np.ndarray, slot: Int[np.ndarray, " m"], halo: tuple[int, int], blank: float | int
) -> np.ndarray:
    """Return bricks of samples with some samples before and after, `blank` where there are none in the lattice."""
    bricks, (before, after) = samples.bricks, halo
    side = before + SIDE + after
    spans = {
        -1: (slice(0, before), slice(SIDE - before, SIDE)),
        0: (slice(before, before + SIDE), slice(0, SIDE)),
        1: (slice(before + SIDE, side), slice(0, after)),
    }
    out = np.full((len(slot), side, side, side), blank, values.dtype)
    index, last = bricks.index[slot], np.array(bricks.slot.shape) - 1
    for step in product((-1, 0, 1) if before else (0, 1), repeat=3):
        at = index + step
        known = at.clip(0, last)
        near = np.where((at == known).all(axis=1), bricks.slot[tuple(known.T)], -1)
        there = np.flatnonzero(near >= 0)
        to, source = zip(*(spans[s] for s in step), strict=True)
        out[(there, *to)] = values[(near[there], *source)]
    for axis in range(3):
        beyond = index[:, axis, None] * SIDE + np.arange(-before, SIDE + after) >= samples.lattice.shape[axis]
        if beyond.any():
            np.moveaxis(out, axis + 1, 1)[beyond] = blank
    return out


def _stencil(halo: np.ndarray, mask: Bool[np.ndarray, "m 8 8 8"], width: int) -> np.ndarray:
    """Return the samples, (width^3, n), around the cells of a mask; the halo starts with the first cell's first."""
    side = halo.shape[1]
    weight = np.array([side * side, side, 1])
    brick, cell = np.divmod(np.flatnonzero(mask), SIDE**3)
    first = brick * side**3 + (PLACES @ weight)[cell]
    step = weight @ np.indices((width, width, width)).reshape(3, -1)
    around: np.ndarray = halo.reshape(-1)[step[:, None] + first]
    return around


def _apart(axis: int, step: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return what takes, of neighbours so many steps apart along an axis, the former ones and the latter ones."""
    whole = (slice(None),) * axis
    return (*whole, slice(-step)), (*whole, slice(step, None))


def _mapped(function: Callable[[slice], _T], count: int) -> list[_T]:
    """Run a function over chunks of so many bricks, on threads; results in order."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(function, [slice(start, start + _CHUNK) for start in range(0, count, _CHUNK)]))


def _nothing() -> Pairs:
    """Return no pairs."""
    return Pairs(*np.zeros((3, 0), np.int64))


def _joined(*pairs: Pairs) -> Pairs:
    """Return several lists of pairs as one."""
    return Pairs(*(np.concatenate(column) for column in zip(*pairs, strict=True)))
