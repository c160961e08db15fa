from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfbake import Grid
from sdfrender import Camera, GridField
from sdfrender.render import shoot
from sdfrender.viewing import CameraView
from validate import metrics
from validate.experiment import Bench, Run, read_runs, timed, write_runs
from validate.sections import filtering as said
from validate.sections.filtering import needed
from validate.shifted import EIGHT, FINE, STILL, ShiftedView, moved, parted
from validate.suites import filtering
from validate.timing import Timing

ERRORS = {"flip": 0.1, "rmse": 0.1, "mse": 0.01, "psnr": 20.0, "edges": 0.1, "edges.share": 0.5}
ERRORS |= {"edges.rmse": 0.2, "inside.rmse": 0.1, "flicker": 0.05}


def made_up(cost: dict[str, float], *, bench: Bench | None = None) -> list[Run]:
    """Bare samples whose error falls as 0.8 / N, and one look-up by footprint with an error of 0.1."""
    image, error = np.full((8, 8, 3), 90, np.uint8), np.full((8, 8), 0.1, np.float16)
    artefact = "" if bench is None else str(bench.artefacts / bench.store("crop", image=image, flip=error))
    truth = {"rmse": 0.001, "flip": 0.002, "change": 0.03}
    runs = [Run("filtering", "page", {"filter": "truth"}, {"samples": 128}, "error", truth, artefact=artefact)]
    for name in ("point", "bilinear", "anisotropic"):
        for samples in (1, 4, 16):
            setup, knob = {"filter": name}, {"samples": samples}
            figure = 0.1 if name == "anisotropic" else 0.8 / samples
            values = ERRORS | {"flip": figure, "rmse": figure, "edges.rmse": 2 * figure, "inside.rmse": 5 * figure}
            runs.append(Run("filtering", "page", setup, knob, "error", values, artefact=artefact))
            if name in cost:
                timing = timed("filtering", "page", setup, knob, Timing((1.0,), ()))
                runs.append(replace(timing, values=timing.values | {"us_per_pixel": cost[name] * samples}))
    return runs


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """A build with a coarse grid of the sheet, whose front is flat on any."""
    folder = tmp_path_factory.mktemp("build")
    (folder / "grids").mkdir()
    Grid.from_function(shape("sheet"), 32).save(folder / "grids" / "exact-sheet@128.zarr.zip")
    return Bench(folder, folder, only="checker at a grazing angle", quick=True)


def test_samples_between_two_lie_on_a_line_of_logarithms() -> None:
    samples = np.array([1.0, 4.0, 16.0])
    assert needed(samples, 0.8 / samples, 0.1) == pytest.approx(8.0)
    assert needed(samples, 0.8 / samples, 0.9) == 1.0
    assert needed(samples, 0.8 / samples, 0.01) is None


def test_the_finding_follows_the_numbers() -> None:
    found = said.section(made_up({"point": 2.0, "bilinear": 2.0, "anisotropic": 4.0}))
    # 8 samples at 2 µs each against one at 4.
    assert "point sampling needs 8 samples and 4 times the time" in found.finding[0]
    assert found.headlines[0].figure == "8 / 4 x"
    assert "0.05 (point)" in found.finding[1] and "changes by 0.03" in found.finding[1]
    assert "divide the error of one bilinear sample by 8, elsewhere by 8" in found.finding[2]


def test_a_scene_without_a_clock_tells_samples_only(tmp_path: Path) -> None:
    found = said.section(made_up({}, bench=Bench(tmp_path, tmp_path)))
    assert "needs 8 samples (by root mean square, 8 samples)" in found.finding[0] and not found.headlines
    assert found.tables[0].rows[1][-1] == "-"


def test_where_footprints_buy_nothing_that_is_said() -> None:
    runs = [replace(run, values=run.values | {"rmse": 0.1, "flip": 0.1}) for run in made_up({})]
    assert "footprints buy nothing" in said.section(runs).finding[0]


def test_where_no_number_of_samples_is_enough_that_is_said() -> None:
    runs = [run for run in made_up({}) if run.knob["samples"] != 16]
    assert "needs more than 4 samples, where its error is 0.2" in said.section(runs).finding[0]


