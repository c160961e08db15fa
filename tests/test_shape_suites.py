"""The suites on every shape, every mesh, and every kernel and engine: small runs, and what is said of made-up ones."""

from dataclasses import replace

import numpy as np
import pytest

from datasets_synthetic import exact_names
from sdfbake.complaint import BadInput
from validate.experiment import Bench, Run, read_runs, write_runs
from validate.metrics import FOOTPRINT, UV_ERROR, summary
from validate.regions import CLASSES
from validate.sections import footprints as of_footprints
from validate.sections import matrix as of_matrix
from validate.sections import meshes as of_meshes
from validate.sections import shapes as of_shapes
from validate.suites import matrix, meshes, shapes


def values(error: float = 0.01) -> dict[str, float]:
    """What `compare` finds where every metric of every pixel is the same."""
    figures = summary(np.full(10, error))
    found = {"pixels": 10.0, "missed": 0.0, "missed.silhouette": 0.0, "missed.away": 0.0, "seam": 0.0}
    found["chart_mismatch"] = 0.002
    for prefix in ("", "inside.", "away.", *(f"{name}." for name in CLASSES)):
        for metric in (*FOOTPRINT[:-1], UV_ERROR):
            found |= {f"{prefix}{metric.name}.{key}": figure for key, figure in figures.items()}
    return found | {f"{name}.share": 0.25 for name in CLASSES}


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path, tmp_path, quick=True)


# ---- every shape -----------------------------------------------------------------------------------------------------
def test_a_small_run_over_the_sphere(bench) -> None:
    runs = list(shapes.run(replace(bench, only="sphere")))
    assert [run.status for run in runs] == ["ok"] * 4
    by = {(run.problem, run.setup["kernel"]): run.values for run in runs}
    mirrored = f"sphere, {shapes.MIRRORED}"
    # At 32 samples the curvature of the B-spline is off by 5e-4, that of the trilinear kernel by all of itself.
    assert (
        by[mirrored, "bspline"]["away.jacobian_error.p50"]
        < 2e-3
        < 0.3
        < by[mirrored, "linear"]["away.jacobian_error.p50"]
    )
    assert by[mirrored, "bspline"]["bar.covered"] > 0.95 > 0.3 > by[mirrored, "linear"]["bar.covered"]
    # A kernel without curvature is wrong alike at 32 and at 16; the B-spline gains more than fourfold.
    assert by[mirrored, "linear"]["coarse.mean"] < 1.2 * by[mirrored, "linear"]["interior.jacobian_error.mean"]
    assert by[mirrored, "bspline"]["coarse.mean"] > 4 * by[mirrored, "bspline"]["interior.jacobian_error.mean"]
    for found in by.values():
        assert found["missed.away"] == 0 and found["taylor.slope"] > 1.7


def failing(*_: object, **__: object) -> object:
    raise ValueError("not today")


def test_shapes_that_fail_are_records(bench, monkeypatch) -> None:
    monkeypatch.setattr(shapes, "shape", failing)
    runs = list(shapes.run(bench))
    assert {run.problem.split(",")[0] for run in runs} == set(exact_names())
    assert {run.status for run in runs} == {"failed: ValueError: not today"} and len(runs) == 4 * len(exact_names())
    with pytest.raises(BadInput, match="'teapot'"):
        list(shapes.run(replace(bench, only="teapot")))


def test_meshes_that_fail_are_records(bench, monkeypatch) -> None:
    monkeypatch.setattr(meshes, "mesh", failing)
    runs = list(meshes.run(bench))
    assert {run.problem for run in runs} == {*exact_names(), "cow", "bunny_textured"}
    assert {run.status for run in runs} == {"failed: ValueError: not today"}
    with pytest.raises(BadInput, match="'teapot'"):
        list(meshes.run(replace(bench, only="teapot")))


def shape_run(shape: str, kernel: str, covered: float, gain: float = 4.0, problem: str = shapes.MIRRORED) -> Run:
    found = values() | {"bar.covered": covered, "bar.covered.resolution": covered / 2, "bar.no_bar": 0.0}
    found |= {"bar.width": 7.0, "bar.width.resolution": 3.0, "coarse.p50": gain * 0.01, "coarse.p95": 5.0}
    found |= {"taylor.slope": 2.0, "taylor.right": 0.99}
    return Run(
        "shapes", f"{shape}, {problem}", {"route": "exact grid", "kernel": kernel}, {"resolution": 96}, "error", found
    )


def test_findings_say_where_bars_fail_and_why() -> None:
    runs = [
        shape_run("cone", "bspline", 0.99),
        shape_run("cone", "linear", 0.02, gain=1.0),
        shape_run("wall", "bspline", 0.5),
    ]
    said = " ".join(of_shapes.section(runs).finding)
    assert (
        "linear, mirrored onto an environment (cone 2 %): there the error of half the resolution is 1 to 1 times"
        in said
    )
    assert "B-spline, mirrored onto an environment (wall 50 %), although the error shrinks" in said
    assert "every footprint is the derivative" in said and "no bar" not in said
    section = of_shapes.section(runs[:1])
    assert "No shape and kernel has less than 90 %" in " ".join(section.finding)
    assert section.headlines[0].figure == "99 %"
    bare = replace(runs[0], values=runs[0].values | {"bar.no_bar": 0.9, "taylor.slope": 1.1})
    said = " ".join(of_shapes.section([bare]).finding)
    assert "no bar on the cone" in said and "NOT every footprint" in said


def test_bars_stand_side_by_side(bench) -> None:
    (first, *_) = of_shapes.section([shape_run("cone", "bspline", 0.99), shape_run("cone", "linear", 0.02)]).tables
    assert first.rows == (
        ("cone, mirrored onto an environment", "99 %", "7", "49.5 %", "3", "0 %", "2 %", "7", "1 %", "3", "0 %"),
    )
    assert len(first.header) == len(first.rows[0])


