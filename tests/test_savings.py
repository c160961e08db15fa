"""The account of what scenes leave out: the runs on a small grid, and what the report says of them."""

from dataclasses import replace

import pytest

from datasets_synthetic import shape
from sdfbake import Grid
from validate.experiment import Bench
from validate.sections.savings import section, share
from validate.suites import savings

SMALL = {"numpy": 12}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("savings")
    (folder / "grids").mkdir()
    for resolution in (savings.RESOLUTION, savings.LARGE):
        grid = Grid.from_function(shape("sphere"), 48 if resolution == savings.RESOLUTION else 96)
        grid.save(folder / "grids" / f"bunny@{resolution}.zarr.zip")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(savings, "SIZES", SMALL)
        patch.setattr(savings, "FEW", 8)
        return list(savings.run(Bench(folder, folder)))


def test_all_is_the_same_and_nothing_idle_is_done(runs):
    assert all(run.ok for run in runs), [run.status for run in runs if not run.ok]
    for run in (run for run in runs if run.kind == "error"):
        assert run.values.get("differing", 0.0) == 0 and run.values["planned.polynomials"] > 0
        assert not any(run.values[f"planned.{name}"] for name in savings.IDLE)
        if "full.hessians" in run.values:
            assert run.values["full.hessians"] > 0 and run.values["full.channels"] > 0
        assert run.values["bytes"] < run.values["of_bytes"]
        assert all(run.values[what] == run.values[f"said.{what}"] for what in ("bytes", "bricks"))
        assert 0 < run.values["said.drjit"] < 1 and 0 < run.values["said.numpy"] < 1


def test_a_part_is_read(runs):
    (tenth,) = (run for run in runs if run.kind == "error" and run.problem == savings.TENTH)
    assert 0 < tenth.values["in_sight"] < tenth.values["bricks"] / tenth.values["of_bricks"] < 1


def test_the_section(runs):
    found = section(runs)
    assert "the same to the last bit" in found.finding[0] and "none was done" in found.finding[0]
    assert len(found.tables[0].rows) == len(savings.CASES) and all(len(row) == 8 for row in found.tables[0].rows)
    assert any("to the byte" in sentence for sentence in found.finding) and "the plan had estimated" in found.finding[1]
    assert found.tables[0].rows[0][5].endswith("%)")
    assert share(runs, savings.FLAT, "numpy") > 0 and share(runs, savings.FLAT, "drjit") is None
    assert section([]).finding == ("No run succeeded.",)


def test_the_section_says_what_differs(runs):
    worse = [
        replace(run, values=run.values | {"differing": 3.0, "planned.hessians": 1.0, "said.bytes": 1.0, "bytes": 2.0})
        for run in runs
    ]
    assert "NOT those that the plan said" in section(worse).finding[-1]
    assert "NOT the same: " in section(worse).finding[0] and "SOME were done" in section(worse).finding[0]
