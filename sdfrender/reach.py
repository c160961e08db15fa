"""Which bricks of a grid the rays of a picture can meet before they first hit something.

In: a view, and where a grid stands. Out: convex sets around the rays, in grid coordinates, and the bricks that these
touch, with those around each: never too few. A ray walks through cells that lie within its rounding of it
(docs/tracing.md): less than a voxel. How far it goes at once in such a cell depends on the cells up to 7 away, and what
is prepared of these on samples up to 3 away from them; and the rounding bound of a cell is that of its brick. So a
picture is the same, bit for bit, as with whole grids.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sdfbake.bricks import SIDE, Bricks
from sdfbake.lattice import Lattice
from sdfrender.camera import AnyCamera, OrthographicCamera
from sdfrender.rays import Rays
from sdfrender.similarity import Similarity
from sdfrender.skips import MOST
from sdfrender.viewing import CameraView, GivenView, View

_TILES = 8  # along either side of a picture of given rays: a set around each, as they may go anywhere
_STEEPEST = 0.1  # least cosine to the middle of a tile; with less, the set is as good as everything
_AROUND = MOST + 3  # samples beyond those of a ray's cells that decide how far it goes at once
_ROUNDING = 11 * 2.0**-24  # of positions, in sizes of the scene: float32's, docs/tracing.md


@dataclass(frozen=True, slots=True, eq=False)
class Frustum:
    """A convex set, perhaps without end: all x with normal . x <= limit, in every row."""

    normal: Float[np.ndarray, "m 3"]
    limit: Float[np.ndarray, " m"]

    @staticmethod
    def of_pencil(
        origin: Float[np.ndarray, " 3"],
        frame: Float[np.ndarray, "3 3"],
        place: Float[np.ndarray, "2 2"],
        slope: Float[np.ndarray, "2 2"],
    ) -> "Frustum":
        """Enclose rays that go forward.

        Parameters
        ----------
        origin
            World point; no ray starts behind it.
        frame
            Forward, and two directions across: orthonormal, world.
        place, slope
            Least and greatest, for both directions across: where rays pass the plane through the origin, and by how
            much they move across while they go forward by 1.
        """
        forward, *across = frame
        rows, limits = [-forward], [0.0]
        for axis, (low, high), (least, greatest) in zip(across, place.T, slope.T, strict=True):
            rows += [axis - greatest * forward, least * forward - axis]
            limits += [high, -low]
        normal = np.array(rows)
        return Frustum(normal, np.array(limits) + normal @ origin)

    def in_grid(self, placed: Similarity, lattice: Lattice) -> "Frustum":
        """Return the same set in the grid coordinates of a lattice that stands somewhere in the world."""
        local = placed.scale * (self.normal @ placed.rotation)
        limit = self.limit - self.normal @ placed.translation - local @ lattice.origin
        return Frustum(local * lattice.spacing, limit)

    def meets(
        self, low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"], margin: float
    ) -> Bool[np.ndarray, " n"]:
        """Say which boxes, larger by a margin, are not beyond one of the planes: too many of them, never too few."""
        middle, half = (low + high) / 2, (high - low) / 2 + margin
        nearest = middle @ self.normal.T - half @ np.abs(self.normal).T
        met: Bool[np.ndarray, " n"] = (nearest <= self.limit).all(axis=1)
        return met


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What is seen of a grid, by one or several of its places in the world: frusta in grid coordinates, and a margin.

    Attributes
    ----------
    frusta
        Sets around the rays.
    margin
        How far from a ray the cells are that it may come into, voxels.
    """

    frusta: tuple[Frustum, ...]
    margin: float

    @staticmethod
    def of(frusta: Sequence[Frustum], placed: Similarity, lattice: Lattice, size: float) -> "Sight":
        """Look at a grid that stands somewhere in a scene of that size, world units."""
        margin = 1 + _ROUNDING * size / (placed.scale * lattice.spacing)
        return Sight(tuple(frustum.in_grid(placed, lattice) for frustum in frusta), margin)

    def on_level(self, number: int) -> "Sight":
        """Return the same in the grid coordinates of a coarser level."""
        frusta = tuple(Frustum(frustum.normal * 2.0**number, frustum.limit) for frustum in self.frusta)
        return Sight(frusta, self.margin)

    def meets_lattice(self, lattice: Lattice) -> bool:
        """Say whether any ray comes into the lattice."""
        low, high = np.zeros((1, 3)), np.array([lattice.shape], np.float64) - 1
        return any(bool(frustum.meets(low, high, self.margin).any()) for frustum in self.frusta)

    def meets(self, bricks: Bricks, more: float = 0.0) -> Bool[np.ndarray, " k"]:
        """Say which bricks hold cells, of those that begin in them, that any ray can come into, or come near."""
        low = bricks.index * float(SIDE)
        met = np.zeros(len(bricks), bool)
        for frustum in self.frusta:
            met |= frustum.meets(low, low + SIDE, self.margin + more)
        return met


