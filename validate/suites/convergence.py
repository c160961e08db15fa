"""How fast the interpolated field converges: value, gradient and shape operator on the exact sphere.

In: nothing from the build. Out: one error run per kernel and resolution. Expected orders: linear 2, 1, 0; Catmull-Rom
3, 2, 1; prefiltered B-spline 4, 3, 2.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np
from jaxtyping import Float

from datasets_synthetic import ExactShape, shape
from sdfbake.grid import Grid
from sdfrender import GridField
from validate.experiment import Bench, Run, guarded
from validate.metrics import summary

KERNELS = ("linear", "catmull-rom", "bspline")
RESOLUTIONS = (16, 32, 64, 128, 256)
POINTS = 20_000


def run(bench: Bench) -> Iterator[Run]:
    """Sweep kernels and resolutions."""
    ball = shape("sphere")
    points = on_sphere(ball, POINTS, np.random.default_rng(20))
    for resolution in RESOLUTIONS:
        bench.progress(f"convergence on the sphere, {resolution}^3")
        grid = sphere_grid(resolution)
        for kernel in KERNELS:
            blank = Run("convergence", "sphere", {"kernel": kernel}, {"resolution": resolution}, "error")
            yield guarded(blank, partial(measured, blank, ball, grid, points))


@cache
def sphere_grid(resolution: int) -> Grid:
    """The exact sphere, sampled; kept for the other suites of the same process."""
    return Grid.from_function(shape("sphere"), resolution, uv_mode="none")


def on_sphere(ball: ExactShape, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Points spread evenly over a sphere given by its bounds."""
    low, high = ball.bounds
    d = rng.normal(size=(count, 3))
    return np.asarray((low + high) / 2 + (high - low)[0] / 2 * d / np.linalg.norm(d, axis=1, keepdims=True))


def measured(blank: Run, ball: ExactShape, grid: Grid, points: Float[np.ndarray, "n 3"]) -> Run:
    """Errors of value (in the shape's unit), gradient, and shape operator (relative), at points of the surface."""
    value, gradient, hessian = GridField(grid, blank.setup["kernel"], engine="numpy").jet(points)
    truth = ball.hessian(points)
    operator = shape_operator(gradient, hessian)
    difference = np.linalg.norm(operator - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))
    errors = {
        "value": np.abs(value),
        "gradient": np.linalg.norm(gradient - ball.normal(points), axis=1),
        "shape_operator": difference,
    }
    figures = {f"{name}.{key}": figure for name, error in errors.items() for key, figure in summary(error).items()}
    figures["spacing"] = grid.lattice.spacing
    return replace(blank, values=figures)


def shape_operator(
    gradient: Float[np.ndarray, "n 3"], hessian: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n 3 3"]:
    """Derivative of the unit normal along the surface: P H P / |g| with P = I - n n^T."""
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    n = gradient / np.where(length > 0, length, 1.0)
    project = np.eye(3) - n[:, :, None] * n[:, None, :]
    return np.asarray(project @ hessian @ project / np.where(length > 0, length, 1.0)[:, :, None])
