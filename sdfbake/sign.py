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
from sdfbake.topology import corners, cross, signed_volume

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
        normal = cross(p[1] - p[0], p[2] - p[0])
        normal /= np.sqrt((normal * normal).sum(axis=0))
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
        outward = -1 if signed_volume(surface.vertices, surface.faces) < 0 else 1
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
    """Thresholded winding numbers of a mesh that need not be clean."""

    surface: Surface
    _tree: Any

    @staticmethod
    def of(surface: Surface) -> "Winding":
        """Build the tree."""
        import igl  # here, so that `import sdfbake` is light

        tree = igl.FastWindingNumberBVH()
        tree.init(surface.vertices, surface.faces)
        return Winding(surface, tree)

    def signs(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Return -1 where |winding number| > 1/2, int8."""
        q = np.ascontiguousarray(self.surface.to_unit(p))
        w = np.asarray(self._tree.winding_number(q)).reshape(-1)
        return np.where(np.abs(w) > 0.5, -1, 1).astype(np.int8)

    def brick_signs(
        self, p: Float[np.ndarray, "k 8 8 8 3"], distance: Float[np.ndarray, "k 8 8 8"]
    ) -> Int[np.ndarray, "k 8 8 8"]:
        """Return the signs of whole bricks with few queries.

        Two points have the same sign if the surface is farther from them than they are from each other together:
        |d_1| + |d_2| > |p_1 - p_2|. The farthest sample of every block of 4^3 speaks for those.
        """
        p, d = _blocks(p), _blocks(distance[..., None])[..., 0]
        speaker = d.argmax(axis=1)[:, None]
        reach = np.take_along_axis(d, speaker, axis=1)
        centre = np.take_along_axis(p, speaker[..., None], axis=1)
        spoken = d + reach > np.linalg.norm(p - centre, axis=-1) * (1 + 1e-9)
        sign = np.repeat(self.signs(centre[:, 0])[:, None], d.shape[1], axis=1)
        if not spoken.all():
            sign[~spoken] = self.signs(p[~spoken])
        return _unblocks(sign, distance.shape)


def _blocks(v: np.ndarray) -> np.ndarray:
    """Cut bricks (k, 8, 8, 8, c) into blocks: (8 k, 64, c)."""
    k, *_, width = v.shape
    cut = v.reshape(k, 2, _BLOCK, 2, _BLOCK, 2, _BLOCK, width)
    return np.moveaxis(cut, (3, 5), (2, 3)).reshape(8 * k, _BLOCK**3, width)


def _unblocks(v: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Put blocks (8 k, 64) back together: (k, 8, 8, 8)."""
    cut = v.reshape(-1, 2, 2, 2, _BLOCK, _BLOCK, _BLOCK)
    return np.moveaxis(cut, (2, 3), (3, 5)).reshape(shape)
