"""Every sample of baked grids against brute force over all faces: distances, faces, signs, bricks, and both engines."""

import warnings

import numpy as np
import pytest
from adversarial import (
    EPS,
    ball,
    box,
    dirty,
    every_distance,
    flattened,
    in_pieces,
    joined,
    nested,
    rounding,
    sliver,
    soup,
    spread,
    winding,
)

import datasets_synthetic
import datasets_synthetic.real
from sdfbake import bake
from sdfbake.bricks import REACH
from sdfbake.engine.choose import _jit_problem

QUIET = "ignore:the (mesh is inside out|signs by)"
# A mesh, the resolution, and what else a bake is told.
CASES = {
    "ball": (ball(1), 24, {}),
    "torus": (datasets_synthetic.shape("torus").mesh(0.35), 24, {}),
    "far from the origin": (ball(1, centre=(1000.0, -500, 3), radius=0.02), 24, {}),
    "turned box": (box(1.0, 0.7, 0.4, turned=True), 32, {}),
    "sliver": (sliver(), 48, {}),
    "flattened": (flattened(), 32, {}),
    "dirty": (dirty(), 24, {}),
    "nested": (nested(), 24, {}),
    "two": (joined(ball(1), ball(1, centre=(2.5, 0.3, 0))), 24, {}),
    "one inverted": (joined(ball(1), ball(1, centre=(2.5, 0.3, 0), inward=True)), 24, {}),
    "inverted": (ball(1, inward=True), 24, {}),
    "overlapping": (joined(ball(1), ball(1, centre=(0.9, 0.1, 0.05))), 24, {}),
    "deep": (box(1.0, 0.9, 0.8), 40, {}),
    "slab": (box(2.0, 2.0, 0.5), 33, {"cube": True}),
    "soup by winding": (soup(), 24, {"open": "winding"}),
    "soup as a shell": (soup(), 24, {"open": "shell:0.05"}),
}


class Truth:
    """What a grid should hold, by brute force."""

    def __init__(self, mesh, grid, thickness=0.0):
        self.mesh, self.grid, self.thickness = mesh, grid, thickness
        self.found = spread(grid)
        self.rounding = rounding(mesh, grid.lattice)
        self.real = np.flatnonzero(np.linalg.matrix_rank(np.diff(mesh.vertices[mesh.faces], axis=1)) == 2)
        self.whole = mesh.with_(
            faces=mesh.faces[self.real], uv=None, chart=mesh.chart[self.real], part=mesh.part[self.real]
        )
        values = in_pieces(self._closest, self.found.points)
        self.distance, self.wrong_face = values[:, 0] - thickness / 2, values[:, 1] > 0
        self.reach = REACH * grid.lattice.spacing
        self.near = np.abs(self.distance) <= self.reach
        self.borderline = np.abs(np.abs(self.distance) - self.reach) <= 2 * self.rounding

    def _closest(self, points):
        """Return the least distance, and whether the face of the grid is wrong: farther than a tie, or not the lowest.

        Faces that share an edge are equally near but for the oracle's rounding; a tie as the baker means it is a
        ten-thousand-millionth of the distance and 64 eps of the lattice's extent. In between either is right.
        """
        every = every_distance(self.whole, points)
        least = every.min(axis=1)
        start = int(np.flatnonzero((self.found.points == points[0]).all(axis=1))[0])
        face = self.found.face[start : start + len(points)]
        row = np.searchsorted(self.real, face.clip(0)).clip(0, len(self.real) - 1)
        chosen = every[np.arange(len(points)), row]
        extent = max(self.grid.lattice.shape) * self.grid.lattice.spacing
        beyond = chosen > least * (1 + 2e-10) + 128 * EPS * extent + self.rounding
        equal = every <= (least + self.rounding)[:, None]
        not_lowest = equal.argmax(axis=1) < row
        unknown = (face >= 0) & (self.real[row] != face)
        return np.stack([least, (face >= 0) & (beyond | not_lowest | unknown)], axis=1)


@pytest.fixture(scope="module", params=CASES.items(), ids=CASES)
def truth(request):
    _, (mesh, resolution, options) = request.param
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # signs of soups and duplicates
        grid = bake(mesh, resolution, **options)
    kind, _, thickness = options.get("open", "").partition(":")
    return Truth(mesh, grid, float(thickness) if kind == "shell" else 0.0)


def test_distances_are_float32_of_the_exact_ones(truth):
    near = truth.near & truth.found.present & ~truth.borderline
    true = truth.distance[near] if truth.thickness else np.abs(truth.distance[near])
    stored = truth.found.distance[near] if truth.thickness else np.abs(truth.found.distance[near])
    # float32 rounds by 2^-24 of the value; see `rounding` for the rest.
    assert (np.abs(stored - true) <= np.abs(true) * 2.0**-24 + truth.rounding).all()


