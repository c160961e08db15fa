"""How the faces of a mesh hang together.

In: welded faces. Out: `Topology`: edges, their faces, and what keeps the surface from being closed and oriented.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


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
    """

    edges: Int[np.ndarray, "e 2"]
    edge: Int[np.ndarray, "f 3"]
    forward: Bool[np.ndarray, "f 3"]
    faces_per_edge: Int[np.ndarray, " e"]

    @staticmethod
    def of(faces: Int[np.ndarray, "f 3"]) -> "Topology":
        """Find the edges of some faces."""
        side = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1)
        low, high = side.min(axis=-1), side.max(axis=-1)
        # One 64-bit key per edge: sorts many times faster than rows. Vertices are far fewer than 2^31.
        key, edge, count = np.unique((low << 32) | high, return_inverse=True, return_counts=True)
        edges = np.stack([key >> 32, key & 0xFFFFFFFF], axis=-1)
        return Topology(edges, edge.reshape(-1, 3), side[..., 0] < side[..., 1], count)

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

    def pinched_vertices(self, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, " m"]:
        """Vertices around which the faces form more than one fan."""
        corner = np.arange(faces.size).reshape(-1, 3)
        # Side k of a face joins corner k and corner k + 1: both faces of an edge see the same two vertices there.
        ends = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1)
        ends = np.where(self.forward[..., None], ends, ends[..., ::-1])
        hub = faces.size + 2 * self.edge[..., None] + np.arange(2)
        nodes = faces.size + 2 * len(self.edges)
        links = coo_array((np.ones(ends.size, np.int8), (ends.reshape(-1), hub.reshape(-1))), shape=(nodes, nodes))
        fan = connected_components(links, directed=False)[1][: faces.size]
        pairs = np.unique((faces.reshape(-1) << 32) | fan)
        vertex, fans = np.unique(pairs >> 32, return_counts=True)
        pinched: Int[np.ndarray, " m"] = vertex[fans > 1]
        return pinched


def twice_areas(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, " f"]:
    """Return twice the area of every face."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    doubled: Float[np.ndarray, " f"] = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    return doubled


def signed_volume(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> float:
    """Return the volume inside a closed mesh, negative if its faces look inwards."""
    p = vertices[faces] - vertices[faces].reshape(-1, 3).mean(axis=0)
    return float((p[:, 0] * np.cross(p[:, 1], p[:, 2])).sum() / 6)
