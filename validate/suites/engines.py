"""Both engines over the same scene: whether they agree, and what each costs.

In: nothing of the build. Out: error runs (Dr.Jit in float64 and float32 against NumPy in float64) and timed
runs of all three, over a mirror bounce with footprints.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np
from jaxtyping import Float

from datasets_synthetic import shape
from sdfbake.grid import Grid
from sdfrender import Camera, GridField, Rays
from validate.experiment import Bench, Run, guarded, timed
from validate.metrics import Seen, summary
from validate.timing import measure
from validate.views import through_field

RESOLUTIONS = (64, 128)
# Pixels along a side. NumPy takes the fewer, enough for its cost per ray to be that of a full picture.
FEW, MANY = 96, 512
SETUPS = (("numpy", 64), ("drjit", 64), ("drjit", 32))
PROBLEM = "mirror scene, one bounce with footprints"


def run(bench: Bench) -> Iterator[Run]:
    """Compare with NumPy, then time, each engine with one field for both."""
    few, many = (Camera((0.0, 0.0, 1.9), (0.0, 0.0, 0.0), fov=50.0, size=(n, n)).rays() for n in (FEW, MANY))
    for resolution in RESOLUTIONS:
        grid = Grid.from_function(shape("mirror"), resolution)
        truth: Seen | None = None
        for engine, precision in SETUPS:
            bench.progress(f"engine {engine} in float{precision}, {resolution}^3")
            setup = {"engine": engine, "precision": str(precision)}
            error = Run("engines", PROBLEM, setup, {"resolution": resolution}, "error")
            field = cache(partial(GridField, grid, engine=engine, precision=precision))
            if truth is None:
                truth = _seen(field(), few)
            else:
                yield guarded(error, partial(_error, error, field, few, truth))
            timing = replace(error, kind="timing")
            yield guarded(timing, partial(_timing, timing, field, few if engine == "numpy" else many))


def _seen(field: GridField, rays: Rays) -> Seen:
    return through_field(field, rays, 1, field.grid.lattice.spacing)[0]


def _error(blank: Run, field: Callable[[], GridField], rays: Rays, truth: Seen) -> Run:
    ours = _seen(field(), rays)
    both = ours.hit & truth.hit
    values = {"missed": float((ours.hit != truth.hit).sum()), "pixels": float(both.sum())}
    for name in ("t", "n", "uv", "jacobian"):
        error = relative(getattr(ours, name)[both], getattr(truth, name)[both])
        values |= {f"{name}.{key}": figure for key, figure in summary(error).items()}
    return replace(blank, values=values)


def _timing(blank: Run, field: Callable[[], GridField], rays: Rays) -> Run:
    taken = measure(partial(_seen, field(), rays), repeats=3)
    return timed(blank.suite, blank.problem, blank.setup, blank.knob, taken, rays=len(rays.p))


def relative(ours: Float[np.ndarray, "n ..."], truth: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, " n"]:
    """Size of the difference over size of the truth, per row."""
    rows, size = (ours - truth).reshape(len(truth), -1), np.linalg.norm(truth.reshape(len(truth), -1), axis=1)
    return np.asarray(np.linalg.norm(rows, axis=1) / np.where(size > 0, size, 1.0))
