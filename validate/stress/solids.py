"""Solids that are known, and meshes of them that are broken in one way each.

In: nothing. Out: convex polytopes, whose inside is a few inequalities, their unions, and their broken meshes.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull

from sdfbake import Mesh

RADIUS = 0.8
AXIS = np.array([0.36, 0.48, 0.8])  # where holes are cut, patches turned: along no axis of the lattice
AT_ONCE = 512  # places that are held against all planes together: a few MB, in the caches


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A union of convex polytopes, and a mesh of it; the intended solid of a broken one.

    Attributes
    ----------
    mesh
        Triangles, one polytope after another.
    planes
        Of every polytope (f, 4): unit normals outward and minus their offsets.
    """

    mesh: Mesh
    planes: tuple[Float[np.ndarray, "_ 4"], ...]

    def depth(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Signed, negative inside; its magnitude is at most the distance from the nearest polytope's faces."""
        return np.asarray(np.minimum.reduce([_depth(plane, p) for plane in self.planes]))

    def with_faces(self, faces: np.ndarray) -> "Solid":
        """The same solid, told by other faces."""
        return replace(self, mesh=Mesh(self.mesh.vertices, faces))


def _depth(planes: Float[np.ndarray, "f 4"], p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Of one polytope: the height above its highest plane; within the largest ball inside it, that below the ball."""
    # A ball about the point from which the planes are nearest to even; any point inside would do.
    centre = np.linalg.lstsq(planes[:, :3], planes[:, 3].mean() - planes[:, 3], rcond=None)[0]
    inner = -(planes[:, :3] @ centre + planes[:, 3]).max()
    depth = np.linalg.norm(p - centre, axis=1) - inner
    near = np.flatnonzero(depth > 0)
    for some in (planes[::16], planes):  # above one plane is outside, and a few planes settle most places
        a, b, c, offset = some.T[:, :, None]
        for start in range(0, len(near), AT_ONCE):
            part = near[start : start + AT_ONCE]
            x, y, z = p[part].T
            depth[part] = (a * x + b * y + (c * z + offset)).max(axis=0)  # with sums of three no library is quicker
        near = near[depth[near] <= 0]
    return np.asarray(depth)


def ball(centre: tuple[float, float, float] = (0.0, 0.0, 0.0), count: int = 300) -> Solid:
    """The convex hull of points spread evenly over a sphere along a spiral."""
    step = np.arange(count) + 0.5
    z, turn = 1 - 2 * step / count, np.pi * (1 + np.sqrt(5)) * step
    r = np.sqrt(1 - z * z)
    return hull(RADIUS * np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=-1) + centre)


def hull(points: Float[np.ndarray, "v 3"]) -> Solid:
    """The convex hull of points that are all corners of it, as an oriented mesh."""
    found = ConvexHull(points)
    faces, planes = found.simplices.astype(np.int64), found.equations
    a, b, c = np.moveaxis(points[faces], 1, 0)
    inward = np.sum(np.cross(b - a, c - a) * planes[:, :3], axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Solid(Mesh(points, faces), (planes,))


def union(*solids: Solid) -> Solid:
    """Several solids as one mesh; where they overlap, faces cross."""
    offsets = np.cumsum([0, *(len(solid.mesh.vertices) for solid in solids)])
    faces = [solid.mesh.faces + offset for solid, offset in zip(solids, offsets, strict=False)]
    vertices = np.concatenate([solid.mesh.vertices for solid in solids])
    return Solid(Mesh(vertices, np.concatenate(faces)), sum((solid.planes for solid in solids), ()))


def around(solid: Solid, cosine: float) -> Bool[np.ndarray, " f"]:
    """Faces whose middle, seen from the origin, is within an angle of `AXIS`."""
    middle = solid.mesh.vertices[solid.mesh.faces].mean(axis=1)
    return np.asarray(middle @ AXIS > cosine * np.linalg.norm(middle, axis=1))


def flipped(solid: Solid, which: Bool[np.ndarray, " f"]) -> Solid:
    """Some faces look the other way."""
    return solid.with_faces(np.where(which[:, None], solid.mesh.faces[:, ::-1], solid.mesh.faces))


def fan(spokes: int = 800) -> Solid:
    """A double cone: two apexes where hundreds of slivers meet, each 1 / 160 as wide as long."""
    turn = 2 * np.pi * np.arange(spokes) / spokes
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    frame = np.linalg.qr(np.stack([AXIS, [1.0, 0, 0], [0, 1.0, 0]], axis=1))[0]
    points = RADIUS * np.concatenate([rim, [[0, 0, 0.8], [0, 0, -0.8]]]) @ frame[:, [1, 2, 0]].T
    i = np.arange(spokes)
    j = (i + 1) % spokes
    up, down = np.full(spokes, spokes), np.full(spokes, spokes + 1)
    faces = np.concatenate([np.stack([i, j, up], -1), np.stack([j, i, down], -1)])
    a, b, c = np.moveaxis(points[faces], 1, 0)
    n = np.cross(b - a, c - a)
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    if np.sum(n[0] * a[0]) < 0:
        faces, n = faces[:, ::-1], -n
    planes = np.concatenate([n, -np.sum(n * a, axis=1, keepdims=True)], axis=1)
    return Solid(Mesh(points, faces), (planes,))


def edge_to_edge() -> Solid:
    """Two boxes that touch along an edge alone: four faces meet there."""
    low = _box(np.zeros(3), np.array([0.5, 0.6, 0.7]))
    high = _box(np.array([0.5, 0.6, 0.0]), np.array([1.1, 1.1, 0.7]))
    both = union(low, high)
    vertices, place = np.unique(both.mesh.vertices, axis=0, return_inverse=True)
    return replace(both, mesh=Mesh(vertices, place.reshape(-1)[both.mesh.faces]))


def divided() -> Solid:
    """A box with a wall across its inside: three faces meet at each of the wall's edges."""
    low = _box(np.zeros(3), np.array([0.5, 0.6, 0.7]))
    high = _box(np.array([0.5, 0.0, 0.0]), np.array([1.1, 0.6, 0.7]))
    both = union(low, high)
    vertices, place = np.unique(both.mesh.vertices, axis=0, return_inverse=True)
    faces = place.reshape(-1)[both.mesh.faces]
    wall = (vertices[faces][:, :, 0] == 0.5).all(axis=1)
    once = ~wall | (np.cumsum(wall) <= wall.sum() // 2)  # of the two boxes' own walls, one
    return replace(both, mesh=Mesh(vertices, faces[once]))


def _box(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Solid:
    return hull(np.where(np.indices((2, 2, 2)).reshape(3, -1).T == 1, high, low))
