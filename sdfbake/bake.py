"""From a mesh to a grid asset, as the paper does it and with its distances exact.

In: a closed mesh. Out: a `Grid`. Steps: lattice, bricks near the surface, closest face of every sample with the texture
coordinates of its closest point (Galim 2018, eq. 22), sign, table.
"""

import hashlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from math import prod

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake import memory
from sdfbake.bricks import REACH, SIDE, candidates, counts, in_lattice, sample_index, settle
from sdfbake.closest import Surface
from sdfbake.complaint import BadInput
from sdfbake.diagnosis import diagnose
from sdfbake.grid import CHANNELS, Grid
from sdfbake.lattice import BAND, Lattice
from sdfbake.mesh import Mesh
from sdfbake.metadata import Metadata, Sign
from sdfbake.sign import Pseudonormals, Winding
from sdfbake.topology import twice_areas

Progress = Callable[[str, float], None]
_BRICKS_AT_ONCE = 512  # 262,144 samples: about 100 MB of temporaries
_COMPARED = 20_000  # samples whose sign a second method looks at
_DISAGREEMENT = 1e-3  # share of those beyond which the user is told
_FACE_BYTES = 2000  # tree, tables and normals of a face, with room to spare
_FIXED_BYTES = 200 << 20  # temporaries of one chunk, and the libraries


@dataclass(frozen=True, slots=True, eq=False)
class _Work:
    """A bake under way: what is asked, and what was found so far (samples are (k, 8, 8, 8, ...))."""

    mesh: Mesh
    surface: Surface
    winding: Winding
    normals: Pseudonormals
    lattice: Lattice
    index: Int[np.ndarray, "k 3"]
    report: Progress

    def chunks(self, stage: str) -> "list[slice]":
        """Return slices of bricks that are worked on together."""
        self.report(stage, 0)
        return [slice(start, start + _BRICKS_AT_ONCE) for start in range(0, len(self.index), _BRICKS_AT_ONCE)]

    def done(self, stage: str, chunk: slice) -> None:
        """Report how far a stage is."""
        self.report(stage, min(1.0, chunk.stop / len(self.index)))

    def points(self, chunk: slice) -> Float[np.ndarray, "m 8 8 8 3"]:
        """Return the world positions of the chunk's samples."""
        return self.lattice.to_world(sample_index(self.index[chunk]))


