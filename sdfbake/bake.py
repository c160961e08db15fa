"""From a mesh to a grid asset, as the paper does it and with its distances exact.

In: a mesh. Out: a `Grid`. Steps: lattice, bricks near the surface with their candidate faces, closest face and signed
distance of every sample, texture coordinates (Galim 2018, eq. 22, and two that are right across charts), the error of
interpolation, bounds for what is far.
"""

import hashlib
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from sdfbake import memory, sides
from sdfbake.band import Target, filled
from sdfbake.bricks import REACH, SIDE, Bricks, counts, in_lattice
from sdfbake.candidates import brick_candidates, places
from sdfbake.closest import Surface
from sdfbake.complaint import BadInput
from sdfbake.diagnosis import diagnose
from sdfbake.engine import Engine, choose
from sdfbake.faces import FaceTable
from sdfbake.far import far_bounds
from sdfbake.grid import Grid
from sdfbake.interpolation import brick_errors
from sdfbake.lattice import Lattice
from sdfbake.layering import layer
from sdfbake.mesh import Mesh
from sdfbake.metadata import MODES, Metadata, Sign
from sdfbake.sign import Pseudonormals
from sdfbake.smooth import Refined, ls3
from sdfbake.topology import Topology, corners
from sdfbake.uvgrid import closest_uv

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Options:
    """What a bake is asked for, checked.

    Attributes
    ----------
    modes
        Of texture coordinates, in the order of `MODES`.
    sign
        "auto", "winding" or "pseudonormal".
    shell
        World units: an open mesh is taken for a shell of that thickness; 0 for a solid.
    open
        Whether meshes with boundary edges are taken.
    smooth
        "none" or "ls3".
    """

    modes: tuple[str, ...]
    sign: str
    shell: float
    open: bool
    smooth: str

    @staticmethod
    def of(mesh: Mesh, uv_mode: str | Iterable[str] | None, sign: str, open_: str | None, smooth: str) -> "Options":
        """Check what a user wrote; see `bake` for the meaning and the errors."""
        if sign not in ("auto", "winding", "pseudonormal"):
            raise BadInput(f"sign method {sign!r} is unknown: use auto, winding or pseudonormal")
        if smooth not in ("none", "ls3"):
            raise BadInput(f"smoothing {smooth!r} is unknown: use none or ls3")
        if len(mesh.part_names) > 256:
            raise BadInput(f"the mesh has {len(mesh.part_names)} parts and a grid stores at most 256: merge some")
        thickness = _thickness(open_)
        if open_ is not None and sign == "pseudonormal":
            raise BadInput("pseudonormals need a closed mesh: leave out --sign pseudonormal, or --open")
        return Options(_modes(mesh, uv_mode), sign, thickness, open_ is not None, smooth)


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """What a bake found so far, brick by brick."""

    index: Int[np.ndarray, "k 3"]
    distance: Float[np.ndarray, "k 8 8 8"]
    face: Int[np.ndarray, "k 8 8 8"]
    centre: Float[np.ndarray, "k 4 4 4"]


