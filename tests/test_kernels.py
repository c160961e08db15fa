"""Kernels: the algebra they must satisfy, and the orders that they claim."""

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.complaint import BadInput
from sdfbake.lattice import Lattice
from sdfrender import GridField
from sdfrender.kernels import NAMES, Kernel, catmull_rom, kernel


@pytest.mark.parametrize("name", NAMES)
def test_derivative_weights_sum_to_zero(name):
    k = kernel(name)
    for order in (1, 2):
        assert np.abs(k.derivative(order).sum(axis=0)).max() < 1e-14


@pytest.mark.parametrize("name", NAMES)
def test_bezier_form_is_the_same_curve(name):
    k = kernel(name)
    t = np.linspace(0, 1, 7)[:, None]
    powers = t ** np.arange(k.degree + 1)
    from math import comb

    bernstein = np.array([comb(k.degree, r) for r in range(k.degree + 1)])
    bernstein = bernstein * t ** np.arange(k.degree + 1) * (1 - t) ** np.arange(k.degree, -1, -1)
    assert np.abs(powers @ k.weights.T - bernstein @ k.bezier).max() < 1e-15 * 16


def test_catmull_rom_overlap_is_the_known_one():
    """Over its 64 taps f >= 1.477 min - 0.477 max: (1 + tension / 2)^3 = 1.953 = 2 * 0.4766 + 1."""
    assert catmull_rom(0.5).overlap == pytest.approx(1.25, abs=1e-12)
    assert catmull_rom(0.3).overlap == pytest.approx(1.15, abs=1e-12)


def test_a_wrong_kernel_is_refused():
    good = kernel("bspline")
    with pytest.raises(AssertionError, match="sum"):
        Kernel("bad", good.weights * 1.01, good.prefilter, 3)
    with pytest.raises(AssertionError, match="comes back"):
        Kernel("bad", good.weights, (0.0, 1.0, 0.0), 3)


@pytest.mark.parametrize(("name", "tension"), [("cubic", 0.5), ("catmull-rom", 2.0), ("catmull-rom", float("nan"))])
def test_unknown_kernels(name, tension):
    with pytest.raises(BadInput, match="choose"):
        kernel(name, tension)


def sphere_errors(name: str, n: int, points: np.ndarray) -> np.ndarray:
    """Median errors of value, gradient and Hessian at points of the exact sphere, box of half extent 2."""
    grid = Grid.from_function(
        shape("sphere"), lattice=Lattice(np.full(3, -2.0), 4 / (n - 1), (n, n, n)), uv_mode="none"
    )
    # Samples in float64 rather than the stored float32: an order of convergence must not stop at storage.
    value, gradient, hessian = GridField(grid, name, "numpy").jet(points)
    n0 = points / 0.8
    truth = (np.eye(3) - n0[:, :, None] * n0[:, None, :]) / 0.8
    errors = (np.abs(value), np.linalg.norm(gradient - n0, axis=-1), np.linalg.norm(hessian - truth, axis=(1, 2)))
    return np.array([np.median(error) for error in errors])


@pytest.mark.parametrize(
    ("name", "orders"), [("linear", (2, 1, 0)), ("catmull-rom", (3, 2, 1)), ("bspline", (4, 3, 2))], ids=NAMES
)
def test_fitted_orders_of_convergence(name, orders, directions):
    """The orders of the report, fitted over a factor of 3 in spacing, stopping before float32 storage is seen.

    0.2 is the spread that higher-order terms leave on these grids; the next order is a whole 1 away. The B-spline's
    gradient has a third-order term so small that the fourth still shows: 3.7 falling to 3.3 from 64 to 192.
    """
    sizes = [64, 96, 128, 192]
    errors = np.array([sphere_errors(name, n, directions * 0.8) for n in sizes])
    fitted = [-np.polyfit(np.log(np.array(sizes) - 1), np.log(errors[:, i]), 1)[0] for i in range(3)]
    above = np.array([0.2, 0.6 if name == "bspline" else 0.2, 0.2])
    assert (np.array(fitted) > np.array(orders) - 0.2).all(), fitted
    assert (np.array(fitted) < np.array(orders) + above).all(), fitted


def test_shape_operator_of_the_sphere_at_64(directions):
    """The figure that the toolkit promises: a median relative error of at most 5e-4 (Galim 2018 has 2.8e-2)."""
    error = sphere_errors("bspline", 64, directions * 0.8)[2]
    assert error / (np.sqrt(2) / 0.8) < 5e-4
