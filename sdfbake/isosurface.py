"""From a grid back to a mesh: where the trilinear interpolant's values along the lattice's edges are zero.

In: a grid. Out: a closed, outward `Mesh`, by libigl's marching cubes (Lorensen and Cline 1987) over the cells with
surface in them and no others, so that memory grows with the surface. Its table leaves no cracks; where surface leaves
the lattice, the mesh is open.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake.bricks import SIDE, in_lattice
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.mesh import Mesh

_BRICKS_AT_ONCE = 512
# libigl's order of a cell's corners.
_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
# Vertices keep this distance, in voxels, from samples that are zero or nearly so: else triangles without area would
# stand around them. Far above float64's rounding of a lattice index (1e-12 at 8192), far below float32's of a distance.
_OFF = 1e-6


class _Cells(NamedTuple):
    """Cells of a piece of the grid that have surface: keys of their corners' samples, and the values there."""

    key: Int[np.ndarray, "n 8"]
    value: Float[np.ndarray, "n 8"]


def isosurface(grid: Grid) -> Mesh:
    """Return the zero level of a grid as a mesh.

    Parameters
    ----------
    grid
        Distances or anybody's numbers, negative inside; 0 counts as inside.

    Returns
    -------
    Mesh
        World; one vertex per lattice edge with a change of sign, at the root of the linear interpolant. Where the
        values are distances from a surface of radius of curvature r, a vertex is within h^2 / (8 (r - h)) of it.

    Raises
    ------
    BadInput
        If the grid has no surface.

    Examples
    --------
    >>> from datasets_synthetic import shape
    >>> isosurface(Grid.from_function(shape("sphere"), 16)).faces.shape[1]
    3
    """
    import igl  # here, so that `import sdfbake` is light

    cells = _surface_cells(grid)
    if len(cells.key) == 0:
        raise BadInput("the grid has no surface: all its distances have the same sign")
    key, first, corner = np.unique(cells.key, return_index=True, return_inverse=True)
    value = cells.value.reshape(-1)[first].astype(np.float64)
    p_grid = np.stack(np.unravel_index(key, grid.lattice.shape), axis=-1).astype(np.float64)
    corner = np.ascontiguousarray(corner.reshape(-1, 8), np.int64)
    _, faces, edges = igl.marching_cubes(value, p_grid, corner, 0.0)
    vertices = grid.lattice.to_world(_on_edges(edges, value, p_grid))
    return Mesh(vertices, np.asarray(faces, np.int64), units=grid.metadata.units)


def _on_edges(
    edges: dict[int, int], value: Float[np.ndarray, " n"], p_grid: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "v 3"]:
    """Place the vertices: `edges` has, for a pair of samples in one key, the vertex between them."""
    pair = np.fromiter(edges.keys(), np.int64, len(edges))
    vertex = np.fromiter(edges.values(), np.int64, len(edges))
    a, b = pair & 0xFFFFFFFF, pair >> 32
    # libigl's own vertices may coincide at a sample that is zero; these are the same but for that.
    t = (value[a] / (value[a] - value[b])).clip(_OFF, 1 - _OFF)[:, None]
    placed = np.empty((len(edges), 3))
    placed[vertex] = p_grid[a] + t * (p_grid[b] - p_grid[a])
    return placed


def _surface_cells(grid: Grid) -> _Cells:
    """Find all cells with corners of both signs, a piece of the bricks at a time."""
    pieces = []
    for start in range(0, len(grid.bricks), _BRICKS_AT_ONCE):
        part = slice(start, start + _BRICKS_AT_ONCE)
        value, known = _padded(grid, part)
        brick, *within = np.nonzero(_mixed(value > 0) & _all(known))
        at = np.stack(within, axis=-1)[:, None] + _CORNERS
        sample = grid.bricks.index[part][brick][:, None].astype(np.int64) * SIDE + at
        key = np.ravel_multi_index(tuple(np.moveaxis(sample, -1, 0)), grid.lattice.shape)
        pieces.append(_Cells(np.asarray(key, np.int64), value[brick[:, None], *np.moveaxis(at, -1, 0)]))
    none = _Cells(np.empty((0, 8), np.int64), np.empty((0, 8), np.float32))
    return _Cells(*(np.concatenate(columns) for columns in zip(none, *pieces, strict=True)))


def _padded(grid: Grid, part: slice) -> tuple[Float[np.ndarray, "m 9 9 9"], Bool[np.ndarray, "m 9 9 9"]]:
    """Return bricks with the first samples of the bricks that follow along each axis, and which of them are known."""
    index = grid.bricks.index[part]
    value = np.zeros((len(index), SIDE + 1, SIDE + 1, SIDE + 1), np.float32)
    known = np.zeros(value.shape, bool)
    slots = np.pad(grid.bricks.slot, (0, 1), constant_values=-1)
    for step in np.ndindex(2, 2, 2):
        slot = slots[tuple((index + step).T)]
        there = np.flatnonzero(slot >= 0)
        to = tuple(slice(SIDE, None) if s else slice(0, SIDE) for s in step)
        of = tuple(slice(0, 1) if s else slice(None) for s in step)
        value[there, *to] = grid.distance[slot[there], *of]
        known[there, *to] = in_lattice(grid.bricks.index[slot[there]], grid.lattice.shape)[:, *of]
    return value, known


def _mixed(outside: Bool[np.ndarray, "m 9 9 9"]) -> Bool[np.ndarray, "m 8 8 8"]:
    """Say which cells have corners outside and corners not outside."""
    mixed: Bool[np.ndarray, "m 8 8 8"] = ~_all(outside) & ~_all(~outside)
    return mixed


def _all(v: Bool[np.ndarray, "m 9 9 9"]) -> Bool[np.ndarray, "m 8 8 8"]:
    """Say for which cells something holds at all eight corners."""
    v = v[:, 1:] & v[:, :-1]
    v = v[:, :, 1:] & v[:, :, :-1]
    every: Bool[np.ndarray, "m 8 8 8"] = v[:, :, :, 1:] & v[:, :, :, :-1]
    return every
