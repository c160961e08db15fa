"""The orders that kernels claim, on exact shapes; and that the pointwise route is the field's own interpolant."""

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.lattice import Lattice
from sdfrender import GridField
from sdfrender.kernels import NAMES, kernel
from validate.experiment import Bench, Run
from validate.metrics import fitted_order
from validate.pointwise import jets
from validate.sections import convergence as written
from validate.sections.convergence import EXPECTED, WITHIN, orders
from validate.suites import convergence
from validate.suites.convergence import on_sphere, shape_operator

POINTS = 600


def on_surface(exact, rng, count=POINTS):
    """Points of a surface, by Newton's steps along the normal."""
    p = rng.uniform(*exact.bounds, size=(count, 3))
    for _ in range(4):
        p = p - exact.distance(p)[:, None] * exact.normal(p)
    return p


def sweep(exact, name, points, resolutions):
    """Root-mean-square errors of value, gradient and shape operator, and spacings."""
    errors, spacings = [], []
    truth = exact.hessian(points)
    for n in resolutions:
        lattice = Lattice.around(exact.bounds, n)
        value, gradient, hessian = jets(exact.distance, lattice, kernel(name), points)
        parts = (
            value - exact.distance(points),
            np.linalg.norm(gradient - exact.normal(points), axis=1),
            np.linalg.norm(shape_operator(gradient, hessian) - truth, axis=(1, 2)),
        )
        errors.append([float(np.sqrt(np.mean(part**2))) for part in parts])
        spacings.append(lattice.spacing)
    return np.array(errors), np.array(spacings)


@pytest.mark.parametrize("name", NAMES)
def test_orders_on_the_sphere_up_to_512(name, rng) -> None:
    """Fitted over 128, 256, 512: coarser than that the B-spline's gradient, of order 3 with a small factor, still shows
    its next term, of order 4. Samples are float64, whose rounding of 1e-16 / h^2 stays below 1e-5 of the Hessian's
    error; the points are random, so that no symmetry of the lattice flatters them."""
    ball = shape("sphere")
    errors, spacings = sweep(ball, name, on_sphere(ball, POINTS, rng), (128, 256, 512))
    for column, expected in zip(errors.T, EXPECTED[name], strict=True):
        assert fitted_order(spacings, column) == pytest.approx(expected, abs=WITHIN)


@pytest.mark.parametrize("name", NAMES)
def test_orders_on_the_torus_where_they_have_settled(name, rng) -> None:
    """The torus is bent more: its tube is 0.3 of 2 across, so orders settle later, at 512 to 2048."""
    torus = shape("torus")
    errors, spacings = sweep(torus, name, on_surface(torus, rng), (512, 1024, 2048))
    for column, expected in zip(errors.T, EXPECTED[name], strict=True):
        assert fitted_order(spacings, column) == pytest.approx(expected, abs=WITHIN)


@pytest.mark.parametrize("name", NAMES)
def test_errors_shrink_from_16_to_512_as_orders_promise(name, rng) -> None:
    """Whatever the course in between: over 5 halvings, the whole sweep gains at least the order, less half an order."""
    ball = shape("sphere")
    errors, spacings = sweep(ball, name, on_sphere(ball, POINTS, rng), (16, 512))
    gained = np.log(errors[0] / errors[1]) / np.log(spacings[0] / spacings[1])
    assert (gained > np.array(EXPECTED[name]) - 0.5).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_pointwise_route_is_the_field_on_a_grid(name, rng) -> None:
    torus = shape("torus")
    points = on_surface(torus, rng, 300)
    grid = Grid.from_function(torus, 48, uv_mode="none")
    field = GridField(grid, name, engine="numpy")
    ours, theirs = jets(torus.distance, grid.lattice, kernel(name), points), field.jet(points)
    # Samples within 6 voxels round by 6 h eps / 2 in float32; weights of the prefiltered kernel sum to 8 in magnitude
    # per derivative and axis at most, and every derivative divides by h.
    h = grid.lattice.spacing
    for order, (mine, other) in enumerate(zip(ours, theirs, strict=True)):
        assert np.abs(mine - other).max() < 3 * np.finfo(np.float32).eps * h ** (1 - order) * 8.0


