"""Bounds of absent bricks: never too long, right in sign, of use; by closed form and by brute force."""

import warnings

import numpy as np
import pytest
from adversarial import (
    ball,
    box,
    dirty,
    every_distance,
    flattened,
    in_pieces,
    joined,
    nested,
    points_between,
    sliver,
    winding,
)

from sdfbake import bake
from sdfbake.bricks import REACH, SIDE, in_lattice, sample_index
from sdfbake.far import far_bounds
from sdfbake.lattice import Lattice

SPACING = 0.25
SHAPE = (150, 97, 120)


def blobs(p):
    """Two balls, one of them with a cavity; voxels, 1-Lipschitz, exact near and far but for the medial axis."""
    one, other = np.linalg.norm(p - [45.3, 48.1, 60.7], axis=-1), np.linalg.norm(p - [115.9, 50.2, 58.8], axis=-1)
    return np.minimum(np.maximum(one - 40, 22 - one), other - 27)


def present_bricks(distance, shape):
    counts = tuple(-(-n // SIDE) for n in shape)
    index = np.argwhere(np.ones(counts, bool)).astype(np.int32)
    values = distance(sample_index(index).astype(float))
    near = ((np.abs(values) <= REACH) & in_lattice(index, shape)).any(axis=(1, 2, 3))
    present = np.zeros(counts, bool)
    present[tuple(index[near].T)] = True
    stored = np.clip(values[near], -REACH, REACH).astype(np.float32) * np.float32(SPACING)
    stored[~in_lattice(index[near], shape)] = 0
    return present, index[near], stored


def far_of(distance, shape=SHAPE):
    present, index, stored = present_bricks(distance, shape)
    return present, far_bounds(present, index, stored, REACH, Lattice(np.zeros(3), SPACING, shape))


def test_bounds_hold_all_over_the_bricks_cells(rng):
    present, far = far_of(blobs)
    absent = np.argwhere(~present)
    within = np.concatenate([rng.uniform(0, SIDE, (60, 3)), np.indices((3, 3, 3)).reshape(3, -1).T * SIDE / 2])
    p = np.minimum(absent[:, None] * SIDE + within, np.array(SHAPE) - 1.0)
    true = blobs(p) * SPACING
    bound = far[~present].astype(float)[:, None]
    assert (np.abs(bound) <= np.abs(true)).all()
    assert (np.sign(bound) == np.sign(true)).all()
    assert {-1, 1} == set(np.sign(far[~present]))
    # The cavity is outside.
    assert not present[5, 6, 7] and far[5, 6, 7] > 0 and far[0, 0, 0] > 0
    assert (far[present] == 0).all() and far.dtype == np.float32


def test_bounds_grow_with_the_distance():
    """At least the true distance less three of the bricks' diagonals: no ray creeps through empty space."""
    present, far = far_of(blobs)
    middle = (np.argwhere(~present) + 0.5) * SIDE
    true = np.abs(blobs(middle)) * SPACING
    assert (np.abs(far[~present]) >= true - 3 * 3**0.5 * SIDE * SPACING).all()
    # And never less than what it means that no sample is in reach.
    assert np.abs(far[~present]).min() >= (REACH - 3**0.5) * SPACING * (1 - 1e-5)


def test_a_surface_in_the_last_samples_of_a_lattice():
    """Partly filled last bricks: what lies beyond the lattice has no say in signs."""

    def wall(p):
        return 84.0 - p[..., 1]

    shape = (40, 89, 33)
    present, far = far_of(wall, shape)
    assert present[:, 10:].all() and (far[~present] > 0).all()
    present, far = far_of(lambda p: -wall(p), shape)
    assert (far[~present] < 0).all()


def test_nothing_present_is_outside_and_everything_present_has_no_bound():
    none = np.zeros((3, 4, 5), bool)
    empty = np.zeros((0, 3), np.int32), np.zeros((0, 8, 8, 8), np.float32)
    lattice = Lattice(np.zeros(3), SPACING, (24, 32, 40))
    far = far_bounds(none, *empty, REACH, lattice)
    assert (far > 0).all() and np.isfinite(far).all()
    index = np.argwhere(~none).astype(np.int32)
    assert (far_bounds(~none, index, np.ones((60, 8, 8, 8), np.float32), REACH, lattice) == 0).all()


def test_a_surface_may_fill_any_corner_of_its_brick(rng):
    """The bound is no more than the gap between two bricks' cubes of cells, and not much less."""
    present = np.zeros((7, 6, 8), bool)
    index = np.array([[3, 2, 4]], np.int32)
    present[tuple(index[0])] = True
    lattice = Lattice(np.zeros(3), SPACING, (56, 48, 64))
    far = far_bounds(present, index, np.ones((1, 8, 8, 8), np.float32), REACH, lattice)
    apart = np.abs(np.moveaxis(np.indices(present.shape), 0, -1) - index[0])
    gap = np.linalg.norm((apart - 1).clip(0), axis=-1) * SIDE
    # Next to the brick it says only that no sample is in reach.
    assert (far <= np.maximum(gap, REACH - 3**0.5) * SPACING)[~present].all()
    assert (far >= (gap - SIDE) * SPACING)[~present].all()


MESHES = {
    "turned box": box(1.0, 0.7, 0.4, turned=True),
    "sliver": sliver(),
    "flattened": flattened(),
    "nested": nested(),
    "dirty": dirty(),
    "two": joined(ball(1), ball(1, centre=(3.5, 0.3, 0))),
}


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_bounds_of_baked_meshes(mesh, rng):
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        grid = bake(mesh, 72)
    points, bound = points_between(grid, rng)
    chosen = rng.permutation(len(points))[:8000]
    points, bound = points[chosen], bound[chosen]
    true = in_pieces(lambda p: every_distance(mesh, p).min(axis=1), points)
    assert len(points) > 1000 and (np.abs(bound) <= true).all()
    np.testing.assert_array_equal(bound < 0, np.abs(winding(mesh, points)) > 0.5)
