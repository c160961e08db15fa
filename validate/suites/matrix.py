"""Kernel x resolution x engine x precision: footprints on a page, seen in a mirror sphere.

In: nothing from the build. The sphere and the page of Galim 2018 are exact shapes, each sampled in a grid of its own,
so that "64" is 64 samples along the sphere. Out: one error run per combination; the exact scene is truth, in closed
form, and pixels near the silhouette stand apart.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product

import numpy as np
from jaxtyping import Bool, Int

from datasets_synthetic import ExactShape, shape
from datasets_synthetic.union import Union
from sdfbake import Grid
from sdfrender import Camera, GridField, Rays, footprint, reflect, transfer
from sdfrender.rays import COLUMNS
from validate.closed import ExactReference
from validate.compare import compare
from validate.experiment import Bench, Run, guarded
from validate.metrics import Seen
from validate.metrics import footprint as jacobians
from validate.views import TEXELS, seen

KERNELS = ("linear", "catmull-rom", "bspline")
RESOLUTIONS = (32, 64, 128)
ENGINES = (("numpy", 64), ("drjit", 64), ("drjit", 32))
SIZE, QUICK = 128, 48  # pixels
PROBLEM = "mirror sphere, one bounce onto the page"
PAGE_RESOLUTION = 64  # it is flat and its texture coordinates are linear: off its border every resolution is exact


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """Rays, what is true at each pixel, which pixels count, and the grid of the page."""

    rays: Rays
    truth: Seen
    among: Bool[np.ndarray, " n"]
    page: Grid


def run(bench: Bench) -> Iterator[Run]:
    """All engines and kernels on one grid at a time."""
    size, resolutions = (QUICK, (64,)) if bench.quick else (SIZE, RESOLUTIONS)
    case = cache(partial(_case, size))
    for n in resolutions:
        bench.progress(f"kernels, engines and precisions, {n}^3")
        sphere = cache(lambda n=n: Grid.from_function(_members()[0], n, uv_mode="none"))
        for (engine, precision), kernel in product(ENGINES, KERNELS):
            setup = {"kernel": kernel, "engine": engine, "precision": str(precision)}
            blank = Run("matrix", PROBLEM, setup, {"resolution": n}, "error")

            def measured(blank: Run = blank, sphere: Callable[[], Grid] = sphere) -> Run:
                return _judged(blank, sphere(), case())

            yield guarded(blank, measured)


def _case(size: int) -> Case:
    """Rays of a camera in front of the page, and what they see of it in the sphere."""
    rays = Camera((0.0, 0.0, 1.9), (0.0, 0.0, 0.0), fov=28.0, size=(size, size)).rays()
    first, second = ExactReference(shape("mirror")).follow(rays, 1)
    truth = seen(second)
    # Charts of the scene are numbered through; the page's grid knows its own.
    truth = replace(truth, chart=np.where(truth.hit, truth.chart - _members()[0].charts, -1))
    among = second.hit & (first.part == 0) & (second.part == 1)
    return Case(rays, truth, among, Grid.from_function(_members()[1], PAGE_RESOLUTION))


def _members() -> tuple[ExactShape, ...]:
    """The sphere and the page of the mirror scene."""
    scene = shape("mirror")
    assert isinstance(scene, Union)
    return scene.members


def _judged(blank: Run, grid: Grid, case: Case) -> Run:
    setup = blank.setup
    sphere, page = (
        GridField(one, setup["kernel"], setup["engine"], int(setup["precision"])) for one in (grid, case.page)
    )
    ours, flags = _mirrored(sphere, page, case.rays)
    side = math.isqrt(len(case.truth.t))
    values = compare(ours, case.truth, (side, side), case.among, flags)
    return replace(blank, values=values | {"spacing": grid.lattice.spacing})


def _mirrored(sphere: GridField, page: GridField, rays: Rays) -> tuple[Seen, Int[np.ndarray, " n"]]:
    """Trace to the sphere, mirror, trace on to the page; hit errors count the page's voxels."""
    hits, at = transfer(sphere, rays)
    hit, mirrored = np.flatnonzero(hits.hit), reflect(sphere, hits, at)
    ended, at = transfer(page, Rays(*(getattr(mirrored, name)[hit] for name in (*COLUMNS, "flags"))))
    prints = footprint(page, ended, at, size=(TEXELS, TEXELS))
    n, count = np.zeros((len(rays), 3)), len(rays)
    t, chart, flags = np.full(count, np.inf), np.full(count, -1), np.zeros(count, np.int64)
    uv, jacobian = np.zeros((count, 2)), np.zeros((count, 2, 2))
    t[hit], n[hit], chart[hit], flags[hit] = ended.t, ended.n, prints.chart, prints.flags
    uv[hit], jacobian[hit] = prints.uv, jacobians(prints.duv_dx, prints.duv_dy, TEXELS)
    return Seen(t, n, uv, jacobian, chart, page.grid.lattice.spacing, float(TEXELS)), flags
