"""Comparisons of views made by hand: regions, what is summed up where, error bars, Taylor remainders."""

from dataclasses import replace

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfrender import Flag, Rays
from validate.bar import coverage, error_bar
from validate.closed import ExactReference
from validate.compare import compare
from validate.metrics import Seen
from validate.reflected import frames, on_environment
from validate.regions import CLASSES, NEAR, SILHOUETTE, near, regions
from validate.taylor import STEPS, displaced_rays, slopes
from validate.views import framing, seen

SHAPE = (24, 40)
COUNT = SHAPE[0] * SHAPE[1]


def flat(t: float = 3.0) -> Seen:
    """A wall that fills the picture, seen a little from the side, with a footprint of the unit matrix."""
    n = np.tile([0.0, 0.0, 1.0], (COUNT, 1))
    uv = np.zeros((COUNT, 2))
    depth = t + 1e-3 * np.add.outer(np.arange(SHAPE[0]), np.arange(SHAPE[1])).ravel()
    return Seen(depth, n, uv, np.tile(np.eye(2), (COUNT, 1, 1)), np.zeros(COUNT, np.int64), 0.1, 100.0)


def columns(first: int, last: int) -> np.ndarray:
    """Pixels in these columns."""
    mask = np.zeros(SHAPE, bool)
    mask[:, first:last] = True
    return mask.ravel()


def test_a_plain_wall_is_all_interior() -> None:
    found = regions(flat(), SHAPE)
    assert found["interior"].all() and not any(found[name].any() for name in CLASSES[:-1])


def test_each_pixel_has_the_first_class_that_holds() -> None:
    truth = flat()
    turned = np.where(columns(0, 30)[:, None], truth.n, [1.0, 0.0, 0.0])
    truth = replace(
        truth,
        t=np.where(columns(0, 8), np.inf, truth.t),  # misses to the left,
        chart=np.where(columns(0, 20), 0, 1),  # a cut between columns 19 and 20,
        n=turned,  # and an edge between 29 and 30
    )
    found = regions(truth, SHAPE)
    # A miss lies near the silhouette too, if the hits are near.
    assert np.array_equal(found["silhouette"], columns(8 - SILHOUETTE, 8 + SILHOUETTE))
    assert np.array_equal(found["seams"], columns(19 - NEAR, 21 + NEAR))
    assert np.array_equal(found["edges"], columns(29 - NEAR, 31 + NEAR))
    taken = np.sum([found[name] for name in CLASSES], axis=0)
    assert np.array_equal(taken, columns(8 - SILHOUETTE, 40).astype(int))


def test_a_break_of_depth_is_a_silhouette_and_a_slope_is_none() -> None:
    truth = flat()
    broken = replace(truth, t=truth.t + columns(20, 40) * 0.5)
    # Both pixels of the break count, and those within 5 of either.
    expected = columns(19 - SILHOUETTE, 21 + SILHOUETTE)
    assert np.array_equal(regions(broken, SHAPE)["silhouette"], expected)
    steep = replace(truth, t=truth.t + 0.2 * np.tile(np.maximum(np.arange(40) - 20, 0), SHAPE[0]))
    assert not regions(steep, SHAPE)["silhouette"].any()


def test_what_does_not_count_is_a_miss_and_flags_make_seams_and_edges() -> None:
    flags = np.zeros(COUNT, np.int64)
    flags[0], flags[1], flags[2] = Flag.SEAM, Flag.EDGE, Flag.SEAM | Flag.EDGE
    found = regions(flat(), SHAPE, ~columns(30, 40), flags)
    assert np.flatnonzero(found["seams"]).tolist() == [0, 2] and np.flatnonzero(found["edges"]).tolist() == [1]
    assert np.array_equal(found["silhouette"], columns(30 - SILHOUETTE, 30 + SILHOUETTE))


def test_near_is_a_disk() -> None:
    where = np.zeros((9, 9), bool)
    where[4, 4] = True
    y, x = np.indices(where.shape) - 4
    assert np.array_equal(near(where, 2), x**2 + y**2 <= 4)
    assert not near(np.zeros((3, 3), bool), 2).any()


