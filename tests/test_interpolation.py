"""Error per brick: filters, orders of convergence, the renderer's own interpolation, and a bake's exact probes."""

import numpy as np
import pytest
from adversarial import ball, box, every_distance, in_pieces

from datasets_synthetic import shape
from sdfbake import Grid, bake
from sdfbake.band import PROBES
from sdfbake.bricks import REACH, SIDE, Bricks, in_lattice, sample_index
from sdfbake.engine import choose
from sdfbake.grid import KERNELS
from sdfbake.interpolation import brick_errors, taps
from sdfbake.lattice import Lattice
from sdfrender import GridField
from sdfrender.kernels import kernel

HALF_CELL = 3**0.5 / 2
# Sums of 216 products in single precision: each rounds the sum by 2^-24 of the largest sample, the reach, times the
# sum of the weights' magnitudes, at most (1 + 1/8)^3 < 2 for Catmull-Rom and (1.7)^3 < 5 for the B-spline.
ROUNDING = 216 * 2.0**-24 * REACH * 5


def probes(grid):
    """Positions (k, 4, 4, 4, p, 3) in the cells whose first samples are even, and which cells lie in the lattice."""
    first = np.moveaxis(np.indices((4, 4, 4)), 0, -1) * 2
    at = grid.bricks.index[:, None, None, None].astype(int) * SIDE + first
    places = at[..., None, :] + np.array(PROBES)[:, None]
    return grid.lattice.to_world(places), (at + 1 < grid.lattice.shape).all(axis=-1)


def with_surface(grid, distance):
    """Exact distances at the probes of cells that may hold surface, by their centres; NaN at others."""
    p, inside = probes(grid)
    exact = distance(p.reshape(-1, 3)).reshape(p.shape[:-1])
    cell = inside & (np.abs(exact[..., PROBES.index(0.5)]) <= HALF_CELL * grid.lattice.spacing)
    return np.where(cell[..., None], exact, np.nan).astype(np.float32)


