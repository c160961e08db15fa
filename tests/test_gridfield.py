"""Grid fields: jets and texture coordinates against differences, other people's interpolation, and exact shapes."""

import numpy as np
import pytest
from scipy.ndimage import convolve1d, map_coordinates

from datasets_synthetic import shape
from datasets_synthetic.sheet import sheet
from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfbake.bricks import SIDE
from sdfbake.complaint import BadInput
from sdfbake.lattice import Lattice
from sdfrender import GridField, Rays, footprint, trace, transfer
from sdfrender.flags import Flag
from sdfrender.kernels import NAMES

SIZE = (11, 9, 13)


def noise(rng):
    """Random numbers: every brick exists, no direction is like another."""
    return Grid.from_dense(rng.normal(size=SIZE), origin=[-0.7, 0.3, 2.0], spacing=0.25)


def inside_cells(rng, count=400):
    """Grid coordinates whose neighbours at 0.2 lie in the same cell."""
    return rng.integers(0, np.array(SIZE) - 1, (count, 3)) + rng.uniform(0.21, 0.79, (count, 3))


def slope(function, points, spacing, step=0.2):
    """Richardson's central differences along the axes: exact on the cubics that a kernel is within a cell."""
    columns = []
    for axis in np.eye(3) * spacing:
        coarse, fine = (
            (function(points + e * axis) - function(points - e * axis)) / (2 * e * spacing) for e in (step, step / 2)
        )
        columns.append((4 * fine - coarse) / 3)
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_the_value(name, choice, rng):
    """The differences are exact, so what is left is rounding: 3 roundings of the value over the step.

    A value rounds to 200 eps of the largest sample times the kernel's overlap (docs/tracing.md has the count, and the
    B-spline's coefficients are up to (5/3)^3 = 4.6 times the samples); a derivative's weights are 4 times as large.
    """
    grid = noise(rng)
    field, h = GridField(grid, name, choice), grid.lattice.spacing
    points = grid.lattice.to_world(inside_cells(rng))
    value, gradient, hessian = field.jet(points)
    rounding = 200 * choice.engine.eps * 4.6 * np.abs(grid.distance).max() * field.kernel.overlap**3
    by_value = slope(lambda p: field.jet(p, 0)[0], points, h)
    by_gradient = slope(lambda p: field.jet(p, 1)[1], points, h)
    assert np.abs(gradient - by_value).max() < 3 * rounding / (0.2 * h)
    assert np.abs(hessian - by_gradient).max() < 12 * rounding / (0.2 * h * h)
    assert np.abs(gradient).max() > 1 and (name == "linear" or np.abs(np.diagonal(hessian, 0, 1, 2)).max() > 1)
    assert np.array_equal(value, field.jet(points, 0)[0])


@pytest.mark.parametrize("name", NAMES)
def test_values_are_those_of_another_interpolation(name, rng):
    """SciPy's splines on the same coefficients, at points whose stencils lie in the lattice."""
    grid = noise(rng)
    at = rng.uniform(2.01, np.array(SIZE) - 3.01, (500, 3))
    dense = grid.to_dense().astype(float)
    if name == "catmull-rom":  # SciPy has none: the mean of the two parabolas through three samples each, per axis
        expected = catmull_rom(dense, at)
    else:
        for axis in range(3) if name == "bspline" else ():
            dense = convolve1d(dense, np.array([-1, 8, -1]) / 6, axis=axis)
        expected = map_coordinates(dense, at.T, order=3 if name == "bspline" else 1, prefilter=False)
    value = GridField(grid, name, "numpy").jet(grid.lattice.to_world(at), 0)[0]
    # Positions round to 1e-15 of 3 units, that is 1e-14 cells, over slopes of up to 10 per cell.
    assert np.abs(value - expected).max() < 2e-13


def catmull_rom(dense, at):
    """Blend the parabolas left and right of a cell, axis by axis."""
    cell = np.floor(at).astype(int)
    u = at - cell

    def blend(a, b, c, d, t):
        left = b + t * (c - a) / 2 + t * t * (a - 2 * b + c) / 2
        right = b + t * (c - b) - t * (1 - t) * (b - 2 * c + d) / 2
        return (1 - t) * left + t * right

    def value(i, j, k):
        return dense[cell[:, 0] + i, cell[:, 1] + j, cell[:, 2] + k]

    offsets = (-1, 0, 1, 2)
    planes = [[blend(*(value(i, j, k) for k in offsets), u[:, 2]) for j in offsets] for i in offsets]
    return blend(*(blend(*plane, u[:, 1]) for plane in planes), u[:, 0])


