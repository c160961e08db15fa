"""Textures for surfaces without a parametrisation of their own: by direction from the middle, or by the normal.

In: surface points y and unit normals n. Out: chart, uv, and the gradient of uv in space; its share along the surface is
the caller's to take. Charts are six, laid out by the net of the cube: either the equiangular cube map of q = y / h,
each coordinate (4 / pi) atan of the gnomonic one, q_a / |q_b|; or projections along the axes.
"""

from dataclasses import dataclass
from math import ceil, pi

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic.net import ACROSS, AXIS, SIGN, UPWARD, Net, face_of, lattice_mesh

_CUBE = Net.fitted((1.0, 1.0, 1.0))


@dataclass(frozen=True, slots=True)
class CubeMap:
    """Cube map about the origin; charts are the faces of the cube (ids of `net.FACES`).

    Attributes
    ----------
    half
        Half extents h along x, y, z: the cut between two faces runs where p / h is equally long along both axes.
    """

    half: tuple[float, float, float]

    def chart(self, y: Float[np.ndarray, "n 3"], n: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Face of the greatest component of y / h, the lowest id on ties; the normal does not matter."""
        return face_of(y / np.asarray(self.half), (0.0, 0.0, 0.0))

    def uv(self, y: Float[np.ndarray, "n 3"], chart: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Net of the cube at (4 / pi) atan of the gnomonic coordinates on the given faces."""
        q = y / np.asarray(self.half)
        major = np.abs(np.take_along_axis(q, AXIS[chart][:, None], axis=1))
        return _CUBE.uv(chart, 4 / pi * np.arctan(q / major))

    def gradient(self, y: Float[np.ndarray, "n 3"], chart: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2 3"]:
        """Gradient in space of atan(a / b) is (b grad a - a grad b) / (a^2 + b^2); it has no share along y."""
        q = y / np.asarray(self.half)
        toward = np.eye(3)[AXIS[chart]] * SIGN[chart][:, None]
        b = np.sum(toward * q, axis=1)
        rows = []
        for tangent, scale in ((ACROSS[chart], _CUBE.scale[0]), (UPWARD[chart], _CUBE.scale[1])):
            a = np.sum(tangent * q, axis=1)
            turn = (b[:, None] * tangent - a[:, None] * toward) / (a * a + b * b)[:, None]
            rows.append(4 / pi * scale * turn / np.asarray(self.half))
        return np.stack(rows, axis=1)

    def lattice(self, edge: float) -> tuple[np.ndarray, np.ndarray]:
        """Mesh the directions from the middle, even in the texture, for edges of about `edge` on the ellipsoid p / h.

        Returns
        -------
        q, faces
            (v, 3), whose h q has the direction, of unit length; (f, 3) vertex indices. Cuts run along edges.
        """
        nx, ny, nz = (max(2, ceil(pi / 2 * extent / edge)) for extent in self.half)
        cube, faces, _ = lattice_mesh((nx, ny, nz))
        q = np.tan(pi / 4 * cube)
        return q / np.linalg.norm(q, axis=1, keepdims=True), faces


@dataclass(frozen=True, slots=True)
class Projection:
    """Projection along the axis nearest to the normal, for surfaces that no point sees all of; charts are the sides.

    Sheets that lie behind one another share texture, but a chart never touches itself across a cut: within it the
    texture coordinates are two of the coordinates in space.

    Attributes
    ----------
    half
        Half extents of a box about the origin that holds the solid; its net is the texture.
    """

    half: tuple[float, float, float]

    def chart(self, y: Float[np.ndarray, "n 3"], n: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Face of the greatest component of the normal, the lowest id on ties."""
        return face_of(n, (0.0, 0.0, 0.0))

    def uv(self, y: Float[np.ndarray, "n 3"], chart: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Net of the box at the projection onto the given faces."""
        return Net.fitted(self.half).uv(chart, y)

    def gradient(self, y: Float[np.ndarray, "n 3"], chart: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2 3"]:
        """Gradient in space, constant on each face."""
        return Net.fitted(self.half).gradient(chart)
