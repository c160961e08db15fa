"""The benchmark of renderers: the closed form, the processes, turns, first frames, and what the report says."""

from dataclasses import replace

import numpy as np
import pytest
from contest import rendering_runs

from datasets_synthetic.sphere import Sphere
from sdfrender import Camera
from validate.experiment import Bench, Run
from validate.peers.catalogue import MITSUBA, OURS, RENDERERS, Found, find
from validate.peers.frames import JOBS, MIRROR, PRIMARY
from validate.peers.paces import LABELS, LIMITS, label_of, ours, paired, ratio
from validate.sections.rendering import _quicker, section
from validate.suites import rendering
from validate.suites.rendering import Entry, judge, seen

NOWHERE = Found(replace(RENDERERS[1], module="nowhere"), problem="no such module")


@pytest.fixture
def off_middle(monkeypatch):
    """A sphere whose axes cannot be exchanged unseen."""
    monkeypatch.setattr(rendering, "SPHERE", Sphere(0.8, (0.1, -0.06, 0.04)))


def test_the_truth_is_what_the_camera_sees(off_middle):
    rays = Camera(rendering.EYE, (0, 0, 0), fov=2 * np.degrees(np.arctan(rendering.SLOPE)), size=(40, 40)).rays()
    truth = rendering.SPHERE.intersect(rays.p, rays.d)
    assert 0.3 < np.isfinite(truth).mean() < 0.9
    # Directions round to 2e-16, and silhouettes are 1e-3 away: as many hits, at the same places.
    np.testing.assert_allclose(seen(40), truth, rtol=1e-12)


def test_what_was_seen_is_judged():
    truth = np.array([1.0, 2.0, np.inf, np.inf, 3.0, 4.0])
    right = judge({"t": truth}, truth, 0.5)
    assert right["wrong_pixels"] == right["missed_pixels"] == right["t.max"] == 0 and "met_again" not in right
    found = {"t": np.array([1.25, 2.0, 7.0, np.inf, np.inf, 4.0]), "t2": np.array([1.0, *[np.inf] * 5])}
    wrong = judge(found, truth, 0.5)
    assert (wrong["wrong_pixels"], wrong["missed_pixels"], wrong["met_again"]) == (2, 1, 1)
    assert wrong["t.max"] == 0.5 and wrong["t.p50"] == wrong["t.p50_world"] == 0
    with pytest.raises(ValueError, match="5 rays were traced, not 6"):
        judge({"t": truth[1:]}, truth, 0.5)
    with pytest.raises(ValueError, match="1 values of c0"):
        judge({"t": truth, "c0": np.array([np.nan, *[0.0] * 5])}, truth, 0.5)


def _entry(*options):
    setup = {"tool": OURS} | dict(zip(("engine", "precision", "kernel"), options, strict=True))
    return Entry(find(RENDERERS[0]), setup)


def test_renderers_take_turns_and_are_judged(tmp_path, monkeypatch, off_middle):
    monkeypatch.setattr(rendering, "ROUNDS", 2)
    theirs = find(RENDERERS[1])
    asked = [_entry("numpy", "64", "bspline")] + ([Entry(theirs, {"tool": MITSUBA})] if theirs.here else [])
    course = rendering._Course(32, tmp_path, 48)
    runs = list(rendering.race(Bench(tmp_path, tmp_path, quick=True), course, asked))
    assert all(run.ok for run in runs), [run.status for run in runs]
    assert [run.problem for run in runs if run.setup["tool"] == OURS and run.kind == "timing"] == list(JOBS)
    for run in runs:
        if run.kind == "timing":
            assert len(run.samples["seconds"]) == len(run.samples["warm_up"]) == 1 and run.values["seconds"] > 0
            assert run.values["us_per_ray"] == run.values["seconds"] * 1e6 / 48**2
        elif run.setup["tool"] == OURS:
            # The B-spline is off by h^4 f''''/ 300 or so, h = 0.13 and f'''' near 9 / r^3: 1e-4, in voxels 1e-3.
            assert run.values["wrong_pixels"] == 0 and run.values["t.p50"] < 1e-3
            assert run.values.get("met_again", 0) == 0
        else:
            # Trilinear: h^2 / (8 r) per axis, 0.02 voxel; an exchanged axis would be off by a voxel.
            assert run.values["t.p50"] < 0.1 and run.values["wrong_pixels"] < 48


