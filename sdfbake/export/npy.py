"""Dense distances as a NumPy array, with what else is known in arrays beside it.

In: a grid. Out: OUT.npy, float32 (nx, ny, nz), which `numpy.load(..., mmap_mode="r")` opens without reading it;
OUT.uv.npy, OUT.chart.npy, OUT.seam.npy and OUT.part.npy where the grid has them; OUT.npy.json with the lattice. An .npz
could not be written a plane at a time.
"""

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from sdfbake.atomic import replacing_all
from sdfbake.densify import surface_of
from sdfbake.export.result import Exported, Progress
from sdfbake.export.room import check_room
from sdfbake.export.slabs import DENSE, beyond_the_band, carried, sample_bytes, slab_bytes, stream, written
from sdfbake.grid import Grid

_AXIS = 0  # the slowest in C order


def write(grid: Grid, path: Path, *, progress: Progress, exact: bool = False) -> Exported:
    """Write a grid as NumPy arrays, indexed [x, y, z].

    Parameters
    ----------
    grid
        Any grid.
    path
        OUT.npy.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    exact
        Whether distances beyond the band are computed from the mesh that the grid carries.

    Raises
    ------
    BadInput
        If it does not fit on the disk, or the grid carries no mesh to be exact with.
    """
    names = carried(grid)
    samples = int(np.prod(grid.lattice.shape, dtype=int))
    check_room(path, samples * sample_bytes(names), slab_bytes(grid, names, _AXIS))
    surface = surface_of(grid, exact)
    files = {name: path if name == "distance" else path.with_suffix(f".{name}.npy") for name in names}
    described = described_by(path)
    with replacing_all([*files.values(), described]) as temporary, ExitStack() as stack:
        sinks = {}
        for name, target in zip(names, temporary, strict=False):
            file = stack.enter_context(target.open("wb"))
            write_head(file, grid.lattice.shape + DENSE[name][0], DENSE[name][1])
            sinks[name] = written(file)
        stream(grid, _AXIS, sinks, surface, progress)
        named = {name: file.name for name, file in files.items()}
        record = {"arrays": named, **description(grid, exact=exact), "notes": beyond_the_band(grid, exact=exact)}
        temporary[-1].write_text(json.dumps(record, indent=2) + "\n")
    return Exported((*files.values(), described), (), beyond_the_band(grid, exact=exact))


def described_by(path: Path) -> Path:
    """Return where the description of an array is: the other formats' files have other names."""
    return path.with_name(f"{path.name}.json")


def write_head(file: BinaryIO, shape: tuple[int, ...], kind: str) -> None:
    """Write what stands before the samples of an array in C order."""
    np.lib.format.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": shape})


def description(grid: Grid, *, exact: bool) -> dict[str, Any]:
    """Return what a reader has to know of a grid's samples."""
    lattice, metadata = grid.lattice, grid.metadata
    return {
        "lattice": {
            "origin": lattice.origin.tolist(),
            "spacing": lattice.spacing,
            "shape": list(lattice.shape),
            "samples": "on nodes: position = origin + spacing * [i, j, k], indexed [x, y, z]",
        },
        "units": metadata.units,
        "sign": "negative inside",
        "band": None if exact else metadata.band,
        "source": metadata.source,
        "parts": list(metadata.parts),
        "charts": metadata.charts,
        "texture": metadata.texture,
        "tool_version": metadata.tool_version,
    }
