"""Slabs and occupied cells: certificates against values sampled inside the cells."""

from typing import NamedTuple

import numpy as np
import pytest

from sdfbake import Grid
from sdfbake.bricks import SIDE
from sdfbake.engine import choose
from sdfrender.kernels import NAMES, kernel
from sdfrender.slabs import slabs
from sdfrender.stencils import Blocks, stencils, width


def noise(rng, offset=0.0):
    return Grid.from_dense(rng.normal(size=(11, 18, 9)) + offset)


class Made(NamedTuple):
    """Coefficients and complete cells, cell by cell; see `Stencils`."""

    coefficients: np.ndarray
    complete: np.ndarray


class Found(NamedTuple):
    """Slabs as NumPy arrays; see `Slabs`."""

    cell: np.ndarray
    plane: np.ndarray
    delta: np.ndarray
    largest: np.ndarray


def prepared(grid: Grid, name: str, choice=None, margin: float = 0.0) -> tuple[Made, Found]:
    xp, k = (choice or choose("numpy")).engine, kernel(name)
    blocks = Blocks.of(xp, grid.bricks, grid.lattice.shape)
    made = stencils(xp, grid.distance, blocks, k)
    reach = np.full(blocks.size, np.abs(np.array(made.coefficients)).max(), float)
    found = slabs(xp, made, blocks, k, reach, np.full(blocks.size, margin))
    bits = np.array(made.complete).astype(np.uint8).reshape(-1, 8, 8, 1)
    coefficients = np.array(made.coefficients).reshape(-1, *[width(k)] * 3)
    assert coefficients.dtype == (np.float64 if xp.precision == 64 else np.float32)
    n = found.size
    arrays = np.array(found.cell), np.array(found.plane).reshape(-1, 4), np.array(found.delta)
    cell, plane, delta = (array[:n].astype(kind) for array, kind in zip(arrays, (int, float, float), strict=True))
    whole = np.unpackbits(bits, axis=-1, bitorder="little").astype(bool)
    return Made(coefficients, whole), Found(cell, plane, delta, found.largest)


def values(made: Made, name: str, cell, u):
    """The interpolant in cells (n,) at places (m, 3), the same in each."""
    k = kernel(name)
    brick, local = np.divmod(cell, SIDE**3)
    corner = np.stack([local >> 6, local >> 3 & 7, local & 7], axis=1)
    tap = np.arange(k.taps)
    x, y, z = (corner[:, a, None] + tap for a in range(3))
    cube = made.coefficients[brick[:, None, None, None], x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]]
    weights = [u[:, a, None] ** np.arange(k.degree + 1) @ k.weights.T for a in range(3)]
    return np.einsum("nijk,mi,mj,mk->nm", cube.astype(float), *weights, optimize=True)


def places(rng):
    """The cell's corners, where slabs are tight, and anywhere."""
    corners = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), axis=-1).reshape(-1, 3)
    return np.concatenate([corners, rng.uniform(size=(60, 3))])


@pytest.mark.parametrize("name", NAMES)
def test_the_interpolant_stays_in_its_slab(name, choice, rng):
    made, found = prepared(noise(rng), name, choice)
    u = places(rng)
    f = values(made, name, found.cell, u)
    middle = found.plane[:, :1] + found.plane[:, 1:].astype(float) @ (u - 0.5).T
    assert (np.abs(f - middle) <= found.delta[:, None]).all()
    assert len(found.cell) > 500
    if name != "catmull-rom":  # its net's inner points lie outside the curve by up to a third of the slope
        # Not idle: somewhere half of the slab is used.
        assert (np.abs(f - middle).max(axis=1) > 0.5 * found.delta).any()


@pytest.mark.parametrize("name", NAMES)
def test_cells_that_are_left_out_keep_their_distance(name, choice, rng):
    margin = 0.02
    made, found = prepared(noise(rng, 2.0), name, choice, margin)
    empty = np.flatnonzero(made.complete)
    empty = empty[~np.isin(empty, found.cell)]
    assert len(empty) > 20
    assert np.abs(values(made, name, empty, places(rng))).min() > margin
    kept = values(made, name, found.cell, places(rng))
    assert (np.abs(kept).min(axis=1) < 10 * margin).mean() > 0.15  # of those that are kept many are needed


@pytest.mark.parametrize("name", NAMES)
def test_an_affine_function_is_its_own_slab(name, choice):
    """Half a plane's width is rounding of single precision, 64 * 2^-23 of the greatest tap times (4/3)^3 for
    Catmull-Rom, and 4 * 2^-23 of the slab's numbers; the greatest tap is under 25."""
    slope = np.array([0.3, -0.7, 0.2])
    index = np.stack(np.meshgrid(*(np.arange(n) for n in (17, 9, 12)), indexing="ij"), axis=-1)
    found = prepared(Grid.from_dense(index @ slope + 1.3), name, choice)[1]
    np.testing.assert_allclose(found.plane[:, 1:], np.broadcast_to(slope, (len(found.cell), 3)), atol=2e-5)
    assert found.delta.max() < (64 * (4 / 3) ** 3 * 25 + 4 * 26) * 2.0**-23 and len(found.cell) > 50


@pytest.mark.parametrize("name", NAMES)
def test_largest_sum_of_magnitudes(name, choice, rng):
    grid, k = noise(rng), kernel(name)
    made, found = prepared(grid, name, choice)
    net = np.abs(np.kron(np.kron(k.bezier, k.bezier), k.bezier))
    brick, local = np.divmod(found.cell, SIDE**3)
    sums = np.zeros(len(grid.bricks))
    for b, c in zip(brick, local, strict=True):
        x, y, z = (slice(i, i + k.taps) for i in (c >> 6, c >> 3 & 7, c & 7))
        cube = made.coefficients[b, x, y, z]
        sums[b] = max(sums[b], (net @ np.abs(cube).ravel()).max())
    assert (sums <= found.largest).all() and (found.largest <= sums * (1 + 1e-4)).all() and (sums > 0).any()


def test_incomplete_cells_are_never_occupied(choice, sphere):
    """A surface crosses |nx| + |ny| + |nz| cells per unit of area, 3/2 on average over the sphere."""
    grid = Grid.from_function(sphere, 40, uv_mode="none")
    made, found = prepared(grid, "bspline", choice)
    assert made.complete.reshape(-1)[found.cell].all() and not made.complete.all()
    crossed = 1.5 * 4 * np.pi * (0.8 / grid.lattice.spacing) ** 2
    assert crossed * 0.9 < len(found.cell) < crossed * 1.5


@pytest.mark.parametrize("name", NAMES)
def test_no_surface_no_slabs(name, choice):
    for level in (1.0, 1e-9):  # nothing that is asked, and cells that a margin brings near
        found = prepared(Grid.from_dense(np.full((9, 9, 9), level)), name, choice)[1]
        assert len(found.cell) == 0 and not found.largest.any()
