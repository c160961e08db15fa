"""Grids of exact shapes and of anybody's numbers, against the shapes and the numbers themselves."""

import numpy as np
import pytest

from sdfbake import BadInput, Grid, Lattice
from sdfbake.bricks import REACH, SIDE, in_lattice, sample_index
from sdfbake.lattice import BAND


class Ball:
    """A ball whose upper half is chart 1 and whose front half is part 1."""

    bounds = np.array([[-1.0, -1, -1], [1, 1, 1]])
    part_names = ("back", "front")

    def distance(self, p):
        return np.linalg.norm(p, axis=-1) - 1

    def uv(self, p):
        return p[:, :2] * 0.5 + 0.5

    def chart(self, p):
        return (p[:, 2] > 0).astype(int)

    def part(self, p):
        return (p[:, 0] > 0).astype(int)


class Plain:
    """A ball with neither charts nor parts."""

    bounds = Ball.bounds

    def distance(self, p):
        return np.linalg.norm(p, axis=-1) - 1

    def uv(self, p):
        return p[:, :2]


@pytest.mark.parametrize("resolution", [16, 33, 64])
def test_samples_are_exact(resolution):
    grid = Grid.from_function(Ball(), resolution)
    points, distance = grid.samples()
    np.testing.assert_array_equal(distance, Ball().distance(points).astype(np.float32))
    every = np.moveaxis(np.indices(grid.lattice.shape), 0, -1)
    true = Ball().distance(grid.lattice.to_world(every))
    assert len(points) == np.count_nonzero(np.abs(true.astype(np.float32)) <= BAND * grid.lattice.spacing)


def test_channels_are_those_of_the_shape():
    grid = Grid.from_function(Ball(), 32)
    inside = in_lattice(grid.bricks.index, grid.lattice.shape) & (np.abs(grid.distance) <= REACH * grid.lattice.spacing)
    p = grid.lattice.to_world(sample_index(grid.bricks.index)[inside])
    np.testing.assert_array_equal(grid.uv[inside], Ball().uv(p).astype(np.float32))
    np.testing.assert_array_equal(grid.chart[inside], Ball().chart(p))
    np.testing.assert_array_equal(grid.part[inside], Ball().part(p))
    assert grid.metadata.parts == ("back", "front") and grid.metadata.charts == 2


def test_samples_beyond_the_lattice_are_zero():
    grid = Grid.from_function(Ball(), 33)
    outside = ~in_lattice(grid.bricks.index, grid.lattice.shape)
    assert outside.any()
    for channel in (grid.distance, grid.uv, grid.chart, grid.part):
        assert (channel[outside] == 0).all()


def test_channels_that_are_not_wanted():
    plain = Grid.from_function(Plain(), 24)
    assert plain.uv is not None and plain.chart is None and plain.part is None and plain.metadata.charts == 1
    bare = Grid.from_function(Ball(), 24, uv_mode="none")
    assert bare.uv is None and bare.chart is None and bare.part is not None and bare.metadata.charts == 0


def test_given_lattice():
    lattice = Lattice(np.array([0.5, 0, 0]), 0.1, (9, 5, 3))
    grid = Grid.from_function(Ball(), lattice=lattice)
    assert grid.lattice is lattice
    assert grid.to_dense().shape == (9, 5, 3)


def test_dense_fill_is_a_signed_bound():
    grid = Grid.from_function(Ball(), 64)
    dense = grid.to_dense()
    true = Ball().distance(grid.lattice.to_world(np.moveaxis(np.indices(dense.shape), 0, -1)))
    near = np.abs(true) <= BAND * grid.lattice.spacing
    np.testing.assert_array_equal(dense[near], true[near].astype(np.float32))
    # float32 rounding of a stored exact value, half a unit in the last place
    assert (np.abs(dense) <= np.abs(true) * (1 + 2.0**-24)).all()
    assert (np.sign(dense) == np.sign(true)).all()


SIZES = [(2, 2, 2), (3, 3, 3), (5, 5, 5), (17, 17, 17), (2, 3, 5), (17, 9, 33), (40, 8, 11)]


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_noise_comes_back_bit_for_bit(size):
    values = np.random.default_rng(1).normal(size=size).astype(np.float32)
    grid = Grid.from_dense(values, origin=(1, 2, 3), spacing=0.25)
    np.testing.assert_array_equal(grid.to_dense(), values)  # noise: every brick is needed
    assert grid.lattice.origin.tolist() == [1, 2, 3] and grid.lattice.spacing == 0.25