def test_errors_are_summed_up_where_they_lie() -> None:
    truth = flat()
    truth = replace(truth, t=np.where(columns(0, 10), np.inf, truth.t), chart=np.where(columns(0, 30), 0, 1))
    wrong = np.where(columns(10, 15)[:, None, None], 2 * truth.jacobian, truth.jacobian)
    ours = replace(truth, jacobian=wrong, chart=np.where(columns(0, 31), 0, 1), uv=truth.uv + np.array([0.03, 0.04]))
    ours = replace(ours, t=np.where(columns(10, 11), np.inf, ours.t))
    flags = np.where(columns(28, 32), int(Flag.SEAM), 0)
    values = compare(ours, truth, SHAPE, flags=flags)
    assert values["pixels"] == 29 * 24
    assert values["missed"] == values["missed.silhouette"] == pytest.approx(1 / 30) and values["missed.away"] == 0
    assert values["chart_mismatch"] == pytest.approx(1 / 29) and values["seam"] == pytest.approx(4 / 29)
    # The doubled footprints are those near the silhouette, but for the column that is missed.
    assert values["silhouette.jacobian_error.p50"] == values["silhouette.jacobian_error.max"] == pytest.approx(1.0)
    assert values["away.jacobian_error.max"] == values["interior.jacobian_error.max"] == 0.0
    assert values["silhouette.pixels"] == 4 * 24 and values["silhouette.share"] == pytest.approx(4 / 29)
    assert sum(values[f"{name}.share"] for name in CLASSES) == pytest.approx(1.0)
    # 0.05 of 100 texels; the column on another chart has none.
    assert values["uv_error.p50"] == pytest.approx(5.0) and values["uv_error.count"] == 28 * 24


def test_misses_off_the_silhouette_are_told_apart() -> None:
    ours = flat()
    ours = replace(ours, t=np.where(columns(20, 21), np.inf, ours.t))
    values = compare(ours, flat(), SHAPE)
    assert values["missed.away"] == values["missed"] == pytest.approx(1 / 40) and values["missed.silhouette"] == 0


def halving(order: float, wrong: float = 0.01) -> tuple[Seen, Seen, Seen]:
    """Footprints that are off by `wrong` along one direction, by 2^order that at half the resolution, and the truth."""
    truth = flat()
    off = np.tile(np.array([[1.0, 2.0], [2.0, 0.0]]) / 3.0, (COUNT, 1, 1))  # of Frobenius norm 1
    fine, coarse = (replace(truth, jacobian=truth.jacobian + size * off) for size in (wrong, wrong * 2**order))
    return fine, coarse, truth


EVERYWHERE = np.ones(COUNT, bool)


@pytest.mark.parametrize(("order", "covered"), [(0.0, 0.0), (0.9, 0.0), (1.1, 1.0), (2.0, 1.0)])
def test_bars_hold_where_the_error_more_than_halves(order: float, covered: float) -> None:
    # |J_N - J_N/2| = (2^order - 1) |J_N - J*|; all footprints are alike, so that the neighbours add nothing.
    fine, coarse, truth = halving(order)
    bar = error_bar(fine, coarse, SHAPE)
    found = coverage(fine, bar, truth, EVERYWHERE)
    assert found["covered"] == found["covered.resolution"] == covered and found["no_bar"] == 0
    assert found["width"] == pytest.approx(2**order - 1)


def test_neighbours_widen_the_bar() -> None:
    fine, coarse, truth = halving(0.0)
    growing = 1.0 + 0.1 * np.tile(np.arange(40.0), SHAPE[0])[:, None, None]
    fine, coarse, truth = (replace(one, jacobian=one.jacobian * growing) for one in (fine, coarse, truth))
    bar = error_bar(fine, coarse, SHAPE)
    # Neighbours differ by 0.1 of the first column's footprint, whose size is sqrt(2) to the error.
    one = np.linalg.norm(np.eye(2) + 0.01 * np.array([[1.0, 2.0], [2.0, 0.0]]) / 3.0)
    np.testing.assert_allclose(bar.neighbours, 0.1 * one, rtol=1e-12)
    found = coverage(fine, bar, truth, EVERYWHERE)
    assert found["covered"] == 1.0 and found["covered.resolution"] == 0.0


def test_no_bar_without_a_twin() -> None:
    fine, coarse, truth = halving(1.5)
    coarse = replace(coarse, t=np.where(columns(0, 4), np.inf, coarse.t), chart=np.where(columns(4, 10), 1, 0))
    bar = error_bar(fine, coarse, SHAPE)
    assert np.array_equal(bar.known, ~columns(0, 10)) and not bar.whole[~bar.known].any()
    assert coverage(fine, bar, truth, EVERYWHERE)["no_bar"] == pytest.approx(0.25)
    assert coverage(fine, bar, truth, columns(0, 4)) == {"bars": 0.0, "no_bar": 1.0}
    assert coverage(fine, bar, truth, np.zeros(COUNT, bool)) == {"bars": 0.0, "no_bar": 0.0}


