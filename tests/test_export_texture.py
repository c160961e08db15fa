"""Texture coordinates by sample, whichever way a grid stores them."""

from dataclasses import replace

import numpy as np
import pytest

from datasets_synthetic import mesh
from sdfbake import bake, triangle
from sdfbake.bricks import in_lattice, sample_index
from sdfbake.closest import Surface
from sdfbake.export.texture import channels, textured
from sdfbake.faces import FaceTable

# What a grid keeps when it has one mode only.
ALONE = {
    "grid": {"face": None, "surface": None, "layers": None},
    "faces": {"uv": None, "chart": None, "layers": None},
    "layers": {"uv": None, "chart": None, "face": None, "surface": None},
}


@pytest.fixture(scope="module")
def baked():
    """A box of six charts, so that its edges are seams; 33 samples: the last bricks have one layer in the lattice."""
    source = mesh("box")
    grid = bake(source, 33, uv_mode="faces,layers,grid")
    assert grid.metadata.charts > 1 and min(grid.lattice.shape) % 8
    return source, grid


@pytest.fixture(scope="module", params=list(ALONE))
def found(request, baked):
    return request.param, textured(replace(baked[1], **ALONE[request.param]))


def near_a_cell(grid):
    """Samples that a cell with surface has as a corner, and no others."""
    within = np.abs(grid.distance) <= 3**0.5 * grid.lattice.spacing
    return within & in_lattice(grid.bricks.index, grid.lattice.shape)


def test_coordinates_are_those_of_the_closest_point(baked, found):
    """Against libigl's closest face; at edges, the tie between charts is broken the same way."""
    source, grid = baked
    mode, given = found
    near = near_a_cell(grid)
    closest = Surface.of(source).closest(grid.lattice.to_world(sample_index(grid.bricks.index)[near]))
    uv = np.einsum("nc,ncd->nd", closest.barycentric, source.uv[closest.face])
    same = given.chart[near] == source.chart[closest.face]
    if mode == "layers":  # which go on past the border of a chart, and do not stop there as closest points do
        same &= closest.feature == triangle.INTERIOR
    assert same.mean() > (0.5 if mode == "layers" else 0.99999)
    # Half a step of 16 bits over a chart's range, or of float32; coordinates are at most 1.
    np.testing.assert_allclose(
        given.uv[near][same], uv[same], rtol=0, atol=2**-17 + 2**-24 if mode == "layers" else 2**-23
    )


def test_samples_and_faces_say_the_same(baked):
    """Of the same samples, out to the reach of the grid, to the last bit: both round the same float64 number."""
    first, second = (textured(replace(baked[1], **ALONE[mode])) for mode in ("grid", "faces"))
    for name in ("uv", "chart", "seam"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_seams_are_cells_with_corners_in_several_charts(baked, found):
    grid, given = baked[1], found[1]
    at = sample_index(grid.bricks.index)
    dense = np.full(tuple(8 * n + 1 for n in grid.bricks.slot.shape), -1)
    dense[tuple(np.moveaxis(at, -1, 0))] = given.chart
    corners = np.stack([dense[tuple(np.moveaxis(at + step, -1, 0))] for step in np.ndindex(2, 2, 2)])
    several = np.where(corners < 0, 1 << 30, corners).min(axis=0) < corners.max(axis=0)
    assert several.any()
    np.testing.assert_array_equal(given.seam, several)


def test_only_what_is_wanted(rng, baked, found):
    grid, given = baked[1], found[1]
    wanted = near_a_cell(grid) & (rng.random(grid.distance.shape) < 0.5)
    part = textured(replace(grid, **ALONE[found[0]]), wanted)
    known = wanted & (given.chart >= 0)
    np.testing.assert_array_equal(part.chart, np.where(known, given.chart, -1))
    np.testing.assert_array_equal(part.uv, np.where(known[..., None], given.uv, 0))
    assert (part.seam <= given.seam).all()


def test_samples_outside_the_lattice_have_none(baked, found):
    outside = ~in_lattice(baked[1].bricks.index, baked[1].lattice.shape)
    assert outside.any() and (found[1].chart[outside] == -1).all()


def test_a_face_without_a_plane(baked):
    """All three corners on a line along x: the closest point is the nearest of that segment."""
    grid = baked[1]
    a = grid.lattice.origin + 9.5 * grid.lattice.spacing
    corners = a + np.array([[0, 0, 0], [4.0, 0, 0], [1.0, 0, 0]]) * grid.lattice.spacing
    uv = np.array([[[0.0, 1.0], [1.0, 0.0], [0.25, 0.75]]])
    line = FaceTable(corners, np.array([[0, 1, 2]], np.int32), uv, np.array([7], np.int32))
    face = np.where(grid.face >= 0, np.int32(0), np.int32(-1))
    given = textured(replace(grid, **ALONE["faces"] | {"face": face, "surface": line}))
    along = ((sample_index(grid.bricks.index)[..., 0] - 9.5) / 4).clip(0, 1)
    known = face >= 0
    expected = np.stack([along, 1 - along], axis=-1)
    np.testing.assert_allclose(given.uv[known], expected[known], rtol=0, atol=2**-23)  # float32
    assert (given.chart[known] == 7).all()


def test_a_grid_without_texture_coordinates(baked):
    assert textured(replace(baked[1], **ALONE["grid"] | ALONE["faces"])) is None


@pytest.mark.parametrize(
    "modes, read",
    [
        ((), ()),
        (("faces",), ("face",)),
        (("layers",), ("layers",)),
        (("faces", "layers", "grid"), ("face",)),
        (("layers", "grid"), ("uv", "chart")),
    ],
    ids=["none", "faces", "layers", "all", "no-faces"],
)
def test_channels_to_read(modes, read):
    assert channels(modes) == read
