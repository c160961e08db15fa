"""Footprints through bounces: what they are compared by, the suite in small, and what is said of made-up runs."""

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfrender import Camera
from validate.beam import MeshRays
from validate.closed import ExactReference
from validate.experiment import Bench, Run
from validate.metrics import summary
from validate.sections import bounces as said
from validate.suites import bounces


def test_the_wall_is_met_where_it_is():
    """From the origin with dd across: J = R dd; along a ray that starts off it, by differences of the closed form."""
    d = np.array([[0.0, 0.0, 1.0]])
    across, zero = np.array([[1e-3, 0.0, 0.0]]), np.zeros((1, 3))
    (j,) = bounces.on_wall(MeshRays(zero, d, zero, zero, across, zero), 4.0)
    assert j == pytest.approx(np.array([[4e-3, 0.0], [0.0, 0.0], [0.0, 0.0]]), abs=1e-18)
    p, dp = np.array([[1.0, 0.5, 0.2]]), np.array([[0.3, -0.2, 0.1]])

    def met(e):
        o, v = p + e * dp, d + e * across
        v = v / np.linalg.norm(v)
        along = np.sum(o * v)
        return o + (np.sqrt(along**2 + 16 - np.sum(o * o)) - along) * v

    (j,) = bounces.on_wall(MeshRays(p, d, dp, zero, across, zero), 4.0)
    # Central differences over 1e-4: 1e-8 of curvature, 1e-12 of rounding.
    assert j[:, 0] == pytest.approx((met(1e-4) - met(-1e-4))[0] / 2e-4, abs=1e-7)


@pytest.mark.parametrize("way", bounces.WAYS, ids=lambda way: way.name)
def test_every_way_leads_somewhere(way):
    """After three bounces there are rays left, none of them near grazing on the way."""
    truth = bounces.closed_truth(way, way.rays(24))
    assert truth.clear[-1].sum() >= 8
    assert (truth.clear <= truth.hit).all() and (truth.hit[1:] <= truth.hit[:-1]).all()
    assert (np.diff(truth.clear.astype(int), axis=0) <= 0).all()
    assert np.isfinite(truth.jacobian).all()


def test_grazing_rays_do_not_count():
    """On the sphere |d . n| is below 0.2 where a ray passes the centre at more than sqrt(1 - 0.04) r = 0.98 r."""
    way = bounces.WAYS[3]
    rays = way.rays(96)
    truth = bounces.closed_truth(way, rays)
    past = np.linalg.norm(np.cross(rays.p, rays.d), axis=1) / 0.8
    assert np.array_equal(truth.hit[0], past < 1)
    assert np.array_equal(truth.clear[0], past < np.sqrt(1 - 0.04))
    assert (truth.hit[0] & ~truth.clear[0]).sum() > 20


def test_relative_errors_are_what_was_planted():
    truth = np.random.default_rng(1).normal(size=(50, 3, 2))
    figures = bounces.relative(1.25 * truth, truth, np.arange(50) < 30)
    assert figures["p50"] == pytest.approx(0.25) and figures["max"] == pytest.approx(0.25) and figures["count"] == 30


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """One way and the mirrored sphere, small."""
    patch = pytest.MonkeyPatch()
    patch.setattr(bounces, "WAYS", (bounces.WAYS[5],))
    patch.setattr(bounces, "ENGINE", "numpy")  # small pictures: compiling would be most of the time
    folder = tmp_path_factory.mktemp("runs")
    runs = list(bounces.run(Bench(folder, folder, quick=True)))
    patch.undo()
    return runs


def test_the_suite_runs_small(small):
    assert {run.status for run in small} == {"ok"}
    by = {(run.problem, run.setup["kernel"], run.knob.get("resolution"), run.knob.get("bounces")): run for run in small}
    way = bounces.WAYS[5].name
    for k in range(4):
        trusted, exact = by[way, bounces.TRUTH, None, k].values, by[way, bounces.EXACT, None, k].values
        assert trusted["compared"] > 0.9 * trusted["rays"] > 10
        # A wide pixel's bar is what the truth is held to; an optical path of a few roundings, grown by its bounces.
        assert trusted["difference.p95"] < max(trusted["bar.p95"], 1e-9)
        assert exact["jacobian.p95"] < 1e-12
        spline = [by[way, "bspline", n, k].values for n in bounces.QUICK_RESOLUTIONS]
        for values in (exact, *spline):
            assert max(values[f"{name}.max"] for name in said.IDENTITIES) < said.IDENTITY
    error = [by[way, "bspline", 32, k].values["jacobian.p50"] for k in range(4)]
    assert error[0] < error[1] < 0.1 and error[3] < 0.2
    assert by[way, "linear", 32, 1].values["jacobian.p50"] > 0.3  # flat facets: the curvature is not there at all
    mirrored = by[bounces.SPHERE, "bspline", 24, None].values
    assert 0 < mirrored["environment.p50"] < 1e-2 and mirrored["left_out"] > 0.05
    assert said.section(small).pictures


