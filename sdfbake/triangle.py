"""The point of a triangle that is closest to a point, for many pairs at once, on any engine.

In: points and triangles, one each, as components. Out: distance, barycentric coordinates and the feature (interior,
edge or vertex) they lie on. The three edges are always tried beside the interior, so that slivers and degenerate
triangles, whose normal is mostly rounding, still give a point of the triangle no farther than its nearest edge.
"""

from typing import NamedTuple

from sdfbake.engine import Array, Engine

# Features: 0 is the interior, 1 + k the edge from corner k to corner k + 1, 4 + k the corner k.
INTERIOR, EDGE, CORNER = 0, 1, 4

Point = tuple[Array, Array, Array]


class Nearest(NamedTuple):
    """Closest points of triangles.

    Attributes
    ----------
    distance
        Unsigned.
    barycentric
        Weights of the three corners; exactly 0 for those that the feature does not touch.
    feature
        Where the point lies: `INTERIOR`, `EDGE` + k or `CORNER` + k.
    """

    distance: Array
    barycentric: Point
    feature: Array


class _Best(NamedTuple):
    """The nearest point of the edges so far: squared distance, place on the edge, feature, which edge."""

    square: Array
    along: Array
    feature: Array
    edge: Array


def nearest(xp: Engine, p: Point, corners: tuple[Point, Point, Point]) -> Nearest:
    """Return the point of every triangle that is closest to the point of the same lane.

    Parameters
    ----------
    xp
        The engine whose arrays these are.
    p, corners
        Components, all in one frame near the origin.
    """
    best = _on_edge(xp, p, corners, 0)
    for k in (1, 2):
        other = _on_edge(xp, p, corners, k)
        nearer = other.square < best.square
        best = _Best(*(xp.where(nearer, new, old) for new, old in zip(other, best, strict=True)))
    height, inner = _over_plane(xp, p, *corners)
    inside = (inner[0] > 0) & (inner[1] > 0) & (inner[2] > 0) & (height * height <= best.square)
    distance = xp.where(inside, xp.abs(height), xp.sqrt(best.square))
    weights = []
    for k in range(3):
        on = xp.where(best.edge == k, 1 - best.along, xp.where(best.edge == (k + 2) % 3, best.along, 0.0))
        weights.append(xp.where(inside, inner[k], on))
    return Nearest(distance, (weights[0], weights[1], weights[2]), xp.where(inside, INTERIOR, best.feature))


def _on_edge(xp: Engine, p: Point, corners: tuple[Point, Point, Point], k: int) -> _Best:
    """Return the closest point of the edge from corner k to the next."""
    start, end = corners[k], corners[(k + 1) % 3]
    along, to = minus(end, start), minus(p, start)
    length = dot(along, along)
    t = xp.minimum(xp.maximum(dot(to, along) / xp.where(length > 0, length, 1.0), 0.0), 1.0)
    gap = (to[0] - t * along[0], to[1] - t * along[1], to[2] - t * along[2])
    # From the far end the difference is taken there: start + 1 * along need not be the bits of end.
    far = minus(p, end)
    square = xp.where(t >= 1, dot(far, far), dot(gap, gap))
    feature = xp.where(t <= 0, CORNER + k, xp.where(t >= 1, CORNER + (k + 1) % 3, xp.full(t, EDGE + k)))
    return _Best(square, t, feature, xp.full(t, k))


def _over_plane(xp: Engine, p: Point, a: Point, b: Point, c: Point) -> tuple[Array, Point]:
    """Return the signed height over the plane and the barycentric coordinates of the foot; -1 where there is none."""
    ab, ac, ap = minus(b, a), minus(c, a), minus(p, a)
    normal = cross(ab, ac)
    square = dot(normal, normal)
    usable = square > 0
    square = xp.where(usable, square, 1.0)
    of_c, of_b = dot(cross(ab, ap), normal) / square, dot(cross(ap, ac), normal) / square
    inner = tuple(xp.where(usable, weight, -1.0) for weight in (1 - of_b - of_c, of_b, of_c))
    return dot(ap, normal) / xp.sqrt(square), (inner[0], inner[1], inner[2])


def minus(u: Point, v: Point) -> Point:
    """Return differences."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


def dot(u: Point, v: Point) -> Array:
    """Return scalar products."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def cross(u: Point, v: Point) -> Point:
    """Return vector products."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
