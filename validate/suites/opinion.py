"""A second opinion on baked grids: Open3D's distance and sign at samples of the exact band.

In: build/meshes/NAME.ply and build/grids/NAME@N.zarr.zip. Out: one error run per grid.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdfbake.grid import Grid
from sdfbake.mesh import Mesh
from validate.experiment import Bench, Run, guarded
from validate.metrics import summary
from validate.opinion import signed_distance

NAMES = ("torus", "mirror", "bunny")
RESOLUTIONS = (64, 512)
SAMPLES = 100_000
# Open3D's float32 in the unit box: a sample nearer to the surface than this, relative to the box, has no certain sign.
CERTAIN = 2e-6


def run(bench: Bench) -> Iterator[Run]:
    """Ask about every grid."""
    for name in NAMES:
        mesh = Mesh.load(bench.mesh(name))
        for resolution in RESOLUTIONS:
            bench.progress(f"Open3D's opinion on {name}, {resolution}^3")
            grid = Grid.load(bench.grid(name, resolution), channels={"distance"})
            blank = Run("opinion", name, {"peer": "Open3D"}, {"resolution": resolution}, "error")
            yield guarded(blank, partial(_judged, blank, mesh, grid))


def _judged(blank: Run, mesh: Mesh, grid: Grid) -> Run:
    points, distance = grid.samples()
    if len(points) > SAMPLES:
        chosen = np.random.default_rng(7).choice(len(points), SAMPLES, replace=False)
        points, distance = points[chosen], distance[chosen]
    other = signed_distance(mesh, points)
    certain = np.abs(other) > CERTAIN * float(np.ptp(mesh.bounds, axis=0).max()) / 2
    values = {
        "samples": float(len(points)),
        "wrong_sign": float(np.sum((distance < 0)[certain] != (other < 0)[certain])),
    }
    apart = np.abs(np.abs(distance) - np.abs(other)) / grid.lattice.spacing
    values |= {f"distance.{name}": figure for name, figure in summary(apart).items()}
    return replace(blank, values=values)
