"""Footprints and their error bars on every exact shape: its grid against closed forms.

In: nothing from the build; grids are sampled here. Out: per shape and kernel, error runs of primary rays and of rays
mirrored onto an environment (a shape need not see itself in its own mirror), with the coverage of error bars from a
grid of half the resolution, and the slope of the Taylor remainder.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic import ExactShape, exact_names, shape
from sdfbake import Grid
from sdfbake.complaint import BadInput
from sdfrender import GridField, Rays, reflect, transfer
from validate.bar import Bar, coverage, error_bar
from validate.beam import Beam, only
from validate.closed import ExactReference
from validate.compare import compare
from validate.course import as_rays
from validate.experiment import Bench, Run, guarded
from validate.metrics import Seen, jacobian_error, summary
from validate.reflected import frames, on_environment
from validate.regions import CLASSES, regions
from validate.taylor import slopes
from validate.views import framing, seen, through_field

KERNELS = ("bspline", "linear")
PRIMARY, MIRRORED = "primary rays", "mirrored onto an environment"
PICTURED = f"torus, {MIRRORED}"  # of which maps are kept
# From here every shape shows its sides, and the torus and the knot their holes.
DIRECTION = (0.35, 0.45, 1.0)
TAYLOR = 400  # pixels whose rays are displaced
DOUBLE = 64  # bits: errors of the method are measured, not those of float32

Fields = Callable[[], list[GridField]]


@dataclass(frozen=True, slots=True)
class Sizes:
    """Samples along a grid, pixels along a picture."""

    grid: int = 96
    picture: int = 160


QUICK = Sizes(grid=32, picture=40)
# Where the distance is found by iteration, sample by sample, and hits ray by ray.
COSTLY = {
    "knot": Sizes(grid=64),  # thin: in a smaller picture it is all silhouette
    **dict.fromkeys(("gyroid", "bumps", "terrain"), Sizes(grid=48, picture=80)),
}


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is asked of a field in a picture.

    Attributes
    ----------
    rays
        The camera's.
    truth
        What is true at its pixels.
    sees
        From a field, rays and the pixel that each belongs to, to what is seen, and its flags.
    """

    rays: Rays
    truth: Seen
    sees: Callable[[GridField, Beam, Int[np.ndarray, " m"]], tuple[Seen, Int[np.ndarray, " m"]]]


def run(bench: Bench) -> Iterator[Run]:
    """All of one shape at a time."""
    names = exact_names()
    if bench.only not in (None, *names):
        raise BadInput(f"this suite does not look at '{bench.only}': choose one of {', '.join(names)}")
    for name in names if bench.only is None else [bench.only]:
        bench.progress(f"footprints of the {name}")
        yield from _exact(bench, name, QUICK if bench.quick else COSTLY.get(name, Sizes()))