def needed(sights: Sequence[Sight], bricks: Bricks) -> Bool[np.ndarray, " k"]:
    """Return the bricks that some place of a grid needs: those in sight, and those around each, for the stencils."""
    table = np.zeros(np.add(bricks.slot.shape, 2), bool)
    seen, beside = np.zeros(len(bricks), bool), np.zeros(len(bricks), bool)
    for sight in sights:
        seen |= sight.meets(bricks)
        beside |= sight.meets(bricks, _AROUND)
    table[tuple((bricks.index[seen] + 1).T)] = True
    for axis in range(3):
        inner = [slice(None)] * 3
        inner[axis] = slice(1, -1)
        before, after = list(inner), list(inner)
        before[axis], after[axis] = slice(None, -2), slice(2, None)
        grown = table.copy()
        grown[tuple(inner)] |= table[tuple(before)] | table[tuple(after)]
        table = grown
    near: Bool[np.ndarray, " k"] = table[tuple((bricks.index + 1).T)] | beside
    return near


def frusta(view: View) -> tuple[Frustum, ...] | None:
    """Enclose the rays of a picture, in the world; None where that is as good as everything."""
    if isinstance(view, CameraView):
        return (_of_camera(view.camera),)
    if isinstance(view, GivenView):
        return _of_rays(view.rays, view.size)
    return None


def _of_camera(camera: AnyCamera) -> Frustum:
    """Enclose the rays through a picture, to the outer border of its pixels, wherever in them samples lie."""
    forward, right, down = camera.frame()
    pixel = np.linalg.norm(right)
    ends = np.array([[-0.5], [0.5]]) * np.array(camera.size) * pixel
    flat = isinstance(camera, OrthographicCamera)
    place, slope = (ends, 0 * ends) if flat else (0 * ends, ends)
    return Frustum.of_pencil(np.array(camera.position), np.stack([forward, right / pixel, down / pixel]), place, slope)


def _of_rays(rays: Rays, size: tuple[int, int]) -> tuple[Frustum, ...] | None:
    """Enclose given rays, tile by tile of their picture."""
    width, height = size
    number = np.arange(width * height).reshape(height, width)
    found = []
    for row in np.array_split(number, min(_TILES, height)):
        for tile in np.array_split(row, min(_TILES, width), axis=1):
            frustum = _of_tile(rays.p[tile.ravel()], rays.d[tile.ravel()])
            if frustum is None:
                return None
            found.append(frustum)
    return tuple(found)


def _of_tile(p: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Frustum | None:
    """Enclose rays; None where they go in all directions."""
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    frame = _frame(d.mean(axis=0))
    if frame is None or (d @ frame[0]).min() < _STEEPEST:
        return None
    origin = p[np.argmin(p @ frame[0])]
    ahead, slope = (p - origin) @ frame[0], (d @ frame[1:].T) / (d @ frame[0])[:, None]
    place = (p - origin) @ frame[1:].T - ahead[:, None] * slope
    return Frustum.of_pencil(origin, frame, _ends(place), _ends(slope))


def _ends(values: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 2"]:
    return np.stack([values.min(axis=0), values.max(axis=0)])


def _frame(forward: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"] | None:
    """Return an orthonormal frame about a direction; None if it has no length to speak of."""
    length = np.linalg.norm(forward)
    if length < _STEEPEST:
        return None
    forward = forward / length
    right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    return np.stack([forward, right, np.cross(forward, right)])
