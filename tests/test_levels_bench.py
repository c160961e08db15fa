"""What levels by footprint are off by and save: the runs on a small grid, and what the report says of them."""

from dataclasses import replace

import pytest

from datasets_synthetic import shape
from sdfbake import bake
from sdfbake.engine import choose
from sdfrender.levelreach import SHARE
from validate.experiment import Bench
from validate.sections.levels import section
from validate.suites import levels


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("levels")
    (folder / "grids").mkdir()
    bake(shape("torus").mesh(0.3), 48, levels=2).save(folder / "grids" / f"levels-bunny@{levels.RESOLUTION}.zarr.zip")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"SIZES": (12, 6), "SMALL": 12, "TRUTH": 2, "RAYS": 64, "SAMPLED": (40, 1)}.items():
            patch.setattr(levels, name, value)
        patch.setattr(levels, "SHARES", (SHARE, 4.0))
        patch.setattr(levels, "choose", lambda _: choose("numpy", 64))
        return list(levels.run(Bench(folder, folder)))


def chosen(runs, problem, share):
    return [run for run in runs if run.kind == "error" and run.problem == problem and run.knob.get("share") == share]


def test_the_finest_is_off_by_nothing(runs):
    assert all(run.ok for run in runs), [run.status for run in runs if not run.ok]
    for run in (*chosen(runs, levels.BUNNY, 0.0), *chosen(runs, levels.BOUNCE, 0.0)):
        assert run.values["hit.p95"] == run.values["normal.p95"] == run.values["missed"] == 0


def test_errors_grow_with_the_share(runs):
    """And stay below a voxel, which is at most the share of a pixel."""
    (one, far), (four, farther) = (chosen(runs, levels.BUNNY, share) for share in (SHARE, 4.0))
    assert 0 < far.values["hit.p95"] <= farther.values["hit.p95"] < 4.0
    assert one.values["hit.p95"] <= four.values["hit.p95"]
    assert far.values["coarsest_px"] <= 1.5 * SHARE  # where it enters the box it is a little narrower


def test_less_is_read_from_far(runs):
    read = {run.setup["levels"]: run.values for run in runs if run.problem == levels.FAR and run.kind == "error"}
    assert read[levels.FOOTPRINT]["bricks"] < 0.5 * read[levels.FINEST]["bricks"]
    assert read[levels.FOOTPRINT]["bytes"] < read[levels.FINEST]["bytes"] and read[levels.FOOTPRINT]["first"] == 2


def test_the_section(runs, undrawn):
    found = section(runs)
    assert len(found.tables[0].rows) == 4 * 3 and all(len(row) == 12 for row in found.tables[0].rows)
    said = " ".join(found.finding)
    assert "pixels of the finest level" in said and "the exact shape" in said and "times as long" in said
    assert "of the bytes" in said and len(found.headlines) == 2 and len(found.pictures) == 1
    assert section([]).finding == ("No run succeeded.",)


def test_the_section_without_some_runs(runs, undrawn):
    bare = section([run for run in runs if run.kind == "error" and run.problem != levels.FAR])
    assert bare.pictures == () and "times as long" not in " ".join(bare.finding)
    failed = section([replace(run, status="failed: so") for run in runs])
    assert failed.finding == ("No run succeeded.",)
