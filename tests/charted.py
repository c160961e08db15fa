"""Grids with texture coordinates as faces and as layers, made by hand: no bake has a part in them."""

from dataclasses import replace

import numpy as np

from sdfbake.bricks import REACH, SIDE, in_lattice, sample_index
from sdfbake.closest import Surface
from sdfbake.faces import NONE, FaceTable
from sdfbake.layers import FULL, NORMAL, Layers


def with_faces(grid, mesh):
    """Name the closest face of a mesh at every sample near the surface, and nothing else."""
    near = (np.abs(grid.distance) <= REACH * grid.lattice.spacing) & in_lattice(grid.bricks.index, grid.lattice.shape)
    face = np.full(grid.distance.shape, NONE, np.int32)
    points = grid.lattice.to_world(sample_index(grid.bricks.index)[near])
    face[near] = Surface.of(mesh).closest(points).face
    metadata = grid.metadata.model_copy(update={"uv_modes": ("faces",), "charts": int(mesh.chart.max()) + 1})
    return replace(grid, uv=None, chart=None, face=face, surface=FaceTable.of(mesh), metadata=metadata)


def with_layers(grid, layers, charts):
    """Give a grid layers, and nothing else."""
    metadata = grid.metadata.model_copy(update={"uv_modes": ("layers",), "charts": charts})
    return replace(grid, uv=None, chart=None, layers=layers, metadata=metadata)


def with_all(grid, mesh, layers):
    """Give a grid that has texture coordinates at its samples the two other representations, too."""
    faces = with_faces(grid, mesh)
    metadata = faces.metadata.model_copy(update={"uv_modes": ("faces", "layers", "grid")})
    return replace(faces, uv=grid.uv, chart=grid.chart, layers=layers, metadata=metadata)


def layers_of(grid, codes, border, normal, *, offset=None, scale=None, of=None):
    """Cut dense layers (charts first) into rows; infinite borders say nothing."""
    charts = len(border)
    rows = []
    at = sample_index(grid.bricks.index).reshape(-1, 3)
    inside = in_lattice(grid.bricks.index, grid.lattice.shape).reshape(-1)
    at = np.minimum(at, np.array(grid.lattice.shape) - 1)
    for chart in range(charts):
        values = np.where(inside, border[chart][tuple(at.T)], np.inf).reshape(-1, SIDE, SIDE, SIDE)
        speaks = np.isfinite(values).any(axis=(1, 2, 3))
        uv = codes[chart][tuple(at.T)].reshape(*values.shape, 2)
        n = normal[chart][tuple(at.T)].reshape(*values.shape, 3)
        rows += [(brick, chart, uv[brick], values[brick], n[brick]) for brick in np.flatnonzero(speaks)]
    rows.sort(key=lambda row: row[:2])
    brick, chart, uv, values, n = (list(column) for column in zip(*rows, strict=True))
    values = np.array(values).astype(np.float16)
    n = np.where(np.isfinite(values)[..., None], np.rint(NORMAL * np.array(n)), 0)
    return Layers(
        np.array(brick, np.int32),
        np.array(chart, np.int32),
        np.array(uv).astype(np.uint16),
        values,
        n.astype(np.int8),
        np.zeros((charts, 2)) if offset is None else np.asarray(offset, float),
        np.full((charts, 2), float(FULL)) if scale is None else np.asarray(scale, float),
        np.arange(charts, dtype=np.int32) if of is None else np.asarray(of, np.int32),
    )


def ask(field, points, n):
    """Texture coordinates at points with given normals: uv, gradient, chart, seam."""

    def program(xp, *c):
        spot = field.locate(xp, (c[0], c[1], c[2]), xp.full(c[0], True))
        mapped = field.uv_at(xp, spot, (c[3], c[4], c[5]))
        entries = [mapped.u, mapped.v, *mapped.du, *mapped.dv]
        return {str(i): e for i, e in enumerate(entries)} | {"chart": mapped.chart, "seam": xp.integer(mapped.seam)}

    n = np.broadcast_to(np.asarray(n, float), points.shape)
    out = field.engine.run(program, [*(points - field.anchor).T, *n.T])
    columns = np.stack([out[str(i)] for i in range(8)], axis=-1).astype(float)
    return columns[:, :2], columns[:, 2:].reshape(-1, 2, 3), out["chart"], out["seam"] > 0
