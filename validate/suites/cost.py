"""What exactness costs a bake: error against seconds and against bytes, for every way to hold texture coordinates.

In: build/meshes/NAME.ply, build/grids/NAME@N.zarr.zip with all of them. Out: per mesh, mode and resolution an error run
(distances near the surface against libigl's, levels of detail against the mesh by Embree, bytes in the file) and a
timed run of the bake.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path

import numpy as np

from datasets_synthetic import shape
from sdfbake import bake
from sdfbake.bricks import SIDE
from sdfbake.closest import Surface
from sdfbake.complaint import BadInput
from sdfbake.grid import KERNELS, Grid
from sdfbake.gridfile import stored_bytes
from sdfbake.mesh import Mesh
from sdfbake.metadata import MODES
from sdfbake.sign import Winding
from sdfrender import GridField, Rays
from validate.embree import MeshReference
from validate.experiment import Bench, Run, guarded, timed
from validate.metrics import Seen, lod_error, summary
from validate.suites.footprints import DIRECTIONS
from validate.suites.representations import STORED, scattered
from validate.timing import Timing, measure
from validate.views import framing, seen, through_field

NONE = "none"
# How texture coordinates are held; of a second mesh the cheapest, and the default.
HELD = {"bunny": (NONE, *MODES), "torus": (NONE, "faces")}
RESOLUTIONS = (64, 128, 256)
POINTS = 20_000
KERNEL = "bspline"  # that levels of detail are traced with
SIZE = 192  # pixels along a side
REPEATS, SHORT = 3, 0.8  # bakes that count, and the seconds above which a bake is timed once


@dataclass(frozen=True, eq=False)
class Subject:
    """A mesh, and what is true of it; made where it is first needed."""

    name: str
    mesh: Mesh

    @cached_property
    def surface(self) -> Surface:
        """The mesh, ready to be asked for distances."""
        return Surface.of(self.mesh)

    @cached_property
    def winding(self) -> Winding:
        """The mesh, ready to be asked for signs."""
        return Winding.of(self.surface)

    @cached_property
    def rays(self) -> Rays:
        """Those of a camera that the mesh fills."""
        return framing(self.mesh.bounds, SIZE, DIRECTIONS[self.name]).rays()

    @cached_property
    def view(self) -> Seen:
        """What they see on the mesh, by Embree."""
        return seen(MeshReference(self.mesh).follow(self.rays, 0)[0])

    @property
    def size(self) -> float:
        """Longest side of the box around the mesh: the unit of distances."""
        low, high = self.mesh.bounds
        return float((high - low).max())


def run(bench: Bench) -> Iterator[Run]:
    """One mesh at a time: errors by resolution, then the clock."""
    if bench.only not in (None, *HELD):
        raise BadInput(f"this suite does not look at '{bench.only}': choose one of {', '.join(HELD)}")
    names = ["torus"] if bench.quick else ["bunny"] if bench.only is None else [bench.only]
    for name in names:
        subject = Subject(name, Mesh.load(bench.mesh(name)))
        for n in RESOLUTIONS[:1] if bench.quick else RESOLUTIONS:
            bench.progress(f"what exactness costs, {name}, {n}^3")
            path = bench.grid(name, n)
            grid = Grid.load(path)
            near = distances(grid, subject)
            for mode in HELD[name]:
                blank = Run("cost", name, {"uv": mode}, {"resolution": n}, "error")
                yield guarded(blank, partial(_error, blank, path, grid, subject, near))
                timing = replace(blank, kind="timing")
                yield guarded(timing, partial(_timing, timing, subject.mesh))


def distances(grid: Grid, subject: Subject) -> dict[str, float]:
    """Interpolated against exact distances within a voxel of the surface, in units of the object.

    `distance.KERNEL.SUMMARY` is over random points, where libigl names the distance and winding numbers the sign;
    `asset.KERNEL.SUMMARY` is what the grid says of itself, over its bricks.
    """
    rng, h = np.random.default_rng(5), grid.lattice.spacing
    places = scattered(subject.mesh, POINTS, rng)
    p = places.p + rng.uniform(-h, h, (POINTS, 1)) * places.truth.n
    exact = subject.surface.distance(p) * subject.winding.signs(p)
    values: dict[str, float] = {}
    for column, kernel in enumerate(KERNELS):
        off = np.abs(GridField(grid, kernel, precision=64).jet(p, 0)[0] - exact) / subject.size
        values |= {f"distance.{kernel}.{key}": figure for key, figure in summary(off).items()}
        if grid.error is not None:
            said = grid.error[:, column].astype(np.float64)
            figures = summary(said[said > 0] * h / subject.size)
            values |= {f"asset.{kernel}.{key}": figure for key, figure in figures.items()}
    return values


def bytes_of(path: Path, mode: str) -> float:
    """Bytes of a grid file that holds one way of texture coordinates, taken from one that holds several."""
    others = {word for other, words in STORED.items() if other != mode for word in words}
    sizes = stored_bytes(path).items()
    return float(sum(size for name, size in sizes if name.partition(".")[0] not in others))


def _error(blank: Run, path: Path, grid: Grid, subject: Subject, near: dict[str, float]) -> Run:
    mode, samples = blank.setup["uv"], len(grid.bricks) * SIDE**3
    size = bytes_of(path, mode)
    values = near | {"bytes": size, "samples": float(samples), "bytes_per_sample": size / samples}
    values["edge_over_h"] = grid.metadata.edge_over_h or 0.0
    return replace(blank, values=values if mode == NONE else values | _levels(grid, subject, mode))


def _levels(grid: Grid, subject: Subject, mode: str) -> dict[str, float]:
    """Levels of detail of camera rays: all pixels that both hit."""
    truth, field = subject.view, GridField(grid, KERNEL, uv_mode=mode)
    ours, _ = through_field(field, subject.rays, 0, grid.lattice.spacing)
    both = ours.hit & truth.hit
    return {f"lod.{key}": figure for key, figure in summary(lod_error(ours.at(both), truth.at(both))).items()}


def _timing(blank: Run, mesh: Mesh) -> Run:
    """Bake; what takes long once, the rest three times."""
    _compiled()
    again = partial(bake, mesh, int(blank.knob["resolution"]), uv_mode=blank.setup["uv"])
    taken = measure(again, repeats=1, warm_up=0)
    if taken.median <= SHORT:
        taken = Timing(taken.samples + measure(again, repeats=REPEATS - 1, warm_up=0).samples, ())
    return timed(blank.suite, blank.problem, blank.setup, blank.knob, taken)


@cache
def _compiled() -> None:
    """Bake something small in every mode, so that an engine that compiles has done so."""
    bake(shape("sphere").mesh(0.2), 32, uv_mode=MODES)