@pytest.mark.parametrize("name", NAMES)
def test_sparse_equals_dense_near_the_surface(name, directions):
    """Half a voxel off the surface every stencil is complete: nothing but the stored samples decides."""
    exact = shape("torus")
    grid = Grid.from_function(exact, 40, uv_mode="none")
    lattice = grid.lattice
    index = np.stack(np.meshgrid(*(np.arange(n) for n in lattice.shape), indexing="ij"), axis=-1)
    everywhere = exact.distance(lattice.to_world(index).reshape(-1, 3)).reshape(lattice.shape)
    dense = Grid.from_dense(everywhere.astype(np.float32), origin=lattice.origin, spacing=lattice.spacing)
    assert len(grid.bricks) < grid.bricks.slot.size
    feet = directions * [1.1, 1.1, 0.4]
    feet = feet - exact.distance(feet)[:, None] * exact.normal(feet)
    points = feet + 0.5 * lattice.spacing * exact.normal(feet) * np.linspace(-1, 1, len(feet))[:, None]
    for ours, theirs in zip(
        GridField(grid, name, "numpy").jet(points), GridField(dense, name, "numpy").jet(points), strict=True
    ):
        assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("name", NAMES)
def test_far_away_there_is_a_bound_and_no_slope(name, choice, rng, sphere):
    grid = Grid.from_function(sphere, 64, uv_mode="none")
    field = GridField(grid, name, choice)
    low, high = grid.lattice.bounds
    points = rng.uniform(low, high, (4000, 3))
    brick = np.minimum(grid.lattice.to_grid(points).astype(int), np.array(grid.lattice.shape) - 2) // SIDE
    absent = grid.bricks.slot[tuple(brick.T)] < 0
    assert 0.1 < absent.mean() < 0.9
    value, gradient, hessian = (entry[absent] for entry in field.jet(points))
    assert np.array_equal(value, grid.bricks.far[tuple(brick[absent].T)])
    truth = sphere.distance(points[absent])
    # The bound is stored rounded down; its own sign is the truth's.
    assert (np.sign(value) == np.sign(truth)).all() and (np.abs(value) <= np.abs(truth)).all()
    assert not gradient.any() and not hessian.any()
    for entry in field.jet(rng.uniform(-9, 9, (2000, 3))):
        assert np.isfinite(entry).all()


@pytest.mark.parametrize("name", NAMES)
def test_affine_texture_coordinates_come_back(name, choice, rng):
    """The front of the sheet has u = (x + 1) / 2, v = (y + 1) / 2, which every kernel reproduces.

    Coordinates are stored to half a float32 unit, 6e-8 at 1; overlaps of up to 2, and prefilters of (5/3)^3, make 3e-7
    of it. Positions add their own rounding, 100 units in the last place; gradients have weights of 4 per spacing.
    """
    grid = Grid.from_function(sheet((2.0, 2.0), 0.6), 48)  # thick: the stencils must not see the back's coordinates
    field = GridField(grid, name, choice)
    points = np.append(rng.uniform(-0.6, 0.6, (300, 2)), rng.uniform(-0.02, 0.02, (300, 1)), axis=1)
    uv, gradient, chart = field.uv(points)
    rounding = 3e-7 + 100 * choice.engine.eps
    assert np.abs(uv - (points[:, :2] + 1) / 2).max() < rounding
    expected = np.zeros((2, 3))
    expected[0, 0] = expected[1, 1] = 0.5
    assert np.abs(gradient - expected).max() < 4 * rounding / grid.lattice.spacing
    assert len(set(chart.tolist())) == 1


