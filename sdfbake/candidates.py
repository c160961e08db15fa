"""Candidate faces of every brick, coarse to fine.

In: faces in voxels. Out: the bricks of 8^3 samples that may hold a sample in reach of the surface, each with the list
of all faces that may be closest to one of its samples. All cubes of a level are worked on together; a cube hands its
list down, and every child keeps what can still win there (`_may_win`) and is in reach.
"""

from collections.abc import Callable, Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sdfbake.bricks import SIDE, counts
from sdfbake.engine import Array, Engine
from sdfbake.engine.protocol import Lists, Measures
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


class Record(NamedTuple):
    """A triangle as `Faces.table` has it."""

    a: Point
    bb: Array
    b: Point
    bc: Array
    c: Point
    cc: Array
    over: tuple[Array, Array, Array, Array]


def record(xp: Engine, table: Array, face: Array) -> Record:
    """Look up triangles."""
    (ax, ay, az, bb), (bx, by, bz, bc), (cx, cy, cz, cc), over = (xp.rows(table, face * 4 + k, True) for k in range(4))
    return Record((ax, ay, az), bb, (bx, by, bz), bc, (cx, cy, cz), cc, over)


def offset(xp: Engine, triangle: Record, p: Point) -> Point:
    """Return the way from the closest point of triangles, of their edges or, if no edge is nearer, their interior."""
    to, b, c = minus(p, triangle.a), triangle.b, triangle.c
    bb, bc, cc, (over_b, over_c, over_e, over_area) = triangle.bb, triangle.bc, triangle.cc, triangle.over
    on_b, on_c = dot(to, b), dot(to, c)
    best = _along(xp, to, b, on_b * over_b)
    best = _nearer(xp, best, _along(xp, to, c, on_c * over_c))
    third = _along(xp, minus(to, b), minus(c, b), (on_c - on_b - bc + bb) * over_e)
    best = _nearer(xp, best, third)
    u, v = (cc * on_b - bc * on_c) * over_area, (bb * on_c - bc * on_b) * over_area
    foot = _less(_less(to, b, u), c, v)
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (over_area > 0) & (dot(foot, foot) < dot(best, best))
    return _chosen(xp, inside, foot, best)


def squares(xp: Engine, triangle: Record, corner: Point, side: Array) -> tuple[Array, ...]:
    """Return the squared distances of the corners of cubes from triangles, in C order."""
    gaps = (offset(xp, triangle, p) for p in _cube(corner, side))
    return tuple(dot(gap, gap) for gap in gaps)


def _cube(corner: Point, side: Array) -> Iterator[Point]:
    ends = [(c, c + side) for c in corner]
    return product(*ends)


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

    def measure(*corner: Array) -> Callable[[Array], tuple[Array, ...]]:
        return lambda face: squares(xp, record(xp, faces.table, face), (corner[0], corner[1], corner[2]), size)

    # The lane is the parent, and looks a face up once for its eight children.
    corner = [*(xp.real(c) * (2 * size) + half for c in cubes.at), xp.lanes(len(cubes.parent)) * 8]
    nearest = xp.interleaved(xp.first_least(cubes.lists, corner, measure, lambda least: 0.0))
    gap = offset(xp, record(xp, faces.table, nearest), centre)
    d = xp.sqrt(dot(gap, gap))
    most = xp.uniform(reach + radius + faces.slack)
    last = [xp.uniform((n - 1) // side) for n in shape]
    inside = (d <= most) & (x <= last[0]) & (y <= last[1]) & (z <= last[2])
    xp.settled(x, y, z, parent, d, inside, *gap)
    kept = xp.kept(inside)
    if len(kept) == 0:
        return None
    lists = xp.narrowed(cubes.lists, corner, _may_win(xp, faces, Known(inside, d, gap), (radius, most, size)))
    return taken(xp, Cubes(side, (x, y, z), lists, parent, d), kept)


class Known(NamedTuple):
    """What is known of cubes: whether they are kept, least distance of the centre, way from its closest point."""

    kept: Array
    distance: Array
    away: Point


def _may_win(xp: Engine, faces: Faces, known: Known, scale: tuple[float, Array, Array]) -> Measures:
    """Return the test of a face against the eight children of a cube.

    A distance from a convex set is convex: with u the direction away from the face, it is at least d_f + u.e at a
    sample that lies e from the centre. The closest point q of the centre is at most d + v.e + |e|^2 / 2 d from there,
    with v the direction away from it. With H the half side of the cube, e.(v - u) is at most H times the sum of the
    magnitudes of v - u, and |e| at most R. So the face can win only if d_f - d <= H |v - u|_1 + R^2 / 2 d, and if
    d_f - d <= 2 R anyhow.
    """
    radius, most, size = scale
    r, half = xp.uniform(radius), xp.uniform(radius / _ROOT3)
    slack, least = xp.uniform(faces.slack), xp.uniform(1e-6)

    def of_child(child: Array) -> Callable[[Point], Array]:
        kept, d, *away = _pick(xp, (known.kept, known.distance, *known.away), child)
        over = 1.0 / xp.maximum(d, least)
        vx, vy, vz = (w * over for w in away)
        bend, limit = 0.5 * r * r * over + slack * (r * over), d + 2 * slack

        def passes(gap: Point) -> Array:
            of_face = xp.sqrt(dot(gap, gap))
            over_face = 1.0 / xp.maximum(of_face, least)
            turn = minus((gap[0] * over_face, gap[1] * over_face, gap[2] * over_face), (vx, vy, vz))
            turned = xp.abs(turn[0]) + xp.abs(turn[1]) + xp.abs(turn[2])
            margin = xp.minimum(2 * r, half * turned + r * (slack * over_face) + bend)
            return (of_face <= xp.minimum(limit + margin, most)) & kept

        return passes

    def within(x: Array, y: Array, z: Array, first: Array) -> Callable[[Array], tuple[Array, ...]]:
        tests = [of_child(first + k) for k in range(8)]

        def masks(face: Array) -> tuple[Array, ...]:
            triangle = record(xp, faces.table, face)
            cubes = zip(tests, _cube((x, y, z), size), strict=True)
            return tuple(passes(offset(xp, triangle, p)) for passes, p in cubes)

        return masks

    return within


def ordered(xp: Engine, cubes: Cubes) -> Cubes:
    """Return bricks in C order of their places."""
    x, y, z = (np.asarray(c) for c in cubes.at)
    order = xp.table(np.lexsort((z, y, x)))
    return taken(xp, cubes, order)


def taken(xp: Engine, cubes: Cubes, which: Array) -> Cubes:
    """Return some of the cubes."""
    x, y, z, start, count, parent, distance = _pick(
        xp, (*cubes.at, cubes.lists.start, cubes.lists.count, cubes.parent, cubes.distance), which
    )
    xp.settled(x, y, z, start, count, parent, distance)
    return Cubes(cubes.side, (x, y, z), Lists(start, count, cubes.lists.items), parent, distance)


def places(cubes: Cubes) -> Int[np.ndarray, "k 3"]:
    """Return the places of cubes, in cubes of their side, int32."""
    return np.stack([np.asarray(c) for c in cubes.at], axis=-1).astype(np.int32)


def _pick(xp: Engine, arrays: tuple[Array, ...], index: Array) -> tuple[Array, ...]:
    return tuple(xp.gather(array, index, True) for array in arrays)
