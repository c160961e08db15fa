"""Runs on disk, guarded runs, timing, and the Pareto front."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdfbake.complaint import BadInput
from validate import timing
from validate.experiment import Bench, Run, guarded, read_runs, timed, write_runs
from validate.frontier import pareto
from validate.timing import Timing, measure


def run(**changes: object) -> Run:
    given = {
        "suite": "s",
        "problem": "p",
        "setup": {"kernel": "bspline"},
        "knob": {"resolution": 64.0},
        "kind": "error",
    }
    return Run(**{**given, **changes})


def test_round_trip(tmp_path: Path) -> None:
    runs = [run(values={"p50": 1e-300}, samples={"seconds": [0.1, 0.2]}), run(status="failed: why")]
    write_runs(tmp_path / "a.jsonl", runs)
    assert read_runs([tmp_path / "a.jsonl"]) == runs
    assert runs[0].ok and not runs[1].ok


def test_every_run_says_what_it_ran_on() -> None:
    record = run()
    assert {"processor", "cores", "memory", "system", "python"} <= set(record.machine)
    assert "numpy" in record.versions and record.command and record.commit


def test_not_finite_is_never_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_runs(tmp_path / "a.jsonl", [run(values={"p50": float("nan")})])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("line", ["not json", "[1, 2]", '{"suite": "s"}', '{"artefact": ""}'])
def test_broken_lines_are_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "a.jsonl"
    write_runs(path, [run()])
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(BadInput, match="line 2"):
        read_runs([path])


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"gone\.jsonl"):
        read_runs([tmp_path / "gone.jsonl"])
    with pytest.raises(BadInput, match="make report"):
        Bench(tmp_path, tmp_path).grid("bunny", 64)


def test_artefacts_lie_beside_the_lines(tmp_path: Path) -> None:
    name = Bench(tmp_path, tmp_path / "runs").store("map", error=np.arange(3.0))
    write_runs(tmp_path / "runs" / "a.jsonl", [run(artefact=name)])
    (record,) = read_runs([tmp_path / "runs" / "a.jsonl"])
    with np.load(record.artefact) as arrays:
        assert arrays["error"].tolist() == [0.0, 1.0, 2.0]


def test_failures_become_records() -> None:
    def fail() -> Run:
        raise ValueError("two\nlines")

    def bad() -> Run:
        raise BadInput("no such file")

    assert guarded(run(), fail).status == "failed: ValueError: two lines"
    assert guarded(run(), run).ok
    assert guarded(run(), bad).status == "failed: no such file"


def test_measure_keeps_every_sample_and_the_warm_up_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.accumulate([0.0, 9.0, 0.0, 1.0, 0.0, 3.0, 0.0, 2.0])
    monkeypatch.setattr(timing.time, "perf_counter", lambda: next(clock))
    calls: list[int] = []
    taken = measure(lambda: calls.append(1), repeats=3, warm_up=1)
    assert taken == Timing(samples=(1.0, 3.0, 2.0), warm_up=(9.0,)) and len(calls) == 4
    record = timed("s", "p", {}, {}, taken, rays=4)
    assert record.values == {"seconds": 2.0, "first_seconds": 9.0, "us_per_ray": 5e5}
    assert json.loads(json.dumps(record.samples)) == {"seconds": [1.0, 3.0, 2.0], "warm_up": [9.0]}


coordinate = st.integers(0, 6).map(float)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(coordinate, coordinate), max_size=12))
def test_the_front_is_what_nothing_beats(points: list[tuple[float, float]]) -> None:
    error, cost = np.array(points).reshape(-1, 2).T
    front = pareto(error, cost).tolist()
    for i, p in enumerate(points):
        beaten = any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)
        first = points.index(p) == i
        assert (i in front) == (not beaten and first)