def bake(
    mesh: Mesh,
    resolution: int,
    *,
    uv_mode: str | None = None,
    cube: bool = False,
    sign: str = "auto",
    progress: Progress | None = None,
    max_memory: float | None = None,
) -> Grid:
    """Bake a closed mesh.

    Parameters
    ----------
    mesh
        Closed; signs are surest where it is oriented and manifold too.
    resolution
        Samples along the longest axis, 16 to 8192.
    uv_mode
        "none", or "grid": the closest point's texture coordinates at every sample. By default "grid" where the mesh
        has texture coordinates.
    cube
        Give every axis the same number of samples.
    sign
        "pseudonormal", "winding", or "auto": pseudonormals where the mesh is clean and winding numbers agree.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    max_memory
        Gigabytes (2^30 bytes) allowed; by default what the machine has available.

    Returns
    -------
    Grid
        Within `REACH` voxels distances are float32 of the float64 distance from the closest face; beyond, samples
        hold a signed lower bound of it, and no texture coordinates.

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
    mode = _uv_mode(mesh, uv_mode)
    if sign not in ("auto", "winding", "pseudonormal"):
        raise BadInput(f"sign method {sign!r} is unknown: use auto, winding or pseudonormal")
    diagnosis = diagnose(mesh)
    diagnosis.require_bakeable()
    lattice = Lattice.around(mesh.bounds, resolution, cube=cube)
    _check_tables(mesh, lattice, max_memory)
    work, far = _start(mesh, lattice, progress or (lambda stage, share: None))
    _check_samples(work, mode, max_memory)

    channels = _closest(work, mode)
    clean = diagnosis.certified or sign == "pseudonormal"
    record = _signed(work, channels, "winding" if sign == "winding" or not clean else "pseudonormal", sign == "auto")
    _warn(record, inside_out=diagnosis.has("inside-out"))

    bricks, kept = settle(lattice, (work.index, far), channels["distance"])
    channels = {name: values if kept.all() else values[kept] for name, values in channels.items()}
    return Grid(
        lattice,
        bricks,
        channels["distance"],
        channels.get("uv"),
        channels.get("chart"),
        channels.get("part"),
        Metadata(
            source="mesh",
            units=mesh.units,
            mesh_hash=mesh_hash(mesh),
            sign=record,
            parts=mesh.part_names,
            charts=0 if mode == "none" else int(mesh.chart.max()) + 1,
            uv_modes=("grid",) if mode == "grid" else (),
            options={"resolution": resolution, "cube": cube, "sign": sign, "uv_mode": mode},
            edge_over_h=edge_over_h(mesh, lattice),
        ),
    )


def _uv_mode(mesh: Mesh, wanted: str | None) -> str:
    """Return how texture coordinates are stored."""
    if wanted not in (None, "none", "grid"):
        raise BadInput(f"uv mode {wanted!r} is not available: use none or grid")
    if wanted == "grid" and mesh.uv is None:
        raise BadInput(
            "uv mode 'grid' needs texture coordinates and the mesh has none: unwrap it (--unwrap) or use none"
        )
    if wanted != "none" and mesh.uv is not None and not np.isfinite(mesh.uv).all():
        raise BadInput("the mesh has texture coordinates that are not finite: unwrap it again or use uv mode none")
    if len(mesh.part_names) > 256:
        raise BadInput(f"the mesh has {len(mesh.part_names)} parts and a grid stores at most 256: merge some")
    return wanted or ("none" if mesh.uv is None else "grid")


def _check_tables(mesh: Mesh, lattice: Lattice, limit: float | None) -> None:
    """Refuse, before anything is allocated, what cannot fit: brick tables, and the surface in one layer of bricks."""
    bricks = prod(counts(lattice.shape))
    # A brick is crossed by no more surface than 8^2 voxels' worth on average; tight folds may share one, hence a half.
    area = twice_areas(mesh.vertices, mesh.faces).sum() / 2 / lattice.spacing**2
    least = min(area / SIDE**2 / 2, bricks)
    needed = 12.0 * bricks + least * SIDE**3 * 5 + len(mesh.faces) * _FACE_BYTES
    memory.require(needed, limit, max(lattice.shape))


def _check_samples(work: _Work, mode: str, limit: float | None) -> None:
    """Refuse what would not fit, now that the bricks are counted."""
    per_sample = 4 + 1 + (12 if mode == "grid" else 0) + (1 if len(work.mesh.part_names) > 1 else 0)
    # Twice: candidates that hold no sample in reach are dropped by copying the rest.
    samples = 2.0 * per_sample * SIDE**3 * len(work.index)
    tables = 12.0 * prod(counts(work.lattice.shape)) + len(work.mesh.faces) * _FACE_BYTES
    memory.require(samples + tables + _FIXED_BYTES, limit, max(work.lattice.shape))


def _start(mesh: Mesh, lattice: Lattice, report: Progress) -> tuple[_Work, Float[np.ndarray, "bx by bz"]]:
    """Find the candidate bricks, and the signed bounds of all others."""
    report("bricks", 0)
    surface = Surface.of(mesh)
    winding = Winding.of(surface)
    index, far = candidates(lattice, lambda p: surface.distance(p) * winding.signs(p))
    report("bricks", 1)
    return _Work(mesh, surface, winding, Pseudonormals.of(surface), lattice, index, report), far


def _closest(work: _Work, mode: str) -> dict[str, np.ndarray]:
    """Fill the channels from the closest points of the samples in reach; the distance is signed by pseudonormals."""
    several = {"uv": mode == "grid", "chart": mode == "grid" and work.mesh.chart.any()}
    several |= {"distance": True, "part": len(work.mesh.part_names) > 1}
    channels = {
        name: np.zeros((len(work.index), SIDE, SIDE, SIDE, *width), kind)
        for name, (width, kind) in CHANNELS.items()
        if several.get(name)
    }
    for chunk in work.chunks("closest points"):
        channels["distance"][chunk], near = _bounds(work, chunk)
        near &= in_lattice(work.index[chunk], work.lattice.shape)
        p = work.points(chunk)[near]
        at = work.surface.closest(p)
        values = {"distance": at.distance * work.normals.signs(p, at), "part": work.mesh.part[at.face]}
        if work.mesh.uv is not None and mode == "grid":
            values["uv"] = np.einsum("nk,nkd->nd", at.barycentric, work.mesh.uv[at.face])
            values["chart"] = work.mesh.chart[at.face]
        for name, channel in channels.items():
            channel[chunk][near] = values[name]
        work.done("closest points", chunk)
    return channels


def _bounds(work: _Work, chunk: slice) -> tuple[Float[np.ndarray, "m 8 8 8"], Bool[np.ndarray, "m 8 8 8"]]:
    """Go on with the octree inside bricks, from blocks of 4^3 samples to blocks of 2^3.

    Returns
    -------
    bound, near
        Signed lower bound of the |distance| of samples that are out of reach, 0 elsewhere and outside the lattice; and
        which samples are near enough to want a query of their own (most queries saved are the slow, far ones).
    """
    first, h = work.index[chunk], work.lattice.spacing
    bound, near = np.zeros((len(first), 1, 1, 1)), np.ones((len(first), 1, 1, 1), bool)
    for side in (4, 2):
        bound, near = (v.repeat(2, 1).repeat(2, 2).repeat(2, 3) for v in (bound, near))
        brick, *block = np.nonzero(near)
        p = work.lattice.to_world(first[brick] * SIDE + np.stack(block, axis=-1) * side + (side - 1) / 2)
        at = work.surface.closest(p)
        radius = np.sqrt(3) * (side - 1) / 2 * h
        out = at.distance > REACH * h + radius
        bound[near] = np.where(out, work.normals.signs(p, at) * (at.distance - radius), 0)
        near[near] = ~out
    bound, near = (v.repeat(2, 1).repeat(2, 2).repeat(2, 3) for v in (bound, near))
    bound[~in_lattice(first, work.lattice.shape)] = 0
    return bound, near


def _signed(work: _Work, channels: dict[str, np.ndarray], method: str, may_change: bool) -> Sign:
    """Give the distances their signs, and compare them with another method's on a sample.

    `channels["distance"]` comes with the signs of pseudonormals. Those of a mesh that is closed and oriented but
    crosses itself are wrong in places; the comparison finds it, and winding numbers take over if they may.
    """
    if method == "pseudonormal":
        points, given = _compared(work, channels["distance"])
        differ = float((work.winding.signs(points) != given).mean()) if len(given) else 0.0
        if differ <= _DISAGREEMENT or not may_change:
            return Sign(method="pseudonormal", checked=len(given), disagree=differ)
    distance = np.abs(channels["distance"])
    for chunk in work.chunks("signs"):
        distance[chunk] *= work.winding.brick_signs(work.points(chunk), distance[chunk])
        work.done("signs", chunk)
    channels["distance"] = distance
    points, given = _compared(work, distance)
    other = work.normals.signs(points, work.surface.closest(points))
    return Sign(method="winding", checked=len(given), disagree=float((other != given).mean()) if len(given) else 0.0)


def _compared(work: _Work, distance: Float[np.ndarray, "k 8 8 8"]) -> tuple[np.ndarray, Int[np.ndarray, " n"]]:
    """Return an even choice of the band's samples, off the surface itself, and their signs."""
    size = np.abs(distance) / work.lattice.spacing
    near = np.flatnonzero((size <= BAND) & (size > 1e-6) & in_lattice(work.index, work.lattice.shape))
    near = near[:: max(1, -(-len(near) // _COMPARED))]
    slot, *within = np.unravel_index(near, distance.shape)
    at = work.index[slot].astype(np.int64) * SIDE + np.stack(within, axis=-1)
    return work.lattice.to_world(at), np.where(distance.reshape(-1)[near] < 0, -1, 1).astype(np.int8)


def _warn(sign: Sign, *, inside_out: bool) -> None:
    """Tell the user what the signs rest on."""
    if inside_out:
        warnings.warn("the mesh is inside out: its inside is taken to be what it encloses", stacklevel=3)
    if sign.disagree > _DISAGREEMENT:
        warnings.warn(
            f"the signs by {sign.method} differ from another method's on {sign.disagree:.2%} of {sign.checked} samples:"
            " the mesh overlaps itself or is not oriented; see 'python -m sdfbake check'",
            stacklevel=3,
        )


def edge_over_h(mesh: Mesh, lattice: Lattice) -> float:
    """Return the median edge of a mesh in voxels; above 1, reflections look faceted."""
    sides = mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)]
    return float(np.median(np.linalg.norm(sides, axis=-1)) / lattice.spacing)


def mesh_hash(mesh: Mesh) -> str:
    """Return the SHA-256 of a mesh's arrays."""
    digest = hashlib.sha256()
    for values in (mesh.vertices, mesh.faces, mesh.uv, mesh.chart, mesh.part):
        if values is not None:
            digest.update(values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes())
    return digest.hexdigest()
