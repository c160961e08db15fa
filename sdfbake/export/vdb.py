"""Grids as OpenVDB level sets.

In: a grid. Out: a file with the grids `sdf`, and where there are any `uv`, `chart`, `seam` and `part`. A brick is a
leaf, and the index space is that of the lattice. Ids are floats: every reader takes those, and they are exact to 2^24.
"""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from sdfbake.bricks import in_lattice
from sdfbake.export.result import Exported, Progress, silent
from sdfbake.export.texture import Textured, textured
from sdfbake.export.vdbfile import Entry, Named, save
from sdfbake.export.vdbtree import Channel
from sdfbake.grid import Grid

HALF_WIDTH = 3.0  # voxels: OpenVDB's own for level sets, which its tools expect
# The corners of a cell with surface in it are no farther from the surface than the cell's diagonal. Where an open mesh
# has no surface but its signs change, across a hole, corners may be farther: those have no texture coordinates.
_CELL = 3**0.5 * (1 + 1e-6)


class _Stored(NamedTuple):
    """Samples of the bricks: which the lattice has, and distances without signs."""

    inside: Bool[np.ndarray, "k 8 8 8"]
    magnitude: Float[np.ndarray, "k 8 8 8"]


def write(grid: Grid, path: Path, *, progress: Progress = silent) -> Exported:
    """Write a level set.

    Parameters
    ----------
    grid
        Any grid, whole.
    path
        The file.
    progress
        Called with a stage and the share of it that is done, 0 to 1.

    Returns
    -------
    Exported
        Distances are stored as they are within `HALF_WIDTH` voxels of the surface, and clamped to that beyond; the
        other grids where the cell of a hit may ask.

    Raises
    ------
    BadInput
        If the file cannot be written.
    """
    progress("vdb", 0)
    stored = _Stored(in_lattice(grid.bricks.index, grid.lattice.shape), np.abs(grid.distance))
    near = stored.inside & (stored.magnitude <= _CELL * grid.lattice.spacing)
    grids = [Named("sdf", _level_set(grid, stored), _about(grid))]
    progress("vdb", 0.3)
    found = textured(grid, near)
    if found is not None:
        grids += _textures(grid, found)
    if grid.part is not None:
        parts = Channel(grid.bricks.index, grid.part.astype(np.float32), near, np.float32(-1))
        grids.append(Named("part", parts, {"parts": json.dumps(grid.metadata.parts)}))
    progress("vdb", 0.6)
    save(path, grid.lattice, grids)
    progress("vdb", 1)
    return Exported((path,), _dropped(grid), _notes(grid, textured=found is not None))


def _level_set(grid: Grid, stored: _Stored) -> Channel:
    """Return the distances: a narrow band, or where they need not be distances all that are stored."""
    if grid.metadata.source == "dense":
        active = stored.inside
        background = stored.magnitude.max(initial=np.float32(HALF_WIDTH * grid.lattice.spacing))
    else:
        background = np.float32(HALF_WIDTH * grid.lattice.spacing)
        active = stored.inside & (stored.magnitude < background)
    minus = stored.inside & (grid.distance < 0)
    return Channel(grid.bricks.index, grid.distance, active, background, minus, grid.bricks.far < 0)


def _about(grid: Grid) -> dict[str, Entry]:
    """Return what the file says about the level set."""
    metadata = grid.metadata
    return {"class": "level set", "creator": f"sdf-ray-differentials {metadata.tool_version}", "units": metadata.units}


def _textures(grid: Grid, found: Textured) -> list[Named]:
    """Return texture coordinates, their charts and the cells where charts meet."""
    index, known = grid.bricks.index, found.chart >= 0
    about: dict[str, Entry] = {"vector_type": "invariant"}
    if grid.metadata.texture is not None:
        about["texture"] = grid.metadata.texture
    return [
        Named("uv", Channel(index, found.uv, known, np.float32(0)), about),
        Named("chart", Channel(index, found.chart.astype(np.float32), known, np.float32(-1)), {}),
        Named("seam", Channel(index, found.seam, found.seam, np.bool_(False)), {}),
    ]


def _dropped(grid: Grid) -> tuple[str, ...]:
    """Say what the file lacks."""
    dropped = []
    if grid.metadata.source != "dense":
        dropped.append(
            f"distances beyond {HALF_WIDTH:g} voxels from the surface: they are the background, negative inside"
        )
    if grid.metadata.uv_modes and grid.metadata.uv_modes != ("grid",):
        dropped.append("texture coordinates by face or by layer: there is one value per voxel, of the closest point")
    return tuple(dropped)


def _notes(grid: Grid, *, textured: bool) -> tuple[str, ...]:
    """Say what a reader has to know."""
    notes = [f"voxel [i, j, k] is the sample at origin + {grid.lattice.spacing:g} [i, j, k], its value that of a point"]
    if textured:
        notes.append("uv holds u, v, 0; where seam is true, interpolation towards +x, +y, +z would mix charts")
    if grid.metadata.source == "dense":
        notes.append("the numbers of this grid need not be distances: every stored sample is active")
    return tuple(notes)
