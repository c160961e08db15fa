"""The first root of the interpolant on a ray's way through one cell, certified.

In: where a ray enters and leaves a cell (cell coordinates, 0 to 1), the cell's coefficients, the sign it carries. Out:
whether there is a root, and an interval that holds just that one; `refine` then finds it to the last digit.

On the segment a + s (e - a), s in [0, 1], the tensor product of three cubics is one polynomial of degree 9 in s. Its
Bernstein coefficients come without sampling and without a matrix to invert: the coefficients of one axis' weight are
its polar form at (a,a,a), (a,a,e), (a,e,e), (e,e,e), and the product of Bernstein forms is a convolution of
coefficients scaled by binomials. A polynomial has at most as many roots as its coefficients change sign (variation
diminution): 0 changes certify none, 1 certifies one; more are split by de Casteljau.

Rounding. A coefficient below `tolerance` has no sign: it is passed over, and the last decided sign is carried on, from
cell to cell, so that no root slips through between two cells. docs/tracing.md derives the bound.
"""

from math import comb, sqrt
from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.kernels import Kernel
from sdfrender.vector import Vector

Polynomial = tuple[Array, ...]  # Bernstein coefficients on [0, 1]


class Bracket(NamedTuple):
    """An interval of s with one root, and the sign before it."""

    found: Array
    low: Array
    high: Array
    before: Array


def tolerance(eps: float, kernel: Kernel, largest: float) -> float:
    """Bound the rounding of a Bernstein coefficient of `ray_polynomial` (derived in docs/tracing.md).

    Parameters
    ----------
    eps
        Distance from 1 to the next float.
    kernel
        The kernel, for the number of operations.
    largest
        Greatest sum of |weight x coefficient| behind a control point of the nets of cells that may hold surface.
    """
    weights = 12 if kernel.degree > 1 else 1
    sums = kernel.taps + 2 * kernel.taps * (kernel.degree + 1) + 3
    return eps / 2 * (sums + 3 * weights) * largest


def ray_polynomial(xp: Engine, kernel: Kernel, coefficients: Array, enter: Vector, leave: Vector) -> Polynomial:
    """Return the interpolant along a segment of a cell as Bernstein coefficients.

    Parameters
    ----------
    xp
        The engine.
    kernel
        The kernel.
    coefficients
        The cell's coefficients, by `tables.stencil`, or taps^3 arrays, z fastest.
    enter, leave
        The segment's ends in cell coordinates, clamped to [0, 1].
    """
    by_axis = [_scaled_weights(xp, kernel, enter[axis], leave[axis]) for axis in range(3)]
    whole = xp.by_degree(coefficients, by_axis)
    degree = len(whole) - 1
    return tuple(value * (1.0 / comb(degree, r)) for r, value in enumerate(whole))


def _scaled_weights(xp: Engine, kernel: Kernel, a: Array, e: Array) -> list[list[Array]]:
    """Return the weights' Bernstein coefficients on [a, e], each times its binomial, by number and tap.

    Polar forms in the Bernstein basis of the cell, whose terms have one sign: in powers of a and e they cancel.
    """
    not_a, not_e = 1.0 - a, 1.0 - e
    if kernel.degree == 1:
        return [[not_a, a], [not_e, e]]
    aa, ee, bb, ff = a * a, e * e, not_a * not_a, not_e * not_e
    inner, outer = 2.0 * (a * not_a), 2.0 * (e * not_e)
    forms = (
        (bb * not_a, 3.0 * (a * bb), 3.0 * (aa * not_a), aa * a),
        (bb * not_e, xp.fma(inner, not_e, bb * e), xp.fma(inner, e, aa * not_e), aa * e),
        (ff * not_a, xp.fma(outer, not_a, ff * a), xp.fma(outer, a, ee * not_a), ee * a),
        (ff * not_e, 3.0 * (e * ff), 3.0 * (ee * not_e), ee * e),
    )
    rows = []
    for form, binomial in zip(forms, (1.0, 3.0, 3.0, 1.0), strict=True):
        row = []
        for ordinates in kernel.bezier.T.tolist():
            used = [(s, ordinate) for s, ordinate in enumerate(ordinates) if ordinate]
            value = form[used[0][0]] * (used[0][1] * binomial)
            for s, ordinate in used[1:]:
                value = xp.fma(form[s], ordinate * binomial, value)
            row.append(value)
        rows.append(row)
    return rows


def sign_changes(xp: Engine, polynomial: Polynomial, sign: Array, bound: Array) -> tuple[Array, Array]:
    """Count the sign changes of (sign, coefficients), passing over |b| <= bound; also return the last sign."""
    changes = xp.full(polynomial[0], 0)
    above, below = sign > 0, sign < 0  # masks: in either precision they cost the same
    for value in polynomial:
        positive, negative = value > bound, value < -bound
        changes = changes + xp.integer((positive & below) | (negative & above))
        above, below = positive | (above & ~negative), negative | (below & ~positive)
    return changes, xp.where(above, 1.0, xp.where(below, xp.full(polynomial[0], -1.0), 0.0))


