"""From a mesh to a grid asset, as the paper does it and with its distances exact.

In: a mesh. Out: a `Grid`. Steps: lattice, bricks near the surface with their candidate faces, closest face and signed
distance of every sample, texture coordinates (Galim 2018, eq. 22, and two that are right across charts), the error of
interpolation, bounds for what is far.
"""

import hashlib
import warnings
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sdfbake import memory, sides
from sdfbake.band import Target, filled
from sdfbake.bricks import REACH, SIDE, Bricks, counts, in_lattice
from sdfbake.candidates import brick_candidates, places
from sdfbake.closest import Surface
from sdfbake.diagnosis import diagnose
from sdfbake.engine import Engine, choose
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
from sdfbake.smooth import Refined, ls3
from sdfbake.topology import corners
from sdfbake.uvgrid import closest_uv

Progress = Callable[[str, float], None]
_MEASURED = 50_000  # faces whose edges are measured, at least, where there are more


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """What a bake found so far, brick by brick."""

    index: Int[np.ndarray, "k 3"]
    distance: Float[np.ndarray, "k 8 8 8"]
    face: Int[np.ndarray, "k 8 8 8"]
    probe: Float[np.ndarray, "k 4 4 4 p"]


def bake(
    mesh: Mesh,
    resolution: int,
    *,
    uv_mode: str | Iterable[str] | None = None,
    cube: bool = False,
    sign: str = "auto",
    open: str | None = None,  # noqa: A002
    smooth: str = "none",
    without: Collection[str] = (),
    engine: str = "auto",
    progress: Progress | None = None,
    max_memory: float | None = None,
) -> Grid:
    """Bake a mesh.

    Parameters
    ----------
    mesh
        Closed, unless `open` says what inside means; signs are surest where it is oriented and manifold too.
    resolution
        Samples along the longest axis, 16 to 8192.
    uv_mode
        "none", or one or several of "faces" (exact: the closest face's id at every sample, and a table of faces),
        "layers" (a map per chart, continued past its border) and "grid" (the closest point's texture coordinates,
        interpolated across charts as Galim 2018 does), as a list or with commas. By default "faces" where the mesh
        has texture coordinates.
    cube
        Give every axis the same number of samples.
    sign
        "pseudonormal", "winding", or "auto": pseudonormals where the mesh is clean and winding numbers agree.
    open
        For meshes with holes: "winding" takes the inside to be where the winding number is above 1/2, "shell:T" gives
        the faces the thickness T, world units.
    smooth
        "ls3" bakes the smooth surface that the mesh approximates; texture coordinates stay those of the mesh.
    without
        Channels that are left out: "part", "error".
    engine
        As for `sdfbake.engine.choose`; the result is the same but for the last unit of distances.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    max_memory
        Gigabytes (2^30 bytes) allowed; by default what the machine has available. With little, the work is cut into
        smaller pieces.

    Returns
    -------
    Grid
        Within `REACH` voxels distances are float32 of the float64 distance from the closest face; beyond, samples
        hold +-`REACH`, and no face or texture coordinates.

    Raises
    ------
    BadInput
        If the mesh is empty, not finite or open, an option is unknown, or memory would not suffice.

    Warns
    -----
    UserWarning
        If two methods disagree on more than 0.1 % of the signs, or the mesh is inside out.

    Examples
    --------
    >>> grid = bake(Mesh.load("bunny.obj"), 64)  # doctest: +SKIP
    """
    options = Options.of(mesh, uv_mode, sign, open, smooth, without)
    surface = _checked(mesh)
    report = progress or (lambda stage, share: None)
    lattice = _lattice(mesh, resolution, options, cube)
    xp = choose(engine, 32).engine
    with ThreadPoolExecutor(1) as aside:  # on another core, while this one makes ready what a clean mesh needs
        found = aside.submit(diagnose, mesh, surface)
        refined = _refined(mesh, lattice, options, report)
        source = refined.mesh if refined else mesh
        if refined:
            surface, lattice = Surface.of(source), _lattice(source, resolution, options, cube)
        budget = memory.Budget.of(max_memory, surface, lattice, options.modes, _parts(mesh, options))
        budget.check_tables()
        normals = Pseudonormals.of(surface) if options.may_orient else None
        inset = options.shell / 2 / lattice.spacing
        target = Target.of(xp, lattice.to_grid(source.vertices), surface.faces, lattice.shape, normals, inset)
        diagnosis = found.result()
    diagnosis.require_bakeable(open_too=options.open)
    oriented = options.may_orient and (diagnosis.certified or sign == "pseudonormal")
    if not oriented:
        target = target._replace(normals=None)
    if "error" in options.without:
        target = target._replace(probes=())
    with ThreadPoolExecutor(1) as aside:  # the tree for the other method's signs grows beside the descent
        growing = aside.submit(Winding.of, surface)
        samples = _sampled(xp, target, lattice, budget, report)
        winding = growing.result()
    samples, record = _signed(samples, winding, lattice, oriented=oriented, options=options, report=report)
    _warn(record, inside_out=diagnosis.has("inside-out"), holes=options.open)

    bricks = _bricks(samples, winding, lattice, record)
    named = replace(samples, face=_mesh_faces(samples.face, surface, refined))
    channels = _texture(mesh, lattice, bricks, named, options, report)
    if "grid" in options.modes:
        channels["uv"] = closest_uv(xp, target, _corner_uv(source)[surface.ids], samples.index, samples.face)
    return Grid(
        lattice,
        bricks,
        samples.distance,
        channels.get("uv"),
        channels.get("chart"),
        _by_face(mesh.part, named.face, np.uint8) if _parts(mesh, options) > 1 else None,
        Metadata(
            source="mesh",
            units=mesh.units,
            mesh_hash=mesh_hash(mesh),
            sign=record,
            parts=mesh.part_names,
            charts=int(mesh.chart.max()) + 1 if options.modes else 0,
            uv_modes=options.modes,
            overflow=channels.get("overflow", 0),
            texture=mesh.texture,
            options={"resolution": resolution, "cube": cube, "sign": sign, "open": open, "smooth": smooth},
            edge_over_h=edge_over_h(source, lattice),
        ),
        face=channels.get("face"),
        surface=channels.get("surface"),
        layers=channels.get("layers"),
        error=brick_errors(xp, bricks, samples.distance, samples.probe, lattice.spacing) if target.probes else None,
    )


