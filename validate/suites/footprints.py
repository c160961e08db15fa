"""Footprints of the grid against the mesh, and against closed forms where there are some.

In: build/meshes/NAME.ply and build/grids/NAME@N.zarr.zip. Out: error runs with maps of the level-of-detail error.
Primary rays: the mesh, by Embree, is truth. Reflected rays: the exact shape is truth, and the mesh with its facets or
with interpolated normals is one more contender: it is what renderers do today. Baked grids are read by faces, as is the
default, and as Galim 2018 reads them; grids of exact shapes know the latter only.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product

import numpy as np
from jaxtyping import Bool, Int

from datasets_synthetic import shape
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.mesh import Mesh
from sdfrender import Camera, GridField
from validate.beam import Beam
from validate.closed import ExactReference
from validate.compare import compare, lod_map
from validate.embree import MeshReference
from validate.experiment import Bench, Run, guarded
from validate.facets import Normals
from validate.metrics import Seen
from validate.views import framing, seen, through_field

SIZE = 256
RESOLUTIONS = (64, 512)
KERNELS = ("bspline", "linear")
# Texture coordinates that are read, per route.
READ = {"exact grid": ("grid",), "baked grid": ("faces", "grid")}
PRIMARY = ("torus", "mirror", "bunny")
REFLECTED = ("torus", "mirror")
# Where the cameras stand, as seen from the middle of each object. The torus shows its hole, where it mirrors
# itself; the mirror scene its page, from beside the sphere.
DIRECTIONS = {"torus": (0.35, 0.3, 1.0), "mirror": (1.0, 0.5, -0.9), "bunny": (0.2, 0.25, 1.0)}


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A problem: its rays, what is true at each pixel, and which pixels count."""

    problem: str
    rays: Beam
    bounces: int
    truth: Seen
    among: Bool[np.ndarray, " n"]


def run(bench: Bench) -> Iterator[Run]:
    """All views of one object at a time, so that each field is built once."""
    names = list(dict.fromkeys((*PRIMARY, *REFLECTED)))
    if bench.only not in (None, *names):
        raise BadInput(f"this suite does not look at '{bench.only}': choose one of {', '.join(names)}")
    for name in names if bench.only is None else [bench.only]:
        bench.progress(f"footprints of the {name}")
        reference = MeshReference(Mesh.load(bench.mesh(name)))
        views = [_primary(name, reference)] if name in PRIMARY else []
        if name in REFLECTED:
            view = _reflected(name)
            views.append(view)
            yield from _meshes(bench, view, reference)
        for resolution in RESOLUTIONS:
            grids = {"baked grid": Grid.load(bench.grid(name, resolution))}
            if name in REFLECTED:
                path = bench.exact_grid(name, resolution)
                exact = Grid.from_function(shape(name), resolution) if path is None else Grid.load(path)
                grids["exact grid"] = exact
            for route, grid in grids.items():
                for uv, kernel in product(READ[route], KERNELS):
                    setup = {"route": route, "uv": uv, "kernel": kernel}
                    yield from _judged(bench, views, grid, setup, resolution)


def _primary(name: str, reference: MeshReference) -> View:
    """Camera rays; the mesh is truth."""
    rays = framing(reference.mesh.bounds, SIZE, DIRECTIONS[name]).rays()
    truth = seen(reference.follow(rays, 0)[0])
    return View(f"{name}, primary rays", rays, 0, truth, np.ones(len(truth.t), bool))


def _reflected(name: str) -> View:
    """Rays through one mirror bounce that hit something; the exact shape is truth."""
    exact = shape(name)
    rays = _mirror_camera(name, exact.bounds).rays()
    first, second = ExactReference(exact).follow(rays, 1)
    among = second.hit & ((first.part == 0) & (second.part == 1) if name == "mirror" else first.hit)
    return View(f"{name}, one mirror bounce", rays, 1, seen(second), among)


def _mirror_camera(name: str, bounds: np.ndarray) -> Camera:
    """Between sphere and page, where the page fills the mirror (Galim 2018), or the torus from outside."""
    if name == "mirror":
        return Camera((0.0, 0.0, 1.9), (0.0, 0.0, 0.0), fov=28.0, size=(SIZE, SIZE))
    return framing(bounds, SIZE, DIRECTIONS[name])


def _blank(view: View, setup: dict[str, str], knob: dict[str, float | int]) -> Run:
    return Run("footprints", view.problem, setup, knob, "error")


def _meshes(bench: Bench, view: View, reference: MeshReference) -> Iterator[Run]:
    """The mesh as a contender, with its facets and with interpolated normals."""
    routes: tuple[tuple[str, Normals], ...] = (("mesh, facets", "faceted"), ("mesh, interpolated normals", "angle"))
    for route, normals in routes:

        def measured(blank: Run, normals: Normals) -> Run:
            ours = seen(reference.follow(view.rays, view.bounces, normals)[-1])
            return _record(bench, view, blank, ours, None)

        blank = _blank(view, {"route": route}, {})
        yield guarded(blank, partial(measured, blank, normals))


def _judged(bench: Bench, views: list[View], grid: Grid, setup: dict[str, str], resolution: int) -> Iterator[Run]:
    """A grid read in one way, in all views that it is meant for: primary rays see baked grids alone."""
    field = cache(partial(GridField, grid, setup["kernel"], uv_mode=setup["uv"]))

    def measured(view: View, blank: Run) -> Run:
        ours, flags = through_field(field(), view.rays, view.bounces, grid.lattice.spacing)
        return _record(bench, view, blank, ours, flags)

    for view in views:
        if view.bounces or setup["route"] == "baked grid":
            blank = _blank(view, setup, {"resolution": resolution})
            yield guarded(blank, partial(measured, view, blank))


def _record(bench: Bench, view: View, blank: Run, ours: Seen, flags: Int[np.ndarray, " n"] | None) -> Run:
    values = compare(ours, view.truth, (SIZE, SIZE), view.among, flags)
    error = lod_map(ours, view.truth, (SIZE, SIZE), view.among).astype(np.float16)
    words = [view.problem, *blank.setup.values(), *(f"{n:g}" for n in blank.knob.values())]
    name = "footprints-" + "-".join(word.replace(", ", "-").replace(" ", "-") for word in words)
    artefact = bench.store(name, lod_error=error)
    return replace(blank, values=values, artefact=artefact)
