"""The stress cases on geometry, lattices and samples: they hold, faults make the right ones fail, limits are bounds."""

import numpy as np
import pytest

from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfbake.engine import choose
from sdfrender import GridField, gridfield, march, optics, transfer
from sdfrender.kernels import bspline
from validate.closed import ExactReference
from validate.stress import bounds, brute, frames, geometry, kinks, lattices, mirrored, samples
from validate.stress.mirrored import Frame, Places, change, dense, differences, met, towards

CASES = {case.name: case for theme in (geometry, lattices, samples) for case in theme.CASES}
CHOICE = choose("numpy", 64)


def figures(name, said):
    """The checks of a case whose names say this, and its identities: each with its greatest error."""
    for check in CASES[name].checks(CHOICE):
        if said in check.name or "identities" in check.name:
            errors = np.abs(check.find().errors)
            assert np.isfinite(errors).all()
            yield check, errors.max()


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Fewer rays and grids than the suite's."""
    for module in (geometry, kinks, lattices, samples, frames):
        monkeypatch.setattr(module, "COUNT", 60)
    monkeypatch.setattr(kinks, "WIDTHS", (0.6, 0.4))
    monkeypatch.setattr(samples, "SCALES", (2.0**-10, 1e3))
    monkeypatch.setattr(frames, "SIZES", ((2, 2, 2), (2, 3, 5)))
    chosen = ("scaled by 1e-6", "a sixteenth as large, 1e6 away")
    monkeypatch.setattr(frames, "FRAMES", {name: frames.FRAMES[name] for name in chosen})


@pytest.mark.parametrize("name", CASES)
def test_a_case_holds(name, monkeypatch):
    names, hit = [], []

    def spied(*given, **options):
        hits, at = transfer(*given, **options)
        hit.append(hits.hit.mean())
        return hits, at

    monkeypatch.setattr(mirrored, "transfer", spied)
    for check in CASES[name].checks(CHOICE):
        found = check.find()
        errors = np.abs(found.errors)
        assert np.isfinite(errors).all() and errors.size, check.name
        # A limit that is known not to be met is not met: else its sentence is out of date.
        assert (errors.max() > check.limit) == bool(check.known), (check.name, errors.max(), check.limit)
        assert found.rays is not None and len(found.rays.p) == len(errors) and check.course is not None, check.name
        names.append(check.name)
    assert len(set(names)) == len(names)  # a replay finds its check by name
    assert np.mean(hit) > 0.3  # rays that meet nothing claim nothing


def without_length(xp, jet, n, dp):
    """Eq. 20 of the report without the division by |g|."""
    bent = optics.apply(jet.hessian, dp)
    return optics.subtract(bent, optics.scale(n, optics.dot(n, bent)))