def test_first_frames(tmp_path, monkeypatch):
    pytest.importorskip("drjit")
    if rendering.choose().engine.name != "drjit":
        pytest.skip("no Dr.Jit here")
    monkeypatch.setattr(rendering, "JOBS", (PRIMARY,))
    courses = [rendering._Course(n, tmp_path, 16) for n in (24, 20)]
    bench = Bench(tmp_path, tmp_path)
    (run,) = rendering._starts(bench, courses, [_entry("drjit", "32", "linear"), _entry("numpy", "64", "linear")])
    assert run.ok, run.status
    assert run.problem == "cold start, primary" and run.values["programs"] >= 1
    assert run.values["programs_again"] == 0
    # Compiling takes tenths of a second, a frame of 256 rays milliseconds.
    assert run.values["cold_frame"] > 5 * run.values["warm_frame"]


def test_missing_renderers_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(rendering, "find", lambda peer: NOWHERE)
    monkeypatch.setattr(rendering, "QUICK", ())
    monkeypatch.setattr(rendering, "COLD", ())
    runs = list(rendering.run(Bench(tmp_path, tmp_path, quick=True)))
    assert [run.ok for run in runs] == [False, False]
    assert "make mitsuba" in runs[0].status and "no such module" in runs[0].status


def test_a_process_that_fails_leaves_failed_runs(tmp_path):
    entry = _entry("numpy", "64", "no-kernel")
    runs = list(rendering.race(Bench(tmp_path, tmp_path, quick=True), rendering._Course(16, tmp_path, 8), [entry]))
    assert [run.kind for run in runs] == ["timing"] * 3
    assert all("load" in run.status and "no-kernel" in run.status for run in runs)


def test_setups():
    found = [Found(peer, "python") for peer in RENDERERS]
    asked = rendering.entries(found)
    assert {label_of(entry.setup) for entry in asked} <= set(LABELS)
    assert asked[-1].jobs == (PRIMARY, MIRROR) and asked[0].jobs == JOBS
    assert len(rendering.entries(found, quick=True)) <= 3


def test_limits_find_their_figures():
    found = {limit.what: limit.measured(paired(rendering_runs())) for limit in LIMITS}
    assert found["Mirror, 64³, bspline with Hessian, Dr.Jit float32: time over Mitsuba's"] == pytest.approx(0.5)
    assert found["Mirror, 512³, bspline with Hessian, Dr.Jit float32: time over Mitsuba's"] is None
    top = "Differentials, texture coordinates and trilinear look-up on top, worst size: time over the mirror's"
    assert found[top] == pytest.approx(1.2)
    assert found["Mirror, float64 over float32, bspline, worst size"] == pytest.approx(2.0)
    assert found["Mirror on NumPy, float64, bspline, worst size: a frame"] == 2.5
    cold = "First frame and field, nothing compiled before, worst kernel: over the warm ones"
    assert found[cold] == pytest.approx(1.5)
    assert found["Programs that a second grid of another size compiles"] == 0
    assert found["Wrong pixels of the sphere, bspline, NumPy float64, worst size"] == 2
    assert found["Wrong pixels of the sphere, bspline, Dr.Jit float32, worst size"] == 0


def test_ratios_are_of_one_round():
    points = paired(rendering_runs())
    assert ratio(points, MIRROR, ours(), 64) == pytest.approx(0.5)
    # NumPy's one round is the first of the others.
    assert ratio(points, MIRROR, ours(precision="64", engine="numpy"), 64) == pytest.approx(2.5 / 0.2)


def test_the_section_is_written_from_the_numbers():
    failed = Run("rendering", MIRROR, {"tool": MITSUBA}, {"resolution": 128}, "timing", status="failed: why")
    written = section([*rendering_runs(), failed])
    said = " ".join(written.finding)
    assert "the mirror with the B-spline and its Hessian takes this share of Mitsuba's time: 0.5 at 64³" in said
    assert "Mitsuba is quicker than Dr.Jit float32, bspline at 64³ (first hits, 3 times Mitsuba's)" in said
    assert "Mitsuba: 272 at 64³" in said
    assert "1.5 s more than a warm one where nothing was ever compiled, and 0.3 s more" in said
    assert f"compile so many programs: 0 for {ours()}, 0 for Mitsuba." in said
    assert "not met: " in said and "Mirror on NumPy, float64, bspline, worst size: a frame (2.5 s)" in said
    assert [row[-1] for row in written.tables[0].rows].count("no") == 3
    assert len(written.tables) == 5 and written.pictures
    assert [row[1] for row in written.tables[2].rows if row[0] == "128³, Mitsuba"] == ["failed"]


def test_what_is_missing_is_said():
    failed = Run("rendering", MIRROR, {"tool": MITSUBA}, {"resolution": 128}, "timing", status="failed: why")
    assert "No renderer" in section([failed]).finding[0]
    alone = paired([run for run in rendering_runs() if run.setup["tool"] == OURS])
    assert "Mitsuba was not here" in _quicker(alone)[0]
