"""The exact band: closest face and signed distance of every sample in reach.

In: bricks with candidate faces. Out: per sample the lowest closest face, and the float32 of its float64 distance.
Positions are lattice indices, which are exact; faces are in voxels. Cubes of 2^3 samples share a list; every sample
runs through it in double precision, and what follows from the winner is computed from its corners anew.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sdfbake import triangle
from sdfbake.bricks import SIDE
from sdfbake.candidates import Cubes, Faces, children, offset, record, records, squares, taken
from sdfbake.engine import Array, Engine
from sdfbake.engine.protocol import Lists, Measures
from sdfbake.sign import Pseudonormals
from sdfbake.topology import corners
from sdfbake.triangle import Point, dot, minus

_LEAF = 2  # samples along a cube that shares one list
_NODES = SIDE // _LEAF
_PAIRS = 1 << 21  # bricks' candidates worked on together: those of their leaves have room for some twenty times more
# Where interpolation is compared with exact distances: the centre of a cell, and where a Catmull-Rom spline, which is
# better at the centre than anywhere else, is worst.
PROBES = (0.5, 0.25)
_CELL = 3**0.5 / 2  # voxels from a cell's centre to its corners: farther, and there is no surface in it
# Two distances that differ by less are equal: well above what rounding makes of coordinates of the lattice's extent.
_TIE_EPS = 64 * 2.0**-53
_TIE_SHARE = 1e-10


class Normals(NamedTuple):
    """Pseudonormals on an engine: rows of four in `table`, and per face the rows of its seven features."""

    row: Array
    table: Array


class Target(NamedTuple):
    """A mesh on an engine, in voxels of a lattice.

    Attributes
    ----------
    coarse, fine
        Faces for single and for double precision.
    corners, vertices
        Three vertices of every face; rows of four, the last of them 0.
    normals
        For signs; None for unsigned distances.
    size
        Number of faces.
    shape
        Samples of the lattice.
    tie
        Voxels: distances nearer to each other than this are equal.
    inset
        Voxels that are taken off unsigned distances: the surface is that far from the faces, on both sides.
    probes
        Where in cells with surface distances are wanted too: `PROBES`, or nowhere.
    """

    coarse: Faces
    fine: Faces
    corners: Array
    vertices: Array
    normals: Normals | None
    size: int
    shape: tuple[int, int, int]
    tie: float
    inset: float
    probes: tuple[float, ...] = PROBES

    @staticmethod
    def of(
        xp: Engine,
        vertices: Float[np.ndarray, "v 3"],
        faces: Int[np.ndarray, "f 3"],
        shape: tuple[int, int, int],
        normals: Pseudonormals | None,
        inset: float = 0.0,
    ) -> "Target":
        """Bring a mesh to an engine; `vertices` in lattice coordinates, signs by `normals`, or else `inset`."""
        extent = float(max(shape))
        rows, slack = records(corners(vertices, faces), extent)
        features = None
        if normals is not None:
            stacked = np.concatenate([normals.of_face, normals.of_edge, normals.of_vertex]) * normals.outward
            at = np.cumsum([0, len(normals.of_face), len(normals.of_edge)])
            named = [np.arange(len(faces))[:, None], normals.surface.topology.edge, faces]
            of = np.concatenate([table + start for table, start in zip(named, at, strict=True)], axis=1)
            features = Normals(xp.table(of), xp.at(32).table(_rows_of_four(stacked)))
        return Target(
            Faces(xp.at(32).table(rows), slack),
            Faces(xp.at(64).table(rows), 0.0),
            xp.table(faces),
            xp.at(64).table(_rows_of_four(vertices)),
            features,
            len(faces),
            shape,
            _TIE_EPS * extent,
            inset,
        )


class Band(NamedTuple):
    """Samples of some bricks, 512 each in C order.

    Attributes
    ----------
    face
        Row of the target's faces, int32; -1 out of reach.
    distance
        Signed if the target has normals, world units; +-reach where the sample is farther than that. Outside the
        lattice face is -1, and the distance means nothing.
    probe
        Distances, world units, at the target's probes in the cells with surface whose first samples have even indices;
        NaN elsewhere.
    """

    face: Int[np.ndarray, "b 512"]
    distance: Float[np.ndarray, "b 512"]
    probe: Float[np.ndarray, "b 64 p"]


def filled(
    xp: Engine, target: Target, bricks: Cubes, reach: float, spacing: float, at_once: int
) -> Iterator[tuple[slice, Band]]:
    """Yield the samples of all bricks, some bricks at a time.

    Parameters
    ----------
    xp
        The engine.
    target, bricks
        The mesh, and bricks with candidates.
    reach
        Voxels.
    spacing
        World units per voxel: distances are multiplied by it before they are rounded.
    at_once
        Bricks worked on together; memory is in proportion, and the result does not depend on it.
    """
    for part in _parts(np.asarray(bricks.lists.count), at_once):
        some = taken(xp, bricks, xp.lanes(part.stop - part.start) + xp.uniform(part.start))
        yield part, _fill(xp, target, some, reach, spacing)


def _parts(counts: Int[np.ndarray, " b"], at_once: int) -> list[slice]:
    """Cut a row of bricks where there are enough of them, or enough candidates."""
    before = np.cumsum(counts, dtype=np.int64) - counts
    cuts, start = [], 0
    while start < len(counts):
        stop = int(np.searchsorted(before, before[start] + _PAIRS))
        stop = min(max(stop, start + 1), start + at_once)
        cuts.append(slice(start, min(stop, len(counts))))
        start = stop
    return cuts


def _fill(xp: Engine, target: Target, bricks: Cubes, reach: float, spacing: float) -> Band:
    """Evaluate the samples of some bricks and put them in their places."""
    count = len(bricks.parent)
    leaves, owner = _leaves(xp, target, bricks, reach)
    if leaves is None:
        far = np.full((count, SIDE**3), reach * spacing, np.float32)
        nothing = np.full((count, _NODES**3, len(target.probes)), np.nan, np.float32)
        return Band(np.full(far.shape, -1, np.int32), far, nothing)
    face, values, side = _samples(xp, target, (leaves, owner), count, (reach, spacing))
    probes = [_probed(xp, target, (leaves, owner), count, (at, spacing)) for at in target.probes]
    xp.settled(face, values, *probes, *([] if side is None else [side]))
    found, distance = np.array(face).reshape(count, -1), np.array(values).reshape(count, -1)
    if side is not None:
        distance = _sided(found, distance, np.array(side).astype(np.int8).reshape(count, *[_NODES] * 3))
    probed = np.array(probes, np.float32).reshape(len(probes), count, _NODES**3)
    return Band(found, distance, np.moveaxis(probed, 0, -1))


def _leaves(xp: Engine, target: Target, bricks: Cubes, reach: float) -> tuple[Cubes | None, Array]:
    """Go down to cubes of 2^3 samples; also return the brick of each."""
    cubes: Cubes | None = bricks
    owner = xp.lanes(len(bricks.parent))
    while cubes is not None and cubes.side > _LEAF:
        cubes = children(xp.at(32), target.coarse, cubes, target.shape, reach + target.inset)
        owner = owner if cubes is None else xp.gather(owner, cubes.parent, True)
    return cubes, owner


def _samples(
    xp: Engine, target: Target, leaves: tuple[Cubes, Array], count: int, scale: tuple[float, float]
) -> tuple[Array, Array, Array | None]:
    """Return closest faces, distances and, if these are signed, the sides of leaves, in the order of bricks."""
    cubes, owner = leaves
    reach, spacing = scale
    fine, size = xp.at(64), count * SIDE**3
    # The lane is the leaf, and looks a face up once for its eight samples.
    first = [fine.real(c * _LEAF) for c in cubes.at]
    winner = xp.interleaved(_winners(fine, target, cubes.lists, first))
    lane = xp.lanes(len(cubes.parent) * _LEAF**3)
    cube = lane >> 3
    x, y, z = (xp.gather(cubes.at[k], cube, True) * _LEAF + ((lane >> (2 - k)) & 1) for k in range(3))
    distance = _signed(fine, target, winner, (fine.real(x), fine.real(y), fine.real(z)))
    brick, most, unit = xp.gather(owner, cube, True), fine.uniform(reach), fine.uniform(spacing)
    nx, ny, nz = (xp.uniform(n) for n in target.shape)
    inside = (x < nx) & (y < ny) & (z < nz)
    known = inside & (xp.abs(distance) <= most)
    place, node = _within(brick, (x, y, z), SIDE, 0), _within(brick, (x, y, z), _NODES, 1)
    faces = xp.scattered(size, -1, place, winner, known)
    if target.normals is None:  # what lies deeper than the reach in a shell is known to do so
        known, distance = inside & (distance <= most), xp.maximum(distance, -most)
    values = xp.at(32).scattered(size, reach * spacing, place, distance * unit, known)
    if target.normals is None:
        return faces, values, None
    side = xp.where(distance < 0, -1, xp.full(lane, 1))
    return faces, values, xp.scattered(count * _NODES**3, 0, node, side, known)


def _probed(xp: Engine, target: Target, leaves: tuple[Cubes, Array], count: int, scale: tuple[float, float]) -> Array:
    """Return distances at a place, the same along every axis, in the leaves with surface: these are cells."""
    cubes, owner = leaves
    place, spacing = scale
    fine = xp.at(64)
    distance = fine.real(xp.gather(cubes.distance, xp.lanes(len(owner)), True)) - fine.uniform(target.inset)
    some = xp.kept(xp.abs(distance) <= fine.uniform(_CELL))
    if len(some) == 0:
        none = xp.lanes(1)
        return xp.at(32).scattered(count * _NODES**3, float("nan"), none, fine.real(none), none < 0)
    at = [xp.gather(cubes.at[k], some, True) for k in range(3)]
    within = fine.uniform(place)
    p = (fine.real(at[0] * 2) + within, fine.real(at[1] * 2) + within, fine.real(at[2] * 2) + within)
    lists = Lists(xp.gather(cubes.lists.start, some, True), xp.gather(cubes.lists.count, some, True), cubes.lists.items)
    (winner,) = fine.first_least(lists, p, _from_point(fine, target), _tie(fine, target))
    exact = _signed(fine, target, winner, p)
    node = _within(xp.gather(owner, some, True), (at[0], at[1], at[2]), _NODES, 0)
    return xp.at(32).scattered(count * _NODES**3, float("nan"), node, exact * fine.uniform(spacing), some >= 0)


def _within(brick: Array, at: Point, side: int, shift: int) -> Array:
    """Return the number of a place in an array of bricks with that many entries along each axis."""
    x, y, z = ((c >> shift) & (side - 1) for c in at)
    return ((brick * side + x) * side + y) * side + z


def _winners(xp: Engine, target: Target, lists: Lists, first: list[Array]) -> tuple[Array, ...]:
    """Return the lowest closest face of every sample of leaves."""
    one = xp.uniform(1.0)

    def distances(*p: Array) -> Callable[[Array], tuple[Array, ...]]:
        def of_face(face: Array) -> tuple[Array, ...]:
            of_corners = squares(xp, record(xp, target.fine.table, face), (p[0], p[1], p[2]), one)
            return tuple(xp.sqrt(square) for square in of_corners)

        return of_face

    return xp.first_least(lists, first, distances, _tie(xp, target))


def _from_point(xp: Engine, target: Target) -> Measures:
    """Return the distance of faces from single points."""

    def distance(*p: Array) -> Callable[[Array], tuple[Array, ...]]:
        def of_face(face: Array) -> tuple[Array, ...]:
            gap = offset(xp, record(xp, target.fine.table, face), (p[0], p[1], p[2]))
            return (xp.sqrt(dot(gap, gap)),)

        return of_face

    return distance


def _tie(xp: Engine, target: Target) -> Callable[[Array], Array]:
    """Return by how much distances may differ and be the same."""
    tie = xp.uniform(target.tie)
    return lambda least: least * _TIE_SHARE + tie


def _signed(xp: Engine, target: Target, face: Array, p: Point) -> Array:
    """Return distances from given faces, signed by the pseudonormal of the closest feature."""
    corner = [xp.gather(target.corners, face * 3 + k, True) for k in range(3)]
    a, b, c = (xp.rows(target.vertices, vertex, True)[:3] for vertex in corner)
    at = triangle.nearest(xp, p, (a, b, c))
    if target.normals is None:
        return at.distance - xp.uniform(target.inset)
    row = xp.gather(target.normals.row, face * 7 + at.feature, True)
    rows = xp.at(32).rows(target.normals.table, row, True)
    normal = (xp.real(rows[0]), xp.real(rows[1]), xp.real(rows[2]))
    # From a corner of the feature rather than from the closest point, whose rounding is left out that way.
    use_b, use_c = _starts_at(xp, at.feature, 1), _starts_at(xp, at.feature, 2)
    x, y, z = (xp.where(use_b, b[k], xp.where(use_c, c[k], a[k])) for k in range(3))
    # What is on the surface but for rounding is outside, on every engine.
    negative = (dot(minus(p, (x, y, z)), normal) < 0) & (at.distance > xp.uniform(target.tie))
    return xp.where(negative, -at.distance, at.distance)


def _starts_at(xp: Engine, feature: Array, k: int) -> Array:
    return (feature == triangle.EDGE + k) | (feature == triangle.CORNER + k)


def _sided(
    face: Int[np.ndarray, "b 512"], distance: Float[np.ndarray, "b 512"], side: Int[np.ndarray, "b 4 4 4"]
) -> Float[np.ndarray, "b 512"]:
    """Give samples out of reach the sign of their neighbours.

    `side` is 0 for cubes without any sample in reach. Their samples, and those of a cube next to one, are too far from
    the surface for it to pass between them: all have one sign, which spreads from cube to cube.
    """
    waiting = np.flatnonzero((side == 0).any(axis=(1, 2, 3)) & (side != 0).any(axis=(1, 2, 3)))
    some = side[waiting]
    while (some == 0).any():
        for axis in (1, 2, 3):
            row = np.moveaxis(some, axis, 0)
            for near, far in ((0, 1), (1, 2), (2, 3), (3, 2), (2, 1), (1, 0)):
                row[far] = np.where(row[far] == 0, row[near], row[far])
    side[waiting] = some
    signs = side.repeat(_LEAF, 1).repeat(_LEAF, 2).repeat(_LEAF, 3).reshape(len(side), -1)
    return np.where(face < 0, distance * signs, distance)


def _rows_of_four(v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    return np.concatenate([v, np.zeros((len(v), 1))], axis=1)