FAULTS = {
    "unnormalised": (optics, "normal_differential", without_length, "gradient-scaled", "n and mirrored J"),
    "no edge": (optics, "is_edge", lambda xp, jet: jet.value > 1e30, "cube-edges", "no EDGE"),
    "all edge": (optics, "is_edge", lambda xp, jet: jet.value < 1e30, "cube-edges", "EDGE on hits"),
    "no band": (gridfield, "_beyond", lambda *_: None, "truncated-band", "BAND otherwise"),
    "sign forgotten": (march, "isolate", None, "lattice-nodes", "plane through nodes"),
    "curvature": (optics, "normal_differential", None, "torus-saddle", "mirrored J"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_caught(fault, monkeypatch):
    module, name, wrong, case, said = FAULTS[fault]
    right = getattr(module, name)
    if fault == "sign forgotten":

        def wrong(*given):
            bracket, sign = right(*given)
            return bracket, 0.0 * sign

    if fault == "curvature":
        wrong = lambda *given: optics.scale(right(*given), 3.0)  # noqa: E731
    monkeypatch.setattr(module, name, wrong)
    checks = figures(case, said)
    failed = [check.name for check, figure in checks if figure > check.limit and not check.known]
    assert any(said in name for name in failed), failed
    assert not any("identities" in name for name in failed)  # all of these are symplectic maps


def test_the_wrong_ray_is_named(monkeypatch):
    """Of all rays one is traced wrongly: its number is the worst one's, and the count is 1."""
    values = np.random.default_rng(5).normal(size=(9, 8, 7))
    right, lost = brute.trace, []

    def forgetful(field, p, d):
        hits = right(field, p, d)
        if not lost:
            lost.append(p[np.flatnonzero(hits.hit)[3]])
        hits.t[(p == lost[0]).all(axis=1)] = np.inf
        return hits

    monkeypatch.setattr(brute, "trace", forgetful)
    found = brute.none_missed("wrong", values, bspline(), CHOICE, samples.through, 30).find()
    assert found.errors.max() == found.errors.sum() == 1
    np.testing.assert_array_equal(found.rays.p[np.argmax(found.errors)], lost[0])


# ---- bounds ----------------------------------------------------------------------------------------------------------
def test_weights_are_those_of_samples():
    """They give x^k back, and its derivatives, for k up to 3; of x^4 what Lagrange's form says."""
    at = bounds.apart(bspline())
    for order, expected in enumerate(np.eye(4)[:3] * [1, 1, 2, 0]):
        w = bounds.sample_weights(bspline(), order)
        for k in range(4):
            assert (w * at**k).sum(axis=1) == pytest.approx(expected[k], abs=1e-13)
    assert np.abs((bounds.sample_weights(bspline(), 0) * at**4 / 24).sum(axis=1)).max() == pytest.approx(35 / 1152)
    assert np.abs((bounds.sample_weights(bspline(), 2) * at**4 / 24).sum(axis=1)).max() == pytest.approx(1 / 12)


@pytest.mark.parametrize("n", [np.eye(3)[0], kinks.OBLIQUE], ids=["axis", "oblique"])
def test_no_kink_is_worse(n, rng):
    """The interpolant of |s| on the plane s = 0, by the renderer; 17^3 places know the worst to 1 %."""
    values = np.abs((np.moveaxis(np.indices((24, 24, 24)), 0, -1) - 11.27) @ n)
    p = 11.27 + rng.uniform(-6, 6, (20_000, 3))
    p -= ((p - 11.27) @ n)[:, None] * n
    found = dense(values, CHOICE).jet(p, 0)[0].max()
    assert found <= 1.01 * bounds.kink(bspline(), n)
    assert n[0] == 1 or found > 0.95 * bounds.kink(bspline(), n)


def test_nothing_is_amplified_more(rng):
    """Noise in the samples, as large as the bound allows: it never exceeds the bound, and comes near it."""
    noise = rng.choice([-1.0, 1.0], (24, 24, 24)) * 0.25
    far = np.indices((24, 24, 24))[0] * 64.0  # a plane, so that bricks are there
    fields = [dense(values, CHOICE) for values in (far - 11 * 64 + noise, far - 11 * 64)]
    p = rng.uniform([10.8, 4, 4], [11.2, 19, 19], (4000, 3))
    for order, pair in enumerate(zip(*(field.jet(p) for field in fields), strict=True)):
        bound = 0.25 * bounds.amplified(bspline(), order, np.ones_like)
        assert 0.1 * bound < np.abs(np.subtract(*pair)).max() <= bound * (1 + 1e-9)


def test_a_ball_by_another_route(rng):
    """`Places.mirror` against the closed-form reference, which finds the hits itself."""
    ball = Sphere(0.8)
    places = Places.of(ball, rng.normal(size=(200, 3)))
    rays = towards(places, rng, 2.0)
    reference = ExactReference(ball)
    truth = reference.reflect(*reference.transfer(rays))
    # Cosines of 0.3 or more: a hundred roundings.
    assert change(places.mirror(rays), truth, 0.8).max() < 1e-13
    assert np.abs(places.mirror(rays).d - truth.d).max() < 1e-14


def test_frames_carry_everything(rng):
    """A ball seen in another frame, wrongly and rightly."""
    ball, frame = Sphere(6.0, (7.6, 7.3, 7.8)), Frame(2.0, 0.5, (2, 0, 1))
    p = np.moveaxis(np.indices((16, 16, 16)), 0, -1).reshape(-1, 3).astype(float)
    values = ball.distance(p).reshape(16, 16, 16)
    base, other = dense(values, CHOICE), dense(2 * values.transpose(2, 0, 1), CHOICE, [0.5] * 3, 2.0)
    rays = towards(Places.of(ball, ball.centre + rng.normal(size=(50, 3))), rng, 9.0)
    ours, theirs = met(other, frame.beam(rays)), met(base, rays)
    place, rest = differences(ours, theirs, 1.0, frame)
    assert ours.hits.hit.all() and max(place.max(), rest.max()) < 1e-12
    place, rest = differences(ours, theirs, 1.0, Frame(2.0, 0.5, (1, 2, 0)))
    assert min(np.median(place), np.median(rest)) > 0.1


def test_a_grid_says_what_was_cut_off(rng):
    """`cut_off` by the definition, one place at a time."""
    values = rng.uniform(-5, 5, (34, 34, 34))
    p = rng.uniform(4, 28, (20, 3))
    seen, sure = samples.cut_off(values, 4.9, p)
    for k, (x, y, z) in enumerate(np.floor(p).astype(int)):
        block = values[x - 2 : x + 4, y - 2 : y + 4, z - 2 : z + 4]
        assert block.size == 216 and seen[k] == (np.abs(block).max() >= 4.9)
    assert sure.all() and 0 < seen.mean() <= 1
    grid = Grid.from_dense(np.clip(values, -4.9, 4.9), band=4.9)
    assert isinstance(GridField(grid, "bspline", CHOICE), GridField)