def straddling_cells(values):
    """Say, one cell at a time, which cells some kernel's bound lets have a root (float64, no slack)."""
    v = values.astype(np.float64)
    for axis in range(3):  # two more samples on every side, continued linearly
        v = np.moveaxis(v, axis, 0)
        d0, d1 = v[0] - v[1], v[-1] - v[-2]
        v = np.stack([v[0] + 2 * d0, v[0] + d0, *v, v[-1] + d1, v[-1] + 2 * d1])
        v = np.moveaxis(v, 0, axis)
    c = v
    for axis in range(3):
        c = np.apply_along_axis(lambda line: np.convolve(line, [-1 / 6, 8 / 6, -1 / 6], "same"), axis, c)
    cells = []
    for i, j, k in np.ndindex(*(n - 1 for n in values.shape)):
        two = v[i + 2 : i + 4, j + 2 : j + 4, k + 2 : k + 4]
        four = v[i + 1 : i + 5, j + 1 : j + 5, k + 1 : k + 5]
        taps = c[i + 1 : i + 5, j + 1 : j + 5, k + 1 : k + 5]
        over = 0.4765 * (four.max() - four.min())
        bounds = [(two.min(), two.max()), (four.min() - over, four.max() + over), (taps.min(), taps.max())]
        if any(low <= 0 <= high for low, high in bounds):
            cells.append((i, j, k))
    return cells


@pytest.mark.parametrize("size", [(5, 5, 5), (18, 25, 20), (17, 2, 40)], ids=str)
@pytest.mark.parametrize("kind", ["noise", "corner", "edge"])
def test_dense_bricks_cover_every_candidate(size, kind):
    rng = np.random.default_rng(2)
    values = {
        "noise": rng.normal(size=size) + 2.5,
        "corner": np.linalg.norm(np.moveaxis(np.indices(size), 0, -1), axis=-1) - 1.3,
        "edge": np.broadcast_to(np.arange(size[2]) - size[2] + 1.4, size) + rng.normal(size=size) * 0.01,
    }[kind].astype(np.float32)
    grid = Grid.from_dense(values)
    cells = straddling_cells(values)
    assert cells
    expected = np.zeros(size, bool)
    for cell in cells:
        expected[tuple(slice(max(0, i - 2), i + 4) for i in cell)] = True
    needed = np.unique(np.argwhere(expected) // SIDE, axis=0)
    assert (grid.bricks.slot[tuple(needed.T)] >= 0).all()
    # The slack for float32 may add a brick where a bound almost straddles; none does here.
    assert len(needed) == len(grid.bricks)


def test_dense_far_is_the_least_magnitude():
    rng = np.random.default_rng(3)
    values = (np.arange(40.0)[:, None, None] - 20 + rng.uniform(-0.1, 0.1, (40, 8, 8))).astype(np.float32)
    grid = Grid.from_dense(values)
    absent = np.argwhere(grid.bricks.slot < 0)
    assert len(absent)
    for x, y, z in absent:
        block = values[8 * x : 8 * x + 8, 8 * y : 8 * y + 8, 8 * z : 8 * z + 8]
        assert grid.bricks.far[x, y, z] == np.abs(block).min() * np.sign(block[0, 0, 0])


@pytest.mark.parametrize(
    "values",
    [np.zeros((2, 2)), np.zeros((1, 2, 2)), np.full((2, 2, 2), np.nan), np.full((2, 2, 2), 1e300), [["a"]]],
    ids=["flat", "thin", "nan", "beyond float32", "text"],
)
def test_dense_refused(values):
    with pytest.raises(BadInput):
        Grid.from_dense(values)


class Broken(Plain):
    def distance(self, p):
        return np.where(p[:, 0] > 0.95, np.nan, np.linalg.norm(p, axis=-1) - 1)


@pytest.mark.parametrize(
    ("shape", "options", "match"),
    [
        (Plain(), {"resolution": 1}, "resolution 1"),
        (Plain(), {}, "resolution"),
        (Plain(), {"resolution": 32, "uv_mode": "layers"}, "layers"),
        (Broken(), {"resolution": 32}, "NaN"),
    ],
    ids=["resolution 1", "no resolution", "unknown mode", "nan"],
)
def test_function_refused(shape, options, match):
    with pytest.raises(BadInput, match=match):
        Grid.from_function(shape, **options)
