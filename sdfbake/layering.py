"""Texture coordinates as layers, baked.

In: a mesh with texture coordinates, and the distances and closest faces of a grid. Out: `Layers`: at every corner of
every cell with surface, for every (virtual) chart near the cell, the chart's map continued past its border.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import product

import numpy as np
from jaxtyping import Float, Int, UInt16

from sdfbake import virtual
from sdfbake.bricks import SIDE, Bricks
from sdfbake.chartmaps import ChartMaps, unit_normals
from sdfbake.lattice import Lattice
from sdfbake.layers import FULL, NORMAL, Layers
from sdfbake.mesh import Mesh
from sdfbake.nearcharts import PLACES, Rows, Samples, folds, near_charts, surface_cells

Progress = Callable[[str, float], None]
_ROWS_AT_ONCE = 256  # some 40,000 samples that hold a value: a few MB of temporaries, in the caches
_STAGE = "layers"


def layer(
    mesh: Mesh,
    lattice: Lattice,
    bricks: Bricks,
    distance: Float[np.ndarray, "k 8 8 8"],
    face: Int[np.ndarray, "k 8 8 8"],
    progress: Progress | None = None,
) -> tuple[Layers, int]:
    """Bake the layers of a mesh.

    Parameters
    ----------
    mesh
        With texture coordinates, finite, and charts.
    lattice, bricks
        Where the samples lie.
    distance
        Signed or not, world units, float32; a lower bound where it is more than a few voxels.
    face
        Face of the mesh closest to every sample, int32; -1 where it is not known, at samples that are not corners of
        cells with surface.
    progress
        Called with a stage and the share of it that is done, 0 to 1.

    Returns
    -------
    layers
        Bytes depend on the arguments only.
    overflow
        Cells with more than three charts near, of which they keep the three nearest to their centre.

    Raises
    ------
    ValueError
        If the mesh has no texture coordinates.
    """
    if mesh.uv is None:
        raise ValueError("layers need texture coordinates")
    report = progress or (lambda stage, share: None)
    report(_STAGE, 0)
    samples = Samples(lattice, bricks, distance, face)
    cells = surface_cells(samples)
    normals, _ = unit_normals(mesh.vertices[mesh.faces])
    piece, of = virtual.split(mesh, normals, folds(samples, cells, normals, mesh.chart))
    maps = ChartMaps.of(mesh, lattice, piece)
    near, overflow = near_charts(samples, cells, maps)
    layers = _filled(samples, maps, of, _corners(bricks, near), report)
    report(_STAGE, 1)
    return layers, overflow


def _corners(bricks: Bricks, cells: Rows) -> Rows:
    """Return the samples that are a corner of some cells, chart by chart; rows sorted."""
    corner = cells.mask
    for axis in (1, 2, 3):  # a cell's corners are its lowest one and, along each axis, the next
        wide = np.insert(corner, SIDE, False, axis=axis)
        ends = np.moveaxis(wide, axis, 0)
        ends[1:] |= np.moveaxis(corner, axis, 0)
        corner = wide
    steps = list(product((0, 1), repeat=3))
    keys, rows, parts = [], [], []
    for step in steps:
        # What sticks out of a brick is the first layer of samples of the next one.
        part = corner[(slice(None), *(slice(SIDE, None) if s else slice(0, SIDE) for s in step))]
        row = np.flatnonzero(part.reshape(len(part), -1).any(axis=1))
        slot = bricks.slot[tuple((bricks.index[cells.slot[row]] + step).T)]
        keys.append((slot.astype(np.int64) << 32) | cells.chart[row])
        rows.append(row)
        parts.append(part)
    names, place = np.unique(np.concatenate(keys), return_inverse=True)
    mask = np.zeros((len(names), SIDE, SIDE, SIDE), bool)
    for step, row, part, to in zip(
        steps, rows, parts, np.split(place.reshape(-1), np.cumsum([len(k) for k in keys])[:-1]), strict=True
    ):
        span = (slice(0, 1) if s else slice(None) for s in step)
        mask[(to, *span)] |= part[row]  # the bricks of one step are all different
    return Rows(names >> 32, names & 0xFFFFFFFF, mask)


def _filled(samples: Samples, maps: ChartMaps, of: Int[np.ndarray, " c"], rows: Rows, report: Progress) -> Layers:
    """Evaluate all samples that hold a value, and store them in few bits."""
    size = rows.mask.size
    border, normal = np.full(size, np.inf, np.float16), np.zeros((size, 3), np.int8)
    code = np.rint(maps.normals * NORMAL).astype(np.int8)
    channel, first = samples.face.reshape(-1), samples.bricks.index[rows.slot].astype(np.float64) * SIDE
    chunks = [slice(start, start + _ROWS_AT_ONCE) for start in range(0, len(rows.mask), _ROWS_AT_ONCE)]

    def evaluate(chunk: slice) -> Float[np.ndarray, "n 2"]:
        place = np.flatnonzero(rows.mask[chunk]) + chunk.start * SIDE**3
        row, sample = place // SIDE**3, place % SIDE**3
        chart, p = rows.chart.take(row), first.take(row, axis=0) + PLACES.take(sample, axis=0)
        face = channel.take(rows.slot.take(row) * SIDE**3 + sample).astype(np.int64)
        other = np.flatnonzero((face < 0) | (maps.piece.take(face) != chart))
        face[other] = maps.closest(p[other], chart[other])[1]
        values = maps.at(p, face)
        border[place], normal[place] = values.border, code.take(face, axis=0)
        return values.uv

    found = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for done, uv in enumerate(pool.map(evaluate, chunks)):
            found.append(uv)
            report(_STAGE, (done + 1) / (len(chunks) + 1))
    steps, offset, scale = _in_steps(np.concatenate([np.zeros((0, 2)), *found]), rows, len(of))
    shape, slot, chart = rows.mask.shape, rows.slot.astype(np.int32), rows.chart.astype(np.int32)
    values = steps.reshape(*shape, 2), border.reshape(shape), normal.reshape(*shape, 3)
    return Layers(slot, chart, *values, offset, scale, of)


def _in_steps(
    uv: Float[np.ndarray, "n 2"], rows: Rows, charts: int
) -> tuple[UInt16[np.ndarray, "s 2"], Float[np.ndarray, "c 2"], Float[np.ndarray, "c 2"]]:
    """Return texture coordinates as 16 bits of the range of their chart, at all samples, and the charts' ranges."""
    count = np.count_nonzero(rows.mask.reshape(-1, SIDE**3), axis=1)
    offset, scale = _ranges(uv, count, rows.chart, charts)
    steps = np.zeros((rows.mask.size, 2), np.uint16)
    end = np.cumsum(count)
    for start in range(0, len(count), _ROWS_AT_ONCE):
        part = slice(start, start + _ROWS_AT_ONCE)
        values = uv[end[start] - count[start] : end[part][-1]]
        chart = np.repeat(rows.chart[part], count[part])
        place = np.flatnonzero(rows.mask[part]) + start * SIDE**3
        steps[place] = np.rint((values - offset[chart]) * (FULL / scale)[chart])
    return steps, offset, scale


def _ranges(
    uv: Float[np.ndarray, "n 2"], count: Int[np.ndarray, " m"], chart: Int[np.ndarray, " m"], charts: int
) -> tuple[Float[np.ndarray, "c 2"], Float[np.ndarray, "c 2"]]:
    """Return the charts' least texture coordinates and their extents, 1 for 0; rows hold so many values each."""
    low, high = np.full((charts, 2), np.inf), np.full((charts, 2), -np.inf)
    if len(uv):
        first = np.cumsum(count) - count
        np.minimum.at(low, chart, np.minimum.reduceat(uv, first, axis=0))
        np.maximum.at(high, chart, np.maximum.reduceat(uv, first, axis=0))
    low, high = (np.where(np.isfinite(end), end, 0) for end in (low, high))
    return low, np.where(high > low, high - low, 1)
