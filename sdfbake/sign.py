"""Inside or outside, and how sure.

In: a surface, and samples with their closest points. Out: signs, -1 inside. Pseudonormals (Baerentzen and Aanaes 2005)
where the mesh is closed, oriented and manifold: exact and nearly free. Otherwise the generalised winding number
(Barill et al. 2018), thresholded: |w| > 1/2 is inside, whichever way the faces look.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sdfbake import triangle
from sdfbake.closest import Closest, Surface
from sdfbake.topology import corners, cross

_FLOAT32 = 1e-6  # more than the rounding of stored distances: on a straight line through a face the sums are equal
_ROUGH = 0.02  # twice what the tree's winding numbers are off by
_BLOCK = 4  # samples along the side of a block that is given one winding number, where the distances allow it


@dataclass(frozen=True, slots=True, eq=False)
class Pseudonormals:
    """Outward normals of faces, edges and vertices.

    Attributes
    ----------
    of_face
        Unit normals.
    of_edge
        Sum of the normals of the edge's faces.
    of_vertex
        Normals around a vertex, weighted by the angles of the faces there.
    outward
        -1 for a mesh whose faces look inwards as a whole, else 1.
    """

    surface: Surface
    of_face: Float[np.ndarray, "f 3"]
    of_edge: Float[np.ndarray, "e 3"]
    of_vertex: Float[np.ndarray, "v 3"]
    outward: int

    @staticmethod
    def of(surface: Surface) -> "Pseudonormals":
        """Compute the normals of all features."""
        p = corners(surface.vertices, surface.faces)
        normal = surface.normals / np.sqrt((surface.normals * surface.normals).sum(axis=0))
        of_edge = np.zeros((3, len(surface.topology.edges)))
        of_vertex = np.zeros((3, len(surface.vertices)))
        for k in range(3):
            u, v = p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]
            turn = cross(u, v)
            angle = np.arctan2(np.sqrt((turn * turn).sum(axis=0)), (u * v).sum(axis=0))
            edge, vertex = surface.topology.edge[:, k], surface.faces[:, k]
            for axis in range(3):
                of_edge[axis] += np.bincount(edge, normal[axis], of_edge.shape[1])
                of_vertex[axis] += np.bincount(vertex, angle * normal[axis], of_vertex.shape[1])
        outward = -1 if surface.volume < 0 else 1
        of_face, edges, vertices = (np.ascontiguousarray(v.T) for v in (normal, of_edge, of_vertex))
        return Pseudonormals(surface, of_face, edges, vertices, outward)

    def signs(self, p: Float[np.ndarray, "n 3"], at: Closest) -> Int[np.ndarray, " n"]:
        """Return the side of its closest point's feature on which every point lies: -1 inside, int8."""
        face = np.searchsorted(self.surface.ids, at.face)
        corner = np.maximum(at.feature - 1, 0) % 3
        edge = self.surface.topology.edge[face, corner]
        vertex = self.surface.faces[face, corner]
        normal = self.of_face[face]
        on_edge = (at.feature >= triangle.EDGE) & (at.feature < triangle.CORNER)
        on_corner = at.feature >= triangle.CORNER
        normal[on_edge] = self.of_edge[edge[on_edge]]
        normal[on_corner] = self.of_vertex[vertex[on_corner]]
        # From a corner of the face rather than from the closest point: exact on the feature's plane either way, and
        # without the rounding of the closest point, except at edges and corners, which lie on it themselves.
        to = self.surface.to_unit(p) - self.surface.vertices[vertex]
        return np.where((to * normal).sum(axis=1) * self.outward < 0, -1, 1).astype(np.int8)


