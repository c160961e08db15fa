"""The report from made-up runs: complete, self-contained, the same bytes twice; and what the sections say."""

from dataclasses import replace
from pathlib import Path

import click.testing
import numpy as np
import pytest
from contest import baking_runs, misses_runs, picture_runs, rendering_runs

from sdfbake.complaint import BadInput
from validate.__main__ import cli
from validate.experiment import Bench, Run, read_runs, timed, write_runs
from validate.metrics import FOOTPRINT, summary
from validate.report import LONG_TABLE, render, write_report
from validate.section import number
from validate.sections import convergence, representations
from validate.suites import SUITES
from validate.timing import Timing

RESOLUTIONS = (16.0, 32.0, 64.0, 128.0)


def convergence_runs() -> list[Run]:
    """Errors of exactly the expected orders."""
    runs = []
    for kernel, orders in convergence.EXPECTED.items():
        for n in RESOLUTIONS:
            errors = dict(zip(("value", "gradient", "shape_operator"), orders, strict=True))
            values = {f"{name}.p50": 0.3 * (8 / n) ** order for name, order in errors.items()} | {"spacing": 2 / n}
            runs.append(Run("convergence", "sphere", {"kernel": kernel}, {"resolution": n}, "error", values))
    return runs


def frontier_runs() -> list[Run]:
    runs = []
    for engine, cost in (("numpy", 20.0), ("drjit", 1.0)):
        for n in RESOLUTIONS:
            setup, knob = {"kernel": "bspline", "engine": engine}, {"resolution": n}
            values = {"beam.p50": 1 / n**2, "beam.p95": 2 / n**2, "missed": 0.0, "spacing": 2 / n}
            runs.append(Run("frontier", "sphere, one mirror bounce", setup, knob, "error", values))
            timing = Timing((cost * n * 1e-3,) * 3, (0.5,))
            runs.append(timed("frontier", "sphere, one mirror bounce", setup, knob, timing, rays=1000))
    return runs


def footprint_runs(bench: Bench) -> list[Run]:
    rng = np.random.default_rng(3)
    values = {"pixels": 100.0, "missed": 0.0, "seam": 0.1, "chart_mismatch": 0.01}
    for metric in FOOTPRINT[:-1]:
        for prefix in ("", "inside."):
            figures = summary(rng.random(100))
            values |= {f"{prefix}{metric.name}.{key}": figure for key, figure in figures.items()}
    error = rng.random((16, 16)).astype(np.float16)
    error[:4] = np.nan
    artefact = bench.store("map", lod_error=error)
    primary = []
    for uv, share in (("faces", 0.001), ("grid", 0.25)):
        for kernel in ("bspline", "linear"):
            setup, off = {"route": "baked grid", "uv": uv, "kernel": kernel}, {"lod_error.share>0.5": share}
            run = Run("footprints", "bunny, primary rays", setup, {"resolution": 512}, "error", values | off)
            primary.append(replace(run, artefact=artefact))
    mesh = Run("footprints", "torus, one mirror bounce", {"route": "mesh, facets"}, {}, "error", values)
    return [*primary, mesh]


def representation_runs(bench: Bench) -> list[Run]:
    """The bunny at two resolutions: faces all right, layers within what is asked for, grids wrong at a quarter."""
    shares = {"faces": (0.0, 0.0), "layers": (0.004, 0.0009), "grid": (0.01, 0.25)}
    rng = np.random.default_rng(4)
    image = np.full((16, 16, 3), 128, np.uint8)
    artefact = bench.store("view", image=image, lod_error=rng.random((16, 16)).astype(np.float16))
    runs = []
    for mode, (wrong, off) in shares.items():
        setup = {"uv": mode, "kernel": "bspline"}
        values = {f"{name}.{key}": figure for name in ("uv", "lod") for key, figure in summary(rng.random(9)).items()}
        values |= {"points": 1e5, "wrong_chart": wrong, "seam": 0.0, "lod.share>0.5": off, "bytes": 4.2e6}
        runs += [Run("representations", "bunny", setup, {"resolution": n}, "error", values) for n in (64, 256)]
        view = Run("representations", "bunny, a view", setup, {"resolution": 64}, "error", {"lod.share>0.5": off})
        runs.append(replace(view, artefact=artefact))
        timing = Timing((0.25,), ())
        runs.append(timed("representations", "bunny", setup, {"resolution": 256}, timing, rays=10**6))
    return runs


