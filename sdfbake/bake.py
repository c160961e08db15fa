"""From a mesh to a grid asset, as the paper does it and with its distances exact.

In: a mesh. Out: a `Grid`, with its levels. What a lattice does not change is done once: checks, smoothing, normals, the
tree for winding numbers; the rest by `sdfbake.onlattice`, lattice by lattice.
"""

import hashlib
import warnings
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from sdfbake import sides
from sdfbake.closest import Surface
from sdfbake.diagnosis import diagnose
from sdfbake.engine import choose
from sdfbake.grid import Grid
from sdfbake.lattice import Lattice
from sdfbake.mesh import Mesh
from sdfbake.metadata import Sign
from sdfbake.onlattice import Ready
from sdfbake.options import Options
from sdfbake.sign import Pseudonormals, Winding
from sdfbake.smooth import Refined, ls3

Progress = Callable[[str, float], None]


def bake(
    mesh: Mesh,
    resolution: int,
    *,
    uv_mode: str | Iterable[str] | None = None,
    cube: bool = False,
    sign: str = "auto",
    open: str | None = None,  # noqa: A002
    smooth: str = "none",
    levels: int = 0,
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
    levels
        Coarser ones to bake too, each of twice the spacing, on every second node; the first lattice is larger then, as
        it makes room for the band of the last.
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
    lattice = _lattice(mesh, resolution, options, cube, levels)
    xp = choose(engine, 32).engine
    asked: dict[str, Any] = {"resolution": resolution, "cube": cube, "sign": sign, "open": open, "smooth": smooth}
    asked |= {"levels": levels} if levels else {}
    with ThreadPoolExecutor(1) as aside:  # on another core, while this one makes ready what a clean mesh needs
        found = aside.submit(diagnose, mesh, surface)
        refined = _refined(mesh, lattice, options, report)
        if refined:
            surface, lattice = Surface.of(refined.mesh), _lattice(refined.mesh, resolution, options, cube, levels)
        normals = Pseudonormals.of(surface) if options.may_orient else None
        ready = Ready(mesh, surface, refined, options, asked, mesh_hash(mesh), max_memory)
        work = ready.work(xp, lattice, normals)
        diagnosis = found.result()
    diagnosis.require_bakeable(open_too=options.open)
    if not (options.may_orient and (diagnosis.certified or sign == "pseudonormal")):
        work, normals = work.without_signs(), None
    with ThreadPoolExecutor(1) as aside:  # the tree for the other method's signs grows beside the descent
        growing = aside.submit(Winding.of, surface)
        finest = work.done(xp, growing, report)
        decided = finest.metadata.sign.method
        coarser = []
        for number in range(1, levels + 1):
            lattice = lattice.coarser()
            work = ready.work(xp, lattice, normals if decided == "pseudonormal" else None)
            level = work.done(xp, growing, _of_level(report, number), decided)
            coarser.append(replace(level, surface=finest.surface))
    _warn(finest.metadata.sign, inside_out=diagnosis.has("inside-out"), holes=options.open)
    return replace(finest, levels=tuple(coarser))


def _of_level(report: Progress, number: int) -> Progress:
    """Say which level the work is on."""
    return lambda stage, share: report(f"level {number}: {stage}", share)


def _checked(mesh: Mesh) -> Surface:
    """Return a mesh made ready, unless there is nothing in it that could be."""
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        diagnose(mesh).require_bakeable()
    return Surface.of(mesh)


def _lattice(mesh: Mesh, resolution: int, options: Options, cube: bool, levels: int) -> Lattice:
    grown = np.array([[-1.0], [1.0]]) * options.shell / 2
    return Lattice.around(mesh.bounds + grown, resolution, cube=cube, levels=levels)


def _refined(mesh: Mesh, lattice: Lattice, options: Options, report: Progress) -> Refined | None:
    """Return the mesh that is baked in place of a faceted one."""
    if options.smooth == "none":
        return None
    report("smoothing", 0)
    refined = ls3(mesh, lattice.spacing)
    report("smoothing", 1)
    return refined


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


def mesh_hash(mesh: Mesh) -> str:
    """Return the SHA-256 of a mesh's arrays."""
    digest = hashlib.sha256()
    for values in (mesh.vertices, mesh.faces, mesh.uv, mesh.chart, mesh.part):
        if values is not None:
            digest.update(values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes())
    return digest.hexdigest()
