"""The optical stress cases hold on NumPy, their surfaces are exact, and planted faults make the right ones fail."""

import re

import numpy as np
import pytest

from sdfbake.engine import choose
from sdfrender import Rays, optics, reflect, transfer
from validate.stress import glass, grazing, optical, resonance
from validate.stress.bounced import bounced

CASES = {case.name: case for theme in (grazing, resonance, glass) for case in theme.CASES}
NUMPY = choose("numpy", 64)
SKIPPED = re.compile(r"1e-(2|3|4|5|6|7|9|10|11|13|14):")  # decades between


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Fewer bounces; limits follow them."""
    for name, value in (("BOUNCES", 6), ("LONG", 20), ("MARKS", 2), ("SHOWN", 2)):
        monkeypatch.setattr(resonance, name, value)


def failures(checks):
    """Names of the checks that are not met, known limits apart."""
    found = [(check, check.find().errors) for check in checks]
    assert found and all(len(errors) for _, errors in found)
    return [check.name for check, errors in found if not (errors <= check.limit).all() and not check.known]


@pytest.mark.parametrize("name", CASES)
def test_cases_hold(name):
    checks = list(CASES[name].checks(NUMPY))
    assert failures([check for check in checks if not SKIPPED.search(check.name)]) == []
    names = [check.name for check in checks]
    assert len(set(names)) == len(names)
    assert any(check.startswith("identities") for check in names) and any(c.startswith("finite") for c in names)
    assert all(check.course is not None for check in checks)


def test_the_ball_is_a_ball(choice, directions):
    """Normal, curvature and radius within the bounds from which all limits are made; float64 and float32."""
    eps, p = choice.engine.eps, directions
    value, gradient, hessian = optical.ball(choice).jet(p)
    n = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    assert np.abs(value).max() / 2 < optical.BALL_RADIUS * eps
    assert np.linalg.norm(n - p, axis=1).max() < optical.BALL_NORMAL * eps
    assert np.abs(hessian / 2 - np.eye(3)).max() < optical.BALL_CURVATURE * eps


def test_samples_that_float32_does_not_hold_are_refused():
    with pytest.raises(ValueError, match="float32"):
        optical.field(np.full((4, 4, 4), 0.1), (0.0, 0.0, 0.0), 1.0, NUMPY)


def test_many_bounces_are_as_many_calls():
    """The loop does what `transfer` and `reflect` do, bit for bit: one engine, the same operations."""
    cavity = optical.ball(NUMPY)
    p, d = np.array([[0.1, 0.0, 0.0], [0.0, 0.2, 0.1]]), np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])
    x, y, zero = np.array([[1.0, 0, 0], [0, 1, 0]]), np.array([[0.0, 0.8, -0.6], [0, 0, 1]]), np.zeros((2, 3))
    hits, start = transfer(cavity, Rays(p, d, x, y, zero, zero))
    start = by_calls = reflect(cavity, hits, start)
    for _ in range(5):
        hits, by_calls = transfer(cavity, by_calls, on_surface=True)
        by_calls = reflect(cavity, hits, by_calls)
    [(number, by_loop)] = bounced(cavity, start, 5, 1)
    assert number == 5 and np.array_equal(by_loop.columns(), by_calls.columns())


def straight(xp, beam, jet, p, t):
    """Transfer without dt_dx."""
    dp = [optics.along(a, b, t) for a, b in ((beam.dp_dx, beam.dd_dx), (beam.dp_dy, beam.dd_dy))]
    return beam._replace(p=p, dp_dx=dp[0], dp_dy=dp[1])


def cancelled(xp, d, n, eta, right=optics.passage):
    """mu = c' - eta c as it stands."""
    way = right(xp, d, n, eta)
    return way._replace(mu=way.c_out - eta * way.c)


def swapped(xp, beam, n, dn_dx, dn_dy, eta, right=optics.refract):
    """n_t / n_i in place of n_i / n_t."""
    return right(xp, beam, n, dn_dx, dn_dy, 1.0 / eta)


def triple(xp, jet, n, dp, right=optics.normal_differential):
    """Curvature times three."""
    return optics.scale(right(xp, jet, n, dp), 3.0)


def by_sign(xp, beam, t):
    """A caustic only where the cross-section's sign at the end is another."""
    ends = [
        [optics.along(dp, dd, way) for dp, dd in ((beam.dp_dx, beam.dd_dx), (beam.dp_dy, beam.dd_dy))]
        for way in (0.0 * t, t)
    ]
    first, last = (optics.dot(optics.cross(*pair), beam.d) for pair in ends)
    return first * last < 0


def never(xp, beam, jet):
    return xp.full(beam.d[0], False)


FAULTS = {
    "no dt_dx": ("transfer", straight, "plane-grazing", "oblique plane"),
    "cancelled mu": ("passage", cancelled, "index-near-one", "1e-8"),
    "wrong eta": ("refract", swapped, "ball-lens", "index 1.5: dd"),
    "wrong eta, by the identities": ("refract", swapped, "ball-lens", "identities, index 1.5"),
    "curvature times three": ("normal_differential", triple, "mirror-focus", "width"),
    "caustics by sign": ("passes_caustic", by_sign, "mirror-focus", "CAUSTIC there"),
    "no horizon": ("crosses_horizon", never, "horizon", "HORIZON"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_planted_faults_fail(fault, monkeypatch):
    function, wrong, case, check = FAULTS[fault]
    monkeypatch.setattr(optics, function, wrong)
    assert failures([one for one in CASES[case].checks(NUMPY) if check in one.name]) != []