def engine_runs() -> list[Run]:
    values = {f"{name}.{key}": 1e-12 for name in ("t", "n", "uv", "jacobian") for key in ("p50", "p99", "max")}
    setups = [{"engine": "drjit", "precision": precision} for precision in ("64", "32")]
    runs = [Run("engines", "mirror", s, {"resolution": 64}, "error", values | {"missed": 0.0}) for s in setups]
    for setup, seconds in (({"engine": "numpy", "precision": "64"}, 2.0), (setups[1], 0.1)):
        runs.append(timed("engines", "mirror", setup, {"resolution": 64}, Timing((seconds,), ()), rays=100))
    return runs


def figure_runs(bench: Bench) -> list[Run]:
    image = np.full((8, 8, 3), 128, np.uint8)
    reference = Run("figures", "reference", {"grid": "none"}, {}, "error", artefact=bench.store("ref", image=image))
    artefact = bench.store("figure", image=image, error=np.full((8, 8), 0.1, np.float16))
    names = {"figure-5": 0.04, "figure-6-cubic": 0.01}
    return [reference] + [
        Run("figures", name, {"grid": grid}, {}, "error", {"mse": mse, "psnr": 20.0}, artefact=artefact)
        for name, mse in names.items()
        for grid in ("exact", "baked")
    ]


