"""OpenVDB reads a level set: values, transform, background, class, names.

In: a .vdb file. Out: signed distances of all samples, and the vertices of the quads that it extracts itself.
"""

from typing import Any

import numpy as np

from validate.peers.reading.question import Arrays, Question, Reader, Words, serve

_SOME = 4096  # samples asked for one by one


def module() -> Any:
    """Import it by either of its names."""
    try:
        import openvdb as vdb  # its name from version 11 on
    except ImportError:
        import pyopenvdb as vdb
    return vdb


def look_at(vdb: Any, path: str, asked: Question) -> "tuple[Arrays, Words]":
    """Answer from the grids of a .vdb file."""
    names = [grid.name for grid in vdb.readAllGridMetadata(path)]
    grid = vdb.read(path, "sdf")
    some = asked.samples[:_SOME].tolist()
    accessor = grid.getConstAccessor()
    arrays = {
        "value": _copied(grid, asked.samples),
        "one_by_one": np.array([accessor.getValue((i, j, k)) for i, j, k in some]),
        "active": _active(grid, asked.samples),
        "position": np.array([grid.transform.indexToWorld((i, j, k)) for i, j, k in some]),
        "background": np.array([grid.background]),
        "active_voxels": np.array([grid.activeVoxelCount()]),
        "surface": np.asarray(grid.convertToQuads()[0], np.float64),
    }
    for name in {"chart", "part", "seam"} & set(names):
        arrays[name] = _copied(vdb.read(path, name), asked.samples, kind=bool if name == "seam" else np.float32)
    if "uv" in names:
        arrays["uv"] = _copied(vdb.read(path, "uv"), asked.samples, 3)[:, :2]
    return arrays, {"class": str(grid.gridClass), "type": grid.valueTypeName, "grids": ", ".join(names)}


def _copied(grid: Any, index: np.ndarray, *width: int, kind: type = np.float32) -> np.ndarray:
    """Copy all samples up to the last that is asked for."""
    dense = np.empty((*(index.max(axis=0) + 1), *width), kind)
    grid.copyToArray(dense)
    found: np.ndarray = dense[tuple(index.T)]
    return found


def _active(grid: Any, index: np.ndarray) -> np.ndarray:
    """Say which samples are active: a copy with all those at 1, the others at 0."""
    mask = grid.deepCopy()
    mask.mapOn(lambda value: 1.0)
    mask.mapOff(lambda value: 0.0)
    return _copied(mask, index) > 0


def _reader() -> Reader:
    vdb = module()

    def look(path: str, asked: Question) -> "tuple[Arrays, Words]":
        return look_at(vdb, path, asked)

    return Reader(".".join(map(str, vdb.LIBRARY_VERSION)), str, look)


if __name__ == "__main__":
    serve(_reader)