def test_an_exact_footprint_has_no_width_and_is_covered() -> None:
    truth = flat()
    found = coverage(truth, error_bar(truth, truth, SHAPE), truth, EVERYWHERE)
    assert found["covered"] == 1.0 and "width" not in found


@pytest.fixture(scope="module")
def torus_view():
    """Rays on the torus away from silhouettes, and what mirrored ones see."""
    exact = shape("torus")
    rays = framing(exact.bounds, 32, (0.35, 0.45, 1.0)).rays()
    reference = ExactReference(exact)
    hits, _ = reference.transfer(rays)
    keep = hits.hit & (np.abs(np.sum(hits.n * rays.d, axis=1)) > 0.4)
    chosen = Rays(*(getattr(rays, name)[keep] for name in ("p", "d", "dp_dx", "dp_dy", "dd_dx", "dd_dy")))
    return reference, chosen


def test_taylor_slopes_tell_right_derivatives_from_wrong(torus_view) -> None:
    reference, rays = torus_view
    hits, _ = reference.transfer(rays)
    jacobian = seen(hits).jacobian / 1024

    def look(moved):
        found, _ = reference.transfer(moved)
        same = found.chart == np.tile(hits.chart, 1 + 2 * len(STEPS))
        return np.where(same[:, None], found.uv, np.nan)

    right, wrong = slopes(look, rays, jacobian), slopes(look, rays, 1.01 * jacobian)
    assert right["taylor.pixels"] == wrong["taylor.pixels"] > 150
    # A third-order term of the size of the second changes the slope over steps from 1/8 to 1/64 by at most 1/10.
    assert right["taylor.slope"] == pytest.approx(2.0, abs=0.1) and right["taylor.right"] > 0.97
    # A hundredth of J, at steps of 1/64 of a pixel, outweighs what curvature does.
    assert wrong["taylor.slope"] < 1.5 and wrong["taylor.right"] < 0.2


def test_a_linear_view_has_no_remainder(torus_view) -> None:
    _, rays = torus_view
    jacobian = np.tile(np.array([[1.0, 2.0], [3.0, -1.0]]), (len(rays), 1, 1))
    steps = np.array([(0.0, 0.0), *(offset for e in STEPS for offset in ((e, 0.0), (0.0, e)))])
    found = slopes(lambda _: np.repeat(steps @ jacobian[0].T, len(rays), axis=0), rays, jacobian)
    assert found == {"taylor.pixels": float(len(rays)), "taylor.exact": 1.0}


def test_displaced_rays_keep_their_order(torus_view) -> None:
    _, rays = torus_view
    moved = displaced_rays(rays)
    assert len(moved.p) == len(rays) * (1 + 2 * len(STEPS))
    np.testing.assert_allclose(moved.d[: len(rays)], rays.d, atol=1e-15)
    # The second block is the first step to the right, to the rounding of normalising.
    step = moved.d[len(rays) : 2 * len(rays)] - rays.d
    assert np.linalg.norm(step - STEPS[0] * rays.dd_dx, axis=1).max() < np.linalg.norm(rays.dd_dx, axis=1).max() ** 2


def test_the_environment_shows_how_mirrored_rays_turn(torus_view) -> None:
    """The footprint is d(direction)/d(pixel), 1024 texels around, in a frame of unit vectors across the ray."""
    reference, rays = torus_view
    hits, at = reference.transfer(rays)
    mirrored = reference.reflect(hits, at)
    frame = frames(mirrored.d, np.array([0.0, 0.6, -0.8]))
    # The frame divides roundings of 1e-16 by 1 - cos of the angle to the singular direction, above 1e-3 here.
    np.testing.assert_allclose(frame @ np.swapaxes(frame, 1, 2), np.tile(np.eye(2), (len(rays), 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", frame, mirrored.d), 0.0, atol=1e-12)
    view = on_environment(hits.hit, hits.t, hits.n, mirrored, frame)
    # d.dd = 0, so that the two components hold all of dd.
    length = np.linalg.norm(mirrored.dd_dx, axis=1) * 1024 / (2 * np.pi)
    np.testing.assert_allclose(np.linalg.norm(view.jacobian[:, :, 0], axis=1), length, rtol=1e-11)
    np.testing.assert_allclose(view.uv, 0.0, atol=1e-13)
