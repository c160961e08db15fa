"""What may not matter does not: unit, place and direction of a mesh; and the extremes of resolution and form."""

import warnings

import numpy as np
import pytest
from adversarial import (
    EPS,
    Samples,
    ball,
    box,
    dirty,
    every_distance,
    flattened,
    in_pieces,
    named,
    rounding,
    sliver,
    spread,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sdfbake import bake
from sdfbake.band import Target, filled
from sdfbake.bricks import REACH
from sdfbake.candidates import brick_candidates, places
from sdfbake.engine import choose


def baked(mesh, resolution, **options):
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # of soups and duplicates
        return bake(mesh, resolution, **options)


SCALED = {"ball": ball(1), "box": box(1.0, 0.7, 0.4, turned=True), "sliver": sliver(), "dirty": dirty()}


@pytest.mark.parametrize("exponent", [-40])
@pytest.mark.parametrize("mesh", SCALED.values(), ids=SCALED)
def test_powers_of_two_scale_exactly(mesh, exponent):
    one, other = baked(mesh, 16), baked(named(mesh.vertices * 2.0**exponent, mesh.faces), 16)
    np.testing.assert_array_equal(other.bricks.slot, one.bricks.slot)
    np.testing.assert_array_equal(other.face, one.face)
    np.testing.assert_array_equal(other.distance, one.distance * np.float32(2.0**exponent))
    np.testing.assert_array_equal(other.bricks.far, one.bricks.far * np.float32(2.0**exponent))
    np.testing.assert_array_equal(other.error, one.error)


@pytest.mark.parametrize("move", [(0, 0, 40), (16, 8, 32), (40, 40, 40)])
def test_moving_by_whole_bricks_changes_nothing(move):
    """Corners on a raster of 2^-10 voxels: every difference of coordinates is the same number after the move."""
    xp, shape = choose("auto", 32).engine, (64, 64, 64)
    vertices = np.round((box(1.0, 0.7, 0.4, turned=True).vertices * 5 + 11) * 1024) / 1024
    found = []
    for by in (np.zeros(3), np.array(move)):
        target = Target.of(xp, vertices + by, box(1.0, 1.0, 1.0).faces, shape, None)
        bricks = brick_candidates(xp, target.coarse, target.size, shape, REACH)
        ((_, band),) = filled(xp, target, bricks, REACH, 0.5, 1 << 20)
        near = (band.face >= 0).any(axis=1)  # candidates may differ: single precision has other roundings there
        found.append((places(bricks)[near] - (by // 8).astype(int), band.face[near], band.distance[near]))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


TURNED = {"ball": ball(1), "box": box(1.0, 0.7, 0.4, turned=True), "flattened": flattened(), "dirty": dirty()}
QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


@pytest.mark.parametrize("mesh", TURNED.values(), ids=TURNED)
def test_quarter_turns_permute(mesh):
    """x goes to y and y to -x; places are the same but for rounding."""
    one, other = baked(mesh, 24), baked(named(mesh.vertices @ QUARTER.T, mesh.faces), 24)
    shape = one.lattice.shape
    assert other.lattice.shape == (shape[1], shape[0], shape[2])
    a, b = spread(one), spread(other)

    def turned(values):
        return np.rot90(values.reshape(shape), 1, axes=(0, 1)).ravel()

    both = turned(a.present) & b.present  # bricks are counted from the other side
    np.testing.assert_array_equal(turned(a.face)[both], b.face[both])
    reach = REACH * one.lattice.spacing
    near = both & (np.abs(b.distance) < reach * (1 - 1e-6))
    gap = np.abs(turned(a.distance) - b.distance)[near]
    assert (gap <= np.spacing(np.abs(b.distance[near]).astype(np.float32)) + rounding(mesh, one.lattice)).all()
    assert np.count_nonzero(near) > 1000


ANGLES = st.tuples(*[st.floats(-180, 180)] * 3)
OFFSETS = st.tuples(*[st.floats(-100, 100)] * 3)


@settings(max_examples=4, deadline=None, derandomize=True)
@given(ANGLES, OFFSETS, st.sampled_from(["ball", "box", "dirty"]))
def test_any_motion(angles, offset, name):
    """Distances are those of the mesh that was not moved, at the samples moved back."""
    mesh, turn = SCALED[name], Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    grid = baked(named(mesh.vertices @ turn.T + offset, mesh.faces), 16)
    found = spread(grid)
    near = np.flatnonzero(found.face >= 0)[::7]
    found = Samples(*(column[near] for column in found))
    every = in_pieces(lambda p: every_distance(mesh, p), (found.points - offset) @ turn)
    least = every.min(axis=1)
    # The motion rounds a vertex, and the way back a sample, by a few eps of the greatest coordinate: as much again.
    slack = 2 * rounding(grid.surface.mesh(), grid.lattice)
    assert (np.abs(np.abs(found.distance) - least) <= least * 2.0**-24 + slack).all()
    chosen = np.take_along_axis(every, found.face[:, None], axis=1)[:, 0]
    assert (chosen <= least * (1 + 2e-10) + 128 * EPS * 16 * grid.lattice.spacing + slack).all()


EXTREMES = {
    "least resolution": (ball(1), 16),
    "1 to 12": (box(1.0, 1.0, 12.0), 96),
    "several parts": (
        ball(1).with_(part=np.arange(80, dtype=np.int32) // 20, part_names=("a", "b", "c", "d")),
        20,
    ),
}


@pytest.mark.parametrize(("mesh", "resolution"), EXTREMES.values(), ids=EXTREMES)
def test_extremes(mesh, resolution, rng):
    grid = baked(mesh, resolution)
    assert max(grid.lattice.shape) == resolution
    found = spread(grid)
    chosen = rng.permutation(np.flatnonzero(found.face >= 0))[:3000]
    every = in_pieces(lambda p: every_distance(mesh, p), found.points[chosen])
    least = every.min(axis=1)
    slack = rounding(mesh, grid.lattice)
    assert (np.abs(np.abs(found.distance[chosen]) - least) <= least * 2.0**-24 + slack).all()
    np.testing.assert_array_equal((every <= (least + slack)[:, None]).argmax(axis=1), found.face[chosen])
    if len(mesh.part_names) > 1:
        np.testing.assert_array_equal(grid.part[grid.face >= 0], mesh.part[grid.face[grid.face >= 0]])
        assert (grid.part[grid.face < 0] == 0).all()
