"""Candidate faces of every brick, coarse to fine.

In: faces in voxels. Out: the bricks of 8^3 samples that may hold a sample in reach of the surface, each with the list
of all faces that may be closest to one of its samples. All cubes of a level are worked on together; a cube hands its
list down, and every child keeps what can still win there (`_may_win`) and is in reach.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sdfbake.bricks import SIDE, counts
from sdfbake.engine import Array, Engine
from sdfbake.engine.protocol import Lists
from sdfbake.topology import cross
from sdfbake.triangle import Point, dot, minus

_HALF_EPS32 = 2.0**-24
_ROOT3 = 3.0**0.5


class Faces(NamedTuple):
    """Triangles as a fast distance wants them, on one engine.

    Attributes
    ----------
    table
        Four rows of four per face: corner and |ab|^2; edge ab and ab.ac; edge ac and |ac|^2; the inverses of |ab|^2,
        |ac|^2, |bc|^2 and |ab x ac|^2 (0 where that is 0).
    slack
        More than the fast distance can be too long by, voxels.
    """

    table: Array
    slack: float


class Cubes(NamedTuple):
    """Cubes of `side` samples along each axis, with their candidates.

    Attributes
    ----------
    side
        Samples.
    at
        First sample over the side: integers.
    lists
        Candidate faces in ascending order.
    parent
        Number of the cube they come from.
    distance
        Of the centre from the nearest candidate, voxels, in single precision.
    """

    side: int
    at: Point
    lists: Lists
    parent: Array
    distance: Array


def records(p: Float[np.ndarray, "3 3 f"], extent: float) -> tuple[Float[np.ndarray, "f 16"], float]:
    """Return the rows of `Faces.table` and the slack that single precision needs.

    A coordinate is rounded by at most `extent` / 2^24, which moves a corner and what follows from it by less than
    16 of those. The foot on the plane is found by dividing by sin^2 of the angle at the corner, which loses as many
    digits as the triangle is thin; but the nearest edge is never farther than the least altitude from that foot.

    Parameters
    ----------
    p
        Corners, components, faces; voxels.
    extent
        Voxels.
    """
    # The corner opposite to the longest edge comes first: the angle there is the best to divide by.
    length = ((p - p[[1, 2, 0]]) ** 2).sum(axis=1)
    longest = length.argmax(axis=0)
    a, b, c = (_turned(p, longest, k) for k in (2, 0, 1))
    ab, ac = b - a, c - a
    bb, bc, cc, turn = (ab * ab).sum(0), (ab * ac).sum(0), (ac * ac).sum(0), cross(ab, ac)
    squares = np.stack([bb, cc, ((ac - ab) ** 2).sum(0), (turn * turn).sum(0)])
    inverse = np.divide(1.0, squares, out=np.zeros_like(squares), where=squares > 0)
    sine = squares[3] * inverse[0] * inverse[1]
    lost = np.divide(8 * _HALF_EPS32 * extent, sine, out=np.full(len(sine), np.inf), where=sine > 0)
    altitude = np.sqrt(squares[3] * inverse[2])
    rows = np.stack([*a, bb, *ab, bc, *ac, cc, *inverse], axis=-1)
    return rows, float(16 * _HALF_EPS32 * extent + np.minimum(lost, altitude).max(initial=0.0))


def _turned(p: Float[np.ndarray, "3 3 f"], longest: Int[np.ndarray, " f"], k: int) -> Float[np.ndarray, "3 f"]:
    """Return corner `longest` + k of every face."""
    corner: Float[np.ndarray, "3 f"] = np.where(
        longest == 0, p[k], np.where(longest == 1, p[(k + 1) % 3], p[(k + 2) % 3])
    )
    return corner


def offset(xp: Engine, table: Array, face: Array, p: Point) -> Point:
    """Return the way from the closest point of triangles, of their edges or, if no edge is nearer, their interior."""
    row = face * 4
    rows = [xp.rows(table, row + k, True) for k in range(4)]
    (ax, ay, az, bb), (bx, by, bz, bc), (cx, cy, cz, cc), (over_b, over_c, over_e, over_area) = rows
    to, b, c = (p[0] - ax, p[1] - ay, p[2] - az), (bx, by, bz), (cx, cy, cz)
    on_b, on_c = dot(to, b), dot(to, c)
    best = _along(xp, to, b, on_b * over_b)
    best = _nearer(xp, best, _along(xp, to, c, on_c * over_c))
    third = _along(xp, minus(to, b), minus(c, b), (on_c - on_b - bc + bb) * over_e)
    best = _nearer(xp, best, third)
    u, v = (cc * on_b - bc * on_c) * over_area, (bb * on_c - bc * on_b) * over_area
    foot = _less(_less(to, b, u), c, v)
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (over_area > 0) & (dot(foot, foot) < dot(best, best))
    return _chosen(xp, inside, foot, best)


def square(xp: Engine, table: Array, face: Array, p: Point) -> Array:
    """Return squared distances from triangles."""
    gap = offset(xp, table, face, p)
    return dot(gap, gap)


def _along(xp: Engine, to: Point, edge: Point, t: Array) -> Point:
    return _less(to, edge, xp.minimum(xp.maximum(t, 0.0), 1.0))


def _less(to: Point, edge: Point, t: Array) -> Point:
    return to[0] - t * edge[0], to[1] - t * edge[1], to[2] - t * edge[2]


def _nearer(xp: Engine, one: Point, other: Point) -> Point:
    return _chosen(xp, dot(other, other) < dot(one, one), other, one)


def _chosen(xp: Engine, mask: Array, yes: Point, no: Point) -> Point:
    return xp.where(mask, yes[0], no[0]), xp.where(mask, yes[1], no[1]), xp.where(mask, yes[2], no[2])


def brick_candidates(xp: Engine, faces: Faces, count: int, shape: tuple[int, int, int], reach: float) -> Cubes | None:
    """Descend from one cube around the lattice to bricks.

    Parameters
    ----------
    xp
        The engine, in single precision.
    faces, count
        The triangles, and how many.
    shape
        Samples of the lattice.
    reach
        Voxels.

    Returns
    -------
    Cubes
        Bricks in C order; None where nothing is in reach.
    """
    side = SIDE << int(np.ceil(np.log2(max(counts(shape)))))
    zero = xp.lanes(1) * 0
    everything = Lists(zero, zero + count, xp.lanes(count))
    cubes: Cubes | None = Cubes(side, (zero, zero, zero), everything, zero, xp.real(zero))
    if side == SIDE:
        return cubes
    while cubes is not None and cubes.side > SIDE:
        cubes = children(xp, faces, cubes, shape, reach)
    return cubes and ordered(xp, cubes)


def children(xp: Engine, faces: Faces, cubes: Cubes, shape: tuple[int, int, int], reach: float) -> Cubes | None:
    """Halve the side of cubes; children out of reach, or outside the lattice, are dropped. None if none is left."""
    side = cubes.side // 2
    size, half = xp.uniform(float(side)), xp.uniform((side - 1) / 2)
    radius = _ROOT3 * (side - 1) / 2
    lane = xp.lanes(8 * len(cubes.parent))
    parent = lane >> 3
    at = _pick(xp, cubes.at, parent)
    x, y, z = (at[k] * 2 + ((lane >> (2 - k)) & 1) for k in range(3))
    centre = (xp.real(x) * size + half, xp.real(y) * size + half, xp.real(z) * size + half)

    def measure(face: Array, *p: Array) -> Array:
        return square(xp, faces.table, face, (p[0], p[1], p[2]))

    inherited = _inherited(xp, cubes.lists, parent)
    nearest = xp.first_least(inherited, centre, measure, lambda least: 0.0)
    gap = offset(xp, faces.table, nearest, centre)
    d = xp.sqrt(dot(gap, gap))
    xp.settled(x, y, z, d, *gap)  # asked for twice below
    most = xp.uniform(reach + radius + faces.slack)
    last = [xp.uniform((n - 1) // side) for n in shape]
    kept = xp.kept((d <= most) & (x <= last[0]) & (y <= last[1]) & (z <= last[2]))
    if len(kept) == 0:
        return None
    x, y, z, parent, *lane = _pick(xp, (x, y, z, parent, *centre, d, *gap), kept)
    inherited = _inherited(xp, cubes.lists, parent)
    xp.settled(x, y, z, parent, lane[3])
    lists = xp.narrowed(inherited, lane, _may_win(xp, faces, radius, most))
    return Cubes(side, (x, y, z), lists, parent, lane[3])


def _inherited(xp: Engine, lists: Lists, parent: Array) -> Lists:
    """Return the lists of some parents."""
    return Lists(xp.gather(lists.start, parent, True), xp.gather(lists.count, parent, True), lists.items)


def _may_win(xp: Engine, faces: Faces, radius: float, most: Array) -> Callable[..., Array]:
    """Return the test of a face against what is known of a cube: centre, least distance, way from the closest point.

    A distance from a convex set is convex: with u the direction away from the face, it is at least d_f + u.e at a
    sample that lies e from the centre. The closest point q of the centre is at most d + v.e + |e|^2 / 2 d from there,
    with v the direction away from it. So the face can win only if d_f - d <= R |u - v| + R^2 / 2 d, and <= 2 R anyhow.
    """
    r, slack, least = xp.uniform(radius), xp.uniform(faces.slack), xp.uniform(1e-6)

    def within(face: Array, *known: Array) -> Array:
        d, away = known[3], (known[4], known[5], known[6])
        gap = offset(xp, faces.table, face, (known[0], known[1], known[2]))
        of_face = xp.sqrt(dot(gap, gap))
        over, over_face = 1.0 / xp.maximum(d, least), 1.0 / xp.maximum(of_face, least)
        turn = tuple(gap[k] * over_face - away[k] * over for k in range(3))
        turned = xp.sqrt(dot(turn, turn)) + slack * (over + over_face)
        margin = xp.minimum(2 * r, r * (turned + 0.5 * r * over))
        return of_face <= xp.minimum(d + margin + 2 * slack, most)

    return within


def ordered(xp: Engine, cubes: Cubes) -> Cubes:
    """Return bricks in C order of their places."""
    x, y, z = (np.asarray(c) for c in cubes.at)
    order = xp.table(np.lexsort((z, y, x)))
    return taken(xp, cubes, order)


def taken(xp: Engine, cubes: Cubes, which: Array) -> Cubes:
    """Return some of the cubes, as if they had no parents."""
    x, y, z, start, count, distance = _pick(
        xp, (*cubes.at, cubes.lists.start, cubes.lists.count, cubes.distance), which
    )
    parent = xp.lanes(len(which))
    xp.settled(x, y, z, start, count, parent, distance)
    return Cubes(cubes.side, (x, y, z), Lists(start, count, cubes.lists.items), parent, distance)


def places(cubes: Cubes) -> Int[np.ndarray, "k 3"]:
    """Return the places of cubes, in cubes of their side, int32."""
    return np.stack([np.asarray(c) for c in cubes.at], axis=-1).astype(np.int32)


def _pick(xp: Engine, arrays: tuple[Array, ...], index: Array) -> tuple[Array, ...]:
    return tuple(xp.gather(array, index, True) for array in arrays)