def test_charts_and_seams_are_those_of_the_stencil(choice, directions, sphere):
    """A chart is the nearest sample's; a seam is where the samples behind the cell's coefficients disagree: -2 to 3."""
    grid = Grid.from_function(sphere, 32)
    field = GridField(grid, "bspline", choice)
    rays = Rays(directions * 2, -directions, *(np.zeros_like(directions) for _ in range(4)))
    hits, moved = transfer(field, rays)
    seen = footprint(field, hits, moved)
    at = grid.lattice.to_grid(hits.p)
    clear = np.abs(at - np.round(at)).max(axis=1) < 0.5 - 1e-4  # which sample is nearest, and which cell, is settled
    clear &= np.abs(at - np.round(at)).min(axis=1) > 1e-4
    nearest = sphere.chart(grid.lattice.to_world(np.round(at)))
    stencil = np.stack([sphere.chart(grid.lattice.to_world(np.floor(at) + c - 2.0)) for c in np.ndindex(6, 6, 6)])
    seam = (stencil != stencil[0]).any(axis=0)
    assert clear.mean() > 0.9 and 0.05 < seam.mean() < 0.95
    assert np.array_equal(seen.chart[clear], nearest[clear])
    assert np.array_equal((seen.flags[clear] & Flag.SEAM) > 0, seam[clear])
    assert np.array_equal(field.uv(hits.p)[2][clear], nearest[clear])


def test_parts_are_named_and_found(choice):
    exact = shape("mirror")
    grid = Grid.from_function(exact, 48, uv_mode="none")
    field = GridField(grid, "bspline", choice)
    assert field.part_names == ("sphere", "sheet")
    hits = trace(
        field, np.array([[0.0, 0, 1.5], [0.0, 0, 1.5], [0.0, 5, 1.5]]), np.array([[0.0, 0, -1], [0, 0, 1], [0, 1, 0]])
    )
    assert hits.part.tolist() == [0, 1, -1]


def test_a_grid_without_texture_coordinates_says_so(sphere):
    field = GridField(Grid.from_function(sphere, 24, uv_mode="none"), engine="numpy")
    with pytest.raises(BadInput, match="no texture coordinates.*--uv-mode grid"):
        field.uv(np.zeros((1, 3)))


def test_a_box_need_not_be_a_cube(choice, directions):
    """The torus' lattice is flat; positions, gradients and curvatures on it are the torus'."""
    exact = shape("torus")
    grid = Grid.from_function(exact, 48, uv_mode="none")
    assert len(set(grid.lattice.shape)) > 1
    field = GridField(grid, "bspline", choice)
    feet = directions * [1.1, 1.1, 0.4]
    feet = feet - exact.distance(feet)[:, None] * exact.normal(feet)
    value, gradient, hessian = field.jet(feet)
    h = grid.lattice.spacing  # 0.054, the tube's radius is 5.6 of it: errors of h^4, h^3, h^2 times curvatures' powers
    assert np.abs(value).max() < 2e-2 * h
    assert np.abs(gradient - exact.normal(feet)).max() < 2e-2
    assert np.median(np.abs(hessian - exact.hessian(feet))) < 2e-2 / 0.3


@pytest.mark.parametrize("scale", [2.0**-20, 2.0**20], ids=["1e-6", "1e6"])
def test_scale_and_place_change_nothing(scale, choice, directions):
    """A power of two scales every stored number exactly; a thousand units of offset round positions to 1e-13.

    Positions are taken relative to the lattice in float64, so float32 keeps its own rounding, that of 48 samples.
    """
    here = GridField(Grid.from_function(Sphere(0.8), 48, uv_mode="none"), "bspline", choice)
    lattice, offset = here.grid.lattice, scale * np.array([1e3, -1e3, 1e3])
    there = Lattice(lattice.origin * scale + offset, lattice.spacing * scale, lattice.shape)
    grid = Grid.from_dense(here.grid.to_dense() * np.float32(scale), origin=there.origin, spacing=there.spacing)
    field = GridField(grid, "bspline", choice)
    near, far = trace(here, directions * 1.2, -directions), trace(field, directions * 1.2 * scale + offset, -directions)
    rounding = 64 * 48 * choice.engine.eps * lattice.spacing + 1e-12
    assert near.hit.all() and np.array_equal(near.hit, far.hit)
    assert np.abs(near.t - far.t / scale).max() < rounding
    jets = here.jet(near.p), field.jet(near.p * scale + offset)
    for order, (a, b) in enumerate(zip(*jets, strict=True)):
        assert np.abs(a - b * scale ** (order - 1)).max() < rounding * (4 / lattice.spacing) ** order


@pytest.mark.parametrize(("name", "problem"), [("cubic", "kernel"), ("bspline", "engine")])
def test_unknown_kernels_and_engines(name, problem, sphere):
    grid = Grid.from_function(sphere, 24, uv_mode="none")
    with pytest.raises(BadInput, match=f"there is no {problem}"):
        GridField(grid, name, "cuda" if problem == "engine" else "numpy")