def test_the_mirrored_footprint_is_that_of_displaced_rays():
    """What the mirrored sphere is held against: directions of neighbouring rays, (1e-3 px)^2 of a smooth function."""
    rays, _, mirrored = bounces._mirror(16)
    reference = ExactReference(shape("sphere"))

    def direction(x):
        camera = Camera((0.3, 0.4, 3.2), (0.0, 0.0, 0.0), fov=35.0, size=(16, 16))
        right = camera.frame()[1]
        d = rays.d / np.sum(rays.d * camera.frame()[0], axis=1, keepdims=True) + x * right
        moved = MeshRays(rays.p, d / np.linalg.norm(d, axis=1, keepdims=True), *(np.zeros((256, 3)) for _ in range(4)))
        hits, at = reference.transfer(moved)
        return hits.hit, reference.reflect(hits, at).d

    (low, before), (high, after) = direction(-1e-3), direction(1e-3)
    slope = np.abs(np.sum(rays.d * mirrored.d, axis=1) - 1)
    clear = low & high & (slope > 0.3)
    assert clear.sum() > 50
    ours, theirs = bounces.turning(mirrored)[clear, :, 0], ((after - before) / 2e-3)[clear]
    assert np.abs(ours - theirs).max() < 1e-4 * np.abs(ours).max()


def made_up(p50=1e-4, symplectic=1e-15):
    """Errors of order two in the spacing that double per bounce; the mirrored sphere at `p50`."""
    runs = []
    for n in (64, 128):
        values = {f"{on}.{key}": p50 * 64 / n for on in ("environment", "wall") for key in ("p50", "p95", "p99")}
        values |= {"pixels": 100.0, "left_out": 0.1, "spacing": 2 / n}
        runs.append(Run("bounces", said.SPHERE, {"kernel": "bspline"}, {"resolution": n}, "error", values))
        for k in range(4):
            figures = {f"jacobian.{key}": v for key, v in summary(np.full(9, 2.0**k * (1 / n) ** 2), ()).items()}
            figures |= {"spacing": 2 / n, "slope": 0.2, "left_out": 0.03, "missed": 0.0, "pixels": 9.0}
            figures |= {"symplectic.max": symplectic, "direction.max": 1e-16, "surface.max": 1e-16}
            knob = {"resolution": n, "bounces": k}
            runs.append(Run("bounces", "torus, glass", {"kernel": "bspline"}, knob, "error", figures))
    trust = {f"{name}.{key}": 1e-9 for name in ("difference", "bar") for key in ("p50", "p95")}
    runs.append(Run("bounces", "torus, glass", {"kernel": said.TRUTH}, {"bounces": 1}, "error", trust))
    return runs


def test_findings_follow_the_numbers():
    good, bad = said.section(made_up()), said.section(made_up(p50=2e-3, symplectic=1e-9))
    text, other = " ".join(good.finding), " ".join(bad.finding)
    assert "both within" in text and "not within" in other
    assert (
        good.headlines[0].met is True
        and bad.headlines[0].met is False
        and good.headlines[0].figure == "1.0e-4 / 1.0e-4"
    )
    assert "times 2 per bounce" in text and "order 2.0" in text
    assert "(within 1.0e-12" in text and "(beyond 1.0e-12" in other
    assert "by 1.0e-9 at the most" in text
    assert said.section([]).finding == ("No run succeeded, so there is nothing to compare.",)
    failed = Run("bounces", "torus, glass", {"kernel": "bspline"}, {"bounces": 0}, "error", status="failed: why")
    assert "No run succeeded" in said.section([failed]).finding[0]
