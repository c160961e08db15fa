"""Brute force, what it makes of tracers that are wrong, and what the report says about them."""

import numpy as np
import pytest
from contest import misses_runs
from test_trace import dense_values

from sdfbake import Grid
from sdfbake.engine import choose
from sdfrender import GridField, trace
from sdfrender.kernels import NAMES, kernel
from validate.bruteforce import Interpolant, first_roots, lines
from validate.experiment import Bench
from validate.sections.misses import section
from validate.suites import misses
from validate.suites.misses import PROBLEMS, Tolerances, compare, tolerances

DOUBLE = choose("drjit", 64) if choose().engine.name == "drjit" else choose("numpy", 64)
COUNT = 2000


def _field(name, of="bspline"):
    values = PROBLEMS[name].values.astype(np.float32)
    return Interpolant(values.astype(float), kernel(of), DOUBLE.engine), GridField(Grid.from_dense(values), of, DOUBLE)


@pytest.fixture(scope="module")
def gyroid():
    dense, field = _field("gyroid")
    rays = PROBLEMS["gyroid"].rays(np.random.default_rng(1), COUNT, field.grid.lattice.shape, field)
    return dense, field, rays


@pytest.mark.parametrize("of", NAMES)
def test_the_interpolant_agrees_with_another_route(of, rng):
    dense, _ = _field("noise", of)
    values = PROBLEMS["noise"].values.astype(np.float32)
    p = rng.uniform(0, 1, (500, 3)) * (np.array(values.shape) - 1)
    p[:100] = np.round(p[:100])
    # 64 products of numbers up to 8, summed in float64 in another order.
    assert np.abs(dense.at(p) - dense_values(values, of, p)).max() < 64 * 8 * 2.0**-52


