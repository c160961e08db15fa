"""The kernels' closed-form derivatives against automatic differentiation, and what each of the two costs.

In: nothing from the build. Out: error runs per field, kernel and precision, both ways against the closed form in
float64 on NumPy, which shares no arithmetic with Dr.Jit; and timed runs of value, gradient and Hessian at many points.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Float

from sdfbake.grid import Grid
from sdfrender import GridField
from validate.autodiff import (
    Derivatives,
    automatic,
    automatic_columns,
    closed_columns,
    closed_form,
    columns,
    differentiable_field,
    inside_cells,
)
from validate.experiment import Bench, Run, guarded, timed
from validate.metrics import summary
from validate.suites.convergence import KERNELS, sphere_grid
from validate.timing import measure

PRECISIONS = (64, 32)
CLOSED, AUTOMATIC = "closed form", "automatic"
WAYS: dict[str, Callable[[GridField, np.ndarray], Derivatives]] = {CLOSED: closed_form, AUTOMATIC: automatic}
WORK: dict[str, Callable[[GridField, list[np.ndarray]], object]] = {
    CLOSED: closed_columns,
    AUTOMATIC: automatic_columns,
}
RESOLUTION, NOISE = 64, 24  # samples per axis of the distance grid, and of the one that is no distance at all
# Points that are compared, and that are timed: enough for the cost per point to be that of a picture.
SIZES = {"compared": 100_000, "timed": 1_000_000}
QUICK = {"compared": 2_000, "timed": 20_000}


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A grid and points in it, none of them on a face between cells."""

    name: str
    grid: Grid
    points: Float[np.ndarray, "n 3"]


def run(bench: Bench) -> Iterator[Run]:
    """All errors first, then the clock on the distance grid."""
    sizes = QUICK if bench.quick else SIZES
    rng = np.random.default_rng(31)
    for problem in (_distance(sizes["compared"], rng), _noise(sizes["compared"], rng)):
        bench.progress(f"derivatives by differentiation, {problem.name}")
        for precision in PRECISIONS:
            for kernel in KERNELS:
                yield from _errors(problem, kernel, precision)
    problem = _distance(sizes["timed"], rng)
    bench.progress("derivatives by differentiation, the clock")
    for precision in PRECISIONS:
        for kernel in KERNELS:
            for way in WAYS:
                blank = replace(_blank(problem, kernel, precision, way), kind="timing")
                yield guarded(blank, partial(_timing, blank, problem))


def _distance(count: int, rng: np.random.Generator) -> Problem:
    """The exact sphere; points within half a voxel of its surface."""
    grid = sphere_grid(RESOLUTION)
    d = rng.normal(size=(count, 3))
    radius = 0.8 + grid.lattice.spacing * rng.uniform(-0.5, 0.5, (count, 1))
    return Problem("sphere", grid, inside_cells(grid, radius * d / np.linalg.norm(d, axis=1, keepdims=True)))


def _noise(count: int, rng: np.random.Generator) -> Problem:
    """Random samples; points in all cells but those at the border, whose stencils leave the lattice."""
    grid = Grid.from_dense(rng.normal(size=(NOISE,) * 3))
    return Problem("noise", grid, inside_cells(grid, rng.uniform(2.0, NOISE - 3.0, (count, 3))))


def _blank(problem: Problem, kernel: str, precision: int, way: str) -> Run:
    setup = {"kernel": kernel, "precision": str(precision), "way": way}
    return Run("derivatives", problem.name, setup, {"points": len(problem.points)}, "error")


@lru_cache(maxsize=1)
def _plain(grid: Grid, kernel: str, precision: int) -> GridField:
    """The field that closed forms are taken from, kept from warm-up to clock."""
    return GridField(grid, kernel, "drjit", precision)


@lru_cache(maxsize=1)
def _recording(grid: Grid, kernel: str, precision: int) -> GridField:
    return differentiable_field(grid, kernel, precision)


def _field(problem: Problem, blank: Run) -> GridField:
    make = _plain if blank.setup["way"] == CLOSED else _recording
    return make(problem.grid, blank.setup["kernel"], int(blank.setup["precision"]))


def _errors(problem: Problem, kernel: str, precision: int) -> Iterator[Run]:
    """Both ways against NumPy, and the second against the first."""
    truth = closed_form(GridField(problem.grid, kernel, "numpy", 64), problem.points)
    first: list[Derivatives] = []

    def measured(blank: Run) -> Run:
        found = WAYS[blank.setup["way"]](_field(problem, blank), problem.points)
        first.append(found)
        figures = {"finite": float(_finite(found))} | _differences("", found, truth)
        if blank.setup["way"] == AUTOMATIC:
            figures |= _differences("ways.", found, first[0])
        return replace(blank, values=figures)

    for way in WAYS:
        blank = _blank(problem, kernel, precision, way)
        yield guarded(blank, partial(measured, blank))


def _differences(prefix: str, ours: Derivatives, theirs: Derivatives) -> dict[str, float]:
    """Differences of gradient and Hessian per point, relative to the root mean square length of what they should be."""
    figures: dict[str, float] = {}
    for name, a, b in (
        ("gradient", ours.gradient, theirs.gradient),
        ("hessian", ours.hessian, theirs.hessian),
    ):
        axes = tuple(range(1, a.ndim))
        a, b = a.astype(np.float64), b.astype(np.float64)
        size = float(np.sqrt(np.mean(np.sum(b * b, axis=axes))))
        difference = np.sqrt(np.sum((a - b) ** 2, axis=axes))
        figures |= {f"{prefix}{name}.{key}": value for key, value in summary(difference / (size or 1.0), ()).items()}
    return figures


def _finite(found: Derivatives) -> bool:
    return bool(np.isfinite(found.gradient).all() and np.isfinite(found.hessian).all())


def _timing(blank: Run, problem: Problem) -> Run:
    field = _field(problem, blank)
    work, places = WORK[blank.setup["way"]], columns(field, problem.points)
    taken = measure(lambda: work(field, places), repeats=3)
    return timed(blank.suite, blank.problem, blank.setup, blank.knob, taken, rays=len(problem.points))
