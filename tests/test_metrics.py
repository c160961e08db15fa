"""Metrics on cases made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from validate import metrics
from validate.metrics import FOOTPRINT, IMAGE, Seen, fitted_order, singular_values, summary


def seen(*jacobians: list[list[float]], t: float = 1.0) -> Seen:
    jacobian = np.array(jacobians, np.float64)
    n = len(jacobian)
    z = np.tile([0.0, 0.0, 1.0], (n, 1))
    return Seen(np.full(n, t), z, np.zeros((n, 2)), jacobian, np.zeros(n, np.int64), voxel=0.1)


CIRCLE, WIDE = [[4.0, 0.0], [0.0, 4.0]], [[8.0, 0.0], [0.0, 4.0]]
TALL, TURNED = [[4.0, 0.0], [0.0, 8.0]], [[0.0, 8.0], [-4.0, 0.0]]


def test_equal_views_have_no_error() -> None:
    truth = seen(CIRCLE, WIDE, [[3.0, 1.0], [-2.0, 0.5]])
    for metric in FOOTPRINT:
        values = metric.function(truth, truth)
        # The Wasserstein distance is the root of a difference that cancels: sqrt(eps).
        np.testing.assert_allclose(values, 0.0, atol=1e-7 if metric.name == "wasserstein" else 1e-15)


def test_hit_error_counts_voxels() -> None:
    assert metrics.hit_error(seen(CIRCLE, t=1.25), seen(CIRCLE)) == pytest.approx([2.5])


def test_misses_are_counted_both_ways() -> None:
    there, gone = seen(CIRCLE), seen(CIRCLE, t=np.inf)
    assert [metrics.missed(a, b)[0] for a in (there, gone) for b in (there, gone)] == [0, 1, 1, 0]


@pytest.mark.parametrize("angle", [1e-9, 0.3, 2.0, np.pi])
def test_normal_angle_is_exact_when_small(angle: float) -> None:
    turned = replace(seen(CIRCLE), n=np.array([[np.sin(angle), 0.0, np.cos(angle)]]))
    assert metrics.normal_angle(turned, seen(CIRCLE))[0] == pytest.approx(np.degrees(angle), rel=1e-12)


def test_jacobian_error_is_relative() -> None:
    error = metrics.jacobian_error(seen(WIDE, CIRCLE), seen(CIRCLE, [[0.0, 0.0], [0.0, 0.0]]))
    assert error == pytest.approx([4.0 / np.sqrt(32.0), 1.0])


def test_levels_of_detail() -> None:
    # Columns (8, 0) and (0, 4): the longer is 8 texels, level 3; a circle of 4 is level 2.
    assert metrics.lod(seen(WIDE, CIRCLE).jacobian) == pytest.approx([3.0, 2.0])
    # Turning the pixel axes by 45 degrees shortens the longer column of eq. 25 but not the singular value.
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
    turned = seen(np.array(WIDE) @ turn)
    assert metrics.lod_invariant_error(turned, seen(WIDE)) == pytest.approx([0.0], abs=1e-14)
    assert metrics.lod_error(turned, seen(WIDE)) == pytest.approx([3.0 - np.log2(np.hypot(8, 4) / np.sqrt(2))])
    assert metrics.singular_ratio(seen(WIDE), seen(CIRCLE)) == pytest.approx([1.0])


def test_a_footprint_without_extent_stays_finite() -> None:
    nothing = seen([[0.0, 0.0], [0.0, 0.0]])
    for metric in FOOTPRINT:
        for pair in ((nothing, seen(CIRCLE)), (seen(CIRCLE), nothing), (nothing, nothing)):
            assert np.isfinite(metric.function(*pair)).all(), metric.name


def test_major_axis_turns_by_a_right_angle() -> None:
    assert metrics.axis_angle(seen(TALL), seen(WIDE)) == pytest.approx([90.0])
    # TURNED has columns (0, -4) and (8, 0): the same ellipse as WIDE seen with other pixel axes.
    assert metrics.axis_angle(seen(TURNED), seen(WIDE)) == pytest.approx([0.0], abs=1e-12)


def test_wasserstein_between_aligned_ellipses_is_their_axes_distance() -> None:
    # Aligned ellipses (8, 4) and (4, 4): W = 4, relative to ||J*|| = sqrt 32; a rotation of the pixels changes nothing.
    assert metrics.wasserstein(seen(WIDE), seen(CIRCLE)) == pytest.approx([4.0 / np.sqrt(32.0)])
    assert metrics.wasserstein(seen(TURNED), seen(CIRCLE)) == pytest.approx([4.0 / np.sqrt(32.0)])


def test_singular_values_match_linalg() -> None:
    jacobian = np.random.default_rng(2).normal(size=(200, 2, 2))
    np.testing.assert_allclose(singular_values(jacobian), np.linalg.svd(jacobian)[1], atol=1e-14)


def test_chart_mismatch() -> None:
    other = replace(seen(CIRCLE, WIDE), chart=np.array([0, 3]))
    assert metrics.chart_mismatch(other, seen(CIRCLE, WIDE)).tolist() == [0.0, 1.0]


def test_image_metrics() -> None:
    black, grey = np.zeros((4, 5, 3)), np.full((4, 5, 3), 0.1)
    mse, psnr = (metric.function(grey, black)[0] for metric in IMAGE if metric.name != "flip")  # its own file
    assert (mse, psnr) == (pytest.approx(0.01), pytest.approx(20.0))
    assert metrics.image_psnr(grey, grey)[0] == 200.0


def test_summary_of_known_values() -> None:
    record = summary(np.arange(101) / 100.0)
    assert record["count"] == 101 and record["mean"] == pytest.approx(0.5)
    assert (record["p50"], record["p95"], record["p99"], record["max"]) == pytest.approx((0.5, 0.95, 0.99, 1.0))
    assert record["share>0.5"] == pytest.approx(50 / 101) and record["share>1"] == 0.0
    assert summary(np.zeros(0)) == {"count": 0.0}


def test_summary_refuses_what_is_not_finite() -> None:
    with pytest.raises(ValueError, match="1 of 3"):
        summary(np.array([0.0, np.nan, 1.0]))


def test_fitted_order_stops_before_round_off() -> None:
    steps = 0.5 ** np.arange(5)
    errors = np.maximum(3.0 * steps**3, 1e-2)
    assert fitted_order(steps, errors, floor=1e-2) == pytest.approx(3.0)
    assert fitted_order(steps, errors) < 2.9
    assert fitted_order(steps, np.zeros(5)) == 0.0


def test_uv_error_counts_texels() -> None:
    truth = replace(seen(CIRCLE), texels=512.0)
    moved = replace(truth, uv=np.array([[3.0, -4.0]]) / 512.0)
    assert metrics.uv_error(moved, truth) == pytest.approx([5.0])