class _Split(NamedTuple):
    """State of the search: the rest of the segment from `low` on, of which the share `cut` is tried next."""

    working: Array
    bracket: Bracket
    cut: Array
    rest: Polynomial


def isolate(xp: Engine, polynomial: Polynomial, sign: Array, bound: Array, active: Array) -> tuple[Bracket, Array]:
    """Find an interval with the first root only.

    Parameters
    ----------
    xp
        The engine.
    polynomial
        Bernstein coefficients on [0, 1].
    sign
        Sign carried from before the segment: -1, 1, or 0 where it is not known yet.
    bound
        Rounding bound of a coefficient, by ray.
    active
        Rays that ask.

    Returns
    -------
    Bracket
        Where the first root is.
    Array
        The sign after the segment.
    """
    changes, after = sign_changes(xp, polynomial, sign, bound)
    odd = (changes & 1) == 1
    before = xp.where(sign == 0, xp.where(odd, -after, after), sign)
    zero, one = xp.full(polynomial[0], 0.0), xp.full(polynomial[0], 1.0)
    start = _Split(
        xp.integer(active & (changes >= 2)),
        Bracket(active & (changes == 1), zero, one, before),
        xp.full(polynomial[0], 0.5),
        polynomial,
    )
    smallest = sqrt(xp.eps)  # below, a bulge that the coefficients show is under the rounding bound itself

    def halve(state: _Split, bound: Array) -> _Split:
        found, low, _high, before = state.bracket
        left, right = _de_casteljau(xp, state.rest, state.cut)
        changes, after = sign_changes(xp, left, before, bound)
        end = xp.fma(state.cut, 1.0 - low, low)
        tiny = state.cut * (1.0 - low) < smallest
        here = (changes == 1) | ((changes >= 2) & tiny)
        none, whole = changes == 0, state.cut >= 1.0
        go_on = none & ~whole
        bracket = Bracket(
            found | here,
            xp.where(go_on, end, low),
            xp.where(here, end, state.bracket.high),
            xp.where(go_on, after, before),
        )
        rest = tuple(xp.where(go_on, new, old) for new, old in zip(right, state.rest, strict=True))
        cut = xp.where(go_on, 1.0, state.cut * 0.5)
        return _Split(xp.integer(~(here | (none & whole))), bracket, cut, rest)

    end = xp.while_loop(lambda state: state.working > 0, halve, start, bound)
    return end.bracket, after


def _de_casteljau(xp: Engine, polynomial: Polynomial, at: Array) -> tuple[Polynomial, Polynomial]:
    """Split Bernstein coefficients into those left and right of a parameter."""
    row = list(polynomial)
    left, right = [row[0]], [row[-1]]
    while len(row) > 1:
        row = [xp.fma(at, row[i + 1] - row[i], row[i]) for i in range(len(row) - 1)]
        left.append(row[0])
        right.append(row[-1])
    return tuple(left), tuple(reversed(right))


class _Newton(NamedTuple):
    """State of the refinement."""

    working: Array
    s: Array
    low: Array
    high: Array


def refine(xp: Engine, polynomial: Polynomial, bracket: Bracket) -> Array:
    """Return the root in the bracket to two units in the last place, by Newton's method inside bisection."""
    degree = len(polynomial) - 1
    value_form = tuple(b * float(comb(degree, r)) for r, b in enumerate(polynomial))
    slope_form = tuple((polynomial[r + 1] - polynomial[r]) * float(degree * comb(degree - 1, r)) for r in range(degree))
    found, low, high, before = bracket
    middle = 0.5 * (low + high)
    secant = polynomial[0] / (polynomial[0] - polynomial[-1])
    usable = (low == 0.0) & (high == 1.0) & (secant > low) & (secant < high)
    start = _Newton(xp.integer(found), xp.where(usable, secant, middle), low, high)

    def step(state: _Newton, constants: tuple[Polynomial, Polynomial, Array]) -> _Newton:
        values, slopes, before = constants
        value, slope = _horner(xp, values, state.s), _horner(xp, slopes, state.s)
        not_yet = value * before > 0
        low, high = xp.where(not_yet, state.s, state.low), xp.where(not_yet, state.high, state.s)
        newton = state.s - value / slope
        # Never the bracket's other end, which was there before: two ends can send Newton to and fro for ever.
        stays, inside = (value == 0) | (newton == state.s), (newton > low) & (newton < high)
        s = xp.where(stays, state.s, xp.where(inside, newton, 0.5 * (low + high)))
        done = (xp.abs(s - state.s) <= 2 * xp.eps) | (high - low <= 2 * xp.eps) | (value == 0)
        return _Newton(xp.integer(~done), s, low, high)

    return xp.while_loop(lambda state: state.working > 0, step, start, (value_form, slope_form, before)).s


def _horner(xp: Engine, scaled: Polynomial, s: Array) -> Array:
    """Evaluate a scaled Bernstein form."""
    rest = 1.0 - s
    total, power = scaled[0], s
    for coefficient in scaled[1:]:
        total = xp.fma(total, rest, coefficient * power)
        power = power * s
    return total