def opinion_runs() -> list[Run]:
    values = {"samples": 1000.0, "wrong_sign": 3.0, "distance.p50": 1e-7, "distance.p99": 2e-7, "distance.max": 4e-6}
    return [Run("opinion", "torus", {"peer": "Open3D"}, {"resolution": 64}, "error", values)]


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A JSON-lines file with runs of every suite, one of them failed."""
    folder = tmp_path_factory.mktemp("runs")
    bench = Bench(folder, folder)
    failed = Run("engines", "mirror", {"engine": "drjit", "precision": "16"}, {}, "error", status="failed: no <LLVM>")
    runs = [
        *figure_runs(bench),
        *footprint_runs(bench),
        *representation_runs(bench),
        *convergence_runs(),
        *frontier_runs(),
        *engine_runs(),
        *opinion_runs(),
        *baking_runs(),
        *rendering_runs(),
        *misses_runs(),
        *picture_runs(),
        failed,
    ]
    write_runs(folder / "all.jsonl", runs)
    return folder / "all.jsonl"


def _report(*arguments: object) -> click.testing.Result:
    return click.testing.CliRunner().invoke(cli, ["report", *map(str, arguments)], catch_exceptions=False)


@pytest.fixture(scope="module")
def page(lines: Path) -> str:
    assert _report(lines, "-o", lines.parent / "first").exit_code == 0
    return (lines.parent / "first" / "index.html").read_text(encoding="utf-8")


def test_every_section_is_there_and_nothing_is_fetched(page: str, lines: Path) -> None:
    for suite in {run.suite for run in read_runs([lines])}:
        assert f'<section id="{suite}">' in page
    for part in ("At a glance", "Machine", "Versions", "Commit", "Commands"):
        assert part in page
    assert "http://" not in page and "https://" not in page and "<script src" not in page
    assert page.count("<img") == page.count('src="data:image/')
    assert "nan" not in page.partition("<body>")[2].partition("base64")[0].lower()


def test_same_runs_give_the_same_bytes(lines: Path, page: str, tmp_path: Path) -> None:
    _report(lines, "-o", tmp_path)
    assert (tmp_path / "index.html").read_text(encoding="utf-8") == page
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]


def test_failed_runs_are_shown(page: str) -> None:
    assert "Runs without a result" in page and "failed: no &lt;LLVM&gt;" in page


def test_findings_are_written_from_the_numbers(page: str) -> None:
    assert "divides the mean square error by 4." in page  # 0.04 over 0.01
    assert "bspline: fitted orders 4.00, 3.00, 2.00" in page
    assert "Of 1,000 samples, 3 have another sign" in page
    assert "20 times as fast as NumPy" in page  # 2 s over 0.1 s
    assert "swapped against the text" in page
    assert "off by as much in 0.1 % against 25 % at 512³" in page
    assert "wrong chart at 0.4 % of the points and a level of detail off by more than a half at 0.09 %; within" in page
    assert "off by more than a half at 25 % of the points at 64³ (0.09 % as layers, 0 % as faces) and" in page
    assert "4.2 MB as faces" in page and "0.25 µs as grid" in page


def test_goals_that_are_missed_are_named() -> None:
    setup, values = {"uv": "faces", "kernel": "bspline"}, {"points": 1e5, "seam": 0.0, "bytes": 1.0}
    values |= {f"{name}.{key}": 0.1 for name in ("uv", "lod") for key in ("p50", "p95", "p99")}
    values |= {"wrong_chart": 0.0, "lod.share>0.5": 2e-4}
    found = representations.section([Run("representations", "bunny", setup, {"resolution": 256}, "error", values)])
    assert "NOT within the 0.01 % and 0.01 % asked for" in found.finding[0]
    assert found.headlines[0].figure == "0 % / 0.02 %"


def test_orders_ignore_what_float32_rounding_hides() -> None:
    runs = [run for run in convergence_runs() if run.setup["kernel"] == "bspline"]
    assert convergence.orders(runs) == pytest.approx((4.0, 3.0, 2.0))
    fine = Run(
        "convergence",
        "sphere",
        {"kernel": "bspline"},
        {"resolution": 256.0},
        "error",
        # Rounding noise: below eps / 2 times the spacing to the power of 1, 0, -1.
        {"value.p50": 1e-10, "gradient.p50": 5e-8, "shape_operator.p50": 5e-6, "spacing": 2 / 256},
    )
    assert convergence.orders([*runs, fine]) == pytest.approx((4.0, 3.0, 2.0))


@pytest.mark.parametrize("suite", SUITES)
def test_a_suite_whose_runs_all_failed_still_has_its_section(suite: str) -> None:
    setup = {"kernel": "linear", "engine": "numpy", "precision": "64", "route": "baked grid", "grid": "exact"}
    page = render([Run(suite, "sphere", setup, {"resolution": 64}, "error", status="failed: why")])
    assert f'<section id="{suite}">' in page and "failed: why" in page
    assert "Not run: " in page


def test_long_tables_are_folded_and_captions_numbered() -> None:
    runs = [run for run in engine_runs() if run.kind == "error"]
    many = [replace(run, knob={"resolution": n}) for run in runs for n in range(64, 64 + LONG_TABLE)]
    short, long = render(runs), render(many)
    assert "<details" not in short and long.count("<details>") == 1
    assert "<b>Table 1.</b>" in short and "<b>Table 2.</b>" not in short


def test_bad_runs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no runs"):
        write_report([], tmp_path)
    with pytest.raises(BadInput, match="'stranger'"):
        write_report([Run("stranger", "p", {}, {}, "error")], tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_unknown_suites_are_refused() -> None:
    result = click.testing.CliRunner().invoke(cli, ["run", "nonsense", "-o", "x.jsonl"])
    assert result.exit_code == 2 and not Path("x.jsonl").exists()


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (None, "-"), (0.12345, "0.123"), (12.345, "12.3"), (1234.5, "1,234"), (3.456e-7, "3.5e-7")],
)
def test_numbers_are_short(value: float | None, text: str) -> None:
    assert number(value) == text
