"""Texture coordinates as faces, layers and grid (Galim 2018), at points of the mesh where they are known exactly.

In: build/meshes/NAME.ply, build/grids/NAME@N.zarr.zip with all three, build/textures/checker.png. Out: error runs at
random points and of a camera's view, with pictures; timed runs of look-ups, which `--only clock` sets apart.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.gridfile import stored_bytes
from sdfbake.mesh import Mesh
from sdfbake.metadata import MODES
from sdfrender import Camera, Flag, Footprint, GridField, Hits, Rays, Scene, footprint, render
from sdfrender.image import srgb_bytes
from validate import metrics
from validate.compare import lod_map
from validate.embree import MeshReference
from validate.experiment import Bench, Run, guarded, timed
from validate.facets import Facets, unit
from validate.metrics import Seen, summary
from validate.suites.footprints import DIRECTIONS
from validate.timing import measure
from validate.views import TEXELS, framing, seen, through_field

# Interpolated coordinates depend on the kernel that traces; of the others only the normal does.
KERNEL, MORE_KERNELS = "bspline", ("linear", "catmull-rom")
NAMES = ("bunny", "torus")
RESOLUTIONS = (64, 128, 256)
COARSE = 128  # up to which all kernels are tried
POINTS = 40_000
# What is shown, and how many pixels it has along a side.
SHOWN, SHOWN_RESOLUTION, SIZE = "bunny", 64, 384
# What is timed, on how many points, and what to ask for to have nothing else.
CLOCKED, CLOCKED_RESOLUTIONS, CLOCKED_POINTS, CLOCK = "bunny", (64, 256), 2**18, "clock"
# Where each representation lies in a file, by the first word of the arrays' names.
STORED = {"faces": ("face", "surface"), "layers": ("layers",), "grid": ("uv", "chart")}


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Points of a mesh with two tangent vectors each, as a pixel's steps would be.

    Attributes
    ----------
    p
        Positions.
    face
        The face that each lies on.
    dp_dx, dp_dy
        Random vectors in the plane of the face.
    truth
        Texture coordinates, footprint and chart of the mesh itself.
    """

    p: Float[np.ndarray, "n 3"]
    face: Int[np.ndarray, " n"]
    dp_dx: Float[np.ndarray, "n 3"]
    dp_dy: Float[np.ndarray, "n 3"]
    truth: Seen


def run(bench: Bench) -> Iterator[Run]:
    """Errors and a view of one mesh at a time, then the clock."""
    parts = [*NAMES, CLOCK]
    if bench.only not in (None, *parts):
        raise BadInput(f"this suite does not look at '{bench.only}': choose one of {', '.join(parts)}")
    for part in parts if bench.only is None else [bench.only]:
        if part == CLOCK:
            yield from _clocked(bench)
            continue
        yield from _at_points(bench, part)
        if part == SHOWN:
            yield from _views(bench)


def _at_points(bench: Bench, name: str) -> Iterator[Run]:
    """All that a mesh's grids hold, at the same points."""
    places = scattered(Mesh.load(bench.mesh(name)), POINTS, np.random.default_rng(11))
    for resolution in RESOLUTIONS:
        bench.progress(f"texture coordinates of the {name}, {resolution}^3")
        path = bench.grid(name, resolution)
        grid = Grid.load(path)
        for setup in _setups(resolution):
            blank = Run("representations", name, setup, {"resolution": resolution}, "error")
            yield guarded(blank, partial(_judged, blank, path, grid, places))


def _setups(resolution: int) -> list[dict[str, str]]:
    more = MORE_KERNELS if resolution <= COARSE else ()
    pairs = [*((mode, KERNEL) for mode in MODES), *(("grid", kernel) for kernel in more)]
    return [{"uv": mode, "kernel": kernel} for mode, kernel in pairs]


def scattered(mesh: Mesh, count: int, rng: np.random.Generator) -> Places:
    """Points spread evenly over a mesh with texture coordinates, and what is true there in closed form."""
    facets = Facets(mesh)
    a, b, c = np.moveaxis(facets.corners, 1, 0)
    area = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    face = np.searchsorted(area, rng.random(count) * area[-1], side="right")
    # The root makes points as dense at a corner as along the edge that faces it.
    far, along = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - far, far * (1 - along), far * along], axis=1)
    p, uv = (np.einsum("nk,nkc->nc", weights, corners[face]) for corners in (facets.corners, facets.uv))
    n, gradient = facets.normal[face], facets.uv_gradient[face]
    steps = rng.normal(size=(2, count, 3))
    dp_dx, dp_dy = steps - np.sum(steps * n, axis=2, keepdims=True) * n
    duv_dx, duv_dy = (np.einsum("nkc,nc->nk", gradient, dp) for dp in (dp_dx, dp_dy))
    jacobian = metrics.footprint(duv_dx, duv_dy, TEXELS)
    return Places(p, face, dp_dx, dp_dy, Seen(np.zeros(count), n, uv, jacobian, mesh.chart[face].astype(np.int64)))


