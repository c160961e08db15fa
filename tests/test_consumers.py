"""Exported grids in other programs: those that are here read them; the comparison finds what is wrong; what is said."""

from dataclasses import replace

import numpy as np
import pytest

from sdfbake.engine import choose
from sdfbake.export import FORMATS, export
from validate.experiment import Bench, Run
from validate.peers.catalogue import Found, pythons
from validate.peers.consumers import CONSUMERS, UNTRIED
from validate.peers.process import Process
from validate.peers.proof import DIFFER, Check, judged
from validate.peers.specimens import SPECIMENS, specimen
from validate.sections.consumers import LIMITS, section
from validate.suites import consumers
from validate.suites.consumers import Exports, proven

RESOLUTION = 48
NOWHERE = Found(CONSUMERS[0].peer, problem="no such module")
IDS = [f"{one.format}-{one.peer.name}" for one in CONSUMERS]


@pytest.fixture(scope="module", params=CONSUMERS, ids=IDS)
def reader(request):
    """A consumer that is here, and its process: as `find` looks for it, but started once."""
    choose()  # it names the LLVM library to all of them
    peer, problems = request.param.peer, []
    for python in pythons():
        with Process(python, f"validate.peers.{peer.module}") as process:
            try:
                found = Found(peer, python, process.hello())
            except RuntimeError as error:
                problems.append(f"{python}: {error}")
                continue
            yield request.param, found, process
            return
    pytest.skip(f"{peer.name} is not here: {'; '.join(problems)}; to have it: {peer.install}")


@pytest.mark.parametrize("name", SPECIMENS)
def test_programs_read_what_was_exported(reader, name, tmp_path):
    consumer, found, process = reader
    given, path = specimen(name, RESOLUTION), tmp_path / f"grid{FORMATS[consumer.format].suffix}"
    export(given.grid, path, consumer.format)
    runs = proven(consumer, found, process, Exports(given, tmp_path, {consumer.format: path}, {}))
    assert [run.status for run in runs if not run.ok] == []
    off = {run.setup["check"]: run.values for run in runs if run.values["passed"] != 1}
    assert not off and len(runs) >= 3
    assert len(set(given.grid.lattice.shape)) > 1 and given.margin > 2  # voxels: no other order of the axes comes near


def _answer(given):
    """What a program that is right answers."""
    asked, grid = given.question, given.grid
    at = tuple(asked.samples.T)
    (between,) = given.linear.jet(asked.points, 0)
    return {
        "value": given.values[at],
        "position": grid.lattice.to_world(asked.samples),
        "between": between,
        "t": given.t.copy(),
    }


FAULTS = {
    "mirrored": lambda given, a: a | {"value": np.flip(given.values, 0)[tuple(given.question.samples.T)]},
    "positive inside": lambda given, a: a | {"value": -a["value"]},
    "in voxels": lambda given, a: a | {"value": a["value"] / given.grid.lattice.spacing},
    "half a voxel off": lambda given, a: a | {"position": a["position"] + given.grid.lattice.spacing / 2},
    "not a number": lambda given, a: a | {"between": np.where(a["between"] > 0, a["between"], np.nan)},
    "farther": lambda given, a: a | {"t": a["t"] + 0.02 * given.grid.lattice.spacing},
    "one in ten missed": lambda given, a: a | {"t": np.where(np.arange(len(a["t"])) % 10 == 0, np.inf, a["t"])},
    "no hit at all": lambda given, a: a | {"t": np.full(len(a["t"]), np.inf)},
}


def test_the_truth_passes():
    given = specimen("box and sphere", RESOLUTION)
    checks = judged(given, _answer(given), {})
    assert [check.what for check in checks if not check.passed] == []
    assert {check.what for check in checks} == {
        "values",
        "signs",
        "positions",
        "between samples",
        "hits, p99",
        "hit or miss",
    }
    assert not Check("values", 0.0, 0.0, DIFFER, 0).passed  # what compared nothing has not passed


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_is_found(fault):
    given = specimen("box and sphere", RESOLUTION)
    checks = judged(given, FAULTS[fault](given, _answer(given)), {})
    assert any(not check.passed for check in checks)