# ---- every mesh ------------------------------------------------------------------------------------------------------
def test_a_small_run_over_meshes(bench) -> None:
    box = list(meshes.run(replace(bench, only="box")))
    textured = list(meshes.run(replace(bench, only="bunny_textured")))
    assert [run.status for run in (*box, *textured)] == ["ok"] * 2
    for run in box:
        # Flat faces with affine texture coordinates come back to the rounding of float32 samples, off edges and seams.
        assert run.values["interior.jacobian_error.p50"] < 1e-5 and run.values["missed.away"] == 0
    write_runs(bench.artefacts / "meshes.jsonl", [*box, *textured])
    section = of_meshes.section(read_runs([bench.artefacts / "meshes.jsonl"]))
    assert "farthest from Embree is bunny textured 32³" in section.finding[0] and len(section.pictures) == 1
    assert "box 32³, B-spline" in {row[0] for row in section.tables[0].rows}


def test_the_cow_gets_an_atlas(monkeypatch) -> None:
    asked = []
    monkeypatch.setattr(meshes, "unwrap", lambda mesh: asked.append(mesh) or mesh)
    assert meshes._mapped(meshes.mesh("cow")).uv is None and len(asked) == 1
    assert meshes._mapped(meshes.mesh("sphere")).uv is not None and len(asked) == 1


# ---- kernels, engines, precisions ------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def small_matrix(tmp_path_factory):
    """The B-spline on every engine."""
    folder = tmp_path_factory.mktemp("matrix")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matrix, "KERNELS", ("bspline",))
        return list(matrix.run(Bench(folder, folder, quick=True)))


def test_a_64_grid_keeps_the_limits_on_every_engine_that_runs(small_matrix) -> None:
    ran = {(run.setup["engine"], run.setup["precision"]): run.values for run in small_matrix if run.ok}
    assert len(small_matrix) == len(matrix.ENGINES) and ("numpy", "64") in ran
    for found in ran.values():
        assert found[of_matrix.P50] <= 1e-3 and found[of_matrix.P95] <= 1e-2
    # Engines in float64 differ by rounding; second differences of samples make 1e-16 / h^2 = 1e-13 of it.
    if ("drjit", "64") in ran:
        p50 = [ran[engine, "64"][of_matrix.P50] for engine in ("numpy", "drjit")]
        assert p50[0] == pytest.approx(p50[1], abs=1e-11)


def test_limits_are_said_to_be_met_or_not(small_matrix) -> None:
    said = of_matrix._limit([run for run in small_matrix if run.ok])[0]
    assert " are met on " in said
    worse = [replace(run, values=run.values | {of_matrix.P95: 0.02}) for run in small_matrix if run.ok]
    assert " are NOT met on " in of_matrix._limit(worse)[0]
    assert of_matrix._headlines(worse)[0].figure.endswith(" / 0.02")


def test_orders_and_engines_are_put_into_words() -> None:
    runs = []
    for engine, precision in matrix.ENGINES:
        for k, n in enumerate(matrix.RESOLUTIONS):
            noise = 1.5 if precision == 32 and n == 128 else 1.0
            found = values() | {of_matrix.P50: noise * 0.01 * 0.25**k, "spacing": 2.0 / n}
            setup = {"kernel": "bspline", "engine": engine, "precision": str(precision)}
            runs.append(Run("matrix", matrix.PROBLEM, setup, {"resolution": n}, "error", found))
    section = of_matrix.section(runs)
    assert (
        "NumPy float64, median error of the footprint: bspline 0.01 at 32³ to 6.3e-4 at 128³, order 2.00."
        in section.finding
    )
    assert (
        "From Dr.Jit float64 to Dr.Jit float32 the median error changes by at most 50 % (bspline, 128³)."
        in section.finding
    )
    assert "From NumPy float64 to Dr.Jit float64 the median error changes by at most 0 %" in " ".join(section.finding)
    assert section.tables[0].rows[6] == ("bspline, 32³", *("0.01",) * 9)


# ---- what the report says of footprints ------------------------------------------------------------------------------
@pytest.mark.parametrize(("p95", "word"), [(0.1, "are met"), (0.3, "are NOT met")])
def test_the_limits_of_the_bunny(p95: float, word: str) -> None:
    found = values() | {"inside.lod_error.p95": p95, "edges.jacobian_error.p50": 0.07}
    setup = {"route": "baked grid", "uv": "faces", "kernel": "bspline"}
    run = Run("footprints", "bunny, primary rays", setup, {"resolution": 512}, "error", found)
    section = of_footprints.section([run])
    assert f"(95 %), {word}: 0.01 and {p95:g}" in section.finding[0]
    assert "0.07 near edges" in section.finding[0]
    (line,) = section.headlines
    assert line.figure == f"0.01 / {p95:g}" and line.against.endswith("at most 0.02 / 0.2")
    # No limit was asked for anywhere else.
    other = of_footprints.section([replace(run, problem="torus, primary rays")])
    assert "limits" not in other.finding[0] and "at most" not in other.headlines[0].against


def test_regions_have_a_column_each() -> None:
    setup = {"route": "baked grid", "uv": "faces", "kernel": "bspline"}
    run = Run("footprints", "torus, primary rays", setup, {"resolution": 64}, "error", values())
    table = of_footprints.by_region("by region", [run], of_footprints.label)
    assert table.rows[0][1:5] == ("25 %", "0.01", "0.01", "0.01") and len(table.rows[0]) == len(table.header) == 17
