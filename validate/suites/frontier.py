"""Error against run time: mirror bounces on exact shapes, traced on grids and on meshes of many resolutions.

In: nothing from the build. Out: per problem, kernel, engine, precision and resolution an error run and a timed run;
error runs on NumPy count the work, which is every engine's. The mesh with interpolated normals is one more contender.
The error is that of the reflected beam, d(direction)/d(pixel), which is the footprint on a distant environment; its
truth is closed-form.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic import shape
from sdfbake.grid import Grid
from sdfrender import Camera, Field, GridField, Rays, reflect, transfer
from validate.beam import Beam, MeshRays, only
from validate.closed import ExactReference
from validate.counters import Counters
from validate.course import as_rays
from validate.embree import MeshReference
from validate.experiment import Bench, Run, guarded, timed
from validate.metrics import summary
from validate.suites.convergence import KERNELS, sphere_grid
from validate.timing import measure

RESOLUTIONS = (16, 32, 64, 128)
# Engine, precision, and pixels along a side for the clock: enough for the cost per ray to be that of a full picture.
SETUPS = (("numpy", "64", 48), ("drjit", "32", 192), ("drjit", "64", 192))
# Pixels whose ray meets the surface flatter than this are the silhouette's: there the footprint has no bound.
GRAZING = 0.1
MESH = {"route": "mesh, interpolated normals", "kernel": "mesh", "engine": "numpy", "precision": "64"}
# Median edges of the meshes, in the shape's units: about 500 to 120,000 faces.
EDGES: tuple[float, ...] = (0.2, 0.1, 0.05, 0.025, 0.0125)
MESH_SIZE = 128  # pixels along a side for the meshes' clock


@dataclass(frozen=True, slots=True)
class Problem:
    """What is looked at.

    Attributes
    ----------
    name
        In words.
    shape
        Name of the exact shape.
    position, target, fov
        The camera.
    bounces
        Mirror bounces; the beam after the last is judged.
    pixels
        Along a side, for the error and the counts.
    kernels, resolutions
        Those that are tried.
    """

    name: str
    shape: str
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float
    bounces: int
    pixels: int
    kernels: tuple[str, ...]
    resolutions: tuple[int, ...]

    def rays(self, size: int) -> Rays:
        """Rays of a camera with so many pixels along a side."""
        return Camera(self.position, self.target, fov=self.fov, size=(size, size)).rays()


SPHERE = Problem(
    "sphere, one mirror bounce", "sphere", (0.3, 0.4, 3.2), (0.0, 0.0, 0.0), 35.0, 1, 48, KERNELS, RESOLUTIONS
)
# From within the hole, where rays go from one side of the tube to the other; most leave after the first mirror.
TORUS = Problem(
    "torus, two mirror bounces",
    "torus",
    (0.0, 0.0, 0.2),
    (0.4, 0.1, -0.05),
    60.0,
    2,
    96,
    ("bspline",),  # the linear one's error is that of a flat mirror at any resolution
    (32, 64, 128),
)


class Tracer(NamedTuple):
    """One route's way to carry rays to a surface, and to mirror them there.

    `transfer(rays, left)` gives hits and the rays at the hits; `left` says where rays start on the surface: at which
    of the earlier hits, with their indices, or None for a camera's.
    """

    transfer: Callable[[Beam, tuple[Any, Int[np.ndarray, " m"]] | None], tuple[Any, Beam]]
    reflect: Callable[[Any, Beam], Beam]


class Bounced(NamedTuple):
    """What came of rays: where they first hit, which went through all mirrors, how steeply at least, and as what."""

    t: Float[np.ndarray, " n"]
    which: Int[np.ndarray, " m"]
    steepness: Float[np.ndarray, " m"]
    beam: MeshRays


def run(bench: Bench) -> Iterator[Run]:
    """Sweep problems, resolutions, kernels and engines; for each the error first, then the clock; then the meshes."""
    setups, edges, mesh_size = list(SETUPS), EDGES, MESH_SIZE
    if bench.quick:
        setups, edges, mesh_size = [(*SETUPS[0][:2], 8)], EDGES[:2], 8
    for whole in (SPHERE, TORUS):
        problem = replace(whole, kernels=("bspline",), resolutions=(16, 32), pixels=24) if bench.quick else whole
        for n in problem.resolutions:
            bench.progress(f"error against run time, {problem.name}, {n}^3")
            for kernel in problem.kernels:
                for engine, precision, size in setups:
                    setup = {"kernel": kernel, "engine": engine, "precision": precision}
                    error = Run("frontier", problem.name, setup, {"resolution": n}, "error")
                    yield guarded(error, partial(_error, error, problem))
                    timing = replace(error, kind="timing")
                    yield guarded(timing, partial(_timing, timing, problem, size))
        bench.progress(f"error against run time, {problem.name}, meshes")
        for edge in edges:
            yield from _mesh(problem, edge, mesh_size)


@lru_cache(maxsize=1)
def _grid(name: str, resolution: int) -> Grid:
    """A shape, sampled; the sphere is shared with the other suites of the same process."""
    return sphere_grid(resolution) if name == "sphere" else Grid.from_function(shape(name), resolution, uv_mode="none")


@lru_cache(maxsize=1)
def _field(name: str, resolution: int, kernel: str, engine: str, precision: str) -> GridField:
    """The field under test, kept from the error run for the timed one."""
    return GridField(_grid(name, resolution), kernel, engine=engine, precision=int(precision))


@cache
def _truth(problem: Problem) -> Bounced:
    """What is true of the rays of the error runs."""
    return bounced(exact_tracer(ExactReference(shape(problem.shape))), problem.rays(problem.pixels), problem.bounces)


def field_tracer(field: Field) -> Tracer:
    """The renderer on a field."""
    return Tracer(
        lambda rays, left: transfer(field, as_rays(rays), on_surface=left is not None),
        lambda hits, at: reflect(field, hits, as_rays(at)),
    )


def exact_tracer(reference: ExactReference) -> Tracer:
    """Closed forms."""
    return Tracer(lambda rays, left: reference.transfer(rays, on_surface=left is not None), reference.reflect)


def mesh_tracer(reference: MeshReference) -> Tracer:
    """Embree, with vertex normals interpolated."""
    return Tracer(
        lambda rays, left: reference.transfer(rays, None if left is None else left[0].face[left[1]], "angle"),
        lambda hits, at: reference.reflect(hits, at, "angle"),
    )


def bounced(tracer: Tracer, rays: Rays, bounces: int) -> Bounced:
    """Trace, mirror so many times what hits, and trace what is left once more."""
    hits, at = tracer.transfer(rays, None)
    t, which, steepness = hits.t, np.arange(len(rays.p)), np.ones(len(rays.p))
    beam = only(rays, which)
    for _ in range(bounces):
        hit = np.flatnonzero(hits.hit)
        steepness = np.minimum(steepness[hit], np.abs(np.sum(hits.n[hit] * at.d[hit], axis=1)))
        which, beam = which[hit], only(tracer.reflect(hits, at), hit)
        hits, at = tracer.transfer(beam, (hits, hit))
    return Bounced(t, which, steepness, beam)


def judged(ours: Bounced, truth: Bounced) -> dict[str, float]:
    """Compare beams after the last mirror, and the first distances, where both routes went that way."""
    _, mine, theirs = np.intersect1d(ours.which, truth.which, assume_unique=True, return_indices=True)
    plain = truth.steepness[theirs] > GRAZING
    exact, found = _turning(truth.beam)[theirs[plain]], _turning(ours.beam)[mine[plain]]
    beam = np.linalg.norm(found - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    of = truth.which[theirs[plain]]
    otherwise = len(ours.which) + len(truth.which) - 2 * len(mine)
    values = {"missed": otherwise / len(truth.t), "pixels": float(len(of))}
    for name, error in (("beam", beam), ("distance", np.abs(ours.t[of] - truth.t[of]))):
        values |= {f"{name}.{key}": figure for key, figure in summary(error).items()}
    return values


def _error(blank: Run, problem: Problem) -> Run:
    field, rays, counters = _field_of(blank, problem), problem.rays(problem.pixels), Counters()
    counting = blank.setup["engine"] == "numpy"
    tracer = field_tracer(counters.watch(field) if counting else field)
    values = judged(bounced(tracer, rays, problem.bounces), _truth(problem))
    work = counters.work.per(len(rays.p)) if counting else {}
    values |= {"spacing": field.grid.lattice.spacing} | {f"work.{name}": count for name, count in work.items()}
    return replace(blank, values=values)


def _timing(blank: Run, problem: Problem, size: int) -> Run:
    tracer, rays = field_tracer(_field_of(blank, problem)), problem.rays(size)
    taken = measure(lambda: bounced(tracer, rays, problem.bounces), repeats=3)
    return timed(blank.suite, blank.problem, blank.setup, blank.knob, taken, rays=len(rays.p))


def _field_of(blank: Run, problem: Problem) -> GridField:
    setup = blank.setup
    return _field(problem.shape, int(blank.knob["resolution"]), setup["kernel"], setup["engine"], setup["precision"])


def _mesh(problem: Problem, edge: float, size: int) -> Iterator[Run]:
    """A mesh of the shape, its error and its clock."""
    tracer = mesh_tracer(MeshReference(shape(problem.shape).mesh(edge)))

    def error() -> Run:
        found = judged(bounced(tracer, problem.rays(problem.pixels), problem.bounces), _truth(problem))
        return replace(blank, values=found | {"spacing": edge})

    def timing() -> Run:
        rays = problem.rays(size)
        taken = measure(lambda: bounced(tracer, rays, problem.bounces), repeats=3)
        return timed(blank.suite, blank.problem, blank.setup, blank.knob, taken, rays=len(rays.p))

    blank = Run("frontier", problem.name, MESH, {"edge": edge}, "error")
    yield guarded(blank, error)
    yield guarded(replace(blank, kind="timing"), timing)


def _turning(rays: Beam) -> Float[np.ndarray, "n 3 2"]:
    return np.stack([rays.dd_dx, rays.dd_dy], axis=2)
