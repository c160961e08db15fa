"""Open3D: closest points and occupancy by Embree, at samples that it is told.

In: a job whose options name the samples (`points`, indices in a .npy file). Out: their signed distances and closest
faces. It is spared the search for the band, and works in float32, so points go in recentred and scaled to the unit box.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from validate.opinion import load_open3d
from validate.peers.worker import Job, Tool, serve


@dataclass(frozen=True, slots=True, eq=False)
class _Unit:
    """The frame that Open3D works in, and the mesh in it."""

    open3d: Any
    centre: np.ndarray
    scale: float
    vertices: np.ndarray
    faces: np.ndarray

    def points(self, job: Job, index: np.ndarray) -> np.ndarray:
        """Samples of the lattice, float32."""
        scaled: np.ndarray = (job.origin + job.spacing * index - self.centre) / self.scale
        return scaled.astype(np.float32)


class _Prepared(NamedTuple):
    unit: _Unit
    points: np.ndarray


class _Result(NamedTuple):
    unit: _Unit
    scene: Any
    answer: tuple[np.ndarray, np.ndarray]


def _tool() -> Tool:
    open3d = load_open3d()

    def prepare(job: Job) -> _Prepared:
        vertices = job.arrays["vertices"]
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        centre, scale = (low + high) / 2, float((high - low).max()) / 2
        scaled = ((vertices - centre) / scale).astype(np.float32)
        unit = _Unit(open3d, centre, scale, scaled, job.arrays["faces"].astype(np.uint32))
        return _Prepared(unit, unit.points(job, np.load(job.options["points"])))

    return Tool(open3d.__version__, prepare, _bake, _look)


def _bake(given: _Prepared) -> _Result:
    tensor = given.unit.open3d.core.Tensor
    scene = given.unit.open3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(given.unit.vertices), tensor(given.unit.faces))
    return _Result(given.unit, scene, _asked(given.unit, scene, given.points))


def _asked(unit: _Unit, scene: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance, unit frame, and closest face."""
    query = unit.open3d.core.Tensor(points)
    found = scene.compute_closest_points(query)
    gap = found["points"].numpy() - points
    distance = np.sqrt((gap * gap).sum(axis=1))
    inside = scene.compute_occupancy(query).numpy() > 0
    return np.where(inside, -distance, distance), found["primitive_ids"].numpy()


def _look(job: Job, result: _Result, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    distance, face = _asked(result.unit, result.scene, result.unit.points(job, index))
    return distance.astype(np.float64) * result.unit.scale, face


if __name__ == "__main__":
    serve(_tool)
