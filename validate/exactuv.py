"""Exact texture coordinates by face: every point against every face, in float64.

In: a mesh with texture coordinates and points. Out: the closest face, the closest point's barycentrics and texture
coordinates, their gradient in the surface, and how far they can be off. No tree, no grid, no library: a face is left
out only where its bounding sphere is farther than another face's corner.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh
from validate.facets import Facets

PAIRS = 1 << 22  # points times faces that are compared at once
# A foot is a sum of products of the mesh's size: it is off by a few units of its rounding, in each of three axes.
ROUNDING = 16 * np.finfo(np.float64).eps


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """What the mesh says at points: one reading for every face that is as near as asked for.

    Attributes
    ----------
    points
        How many points there are.
    point, face
        (k,) which point, and which face; ascending, by point and then by face.
    distance
        From the face, world units.
    barycentric
        Weights of the face's corners at the closest point; none is negative, and they sum to 1.
    uv, gradient
        Texture coordinates there, and their gradient in the face, per world unit.
    chart
        Of the face.
    """

    points: int
    point: Int[np.ndarray, " k"]
    face: Int[np.ndarray, " k"]
    distance: Float[np.ndarray, " k"]
    barycentric: Float[np.ndarray, "k 3"]
    uv: Float[np.ndarray, "k 2"]
    gradient: Float[np.ndarray, "k 2 3"]
    chart: Int[np.ndarray, " k"]

    def least(self, errors: Float[np.ndarray, " k"]) -> Float[np.ndarray, " n"]:
        """Of every point, the least of its readings' errors: who agrees with one of them is right."""
        least = np.full(self.points, np.inf)
        np.minimum.at(least, self.point, errors)
        return least


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What the mesh says at points: that of the closest face, of several the lowest.

    Attributes
    ----------
    face, distance, barycentric, uv, gradient, chart
        As in `Readings`, one per point.
    error
        How far `uv` can be off: what rounding does to it, or, where faces are equally near but for rounding and
        differ, by how much they differ.
    """

    face: Int[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    barycentric: Float[np.ndarray, "n 3"]
    uv: Float[np.ndarray, "n 2"]
    gradient: Float[np.ndarray, "n 2 3"]
    chart: Int[np.ndarray, " n"]
    error: Float[np.ndarray, " n"]


class ExactUv:
    """The texture coordinates of a mesh.

    Parameters
    ----------
    mesh
        Triangles with texture coordinates.

    Raises
    ------
    BadInput
        If the mesh has no faces, or no texture coordinates.
    """

    def __init__(self, mesh: Mesh) -> None:
        if mesh.uv is None:
            raise BadInput("exact texture coordinates were asked of a mesh that has none: unwrap it")
        self.mesh = mesh
        self.facets = Facets(mesh)
        low, high = mesh.bounds
        self.rounding = ROUNDING * float(np.abs([low, high]).max() + (high - low).max())
        corners = self.facets.corners
        self._centre = corners.mean(axis=1)
        self._radius = np.linalg.norm(corners - self._centre[:, None], axis=2).max(axis=1)

    def readings(self, points: Float[np.ndarray, "n 3"], slack: float = 0.0) -> Readings:
        """Read every face that is at most `slack` farther than the closest, rounding allowed for.

        Parameters
        ----------
        points
            World frame.
        slack
            World units, such as the rounding of the points themselves.
        """
        step = max(1, PAIRS // len(self._centre))
        pieces = [self._near(points[at : at + step], slack) for at in range(0, max(len(points), 1), step)]
        sizes = np.repeat(np.arange(0, max(len(points), 1), step), [len(piece[0]) for piece in pieces])
        point, face, distance, weights = (np.concatenate(column) for column in zip(*pieces, strict=True))
        return Readings(
            len(points),
            point + sizes,
            face,
            distance,
            weights,
            np.einsum("kc,kcu->ku", weights, self.facets.uv[face]),
            self.facets.uv_gradient[face],
            self.mesh.chart[face].astype(np.int64),
        )

    def at(self, points: Float[np.ndarray, "n 3"]) -> Truth:
        """Return what the closest face says, and its own error."""
        read = self.readings(points)
        order = np.lexsort((read.face, read.distance, read.point))
        first = order[np.searchsorted(read.point[order], np.arange(read.points))]
        differ = np.zeros(read.points)
        np.maximum.at(differ, read.point, np.linalg.norm(read.uv - read.uv[first][read.point], axis=1))
        return Truth(
            read.face[first],
            read.distance[first],
            read.barycentric[first],
            read.uv[first],
            read.gradient[first],
            read.chart[first],
            np.maximum(differ, self._rounded(read.face[first], np.abs(points).max(axis=1, initial=0.0))),
        )

    def _near(
        self, points: Float[np.ndarray, "m 3"], slack: float
    ) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
        """Point, face, distance and weights of all faces that are near enough."""
        from_centre = cdist(points, self._centre)
        within = (from_centre + self._radius).min(axis=1, initial=np.inf)[:, None]
        point, face = np.nonzero(from_centre - self._radius <= within + slack + self.rounding)
        distance, weights = foot(points[point], self.facets.corners[face])
        least = np.full(len(points), np.inf)
        np.minimum.at(least, point, distance)
        kept = np.flatnonzero(distance <= (least + slack + self.rounding)[point])
        return point[kept], face[kept], distance[kept], weights[kept]

    def _rounded(self, face: Int[np.ndarray, " n"], size: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """What a foot's rounding does: as a share of the face's least height, all that its texture has at most."""
        corners, uv = self.facets.corners[face], self.facets.uv[face]
        a, b, c = np.moveaxis(corners, 1, 0)
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        spread = np.linalg.norm(uv - np.roll(uv, 1, axis=1), axis=2).max(axis=1)
        share = (self.rounding + ROUNDING * size) * longest / np.where(area > 0, area, np.finfo(np.float64).tiny)
        return np.asarray(spread * np.minimum(share, 1.0) + ROUNDING * np.abs(uv).max(axis=(1, 2), initial=0.0))


def foot(
    p: Float[np.ndarray, "k 3"], corners: Float[np.ndarray, "k 3 3"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """Closest points of triangles, one each: distances and weights of the corners.

    The foot on the plane where it lies within the triangle, else the closest of the three edges. A foot of a sliver
    whose weights are mostly rounding is seen by its distance, which is measured from the point that they make.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    n = np.cross(b - a, c - a)
    square = np.sum(n * n, axis=1)
    square = np.where(square > 0, square, np.inf)
    second = np.sum(np.cross(p - a, c - a) * n, axis=1) / square
    third = np.sum(np.cross(b - a, p - a) * n, axis=1) / square
    inner = np.stack([1.0 - second - third, second, third], axis=1)
    usable = np.isfinite(square) & (inner >= 0).all(axis=1)
    options = [np.where(usable[:, None], inner, np.eye(3)[0])]
    for k in range(3):
        start, along = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        length = np.sum(along * along, axis=1)
        t = np.sum((p - start) * along, axis=1) / np.where(length > 0, length, 1.0)
        t = np.clip(t, 0.0, 1.0)[:, None]
        options.append((1.0 - t) * np.eye(3)[k] + t * np.eye(3)[(k + 1) % 3])
    weights = np.stack(options)
    distance = np.linalg.norm(np.einsum("okc,kcd->okd", weights, corners) - p, axis=2)
    best = distance.argmin(axis=0)
    rows = np.arange(len(p))
    return distance[best, rows], weights[best, rows]
