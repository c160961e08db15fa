"""Automatic differentiation against closed forms: of small programs, of the kernels; what the report says of it."""

from dataclasses import replace

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.complaint import BadInput
from sdfbake.engine import choose
from sdfbake.engine.choose import _jit_problem
from sdfrender import GridField
from validate.autodiff import automatic, closed_form, differentiable_field, inside_cells
from validate.experiment import Bench, Run, timed
from validate.sections.derivatives import LIMIT, section
from validate.suites import derivatives
from validate.timing import Timing

needs_jit = pytest.mark.skipif(_jit_problem() is not None, reason="Dr.Jit cannot run here")
KERNELS = ("linear", "catmull-rom", "bspline")


@pytest.fixture(scope="module")
def distance():
    return Grid.from_function(shape("torus"), 32, uv_mode="none")


@pytest.fixture(scope="module")
def noise():
    return Grid.from_dense(np.random.default_rng(3).normal(size=(12, 12, 12)))


def places(grid, count=400):
    """Points in cells with samples all around, off their faces."""
    rng = np.random.default_rng(4)
    if grid.metadata.source == "dense":
        return inside_cells(grid, rng.uniform(2.0, 9.0, (count, 3)))
    turn, around = rng.uniform(0, 2 * np.pi, (2, count))
    radius = 0.7 + 0.3 * np.cos(around)
    return inside_cells(grid, np.stack([radius * np.cos(turn), radius * np.sin(turn), 0.3 * np.sin(around)], axis=1))


@needs_jit
def test_a_program_is_differentiated_lane_by_lane():
    """x y + sqrt(x), and a choice whose other way has no derivative: ten roundings."""

    def program(xp, x, y):
        return {"f": x * y + xp.sqrt(x), "g": xp.where(x > 2.0, y * y, xp.full(x, 7.0))}

    x, y = np.array([1.0, 4.0, 9.0]), np.array([2.0, -3.0, 0.5])
    values, slopes = choose("drjit", 64).engine.differentiable().derivatives(program, [x, y])
    assert values["f"] == pytest.approx(x * y + np.sqrt(x), rel=1e-15)
    assert slopes["f"][0] == pytest.approx(y + 0.5 / np.sqrt(x), rel=1e-15)
    assert slopes["f"][1] == pytest.approx(x, rel=1e-15)
    assert slopes["g"][0].tolist() == [0.0] * 3 and slopes["g"][1].tolist() == [0.0, -6.0, 1.0]


@needs_jit
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", ["distance", "noise"])
def test_the_kernels_derivatives_are_those_of_the_value(name, kernel, request):
    """Each is a sum of 64 products in float64, of samples up to five voxels: 1e-12 of the Hessian's size, see LIMIT."""
    grid = request.getfixturevalue(name)
    points = places(grid)
    ours = automatic(differentiable_field(grid, kernel, 64), points)
    for theirs in (
        closed_form(GridField(grid, kernel, "drjit", 64), points),
        closed_form(GridField(grid, kernel, "numpy"), points),
    ):
        for a, b in ((ours.gradient, theirs.gradient), (ours.hessian, theirs.hessian)):
            assert np.abs(b).max() > 0.1
            assert np.abs(a - b).max() < LIMIT * np.abs(b).max()


@needs_jit
def test_a_wrong_derivative_of_a_kernel_shows(distance, monkeypatch):
    """Second derivatives of weights that are a hundredth too large."""
    from sdfrender import kernels

    right = kernels.Kernel.derivative
    monkeypatch.setattr(kernels.Kernel, "derivative", lambda self, order: right(self, order) * (1 + (order == 2) / 100))
    points = places(distance)
    ours = automatic(differentiable_field(distance, "bspline", 64), points)
    theirs = closed_form(GridField(distance, "bspline", "drjit", 64), points)
    assert np.abs(ours.gradient - theirs.gradient).max() < 1e-13
    assert np.abs(ours.hessian - theirs.hessian).max() > 1e-3 * np.abs(ours.hessian).max()


def test_points_on_faces_are_left_out(noise):
    points = np.array([[5.5, 5.5, 5.5], [5.5, 6.0, 5.5], [5.5, 5.5, 7.0 - 1e-4], [5.002, 5.5, 5.5]])
    assert inside_cells(noise, points).tolist() == [points[0].tolist(), points[3].tolist()]


def test_an_engine_that_does_not_differentiate_is_refused(noise):
    with pytest.raises(TypeError, match="differentiable_field"):
        automatic(GridField(noise, "linear", "numpy"), np.array([[5.5, 5.5, 5.5]]))


def test_without_dr_jit_every_run_says_why(tmp_path, monkeypatch):
    def missing(*wish):
        raise BadInput("the engine drjit cannot run here: not installed")

    monkeypatch.setattr("validate.suites.derivatives._plain", missing)
    monkeypatch.setattr("validate.suites.derivatives._recording", missing)
    monkeypatch.setattr(derivatives, "RESOLUTION", 16)
    monkeypatch.setattr(derivatives, "KERNELS", ("linear",))
    runs = list(derivatives.run(Bench(tmp_path, tmp_path, quick=True)))
    assert runs and all(run.status == "failed: the engine drjit cannot run here: not installed" for run in runs)
    assert section(runs).finding == ("No run succeeded, so the two ways were not compared.",)


@needs_jit
def test_the_suite_runs_small(tmp_path, monkeypatch):
    monkeypatch.setattr(derivatives, "RESOLUTION", 16)
    monkeypatch.setattr(derivatives, "KERNELS", ("linear",))
    runs = list(derivatives.run(Bench(tmp_path, tmp_path, quick=True)))
    assert {run.status for run in runs} == {"ok"}
    assert [run.kind for run in runs].count("timing") == 4 and len(runs) == 12
    assert all(run.values["finite"] == 1.0 for run in runs if run.kind == "error")
    assert len(section(runs).pictures) == 1


def made_up(difference, seconds=0.3):
    """Two ways that differ by so much, the second three times as slow as the first."""
    runs = []
    for way, time in (("closed form", 0.1), ("automatic", seconds)):
        setup, knob = {"kernel": "bspline", "precision": "64", "way": way}, {"points": 10}
        values = {f"{name}.p50": 1e-14 for name in ("gradient", "hessian")}
        run = Run("derivatives", "sphere", setup, knob, "error", values)
        if way == "automatic":
            agreed = {f"ways.{name}.{key}": difference for name in ("gradient", "hessian") for key in ("p50", "max")}
            run = replace(run, values=values | agreed)
        runs += [run, timed("derivatives", "sphere", setup, knob, Timing((time,), ()), rays=10)]
    return runs


def test_the_finding_follows_the_numbers():
    good, bad = section(made_up(3e-14)), section(made_up(3e-3))
    assert "within the limit" in good.finding[0] and "3.0e-14" in good.finding[0]
    assert "beyond the limit" in bad.finding[0]
    assert "3 to 3 times as long" in good.finding[1]
    assert good.headlines[0].figure == "3.0e-14" and len(good.tables) == 2
    assert len(section([run for run in made_up(1e-14) if run.kind == "error"]).pictures) == 0
