"""Principal curvatures: closed forms of ball, cavity, torus and cylinder, exact and on grids, with the fitted order."""

import numpy as np
import pytest

from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfrender import GridField, curvature, optics
from sdfrender.field import Jet
from sdfrender.vector import Symmetric
from validate.exact import ShapeField

MAJOR, MINOR = 0.7, 0.3


def torus_points(rng, count=300):
    """Points of the torus with their curvatures: 1 / r around the tube, cos v / (R + r cos v) around the axis."""
    u, v = rng.uniform(0, 2 * np.pi, (2, count))
    reach = MAJOR + MINOR * np.cos(v)
    points = np.stack([reach * np.cos(u), reach * np.sin(u), MINOR * np.sin(v)], axis=1)
    return points, np.cos(v) / reach, np.full(count, 1 / MINOR)


def dense(values, n, engine="numpy"):
    """A function of (x, y, z) on n^3 samples of the box from -1 to 1."""
    axis = np.linspace(-1.0, 1.0, n)
    grid = np.meshgrid(axis, axis, axis, indexing="ij")
    spacing = float(axis[1] - axis[0])
    return GridField(Grid.from_dense(values(*grid), origin=[-1.0] * 3, spacing=spacing), "bspline", engine)


def test_the_exact_torus(rng):
    """Saddle within, dome without; the shape's Hessian has some ten roundings of numbers up to 1 / r."""
    points, least, greatest = torus_points(rng)
    k_min, k_max = curvature(ShapeField(shape("torus")), points)
    assert least.min() < -2 and least.max() > 0.9
    assert np.abs(k_min - least).max() < 1e-12 and np.abs(k_max - greatest).max() < 1e-12


def test_a_ball_is_as_bent_every_way(directions):
    """Equal curvatures keep their digits: a square root of mean^2 - Gauss would leave 1e-8 between them."""
    k_min, k_max = curvature(ShapeField(Sphere(0.8)), 0.8 * directions)
    assert np.abs(k_min - 1.25).max() < 32 * np.finfo(float).eps
    assert (k_max - k_min).max() < 32 * np.finfo(float).eps


def test_a_grid_of_a_ball(choice, directions):
    """The kernel's curvature error at 64 samples, below 1e-3, on every engine; a cavity has the opposite signs."""
    field = GridField(Grid.from_function(Sphere(0.8), 64, uv_mode="none"), "bspline", choice)
    k_min, k_max = curvature(field, 0.8 * directions)
    assert np.abs(k_min - 1.25).max() < 2e-3 and np.abs(k_max - 1.25).max() < 2e-3
    cavity = dense(lambda x, y, z: 0.6 - np.sqrt(x * x + y * y + z * z), 48, choice)
    k_min, k_max = curvature(cavity, 0.6 * directions)
    assert np.abs(k_min + 1 / 0.6).max() < 5e-3 and np.abs(k_max + 1 / 0.6).max() < 5e-3


def test_a_cylinder_whatever_the_gradients_length(rng):
    """0 along, 1 / r around; five times the distance has the same zero set, and the same curvatures."""
    turn, z = rng.uniform(0, 2 * np.pi, 200), rng.uniform(-0.6, 0.6, 200)
    points = np.stack([0.6 * np.cos(turn), 0.6 * np.sin(turn), z], axis=1)
    once, five = (
        curvature(dense(lambda x, y, z, s=scale: s * (np.sqrt(x * x + y * y) - 0.6), 64), points)
        for scale in (1.0, 5.0)
    )
    assert np.abs(once[0]).max() < 1e-3 and np.abs(once[1] - 1 / 0.6).max() < 0.02
    # Float32 samples of up to 1 and 5, over the square of the spacing: 6e-8 / 1e-3, a few taps of them.
    assert np.abs(once[0] - five[0]).max() < 1e-3 and np.abs(once[1] - five[1]).max() < 1e-3


def test_curvature_converges_with_the_grid(rng):
    """Second derivatives of a cubic kernel: order 2, on both curvatures of the torus."""
    points, least, greatest = torus_points(rng)
    sizes = (32, 64, 128)
    fields = [GridField(Grid.from_function(shape("torus"), n, uv_mode="none"), "bspline", "numpy") for n in sizes]
    found = [curvature(field, points) for field in fields]
    spacings = [field.grid.lattice.spacing for field in fields]
    for which, truth in ((0, least), (1, greatest)):
        errors = [np.sqrt(np.mean((pair[which] - truth) ** 2)) for pair in found]
        order = np.polyfit(np.log(spacings), np.log(errors), 1)[0]
        assert 1.7 < order < 2.7, (which, order, errors)


def test_no_gradient_no_curvature(choice):
    """Where the gradient vanishes there is no surface: 0; nor where the grid has no samples."""

    def program(xp, x):
        zero, one = xp.full(x, 0.0), xp.full(x, 1.0)
        jet = Jet(zero, (zero, zero, zero), Symmetric(one, one, one, one, zero, zero))
        least, greatest = optics.curvatures(xp, jet)
        return {"least": least, "greatest": greatest}

    out = choice.engine.run(program, [np.zeros(3)])
    assert not out["least"].any() and not out["greatest"].any()
    field = GridField(Grid.from_function(Sphere(0.8), 64, uv_mode="none"), "bspline", choice)
    assert [k[0] for k in curvature(field, np.zeros((1, 3)))] == [0, 0]


@pytest.mark.parametrize("n", [[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [0, -0.6, -0.8], [0.6, 0.8, -1e-30]], ids=str)
def test_curvatures_are_those_of_the_matrix(n, rng, choice):
    """Any symmetric matrix, any normal: eigenvalues of its projection by NumPy, less the one along the normal."""
    n = np.array(n)
    a = rng.normal(size=(20, 3, 3))
    h = a + a.transpose(0, 2, 1)
    flat = np.eye(3) - np.outer(n, n)
    frame = np.linalg.svd(flat)[0][:, :2]
    expected = np.linalg.eigvalsh(frame.T @ h @ frame) / 2.5

    def program(xp, *c):
        least, greatest = optics.curvatures(xp, Jet(c[0], c[0:3], Symmetric(*c[3:9])))
        return {"least": least, "greatest": greatest}

    entries = [h[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    out = choice.engine.run(program, [*np.broadcast_to(2.5 * n, (20, 3)).T, *entries])
    limit = 64 * choice.engine.eps * np.abs(h).max()
    assert np.abs(out["least"] - expected[:, 0]).max() < limit
    assert np.abs(out["greatest"] - expected[:, 1]).max() < limit