@pytest.mark.parametrize("t", [*PROBES, 0.9])
@pytest.mark.parametrize("name", KERNELS)
def test_filters_are_the_kernels_at_a_place(name, t):
    """Weights there, after the prefilter's taps."""
    source = kernel(name)
    weights = t ** np.arange(source.weights.shape[1]) @ source.weights.T
    a, b, c = source.prefilter
    expected = np.zeros(6)
    for n, weight in enumerate(weights):
        place = n + source.first + 2
        expected[place] += weight * b
        if (a, c) != (0, 0):
            expected[place - 1] += weight * a
            expected[place + 1] += weight * c
    np.testing.assert_allclose(taps(name, t), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("resolution", [24, 45])
def test_errors_are_those_of_the_renderers_interpolation(choice, resolution):
    exact = shape("torus")
    grid = Grid.from_function(exact, resolution, uv_mode="none")
    centre = with_surface(grid, exact.distance)
    errors = brick_errors(choice.engine, grid.bricks, grid.distance, centre, grid.lattice.spacing)
    slot, *_ = np.nonzero(~np.isnan(centre))
    points = probes(grid)[0][~np.isnan(centre)]
    for column, name in enumerate(KERNELS):
        value = GridField(grid, name).jet(points, 0)[0]
        off = np.abs(value - centre[~np.isnan(centre)]) / grid.lattice.spacing
        expected = np.zeros(len(grid.bricks))
        np.maximum.at(expected, slot, off)
        assert np.abs(errors[:, column] - expected).max() <= ROUNDING
        assert (errors[expected == 0, column] == 0).all()
    assert errors.dtype == np.float32 and (errors.max(axis=0) > 1e-4).all()


ORDERS = {"linear": 2, "catmull-rom": 3, "bspline": 4}


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_orders_of_convergence(name):
    """World errors fall as a power of the spacing; fitted before single precision's rounding shows."""
    exact = shape(name)
    spacings, typical = [], []
    for resolution in (28, 36, 48, 64):
        lattice = Lattice.around(exact.bounds, resolution)
        grid = Grid.from_function(exact, lattice=lattice, uv_mode="none")
        centre = with_surface(grid, exact.distance)
        errors = brick_errors(choose("numpy", 64).engine, grid.bricks, grid.distance, centre, lattice.spacing)
        # A root mean square over bricks with surface: the maximum jumps with the lattice's place.
        typical.append(np.sqrt((errors[errors.max(axis=1) > 0] ** 2).mean(axis=0)) * lattice.spacing)
        spacings.append(lattice.spacing)
    for column, kernel_name in enumerate(KERNELS):
        slope = np.polyfit(np.log(spacings), np.log(np.array(typical)[:, column]), 1)[0]
        if (name, kernel_name) == ("torus", "catmull-rom"):  # terms of order 4 are as large as those of order 3 still
            assert 3 <= slope <= 4
        else:
            assert slope == pytest.approx(ORDERS[kernel_name], abs=0.3)


@pytest.mark.parametrize("mesh", [ball(3), box(1.0, 0.7, 0.4, turned=True)], ids=["ball", "box"])
def test_a_bake_compares_with_exact_distances(mesh):
    """Probes by brute force instead of the baker's lists."""
    grid = bake(mesh, 28, engine="auto")
    p, inside = probes(grid)
    exact = in_pieces(lambda q: every_distance(mesh, q).min(axis=1), p.reshape(-1, 3), 500).reshape(p.shape[:-1])
    cell = inside & (exact[..., PROBES.index(0.5)] <= HALF_CELL * grid.lattice.spacing)
    cell = np.repeat(cell[..., None], len(PROBES), axis=-1)
    for column, name in enumerate(KERNELS):
        value = np.abs(GridField(grid, name).jet(p[cell], 0)[0])
        expected = np.zeros(len(grid.bricks))
        np.maximum.at(expected, np.nonzero(cell)[0], np.abs(value - exact[cell]) / grid.lattice.spacing)
        assert np.abs(grid.error[:, column] - expected).max() <= ROUNDING
    assert (grid.error.max(axis=0) > 0.01).all()


def test_bricks_without_surface_have_no_error(choice):
    grid = Grid.from_function(shape("sphere"), 32, uv_mode="none")
    none = np.full((len(grid.bricks), 4, 4, 4, len(PROBES)), np.nan, np.float32)
    errors = brick_errors(choice.engine, grid.bricks, grid.distance, none, grid.lattice.spacing)
    assert errors.shape == (len(grid.bricks), 3) and (errors == 0).all()
    none[5, 1, 2, 3] = 100.0
    errors = brick_errors(choice.engine, grid.bricks, grid.distance, none, grid.lattice.spacing)
    assert np.flatnonzero(errors.any(axis=1)).tolist() == [5] and (errors[5] > 10).all()


@pytest.mark.parametrize("degree", [1, 3])
def test_polynomials_are_reproduced(choice, degree):
    """Linear ones by all kernels, cubics by the B-spline: what is left is rounding."""
    lattice = Lattice(np.zeros(3), 1.0, (40, 40, 40))
    index = np.moveaxis(np.indices((5, 5, 5)), 0, -1).reshape(-1, 3).astype(np.int32)

    def cubic(p):
        x, y, z = np.moveaxis((p - 20) / 20, -1, 0)
        return x + 0.5 * y - z + (0 if degree == 1 else x**3 - 2 * y**3 + x * y * z + x * x * z)

    bricks = Bricks.of(np.ones((5, 5, 5), bool), np.zeros((5, 5, 5), np.float32))
    distance = cubic(sample_index(index).astype(float)).astype(np.float32)
    centre = np.full((125, 4, 4, 4, len(PROBES)), np.nan, np.float32)
    middle = (index > 0).all(axis=1) & (index < 4).all(axis=1)  # whole stencils
    at = index[middle][:, None, None, None].astype(int) * SIDE + np.moveaxis(np.indices((4, 4, 4)), 0, -1) * 2
    centre[middle] = np.abs(cubic(at[..., None, :] + np.array(PROBES)[:, None]))
    assert in_lattice(index, lattice.shape).all()
    errors = brick_errors(choice.engine, bricks, distance, centre, 1.0)
    rounding = 216 * 2.0**-24 * 7 * 5  # samples are at most 7 here
    assert errors[:, 2].max() <= rounding
    assert degree == 3 or errors[:, 1].max() <= rounding
    assert (errors[:, 0].max() <= rounding) == (degree == 1)