def test_shifts_are_every_other_quarter() -> None:
    assert len(EIGHT) == len(set(EIGHT)) == 8
    assert np.bincount([i for i, _ in EIGHT]).tolist() == np.bincount([j for _, j in EIGHT]).tolist() == [2] * FINE


def test_a_moved_film_is_cut_from_the_picture_of_quarters() -> None:
    x = (np.arange(6 * FINE) + 0.5) / FINE  # a ramp: the mean of a pixel is the place of its middle
    fine = np.broadcast_to(x[None, :, None], (3 * FINE, 6 * FINE, 1)).copy()
    assert moved(fine, (0, 0))[1, :, 0] == pytest.approx(np.arange(6) + 0.5)
    assert moved(fine, (3, 2))[:2, :5, 0] == pytest.approx(np.broadcast_to(np.arange(5) + 0.5 + 0.75, (2, 5)))


@pytest.mark.parametrize("per_axis", [1, 2])
def test_a_still_view_is_the_cameras(per_axis: int, build: Bench) -> None:
    camera = Camera((0.0, 0.0, 2.0), (0.1, 0.0, 0.0), size=(6, 4))
    views = CameraView(camera, per_axis, None), ShiftedView(camera, per_axis, STILL)
    scene = filtering._scene(build, build.build, filtering.VIEWS["text close up"], 8)
    stage = filtering.prepare(scene, engine="numpy")
    theirs, ours = (shoot(replace(stage, view=view))["rgb"] for view in views)
    assert np.array_equal(theirs, ours) and isinstance(stage.field, GridField)


def test_a_view_moved_by_a_quarter_sees_what_a_camera_of_quarters_does(build: Bench) -> None:
    view = filtering.VIEWS["checker at a grazing angle"]
    scene = filtering._scene(build, build.build, view, 8)
    stage = filtering.prepare(scene, engine="numpy")
    # Two samples per pixel lie at quarters 1 and 3: in the middle of no quarter pixel, but at the corner of four. Four
    # samples per pixel lie in the middles of quarters, and so does every shift of them.
    fine = shoot(replace(stage, view=CameraView(view.camera.camera((8 * FINE, 8 * FINE)), 1, None)))["rgb"]
    ours = parted(shoot(replace(stage, view=ShiftedView(view.camera.camera((8, 8)), FINE, EIGHT)))["rgb"], EIGHT)
    truth = np.stack([moved(fine, shift) for shift in EIGHT])
    assert ours[:, :-1, :-1] == pytest.approx(truth[:, :-1, :-1], abs=1e-9)  # sums in another order


def test_flicker_is_what_changes_beyond_the_truth(rng: np.random.Generator) -> None:
    truth = rng.random((8, 5, 4, 3))
    blur = rng.random((5, 4, 3))
    assert metrics.FLICKER.function(truth + blur, truth) == pytest.approx(np.zeros(20), abs=1e-12)
    sign = np.where(np.arange(8) % 2, 0.2, -0.2)[:, None, None, None]
    assert metrics.FLICKER.function(truth + sign, truth) == pytest.approx(np.full(20, 0.2))


def test_the_suite_on_a_small_sheet(build: Bench) -> None:
    write_runs(build.artefacts / "filtering.jsonl", filtering.run(build))
    runs = read_runs([build.artefacts / "filtering.jsonl"])
    assert all(run.ok for run in runs), [run.status for run in runs if not run.ok]
    grazing = {(run.setup["filter"], run.knob["samples"]): run.values for run in runs if run.kind == "error"}
    # At one sample a look-up by footprint is nearer to the truth and steadier than one of the finest texels, by far.
    assert grazing["anisotropic", 1]["rmse"] < 0.7 * grazing["point", 1]["rmse"]
    assert grazing["anisotropic", 1]["flicker"] < 0.5 * grazing["point", 1]["flicker"]
    clock = [run.values["us_per_pixel"] for run in runs if run.kind == "timing"]
    assert len(clock) == len(filtering.SAMPLES) and min(clock) > 0
