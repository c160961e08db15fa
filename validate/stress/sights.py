"""Rays at a textured mesh's grid, and what is seen there beside what the mesh itself says.

In: a grid and its mesh, an engine, a representation of texture coordinates. Out: errors per ray that met the surface.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake import Grid, Mesh, bake
from sdfbake.engine import Choice
from sdfbake.metadata import MODES
from sdfrender import Field, Flag, Footprint, GridField, Hits, Rays, footprint, transfer
from sdfrender.rays import COLUMNS
from validate.beam import Beam, MeshRays, only
from validate.course import Course, as_rays
from validate.exactuv import ExactUv, Readings
from validate.stress.case import Check, Finding
from validate.views import framing

RESOLUTION = 48
TEXELS = 1024  # along either side of the texture that footprints are measured in
SIDE = 24  # pixels along either side of a picture
DIRECTION = (0.7, -0.5, 0.6)  # of a camera, off every axis


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What rays that met a surface saw of its texture.

    Attributes
    ----------
    beam
        The rays, where they start.
    hits, at
        Where they met the surface, and the rays there.
    found
        Texture coordinates and footprints.
    readings
        What the mesh says at the same places: of all faces as near as rounding can tell, or as was asked.
    """

    beam: MeshRays
    hits: Hits
    at: Rays
    found: Footprint
    readings: Readings

    def uv_error(self, *, turns: bool = False) -> Float[np.ndarray, " n"]:
        """Distance from what a face says, texels; with `turns`, whole numbers are the same place of the texture."""
        off = self.found.uv[self.readings.point] - self.readings.uv
        off = off - np.rint(off) if turns else off
        return TEXELS * self.readings.least(np.linalg.norm(off, axis=1))

    def wrong_chart(self) -> Float[np.ndarray, " n"]:
        """1 where no face as near has the chart that was found."""
        differ = self.readings.chart != self.found.chart[self.readings.point]
        return self.readings.least(differ.astype(np.float64))

    def jacobian_error(self) -> Float[np.ndarray, " n"]:
        """|J - G dp| over |G| |dp|, Frobenius: J is what the face's gradient makes of the ray's own steps."""
        steps = np.stack([self.at.dp_dx, self.at.dp_dy], axis=-1)
        found = np.stack([self.found.duv_dx, self.found.duv_dy], axis=-1)[self.readings.point]
        read = self.readings.gradient @ steps[self.readings.point]
        size = _norm(self.readings.gradient) * _norm(steps)[self.readings.point]
        return self.readings.least(_norm(found - read) / np.where(size > 0, size, 1.0))

    def unusable(self) -> Float[np.ndarray, " n"]:
        """How many of a footprint's numbers are not finite."""
        found = self.found
        columns = [found.uv, found.duv_dx, found.duv_dy, found.lod[:, None], found.lod_invariant[:, None]]
        return np.asarray((~np.isfinite(np.concatenate(columns, axis=1))).sum(axis=1).astype(np.float64))

    @property
    def seam(self) -> Bool[np.ndarray, " n"]:
        """Where the flag SEAM is set."""
        return np.asarray((self.found.flags & Flag.SEAM) != 0)


@dataclass(frozen=True, eq=False)
class Subject:
    """A textured mesh, its grid with every representation, and the truth about its texture."""

    mesh: Mesh
    grid: Grid

    @staticmethod
    def of(mesh: Mesh, resolution: int | None = None) -> "Subject":
        """Bake a mesh, at `RESOLUTION` if nothing else is said."""
        return Subject(mesh, bake(mesh, resolution or RESOLUTION, uv_mode=MODES))

    @cached_property
    def exact(self) -> ExactUv:
        """What the mesh's faces say."""
        return ExactUv(self.mesh)

    @property
    def samples(self) -> int:
        """Along the longest axis."""
        return max(self.grid.lattice.shape)

    @property
    def spacing(self) -> float:
        """Side of a voxel."""
        return self.grid.lattice.spacing

    @cached_property
    def edge(self) -> float:
        """Length of the shortest edge, voxels."""
        corners = self.exact.facets.corners
        return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min() / self.spacing)

    @cached_property
    def steepest(self) -> float:
        """Greatest gradient of the texture coordinates, per world unit."""
        return float(_norm(self.exact.facets.uv_gradient).max())

    def rounding(self, choice: Choice) -> float:
        """How far rounding moves a place against the faces, world units.

        Places and corners are up to N / 2 voxels from the field's anchor, where a unit of rounding is N eps / 4: one
        for the hit's own place, one for its way to the faces' frame, one each for a corner and a foot on its face; in
        three axes, and for the two faces that are compared.
        """
        return 8 * self.samples * choice.engine.eps * self.spacing

    def camera(self) -> MeshRays:
        """A view of the whole."""
        return joined(framing(self.mesh.bounds, SIDE, DIRECTION).rays())


