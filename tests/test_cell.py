"""Roots in one cell: polynomials against direct evaluation, roots against known ones, signs by hand."""

from math import comb

import numpy as np
import pytest

from sdfrender.cell import Bracket, isolate, ray_polynomial, refine, sign_changes, tolerance
from sdfrender.kernels import NAMES, kernel


def bernstein(degree, s):
    r = np.arange(degree + 1)
    return np.array([comb(degree, k) for k in r]) * s[..., None] ** r * (1 - s[..., None]) ** (degree - r)


def of_roots(roots, sign=1.0, degree=9):
    """Bernstein coefficients of sign * prod (s - root), raised to a degree; complex roots come in pairs."""
    power = np.zeros(degree + 1)
    product = sign * np.polynomial.polynomial.polyfromroots(roots).real
    power[: len(product)] = product
    return np.array([sum(power[p] * comb(r, p) / comb(degree, p) for p in range(r + 1)) for r in range(degree + 1)])


def behind(k, coefficients):
    """Greatest sum of |weight x coefficient| behind a control point: what rounding is relative to."""
    net = np.abs(np.kron(np.kron(k.bezier, k.bezier), k.bezier))
    return float((np.abs(coefficients) @ net.T).max())


def search(choice, polynomials, sign=0.0, bound=None):
    """First roots of polynomials (n, degree + 1): found, where, the bracket, the sign after."""
    polynomials = np.atleast_2d(np.asarray(polynomials, float))
    n, count = polynomials.shape
    bound = 64 * choice.engine.eps * np.abs(polynomials).max() if bound is None else bound

    def program(xp, *columns):
        polynomial, sign = columns[:count], columns[count]
        bracket, after = isolate(xp, polynomial, sign, xp.full(sign, float(bound)), xp.full(sign, True))
        s = refine(xp, polynomial, bracket)
        found = xp.integer(bracket.found)
        return {"found": found, "s": s, "low": bracket.low, "high": bracket.high, "after": after}

    signs = np.broadcast_to(np.asarray(sign, float), n)
    return choice.engine.run(program, [*polynomials.T, signs])


