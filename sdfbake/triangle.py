"""The point of a triangle that is closest to a point, for many pairs at once.

In: points and triangles, one each. Out: distance, barycentric coordinates and the feature (interior, edge or vertex)
they lie on. The three edges are always tried beside the interior, so that slivers and degenerate triangles, whose
normal is mostly rounding, still give a point of the triangle no farther than its nearest edge.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

# Features: 0 is the interior, 1 + k the edge from corner k to corner k + 1, 4 + k the corner k.
INTERIOR, EDGE, CORNER = 0, 1, 4

Columns = Float[np.ndarray, "3 n"]


class Nearest(NamedTuple):
    """Closest points of triangles.

    Attributes
    ----------
    distance
        Unsigned.
    barycentric
        Weights of the three corners; exactly 0 for those that the feature does not touch.
    feature
        Where the point lies, int8: `INTERIOR`, `EDGE` + k or `CORNER` + k.
    """

    distance: Float[np.ndarray, " n"]
    barycentric: Float[np.ndarray, "n 3"]
    feature: Int[np.ndarray, " n"]


def nearest(p: Columns, a: Columns, b: Columns, c: Columns) -> Nearest:
    """Return the point of every triangle (a, b, c) that is closest to the point p of the same column.

    Parameters
    ----------
    p, a, b, c
        Coordinates as rows, one pair per column, all in one frame near the origin.
    """
    corners, weights = (a, b, c), np.zeros((3, p.shape[1]))
    best, feature = np.full(p.shape[1], np.inf), np.zeros(p.shape[1], np.int8)
    for k in range(3):
        start, end = corners[k], corners[(k + 1) % 3]
        square, t = _to_segment(p, start, end)
        nearer = square < best
        best = np.where(nearer, square, best)
        here = np.where(t <= 0, CORNER + k, np.where(t >= 1, CORNER + (k + 1) % 3, EDGE + k))
        feature = np.where(nearer, here, feature).astype(np.int8)
        for corner, weight in ((k, 1 - t), ((k + 1) % 3, t), ((k + 2) % 3, np.zeros_like(t))):
            weights[corner] = np.where(nearer, weight, weights[corner])
    height, inner = _to_plane(p, a, b, c)
    inside = (inner > 0).all(axis=0) & (height * height <= best)
    distance = np.where(inside, np.abs(height), np.sqrt(best))
    feature[inside] = INTERIOR
    return Nearest(distance, np.where(inside, inner, weights).T, feature)


def _to_segment(p: Columns, start: Columns, end: Columns) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return squared distance and place (0 to 1) of the closest point of a segment."""
    along, to = end - start, p - start
    length = dot(along, along)
    t = (dot(to, along) / np.where(length > 0, length, 1)).clip(0, 1)
    gap = to - t * along
    # From the far end the difference is taken there: start + 1 * along need not be the bits of end.
    gap = np.where(t >= 1, p - end, gap)
    return dot(gap, gap), t


def _to_plane(p: Columns, a: Columns, b: Columns, c: Columns) -> tuple[Float[np.ndarray, " n"], Columns]:
    """Return the signed height over the plane and the barycentric coordinates of the foot; -1 where there is none."""
    ab, ac, ap = b - a, c - a, p - a
    normal = cross(ab, ac)
    square = dot(normal, normal)
    usable = square > 0
    square = np.where(usable, square, 1)
    of_c, of_b = dot(cross(ab, ap), normal) / square, dot(cross(ap, ac), normal) / square
    inner = np.where(usable, np.stack([1 - of_b - of_c, of_b, of_c]), -1)
    return dot(ap, normal) / np.sqrt(square), inner


def dot(u: Columns, v: Columns) -> Float[np.ndarray, " n"]:
    """Return the scalar products of columns."""
    product: Float[np.ndarray, " n"] = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
    return product


def cross(u: Columns, v: Columns) -> Columns:
    """Return the vector products of columns."""
    return np.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
