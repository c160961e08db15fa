"""Texture coordinates at single samples, for formats that have one value per sample.

In: a grid with any of the modes. Out: `Textured`: coordinates and chart of the closest surface point (Galim 2018,
eq. 22) of every sample that was asked for, and a mask of the cells across which they must not be interpolated.
"""

import os
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake import triangle
from sdfbake.bricks import REACH, SIDE, in_lattice
from sdfbake.densify import Part
from sdfbake.engine.numpy import NumpyEngine
from sdfbake.faces import FaceTable
from sdfbake.grid import Grid
from sdfbake.lattice import Lattice
from sdfbake.layers import FULL, Layers
from sdfbake.seams import meeting

EVERY: Part = (slice(None), slice(None), slice(None))
_NONE = -1  # the chart of samples of which nothing is known
_ENGINE = NumpyEngine(64)
_CHUNK = 1 << 14  # points whose some thirty temporary columns stay in a core's cache
_TOGETHER = 512  # bricks whose samples are looked up together
_SLIVER = 1e-4  # height over the longest edge: below, the plane is not trusted


@dataclass(frozen=True, slots=True, eq=False)
class Textured:
    """Texture coordinates per stored sample.

    Attributes
    ----------
    uv
        Of the closest surface point, float32; 0 where there are none or they were not asked for.
    chart
        Chart of that point, int32; -1 there.
    seam
        Whether the cell that a sample is the first corner of has corners in several charts, among those that have one.
    """

    uv: Float[np.ndarray, "k 8 8 8 2"]
    chart: Int[np.ndarray, "k 8 8 8"]
    seam: Bool[np.ndarray, "k 8 8 8"]


def channels(modes: Collection[str]) -> tuple[str, ...]:
    """Return the channels of a grid file that `textured` needs, given the modes that the file has."""
    needed = {"faces": ("face",), "grid": ("uv", "chart"), "layers": ("layers",)}  # the quickest to read first
    return next((names for mode, names in needed.items() if mode in modes), ())


def textured(grid: Grid, wanted: Bool[np.ndarray, "k 8 8 8"] | None = None) -> Textured | None:
    """Return the texture coordinates of samples.

    They are, of what the grid has the first: its coordinates by sample; those of the point of the named face that is
    closest to the sample; those of the row of layers with the least border distance, which go on past the border of
    its chart.

    Parameters
    ----------
    grid
        Any grid.
    wanted
        The samples to do this for; None for all of which the grid knows a closest point.

    Returns
    -------
    Textured
        None where the grid has no texture coordinates.
    """
    if all(mode is None for mode in (grid.uv, grid.face, grid.layers)):
        return None
    shape = grid.distance.shape
    uv, chart = np.empty((*shape, 2), np.float32), np.empty(shape, np.int32)

    def fill(start: int) -> None:
        some = slice(start, start + _TOGETHER)
        asked = True if wanted is None else wanted[some]
        uv[some], chart[some] = coordinates(grid, np.arange(*some.indices(shape[0])), asked=asked)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(fill, range(0, shape[0], _TOGETHER)))
    return Textured(uv, chart, meeting(grid.bricks, chart))


def coordinates(
    grid: Grid, slots: Int[np.ndarray, " n"], part: Part = EVERY, asked: Bool[np.ndarray, "n x y z"] | bool = True
) -> tuple[Float[np.ndarray, "n x y z 2"], Int[np.ndarray, "n x y z"]]:
    """Return texture coordinates and charts of some samples, as `textured` does.

    Parameters
    ----------
    grid
        One that has texture coordinates.
    slots, part
        Which bricks, ascending, and which of their samples.
    asked
        Which of these to do this for.
    """
    if grid.uv is not None:
        return _of_samples(grid, slots, part, asked)
    if grid.face is not None and grid.surface is not None:
        first = grid.bricks.index[slots] * SIDE + np.array([along.start or 0 for along in part], np.int32)
        face = np.where(asked, _taken(grid.face, slots, part), _NONE)
        return _of_faces(grid.lattice, grid.surface, face, first)
    assert grid.layers is not None
    return _of_layers(grid.layers, slots, part, asked)


def _taken(values: np.ndarray, rows: Int[np.ndarray, " n"], part: Part) -> np.ndarray:
    """Return some samples of some bricks, or of some layers of bricks."""
    x, y, z = part
    found: np.ndarray = values[:, x, y, z][rows]
    return found


def _of_samples(
    grid: Grid, slots: Int[np.ndarray, " n"], part: Part, asked: Bool[np.ndarray, "n x y z"] | bool
) -> tuple[Float[np.ndarray, "n x y z 2"], Int[np.ndarray, "n x y z"]]:
    """Return what the grid stores by sample, where it stores anything."""
    assert grid.uv is not None
    reach = np.float32(REACH * grid.lattice.spacing)  # what is beyond is clamped to it
    known = asked & (np.abs(_taken(grid.distance, slots, part)) < reach)
    x, y, z = part
    known &= in_lattice(grid.bricks.index[slots], grid.lattice.shape)[:, x, y, z]
    chart = np.int32(0) if grid.chart is None else _taken(grid.chart, slots, part)
    uv = _taken(grid.uv, slots, part)
    uv[~known] = 0
    return uv, np.where(known, chart, np.int32(_NONE))