def test_level_sets_are_held_to_their_band():
    given = specimen("box and sphere", RESOLUTION)
    half = np.float32(3 * given.grid.lattice.spacing)
    band = int((given.known & (np.abs(given.values) < half)).sum())
    right = {"value": _answer(given)["value"], "background": np.array([half]), "active_voxels": np.array([band])}
    level = {"class": "level set"}
    assert all(check.passed for check in judged(given, right, level))
    for name, wrong in (("active_voxels", [band - 1]), ("background", [half * 1.01]), ("invalid", [False, True])):
        assert not all(check.passed for check in judged(given, right | {name: np.array(wrong)}, level)), name
    assert not all(check.passed for check in judged(given, right, {"class": "unknown"}))


def test_what_answers_nothing_has_not_passed():
    with pytest.raises(ValueError, match="nothing to compare: colour"):
        judged(specimen("box and sphere", RESOLUTION), {"colour": np.zeros(3)}, {})


def test_missing_programs_are_not_checked(tmp_path, monkeypatch):
    monkeypatch.setattr(consumers, "find", lambda peer: replace(NOWHERE, peer=peer))
    monkeypatch.setattr(consumers, "SPECIMENS", {})
    monkeypatch.setattr(consumers.browser, "found", lambda: None)
    runs = list(consumers.run(Bench(tmp_path, tmp_path, quick=True)))
    assert len(runs) == len(CONSUMERS) + len(UNTRIED) + 1
    assert all(run.status.startswith("not checked: ") for run in runs) and "make consumers" in runs[0].status
    said = section(runs)
    assert f"Not checked: {CONSUMERS[0].peer.name} (vdb)" in said.finding[-2] and "agree" not in said.finding[0]
    assert {row[-1] for row in said.tables[0].rows} == {"not checked"} and not said.headlines


def test_an_export_that_fails_is_said(tmp_path):
    given = specimen("box and sphere", RESOLUTION)
    path = tmp_path / "grid.zarr.zip"
    assert "there is no format" in consumers.commanded(path, "stl", tmp_path / "grid.stl")
    made = Exports(given, path, {}, {"vdb": "export to vdb: error: why"})
    (run,) = proven(CONSUMERS[0], replace(NOWHERE, python="python"), None, made)
    assert run.status == "failed: ValueError: export to vdb: error: why" and run.setup["check"] == "all"


def _run(check, figure, limit, consumer="OpenVDB", format_="vdb", resolution=64, problem="bunny"):
    setup = {"format": format_, "consumer": consumer, "check": check, "unit": "voxel"}
    values = {"figure": figure, "limit": limit, "count": 7.0, "passed": float(figure <= limit), "margin": 9.0}
    return Run("consumers", problem, setup, {"resolution": resolution}, "error", values)


def _cost(format_, resolution, **values):
    return Run("consumers", "bunny", {"format": format_, "check": "cost"}, {"resolution": resolution}, "timing", values)


RUNS = [
    _run("values", 0.0, 0.0),
    _run("positions", 2e-5, 1e-4),
    _run("hits, p99", 0.002, 0.01, "Mitsuba", "vol", 256),
    _run("hits, p99", 0.02, 0.01, "Mitsuba", "vol", 64, "ellipsoid"),
    _cost("vdb", 512, seconds=2.0, load_seconds=1.0, file_bytes=55e6, above_mb=500.0),
    _cost("vti", 256, seconds=1.0, load_seconds=1.0, file_bytes=221e6, above_mb=10.0, slab_mb=8.0),
]


def test_limits_find_their_figures():
    assert [limit.measured(RUNS) for limit in LIMITS] == pytest.approx([0.002, 0.0, 2.0, 55.0, 1.25])
    assert [limit.measured([]) for limit in LIMITS] == [None] * len(LIMITS)


def test_the_section_is_written_from_the_numbers():
    written = section(RUNS)
    said = " ".join(written.finding)
    assert "Of 3 files read by 2 pairs of format and program, 2 agree; not vol in Mitsuba (ellipsoid)." in said
    assert "off by at least 9 voxels" in said and "hit is 0.02 voxel" in said
    assert "not met: Memory of a dense export above the grid, worst format (1.25 slabs)" in said
    assert [row[-1] for row in written.tables[0].rows] == ["agrees", "agrees", "no: hits, p99"]
    assert written.tables[0].rows[0][3] == "2.0e-5 (positions)"
    assert written.headlines[0].figure == "2 of 3" and written.headlines[0].met is False