def _exact(bench: Bench, name: str, sizes: Sizes) -> Iterator[Run]:
    """Both problems with every kernel; what they share is made once, by the first that needs it."""
    exact = cache(partial(shape, name))
    problems = cache(lambda: _problems(exact(), sizes.picture))
    grids = cache(lambda: [Grid.from_function(exact(), n) for n in (sizes.grid, sizes.grid // 2)])
    for kernel in KERNELS:
        fields = cache(lambda kernel=kernel: [GridField(grid, kernel, precision=DOUBLE) for grid in grids()])
        for problem in (PRIMARY, MIRRORED):
            setup = {"route": "exact grid", "kernel": kernel}
            blank = Run("shapes", f"{name}, {problem}", setup, {"resolution": sizes.grid}, "error")

            def measured(blank: Run = blank, problem: str = problem, fields: Fields = fields) -> Run:
                return _judged(bench, blank, fields(), problems()[problem], sizes.picture)

            yield guarded(blank, measured)


def _problems(exact: ExactShape, size: int) -> dict[str, Problem]:
    """Primary rays, and rays mirrored onto the environment."""
    camera = framing(exact.bounds, size, DIRECTION)
    rays, reference = camera.rays(), ExactReference(exact)
    hits, at = reference.transfer(rays)
    mirrored = reference.reflect(hits, at)
    forward = np.subtract(camera.target, camera.position)
    frame = frames(mirrored.d, forward / np.linalg.norm(forward))
    truth = on_environment(hits.hit, hits.t, hits.n, mirrored, frame)
    return {
        PRIMARY: Problem(rays, seen(hits), lambda field, rays, _: _direct(field, rays)),
        MIRRORED: Problem(rays, truth, lambda field, rays, rows: _mirror(field, rays, frame[rows])),
    }


def _direct(field: GridField, rays: Beam) -> tuple[Seen, Int[np.ndarray, " m"]]:
    return through_field(field, rays, 0, field.grid.lattice.spacing)


def _mirror(field: GridField, rays: Beam, frame: Float[np.ndarray, "m 2 3"]) -> tuple[Seen, Int[np.ndarray, " m"]]:
    hits, at = transfer(field, as_rays(rays))
    mirrored = reflect(field, hits, at)
    return on_environment(hits.hit, hits.t, hits.n, mirrored, frame, field.grid.lattice.spacing), hits.flags


def _judged(bench: Bench, blank: Run, fields: list[GridField], problem: Problem, size: int) -> Run:
    """Errors on the first field, bars by the difference of the two, and the slope of the Taylor remainder."""
    rows, shape_ = np.arange(len(problem.rays)), (size, size)
    (fine, flags), (coarse, _) = (problem.sees(field, problem.rays, rows) for field in fields)
    values = compare(fine, problem.truth, shape_, flags=flags)
    bar, places = error_bar(fine, coarse, shape_), regions(problem.truth, shape_, flags=flags)
    for prefix, where in (("", np.ones(len(rows), bool)), *((f"{name}.", places[name]) for name in CLASSES)):
        found = coverage(fine, bar, problem.truth, where)
        values |= {f"{prefix}bar.{name}": figure for name, figure in found.items()}
    both = problem.truth.hit & fine.hit & coarse.hit & places["interior"]
    values |= {
        f"coarse.{name}": figure
        for name, figure in summary(jacobian_error(coarse.at(both), problem.truth.at(both))).items()
    }
    artefact = _pictured(bench, blank, fine, problem.truth, bar, size) if blank.problem == PICTURED else ""
    some = np.flatnonzero(places["interior"] & fine.hit)
    some = some[:: max(len(some) // TAYLOR, 1)]
    return replace(blank, values=values | _taylor(fields[0], problem, fine, some), artefact=artefact)


def _pictured(bench: Bench, blank: Run, fine: Seen, truth: Seen, bar: Bar, size: int) -> str:
    """Keep maps of the error and of its bar, relative to the true footprint; NaN where there is nothing to compare."""
    both = fine.hit & truth.hit & bar.known
    length = np.where(both, np.linalg.norm(truth.jacobian, axis=(1, 2)), np.nan)
    error = np.linalg.norm(fine.jacobian - truth.jacobian, axis=(1, 2))
    maps = {"error": error, "resolution": bar.resolution, "neighbours": bar.neighbours}
    relative = {name: (values / length).reshape(size, size).astype(np.float32) for name, values in maps.items()}
    return bench.store(f"shapes-bar-{blank.setup['kernel']}", **relative)


def _taylor(field: GridField, problem: Problem, fine: Seen, some: Int[np.ndarray, " m"]) -> dict[str, float]:
    """The remainder at some pixels; a ray that ends on another chart has none."""

    def look(rays: Beam) -> Float[np.ndarray, "m 2"]:
        rows = np.tile(some, len(rays.p) // max(len(some), 1))
        found, _ = problem.sees(field, rays, rows)
        same = found.hit & (found.chart == fine.chart[rows])
        return np.where(same[:, None], found.uv * found.texels, np.nan)

    return slopes(look, only(problem.rays, some), fine.jacobian[some]) if len(some) else {}