def _of_faces(
    lattice: Lattice, surface: FaceTable, face: Int[np.ndarray, "n x y z"], first: Int[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n x y z 2"], Int[np.ndarray, "n x y z"]]:
    """Return those of the closest points of named faces, -1 for none, of samples that go on from the first of a row."""
    uv, chart = np.zeros((face.size, 2), np.float32), np.full(face.size, _NONE, np.int32)
    at, each = np.flatnonzero(face >= 0), face[0].size if len(face) else 1
    for start in range(0, len(at), _CHUNK):
        some = at[start : start + _CHUNK]
        named = face.reshape(-1)[some]
        faces = np.unique(named)
        p = first[some // each].T + np.stack(np.unravel_index(some % each, face.shape[1:])).astype(np.float64)
        uv[some] = _Faces.of(lattice, surface, faces).closest_uv(np.searchsorted(faces, named), p).T
        chart[some] = surface.chart[named]
    return uv.reshape(*face.shape, 2), chart.reshape(face.shape)


class _Faces(NamedTuple):
    """Faces in voxels, where the indices of samples are exact.

    Attributes
    ----------
    corners
        Corners a, b, c one after the other.
    uv
        Texture coordinates of the corners.
    weights
        Gradients of the weights of b and of c at the foot of a point p on the plane, weight = gradient . (p - a);
        NaN for slivers, whose planes are mostly rounding.
    """

    corners: Float[np.ndarray, "f 9"]
    uv: Float[np.ndarray, "f 6"]
    weights: Float[np.ndarray, "f 6"]

    @staticmethod
    def of(lattice: Lattice, surface: FaceTable, faces: Int[np.ndarray, " f"]) -> "_Faces":
        """Build the tables of some faces."""
        corners = lattice.to_grid(surface.vertices[surface.corners[faces]])
        ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normal = np.cross(ab, ac)
        square, longest = (normal**2).sum(axis=1), np.maximum((ab**2).sum(axis=1), (ac**2).sum(axis=1))
        square[square <= (_SLIVER * longest) ** 2] = np.nan
        weights = np.concatenate([np.cross(ac, normal), np.cross(normal, ab)], axis=1) / square[:, None]
        return _Faces(corners.reshape(-1, 9), surface.uv[faces].reshape(-1, 6), weights)

    def closest_uv(self, named: Int[np.ndarray, " n"], p: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "2 n"]:
        """Return the texture coordinates of the points of faces that are closest to p, voxels."""
        corners, gradient = self.corners[named].T, self.weights[named].T
        to = p - corners[:3]
        of_b, of_c = (gradient[:3] * to).sum(axis=0), (gradient[3:] * to).sum(axis=0)
        weight = np.stack([1 - of_b - of_c, of_b, of_c])
        # Most feet lie within their face, and are the closest points; the others, and slivers, take the longer way.
        other = np.flatnonzero(~(weight > 0).all(axis=0))
        weight[:, other] = _closest(corners[:, other], p[:, other])
        found: Float[np.ndarray, "2 n"] = np.einsum("cn,nca->an", weight, self.uv[named].reshape(-1, 3, 2))
        return found


def _closest(corners: Float[np.ndarray, "9 n"], p: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "3 n"]:
    """Return the weights of the corners at the points of faces that are closest to p."""
    x, (px, py, pz) = np.ascontiguousarray(corners), p
    with np.errstate(all="ignore"):  # what has no plane is asked for one all the same
        found = triangle.nearest(_ENGINE, (px, py, pz), ((x[0], x[1], x[2]), (x[3], x[4], x[5]), (x[6], x[7], x[8])))
    return np.stack(found.barycentric)


def _of_layers(
    layers: Layers, slots: Int[np.ndarray, " n"], part: Part, asked: Bool[np.ndarray, "n x y z"] | bool
) -> tuple[Float[np.ndarray, "n x y z 2"], Int[np.ndarray, "n x y z"]]:
    """Return those of the row with the least border distance, of the first of several; turn by turn over the rows."""
    begin, end = (np.searchsorted(layers.brick, slots, side) for side in ("left", "right"))
    place = np.repeat(np.arange(len(slots)), end - begin)
    turn = np.arange(len(place)) - np.searchsorted(place, place)
    rows = begin[place] + turn
    shape = (len(slots), *(len(range(SIDE)[along]) for along in part))
    least = np.full(shape, np.inf, np.float16)
    uv, chart = np.zeros((*shape, 2), np.float32), np.full(shape, _NONE, np.int32)
    asked = np.broadcast_to(asked, shape)
    for number in range(int(turn.max(initial=-1)) + 1):
        chosen = turn == number  # of every brick one at most
        row, brick = rows[chosen], place[chosen]
        border = _taken(layers.border, row, part)
        of_row, *inner = np.nonzero((border < least[brick]) & asked[brick])
        at, virtual = (brick[of_row], *inner), layers.chart[row][of_row]
        code = _taken(layers.uv, row, part)[(of_row, *inner)]
        least[at] = border[(of_row, *inner)]
        uv[at] = layers.offset[virtual] + layers.scale[virtual] * (code / FULL)
        chart[at] = layers.of[virtual]
    return uv, chart