@dataclass(frozen=True, eq=False)
class Probe:
    """Rays at a subject, through one representation on one engine; traced when the first check asks.

    Attributes
    ----------
    subject, mode, choice, beam
        What is looked at, how, on which engine, and along which rays.
    slack
        World units: how much farther than the closest a face may be and still be right.
    """

    subject: Subject
    mode: str
    choice: Choice
    beam: Beam
    slack: float

    @cached_property
    def field(self) -> GridField:
        """The grid's surface."""
        return GridField(self.subject.grid, "bspline", self.choice, uv_mode=self.mode)

    @cached_property
    def seen(self) -> "Sight":
        """What the rays saw."""
        return sight(self.field, self.subject.exact, self.beam, self.slack)

    def check(
        self, name: str, unit: str, limit: float, measure: Callable[["Sight"], Float[np.ndarray, " n"]], known: str = ""
    ) -> Check:
        """Return a check of an error per ray."""

        def find() -> Finding:
            return Finding(measure(self.seen), self.seen.beam)

        return Check(f"{self.mode}: {name}", unit, limit, find, lambda: Course(self.field), known)

    def share(
        self, name: str, limit: float, wrong: Callable[["Sight"], Float[np.ndarray, " n"]], known: str = ""
    ) -> Check:
        """Return a check of the share of rays that are wrong, with one of them."""

        def find() -> Finding:
            bad = wrong(self.seen)
            return Finding(np.array([np.mean(bad)]), only(self.seen.beam, np.array([np.argmax(bad)])))

        return Check(f"{self.mode}: {name}", "share", limit, find, lambda: Course(self.field), known)


def sight(field: Field, exact: ExactUv, beam: Beam, slack: float) -> Sight:
    """Trace rays to a field's surface, and ask the mesh about the places.

    Parameters
    ----------
    field, exact
        The grid's surface, and the truth about its mesh.
    beam
        Rays; those that miss are left out.
    slack
        World units: how much farther than the closest a face may be and still be right.
    """
    hits, at = transfer(field, as_rays(beam))
    hit = np.flatnonzero(hits.hit)
    hits = Hits(hits.t[hit], hits.p[hit], hits.n[hit], hits.flags[hit], hits.part[hit])
    at = at.where(hit)
    found = footprint(field, hits, at, size=(TEXELS, TEXELS))
    return Sight(only(beam, hit), hits, at, found, exact.readings(at.p, slack))


def aimed(
    p: Float[np.ndarray, "n 3"], n: Float[np.ndarray, "n 3"], pixel: float, back: float, tilt: float = 0.0
) -> MeshRays:
    """Parallel rays of square pixels at places of a surface, each from its own side.

    Parameters
    ----------
    p, n
        Places and unit directions out of the surface.
    pixel
        Side of a pixel, world units.
    back
        How far the rays start from the places.
    tilt
        Tangent of the angle between rays and -n.
    """
    other = np.eye(3)[np.abs(n).argmin(axis=1)]
    right = np.cross(other, n)
    right = right / np.linalg.norm(right, axis=1, keepdims=True)
    d = tilt * right - n
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    across = right - np.sum(right * d, axis=1, keepdims=True) * d
    across = across / np.linalg.norm(across, axis=1, keepdims=True)
    nothing = np.zeros_like(p)
    return MeshRays(p - back * d, d, pixel * across, pixel * np.cross(d, across), nothing, nothing)


def on_faces(
    mesh: Mesh, faces: Int[np.ndarray, " n"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """A place on each of some faces, and the direction out of the surface there.

    Faces that have hardly an area have no direction of their own; that from the mesh's middle stands in.
    """
    corners = mesh.vertices[mesh.faces[faces]]
    p = np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), len(faces)), corners)
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(n, axis=1, keepdims=True)
    usable = length > 1e-6 * np.median(length)
    n = np.where(usable, n, p - mesh.bounds.mean(axis=0))
    return p, n / np.linalg.norm(n, axis=1, keepdims=True)


def joined(*beams: Beam) -> MeshRays:
    """All rays of several beams, one after another."""
    return MeshRays(*(np.concatenate([getattr(beam, name) for beam in beams]) for name in COLUMNS))


def _norm(matrices: Float[np.ndarray, "n 2 _"] | Float[np.ndarray, "n 3 _"]) -> Float[np.ndarray, " n"]:
    return np.asarray(np.sqrt((matrices * matrices).sum(axis=(1, 2))))
