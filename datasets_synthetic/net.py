"""The surface of a box unfolded to the plane as a cross, without stretch.

In: half extents (hx, hy, hz) and points of the box in its own frame. Out: face ids, texture coordinates and their
constant gradients; the lattice mesh of the six faces. The cross, in units of the box, before scale and offset:

                 top
    left        front       right       back
                bottom

with front (x, y), right (hx + (hz - z), y), left (-hx - (hz - z), y), top (x, hy + (hz - z)),
bottom (x, -hy - (hz - z)), back (hx + 2 hz + (hx - x), y). Seen from outside no face is mirrored. The map is continuous
across the five edges of the cross and cut along the other seven.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

#: Face ids, and so chart ids: front +z, right +x, left -x, top +y, bottom -y, back -z.
FACES = ("front", "right", "left", "top", "bottom", "back")
AXIS = np.array([2, 0, 0, 1, 1, 2])
SIGN = np.array([1.0, 1.0, -1.0, 1.0, -1.0, -1.0])
#: Directions of growing u and v on each face; their cross product is the outward normal.
ACROSS = np.array([[1, 0, 0], [0, 0, -1], [0, 0, 1], [1, 0, 0], [1, 0, 0], [-1, 0, 0]], np.float64)
UPWARD = np.array([[0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1], [0, 1, 0]], np.float64)


@dataclass(frozen=True, slots=True)
class Net:
    """The cross of one box, scaled and shifted into texture space: uv = scale * cross + offset.

    Attributes
    ----------
    half
        Half extents of the box, in its unit.
    scale
        Texture units per unit along u and along v.
    offset
        Texture coordinates of the middle of the front face.
    """

    half: tuple[float, float, float]
    scale: tuple[float, float]
    offset: tuple[float, float]

    @staticmethod
    def fitted(half: tuple[float, float, float]) -> "Net":
        """Scale the whole cross evenly so that it fits [0, 1]^2 with its lower left at the origin."""
        hx, hy, hz = half
        scale = 1.0 / max(4 * hx + 4 * hz, 2 * hy + 4 * hz)
        return Net(half, (scale, scale), (scale * (hx + 2 * hz), scale * (hy + 2 * hz)))

    @staticmethod
    def front(half: tuple[float, float, float]) -> "Net":
        """Make the front face exactly [0, 1]^2; the other faces continue past its border."""
        return Net(half, (0.5 / half[0], 0.5 / half[1]), (0.5, 0.5))

    def uv(self, face: Int[np.ndarray, " n"], q: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Texture coordinates of surface points `q` (box frame) taken to lie on the given faces."""
        hx, hy, hz = self.half
        shift = np.array([[0, 0], [hx + hz, 0], [-hx - hz, 0], [0, hy + hz], [0, -hy - hz], [2 * hx + 2 * hz, 0]])
        cross = np.stack([np.sum(ACROSS[face] * q, axis=1), np.sum(UPWARD[face] * q, axis=1)], axis=1)
        uv: Float[np.ndarray, "n 2"] = np.asarray(self.scale) * (cross + shift[face]) + np.asarray(self.offset)
        return uv

    def gradient(self, face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2 3"]:
        """Gradient of the texture coordinates on the given faces, constant there and tangent to them."""
        return np.stack([self.scale[0] * ACROSS[face], self.scale[1] * UPWARD[face]], axis=1)


def face_of(p: Float[np.ndarray, "n 3"], half: tuple[float, float, float]) -> Int[np.ndarray, " n"]:
    """Face whose plane `p` (box frame) exceeds the most, or lies behind the least; the lowest id wins ties.

    The foot of `p` is on that face, inside and outside of the box.
    """
    excess = p[:, AXIS] * SIGN - np.asarray(half)[AXIS]
    face: Int[np.ndarray, " n"] = np.argmax(excess, axis=1)
    return face


def lattice_mesh(
    counts: tuple[int, int, int],
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"], Int[np.ndarray, " f"]]:
    """Mesh the cube [-1, 1]^3 with `counts` steps along x, y, z; vertices shared between faces.

    Returns
    -------
    vertices
        (v, 3) in [-1, 1]; the ends are exactly -1 and 1.
    faces
        (f, 3) vertex indices, counter-clockwise from outside.
    face
        (f,) id of the cube's face that each triangle lies on.
    """
    nodes: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    ids: list[np.ndarray] = []
    for face in range(6):
        corners, quads = _patch(face, counts)
        triangles.append(quads + sum(map(len, nodes)))
        nodes.append(corners)
        ids.append(np.full(len(quads), face))
    every = np.concatenate(nodes)
    key = np.ravel_multi_index((every[:, 0], every[:, 1], every[:, 2]), (counts[0] + 1, counts[1] + 1, counts[2] + 1))
    _, first, where = np.unique(key, return_index=True, return_inverse=True)
    size = np.asarray(counts)
    return (2 * every[first] - size) / size, where[np.concatenate(triangles)], np.concatenate(ids)


def _patch(face: int, counts: tuple[int, int, int]) -> tuple[Int[np.ndarray, "m 3"], Int[np.ndarray, "k 3"]]:
    """Lattice nodes (m, 3) of one face of the cube, in steps from the least corner, and its triangles (k, 3)."""
    size = np.asarray(counts)
    across, upward = ACROSS[face].astype(np.int64), UPWARD[face].astype(np.int64)
    nu, nv = int(size @ np.abs(across)), int(size @ np.abs(upward))
    i, j = (index.ravel()[:, None] for index in np.meshgrid(np.arange(nu + 1), np.arange(nv + 1), indexing="ij"))
    start = size * ((across < 0) | (upward < 0))
    start[AXIS[face]] = size[AXIS[face]] if SIGN[face] > 0 else 0
    return start + i * across + j * upward, quads(nu, nv)


def quads(nu: int, nv: int) -> Int[np.ndarray, "k 3"]:
    """Triangles of a (nu + 1) x (nv + 1) grid of nodes stored with v fastest, counter-clockwise in (u, v)."""
    node = np.arange((nu + 1) * (nv + 1)).reshape(nu + 1, nv + 1)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]))
    return np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
