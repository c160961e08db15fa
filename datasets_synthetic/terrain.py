"""Terrain: a rounded block with rolling hills on top.

In: half extents, waves of the hills, rounding of the edges. Out: an `Implicit`. The block is the rounded intersection
(`field.SmoothMax`) of five half spaces and of what is below the hills,

    f = z - c - h(x, y),   h = sum_j a_j sin(k_j.(x, y) + phi_j).
"""

from dataclasses import dataclass
from functools import cache
from math import ceil

import numpy as np
from jaxtyping import Float

from datasets_synthetic.field import SmoothMax
from datasets_synthetic.implicit import Implicit
from datasets_synthetic.layout import CubeMap
from datasets_synthetic.net import lattice_mesh
from datasets_synthetic.offset import dot

#: The flat sides, in the order of the pieces: +x, -x, +y, -y, -z; the hills are the last.
_FLAT = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], np.float64)
#: Height, wave vector and phase of each wave of the hills.
_HILLS = ((0.035, (5.0, 2.0), 0.4), (0.03, (-3.0, 5.0), 1.1), (0.012, (8.0, -6.0), 2.0))
#: Newton's iteration starts within the hills' height of the root; it is quadratic from there.
_NEWTON = 12
#: Edges of the samples' mesh.
_SAMPLES = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Half spaces and hills; the `Pieces` of the terrain."""

    half: tuple[float, float, float]
    heights: Float[np.ndarray, " w"]
    waves: Float[np.ndarray, "w 2"]
    phases: Float[np.ndarray, " w"]

    @property
    def steepest(self) -> float:
        """The hills' slope is at most sum a |k|."""
        return float(np.hypot(1.0, self.heights @ np.linalg.norm(self.waves, axis=1)))

    @property
    def bending(self) -> Float[np.ndarray, " m"]:
        """Planes do not bend, the hills at most by sum a |k|^2."""
        return np.append(np.zeros(5), self.heights @ np.sum(self.waves**2, axis=1))

    def slopes(self, p: Float[np.ndarray, "3 n"]) -> tuple[np.ndarray, np.ndarray]:
        """Values (6, n) and gradients (6, 3, n)."""
        angle = self._angle(p)
        hills = p[2] - self.half[2] - self.heights @ np.sin(angle)
        x, y, z = self.half
        value = np.concatenate([_FLAT @ p - np.array([[x], [x], [y], [y], [z]]), hills[None]])
        gradient = np.empty((6, 3, p.shape[1]))
        gradient[:5] = _FLAT[:, :, None]
        gradient[5, :2] = -(self.waves.T * self.heights) @ np.cos(angle)
        gradient[5, 2] = 1.0
        return value, gradient

    def curved(self, p: Float[np.ndarray, "3 n"], weight: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "6 n"]:
        """Only the hills have a Hessian: sum a k k^T sin."""
        kx, ky = self.waves.T
        curved = np.zeros((6, p.shape[1]))
        swell = np.sin(self._angle(p)) * weight[5]
        curved[[0, 1, 5]] = (np.stack([kx * kx, ky * ky, kx * ky]) * self.heights) @ swell
        return curved

    def _angle(self, p: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "w n"]:
        angle: Float[np.ndarray, "w n"] = self.waves @ p[:2] + self.phases[:, None]
        return angle


@cache
def terrain(half: tuple[float, float, float] = (0.9, 0.9, 0.5), rounding: float = 0.06) -> Implicit:
    """Build the terrain about the origin, its hills towards +z; the same one every time, as sampling it takes a moment.

    The middle sees all of the surface, which the triangulation asks for: F grows along each ray from it.
    """
    heights, waves, phases = (np.array(column) for column in zip(*_HILLS, strict=True))
    field, layout = SmoothMax(Block(half, heights, waves, phases), rounding), CubeMap(half)

    def triangulate(edge: float) -> tuple[np.ndarray, np.ndarray]:
        nx, ny, nz = (max(2, ceil(2 * extent / edge)) for extent in half)
        cube, faces, _ = lattice_mesh((nx, ny, nz))
        return along_rays(field, cube * half), faces

    return Implicit.of(field, layout, triangulate, _SAMPLES, "terrain")


def along_rays(field: SmoothMax, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Move points to the zero level along the rays from the origin, by Newton's iteration on their scale."""
    p = p.T
    for _ in range(_NEWTON):
        f, gradient, _ = field.jet(p)
        p = p * (1 - f / dot(gradient, p))
    return np.ascontiguousarray(p.T)
