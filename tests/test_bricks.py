"""Bricks against brute force over all samples of a small lattice, and their bounds against the true distance."""

import numpy as np
import pytest

from sdfbake import Lattice
from sdfbake.bricks import REACH, SIDE, active, in_lattice, sample_index

CENTRE = np.array([0.13, -0.21, 0.37])


def sphere(p):
    return np.linalg.norm(p - CENTRE, axis=-1) - 0.6


def nothing_near(p):
    return np.linalg.norm(p - CENTRE, axis=-1) + 50.0


def all_samples(lattice):
    return np.moveaxis(np.indices(lattice.shape), 0, -1)


LATTICES = {
    "odd": Lattice(np.array([-1.0, -1, -1]), 0.043, (53, 47, 61)),
    "whole": Lattice(np.array([-1.0, -1, -1]), 0.05, (48, 48, 48)),
    "flat": Lattice(np.array([-1.0, -0.3, -1]), 0.04, (64, 9, 40)),
    "tiny": Lattice(np.array([0.0, 0, 0]), 0.4, (2, 3, 5)),
}


@pytest.mark.parametrize("reach", [0.0, 1.0, REACH])
@pytest.mark.parametrize("lattice", LATTICES.values(), ids=LATTICES)
def test_bricks_equal_brute_force(lattice, reach):
    index = all_samples(lattice)
    near = np.abs(sphere(lattice.to_world(index))) <= reach * lattice.spacing
    expected = np.unique(index[near] // SIDE, axis=0)  # sorted by rows: C order
    bricks = active(lattice, sphere, reach)
    np.testing.assert_array_equal(bricks.index, expected.reshape(-1, 3))
    assert (bricks.slot[tuple(bricks.index.T)] == np.arange(len(bricks))).all()
    assert (bricks.slot >= 0).sum() == len(bricks)


@pytest.mark.parametrize("lattice", LATTICES.values(), ids=LATTICES)
def test_far_bounds_are_safe_and_signed(lattice):
    bricks = active(lattice, sphere)
    absent = np.argwhere(bricks.slot < 0)
    far = bricks.far[tuple(absent.T)].astype(np.float64)
    rng = np.random.default_rng(0)
    # Points of the brick's closed cube of cells, its corners among them.
    within = np.concatenate([rng.uniform(0, SIDE, (200, 3)), np.indices((2, 2, 2)).reshape(3, -1).T * SIDE])
    p_grid = np.minimum(absent[:, None] * SIDE + within, np.array(lattice.shape) - 1)
    true = sphere(lattice.to_world(p_grid))
    assert (np.abs(far)[:, None] <= np.abs(true)).all()
    assert (np.sign(far)[:, None] * np.sign(true) >= 0).all()
    assert (bricks.far[bricks.slot >= 0] == 0).all()


def test_far_bounds_are_of_use():
    lattice = LATTICES["whole"]
    bricks = active(lattice, sphere)
    far = np.abs(bricks.far[bricks.slot < 0])
    # An absent brick has no sample in reach; a bound is at worst a voxel's diagonal less.
    assert far.min() >= (REACH - np.sqrt(3)) * lattice.spacing * (1 - 1e-5)


def test_nothing_near():
    bricks = active(LATTICES["odd"], nothing_near)
    assert len(bricks) == 0 and (bricks.slot == -1).all() and (bricks.far > 48).all()


def test_samples_of_a_last_brick():
    index = np.array([[0, 0, 0], [1, 0, 0]], np.int32)
    inside = in_lattice(index, (9, 8, 3))
    expected = (sample_index(index) < [9, 8, 3]).all(axis=-1)
    np.testing.assert_array_equal(inside, expected)
    assert inside.sum() == 9 * 8 * 3
