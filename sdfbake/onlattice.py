"""A mesh on one lattice.

In: a mesh made ready, and a lattice. Out: a `Grid`. Steps: bricks near the surface with their candidate faces, closest
face and signed distance of every sample, texture coordinates (Galim 2018, eq. 22, and two that are right across
charts), the error of interpolation, bounds for what is far. All of it is done in lattice coordinates: with twice the
spacing and the same origin, every number at a shared node is half as large to the last bit, and the distance the same.
"""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sdfbake import memory, sides
from sdfbake.band import Target, filled
from sdfbake.bricks import REACH, SIDE, Bricks, counts, in_lattice
from sdfbake.candidates import brick_candidates, places
from sdfbake.closest import Surface
from sdfbake.engine import Engine
from sdfbake.faces import FaceTable
from sdfbake.far import far_bounds
from sdfbake.grid import Grid
from sdfbake.interpolation import brick_errors
from sdfbake.lattice import Lattice
from sdfbake.layering import layer
from sdfbake.mesh import Mesh
from sdfbake.metadata import Metadata, Sign
from sdfbake.options import Options
from sdfbake.sign import Pseudonormals, Winding
from sdfbake.smooth import Refined
from sdfbake.stretch import stretch_of
from sdfbake.topology import corners
from sdfbake.uvgrid import closest_uv

Progress = Callable[[str, float], None]
_MEASURED = 50_000  # faces whose edges are measured, at least, where there are more


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """A mesh made ready to be baked on any lattice.

    Attributes
    ----------
    mesh
        As it was given.
    surface
        Of what is baked: the mesh, or the smooth surface in its place.
    refined
        That smooth surface; None where there is none.
    options
        What is asked for.
    asked
        The same as the metadata record it.
    digest
        SHA-256 of the mesh.
    max_memory
        Gigabytes allowed; None for what there is.
    """

    mesh: Mesh
    surface: Surface
    refined: Refined | None
    options: Options
    asked: dict[str, Any]
    digest: str
    max_memory: float | None

    @property
    def source(self) -> Mesh:
        """What is baked."""
        return self.refined.mesh if self.refined else self.mesh

    def work(self, xp: Engine, lattice: Lattice, normals: Pseudonormals | None) -> "Work":
        """Bring the mesh to a lattice and an engine, with signs by `normals` or without.

        Raises
        ------
        BadInput
            If memory would not suffice.
        """
        options = self.options
        budget = memory.Budget.of(self.max_memory, self.surface, lattice, options.modes, self.parts)
        budget.check_tables()
        inset = options.shell / 2 / lattice.spacing
        vertices = lattice.to_grid(self.source.vertices)
        target = Target.of(xp, vertices, self.surface.faces, lattice.shape, normals, inset)
        if "error" in options.without:
            target = target._replace(probes=())
        return Work(self, lattice, target, budget)

    @property
    def parts(self) -> int:
        """How many parts are told apart."""
        return 1 if "part" in self.options.without else len(self.mesh.part_names)


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """What a bake found so far, brick by brick."""

    index: Int[np.ndarray, "k 3"]
    distance: Float[np.ndarray, "k 8 8 8"]
    face: Int[np.ndarray, "k 8 8 8"]
    probe: Float[np.ndarray, "k 4 4 4 p"]


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """A mesh on a lattice, ready to be sampled.

    Attributes
    ----------
    ready, lattice
        The mesh, the lattice.
    target
        The mesh in lattice coordinates, on an engine.
    budget
        How much memory may be taken.
    """

    ready: Ready
    lattice: Lattice
    target: Target
    budget: memory.Budget

    def without_signs(self) -> "Work":
        """Return the same without pseudonormals."""
        return replace(self, target=self.target._replace(normals=None))

    def done(self, xp: Engine, growing: "Future[Winding]", report: Progress, decided: str | None = None) -> Grid:
        """Sample the mesh.

        Parameters
        ----------
        xp
            The engine.
        growing
            The tree for winding numbers, which may be in the making.
        report
            Called with a stage and the share of it that is done.
        decided
            The method of the signs, where it is not to be chosen any more.
        """
        ready, lattice, target, options = self.ready, self.lattice, self.target, self.ready.options
        samples = _sampled(xp, target, lattice, self.budget, report)
        winding = growing.result()
        forced = decided or (options.sign if options.sign != "auto" else None)
        samples, sign = _signed(samples, winding, self, forced, report)
        bricks = _bricks(samples, winding, lattice, sign)
        named = replace(samples, face=_mesh_faces(samples.face, ready.surface, ready.refined))
        channels = _texture(ready.mesh, lattice, bricks, named, options, report)
        if "grid" in options.modes:
            uv = _corner_uv(ready.source)[ready.surface.ids]
            channels["uv"] = closest_uv(xp, target, uv, samples.index, samples.face)
        if ready.parts > 1:
            channels["part"] = _by_face(ready.mesh.part, named.face, np.uint8)
        if target.probes:
            channels["error"] = brick_errors(xp, bricks, samples.distance, samples.probe, lattice.spacing)
        return Grid(
            lattice,
            bricks,
            samples.distance,
            channels.get("uv"),
            channels.get("chart"),
            channels.get("part"),
            self._metadata(sign, channels.get("overflow", 0)),
            face=channels.get("face"),
            surface=channels.get("surface"),
            layers=channels.get("layers"),
            error=channels.get("error"),
        )

    def _metadata(self, sign: Sign, overflow: int) -> Metadata:
        ready, mesh = self.ready, self.ready.mesh
        return Metadata(
            source="mesh",
            units=mesh.units,
            mesh_hash=ready.digest,
            sign=sign,
            parts=mesh.part_names,
            charts=int(mesh.chart.max()) + 1 if ready.options.modes else 0,
            uv_modes=ready.options.modes,
            overflow=overflow,
            texture=mesh.texture,
            options=ready.asked,
            edge_over_h=edge_over_h(ready.source, self.lattice),
            stretch=stretch_of(mesh, sign) if "faces" in ready.options.modes and not ready.options.open else None,
        )


