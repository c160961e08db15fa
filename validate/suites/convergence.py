"""How fast the interpolated field converges: value, gradient and shape operator on the exact sphere.

In: nothing from the build. Out: error runs per kernel and resolution, twice: on float64 samples, each point asking for
its own stencil, which shows the orders of the method (linear 2, 1, 0; Catmull-Rom 3, 2, 1; prefiltered B-spline 4, 3,
2); and on a grid as it is stored, in float32, which shows where their rounding takes over: the B-spline's gradient
reaches it at 256, just as its order settles, so that on stored samples alone no fit of that would mean anything.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np
from jaxtyping import Float

from datasets_synthetic import ExactShape, shape
from sdfbake.grid import Grid
from sdfbake.lattice import Lattice
from sdfrender import GridField
from sdfrender.kernels import kernel
from validate.experiment import Bench, Run, guarded
from validate.metrics import summary
from validate.pointwise import jets

KERNELS = ("linear", "catmull-rom", "bspline")
RESOLUTIONS = (16, 32, 64, 128, 256)
SWEEP = (*RESOLUTIONS, 512)
POINTS, ASKED = 20_000, 4000  # on a grid, and of float64 samples: up to 216 of these for every point

Jets = tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]


def run(bench: Bench) -> Iterator[Run]:
    """Sweep kernels and resolutions."""
    ball = shape("sphere")
    points = on_sphere(ball, POINTS, np.random.default_rng(20))
    for n in SWEEP[:3] if bench.quick else SWEEP:
        bench.progress(f"convergence on the sphere, {n}^3")
        for name in KERNELS:
            stored = Run("convergence", "sphere", {"kernel": name}, {"resolution": n}, "error")
            exact = replace(stored, setup={"kernel": name, "samples": "float64"})
            yield guarded(exact, partial(asked, exact, ball, points[:ASKED]))
            yield guarded(stored, partial(looked_up, stored, ball, points))
    sphere_grid.cache_clear()


@cache
def sphere_grid(resolution: int) -> Grid:
    """The exact sphere, sampled; kept for the kernels, and for the other suites of the same process."""
    return Grid.from_function(shape("sphere"), resolution, uv_mode="none")


def on_sphere(ball: ExactShape, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Points spread evenly over a sphere given by its bounds."""
    low, high = ball.bounds
    d = rng.normal(size=(count, 3))
    return np.asarray((low + high) / 2 + (high - low)[0] / 2 * d / np.linalg.norm(d, axis=1, keepdims=True))


def asked(blank: Run, ball: ExactShape, points: Float[np.ndarray, "n 3"]) -> Run:
    """Errors of the interpolant of float64 samples."""
    lattice = Lattice.around(ball.bounds, int(blank.knob["resolution"]))
    found = jets(ball.distance, lattice, kernel(blank.setup["kernel"]), points)
    return measured(blank, ball, lattice.spacing, points, found)


def looked_up(blank: Run, ball: ExactShape, points: Float[np.ndarray, "n 3"]) -> Run:
    """Errors of a field on a stored grid."""
    grid = sphere_grid(int(blank.knob["resolution"]))
    value, gradient, hessian = GridField(grid, blank.setup["kernel"], precision=64).jet(points)
    return measured(blank, ball, grid.lattice.spacing, points, (value, gradient, hessian))


def measured(blank: Run, ball: ExactShape, spacing: float, points: Float[np.ndarray, "n 3"], found: Jets) -> Run:
    """Errors of value (in the shape's unit), gradient, and shape operator (relative), at points of the surface."""
    value, gradient, hessian = found
    truth = ball.hessian(points)
    operator = shape_operator(gradient, hessian)
    difference = np.linalg.norm(operator - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))
    errors = {
        "value": np.abs(value),
        "gradient": np.linalg.norm(gradient - ball.normal(points), axis=1),
        "shape_operator": difference,
    }
    figures = {f"{name}.{key}": figure for name, error in errors.items() for key, figure in summary(error).items()}
    return replace(blank, values=figures | {"spacing": spacing})


def shape_operator(
    gradient: Float[np.ndarray, "n 3"], hessian: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n 3 3"]:
    """Derivative of the unit normal along the surface: P H P / |g| with P = I - n n^T."""
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    n = gradient / np.where(length > 0, length, 1.0)
    project = np.eye(3) - n[:, :, None] * n[:, None, :]
    return np.asarray(project @ hessian @ project / np.where(length > 0, length, 1.0)[:, :, None])
