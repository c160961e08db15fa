"""Meshes with holes: what lies inside by winding number or as a shell, and refusals."""

import warnings

import numpy as np
import pytest
from adversarial import (
    Samples,
    ball,
    capless,
    every_distance,
    in_pieces,
    points_between,
    rounding,
    soup,
    spread,
    winding,
)

from sdfbake import BadInput, Mesh, bake
from sdfbake.bricks import REACH


def patch():
    """A flat square, bent along a diagonal."""
    return Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0.2], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))


def test_refused_unless_it_is_said_what_inside_means():
    with pytest.raises(BadInput, match="say what inside means with --open winding or --open shell:THICKNESS"):
        bake(patch(), 16)
    assert bake(patch(), 16, open="shell:0.1").metadata.options["open"] == "shell:0.1"


@pytest.mark.parametrize(
    "wish", ["", "shell", "shell:", "shell:0", "shell:-1", "shell:nan", "shell:inf", "hull", "shell:x"]
)
def test_unknown_wishes_are_refused(wish):
    with pytest.raises(BadInput, match="shell:T with a thickness T above 0"):
        bake(patch(), 16, open=wish)


def test_pseudonormals_do_not_go_with_open():
    with pytest.raises(BadInput, match="need a closed mesh"):
        bake(capless(2), 24, open="winding", sign="pseudonormal")


# A ball without its cap above a height, the resolution.
CAPLESS = {"hole of a few voxels": (0.9, 32), "hole wider than the band": (0.3, 56)}


@pytest.fixture(scope="module", params=CAPLESS.values(), ids=CAPLESS)
def holed(request):
    height, resolution = request.param
    mesh = capless(3, height)
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # in a hole, no two methods agree
        return mesh, height, bake(mesh, resolution, open="winding", cube=True)


def test_signs_away_from_the_hole_are_those_of_the_ball(holed):
    """Inside and below the rim, the missing cap takes less than half of all directions: it is less than a hemisphere.

    Facets lie up to 0.004 within the ball, and the rim is as ragged as an edge is long, 0.15.
    """
    _, height, grid = holed
    found = spread(grid)
    radius, low = np.linalg.norm(found.points, axis=1), found.points[:, 2] < height - 0.2
    inside, outside = (found.present & low & part for part in (radius < 0.99, radius > 1.001))
    assert np.count_nonzero(inside) > 1000 and np.count_nonzero(outside) > 1000
    assert (found.distance[outside] > 0).all()
    assert (found.distance[inside] < 0).all()


def test_signs_in_the_hole_are_those_of_the_winding_number(holed):
    mesh, height, grid = holed
    found = spread(grid)
    around = found.present & (found.points[:, 2] > height - 0.4) & (np.linalg.norm(found.points, axis=1) < 1.3)
    w = np.abs(winding(mesh, found.points[around]))
    # The baker's winding numbers are sums over a tree, right to about a hundredth.
    clear = np.abs(w - 0.5) > 0.02
    assert np.count_nonzero(clear) > 1000
    np.testing.assert_array_equal((found.distance[around] < 0)[clear], (w > 0.5)[clear])


def test_bricks_that_touch_through_a_hole_keep_their_sides(rng):
    mesh = capless(3, 0.3)
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        grid = bake(mesh, 56, open="winding", cube=True)
    points, bound = points_between(grid, rng)
    # A bound is less than the distance from the faces.
    assert (np.abs(bound) <= in_pieces(lambda p: every_distance(mesh, p).min(axis=1), points)).all()
    radius = np.linalg.norm(points, axis=1)
    outside, deep = radius > 1.5, (radius < 0.9) & (points[:, 2] < -0.2)
    assert outside.any() and deep.any()
    assert (bound[outside] > 0).all()
    assert (bound[deep] < 0).all()


# World thickness; the spacing is about 2 / 13 and 2 / 21, so that these are 0.3, 3 and 20 voxels.
SHELLS = {"thin": 0.05, "thick": 0.5, "thicker than the band": 3.0}


@pytest.mark.parametrize("thickness", SHELLS.values(), ids=SHELLS)
@pytest.mark.parametrize("mesh", [capless(2), patch(), soup(12), ball(1)], ids=["capless", "patch", "soup", "closed"])
def test_a_shell_is_a_surface_moved_out_on_both_sides(mesh, thickness, rng):
    grid = bake(mesh, 40 if thickness > 1 else 24, open=f"shell:{thickness}")
    assert grid.metadata.sign.method == "exact"
    found, h = spread(grid), grid.lattice.spacing
    chosen = rng.permutation(len(found.points))[:6000]
    found = Samples(*(column[chosen] for column in found))
    true = in_pieces(lambda p: every_distance(mesh, p).min(axis=1), found.points) - thickness / 2
    slack = rounding(mesh, grid.lattice)
    near = np.abs(true) <= REACH * h - slack
    assert found.present[near].all() and np.count_nonzero(near & (true < 0)) > 0
    # float32 rounds by 2^-24 of the value.
    assert (np.abs(found.distance - true)[near] <= np.abs(true[near]) * 2.0**-24 + slack).all()
    beyond = found.present & ~near & (np.abs(np.abs(true) - REACH * h) > slack)
    assert (found.distance[beyond] == (np.sign(true) * np.float32(REACH * h))[beyond]).all()
    # The lattice holds the shell and its band.
    assert (np.abs(grid.lattice.bounds - (mesh.bounds + np.array([[-1], [1]]) * thickness / 2)) >= 5.1 * h).all()


def test_far_bounds_of_a_thick_shell(rng):
    mesh, thickness = ball(1), 1.2
    grid = bake(mesh, 80, open=f"shell:{thickness}")
    points, bound = points_between(grid, rng)
    true = in_pieces(lambda p: every_distance(mesh, p).min(axis=1), points) - thickness / 2
    assert (np.abs(bound) <= np.abs(true)).all() and (np.sign(bound) == np.sign(true)).all()
    assert (bound < 0).any() and (bound > 0).any()


def test_a_shell_and_a_closed_bake_have_the_same_faces():
    """Where both are in reach."""
    mesh = ball(1)
    solid, shell = bake(mesh, 24), bake(mesh, 24, open="shell:0.001")
    one, other = spread(solid), spread(shell)
    assert one.points.shape == other.points.shape  # the lattices differ by half a thousandth on every side
    both = (one.face >= 0) & (other.face >= 0)
    # Other positions, so near the edges of faces other faces: those are a small share.
    assert (one.face == other.face)[both].mean() > 0.95