def _sampled(xp: Engine, target: Target, lattice: Lattice, budget: memory.Budget, report: Progress) -> _Samples:
    """Find the bricks and fill them; those without a sample in reach are dropped."""
    report("bricks", 0)
    found = brick_candidates(xp.at(32), target.coarse, target.size, lattice.shape, REACH + target.inset)
    report("bricks", 1)
    count = 0 if found is None else len(found.parent)
    at_once = budget.bricks_at_once(count)
    distance = np.empty((count, SIDE**3), np.float32)
    face = np.empty((count, SIDE**3), np.int32)
    probe = np.empty((count, 64, len(target.probes)), np.float32)
    kept, end = np.zeros(count, bool), 0
    report("closest faces", 0)
    for part, band in filled(xp, target, found, REACH, lattice.spacing, at_once) if found else ():
        good = (band.face >= 0).any(axis=1)
        start, end = end, end + int(np.count_nonzero(good))
        kept[part], distance[start:end], face[start:end] = good, band.distance[good], band.face[good]
        probe[start:end] = band.probe[good]
        report("closest faces", part.stop / count)
    index = places(found)[kept] if found else np.zeros((0, 3), np.int32)
    shape = (end, SIDE, SIDE, SIDE)
    distance = distance[:end].reshape(shape)
    distance[~in_lattice(index, lattice.shape)] = 0
    return _Samples(index, distance, face[:end].reshape(shape), probe[:end].reshape(end, 4, 4, 4, len(target.probes)))


def _signed(
    samples: _Samples, winding: Winding, work: Work, forced: str | None, report: Progress
) -> tuple[_Samples, Sign]:
    """Check the signs that the samples have, or give them some; `forced` names the method that has to be taken."""
    if work.ready.options.shell:
        return samples, Sign(method="exact")
    if work.target.normals is not None:
        record = sides.compared(winding, work.lattice, samples.index, samples.distance)
        if record.disagree <= sides.DISAGREEMENT or forced == "pseudonormal":
            return samples, record
    distance, record = sides.wound(winding, work.lattice, samples.index, samples.distance, report)
    return replace(samples, distance=distance), record


def _bricks(samples: _Samples, winding: Winding, lattice: Lattice, sign: Sign) -> Bricks:
    """Return the table of bricks, with bounds where there are none."""
    present = np.zeros(counts(lattice.shape), bool)
    present[tuple(samples.index.T)] = True
    torn = winding if sign.method == "winding" else None
    return Bricks.of(present, far_bounds(present, samples.index, samples.distance, REACH, lattice, torn))


def _texture(
    mesh: Mesh, lattice: Lattice, bricks: Bricks, samples: _Samples, options: Options, report: Progress
) -> dict[str, Any]:
    """Return what the UV modes store of the samples' faces, and how many cells had too many charts."""
    channels: dict[str, Any] = {}
    if "faces" in options.modes:
        channels |= {"face": samples.face, "surface": FaceTable.of(mesh)}
    if "layers" in options.modes:
        layers, overflow = layer(mesh, lattice, bricks, samples.distance, samples.face, report)
        channels |= {"layers": layers, "overflow": overflow}
    if "grid" in options.modes and mesh.chart.any():
        channels["chart"] = _by_face(mesh.chart, samples.face, np.int32)
    return channels


def _corner_uv(mesh: Mesh) -> Float[np.ndarray, "f 3 2"]:
    if mesh.uv is None:
        raise ValueError("no texture coordinates")
    return mesh.uv


def _mesh_faces(face: Int[np.ndarray, "k 8 8 8"], surface: Surface, refined: Refined | None) -> np.ndarray:
    """Return faces of the mesh for rows of the surface, -1 where there is none."""
    ids = surface.ids if refined is None else refined.parent[surface.ids]
    if refined is None and len(ids) == ids[-1] + 1:
        return face
    named: np.ndarray = np.concatenate([ids, [-1]]).astype(np.int32)[face]
    return named


def _by_face(values: Int[np.ndarray, " f"], face: Int[np.ndarray, "k 8 8 8"], kind: type) -> np.ndarray:
    """Return what is known of the samples' faces, 0 where there is none."""
    known: np.ndarray = np.concatenate([values, [0]]).astype(kind)[face]
    return known


def edge_over_h(mesh: Mesh, lattice: Lattice) -> float:
    """Return the median edge of a mesh in voxels; above 1, reflections look faceted. Large meshes are sampled."""
    p = corners(mesh.vertices, mesh.faces[:: max(1, len(mesh.faces) // _MEASURED)])
    square = ((p - p[[1, 2, 0]]) ** 2).sum(axis=1)
    return float(np.median(np.sqrt(square)) / lattice.spacing)
