"""Hard atlases, wild footprints and broken meshes: every check holds or is a known limit; planted faults are caught."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from sdfbake import sides
from sdfbake.engine import choose
from sdfrender.facemap import FaceMap
from validate.stress import charts, lookups, meshes, sights, solids
from validate.stress.outcome import outcome, outcomes

CASES = {case.name: case for case in (*charts.CASES, *meshes.CASES)}
# In a Python of its own: where array types are checked, bakes are ten times slower. Fewer rays and samples than the
# suite has; what is derived from them follows.
PROGRAM = """
import json
from dataclasses import asdict
from functools import partial
from sdfbake.engine import choose
from validate.stress import atlases, charts, meshes, sights
from validate.stress.outcome import outcome, outcomes
sights.RESOLUTION, sights.SIDE, charts.AIMED = 24, 10, 40
meshes.RESOLUTION, meshes.PLACES = 16, 2000
charts.MESHES["small patches"] = partial(atlases.patchwork, 0.12)
cases = (*charts.CASES, *meshes.CASES)
print(json.dumps([asdict(outcome(run)) for case in cases for run in outcomes(case, "numpy 64", choose("numpy", 64))]))
"""


@pytest.fixture(scope="module")
def results():
    ended = subprocess.run([sys.executable, "-W", "error", "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


@pytest.mark.parametrize("name", CASES)
def test_every_check_holds_or_is_a_known_limit(results, name):
    found = [one for one in results if one["case"] == name]
    assert found and {one["verdict"] for one in found} <= {"pass", "known limit"}, found
    assert len({one["check"] for one in found}) == len(found) and not any(one["nonfinite"] for one in found)
    # What cannot be right is shown to be wrong: the seed's texture coordinates across cuts.
    assert all(one["figure"] > 0 for one in found if one["check"].startswith("grid") and one["known"])


@pytest.fixture
def small(monkeypatch):
    """Fewer rays and samples here, too."""
    monkeypatch.setattr(sights, "RESOLUTION", 24)
    monkeypatch.setattr(charts, "AIMED", 40)
    monkeypatch.setattr(meshes, "RESOLUTION", 16)
    monkeypatch.setattr(meshes, "PLACES", 2000)


def failed(name, among=""):
    """Names of the checks of a case that fail, of those that have a word in their name."""
    case = CASES[name]
    chosen = replace(case, checks=lambda choice: [check for check in case.checks(choice) if among in check.name])
    found = [outcome(run) for run in outcomes(chosen, "numpy 64", choose("numpy", 64))]
    assert all(one.verdict != "broken" for one in found), found
    return {one.check for one in found if one.verdict == "fail"}


def test_solids_are_what_their_inequalities_say(rng):
    """Closed meshes whose volume is that of the places with a negative depth, to what random places can tell."""
    for solid in (solids.ball(), solids.fan(), solids.edge_to_edge()):
        corners = solid.mesh.vertices[solid.mesh.faces]
        volume = np.linalg.det(corners).sum() / 6
        low, high = solid.mesh.bounds
        inside = solid.depth(rng.uniform(low, high, (40_000, 3))) < 0
        box = np.prod(high - low)
        assert abs(inside.mean() * box - volume) < 4 * box * np.sqrt(0.25 / 40_000)  # four standard deviations
        edge = solid.depth(corners.mean(axis=1))
        assert np.abs(edge).max() < 1e-15  # on the faces, to the rounding of sums of three products


@pytest.fixture(scope="module")
def box():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sights, "RESOLUTION", 24)
        return sights.Subject.of(charts.MESHES["box"]())


def faulty(monkeypatch, box, **channels):
    """Give the box a grid with some channels changed."""
    grid = replace(box.grid, **channels)
    monkeypatch.setattr(charts, "subject", lambda name: sights.Subject(box.mesh, grid))


CORNER = "three-chart-corner"


def test_without_a_fault_nothing_fails(small, monkeypatch, box):
    faulty(monkeypatch, box)
    assert failed(CORNER) == set()


def test_layers_of_other_charts_are_caught(small, monkeypatch, box):
    """Every row has the texture coordinates of the row after it: those of another face of the box."""
    layers = box.grid.layers
    faulty(monkeypatch, box, layers=replace(layers, uv=np.roll(layers.uv, 1, axis=0)))
    assert failed(CORNER) == {"layers: uv on its chart, in closed form"}


def test_u_for_v_is_caught(small, monkeypatch, box):
    faulty(monkeypatch, box, surface=replace(box.grid.surface, uv=box.grid.surface.uv[..., ::-1].copy()))
    assert failed(CORNER) == {"faces: uv of the closest face", "faces: J against G dp"}


def test_samples_whose_charts_are_forgotten_are_caught(small, monkeypatch, box):
    faulty(monkeypatch, box, chart=None)
    assert failed(CORNER) == {"grid: wrong without SEAM"}


def test_faces_whose_charts_are_ignored_are_caught(small, monkeypatch, box):
    faulty(monkeypatch, box, surface=replace(box.grid.surface, chart=0 * box.grid.surface.chart))
    assert failed(CORNER) == {"faces: chart of a closest face"}


def test_a_search_that_stops_at_the_samples_is_caught(small, monkeypatch):
    """Around the pole thousands of faces are smaller than a voxel, and no sample names the right one."""
    monkeypatch.setattr(FaceMap, "_walk", lambda self, xp, q, n, start: start)
    assert "faces: uv of the closest face" in failed("pole", "uv of")


def test_a_short_axis_by_subtraction_is_caught(monkeypatch):
    """|J|^2 less the long axis's square has no digits left of one that is a millionth of it."""

    def naive(xp, dx, dy, size):
        u, v = (dx[0] * size[0], dy[0] * size[0]), (dx[1] * size[1], dy[1] * size[1])
        uu, vv, uv = u[0] ** 2 + u[1] ** 2, v[0] ** 2 + v[1] ** 2, u[0] * v[0] + u[1] * v[1]
        root = np.sqrt((uu - vv) ** 2 / 4 + uv**2)
        return np.sqrt((uu + vv) / 2 + root), np.sqrt(abs((uu + vv) / 2 - root)), np.arctan2(2 * uv, uu - vv) / 2

    monkeypatch.setattr(lookups, "axes", naive)
    assert failed("thousand-to-one", "axis") == {"minor axis"}


def test_signs_without_a_second_method_are_caught(small, monkeypatch):
    """Pseudonormals inside of one of two balls that overlap take the other's surface for the border."""
    monkeypatch.setattr(sides, "DISAGREEMENT", 1.0)
    assert failed("self-intersecting", "two balls: wrong") == {"two balls: wrong signs"}
