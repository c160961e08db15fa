"""Walls and gaps that are too thin for a lattice, on boxes and balls whose thickness is known."""

import numpy as np
import pytest
import trimesh

from sdfbake import Mesh
from sdfbake.closest import Surface
from sdfbake.sign import Pseudonormals
from sdfbake.thin import _MOST, thin_features

H = 0.01  # spacing; thicknesses below are given in it


def of(*parts):
    """Return what is found in the union of some trimesh solids whose sizes are in voxels."""
    joined = trimesh.util.concatenate(parts)
    mesh = Mesh(np.asarray(joined.vertices) * H + [3, -2, 1], joined.faces)
    return thin_features(Pseudonormals.of(Surface.of(mesh)), H)


def named(findings):
    return [(finding.name, "four" if "four" in finding.of else "two") for finding in findings]


def slab(thickness, at=0.0):
    made = trimesh.creation.box((40, 40, thickness))
    made.apply_translation((0, 0, at))
    return made


@pytest.mark.parametrize(
    ("thickness", "found"),
    [
        (6, []),
        (4.1, []),
        (3.9, [("thin", "four")]),
        (3, [("thin", "four")]),
        (2.1, [("thin", "four")]),
        (1.9, [("thin", "four"), ("thin", "two")]),
        (1.5, [("thin", "four"), ("thin", "two")]),
        (0.01, [("thin", "four"), ("thin", "two")]),
    ],
)
def test_a_slab_is_as_thick_as_it_is(thickness, found):
    assert named(of(slab(thickness))) == found


def test_the_share_is_that_of_the_area():
    (finding,) = of(slab(3))
    # Large faces are 2 * 40^2 of the area, sides 4 * 40 * 3. Near its rim, where a side is nearer to the ball's centre
    # than the opposite face is (distance 1), nothing is found: a strip of width 1. Points spread evenly over the area
    # err by their discrepancy, a few points per face side: 1 % is generous.
    share = 2 * 38**2 / (2 * 40**2 + 4 * 40 * 3)
    assert finding.count / _MOST == pytest.approx(share, abs=0.01)
    assert f"of {_MOST} surface points ({finding.count / _MOST:.2%} of the area)" in finding.of
    assert finding.consequence == "noted"
    assert abs(finding.place[2] - 1) == pytest.approx(1.5 * H)
    assert str(finding).startswith(f"thin: {finding.count} of {_MOST} surface points")


@pytest.mark.parametrize(("gap", "found"), [(5, []), (3, [("gap", "four")]), (1.5, [("gap", "four"), ("gap", "two")])])
def test_gap_between_two_boxes(gap, found):
    assert named(of(slab(20, 10 + gap / 2), slab(20, -10 - gap / 2))) == found


@pytest.mark.parametrize("period", [1, 1.3, 0.7])
def test_stack_of_sheets_is_thin_and_full_of_gaps(period):
    # Balls of radius 1 and 2 have their centres beyond several sheets, next to a face that looks either way.
    found = named(of(*(slab(0.3, period * k) for k in range(6))))
    assert found == [("thin", "four"), ("thin", "two"), ("gap", "four"), ("gap", "two")]


def test_a_ball_is_not_thin():
    assert of(trimesh.creation.icosphere(4, radius=10)) == ()


def test_a_small_ball_is():
    # Of radius 1.5 the ball of radius 2 sticks out on all sides, and the far side is the nearest to its centre.
    assert ("thin", "four") in named(of(trimesh.creation.icosphere(3, radius=1.5)))


def test_inside_out_is_the_same():
    box = slab(3)
    turned = box.copy()
    turned.invert()
    (there,), (here,) = of(turned), of(box)
    # Points lie elsewhere on faces whose corners run the other way: 2 % of 1024.
    assert there.name == here.name == "thin" and there.count == pytest.approx(here.count, abs=20)


def test_a_hollow_ball_has_a_thin_wall_and_no_gap():
    inner = trimesh.creation.icosphere(4, radius=17)
    inner.invert()
    assert named(of(trimesh.creation.icosphere(4, radius=20), inner)) == [("thin", "four")]


def test_the_same_mesh_gives_the_same_findings():
    assert of(slab(3)) == of(slab(3))
