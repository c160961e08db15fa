"""How the faces of a mesh hang together.

In: welded faces. Out: `Topology`: edges, their faces, and what keeps the surface from being closed and oriented.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, slots=True, eq=False)
class Topology:
    """Edges and corners of a triangle mesh.

    Attributes
    ----------
    edges
        Vertex pairs, lower index first, sorted.
    edge
        Edge of every face's sides (corner k to k + 1).
    forward
        Whether the side runs from the lower to the higher vertex.
    faces_per_edge
        Number of sides on every edge.
    order
        Sides (3 times the face, plus the corner they start from), edge by edge.
    """

    edges: Int[np.ndarray, "e 2"]
    edge: Int[np.ndarray, "f 3"]
    forward: Bool[np.ndarray, "f 3"]
    faces_per_edge: Int[np.ndarray, " e"]
    order: Int[np.ndarray, " s"]

    @staticmethod
    def of(faces: Int[np.ndarray, "f 3"]) -> "Topology":
        """Find the edges of some faces."""
        start, end = faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
        forward = start < end
        low, high = np.where(forward, start, end), np.where(forward, end, start)
        # One 64-bit key per edge: sorts many times faster than rows. Vertices are far fewer than 2^31.
        key = (low << 32) | high
        order = np.argsort(key)
        key = key[order]
        fresh = np.ones(len(key), bool)
        fresh[1:] = key[1:] != key[:-1]
        edge = np.empty(len(key), np.int64)
        edge[order] = np.cumsum(fresh) - 1
        count = np.diff(np.append(np.flatnonzero(fresh), len(key)))
        edges = np.stack([key[fresh] >> 32, key[fresh] & 0xFFFFFFFF], axis=-1)
        return Topology(edges, edge.reshape(-1, 3), forward.reshape(-1, 3), count, order)

    @property
    def open_edges(self) -> Int[np.ndarray, " m"]:
        """Edges with one face."""
        return np.flatnonzero(self.faces_per_edge == 1)

    @property
    def crowded_edges(self) -> Int[np.ndarray, " m"]:
        """Edges with more than two faces."""
        return np.flatnonzero(self.faces_per_edge > 2)

    @property
    def flipped_edges(self) -> Int[np.ndarray, " m"]:
        """Edges whose two faces run along them in the same direction, so that their orientations disagree."""
        forward = np.bincount(self.edge.reshape(-1), weights=self.forward.reshape(-1), minlength=len(self.edges))
        return np.flatnonzero((self.faces_per_edge == 2) & (forward != 1))

    @property
    def twins(self) -> Int[np.ndarray, " s"]:
        """The other side of every side's edge, if every edge has two."""
        pairs = self.order.reshape(-1, 2)
        twin = np.empty(len(self.order), np.int64)
        twin[pairs[:, 0]], twin[pairs[:, 1]] = pairs[:, 1], pairs[:, 0]
        return twin

    def repeated_faces(self, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, " m"]:
        """Faces that have the vertices of one before them."""
        if (self.faces_per_edge == 2).all():  # then they are each other's only neighbours
            a, b, c = (self.twins // 3).reshape(-1, 3).T
            return np.flatnonzero((a == b) & (b == c) & (a < np.arange(len(faces))))
        low, middle, high = np.sort(faces, axis=1).T
        order = np.lexsort((high, middle, low))
        same = np.logical_and.reduce([column[order][1:] == column[order][:-1] for column in (low, middle, high)])
        return np.sort(order[1:][same])

    def pinched_vertices(self, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, " m"]:
        """Vertices around which the faces form more than one fan."""
        closed = (self.faces_per_edge == 2).all() and len(self.flipped_edges) == 0
        fan = self._turned(faces) if closed else self._linked(faces)
        vertex = np.zeros(fan.max(initial=-1) + 1, np.int64)
        vertex[fan] = faces.reshape(-1)  # all corners of a fan are at one vertex
        return np.flatnonzero(np.bincount(vertex[np.unique(fan)]) > 1)

    def _turned(self, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, " s"]:
        """Number the fan of every corner of a closed and oriented mesh by its least corner."""
        # The corner that follows around a vertex: side k of a face leaves corner k; its twin arrives there, so the
        # corner after the twin's is at the same vertex.
        twin = self.twins
        after = twin + 1 - 3 * (twin % 3 == 2)
        fan = np.arange(faces.size)
        while True:  # by steps of 1, 2, 4, ... corners
            least = np.minimum(fan, fan[after])
            if np.array_equal(least, fan):
                return fan
            fan, after = least, after[after]

    def _linked(self, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, " s"]:
        """Number the fan of every corner of any mesh."""
        from scipy.sparse import coo_array  # here, so that `import sdfbake` is light
        from scipy.sparse.csgraph import connected_components

        corner = np.arange(faces.size).reshape(-1, 3)
        # Side k of a face joins corner k and corner k + 1: both faces of an edge see the same two vertices there.
        ends = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1)
        ends = np.where(self.forward[..., None], ends, ends[..., ::-1])
        hub = faces.size + 2 * self.edge[..., None] + np.arange(2)
        nodes = faces.size + 2 * len(self.edges)
        links = coo_array((np.ones(ends.size, np.int8), (ends.reshape(-1), hub.reshape(-1))), shape=(nodes, nodes))
        fan: Int[np.ndarray, " s"] = connected_components(links, directed=False)[1][: faces.size].astype(np.int64)
        return fan


def twice_areas(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, " f"]:
    """Return twice the area of every face."""
    x, y, z = normals(vertices, faces)
    doubled: Float[np.ndarray, " f"] = np.sqrt(x * x + y * y + z * z)
    return doubled


def normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "3 f"]:
    """Return (b - a) x (c - a) of every face, components first."""
    a, b, c = corners(vertices, faces)
    return cross(b - a, c - a)


def corners(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "3 3 f"]:
    """Return the corners of every face, components before faces: columns are worked on many times faster than rows."""
    return np.moveaxis(np.ascontiguousarray(vertices.T)[:, np.ascontiguousarray(faces.T)], 1, 0)


def cross(u: Float[np.ndarray, "3 f"], v: Float[np.ndarray, "3 f"]) -> Float[np.ndarray, "3 f"]:
    """Return the vector products of columns."""
    return np.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


def signed_volume(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> float:
    """Return the volume inside a closed mesh, negative if its faces look inwards."""
    a = (vertices[faces[:, 0]] - vertices.mean(axis=0)).T
    return float((a * normals(vertices, faces)).sum() / 6)