@dataclass(frozen=True, slots=True, eq=False)
class Winding:
    """Thresholded winding numbers of a mesh that need not be clean.

    Attributes
    ----------
    surface
        The mesh.
    rim
        Edges at which the faces' orientations do not cancel: boundaries of holes, and sides of flipped faces.
    rim_length
        Length of the rim, unit frame, counted as often as orientations are in excess.
    """

    surface: Surface
    rim: Int[np.ndarray, "r 2"]
    rim_length: float
    _tree: Any

    @staticmethod
    def of(surface: Surface) -> "Winding":
        """Build the tree."""
        import igl  # here, so that `import sdfbake` is light

        tree = igl.FastWindingNumberBVH()
        topology = surface.topology
        faces = surface.faces if (topology.faces_per_edge == 2).all() else _distinct(surface.faces)
        tree.init(surface.vertices, faces)
        direction = np.where(topology.forward, 1.0, -1.0).reshape(-1)
        excess = np.abs(np.bincount(topology.edge.reshape(-1), direction, len(topology.edges)))
        rim = topology.edges[excess > 0]
        ends = surface.vertices[rim]
        length = float((np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) * excess[excess > 0]).sum())
        return Winding(surface, rim, length, tree)

    def numbers(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return winding numbers, right to about a hundredth."""
        q = np.ascontiguousarray(self.surface.to_unit(p))
        return np.asarray(self._tree.winding_number(q), np.float64).reshape(-1)

    def signs(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Return -1 where |winding number| > 1/2, int8."""
        return np.where(np.abs(self.numbers(p)) > 0.5, -1, 1).astype(np.int8)

    def brick_signs(
        self, p: Float[np.ndarray, "k 8 8 8 3"], distance: Float[np.ndarray, "k 8 8 8"]
    ) -> Int[np.ndarray, "k 8 8 8"]:
        """Return the signs of whole bricks with few queries.

        No face lies between two points if the surface is farther from them than they are from each other together:
        |d_1| + |d_2| > |p_1 - p_2|. Off the faces the winding number changes only with the solid angle of the rim, by
        at most its length over 4 pi r^2 per unit of way at a distance r from it (the law of Biot and Savart). So the
        farthest sample of every block of 4^3 speaks for those it is near enough to.
        """
        p, d = _blocks(p), _blocks(distance[..., None])[..., 0]
        speaker = d.argmax(axis=1)[:, None]
        reach = np.take_along_axis(d, speaker, axis=1)
        centre = np.take_along_axis(p, speaker[..., None], axis=1)
        way = np.linalg.norm(p - centre, axis=-1)
        number = np.abs(self.numbers(centre[:, 0]))
        spoken = d + reach > way * (1 + _FLOAT32)
        if len(self.rim):
            spoken &= self._change(centre[:, 0], way) < np.abs(number - 0.5)[:, None] - _ROUGH
        sign = np.repeat(np.where(number > 0.5, -1, 1).astype(np.int8)[:, None], d.shape[1], axis=1)
        if not spoken.all():
            sign[~spoken] = self.signs(p[~spoken])
        return _unblocks(sign, distance.shape)

    def _change(self, p: Float[np.ndarray, "m 3"], way: Float[np.ndarray, "m 64"]) -> Float[np.ndarray, "m 64"]:
        """Return the most that the winding number can change by on ways from some points that meet no face."""
        import igl

        q = np.ascontiguousarray(self.surface.to_unit(p))
        square = igl.point_mesh_squared_distance(q, self.surface.vertices, np.ascontiguousarray(self.rim))[0]
        step = way / self.surface.scale
        away = (np.sqrt(np.asarray(square))[:, None] - step).clip(1e-12)
        change: Float[np.ndarray, "m 64"] = step * self.rim_length / (4 * np.pi * away * away)
        return change


def _distinct(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "g 3"]:
    """Return every face once, if it looks the same way: repetitions count in winding numbers."""
    start = faces.argmin(axis=1)
    turned = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1)
    return faces[np.sort(np.unique(turned, axis=0, return_index=True)[1])]


def _blocks(v: np.ndarray) -> np.ndarray:
    """Cut bricks (k, 8, 8, 8, c) into blocks: (8 k, 64, c)."""
    k, *_, width = v.shape
    cut = v.reshape(k, 2, _BLOCK, 2, _BLOCK, 2, _BLOCK, width)
    return np.moveaxis(cut, (3, 5), (2, 3)).reshape(8 * k, _BLOCK**3, width)


def _unblocks(v: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Put blocks (8 k, 64) back together: (k, 8, 8, 8)."""
    cut = v.reshape(-1, 2, 2, 2, _BLOCK, _BLOCK, _BLOCK)
    return np.moveaxis(cut, (2, 3), (3, 5)).reshape(shape)