def _checked(mesh: Mesh) -> Surface:
    """Return a mesh made ready, unless there is nothing in it that could be."""
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        diagnose(mesh).require_bakeable()
    return Surface.of(mesh)


def _parts(mesh: Mesh, options: Options) -> int:
    """Return how many parts are told apart."""
    return 1 if "part" in options.without else len(mesh.part_names)


def _lattice(mesh: Mesh, resolution: int, options: Options, cube: bool) -> Lattice:
    grown = np.array([[-1.0], [1.0]]) * options.shell / 2
    return Lattice.around(mesh.bounds + grown, resolution, cube=cube)


def _refined(mesh: Mesh, lattice: Lattice, options: Options, report: Progress) -> Refined | None:
    """Return the mesh that is baked in place of a faceted one."""
    if options.smooth == "none":
        return None
    report("smoothing", 0)
    refined = ls3(mesh, lattice.spacing)
    report("smoothing", 1)
    return refined


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
    samples: _Samples, winding: Winding, lattice: Lattice, *, oriented: bool, options: Options, report: Progress
) -> tuple[_Samples, Sign]:
    """Check the signs that the samples have, or give them some."""
    if options.shell:
        return samples, Sign(method="exact")
    if oriented:
        record = sides.compared(winding, lattice, samples.index, samples.distance)
        if record.disagree <= sides.DISAGREEMENT or options.sign == "pseudonormal":
            return samples, record
    distance, record = sides.wound(winding, lattice, samples.index, samples.distance, report)
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


def _warn(sign: Sign, *, inside_out: bool, holes: bool) -> None:
    """Tell the user what the signs rest on."""
    if inside_out:
        warnings.warn("the mesh is inside out: its inside is taken to be what it encloses", stacklevel=3)
    if sign.disagree > sides.DISAGREEMENT and not holes:  # pseudonormals mean nothing beside a hole
        warnings.warn(
            f"the signs by {sign.method} differ from another method's on {sign.disagree:.2%} of {sign.checked} samples:"
            " the mesh overlaps itself or is not oriented; see 'python -m sdfbake check'",
            stacklevel=3,
        )


def edge_over_h(mesh: Mesh, lattice: Lattice) -> float:
    """Return the median edge of a mesh in voxels; above 1, reflections look faceted. Large meshes are sampled."""
    p = corners(mesh.vertices, mesh.faces[:: max(1, len(mesh.faces) // _MEASURED)])
    square = ((p - p[[1, 2, 0]]) ** 2).sum(axis=1)
    return float(np.median(np.sqrt(square)) / lattice.spacing)


def mesh_hash(mesh: Mesh) -> str:
    """Return the SHA-256 of a mesh's arrays."""
    digest = hashlib.sha256()
    for values in (mesh.vertices, mesh.faces, mesh.uv, mesh.chart, mesh.part):
        if values is not None:
            digest.update(values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes())
    return digest.hexdigest()
