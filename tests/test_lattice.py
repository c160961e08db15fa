"""The map between world and grid: against positions worked out by hand, and against itself backwards."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdfbake import BadInput, Lattice
from sdfbake.lattice import BAND

CUBE = np.array([[-1.0, -1, -1], [1, 1, 1]])


def test_known_positions():
    lattice = Lattice(np.array([1.0, 2, 3]), 0.5, (4, 5, 6))
    assert lattice.to_world(np.array([[0, 0, 0], [3, 4, 5], [0.5, 0, 1]])).tolist() == [
        [1, 2, 3], [2.5, 4, 5.5], [1.25, 2, 3.5],
    ]  # fmt: skip
    assert lattice.bounds.tolist() == [[1, 2, 3], [2.5, 4, 5.5]]


@given(st.integers(16, 8192), st.floats(1e-6, 1e6), st.floats(-1e3, 1e3))
def test_round_trip(resolution, size, offset):
    lattice = Lattice.around(CUBE * size + offset * size, resolution)
    index = np.array([[0.0, 0, 0], [resolution - 1] * 3, [3.25, 1, 7]])
    # The world position rounds at eps |p|, and |p| is at most (|offset| + 3) size; one voxel is extent / (n - 11.4).
    most = (abs(offset) + 4) * size * 4 * np.finfo(float).eps / lattice.spacing
    assert np.abs(lattice.to_grid(lattice.to_world(index)) - index).max() <= most + 1e-12


@pytest.mark.parametrize("resolution", [16, 17, 64, 513])
def test_box_and_band(resolution):
    bounds = np.array([[0.0, -1, 5], [4, 1, 5.5]])
    lattice = Lattice.around(bounds, resolution)
    assert max(lattice.shape) == lattice.shape[0] == resolution
    assert lattice.spacing == pytest.approx(4 / (resolution - 1 - 2 * BAND), rel=1e-14)
    margin = np.stack([bounds[0] - lattice.bounds[0], lattice.bounds[1] - bounds[1]]) / lattice.spacing
    # The slack of a thousandth of a voxel that `around` states, on two sides.
    assert (margin >= BAND - 5.01e-4).all() and (margin < BAND + 0.5).all()


def test_cube():
    lattice = Lattice.around(np.array([[0.0, 0, 0], [4, 1, 1]]), 32, cube=True)
    assert lattice.shape == (32, 32, 32)
    np.testing.assert_allclose(lattice.bounds.mean(axis=0), [2, 0.5, 0.5], atol=1e-14)


@pytest.mark.parametrize("resolution", [-1, 0, 1, 15, 8193, 100_000])
def test_resolution_refused(resolution):
    with pytest.raises(BadInput, match=rf"resolution {resolution} .*16\.\.8192"):
        Lattice.around(CUBE, resolution)


@pytest.mark.parametrize("bounds", [CUBE * 0, CUBE * np.nan, CUBE[::-1], CUBE * np.inf], ids=str)
def test_box_refused(bounds):
    with pytest.raises(BadInput, match="box"), np.errstate(invalid="ignore"):
        Lattice.around(bounds, 32)


@pytest.mark.parametrize(("spacing", "shape"), [(0.0, (2, 2, 2)), (np.nan, (2, 2, 2)), (1.0, (2, 1, 2))])
def test_lattice_refused(spacing, shape):
    with pytest.raises(BadInput, match="lattice"):
        Lattice(np.zeros(3), spacing, shape)