@pytest.mark.parametrize("name", NAMES)
def test_ray_polynomial_is_the_interpolant_along_the_segment(name, choice, rng):
    """Random coefficients, random ends, some of them on the cell's faces; tolerance: the bound that the march uses."""
    k, n = kernel(name), 300
    coefficients = rng.normal(size=(n, k.taps**3))
    enter, leave = rng.uniform(size=(2, n, 3))
    enter[: n // 3, 0], leave[: n // 3, 1] = 0.0, 1.0
    single = choice.engine.precision == 32
    coefficients, enter, leave = (
        a.astype(np.float32 if single else float).astype(float) for a in (coefficients, enter, leave)
    )

    def program(xp, *columns):
        taps, a, e = list(columns[:-6]), columns[-6:-3], columns[-3:]
        return {str(r): b for r, b in enumerate(ray_polynomial(xp, k, taps, a, e))}

    out = choice.engine.run(program, [*coefficients.T, *enter.T, *leave.T])
    polynomial = np.stack([out[str(r)] for r in range(len(out))], axis=-1).astype(float)
    assert polynomial.shape[1] == 3 * k.degree + 1
    s = np.linspace(0, 1, 13)
    places = enter[:, None] + s[:, None] * (leave - enter)[:, None]
    weights = places[..., None] ** np.arange(k.degree + 1) @ k.weights.T
    cube = coefficients.reshape(n, k.taps, k.taps, k.taps)
    truth = np.einsum("nsi,nsj,nsk,nijk->ns", weights[:, :, 0], weights[:, :, 1], weights[:, :, 2], cube)
    bound = tolerance(choice.engine.eps, k, behind(k, coefficients))
    assert np.abs(polynomial @ bernstein(3 * k.degree, s).T - truth).max() < bound
    assert np.abs(truth).max() > 1e4 * bound


@pytest.mark.parametrize("name", NAMES)
def test_rounding_stays_within_its_bound_at_its_worst(name, rng):
    """Coefficients whose signs are those of the weights: nothing cancels, and the bound is as close as it gets.

    The truth is the same program in float64, whose own rounding is 2^-29 of float32's.
    """
    from sdfbake.engine import choose

    k, n = kernel(name), 2000
    enter, leave = rng.uniform(size=(2, n, 3)).astype(np.float32).astype(float)
    corner = (rng.uniform(size=(n, 3)) < 0.5).astype(float)
    leave[: n // 2] = corner[: n // 2]
    signs = rng.choice([-1.0, 1.0], (n, k.taps**3))

    def program(xp, *columns):
        return dict(enumerate(ray_polynomial(xp, k, list(columns[:-6]), columns[-6:-3], columns[-3:])))

    inputs = [*signs.T, *enter.T, *leave.T]
    exact, single = (np.stack(list(choose("numpy", p).engine.run(program, inputs).values())) for p in (64, 32))
    error = np.abs(exact - single).max()
    bound = tolerance(float(np.finfo(np.float32).eps), k, behind(k, signs))
    assert error < bound
    assert error > bound / 1000  # a bound that nothing comes near would prove nothing


@pytest.mark.parametrize(
    ("sequence", "carried", "changes", "last"),
    [
        ([1, 2, 3], 0, 0, 1),
        ([1, -2, 3], 0, 2, 1),
        ([0, 0, -1], 0, 0, -1),
        ([1, 0, -1], 0, 1, -1),
        ([1, 0.4, -0.4, 1], 0, 0, 1),
        ([1, 2, 3], -1, 1, 1),
        ([-0.5, 0.5, 0], 1, 0, 1),
        ([0, 0, 0], -1, 0, -1),
        ([0, 0, 0], 0, 0, 0),
        ([1, -1, 1, -1], -1, 4, -1),
    ],
)
def test_sign_changes_by_hand(sequence, carried, changes, last, choice):
    """Entries of up to 0.5 have no sign here."""

    def program(xp, sign, bound, *b):
        count, after = sign_changes(xp, b, sign, bound)
        return {"count": count, "after": after}

    columns = [np.full(1, float(x)) for x in (carried, 0.5, *sequence)]
    out = choice.engine.run(program, columns)
    assert (out["count"].item(), out["after"].item()) == (changes, last)


@pytest.mark.parametrize("degree", [3, 9])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    "roots", [(0.5,), (0.2, 0.7), (0.3, 0.31), (0.1, 0.55, 0.9), (0.01, 0.02, 0.03), (0.0625,), (0.999,)], ids=str
)
def test_first_root(roots, sign, degree, choice):
    """The first of one, two or three roots, alone in its bracket.

    A root moves by the coefficients' rounding over the slope there; |c| <= 1, each of 10 of them off by one unit, and
    two units for the search itself. The three close roots have coefficients of 1e-6 next to 1, so only float64 sees
    all of them; what is below float32's bound has no sign by design.
    """
    if choice.engine.precision == 32 and min(np.diff(roots), default=1) < 0.05:
        pytest.skip("below the rounding bound of float32")
    polynomial = of_roots(list(roots), sign, degree)
    out = search(choice, polynomial)
    slope = np.abs(np.prod([roots[0] - r for r in roots[1:]]))
    assert out["found"].all()
    assert abs(out["s"].item() - roots[0]) < choice.engine.eps * (2 + 16 / slope)
    assert out["low"].item() <= roots[0] <= out["high"].item() and (len(roots) < 2 or out["high"].item() < roots[1])
    assert out["after"].item() == np.sign(polynomial[-1])


@pytest.mark.parametrize("carried", [0.0, 1.0])
def test_no_root(carried, choice, rng):
    """Positive polynomials, some of them with coefficients that change sign, have no root."""
    pairs = rng.uniform(0, 1, (200, 2)) + 1j * rng.uniform(0.05, 0.5, (200, 2))
    polynomials = [of_roots([*pair, *pair.conj()]) for pair in pairs]
    assert any((p < 0).any() for p in polynomials)
    bound = 64 * choice.engine.eps * 1e-3
    out = search(choice, np.array(polynomials), carried, bound)
    assert not out["found"].any() and (out["after"] == 1).all()


def test_a_touching_root_is_within_rounding(choice):
    """A double root may count or not, but nothing after it is lost, and nothing is found where there is none."""
    polynomial = np.array([of_roots([0.4, 0.4]), of_roots([0.4, 0.4, 0.8])])
    out = search(choice, polynomial)
    near = np.abs(out["s"] - 0.4) < 4 * np.sqrt(64 * choice.engine.eps)  # f = (s - 0.4)^2 is below the bound there
    assert (near | (out["found"] == 0))[0]
    assert out["found"][1] and (near[1] or abs(out["s"][1] - 0.8) < 1e3 * choice.engine.eps)


def test_roots_at_the_ends(choice):
    """A root on the face between two cells is met once: by the sign that is carried over, not by either cell alone.

    A rise through 0 at the end of one cell leaves the sign -1; the next cell begins at 0 and is positive.
    """
    before, after = of_roots([1.0]), of_roots([0.0])
    one = search(choice, before, -1.0)
    assert not one["found"].any() and one["after"].item() == -1
    two = search(choice, after, one["after"])
    assert two["found"].all() and two["s"].item() <= 2 * choice.engine.eps and two["after"].item() == 1
    # A ray that starts on its root and leaves, as after a mirror, with no sign yet: not met again.
    assert not search(choice, after, 0.0)["found"].any()


@pytest.mark.parametrize(("carried", "found"), [(0.0, False), (1.0, False), (-1.0, True)])
def test_a_sign_that_differs_is_a_root_at_the_start(carried, found, choice):
    out = search(choice, of_roots([]), carried)
    assert bool(out["found"].item()) is found
    if found:
        assert out["s"].item() <= 4 * choice.engine.eps


def test_refine_keeps_to_its_bracket(choice):
    """Where Newton's steps leave the bracket, bisection goes on: a steep and a flat start."""
    polynomial = np.array([[-1e-6, *[-1e-6] * 8, 1.0], [-1.0, *[1e-6] * 9]])

    def program(xp, *b):
        zero, one = xp.full(b[0], 0.0), xp.full(b[0], 1.0)
        return {"s": refine(xp, b, Bracket(zero == 0, zero, one, -one))}

    s = choice.engine.run(program, list(polynomial.T))["s"].astype(float)
    value = np.einsum("nr,nr->n", bernstein(9, s), polynomial)
    # The slope is at most 9 times the greatest coefficient's difference.
    assert (np.abs(value) < 9 * 8 * choice.engine.eps).all() and ((s > 0) & (s < 1)).all()


def test_tolerance_is_positive_and_grows():
    for name in NAMES:
        k = kernel(name)
        one = tolerance(1e-7, k, 1.0)
        assert 0 < one < tolerance(1e-7, k, 2.0) < tolerance(1e-6, k, 2.0)
        assert tolerance(1e-7, k, 0.0) == 0
    assert tolerance(1e-7, kernel("linear"), 1.0) < tolerance(1e-7, kernel("bspline"), 1.0)
    ones = np.ones(64)
    assert behind(kernel("bspline"), ones) == pytest.approx(1, abs=1e-14)
    assert behind(kernel("catmull-rom"), ones) == pytest.approx((4 / 3) ** 3, abs=1e-14)
