"""Texture coordinates from layers made by hand: against SciPy's interpolation of the same numbers, and known maps."""

from dataclasses import replace

import numpy as np
import pytest
from charted import ask, layers_of, with_layers
from scipy.ndimage import map_coordinates

from sdfbake import Grid
from sdfbake.layers import BORDER, FULL
from sdfrender import GridField, Rays, footprint, transfer
from sdfrender.flags import Flag

SIZE = (19, 12, 26)
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def noise():
    """Random distances: every brick exists, and bricks meet along every axis."""
    values = np.random.default_rng(7).normal(size=SIZE)
    return Grid.from_dense(values, origin=[-0.7, 0.3, 2.0], spacing=0.25)


def dense(rng, charts):
    """Random layers on all samples: 16-bit texture coordinates, borders, normals within 60 degrees of up."""
    codes = rng.integers(0, FULL + 1, (charts, *SIZE, 2))
    border = rng.uniform(-BORDER, BORDER, (charts, *SIZE)).astype(np.float16).astype(float)
    normal = UP + rng.uniform(-1, 1, (charts, *SIZE, 3)) * [0.9, 0.9, 0]
    return codes, border, normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def inside_cells(rng, count=2000):
    """Grid coordinates well inside cells."""
    return rng.integers(0, np.array(SIZE) - 1, (count, 3)) + rng.uniform(0.05, 0.95, (count, 3))


def linear(values, at):
    return map_coordinates(values, at.T, order=1)


def codes_rounding(field):
    """Of 16-bit codes in units of the last: places in a cell round by 11 N half eps of a cell (docs/tracing.md)."""
    return 12 * max(SIZE) * field.engine.eps * FULL


def test_one_chart_is_interpolated(noise, choice, rng):
    """Value and gradient of random codes; scale and offset differ between u and v."""
    codes, border, normal = dense(rng, 1)
    offset, scale = np.array([[-3.0, 0.25]]), np.array([[7.0, 0.5]])
    grid = with_layers(noise, layers_of(noise, codes, border, normal, offset=offset, scale=scale, of=[4]), 5)
    field, at = GridField(grid, "bspline", choice), inside_cells(rng)
    uv, gradient, chart, seam = ask(field, grid.lattice.to_world(at), UP)
    expected = np.stack([linear(codes[0, ..., c].astype(float), at) for c in (0, 1)], axis=-1)
    error = np.abs((uv - offset) / scale * FULL - expected)
    # What is added to the code's own rounding is the offset's, 3 units in the last place of 7.
    assert error.max() < codes_rounding(field) + 2 * FULL * choice.engine.eps
    step = 0.02  # linear along every axis within a cell: central differences are exact
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        for c in (0, 1):
            there, back = (linear(codes[0, ..., c].astype(float), at + s * shift) for s in (1, -1))
            slope = (there - back) / (2 * step) * scale[0, c] / FULL / grid.lattice.spacing
            limit = 4 * codes_rounding(field) / FULL * scale[0, c] / grid.lattice.spacing + 1e-10
            assert np.abs(gradient[:, c, axis] - slope).max() < limit
    assert (chart == 4).all() and not seam.any()


def test_the_least_border_distance_chooses_the_chart(noise, choice, rng):
    codes, border, normal = dense(rng, 3)
    grid = with_layers(noise, layers_of(noise, codes, border, normal, of=[5, 0, 2]), 6)
    field, at = GridField(grid, "bspline", choice), inside_cells(rng)
    distances = np.stack([linear(layer, at) for layer in border])
    least = distances.argmin(axis=0)
    first, second = np.sort(distances, axis=0)[:2]
    clear = second - first > 1e-2  # places round by 1e-4 of a cell in float32, borders differ by up to 16 over one
    uv, _, chart, seam = ask(field, grid.lattice.to_world(at), UP)
    assert np.array_equal(chart[clear], np.array([5, 0, 2])[least[clear]]) and not seam.any() and clear.mean() > 0.9
    expected = np.stack([linear(codes[k, ..., 0].astype(float), at) for k in range(3)])
    assert np.abs(uv[:, 0] - np.take_along_axis(expected, least[None], 0)[0])[clear].max() < codes_rounding(field)


def test_layers_that_look_away_are_the_other_side(noise, choice, rng):
    """The greater border distance wins if its layer alone looks along the normal; if none does, the border decides."""
    codes, border, normal = dense(rng, 2)
    border[0], border[1] = -3.0, 3.0
    normal[1] *= -1
    grid = with_layers(noise, layers_of(noise, codes, border, normal), 2)
    field, points = GridField(grid, "bspline", choice), noise.lattice.to_world(inside_cells(rng, 500))
    assert (ask(field, points, UP)[2] == 0).all()
    assert (ask(field, points, -UP)[2] == 1).all()
    normal[1] = normal[0]
    both = GridField(with_layers(noise, layers_of(noise, codes, border, normal), 2), "bspline", choice)
    assert (ask(both, points, -UP)[2] == 0).all()


