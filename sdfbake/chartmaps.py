"""The map of every (virtual) chart, continued past its border.

In: a mesh and its virtual charts. Out: `ChartMaps`, which for a point and a face of a chart closest to it gives texture
coordinates T = UV(c) + [c on the border] G (x - c), with c the closest point and G = U (E^T E)^-1 E^T the gradient of
the face's affine map, and the signed distance to the border. Everything is in lattice coordinates: one voxel is 1.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake import triangle
from sdfbake.engine.numpy import NumpyEngine
from sdfbake.lattice import Lattice
from sdfbake.layers import BORDER
from sdfbake.mesh import Mesh

_ENGINE = NumpyEngine(64)
# A face stretched far more than its chart is (a sliver, mostly) would continue so steeply that the range of the whole
# chart's coordinates grows, and with it the step of their 16 bits.
_STEEPEST = 16.0
_SLIVER = 1e-12  # squared sine of an angle below which the shortcut through the face's plane is not taken


class Values(NamedTuple):
    """What a chart says at some points.

    Attributes
    ----------
    uv
        Texture coordinates, continued where the closest point is on the border.
    border
        Signed distance to the border, voxels, clamped to +-`BORDER`.
    """

    uv: Float[np.ndarray, "n 2"]
    border: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class ChartMaps:
    """Tables per face and trees per chart.

    Attributes
    ----------
    piece
        Virtual chart of every face.
    corners, uv
        Of the faces: lattice coordinates, texture coordinates.
    normals
        Unit; 0 for faces without area.
    dual
        Rows that give the weights of corners 1 and 2 of a point in the face's plane: (E^T E)^-1 E^T.
    gradient
        G of every face, and, at row f + wedge, the mean over the faces around that wedge, weighted by area.
    wedge
        Per corner a number shared by the faces of a chart that meet there with the same texture coordinates.
    on_border
        Whether each feature of a face (see `sdfbake.triangle`) is on the border of its chart.
    deep
        Faces all of which are farther inside than `BORDER`.
    faces, borders
        Trees of the faces, and of the border's edges, of every chart.
    """

    piece: Int[np.ndarray, " f"]
    corners: Float[np.ndarray, "f 3 3"]
    uv: Float[np.ndarray, "f 3 2"]
    normals: Float[np.ndarray, "f 3"]
    dual: Float[np.ndarray, "f 2 3"]
    gradient: Float[np.ndarray, "g 2 3"]
    wedge: Int[np.ndarray, "f 3"]
    on_border: Bool[np.ndarray, "f 7"]
    deep: Bool[np.ndarray, " f"]
    faces: "tuple[Tree, ...]"
    borders: "tuple[Tree | None, ...]"

    @staticmethod
    def of(mesh: Mesh, lattice: Lattice, piece: Int[np.ndarray, " f"]) -> "ChartMaps":
        """Build the tables of a mesh with texture coordinates."""
        if mesh.uv is None:
            raise ValueError("charts have maps where there are texture coordinates")
        vertices, count = lattice.to_grid(mesh.vertices), int(piece.max()) + 1
        corners = vertices[mesh.faces]
        normals, area = unit_normals(corners)
        wedge = _wedges(mesh.faces, mesh.uv, piece)
        gradient, dual = _gradients(corners, mesh.uv, piece, area)
        side = _border_sides(wedge)
        on_vertex = np.zeros(int(wedge.max()) + 1, bool)
        on_vertex[wedge[side]] = on_vertex[np.roll(wedge, -1, axis=1)[side]] = True
        on_border = np.concatenate([np.zeros((len(piece), 1), bool), side, on_vertex[wedge]], axis=1)
        order = np.argsort(np.where(area > 0, piece, count), kind="stable")[: np.count_nonzero(area > 0)]
        faces = tuple(Tree(vertices, mesh.faces[part], part) for part in _parts(order, piece[order], count))
        face, k = np.nonzero(side)
        edges = np.stack([mesh.faces[face, k], mesh.faces[face, (k + 1) % 3]], axis=-1)
        order = np.argsort(piece[face], kind="stable")
        parts = _parts(order, piece[face[order]], count)
        borders = tuple(Tree(vertices, edges[part], part) if len(part) else None for part in parts)
        deep = _deep(corners, piece, wedge, borders)
        average = _averages(gradient, wedge, area)
        return ChartMaps(
            piece, corners, mesh.uv, normals, dual, np.concatenate([gradient, average]), wedge, on_border, deep, faces,
            borders,
        )  # fmt: skip

    def at(self, p: Float[np.ndarray, "n 3"], face: Int[np.ndarray, " n"]) -> Values:
        """Return what the charts of some faces say at points to which these are their closest faces."""
        weight, feature = self._foot(p, face)
        uv = np.einsum("nk,nkd->nd", weight, self.uv.take(face, axis=0))
        past = self.on_border.reshape(-1).take(7 * face + feature)
        border = np.where(past, 0, -BORDER)
        measured = np.flatnonzero(past | ~self.deep.take(face))
        foot = np.einsum("nk,nkd->nd", weight.take(measured, axis=0), self.corners.take(face[measured], axis=0))
        beyond = past[measured]
        inner = measured[~beyond]
        border[inner] = -self._to_border(foot[~beyond], self.piece[face[inner]])

        outer = measured[beyond]
        at, f, corner = p[outer] - foot[beyond], face[outer], feature[outer].astype(np.int64) - triangle.CORNER
        row = np.where(corner < 0, f, len(self.piece) + self.wedge[f, corner.clip(0)])
        uv[outer] += np.einsum("nij,nj->ni", self.gradient[row], at)
        height = np.einsum("nd,nd->n", at, self.normals[f])
        border[outer] = np.linalg.norm(at - height[:, None] * self.normals[f], axis=1)
        return Values(uv, border.clip(-BORDER, BORDER))

    def closest(
        self, p: Float[np.ndarray, "n 3"], piece: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Return the squared distance of points from one chart each, and the closest face of that chart."""
        square, face = np.empty(len(p)), np.empty(len(p), np.int64)
        for k, among in _groups(piece):
            square[among], face[among] = self.faces[k].closest(p[among])
        return square, face

    def _to_border(self, c: Float[np.ndarray, "n 3"], piece: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the distance of points of charts from the charts' borders; `BORDER` where there is none."""
        distance = np.full(len(c), BORDER)
        for k, among in _groups(piece):
            tree = self.borders[k]
            if tree is not None:
                distance[among] = np.sqrt(tree.closest(c[among])[0])
        return distance

    def _foot(
        self, p: Float[np.ndarray, "n 3"], face: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
        """Return weights and feature of the point of a face that is closest to a point.

        Where the foot in the face's plane is inside, it is the closest point; only the others try the edges.
        """
        weight, feature = np.empty((len(p), 3)), np.zeros(len(p), np.int8)
        from_first = p - self.corners.reshape(-1, 3).take(3 * face, axis=0)
        np.einsum("nkd,nd->nk", self.dual.take(face, axis=0), from_first, out=weight[:, 1:])
        weight[:, 0] = 1 - weight[:, 1] - weight[:, 2]
        rest = np.flatnonzero(weight.min(axis=1) <= 0)
        x, y, z = np.ascontiguousarray(p[rest].T)
        a, b, c = (tuple(column) for column in np.ascontiguousarray(self.corners[face[rest]].transpose(1, 2, 0)))
        with np.errstate(all="ignore"):  # faces without a plane are masked out
            found = triangle.nearest(_ENGINE, (x, y, z), (a, b, c))
        weight[rest], feature[rest] = np.stack(found.barycentric, axis=-1), found.feature
        return weight, feature


@dataclass(frozen=True, eq=False)
class Tree:
    """Triangles or segments of lattice space, with their names, for closest-point queries."""

    vertices: Float[np.ndarray, "v 3"]
    elements: Int[np.ndarray, "m k"]
    names: Int[np.ndarray, " m"]

    @cached_property
    def _boxes(self) -> Any:
        """Boxes around boxes, built when the first query comes."""
        import igl  # here, so that `import sdfbake` is light

        tree = igl.AABB()
        tree.init(self.vertices, self.elements)
        return tree

    def closest(self, p: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Return squared distances from points and the names of the closest elements."""
        if len(self.elements) == 0:  # a chart of faces without area
            return np.full(len(p), np.inf), np.zeros(len(p), np.int64)
        square, element, _ = self._boxes.squared_distance(self.vertices, self.elements, np.ascontiguousarray(p))
        return np.asarray(square).reshape(-1), self.names[np.asarray(element).reshape(-1)]


def unit_normals(corners: Float[np.ndarray, "f 3 3"]) -> tuple[Float[np.ndarray, "f 3"], Float[np.ndarray, " f"]]:
    """Return normals (0 where a face has no area) and areas of faces."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=-1)
    return normal / np.where(length > 0, length, 1)[:, None], length / 2


def _groups(piece: Int[np.ndarray, " n"]) -> "list[tuple[int, Int[np.ndarray, ' m']]]":
    """Return every piece that occurs, and where, in ascending order."""
    order = np.argsort(piece, kind="stable")
    names, first = np.unique(piece[order], return_index=True)
    return list(zip(names.tolist(), np.split(order, first[1:]), strict=True)) if len(names) else []


def _parts(order: Int[np.ndarray, " n"], piece: Int[np.ndarray, " n"], count: int) -> "list[Int[np.ndarray, ' m']]":
    """Split things, ordered by piece, into those of each piece."""
    return np.split(order, np.searchsorted(piece, np.arange(1, count)))


def _wedges(
    faces: Int[np.ndarray, "f 3"], uv: Float[np.ndarray, "f 3 2"], piece: Int[np.ndarray, " f"]
) -> Int[np.ndarray, "f 3"]:
    """Number the corners so that those of one chart, vertex and texture coordinate share a number."""
    _, place = np.unique((uv + 0.0).reshape(-1, 2).view(np.complex128), return_inverse=True)  # no -0.0: bits count
    keys = np.stack([np.repeat(piece.astype(np.int64), 3), faces.reshape(-1), place.reshape(-1)])
    order = np.lexsort(keys)
    new = (np.diff(keys[:, order], axis=1) != 0).any(axis=0)
    wedge = np.empty(faces.size, np.int64)
    wedge[order] = np.concatenate([[0], np.cumsum(new)])
    return wedge.reshape(-1, 3)


def _border_sides(wedge: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, "f 3"]:
    """Say which sides of the faces (corner k to k + 1) no other face of their chart shares."""
    end = np.roll(wedge, -1, axis=1)
    key = (np.minimum(wedge, end) << 32) | np.maximum(wedge, end)
    _, edge, count = np.unique(key, return_inverse=True, return_counts=True)
    alone: Bool[np.ndarray, "f 3"] = (count == 1)[edge.reshape(-1, 3)]
    return alone


def _gradients(
    corners: Float[np.ndarray, "f 3 3"],
    uv: Float[np.ndarray, "f 3 2"],
    piece: Int[np.ndarray, " f"],
    area: Float[np.ndarray, " f"],
) -> tuple[Float[np.ndarray, "f 2 3"], Float[np.ndarray, "f 2 3"]]:
    """Return the gradient of every face's map, 0 where the face or its image has no area; and (E^T E)^-1 E^T."""
    e = corners[:, 1:] - corners[:, :1]
    u = uv[:, 1:] - uv[:, :1]
    m = np.einsum("fid,fjd->fij", e, e)
    det = m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] ** 2
    usable = det > _SLIVER * m[:, 0, 0] * m[:, 1, 1]
    inverse = np.stack([m[:, 1, 1], -m[:, 0, 1], -m[:, 1, 0], m[:, 0, 0]], axis=-1).reshape(-1, 2, 2)
    inverse /= np.where(usable, det, 1)[:, None, None]
    dual = np.where(usable[:, None, None], inverse @ e, 0)
    image = u[:, 0, 0] * u[:, 1, 1] - u[:, 0, 1] * u[:, 1, 0]
    flat = np.abs(image) <= 1e-12 * np.linalg.norm(u, axis=-1).prod(axis=-1)
    gradient = np.where(flat[:, None, None], 0, u.transpose(0, 2, 1) @ dual)
    size = np.linalg.norm(gradient, axis=(1, 2))
    total = np.bincount(piece, area)
    # The mean, not the mean square: in it a sliver counts no more than the side it is stretched along.
    usual = (np.bincount(piece, area * size) / np.where(total > 0, total, 1))[piece]
    return gradient * np.minimum(1, _STEEPEST * usual / np.where(size > 0, size, 1))[:, None, None], dual


def _averages(
    gradient: Float[np.ndarray, "f 2 3"], wedge: Int[np.ndarray, "f 3"], area: Float[np.ndarray, " f"]
) -> Float[np.ndarray, "w 2 3"]:
    """Return the mean gradient of the faces around every wedge, weighted by area."""
    at, weight = wedge.reshape(-1), np.repeat(area, 3)
    total = np.bincount(at, weight)
    columns = [np.bincount(at, weight * np.repeat(column, 3)) for column in gradient.reshape(-1, 6).T]
    mean: Float[np.ndarray, "w 2 3"] = np.stack(columns, axis=-1) / np.where(total > 0, total, 1)[:, None]
    return mean.reshape(-1, 2, 3)


def _deep(
    corners: Float[np.ndarray, "f 3 3"],
    piece: Int[np.ndarray, " f"],
    wedge: Int[np.ndarray, "f 3"],
    borders: "tuple[Tree | None, ...]",
) -> Bool[np.ndarray, " f"]:
    """Say which faces are farther inside than `BORDER`: a corner is, by more than the longest side."""
    first = np.empty(int(wedge.max()) + 1, np.int64)
    first[wedge.reshape(-1)] = np.arange(wedge.size)
    p, of = corners.reshape(-1, 3)[first], np.repeat(piece, 3)[first]
    distance = np.full(len(p), np.inf)
    for k, among in _groups(of):
        tree = borders[k]
        if tree is not None:
            distance[among] = np.sqrt(tree.closest(p[among])[0])
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=-1).max(axis=1)
    deep: Bool[np.ndarray, " f"] = distance[wedge].max(axis=1) - longest > BORDER
    return deep
