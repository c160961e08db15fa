"""OpenVDB: a level set of half width 3 from polygons.

In: a job. Out: a FloatGrid in voxels. Its Python module is Debian's, for the system's Python.
"""

from pathlib import Path
from typing import Any

import numpy as np

from validate.peers.worker import Job, Tool, serve

HALF_WIDTH = 3.0


def _tool() -> Tool:
    try:
        import openvdb as vdb  # its name from version 11 on
    except ImportError:
        import pyopenvdb as vdb

    def prepare(job: Job) -> tuple[np.ndarray, np.ndarray]:
        return job.in_voxels(), job.arrays["faces"].astype(np.uint32)

    def bake(given: tuple[np.ndarray, np.ndarray]) -> Any:
        points, triangles = given
        return vdb.FloatGrid.createLevelSetFromPolygons(points, triangles=triangles, halfWidth=HALF_WIDTH)

    def look(job: Job, grid: Any, index: np.ndarray) -> tuple[np.ndarray, None]:
        value = grid.getConstAccessor().getValue
        return np.array([value((i, j, k)) for i, j, k in index.tolist()]) * job.spacing, None

    def save(grid: Any, path: Path) -> Path:
        path = path.with_suffix(".vdb")
        vdb.write(str(path), grids=[grid])
        return path

    return Tool(".".join(map(str, vdb.LIBRARY_VERSION)), prepare, bake, look, save)


if __name__ == "__main__":
    serve(_tool)