def test_nothing_in_reach_is_missing_and_nothing_else_is_there(truth):
    found = truth.found
    sure = ~truth.borderline
    assert found.present[truth.near & sure].all()
    np.testing.assert_array_equal((found.face >= 0)[sure], (truth.near & found.present)[sure])
    # A brick exists exactly if one of its samples is in reach.
    where = np.unravel_index(np.flatnonzero(truth.near), truth.grid.lattice.shape)
    needed = np.zeros(truth.grid.bricks.slot.shape, bool)
    needed[tuple(index // 8 for index in where)] = True
    np.testing.assert_array_equal(truth.grid.bricks.slot >= 0, needed)


def test_beyond_reach_samples_hold_the_reach(truth):
    beyond = truth.found.present & ~truth.near & ~truth.borderline
    assert (np.abs(truth.found.distance[beyond]) == np.float32(truth.reach)).all()


def test_faces_are_the_lowest_closest_ones(truth):
    assert not truth.wrong_face.any()
    assert (truth.found.face >= 0).any()


def test_signs(truth):
    # On the surface but for rounding there is no sign; open surfaces have their own tests.
    sure = truth.found.present & (np.abs(truth.distance) > 1e-9 * truth.reach)
    stored = np.where(truth.found.distance < 0, -1, 1)[sure]
    if truth.thickness:
        expected = np.where(truth.distance[sure] < 0, -1, 1)
    elif truth.grid.metadata.options["open"]:
        pytest.skip("no closed surface")
    else:
        solid = ball(1) if truth.mesh is CASES["dirty"][0] else truth.mesh
        expected = np.where(np.abs(winding(solid, truth.found.points[sure])) > 0.5, -1, 1)
    np.testing.assert_array_equal(stored, expected)


def test_a_slab_of_ties_names_the_lower_face():
    mesh, resolution, options = CASES["slab"]
    grid = bake(mesh, resolution, **options)
    found = spread(grid)
    middle = (np.abs(found.points) < 1e-12)[:, 2] & (np.abs(found.points[:, :2]) < 0.7).all(axis=1)
    assert np.count_nonzero(middle) > 100
    z = mesh.vertices[mesh.faces][..., 2]
    flat = (z == z[:, :1]).all(axis=1)
    # Both sides are a quarter away; which is lower in the file differs from triangle to triangle.
    assert flat[found.face[middle]].all()
    assert np.abs(found.distance[middle] + 0.25).max() <= 0.25 * 2.0**-24


def test_a_real_mesh():
    mesh = datasets_synthetic.real.load("cow")
    mesh = mesh.with_(uv=np.zeros((len(mesh.faces), 3, 2)))
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        grid = bake(mesh, 40)
    found, slack = spread(grid), rounding(mesh, grid.lattice)
    chosen = np.random.default_rng(0).permutation(np.flatnonzero(found.face >= 0))[:800]
    every = in_pieces(lambda p: every_distance(mesh, p), found.points[chosen], 200)
    least = every.min(axis=1)
    stored = np.abs(found.distance[chosen])
    assert (np.abs(stored - least) <= least * 2.0**-24 + slack).all()
    face = found.face[chosen]
    named = np.take_along_axis(every, face[:, None], axis=1)[:, 0]
    assert (named <= least * (1 + 2e-10) + 128 * EPS * np.ptp(grid.lattice.bounds) + slack).all()
    assert ((every <= (least + slack)[:, None]).argmax(axis=1) >= face).all()
    clear = least > 1e-9
    expected = np.where(np.abs(winding(mesh, found.points[chosen])) > 0.5, -1, 1)
    np.testing.assert_array_equal(np.sign(found.distance[chosen])[clear], expected[clear])


ENGINES_COMPARED = ["turned box", "sliver", "dirty", "slab", "soup by winding", "soup as a shell"]


@pytest.mark.skipif(_jit_problem() is not None, reason="Dr.Jit cannot run here")
@pytest.mark.parametrize("name", ENGINES_COMPARED)
def test_engines_agree(name):
    mesh, resolution, options = CASES[name]
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        one, other = (bake(mesh, min(resolution, 24), engine=engine, **options) for engine in ("numpy", "drjit"))
    np.testing.assert_array_equal(one.bricks.slot, other.bricks.slot)
    np.testing.assert_array_equal(one.bricks.far, other.bricks.far)
    np.testing.assert_array_equal(one.face, other.face)
    np.testing.assert_array_equal(np.signbit(one.distance), np.signbit(other.distance))
    # Both are float32 of float64 distances that differ by rounding: one unit in the last place, and what rounding of
    # coordinates makes of those near 0.
    unit = np.spacing(np.maximum(np.abs(one.distance), np.abs(other.distance)))
    assert (np.abs(one.distance - other.distance) <= unit + rounding(mesh, one.lattice)).all()
    # The errors compare those distances with themselves, in single and in double precision: a few units of the band's
    # greatest distance, added up with weights whose magnitudes sum to 6.
    assert np.abs(one.error - other.error).max() <= 216 * 2.0**-24 * REACH * 6


@pytest.mark.parametrize("resolution", [32, 33])
def test_signs_by_winding_are_those_by_pseudonormals(resolution):
    """On lines through the middle of a symmetric ball, two samples are as far apart as from the surface together."""
    mesh = ball(3)
    one, other = (bake(mesh, resolution, sign=method) for method in ("pseudonormal", "winding"))
    np.testing.assert_array_equal(one.distance, other.distance)
