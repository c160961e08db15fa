"""Dense arrays out of grids: bounds that are safe, exact distances by an independent route, one plane at a time."""

from dataclasses import replace

import igl
import numpy as np
import pytest
import trimesh

from sdfbake import BadInput, Grid, Mesh, bake
from sdfbake.closest import Surface
from sdfbake.densify import dense, planes
from sdfbake.faces import FaceTable
from sdfbake.lattice import BAND

ULP = 2.0**-23  # a float32 next to another differs by at most this share; half of it is lost by rounding


def ring():
    made = trimesh.creation.torus(1.0, 0.25, major_sections=24, minor_sections=12)
    return Mesh(np.asarray(made.vertices), made.faces)


def brick():
    made = trimesh.creation.box((3.0, 2.0, 2.5), trimesh.transformations.rotation_matrix(0.4, (1, 2, 3)))
    return Mesh(np.asarray(made.vertices), made.faces)


# The ring is all band inside; the box has absent bricks there.
@pytest.fixture(scope="module", params=[(ring, 70), (brick, 75)], ids=["torus", "box"])
def baked(request):
    made, resolution = request.param
    mesh = made()
    return mesh, bake(mesh, resolution, uv_mode="none")


@pytest.fixture(scope="module")
def truth(baked):
    """Signed distances at all samples by libigl alone: its distance, and its winding number for the sign."""
    mesh, grid = baked
    p = grid.lattice.to_world(np.moveaxis(np.indices(grid.lattice.shape), 0, -1)).reshape(-1, 3)
    square = igl.point_mesh_squared_distance(p, mesh.vertices, mesh.faces)[0]
    inside = igl.winding_number(mesh.vertices, mesh.faces, p) > 0.5
    return np.where(inside, -1, 1).reshape(grid.lattice.shape) * np.sqrt(square).reshape(grid.lattice.shape)


def test_bounds_are_safe_and_have_the_sign(baked, truth):
    grid = baked[1]
    filled = dense(grid)
    assert (grid.bricks.far > 0).any() and filled.dtype == np.float32
    # Stored exact values may be rounded away from zero, by half an ulp.
    assert (np.abs(filled) <= np.abs(truth) * (1 + ULP)).all()
    # On the surface itself, to float64's rounding, there is no sign.
    off = np.abs(truth) > 1e-12
    np.testing.assert_array_equal(filled[off] < 0, truth[off] < 0)


def test_bounds_are_exact_in_the_band(baked, truth):
    grid = baked[1]
    near = np.abs(truth) <= BAND * grid.lattice.spacing
    np.testing.assert_allclose(dense(grid)[near], truth[near], rtol=ULP, atol=1e-12)


def test_exact_everywhere(baked, truth):
    mesh, grid = baked
    filled = grid.to_dense(mesh)
    # atol: two float64 routes to a distance near zero, in a box of size 3; a thousand roundings.
    np.testing.assert_allclose(filled, truth, rtol=ULP, atol=1e-12)
    assert (filled != dense(grid)).any()


def test_grid_that_carries_its_mesh(baked, truth):
    # A mesh with texture coordinates, so that the grid can hold the table of faces.
    mesh = baked[0].with_(uv=np.zeros((len(baked[0].faces), 3, 2)))
    grid = replace(baked[1], face=np.zeros(baked[1].distance.shape, np.int32), surface=FaceTable.of(mesh))
    np.testing.assert_allclose(grid.to_dense(exact=True), truth, rtol=ULP, atol=1e-12)


def test_planes_are_pieces_of_the_whole(baked):
    mesh, grid = baked
    np.testing.assert_array_equal(np.stack(list(planes(grid, Surface.of(mesh)))), dense(grid, mesh))


@pytest.mark.parametrize("axis", [1, 2])
def test_exact_planes_across_other_axes(baked, axis):
    mesh, grid = baked
    whole, far = dense(grid, mesh), grid.lattice.shape[axis] // 2
    rest = planes(grid, Surface.of(mesh), axis=axis)
    found = next(plane for number, plane in enumerate(rest) if number == far)
    np.testing.assert_array_equal(found, whole[:, far] if axis == 1 else whole[..., far].T)


def test_planes_come_one_at_a_time(baked):
    seen = []
    pieces = planes(baked[1], progress=lambda stage, share: seen.append((stage, share)))
    next(pieces)
    assert seen == [("dense", 0)]
    assert len(list(pieces)) == baked[1].lattice.shape[0] - 1
    shares = [share for _, share in seen]
    assert shares == sorted(shares) and shares[-1] == 1


def test_present_bricks_are_as_they_are_stored(rng):
    values = rng.normal(size=(21, 9, 16)).astype(np.float32)  # noise: every brick is needed
    np.testing.assert_array_equal(dense(Grid.from_dense(values)), values)


def test_there_are_absent_bricks_inside():
    assert (bake(brick(), 75, uv_mode="none").bricks.far < 0).any()


def test_another_mesh_is_refused(baked):
    mesh, grid = baked
    with pytest.raises(BadInput, match="not the one that the grid was baked from"):
        dense(grid, mesh.with_(vertices=mesh.vertices * 1.0000001))


def test_no_mesh_to_ask_is_refused(baked):
    with pytest.raises(BadInput, match="carries no mesh"):
        dense(baked[1], exact=True)
