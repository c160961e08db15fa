"""Exact shapes and grids are asked the same way and give the same answers."""

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfbake import Grid
from sdfrender import Camera, Field, GridField, Rays, footprint, reflect, trace, transfer
from validate.exact import ShapeField


@pytest.fixture(scope="module")
def pair():
    """The torus as it is and as a grid of 64 samples."""
    exact = shape("torus")
    return ShapeField(exact), GridField(Grid.from_function(exact, 64), "bspline", "numpy")


def test_both_are_fields(pair):
    for field in pair:
        assert isinstance(field, Field)
        assert field.bounds.shape == (2, 3) and field.anchor.shape == (3,) and field.is_distance
    assert pair[0].part_names == pair[1].part_names == ("torus",)


def test_hits_agree(pair):
    """Off the silhouette (slope above 0.2) a hit moves by the value's error, 1e-3 of a spacing here, over the slope."""
    rays = Camera((0.0, 2.2, 2.6), (0.0, 0.0, 0.0), fov=40.0, size=(48, 48)).rays()
    exact, grid = (trace(field, rays.p, rays.d) for field in pair)
    slope = np.abs(np.einsum("ni,ni->n", exact.n, rays.d))
    both = exact.hit & grid.hit & (slope > 0.2)
    difference = np.where(both, exact.t, 0) - np.where(both, grid.t, 0)
    clear = both & (np.abs(difference) < 0.1)  # beyond, the two met different sides at a silhouette
    assert np.count_nonzero(exact.hit != grid.hit) <= 2
    assert clear.sum() > 0.8 * exact.hit.sum() > 500
    h = pair[1].grid.lattice.spacing
    assert np.abs(difference)[clear].max() < 1e-2 * h
    assert np.abs(exact.n - grid.n)[clear].max() < 1e-2
    assert np.array_equal(exact.part[clear], grid.part[clear])


def test_the_whole_way_agrees(pair):
    """Transfer, mirror, transfer, footprint: the medians differ by the grid's errors of curvature, under a percent."""
    rays = Camera((0.0, 2.2, 2.6), (0.0, 0.0, 0.0), fov=40.0, size=(48, 48)).rays()
    seen = []
    for field in pair:
        hits, moved = transfer(field, rays)
        seen.append((hits, reflect(field, hits, moved), footprint(field, hits, moved, size=(256, 256))))
    (hits, exact, print_), (other, grid, footprint_) = seen
    both = hits.hit & other.hit & (hits.flags == 0) & (footprint_.flags == 0)
    assert both.sum() > 500
    for name in ("dd_dx", "dd_dy"):
        a, b = getattr(exact, name)[both], getattr(grid, name)[both]
        assert np.median(np.linalg.norm(a - b, axis=1) / np.linalg.norm(a, axis=1)) < 1e-2
    assert np.median(np.abs(print_.uv - footprint_.uv)[both]) < 1e-4
    assert np.median(np.abs(print_.lod - footprint_.lod)[both]) < 1e-2


def test_a_start_on_the_surface_is_left(pair):
    """From the outer rim inward, through the tube: both are met again at its inner side, 2 * 0.3 away."""
    p, d = np.array([[1.0, 0.0, 0.0]]), np.array([[-1.0, 0.0, 0.0]])
    grid, exact = (trace(field, p, d, on_surface=True) for field in reversed(pair))
    assert grid.t[0] == pytest.approx(0.6, abs=1e-3) and exact.t[0] == pytest.approx(0.6, abs=1e-12)
    assert not any(trace(field, p, -d, on_surface=True).hit.any() for field in pair)


def test_misses_are_misses(pair):
    p, d = np.array([[0.0, 0.0, 3.0], [5.0, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    rays = Rays(p, d, *(np.zeros((2, 3)) for _ in range(4)))
    for field in pair:
        hits, moved = transfer(field, rays)
        assert np.isinf(hits.t).all() and (hits.flags & 1).all() and (hits.part == -1).all()
        assert np.array_equal(moved.p, p)
        seen = footprint(field, hits, moved)
        assert not seen.uv.any() and not seen.duv_dx.any() and (seen.chart == -1).all()
