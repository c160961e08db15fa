"""The closest face of a mesh, and the distance from it in double precision.

In: a mesh and points. Out: `Closest`. libigl finds a closest face; here the lowest face id that shares the closest
feature takes its place, and distance and barycentric coordinates are computed anew from that face, in a frame that is
recentred and scaled by a power of two, where float64 loses nothing.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sdfbake import triangle
from sdfbake.complaint import BadInput
from sdfbake.engine.numpy import NumpyEngine
from sdfbake.mesh import Mesh
from sdfbake.topology import Topology
from sdfbake.topology import normals as normals_of

# Weights of corners that are zero but for rounding: the rounding of a foot point is a few eps of the face's size.
_ROUNDING = 1e-10
_ENGINE = NumpyEngine(64)
_CHUNK = 1 << 15  # points refined at once: about thirty temporary columns stay in the cache


class Closest(NamedTuple):
    """Closest surface points.

    Attributes
    ----------
    face
        Face of the mesh, int64; of those that share the closest edge or vertex the lowest.
    distance
        Unsigned, the mesh's units, float64.
    barycentric
        Weights of the face's corners, float64.
    point
        The closest point itself, world.
    feature
        Interior, edge or corner of the face; see `sdfbake.triangle`.
    """

    face: Int[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    barycentric: Float[np.ndarray, "n 3"]
    point: Float[np.ndarray, "n 3"]
    feature: Int[np.ndarray, " n"]


class _Found(NamedTuple):
    """Distance, weights and feature on given faces, unit frame."""

    distance: Float[np.ndarray, " n"]
    barycentric: Float[np.ndarray, "n 3"]
    feature: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh made ready for queries.

    Attributes
    ----------
    centre, scale
        The unit frame: q = (p - centre) / scale, with scale a power of two.
    vertices
        Unit frame.
    faces, ids
        Faces with an area, and their numbers in the mesh.
    normals
        Twice the area of `faces` as vectors, unit frame, components first.
    topology
        Edges of `faces`.
    """

    centre: Float[np.ndarray, "3"]
    scale: float
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    ids: Int[np.ndarray, " f"]
    normals: Float[np.ndarray, "3 f"]
    topology: Topology

    @staticmethod
    def of(mesh: Mesh) -> "Surface":
        """Build the tables.

        Raises
        ------
        BadInput
            If no face has an area.
        """
        low, high = mesh.bounds
        centre, scale = (low + high) / 2, float(2.0 ** np.ceil(np.log2(max((high - low).max() / 2, 1e-300))))
        vertices = np.ascontiguousarray((mesh.vertices - centre) / scale)
        normals = normals_of(vertices, mesh.faces)
        proper = (normals * normals).sum(axis=0) > 0
        ids = np.flatnonzero(proper)
        if len(ids) == 0:
            raise BadInput(f"the mesh is empty: {len(mesh.faces)} faces without area: export a surface mesh")
        faces = mesh.faces
        if len(ids) < len(faces):
            faces, normals = np.ascontiguousarray(faces[ids]), normals[:, proper]
        return Surface(centre, scale, vertices, faces, ids, normals, Topology.of(faces))

    @cached_property
    def area(self) -> float:
        """World units, squared."""
        return float(np.sqrt((self.normals * self.normals).sum(axis=0)).sum() / 2 * self.scale**2)

    @cached_property
    def volume(self) -> float:
        """What a closed mesh encloses, unit frame; negative if its faces look inwards."""
        a = self.vertices[self.faces[:, 0]] - self.vertices.mean(axis=0)
        return float((a.T * self.normals).sum() / 6)

    @cached_property
    def least_of_edge(self) -> Int[np.ndarray, " e"]:
        """Lowest of `faces` on every edge."""
        return _least(self.topology.edge, len(self.topology.edges))

    @cached_property
    def least_of_vertex(self) -> Int[np.ndarray, " v"]:
        """Lowest of `faces` around every vertex."""
        return _least(self.faces, len(self.vertices))

    @cached_property
    def _tree(self) -> Any:
        """Bounding boxes, built when the first query comes."""
        import igl  # here, so that `import sdfbake` is light

        tree = igl.AABB()
        tree.init(self.vertices, self.faces)
        return tree

    def to_unit(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Return points in the unit frame."""
        q: Float[np.ndarray, "n 3"] = (p - self.centre) / self.scale
        return q

    def closest(self, p: Float[np.ndarray, "n 3"]) -> Closest:
        """Return the closest surface points of world points."""
        q = np.ascontiguousarray(self.to_unit(p), np.float64).reshape(-1, 3)
        face = np.asarray(self._tree.squared_distance(self.vertices, self.faces, q)[1], np.int64).reshape(-1)
        face, found = self._settled(face, q)
        point = np.einsum("nk,nkd->nd", found.barycentric, self.vertices[self.faces[face]])
        world = point * self.scale + self.centre
        return Closest(self.ids[face], found.distance * self.scale, found.barycentric, world, found.feature)

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return unsigned distances only; exact to float64 rounding of the squared distance."""
        q = np.ascontiguousarray(self.to_unit(p), np.float64).reshape(-1, 3)
        square = np.asarray(self._tree.squared_distance(self.vertices, self.faces, q)[0]).reshape(-1)
        distance: Float[np.ndarray, " n"] = np.sqrt(square.clip(0)) * self.scale
        return distance

    def _settled(
        self, face: Int[np.ndarray, " n"], q: Float[np.ndarray, "n 3"]
    ) -> "tuple[Int[np.ndarray, ' n'], _Found]":
        """Take the lowest face of the closest feature; every face of that edge or corner is equally near."""
        found = self._from_face(face, q)
        lowest = self._lowest(face, found.barycentric)
        changed = np.flatnonzero(lowest != face)
        again = self._from_face(lowest[changed], q[changed])
        # Only rounding can make the lowest face farther; a sliver that is keeps its first winner.
        fine = again.distance <= found.distance[changed] * (1 + 1e-12) + 1e-15
        changed = changed[fine]
        face[changed] = lowest[changed]
        for column, update in zip(found, again, strict=True):
            column[changed] = update[fine]
        return face, found

    def _lowest(self, face: Int[np.ndarray, " n"], barycentric: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Return the lowest face at the edge or corner that every closest point is on, or is on but for rounding."""
        off = barycentric <= _ROUNDING
        at = np.where(off.sum(axis=1) == 2, (~off).argmax(axis=1), (off.argmax(axis=1) + 1) % 3)
        by_edge = self.least_of_edge[self.topology.edge[face, at]]  # the edge opposite to the corner that is off
        by_corner = self.least_of_vertex[self.faces[face, at]]
        lowest: Int[np.ndarray, " n"] = np.choose(off.sum(axis=1), [face, by_edge, by_corner])
        return lowest

    def _from_face(self, face: Int[np.ndarray, " n"], q: Float[np.ndarray, "n 3"]) -> "_Found":
        """Compute distances from given faces, unit frame, in pieces that stay in the cache."""
        pieces = []
        for start in range(0, max(len(face), 1), _CHUNK):
            part = slice(start, start + _CHUNK)
            a, b, c = (tuple(column) for column in np.moveaxis(self.vertices[self.faces[face[part]]], (1, 2), (0, 1)))
            x, y, z = np.ascontiguousarray(q[part].T)
            with np.errstate(all="ignore"):  # faces of no use are masked out
                at = triangle.nearest(_ENGINE, (x, y, z), (a, b, c))
            pieces.append(_Found(at.distance, np.stack(at.barycentric, axis=-1), at.feature.astype(np.int8)))
        return _Found(*(np.concatenate(columns) for columns in zip(*pieces, strict=True)))


def _least(of: Int[np.ndarray, "f 3"], count: int) -> Int[np.ndarray, " count"]:
    """Return the lowest face that names each of `count` things; 0 where none does."""
    least = np.zeros(count, np.int64)
    # Of several values for one entry the last is kept: from the end, that is the lowest.
    least[of.reshape(-1)[::-1]] = np.arange(of.size)[::-1] // 3
    return least


def closest(mesh: Mesh, points: Float[np.ndarray, "n 3"]) -> Closest:
    """Return the closest points of a mesh; for one set of points (else keep a `Surface`)."""
    return Surface.of(mesh).closest(np.asarray(points, np.float64))
