"""Coefficients that make plain B-spline readers exact: at nodes, of fourth order, in two readers that are not ours."""

import json

import numpy as np
import pytest
from exported import silent
from scipy import ndimage

from datasets_synthetic import mesh
from sdfbake import Grid, bake
from sdfbake.densify import surface_of
from sdfbake.engine import choose
from sdfbake.engine.choose import _jit_problem
from sdfbake.export import export
from sdfbake.export.coefficients import _values, write

EPS = 2.0**-24  # float32 is off by this share at most
# Along every axis the inverse of (1, 4, 1) / 6 makes up to 3 of values of 1 that change sign, 27 in all. What is stored
# on the way, 1 / (1 - 0.27) = 1.37, is rounded, goes on 1.37 times, returns times 1.6 * 1.37, and then times 9 along
# the other axes; and all are: 1.37 * 1.37 * 1.6 * 1.37 * 9 + 27.
ROUNDED = 64 * EPS


def coefficients(grid, path, **options):
    write(grid, path, progress=silent, **options)
    return np.load(path)


def read(c, at):
    """Read as SciPy does, whose "reflect" is what clamping does for one sample."""
    return ndimage.map_coordinates(c.astype(np.float64), at.T, order=3, prefilter=False, mode="reflect")


def exact_nodes(grid):
    """Return the samples that have exact ones up to two away in every direction, by looking at all 125."""
    dense, h = grid.to_dense(), grid.lattice.spacing
    padded = np.pad(np.abs(dense) <= 5.2 * h, 2)
    for x, y, z in np.argwhere(grid.bricks.slot < 0) * 8 + 2:
        padded[x : x + 8, y : y + 8, z : z + 8] = False
    views = np.lib.stride_tricks.sliding_window_view(padded, (5, 5, 5))
    return np.argwhere(views.all(axis=(3, 4, 5))), dense


@pytest.mark.parametrize("shape", [(21, 9, 16), (2, 3, 5), (40, 2, 33), (70, 4, 3)], ids=str)
def test_anybodys_numbers_are_interpolated_everywhere(shape, rng, tmp_path):
    values = rng.normal(size=shape).astype(np.float32)
    grid = Grid.from_dense(values)
    dense = grid.to_dense()  # absent bricks hold one value
    c = coefficients(grid, tmp_path / "a.npy")
    most = np.abs(dense).max()
    nodes = np.argwhere(np.ones(shape, bool))
    np.testing.assert_allclose(read(c, nodes), dense.reshape(-1), rtol=0, atol=ROUNDED * most)
    # The matrix itself, solved as any other.
    expected = dense.astype(np.float64)
    for axis, n in enumerate(shape):
        rows = np.pad(np.eye(n), ((1, 1), (0, 0)), mode="edge")
        matrix = (rows[:-2] + 4 * rows[1:-1] + rows[2:]) / 6
        expected = np.moveaxis(
            np.linalg.solve(matrix, np.moveaxis(expected, axis, 0).reshape(n, -1)).reshape(n, *np.delete(shape, axis)),
            0,
            axis,
        )
    np.testing.assert_allclose(c, expected, rtol=0, atol=ROUNDED * most)


@pytest.mark.parametrize("n", [24, 45])
def test_samples_of_a_baked_grid_are_returned(n, sphere, tmp_path):
    grid = Grid.from_function(sphere, n, uv_mode="none")
    c, h = coefficients(grid, tmp_path / "a.npy"), grid.lattice.spacing
    nodes, dense = exact_nodes(grid)
    # All corners of cells with surface are among them, and they are a voxel's diagonal from it at most.
    corners = np.argwhere(np.abs(dense) < 3**0.5 * h)
    assert {*map(tuple, corners)} <= {*map(tuple, nodes)} and len(nodes) < dense.size / 2
    # Their values reach the band's width, and so do those around that were rounded with them.
    np.testing.assert_allclose(read(c, nodes), dense[tuple(nodes.T)], rtol=0, atol=ROUNDED * 6 * h)


