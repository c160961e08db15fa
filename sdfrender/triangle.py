"""The point of a triangle that is closest to a place, as a renderer needs it: from one corner and two edges.

Edges that were taken in float64 keep their digits in float32, wherever the triangle lies.
"""

from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.vector import Vector, cross, dot, scale, subtract


class Nearest(NamedTuple):
    """The point of a triangle closest to a place: weights of its second and third corner, squared distance."""

    second: Array
    third: Array
    squared: Array


def nearest(xp: Engine, q: Vector, a: Vector, ab: Vector, ac: Vector) -> Nearest:
    """Return the point of the triangle (a, a + ab, a + ac) closest to q.

    Every candidate, on an edge or inside, is a point of the triangle, and its distance is computed from that point: a
    sliver, where the place of the foot is mostly rounding, is never taken to be closer than it is.
    """
    ap = subtract(q, a)
    bc = subtract(ac, ab)
    n = cross(ab, ac)
    twice = dot(n, n)
    flat = twice == 0
    inverse = 1.0 / xp.where(flat, 1.0, twice)
    along_b, along_c = _along(xp, ap, ab), _along(xp, ap, ac)
    past = _along(xp, subtract(ap, ab), bc)
    inner_b, inner_c = dot(n, cross(ap, ac)) * inverse, dot(n, cross(ab, ap)) * inverse
    inside = ~flat & (inner_b >= 0) & (inner_c >= 0) & (inner_b + inner_c <= 1)
    nothing = xp.full(ap[0], 0.0)
    second, third, squared = along_b, nothing, _gap(ap, ab, ac, along_b, nothing)
    for b, c, allowed in ((nothing, along_c, None), (1.0 - past, past, None), (inner_b, inner_c, inside)):
        distance = _gap(ap, ab, ac, b, c)
        closer = distance < squared if allowed is None else allowed & (distance <= squared)
        second, third = xp.where(closer, b, second), xp.where(closer, c, third)
        squared = xp.where(closer, distance, squared)
    return Nearest(second, third, squared)


def _along(xp: Engine, to: Vector, edge: Vector) -> Array:
    """Return how far along an edge a point's foot lies, 0 to 1."""
    squared = dot(edge, edge)
    return xp.minimum(xp.maximum(dot(to, edge) / xp.where(squared == 0, 1.0, squared), 0.0), 1.0)


def _gap(ap: Vector, ab: Vector, ac: Vector, second: Array, third: Array) -> Array:
    """Return the squared distance from a point of the triangle given by its weights."""
    gap = subtract(subtract(ap, scale(ab, second)), scale(ac, third))
    return dot(gap, gap)