def looked_up(field: GridField, places: Places) -> Footprint:
    """What a field says at places; the normal there is the field's own, as for a hit."""
    count = len(places.p)
    nothing, nowhere = np.zeros(count, np.int64), np.zeros_like(places.p)
    n = unit(field.jet(places.p, 1)[1])
    hits = Hits(np.zeros(count), places.p, n, nothing, nothing)
    return footprint(field, hits, Rays(places.p, -n, places.dp_dx, places.dp_dy, nowhere, nowhere))


def errors(found: Footprint, truth: Seen) -> dict[str, float]:
    """Sum up texture coordinates in texels, the level of detail in mip levels, and which chart was taken."""
    jacobian = metrics.footprint(found.duv_dx, found.duv_dy, TEXELS)
    ours = Seen(truth.t, truth.n, found.uv, jacobian, found.chart)
    texels = np.linalg.norm(found.uv - truth.uv, axis=1) * TEXELS
    values = {
        "points": float(len(texels)),
        "wrong_chart": float(metrics.chart_mismatch(ours, truth).mean()),
        "seam": float(((found.flags & Flag.SEAM) != 0).mean()),
    }
    for name, error in (("uv", texels), ("lod", metrics.lod_error(ours, truth))):
        values |= {f"{name}.{key}": figure for key, figure in summary(error).items()}
    return values


def size_of(path: Path, mode: str) -> float:
    """Bytes on disk of a representation within a grid file."""
    return float(sum(size for name, size in stored_bytes(path).items() if name.partition(".")[0] in STORED[mode]))


def _judged(blank: Run, path: Path, grid: Grid, places: Places) -> Run:
    mode = blank.setup["uv"]
    field = GridField(grid, blank.setup["kernel"], engine="numpy", uv_mode=mode)
    values = errors(looked_up(field, places), places.truth)
    values |= {"bytes": size_of(path, mode), "file_bytes": float(path.stat().st_size)}
    return replace(blank, values=values)


def _views(bench: Bench) -> Iterator[Run]:
    """The same camera for every representation: a picture, and where its levels of detail are wrong."""
    bench.progress(f"the {SHOWN} at {SHOWN_RESOLUTION}^3, seen through every representation")
    path = bench.grid(SHOWN, SHOWN_RESOLUTION)
    reference = MeshReference(Mesh.load(bench.mesh(SHOWN)))
    camera = framing(reference.mesh.bounds, SIZE, DIRECTIONS[SHOWN])
    truth = seen(reference.follow(camera.rays(), 0)[0])
    grid = Grid.load(path)
    for mode in MODES:
        setup = {"uv": mode, "kernel": KERNEL}
        blank = Run("representations", f"{SHOWN}, a view", setup, {"resolution": SHOWN_RESOLUTION}, "error")
        yield guarded(blank, partial(_viewed, bench, blank, grid, path, camera, truth))


def _viewed(bench: Bench, blank: Run, grid: Grid, path: Path, camera: Camera, truth: Seen) -> Run:
    mode = blank.setup["uv"]
    ours, _ = through_field(GridField(grid, KERNEL, uv_mode=mode), camera.rays(), 0, grid.lattice.spacing)
    error = lod_map(ours, truth, (SIZE, SIZE))
    image = srgb_bytes(render(checkered(path, mode, bench.build / "textures" / "checker.png", camera))["rgb"])
    values = {f"lod.{key}": figure for key, figure in summary(error[np.isfinite(error)]).items()}
    artefact = bench.store(f"representations-{mode}", image=image, lod_error=error.astype(np.float16))
    return replace(blank, values=values, artefact=artefact)


def checkered(grid: Path, mode: str, texture: Path, camera: Camera) -> Scene:
    """The scene of a grid in a checked texture, read by one representation."""
    return Scene.model_validate(
        {
            "camera": {"position": camera.position, "target": camera.target, "fov": camera.fov},
            "film": {"size": camera.size},
            "trace": {"kernel": KERNEL},
            "assets": [{"grid": grid, "uv": mode, "materials": [{"type": "diffuse", "texture": "checker"}]}],
            "textures": [{"name": "checker", "image": texture, "wrap": "repeat"}],
            "background": (0.05, 0.05, 0.06),
        }
    )


def _clocked(bench: Bench) -> Iterator[Run]:
    """Time look-ups with the default engine: places found, normals where they are needed, coordinates, gradients."""
    places = scattered(Mesh.load(bench.mesh(CLOCKED)), CLOCKED_POINTS, np.random.default_rng(12))
    for resolution in CLOCKED_RESOLUTIONS:
        bench.progress(f"look-ups against the clock, {resolution}^3")
        grid = Grid.load(bench.grid(CLOCKED, resolution))
        for mode in MODES:
            setup = {"uv": mode, "kernel": KERNEL}
            blank = Run("representations", CLOCKED, setup, {"resolution": resolution}, "timing")
            yield guarded(blank, partial(_timing, blank, grid, places.p))


def _timing(blank: Run, grid: Grid, points: Float[np.ndarray, "n 3"]) -> Run:
    field = GridField(grid, KERNEL, uv_mode=blank.setup["uv"])
    taken = measure(partial(field.uv, points))
    return timed(blank.suite, blank.problem, blank.setup, blank.knob, taken, rays=len(points))