def test_exact_samples_are_taken_but_at_the_border():
    """Mirrored distances have a kink at the border, however exact they are."""
    grid = bake(mesh("box"), 20, uv_mode="faces")
    strips = [values for *_, values in _values(grid, surface_of(grid, True), silent)]
    taken = np.concatenate(strips).reshape(grid.lattice.shape)
    inner, dense = (slice(2, -2),) * 3, grid.to_dense(exact=True)
    np.testing.assert_array_equal(taken[inner], dense[inner])
    for axis in range(3):
        for end in (0, -1):
            assert (taken.take(end, axis) != dense.take(end, axis)).mean() > 0.9


def by_scipy(c, at):
    return read(c, at)


def by_drjit(c, at, wrap="Clamp"):
    """Read as Dr.Jit does, through float32 textures whose x is the array's last axis."""
    dr = pytest.importorskip("drjit")
    if _jit_problem() is not None:
        pytest.skip(_jit_problem())
    choose("drjit", 32)
    from drjit.llvm import Array3f, Float, TensorXf, Texture3f

    texture = Texture3f(TensorXf(c[..., None]), wrap_mode=getattr(dr.WrapMode, wrap), use_accel=False)
    places = ((at + 0.5) / c.shape)[:, ::-1].astype(np.float32)
    return np.array(
        texture.eval_cubic(Array3f(*(Float(np.ascontiguousarray(places[:, axis])) for axis in range(3))))[0]
    )


@pytest.mark.parametrize("reader", [by_scipy, by_drjit])
def test_fourth_order(reader, sphere, directions, tmp_path):
    spacings, errors = [], []
    for n in (20, 24, 32, 40) if reader is by_drjit else (24, 32, 48, 64, 80):
        grid = Grid.from_function(sphere, n, uv_mode="none")
        c = coefficients(grid, tmp_path / "a.npy")
        spacings.append(grid.lattice.spacing)
        errors.append(np.abs(reader(c, grid.lattice.to_grid(0.8 * directions))).max())
    order = np.polyfit(np.log(spacings), np.log(errors), 1)[0]
    # The sphere has 4 to 20 voxels to its radius: at first the next even order still counts. Dr.Jit's positions are
    # rounded to 2^-24 of the texture's width, 1e-7 of it: it stops at 40 samples, where the error is 1e-5 voxels.
    assert 3.6 < order < 5.2


def test_the_filter_without_end_has_no_order(sphere, directions, tmp_path):
    """Why the samples that see bounds are smoothed: what the plain inverse filter makes of them."""
    grid = Grid.from_function(sphere, 80, uv_mode="none")
    plain, p_grid = grid.to_dense().astype(np.float64), grid.lattice.to_grid(0.8 * directions)
    for axis in range(3):
        plain = ndimage.spline_filter1d(plain, 3, axis, mode="reflect")
    ours = coefficients(grid, tmp_path / "a.npy")
    assert np.abs(read(plain, p_grid)).max() > 50 * np.abs(read(ours, p_grid)).max()


@pytest.mark.parametrize("wrap", ["Clamp", "Mirror"])
def test_borders_in_drjit(wrap, rng, tmp_path):
    grid = Grid.from_dense(rng.normal(size=(9, 6, 12)).astype(np.float32))
    dense = grid.to_dense()
    c = coefficients(grid, tmp_path / "a.npy")
    nodes = np.argwhere(np.ones(dense.shape, bool))
    # Weights in float32 at positions rounded by 2^-24 of 12 texels, times differences of some 20 between coefficients.
    np.testing.assert_allclose(by_drjit(c, nodes, wrap), dense.reshape(-1), rtol=0, atol=12 * EPS * 40 + 64 * EPS * 20)


def test_description(sphere, tmp_path):
    grid = Grid.from_function(sphere, 24)
    done = export(grid, tmp_path / "a.npy", "coefficients")
    record = json.loads((tmp_path / "a.npy.json").read_text())
    assert [file.name for file in done.files] == ["a.npy", "a.npy.json"] and record["coefficients"] == "a.npy"
    assert record["lattice"]["shape"] == [24, 24, 24] and "texture coordinates" in done.dropped[0]
