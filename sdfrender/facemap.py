"""Texture coordinates of the closest face: exact, across the cuts of the atlas too.

In: the closest face of every sample, and the faces. Out: the texture coordinates of the surface point closest to a
place, found by starting at the closest of the faces that the cell's corners name and stepping to closer ones around
it. Faces that look away from the normal at the place are the other side of a thin wall.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from sdfbake.complaint import BadInput
from sdfbake.engine import Array, Engine
from sdfbake.faces import FaceTable
from sdfbake.grid import Grid
from sdfbake.topology import signed_volume
from sdfrender.field import Mapped
from sdfrender.tables import Found, Tables, sample
from sdfrender.triangle import nearest
from sdfrender.vector import Vector, cross, dot, scale, subtract

MOST_NEIGHBOURS = 1 << 27  # half a gigabyte of rings; a closed mesh has twelve neighbours per face
_CORNERS = tuple(product((0, 1), repeat=3))
_PLACE, _MAP = 9, 12  # numbers per face in the tables


class _Best(NamedTuple):
    """The best face so far: -1 for none; whether it looks away; its squared distance, voxels."""

    face: Array
    away: Array
    squared: Array


class _Walk(NamedTuple):
    """Where in the ring of which face the search is, and what it has found."""

    at: Array
    end: Array
    centre: Array
    best: _Best


@dataclass(frozen=True, slots=True, eq=False)
class FaceMap:
    """Faces ready to be looked up.

    Attributes
    ----------
    tables
        The grid's cells.
    face
        Closest face per sample, -1 for none.
    place
        Per face its first corner and the edges to the other two: 9 numbers, voxels from the field's anchor.
    affine
        Per face u, v of the first corner, their differences to the second and third, and the gradients of u and v in
        the face's plane, per voxel: 12 numbers.
    chart
        Per face.
    first, ring
        The faces that share a vertex with face f, ascending, are ring[first[f] : first[f + 1]].
    per_voxel
        1 / spacing.
    sided
        Whether a face has one side only; the faces of an open mesh that was given a thickness have two.
    """

    tables: Tables
    face: Array
    place: Array
    affine: Array
    chart: Array
    first: Array
    ring: Array
    per_voxel: Array
    sided: bool

    @staticmethod
    def of(grid: Grid, tables: Tables, engine: Engine, per_voxel: Array) -> "FaceMap":
        """Prepare the faces of a grid that has them.

        Raises
        ------
        BadInput
            If so many faces meet at some vertex that their neighbourhoods take too much memory.
        """
        assert grid.face is not None and grid.surface is not None
        surface, lattice = _outward(grid.surface), grid.lattice
        anchor = lattice.to_world((np.array(lattice.shape) - 1) / 2)
        corners = ((surface.vertices - anchor) / lattice.spacing)[surface.corners]
        first, ring = rings(surface)
        return FaceMap(
            tables,
            engine.table(grid.face),
            engine.table(np.concatenate([corners[:, 0], *_edges(corners)], axis=1)),
            engine.table(_affine(corners, surface.uv)),
            engine.table(surface.chart),
            engine.table(first),
            engine.table(ring),
            per_voxel,
            not str(grid.metadata.options.get("open")).startswith("shell"),
        )

    def uv_at(self, xp: Engine, found: Found, p: Vector, n: Vector | None) -> Mapped:
        """Texture coordinates of the closest surface point, with their gradient in the surface.

        Parameters
        ----------
        xp, found
            The engine, and the cell of the place.
        p, n
            The place, relative to the field's anchor, world units, and the unit normal there.
        """
        assert n is not None
        q = scale(p, self.per_voxel)
        best = self._walk(xp, q, n, self._of_corners(xp, found, q, n))
        named = best.face >= 0
        row = [xp.gather(self.affine, best.face * _MAP + i, named) for i in range(_MAP)]
        at = nearest(xp, q, *self._triangle(xp, best.face, named))

        def kept(value: Array) -> Array:
            return xp.where(named, value, 0.0)

        u = kept(row[0] + (at.second * row[2] + at.third * row[4]))
        v = kept(row[1] + (at.second * row[3] + at.third * row[5]))
        gradients = []
        for g in ((row[6], row[7], row[8]), (row[9], row[10], row[11])):
            x, y, z = scale(subtract(g, scale(n, dot(n, g))), self.per_voxel)
            gradients.append((kept(x), kept(y), kept(z)))
        chart = xp.where(named, xp.gather(self.chart, best.face, named), 0)
        return Mapped(u, v, gradients[0], gradients[1], chart, xp.full(u, False))

    def _of_corners(self, xp: Engine, found: Found, q: Vector, n: Vector) -> _Best:
        """Choose among the faces that the corners of the cell name, each tried once."""
        faces: list[Array] = []
        pending = xp.full(found.t, 0)
        for number, (i, j, k) in enumerate(_CORNERS):
            at = (found.cell[0] + i, found.cell[1] + j, found.cell[2] + k)
            face = sample(xp, self.tables, self.face, at, found.hit)
            new = found.hit & (face >= 0)
            for other in faces:
                new = new & (face != other)
            pending = pending | (xp.integer(new) << number)
            faces.append(face)

        def step(
            state: tuple[Array, _Best], constants: tuple[tuple[Array, ...], Vector, Vector]
        ) -> tuple[Array, _Best]:
            (pending, best), (faces, q, n) = state, constants
            face = faces[-1]
            for number in reversed(range(len(faces) - 1)):
                face = xp.where((pending & (1 << number)) != 0, faces[number], face)
            return pending & (pending - 1), self._better(xp, best, face, (pending != 0), q, n)

        nobody = _Best(xp.full(found.t, -1), xp.full(found.t, True), xp.full(found.t, 0.0))
        constants = (tuple(faces), q, n)
        return xp.while_loop(lambda state: state[0] != 0, step, (pending, nobody), constants)[1]

    def _walk(self, xp: Engine, q: Vector, n: Vector, start: _Best) -> _Best:
        """Go to the best face of the ring until that is the face in its middle."""

        def around(face: Array, active: Array) -> tuple[Array, Array]:
            at, end = xp.gather(self.first, face, active), xp.gather(self.first, face + 1, active)
            return xp.where(active, at, 0), xp.where(active, end, 0)

        def step(state: _Walk, constants: tuple[Vector, Vector]) -> _Walk:
            q, n = constants
            going = state.at < state.end
            best = self._better(xp, state.best, xp.gather(self.ring, state.at, going), going, q, n)
            at = state.at + 1
            moved = (at >= state.end) & (best.face != state.centre) & going
            there, end = around(best.face, moved)
            centre = xp.where(moved, best.face, state.centre)
            return _Walk(xp.where(moved, there, at), xp.where(moved, end, state.end), centre, best)

        at, end = around(start.face, start.face >= 0)
        state = _Walk(at, end, start.face, start)
        return xp.while_loop(lambda walk: walk.at < walk.end, step, state, (q, n)).best

    def _better(self, xp: Engine, best: _Best, face: Array, active: Array, q: Vector, n: Vector) -> _Best:
        """Return the better of two faces: one that looks along n, then the closer one, then the lower one."""
        a, ab, ac = self._triangle(xp, face, active)
        squared = nearest(xp, q, a, ab, ac).squared
        normal = cross(ab, ac)
        away = dot(normal, n if self.sided else normal) <= 0
        closer = (squared < best.squared) | ((squared == best.squared) & (face < best.face))
        alike = (away & best.away) | ~(away | best.away)
        wins = active & ((best.face < 0) | (best.away & ~away) | (alike & closer))
        return _Best(
            xp.where(wins, face, best.face), (wins & away) | (~wins & best.away), xp.where(wins, squared, best.squared)
        )

    def _triangle(self, xp: Engine, face: Array, active: Array) -> tuple[Vector, Vector, Vector]:
        """Look up the first corner of a face and its edges."""
        c = [xp.gather(self.place, face * _PLACE + i, active) for i in range(_PLACE)]
        return (c[0], c[1], c[2]), (c[3], c[4], c[5]), (c[6], c[7], c[8])


def rings(surface: FaceTable) -> tuple[Int[np.ndarray, " f1"], Int[np.ndarray, " m"]]:
    """Return of every face the others that share a vertex with it, ascending: where each list begins, and all lists.

    Raises
    ------
    BadInput
        If they are too many.
    """
    count, faces = len(surface.corners), surface.corners.ravel()
    valence = np.bincount(faces, minlength=1).astype(np.int64)
    if (valence**2).sum() > MOST_NEIGHBOURS:
        raise BadInput(
            f"up to {valence.max()} faces of the grid's mesh meet at one vertex, too many to look around it: take "
            "uv 'layers' or 'grid', or remesh it"
        )
    owner = np.repeat(np.arange(count, dtype=np.int32), 3)
    incidence = csr_array((np.ones(len(faces), np.int8), (owner, faces)), shape=(count, len(valence)))
    shared = csr_array(incidence @ incidence.T)
    shared.sort_indices()
    of = np.repeat(np.arange(count, dtype=np.int32), np.diff(shared.indptr))
    others = shared.indices != of
    sizes = np.bincount(of[others], minlength=count)
    ring = shared.indices[others].astype(np.int32)
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    return first, ring if len(ring) else np.zeros(1, np.int32)  # no engine likes an empty table


def _outward(surface: FaceTable) -> FaceTable:
    """Turn the faces of a mesh that is inside out: a bake takes the inside for the inside all the same."""
    if signed_volume(surface.vertices, surface.corners.astype(np.int64)) >= 0:
        return surface
    turned = [0, 2, 1]
    return FaceTable(surface.vertices, surface.corners[:, turned], surface.uv[:, turned], surface.chart)


def _edges(corners: Float[np.ndarray, "f 3 3"]) -> tuple[Float[np.ndarray, "f 3"], Float[np.ndarray, "f 3"]]:
    """Return the edges from the first corner."""
    return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def _affine(corners: Float[np.ndarray, "f 3 3"], uv: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, "f 12"]:
    """Return the rows of `FaceMap.affine`; the gradient is U (E^T E)^-1 E^T, 0 for a face without an area."""
    ab, ac = _edges(corners)
    n = np.cross(ab, ac)
    twice = (n * n).sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # The dual basis of the edges: the rows of (E^T E)^-1 E^T.
        dual = np.stack([np.cross(ac, n) / twice, np.cross(n, ab) / twice], axis=1)
        difference = uv[:, 1:] - uv[:, :1]
        gradient = np.einsum("fkc,fkd->fcd", difference, dual)
    # Beyond float32 there is no area worth the name.
    usable = (np.abs(gradient) < 1e30).all(axis=(1, 2))
    gradient = np.where(usable[:, None, None], gradient, 0.0)
    return np.concatenate([uv[:, 0], difference.reshape(-1, 4), gradient.reshape(-1, 6)], axis=1)
