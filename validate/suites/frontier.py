"""Error against run time: a camera on the exact sphere through one mirror bounce.

In: nothing from the build. Out: per kernel, resolution and engine an error run and a timed run. The error is that of
the reflected beam, d(direction)/d(pixel), which is the footprint on a distant environment; its truth is closed-form.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Float

from datasets_synthetic import shape
from sdfrender import Camera, GridField, Rays, reflect, transfer
from validate.beam import Beam, only
from validate.closed import ExactReference
from validate.experiment import Bench, Run, guarded, timed
from validate.metrics import summary
from validate.suites.convergence import KERNELS, RESOLUTIONS, sphere_grid
from validate.timing import measure

# Pixels along a side, for the error and for the clock; NumPy takes fewer rays, enough for its cost per ray to be that
# of a full picture.
SIZES = {"numpy": (48, 48), "drjit": (192, 512)}
PROBLEM = "sphere, one mirror bounce"
# Pixels whose ray meets the surface flatter than this are the silhouette's: there the footprint has no bound.
GRAZING = 0.1


def run(bench: Bench) -> Iterator[Run]:
    """Sweep engines, resolutions and kernels; for each the error first, then the clock."""
    for engine, sizes in SIZES.items():
        few, many = (Camera((0.3, 0.4, 3.2), (0.0, 0.0, 0.0), fov=35.0, size=(n, n)).rays() for n in sizes)
        for n in RESOLUTIONS:
            bench.progress(f"error against run time, {engine}, {n}^3")
            for kernel in KERNELS:
                error = Run("frontier", PROBLEM, {"kernel": kernel, "engine": engine}, {"resolution": n}, "error")
                yield guarded(error, partial(_error, error, few))
                timing = replace(error, kind="timing")
                yield guarded(timing, partial(_timing, timing, many))


@lru_cache(maxsize=1)
def _field(resolution: int, kernel: str, engine: str) -> GridField:
    """The field under test, kept from the error run for the timed one."""
    return GridField(sphere_grid(resolution), kernel, engine=engine)


def bounce(field: GridField, rays: Rays) -> tuple[Float[np.ndarray, " n"], Rays, Rays]:
    """Trace, mirror, and trace again what is left: distance, the mirrored rays, and where those ended."""
    hits, at = transfer(field, rays)
    mirrored = reflect(field, hits, at)
    hit = np.flatnonzero(hits.hit)
    _, ended = transfer(field, _rays(only(mirrored, hit)), on_surface=True)
    return hits.t, mirrored, ended


def _error(blank: Run, rays: Rays) -> Run:
    field = _field(int(blank.knob["resolution"]), blank.setup["kernel"], blank.setup["engine"])
    t, mirrored, _ = bounce(field, rays)
    reference = ExactReference(shape("sphere"))
    hits, at = reference.transfer(rays)
    truth = reference.reflect(hits, at)
    both = np.isfinite(t) & hits.hit
    plain = both & (np.abs(np.sum(hits.n * rays.d, axis=1)) > GRAZING)
    exact = _turning(truth)[plain]
    beam = np.linalg.norm(_turning(mirrored)[plain] - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    spacing = field.grid.lattice.spacing
    missed = float(np.mean(np.isfinite(t) != hits.hit))
    values = {"missed": missed, "pixels": float(both.sum()), "spacing": spacing}
    values |= {f"beam.{name}": figure for name, figure in summary(beam).items()}
    distance = np.abs(t[plain] - hits.t[plain])
    values |= {f"distance.{name}": figure for name, figure in summary(distance).items()}
    return replace(blank, values=values)


def _timing(blank: Run, rays: Rays) -> Run:
    field = _field(int(blank.knob["resolution"]), blank.setup["kernel"], blank.setup["engine"])
    taken = measure(lambda: bounce(field, rays), repeats=3)
    return timed(blank.suite, blank.problem, blank.setup, blank.knob, taken, rays=len(rays.p))


def _turning(rays: Beam) -> Float[np.ndarray, "n 3 2"]:
    return np.stack([rays.dd_dx, rays.dd_dy], axis=2)


def _rays(beam: Beam) -> Rays:
    return Rays(beam.p, beam.d, beam.dp_dx, beam.dp_dy, beam.dd_dx, beam.dd_dy)
