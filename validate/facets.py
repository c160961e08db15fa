"""The geometry of triangles in float64: normals, barycentrics and their gradients, planes, neighbours.

In: a mesh. Out: per-face and per-vertex tables, computed once when first asked for. The in-surface gradient of texture
coordinates is U (E^T E)^-1 E^T with edges E and coordinate differences U.
"""

from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh

Normals = Literal["faceted", "area", "angle"]


class Facets:
    """Tables over the faces of a mesh.

    Raises
    ------
    BadInput
        If the mesh has no faces.
    """

    def __init__(self, mesh: Mesh) -> None:
        if len(mesh.faces) == 0:
            raise BadInput("the reference needs a mesh with faces, and this one has none: check the file")
        self.mesh = mesh
        self.corners: Float[np.ndarray, "f 3 3"] = mesh.vertices[mesh.faces]

    @cached_property
    def _cross(self) -> Float[np.ndarray, "f 3"]:
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return np.cross(b - a, c - a)

    @cached_property
    def normal(self) -> Float[np.ndarray, "f 3"]:
        """Unit geometric normals; zero for faces without area."""
        return unit(self._cross)

    @cached_property
    def barycentric_gradient(self) -> Float[np.ndarray, "f 3 3"]:
        """Gradient of each corner's weight, [face, corner, axis]: the rows of (E^T E)^-1 E^T, after minus their sum."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        edges = np.stack([b - a, c - a], axis=2)
        metric = np.swapaxes(edges, 1, 2) @ edges
        m00, m01, m11 = metric[:, 0, 0], metric[:, 0, 1], metric[:, 1, 1]
        determinant = m00 * m11 - m01 * m01
        # Below the rounding of the determinant itself, relative to the longer edge, a face has no area.
        flat = determinant <= 8 * np.finfo(np.float64).eps * np.maximum(m00, m11) ** 2
        adjoint = np.stack([np.stack([m11, -m01], 1), np.stack([-m01, m00], 1)], 1)
        inverse = np.where(flat[:, None, None], 0.0, adjoint / np.where(flat, 1.0, determinant)[:, None, None])
        rows = inverse @ np.swapaxes(edges, 1, 2)
        return np.concatenate([-rows.sum(axis=1, keepdims=True), rows], axis=1)

    @cached_property
    def uv(self) -> Float[np.ndarray, "f 3 2"]:
        """Texture coordinates per corner; zeros where the mesh has none."""
        return np.zeros((len(self.corners), 3, 2)) if self.mesh.uv is None else self.mesh.uv

    @cached_property
    def uv_gradient(self) -> Float[np.ndarray, "f 2 3"]:
        """In-surface gradient of the texture coordinates, U (E^T E)^-1 E^T; zero for faces without area."""
        return np.asarray(np.swapaxes(self.uv, 1, 2) @ self.barycentric_gradient)

    def corner_normal(self, weight: Literal["area", "angle"]) -> Float[np.ndarray, "f 3 3"]:
        """Unit vertex normals at each face's corners, the faces' own averaged by area or by angle."""
        return self._by_area if weight == "area" else self._by_angle

    @cached_property
    def _by_area(self) -> Float[np.ndarray, "f 3 3"]:
        return self._averaged(np.repeat(self._cross[:, None], 3, axis=1))

    @cached_property
    def _by_angle(self) -> Float[np.ndarray, "f 3 3"]:
        forward = np.roll(self.corners, -1, axis=1) - self.corners
        backward = np.roll(self.corners, 1, axis=1) - self.corners
        sine = np.linalg.norm(np.cross(forward, backward), axis=2)
        angle = np.arctan2(sine, np.sum(forward * backward, axis=2))
        return self._averaged(angle[:, :, None] * self.normal[:, None])

    def _averaged(self, share: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3 3"]:
        total = np.zeros_like(self.mesh.vertices)
        np.add.at(total, self.mesh.faces, share)
        return np.asarray(unit(total)[self.mesh.faces])

    @cached_property
    def _ring(self) -> sparse.csr_array:
        faces = self.mesh.faces
        rows = np.repeat(np.arange(len(faces)), 3)
        shape = (len(faces), len(self.mesh.vertices))
        touches = sparse.csr_array((np.ones(len(rows), np.int32), (rows, faces.ravel())), shape=shape)
        return sparse.csr_array(touches @ touches.T)

    def ring(self, face: Int[np.ndarray, " k"]) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
        """Faces that share a vertex with each of `face`: pairs (position in `face`, neighbour)."""
        pairs = sparse.coo_array(self._ring[face])
        return pairs.coords[0].astype(np.int64), pairs.coords[1].astype(np.int64)

    def cross_plane(
        self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], face: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Where each ray crosses its face's plane: distance and barycentrics (Moeller and Trumbore 1997).

        A face seen edge on has no crossing; its middle stands in, at the distance of closest approach.
        """
        a, b, c = np.moveaxis(self.corners[face], 1, 0)
        ab, ac, ao = b - a, c - a, o - a
        q, r = np.cross(d, ac), np.cross(ao, ab)
        determinant = np.sum(q * ab, axis=1)
        edge_on = determinant == 0.0
        inverse = 1.0 / np.where(edge_on, 1.0, determinant)
        v = np.where(edge_on, 1 / 3, np.sum(ao * q, axis=1) * inverse)
        w = np.where(edge_on, 1 / 3, np.sum(d * r, axis=1) * inverse)
        middle = np.sum(((a + b + c) / 3 - o) * d, axis=1)
        t = np.where(edge_on, middle, np.sum(ac * r, axis=1) * inverse)
        return t, np.stack([1.0 - v - w, v, w], axis=1)


def unit(v: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Vectors of unit length; zero stays zero."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(v / np.where(length > 0, length, 1.0))