def test_a_cell_that_no_chart_fills_says_so(noise, choice, rng):
    """Samples with x <= 9 speak: cells 9 to 10 have four corners, those beyond have none."""
    codes, border, normal = dense(rng, 1)
    border[0, 10:] = np.inf
    grid = with_layers(noise, layers_of(noise, codes, border, normal), 1)
    field = GridField(grid, "bspline", choice)
    at = inside_cells(rng)
    uv, gradient, _, seam = ask(field, grid.lattice.to_world(at), UP)
    cell = np.floor(at).astype(int)
    assert np.array_equal(seam, cell[:, 0] >= 9) and np.isfinite(uv).all() and np.isfinite(gradient).all()
    beyond, torn = cell[:, 0] > 9, cell[:, 0] == 9
    assert torn.any() and not uv[beyond].any() and not gradient[beyond].any()
    corners = np.stack(
        [codes[0][9, cell[torn, 1] + j, cell[torn, 2] + k] for j in (0, 1) for k in (0, 1)], axis=1
    ).astype(float)
    assert np.abs(uv[torn] - corners.mean(axis=1)).max() < 64 * FULL * choice.engine.eps
    slopes = [np.zeros_like(uv[torn]), (corners[:, 2:] - corners[:, :2]).mean(axis=1)]
    slopes.append((corners[:, 1::2] - corners[:, ::2]).mean(axis=1))
    expected = np.stack(slopes, axis=-1) / grid.lattice.spacing
    assert np.abs(gradient[torn] - expected).max() < 256 * FULL * choice.engine.eps / grid.lattice.spacing


def test_no_rows_are_no_texture(noise, choice):
    nothing = layers_of(noise, np.zeros((1, *SIZE, 2)), np.zeros((1, *SIZE)), np.broadcast_to(UP, (1, *SIZE, 3)))
    rows = ("brick", "chart", "uv", "border", "normal")
    empty = replace(nothing, **{name: getattr(nothing, name)[:0] for name in rows})
    field = GridField(with_layers(noise, empty, 1), "bspline", choice)
    uv, gradient, chart, seam = ask(field, noise.lattice.to_world(np.full((5, 3), 4.5)), UP)
    assert not uv.any() and not gradient.any() and not chart.any() and seam.all()


def test_two_charts_of_a_plane(choice, rng):
    """A plane cut at x = 0.03, an affine map on either side: continued past the cut, each is exact up to it.

    Trilinear interpolation gives affine functions back; what is left are codes of half a 16-bit unit, and gradients
    of one unit per voxel. A border in float16 is wrong by at most 2^-11 of a voxel next to the cut.
    """
    size, h = (24, 24, 17), 0.125
    index = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1)
    p = h * (index - [11.5, 11.5, 8.2])
    plane = Grid.from_dense(p[..., 2], origin=h * np.array([-11.5, -11.5, -8.2]), spacing=h)
    maps = np.array([[[0.3, 0.1, 0.5], [-0.1, 0.2, 0.5]], [[0.0, -2.5, 4.0], [0.25, 0.0, -9.0]]])  # per x, per y, at 0
    outside = np.stack([p[..., 0] - 0.03, 0.03 - p[..., 0]]) / h
    border = np.where((outside < 3) & (np.abs(p[..., 2]) < 3 * h), np.clip(outside, -BORDER, BORDER), np.inf)
    true = np.einsum("kcd,xyzd->kxyzc", maps[..., :2], p[..., :2]) + maps[:, None, None, None, :, 2]
    offset, scale = true.min(axis=(1, 2, 3)), np.ptp(true, axis=(1, 2, 3))
    codes = np.rint((true - offset[:, None, None, None]) / scale[:, None, None, None] * FULL)
    normal = np.broadcast_to(UP, (*border.shape, 3))
    grid = with_layers(plane, layers_of(plane, codes, border, normal, offset=offset, scale=scale), 2)
    field = GridField(grid, "bspline", choice)
    origins = np.append(rng.uniform(-1.2, 1.2, (2000, 2)), np.full((2000, 1), 0.7), axis=1)
    down, right, up, zero = (np.tile(d, (2000, 1)) for d in ([0.0, 0, -1], [1.0, 0, 0], [0.0, 1, 0], [0.0, 0, 0]))
    rays = Rays(origins, down, right, up, zero, zero)
    hits, moved = transfer(field, rays)
    seen = footprint(field, hits, moved)
    clear = np.abs(origins[:, 0] - 0.03) > 2**-10 * h
    side = (origins[:, 0] > 0.03).astype(int)
    assert hits.hit.all() and not (seen.flags & Flag.SEAM).any()
    assert np.array_equal(seen.chart[clear], side[clear]) and clear.mean() > 0.99
    expected = np.einsum("ncd,nd->nc", maps[side][..., :2], origins[:, :2]) + maps[side][..., 2]
    unit = scale[side] / FULL + 1000 * choice.engine.eps
    assert (np.abs(seen.uv - expected)[clear] < unit[clear]).all()
    for axis, found in enumerate((seen.duv_dx, seen.duv_dy)):
        assert (np.abs(found - maps[side][..., axis])[clear] < 2 * unit[clear] / h).all()
