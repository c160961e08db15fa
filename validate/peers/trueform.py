"""Trueform: a dense grid, exact within 3 voxels of the surface, swept beyond.

In: a job. Out: a dense float32 volume in voxels. Its licence, PolyForm Noncommercial, allows comparing; nothing
of it is needed, installed or shipped by this project.
"""

from importlib.metadata import version
from typing import Any

import numpy as np

from validate.peers.worker import Job, Tool, serve

BAND = 3


def _tool() -> Tool:
    import trueform

    def prepare(job: Job) -> tuple[np.ndarray, np.ndarray, tuple[int, int, int]]:
        return job.arrays["faces"].astype(np.int32), job.in_voxels(), job.shape

    def bake(given: tuple[np.ndarray, np.ndarray, tuple[int, int, int]]) -> Any:
        faces, points, shape = given
        unit, zero = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
        return trueform.mesh_sdf((faces, points), shape, unit, zero, mode="banded", band=BAND)

    def look(job: Job, volume: Any, index: np.ndarray) -> tuple[np.ndarray, None]:
        return volume.samples[tuple(index.T)].astype(np.float64) * job.spacing, None

    return Tool(version("trueform"), prepare, bake, look)


if __name__ == "__main__":
    serve(_tool)