def test_polynomials_come_back() -> None:
    """A cubic through the B-spline, with all its derivatives, to the rounding of 216 products."""
    lattice = Lattice(np.array([0.1, -0.3, 0.2]), 0.5, (9, 9, 9))

    def cubic(p):
        x, y, z = p.T
        return x**3 - 2 * x * y * z + y**2 * z - 3 * z + 1

    points = np.random.default_rng(3).uniform(0.3, 3.5, (50, 3))
    x, y, z = points.T
    value, gradient, hessian = jets(cubic, lattice, kernel("bspline"), points)
    np.testing.assert_allclose(value, cubic(points), atol=1e-11)
    np.testing.assert_allclose(gradient[:, 0], 3 * x**2 - 2 * y * z, atol=1e-11)
    np.testing.assert_allclose(gradient[:, 2], -2 * x * y + y**2 - 3, atol=1e-11)
    np.testing.assert_allclose(hessian[:, 0, 0], 6 * x, atol=1e-10)
    np.testing.assert_allclose(hessian[:, 1, 2], -2 * x + 2 * y, atol=1e-10)
    np.testing.assert_allclose(hessian, np.swapaxes(hessian, 1, 2), atol=1e-10)


def test_the_suite_sweeps_both_kinds_of_samples(tmp_path) -> None:
    runs = list(convergence.run(Bench(tmp_path, tmp_path, quick=True)))
    assert all(run.ok for run in runs) and len(runs) == 3 * 3 * 2
    by = {(run.setup["kernel"], "samples" in run.setup, run.knob["resolution"]): run.values for run in runs}
    # Other points of the same sphere, and float32 rounding, which at 64 is far off: medians of 4,000 agree to 10 %.
    for name in NAMES:
        exact, stored = (by[name, samples, 64]["shape_operator.p50"] for samples in (True, False))
        assert exact == pytest.approx(stored, rel=0.1)


def made_up(factor: float = 1.0) -> list[Run]:
    """Errors of the expected orders on float64 samples, the B-spline's gradient times `factor` per halving."""
    runs = []
    for name, theory in EXPECTED.items():
        for k, n in enumerate((128, 256, 512)):
            values = {
                f"{q}.p50": 0.5 ** (k * order) for (q, _, _), order in zip(written.QUANTITIES, theory, strict=True)
            }
            values |= {"spacing": 2.0 / n}
            if name == "bspline":
                values["gradient.p50"] *= factor**k
            runs.append(
                Run("convergence", "sphere", {"kernel": name, "samples": "float64"}, {"resolution": n}, "error", values)
            )
            runs.append(
                Run(
                    "convergence",
                    "sphere",
                    {"kernel": name},
                    {"resolution": n},
                    "error",
                    values | {"shape_operator.p50": 1.0},
                )
            )
    return runs


def test_findings_follow_the_orders() -> None:
    section = written.section(made_up())
    assert "bspline: fitted orders 4.00, 3.00, 2.00" in section.finding[2] and "within 0.2" in section.finding[2]
    assert section.headlines[0].figure == "0" or float(section.headlines[0].figure) < 1e-9
    off = {"bspline": [run for run in made_up(2.0**-0.5) if run.setup == {"kernel": "bspline", "samples": "float64"}]}
    (said,), (line,) = written._methods(off), written._method_headlines(off)
    assert "bspline: fitted orders 4.00, 3.50, 2.00" in said and "off by up to 0.50" in said
    assert line.figure == "0.5"
    # Stored samples are 16 times worse at the finest, 0.5^(2 * 2) against 1.
    assert "16 times as much" in section.finding[3]
    assert orders([run for run in made_up() if run.setup.get("samples") and run.setup["kernel"] == "linear"])[2] == 0.0
