"""The runner of stress cases: verdicts, stored rays, the command line, the replay; on cases made up for it."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from datasets_synthetic.sphere import Sphere
from sdfbake.complaint import BadInput
from validate.__main__ import cli
from validate.beam import MeshRays
from validate.course import Course
from validate.exact import ShapeField
from validate.experiment import Bench, write_runs
from validate.report import render
from validate.stress.case import Case, Check, Finding
from validate.stress.outcome import outcome, outcomes, usable
from validate.stress.replay import told, worst
from validate.suites import stress

NUMPY = "numpy 64"


def rays():
    p = np.array([[0.0, 0.0, 3.0], [0.3, 0.0, 3.0], [5.0, 0.0, 3.0]])
    d, x, y = (np.tile(row, (3, 1)) for row in ([0.0, 0.0, -1.0], [1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0]))
    none = np.zeros((3, 3))
    return MeshRays(p, d, none, none, x, y)


def course():
    return Course(ShapeField(Sphere(0.8)), (None,))


def made_up(choice):
    yield Check("fine", "relative", 1.0, lambda: Finding(np.array([0.5, 0.7, 0.1]), rays()), course)
    yield Check("exact", "count", 0.0, lambda: Finding(np.zeros(2, int)))
    yield Check("beyond", "voxel", 0.1, lambda: Finding(np.array([0.0, 0.0, 0.2]), rays()), course)
    yield Check("limit", "voxel", 0.1, lambda: Finding(np.array([0.3])), known="float32 has 24 bits")
    yield Check("infinite", "voxel", 1.0, lambda: Finding(np.array([0.3, np.inf, np.nan])))
    yield Check("raises", "voxel", 1.0, lambda: Finding(np.zeros(0)))


CASE = Case("made-up", "A made-up case", "What must hold.", made_up, (NUMPY,))


@pytest.fixture
def alone(monkeypatch):
    """The made-up case is the only one."""
    monkeypatch.setattr(stress, "cases", lambda: {"made-up": CASE})


def runs():
    return list(outcomes(CASE, NUMPY, usable()[NUMPY]))


def test_verdicts():
    found = {one.check: one for one in map(outcome, runs())}
    verdicts = {name: one.verdict for name, one in found.items()}
    assert verdicts == {
        "fine": "pass",
        "exact": "pass",
        "beyond": "fail",
        "limit": "known limit",
        "infinite": "fail",
        "raises": "broken",
    }
    assert found["fine"].figure == 0.7 and found["fine"].share == 0.7 and found["fine"].places == 3
    assert found["infinite"].nonfinite == 2 and found["infinite"].figure == 0.3
    assert found["exact"].share == 0 and found["limit"].known == "float32 has 24 bits"
    assert "looked at nothing" in found["raises"].known


def test_the_worst_ray_is_stored_and_replayed():
    found = [outcome(run) for run in runs()]
    chosen = worst(found)
    assert chosen.check == "beyond" and chosen.ray[0] == 5.0  # failures first; the third ray, which misses
    lines = list(told(CASE, chosen))
    assert lines[0].startswith("A made-up case") and lines[-1] == "  missed"
    fine = next(one for one in found if one.check == "fine")
    text = "\n".join(told(CASE, fine))
    # The second ray meets the sphere at sqrt(0.8^2 - 0.3^2) and is mirrored away from it.
    assert f"t {3 - np.sqrt(0.55):.12g}" in text and "curvature    1.25 1.25" in text
    assert text.count("step ") == 2 and text.rstrip().endswith("missed") and "symplectic" in text


def test_a_case_whose_preparation_fails_is_one_broken_run():
    def fails(choice):
        raise BadInput("no such grid")

    found = [outcome(run) for run in outcomes(Case("x", "X", "Y", fails), NUMPY, usable()[NUMPY])]
    assert [one.verdict for one in found] == ["broken"] and "no such grid" in found[0].known


def test_every_case_has_its_own_name_and_known_engines():
    from validate.stress import THEMES
    from validate.stress.case import SETUPS

    found = stress.cases()
    assert sum(len(__import__(f"validate.stress.{theme}", fromlist=["CASES"]).CASES) for theme in THEMES) == len(found)
    for name, case in found.items():
        assert name == name.lower() and " " not in name and case.holds.endswith(".")
        assert set(case.engines) <= set(SETUPS)


def command(*words):
    return CliRunner().invoke(cli, ["stress", *map(str, words)])


def test_command_line(alone, tmp_path):
    result = command("--json", "-o", tmp_path / "stress.jsonl")
    assert result.exit_code == 1  # one check fails that is no known limit
    checks = json.loads(result.stdout)["checks"]
    assert [one["verdict"] for one in checks].count("pass") == 2
    text = command().stdout
    assert "known limit of made-up: float32 has 24 bits" in text and "beyond" in text
    stored = command("--replay", "made-up", "--check", "fine", "--runs", tmp_path / "stress.jsonl")
    assert stored.exit_code == 0 and "fine on numpy 64: 0.7 relative, limit 1: pass" in stored.stdout
    assert stored.stdout == command("--replay", "made-up", "--check", "fine", "--runs", tmp_path / "none").stdout


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--only", "nonsense"), "there is no stress case 'nonsense': choose one of made-up"),
        (("--replay", "nonsense"), "there is no stress case"),
        (("--replay", "made-up", "--check", "odd"), "has no check 'odd': choose one of 'fine'"),
        (("--replay", "made-up", "--check", "exact"), "there is nothing to replay"),
    ],
)
def test_bad_names(alone, tmp_path, words, sentence):
    result = command(*words, "--runs", tmp_path / "none")
    assert isinstance(result.exception, BadInput) and sentence in str(result.exception)


def test_section(alone, tmp_path):
    found = runs()
    write_runs(tmp_path / "stress.jsonl", found)
    page = render(found)
    assert "2 of 6 checks of 1 cases pass, 1 show a known limit, 3 fail." in page
    assert "float32 has 24 bits" in page and "0.3 (known limit)" in page and "0.2 (FAIL)" in page
    assert "The tightest pass is A made-up case, &#39;fine&#39; on numpy 64, at 0.7 of its limit." in page


def test_the_suite_runs_what_is_named(alone, tmp_path):
    found = list(stress.run(Bench(tmp_path, tmp_path, only="made-up")))
    assert len(found) == 6 and {run.problem for run in found} == {"made-up"}