def test_roots_of_a_ball_of_known_depth(rng):
    """Chords of a ball in a field that is a quadric, which the B-spline gives back: as short as 3e-5 voxel."""
    shape, centre, r = (21, 22, 23), np.array([10.2, 10.7, 11.1]), 7.3
    p = np.moveaxis(np.indices(shape), 0, -1)
    values = (np.sum((p - centre) ** 2, axis=-1) - r * r).astype(float)
    n = rng.normal(size=(400, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    d = np.cross(n, rng.normal(size=n.shape))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    inward = np.where(np.arange(400) % 2, 1, -1) * 10 ** rng.uniform(-10, 0, 400)
    rays = lines(shape, centre + (r - inward)[:, None] * n - 9 * d, d)
    hit, t = first_roots(Interpolant(values, kernel("bspline"), DOUBLE.engine), rays)
    # Values near 50 sum to 1e-12: a chord that is less deep (2 r inward) may go either way.
    clear = np.abs(inward) > 1e-12
    np.testing.assert_array_equal(hit[clear], inward[clear] > 0)
    # f changes by 2 chord dt; a value's rounding is that of coefficients up to 300, worth 64 u at most, u = 1.1e-16.
    t, chord = t[hit & clear], np.sqrt(inward * (2 * r - inward), where=hit, out=np.zeros(400))[hit & clear]
    assert (np.abs(t - (9 - chord)) * 2 * chord).max() < 2.2e-12


def test_a_right_tracer_passes(gyroid):
    dense, field, rays = gyroid
    found = compare(dense, rays, lambda rays: trace(field, rays.p, rays.d).t, tolerances(field))
    assert found["hits"] > 0.9 * COUNT
    assert found["missed"] == found["late"] == found["false"] == found["within"] == found["depth"] == 0


def _coarse(dense, rays, step=0.7):
    """A tracer that looks every so often, and steps over what is thinner."""
    t = rays.near[:, None] + step * np.arange(int(70 / step))
    inside = t < rays.far[:, None]
    p = rays.p[:, None] + t[:, :, None] * rays.d[:, None]
    values = np.where(inside, dense.at(p.reshape(-1, 3)).reshape(t.shape), np.nan)
    with np.errstate(invalid="ignore"):
        changed = values[:, 1:] * values[:, :1] < 0
    first = np.argmax(changed, axis=1)
    return np.where(changed.any(axis=1), t[np.arange(len(t)), first + 1], np.inf), first


def test_a_tracer_that_skips_cells_is_caught(gyroid):
    dense, _, rays = gyroid
    tolerance = Tolerances(1e-12, 1e-12)

    def skips(rays):
        t, first = _coarse(dense, rays)
        low = rays._replace(near=rays.near + 0.7 * first, far=np.minimum(t, rays.far))
        exact = first_roots(dense, low)[1]
        return np.where(np.isfinite(t), exact, np.inf)

    found = compare(dense, rays, skips, tolerance)
    assert found["missed"] > 0 and found["late"] > 0 and found["depth"] > 1e6
    assert found["false"] == 0


def test_late_and_false_hits_are_caught(gyroid):
    dense, field, rays = gyroid
    t = trace(field, rays.p, rays.d).t
    hit = np.isfinite(t)
    late = compare(dense, rays, lambda _: t + 0.01, tolerances(field))
    # Some hits are beyond a sheet that is thinner than this, and others leave the box.
    assert late["late"] + late["missed"] > 0.99 * hit.sum()
    early = compare(dense, rays, lambda _: np.maximum(t - 0.01, rays.near), tolerances(field))
    assert early["false"] > 0.99 * hit.sum() and early["missed"] == 0
    nothing = compare(dense, rays, lambda _: np.full(len(t), np.inf), tolerances(field))
    assert nothing["missed"] == nothing["hits"] == hit.sum()


def test_a_field_without_some_cells_is_caught(gyroid):
    """The tracer itself, against a grid one of whose octants it believes to be empty."""
    dense, field, rays = gyroid
    values = PROBLEMS["gyroid"].values.astype(np.float32)
    values[13:, 16:, 15:] = 1.0
    holed = GridField(Grid.from_dense(values), "bspline", DOUBLE)
    found = compare(dense, rays, lambda rays: trace(holed, rays.p, rays.d).t, tolerances(field))
    assert found["late"] + found["missed"] > 0.02 * COUNT


@pytest.mark.parametrize("bits", [64, 32])
def test_tangents_do_not_hang(bits):
    """Newton's method went to and fro between the ends of a bracket, on one tangent in so many thousands, for ever."""
    if DOUBLE.engine.name == "numpy":
        pytest.skip("too many rays for NumPy")
    _, field = _field("sphere", "linear")
    field = GridField(field.grid, "linear", choose("drjit", bits))
    rays = misses.grazing(np.random.default_rng(20180412), 100_000, field.grid.lattice.shape, field)
    assert 0.3 < trace(field, rays.p, rays.d).hit.mean() < 0.7


def test_the_section_is_written_from_the_numbers():
    written = section(misses_runs(late=3.0))
    said = " ".join(written.finding)
    assert "Of 1,000 rays in float64 the wrong ones beyond the tolerance are: 0 missed, 0 late, 0 false; within" in said
    assert "0 missed, 3 late, 0 false, in noise (bspline); within it 4 disagree" in said
    assert [line.figure for line in written.headlines] == ["0", "3"]
    assert written.tables[0].rows[1][-2] == "0.4"
    assert section([]).finding == ("No run succeeded.",)


def test_the_suite_runs(tmp_path, monkeypatch):
    chosen = {name: PROBLEMS[name] for name in ("wall of 0.6 voxel", "gyroid, after a mirror")}
    monkeypatch.setattr(misses, "PROBLEMS", chosen)
    monkeypatch.setattr(misses, "NAMES", ("bspline",))
    runs = list(misses.run(Bench(tmp_path, tmp_path, quick=True)))
    assert all(run.ok for run in runs), [run.status for run in runs]
    assert len(runs) == 2 * len(misses.setups(quick=True))
    for run in runs:
        assert run.values["missed"] == run.values["late"] == run.values["false"] == 0 < run.values["hits"]