def bake(
    mesh: Mesh,
    resolution: int,
    *,
    uv_mode: str | Iterable[str] | None = None,
    cube: bool = False,
    sign: str = "auto",
    open: str | None = None,  # noqa: A002
    smooth: str = "none",
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
    options = Options.of(mesh, uv_mode, sign, open, smooth)
    topology = Topology.of(mesh.faces)
    diagnosis = diagnose(mesh, topology)
    diagnosis.require_bakeable(open_too=options.open)
    report = progress or (lambda stage, share: None)
    lattice = _lattice(mesh, resolution, options, cube)
    refined = _refined(mesh, lattice, options, report)
    source = refined.mesh if refined else mesh
    lattice = _lattice(source, resolution, options, cube) if refined else lattice

    surface = Surface.of(source, None if refined else topology)
    oriented = not options.shell and (sign == "pseudonormal" or (diagnosis.certified and sign == "auto"))
    normals = Pseudonormals.of(surface) if oriented else None
    xp = choose(engine, 32).engine
    inset = options.shell / 2 / lattice.spacing
    target = Target.of(xp, lattice.to_grid(surface.vertices * surface.scale + surface.centre), surface.faces,
                       lattice.shape, normals, inset)  # fmt: skip
    samples = _sampled(xp, target, lattice, memory.Budget.of(max_memory, source, lattice, options.modes), report)
    samples, record = _signed(samples, surface, lattice, normals, options, report)
    _warn(record, inside_out=diagnosis.has("inside-out"))

    rows = samples.face
    samples = replace(samples, face=_mesh_faces(samples.face, surface, refined))
    present = np.zeros(counts(lattice.shape), bool)
    present[tuple(samples.index.T)] = True
    far = far_bounds(present, samples.index, samples.distance, REACH, lattice.spacing)
    bricks = Bricks.of(present, far)
    layers, overflow = None, 0
    if "layers" in options.modes:
        layers, overflow = layer(mesh, lattice, bricks, samples.distance, samples.face, report)
    by_grid = "grid" in options.modes
    several = len(mesh.part_names) > 1
    return Grid(
        lattice,
        bricks,
        samples.distance,
        closest_uv(xp, target, source.uv[surface.ids], samples.index, rows)
        if by_grid and source.uv is not None
        else None,
        _by_face(mesh.chart, samples.face, np.int32) if by_grid and mesh.chart.any() else None,
        _by_face(mesh.part, samples.face, np.uint8) if several else None,
        Metadata(
            source="mesh",
            units=mesh.units,
            mesh_hash=mesh_hash(mesh),
            sign=record,
            parts=mesh.part_names,
            charts=int(mesh.chart.max()) + 1 if options.modes else 0,
            uv_modes=options.modes,
            overflow=overflow,
            texture=mesh.texture,
            options={"resolution": resolution, "cube": cube, "sign": sign, "open": open, "smooth": smooth},
            edge_over_h=edge_over_h(source, lattice),
        ),
        face=samples.face if "faces" in options.modes else None,
        surface=FaceTable.of(mesh) if "faces" in options.modes else None,
        layers=layers,
        error=brick_errors(xp, bricks, samples.distance, samples.centre, lattice.spacing),
    )


def _modes(mesh: Mesh, wanted: str | Iterable[str] | None) -> tuple[str, ...]:
    """Return how texture coordinates are stored, in the order of `MODES`."""
    if wanted is None:
        wanted = "none" if mesh.uv is None else "faces"
    names = {name.strip() for name in wanted.split(",")} if isinstance(wanted, str) else set(wanted)
    unknown = sorted(names - {*MODES, "none"})
    if unknown:
        raise BadInput(f"uv mode {unknown[0]!r} is unknown: use none, or some of {', '.join(MODES)} with commas")
    if "none" in names and len(names) > 1:
        raise BadInput("uv mode 'none' goes with no other: leave it out, or ask for none alone")
    modes = tuple(mode for mode in MODES if mode in names)
    if modes and mesh.uv is None:
        raise BadInput(
            f"uv mode {modes[0]!r} needs texture coordinates and the mesh has none: unwrap it (--unwrap) or use none"
        )
    if modes and not np.isfinite(np.asarray(mesh.uv)).all():
        raise BadInput("the mesh has texture coordinates that are not finite: unwrap it again or use uv mode none")
    return modes


def _thickness(wish: str | None) -> float:
    """Return the thickness of a shell, 0 for a solid."""
    if wish in (None, "winding"):
        return 0.0
    kind, _, number = str(wish).partition(":")
    try:
        thickness = float(number) if kind == "shell" else float("nan")
    except ValueError:
        thickness = float("nan")
    if not 0 < thickness < float("inf"):
        raise BadInput(f"open {wish!r} is unknown: use winding, or shell:T with a thickness T above 0 in mesh units")
    return thickness


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
    budget.check_tables()
    found = brick_candidates(xp.at(32), target.coarse, target.size, lattice.shape, REACH + target.inset)
    report("bricks", 1)
    count = 0 if found is None else len(found.parent)
    at_once = budget.bricks_at_once(count)
    distance = np.empty((count, SIDE**3), np.float32)
    face = np.empty((count, SIDE**3), np.int32)
    centre = np.empty((count, 64), np.float32)
    kept, end = np.zeros(count, bool), 0
    report("closest faces", 0)
    for part, band in filled(xp, target, found, REACH, lattice.spacing, at_once) if found else ():
        good = (band.face >= 0).any(axis=1)
        start, end = end, end + int(np.count_nonzero(good))
        kept[part], distance[start:end], face[start:end] = good, band.distance[good], band.face[good]
        centre[start:end] = band.centre[good]
        report("closest faces", part.stop / count)
    index = places(found)[kept] if found else np.zeros((0, 3), np.int32)
    shape = (end, SIDE, SIDE, SIDE)
    distance = distance[:end].reshape(shape)
    distance[~in_lattice(index, lattice.shape)] = 0
    return _Samples(index, distance, face[:end].reshape(shape), centre[:end].reshape(end, 4, 4, 4))


def _signed(
    samples: _Samples,
    surface: Surface,
    lattice: Lattice,
    normals: Pseudonormals | None,
    options: Options,
    report: Progress,
) -> tuple[_Samples, Sign]:
    """Check the signs that the samples have, or give them some."""
    if options.shell:
        return samples, Sign(method="exact")
    if normals is not None:
        record = sides.compared(surface, lattice, samples.index, samples.distance)
        if record.disagree <= sides.DISAGREEMENT or options.sign == "pseudonormal":
            return samples, record
    distance, record = sides.wound(surface, lattice, samples.index, samples.distance, report)
    return replace(samples, distance=distance), record


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


def _warn(sign: Sign, *, inside_out: bool) -> None:
    """Tell the user what the signs rest on."""
    if inside_out:
        warnings.warn("the mesh is inside out: its inside is taken to be what it encloses", stacklevel=3)
    if sign.disagree > sides.DISAGREEMENT:
        warnings.warn(
            f"the signs by {sign.method} differ from another method's on {sign.disagree:.2%} of {sign.checked} samples:"
            " the mesh overlaps itself or is not oriented; see 'python -m sdfbake check'",
            stacklevel=3,
        )


def edge_over_h(mesh: Mesh, lattice: Lattice) -> float:
    """Return the median edge of a mesh in voxels; above 1, reflections look faceted."""
    p = corners(mesh.vertices, mesh.faces)
    square = ((p - p[[1, 2, 0]]) ** 2).sum(axis=1)
    return float(np.median(np.sqrt(square)) / lattice.spacing)


def mesh_hash(mesh: Mesh) -> str:
    """Return the SHA-256 of a mesh's arrays."""
    digest = hashlib.sha256()
    for values in (mesh.vertices, mesh.faces, mesh.uv, mesh.chart, mesh.part):
        if values is not None:
            digest.update(values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes())
    return digest.hexdigest()
