"""The sphere, textured by an equiangular cube map.

In: radius and centre. Out: an exact shape. Each cube-face coordinate is (4 / pi) atan of the gnomonic one, so texture
gradients stay within a factor of sqrt(2) of one another, and there is no pole; the six faces unfold by the net of the
cube.
"""

from dataclasses import dataclass
from math import ceil, pi

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic.net import ACROSS, AXIS, UPWARD, Net, face_of, lattice_mesh
from sdfbake.mesh import Mesh

_CUBE = Net.fitted((1.0, 1.0, 1.0))


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball; six charts, the faces of the cube map (ids of `net.FACES`).

    At the centre, where every direction is normal, +z is returned, with a Hessian of 0.
    """

    radius: float
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    part_names: tuple[str, ...] = ("sphere",)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and greatest corner."""
        return np.asarray(self.centre) + self.radius * np.array([[-1.0], [1.0]])

    @property
    def charts(self) -> int:
        """Six faces of the cube map."""
        return 6

    @property
    def area(self) -> float:
        """4 pi r^2."""
        return 4 * pi * self.radius**2

    @property
    def volume(self) -> float:
        """(4 / 3) pi r^3."""
        return 4 / 3 * pi * self.radius**3

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """|p - centre| - r."""
        x, y, z = p.T - np.asarray(self.centre)[:, None]
        distance: Float[np.ndarray, " n"] = np.sqrt(x * x + y * y + z * z) - self.radius
        return distance

    def normal(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Direction from the centre."""
        offset = p - np.asarray(self.centre)
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        at_centre = length == 0
        return np.where(at_centre, np.array([0.0, 0.0, 1.0]), offset / np.where(at_centre, 1.0, length))

    def hessian(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """(I - n n^T) / |p - centre|."""
        n, length = self.normal(p), self.distance(p) + self.radius
        inverse = np.where(length == 0, 0.0, 1 / np.where(length == 0, 1.0, length))
        flat = np.eye(3) - n[:, :, None] * n[:, None, :]
        hessian: Float[np.ndarray, "n 3 3"] = inverse[:, None, None] * flat
        return hessian

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Equiangular cube map, unfolded; see `net`."""
        n, face = self.normal(p), self.chart(p)
        major = np.abs(np.take_along_axis(n, AXIS[face][:, None], axis=1))
        return _CUBE.uv(face, 4 / pi * np.arctan(n / major))

    def uv_gradient(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
        """Gradient of atan(a / b) is (b grad a - a grad b) / (a^2 + b^2), which has no radial share."""
        n, face = self.normal(p), self.chart(p)
        axis = AXIS[face]
        b = np.take_along_axis(n, axis[:, None], axis=1)[:, 0]
        toward = np.eye(3)[axis] * np.sign(b)[:, None]
        rows = []
        for tangent, scale in ((ACROSS[face], _CUBE.scale[0]), (UPWARD[face], _CUBE.scale[1])):
            a = np.sum(tangent * n, axis=1)
            turn = (np.abs(b)[:, None] * tangent - a[:, None] * toward) / (a * a + b * b)[:, None]
            rows.append(4 / pi * scale / self.radius * turn)
        return np.stack(rows, axis=1)

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Face of the cube map: the largest component of the normal, the lowest id on ties."""
        return face_of(self.normal(p), (0.0, 0.0, 0.0))

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """One part."""
        return np.zeros(len(p), np.int64)

    def intersect(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Lesser root of the quadratic, from the ray's closest approach (no cancellation far away)."""
        offset = o - np.asarray(self.centre)
        middle = -np.sum(offset * d, axis=1)
        closest = offset + middle[:, None] * d
        gap = (self.radius - np.linalg.norm(closest, axis=1)) * (self.radius + np.linalg.norm(closest, axis=1))
        t = middle - np.sqrt(np.maximum(gap, 0.0))
        return np.where((gap >= 0) & (t >= 0), t, np.inf)

    def mesh(self, edge: float) -> Mesh:
        """Cube-sphere whose lattice is even in texture space."""
        count = max(2, ceil(pi / 2 * self.radius / edge))
        cube, faces, face = lattice_mesh((count, count, count))
        gnomonic = np.tan(pi / 4 * cube)
        directions = gnomonic / np.linalg.norm(gnomonic, axis=1, keepdims=True)
        uv = _CUBE.uv(np.repeat(face, 3), cube[faces].reshape(-1, 3)).reshape(-1, 3, 2)
        vertices = np.asarray(self.centre) + self.radius * directions
        return Mesh(vertices, faces, uv, face, part_names=self.part_names)
