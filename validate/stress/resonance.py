"""Mirrors that face light or each other: a focus, an unstable pair, a stable one, by the matrices of paraxial optics.

In: an engine. Out: `CASES`. On the axis of two mirrors a beam (dp, dd) is multiplied by [[1, G], [0, 1]] over a gap G
and by [[1, 0], [-2 k, 1]] at a mirror of curvature k, positive where it is concave; displacements across the axis keep
their direction. Off the axis the two foci are Coddington's.
"""

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Choice
from sdfrender import Flag, Rays
from sdfrender.rays import COLUMNS
from validate.course import Course, Step
from validate.identities import ROUNDINGS, direction_defect, perturbed, symplectic_defect
from validate.stress.bounced import bounced
from validate.stress.case import Case, Check, Finding
from validate.stress.optical import (
    BALL_CURVATURE,
    MARGIN,
    PerRay,
    Vectors,
    Way,
    ball,
    field,
    flagged,
    frames,
    met,
    relative,
)

Matrix = Float[np.ndarray, "2 2"]


def focus(choice: Choice) -> Iterator[Check]:
    """The inside of a ball as a mirror, lit from points on its axis and off it."""
    yield from _on_axis(choice, np.random.default_rng(1))
    yield from _off_axis(choice, np.random.default_rng(2))


def _on_axis(choice: Choice, rng: np.random.Generator) -> Iterator[Check]:
    """Sources at distances s from the mirror; the image at 1 / s' = 2 - 1 / s lies in the ball for s > 2 / 3."""
    surface, eps = ball(choice), choice.engine.eps
    # Where both foci reach the far wall together the cross-section is a square, so its sign is known to sqrt(eps) only.
    least = 10 * BALL_CURVATURE * eps + 4 * eps**0.5
    ahead = np.geomspace(least, 0.25, 24)  # of the wall, 2 / s' - 1 = 3 - 2 / s; as much beyond it
    s = np.concatenate([np.linspace(0.05, 1.95, 48), 2 / (3 - ahead), 2 / (3 + ahead)])
    u, a, b = frames(rng, s.size)
    zero = np.zeros_like(u)
    parallel = Rays((1 - s)[:, None] * u, u, a, b, zero, zero)
    way = Way.of(Course(surface, (None,)), parallel, choice)
    limit = 4 * BALL_CURVATURE * eps  # dd = -2 k dp by the curvature, and the way of 1/2 by little more
    yield way.check("a parallel beam's width at R / 2", "of the beam", limit, lambda steps: _width(steps[0], 0.5))
    yield way.check("CAUSTIC there", "count", 0.0, lambda steps: (~flagged(steps[1], Flag.CAUSTIC)).astype(float))
    image = Way.of(Course(surface, (None,)), Rays(parallel.p, u, zero, zero, a, b), choice)

    def abcd(steps: tuple[Step, ...]) -> PerRay:
        # Over the way s, the mirror, the way 2 across: (2 - 3 s, 1 - 2 s), relative to the terms that it is made of.
        ends, size = np.array([2 - 3 * s, 1 - 2 * s]), s + 2 * (1 + 2 * s)
        return met(steps[1], _beam_error(steps[1].at, (a, b), ends, size))

    def wrong(steps: tuple[Step, ...], among: PerRay) -> PerRay:
        mistaken = (flagged(steps[1], Flag.CAUSTIC) != (s > 2 / 3)) | flagged(steps[0], Flag.CAUSTIC)
        return np.where(among, mistaken, False).astype(float)

    close = np.abs(3 - 2 / s) < 0.3
    yield image.check("(dp, dd) across the ball against the matrices", "relative", limit, abcd)
    yield image.check("CAUSTIC where the image is in the ball", "count", 0.0, lambda steps: wrong(steps, ~close))
    yield image.check(
        "CAUSTIC where the image is close to the far wall",
        "count",
        0.0,
        lambda steps: wrong(steps, close),
    )
    yield from image.guards(rng, about=", on the axis")


def _width(step: Step, way: float) -> PerRay:
    """How wide the beam is some way beyond a surface."""
    after = step.after
    return met(step, np.maximum(*(np.linalg.norm(dp + way * dd, axis=1) for dp, dd in _moves(after))))


def _beam_error(
    rays: Rays,
    sides: tuple[Vectors, Vectors],
    ends: Float[np.ndarray, "2 n"],
    size: PerRay | None = None,
) -> PerRay:
    """Greatest error of a beam whose dp and dd are `ends` times two unit vectors; relative to them, or to a size."""
    errors = [
        relative(ours, end[:, None] * side, size)
        for side, moves in zip(sides, _moves(rays), strict=True)
        for ours, end in zip(moves, ends, strict=True)
    ]
    return np.asarray(np.maximum.reduce(errors))


def _moves(rays: Rays) -> tuple[tuple[Vectors, Vectors], tuple[Vectors, Vectors]]:
    return (rays.dp_dx, rays.dd_dx), (rays.dp_dy, rays.dd_dy)


def _off_axis(choice: Choice, rng: np.random.Generator) -> Iterator[Check]:
    """Sources on chords at angles up to 70 degrees: 1 / s' = 2 / cos - 1 / s in the plane, 2 cos - 1 / s across it."""
    count = 400
    cosine = np.cos(rng.uniform(0.05, 1.2, count))
    chord = 2 * cosine
    s = rng.uniform(0.05, 0.95, count) * chord
    n, e, _ = frames(rng, count)
    d = cosine[:, None] * n + np.sqrt(1 - cosine**2)[:, None] * e
    turn, a = rng.uniform(0, 2 * np.pi, (count, 1)), np.cross(d, n)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b, zero = np.cross(d, a), np.zeros_like(d)
    across, aside = np.cos(turn) * a + np.sin(turn) * b, np.cos(turn) * b - np.sin(turn) * a
    rays = Rays(n - s[:, None] * d, d, zero, zero, across, aside)
    way = Way.of(Course(ball(choice), (None,)), rays, choice)
    within = [image - 1 / chord for image in (2 / cosine - 1 / s, 2 * cosine - 1 / s)]
    # What is closer to the far wall than rounding of the curvature can move it is not decided.
    sharp = np.min(np.abs(within), axis=0) > 10 * BALL_CURVATURE * choice.engine.eps / cosine
    expected = (within[0] > 0) | (within[1] > 0)
    yield way.check(
        "oblique: CAUSTIC where one of Coddington's foci is on the chord",
        "count",
        0.0,
        lambda steps: np.where(sharp, flagged(steps[1], Flag.CAUSTIC) != expected, False).astype(float),
    )
    yield from way.guards(rng, about=", off the axis")


# Two balls of radius 1 that face each other at a gap of 1: every bounce multiplies the beam by 2 + sqrt(3).
GAP, BOUNCES = 1.0, 60
CONVEX = np.array([[1.0, 0.0], [2.0, 1.0]])


def unstable(choice: Choice) -> Iterator[Check]:
    """On the axis, where symmetry holds the ray; thin beams and wide ones.

    Any rounding across the axis would grow like the beam: the coefficients must be the same on both sides to the last
    bit, as Catmull-Rom's are, which are the samples.
    """
    rng = np.random.default_rng(3)
    x, z = np.arange(-6, 7) / 8, np.arange(-9, 10) / 8
    values = (x**2)[:, None, None] + (x**2)[:, None] + (np.abs(z) - 1 - GAP / 2) ** 2 - 1
    surface = field(values, (x[0], x[0], z[0]), 1 / 8, choice, "catmull-rom")
    starts = np.array([[1e-6, 0.0], [0.0, 1e-6], [1e-3, 1e-3], [1.0, 0.5], [0.0, 1.0], [1e-30, 1e-30]])
    rays, a, b = _axial(starts, rng)
    ends = starts @ (CONVEX @ _way(GAP / 2)).T @ np.linalg.matrix_power(CONVEX @ _way(GAP), BOUNCES - 1).T
    way = Way.of(Course(surface, (None,) * BOUNCES), rays, choice)

    def growth(steps: tuple[Step, ...]) -> PerRay:
        return met(steps[BOUNCES - 1], _beam_error(steps[BOUNCES - 1].after, (a, b), ends.T))

    # All entries are positive, so nothing cancels: every bounce adds the error of the curvature, for which
    # Catmull-Rom's weights add up to 12 in place of 4, and less for the gap.
    limit = 2 * BOUNCES * 3 * BALL_CURVATURE * choice.engine.eps
    yield way.check(f"(dp, dd) after {BOUNCES} bounces", "relative", limit, growth)
    yield way.check(
        "flags on the way: none, as the beam spreads",
        "count",
        0.0,
        lambda steps: np.sum([step.hits.flags != 0 for step in steps], axis=0).astype(float),
    )
    yield from way.guards(rng)


def _way(gap: float) -> Matrix:
    return np.array([[1.0, gap], [0.0, 1.0]])


def _axial(starts: Float[np.ndarray, "n 2"], rng: np.random.Generator) -> tuple[Rays, Vectors, Vectors]:
    """Rays up the z axis from the origin, with beams (dp, dd) along two directions across it, turned at random."""
    count, turn = len(starts), rng.uniform(0, 2 * np.pi, len(starts))
    zero = np.zeros(count)
    a = np.stack([np.cos(turn), np.sin(turn), zero], axis=1)
    b = np.stack([-np.sin(turn), np.cos(turn), zero], axis=1)
    p, d = np.zeros((count, 3)), np.tile([0.0, 0.0, 1.0], (count, 1))
    dp, dd = starts[:, :1], starts[:, 1:]
    return Rays(p, d, dp * a, dp * b, dd * a, dd * b), a, b


# Two concave mirrors of radius 1 at 10 voxels of 1/16: half the trace of a bounce is 1 - SHORT = 0.375.
SHORT, LONG = 0.625, 1000
CONCAVE = np.array([[1.0, 0.0], [-2.0, 1.0]])
MARKS = 10  # of the way, where it is looked at
SHOWN = 20  # bounces that a replay shows
# As for a ball, with M = 0.43 at 16 voxels per radius: 30 u M (4 / h^2) / 2.
SHORT_CURVATURE = 3300.0
# Where rays start in the middle plane, straight up: on the axis and off it.
OFF = ((0.0, 0.0), (0.0, 0.0), (0.02, 0.0), (0.0, 0.05), (0.05, -0.05), (-0.1, 0.02))


def stable(choice: Choice) -> Iterator[Check]:
    """A ray on the axis against the power of the matrix; rays off it stay in the resonator."""
    rng, eps = np.random.default_rng(4), choice.engine.eps
    x, z = np.arange(-8, 9) / 16, np.arange(-5 - MARGIN, 6 + MARGIN) / 16
    values = (x**2)[:, None, None] + (x**2)[:, None] + (np.abs(z) + 1 - SHORT / 2) ** 2 - 1
    surface = field(values, (x[0], x[0], z[0]), 1 / 16, choice)
    count = len(OFF)
    p, d = np.pad(np.array(OFF), ((0, 0), (0, 1))), np.tile([0.0, 0.0, 1.0], (count, 1))
    bundles = perturbed(p, d, rng)
    begin = Rays(*(np.concatenate([getattr(bundle, name) for bundle in bundles]) for name in COLUMNS))
    halves = np.arange(count), np.arange(count, 2 * count)
    marks = cache(lambda: bounced(surface, begin, LONG, MARKS))
    short = Way.of(Course(surface, (None,) * SHOWN), begin.where(halves[0]), choice)

    def check(name: str, unit: str, limit: float, error: Callable[[int, Rays], PerRay]) -> Check:
        def find() -> Finding:
            every = np.max([error(number, rays) for number, rays in marks()], axis=0)
            return Finding(every.reshape(-1, count).max(axis=0), short.rays)

        return Check(name, unit, limit, find, lambda: short.course)

    def drift(number: int, rays: Rays) -> PerRay:
        before, after = ([bundle.where(half) for half in halves] for bundle in (begin, rays))
        return symplectic_defect((before[0], before[1]), (after[0], after[1]))

    def power(number: int, rays: Rays) -> PerRay:
        (a, b), (c, e) = _resonator(number)
        errors = []
        for (dp, dd), (dp_, dd_) in zip(_moves(begin), _moves(rays), strict=True):
            truth = np.concatenate([a * dp + b * dd, c * dp + e * dd], axis=1)
            errors.append(relative(np.concatenate([dp_, dd_], axis=1), truth))
        return np.where(np.any(begin.p[:, :2] != 0, axis=1), 0.0, np.maximum(*errors))

    # Every bounce turns the beam's phase by as much as the curvature is off, in the same sense at worst.
    turn = min(LONG * SHORT_CURVATURE * eps, 0.1)
    yield check("on the axis: (dp, dd) against the power of the matrix", "relative", turn, power)
    yield check("symplectic form, now against at first", "relative", ROUNDINGS * eps, drift)
    # A mirror's n . n is off by 2 eps, and turns d into d (1 - 2 n . n).
    yield check("length of d, and d . dd", "relative", 8 * LONG * eps, lambda _, rays: direction_defect(rays))
    yield check("unfinite numbers", "count", 0.0, lambda _, rays: np.sum(~np.isfinite(rays.columns()), axis=0) * 1.0)
    # Aberration moves a ray by the square of its distance from the axis, at most 0.15 radii.
    yield check(
        "distance from the axis over its paraxial bound", "relative", 1.1, lambda _, rays: _strayed(begin, rays)
    )
    yield from short.guards(rng)


def _resonator(bounces: int) -> Matrix:
    """From the middle through a number of bounces."""
    step = CONCAVE @ _way(SHORT)
    return np.asarray(np.linalg.matrix_power(step, bounces - 1) @ CONCAVE @ _way(SHORT / 2))


def _strayed(begin: Rays, rays: Rays) -> PerRay:
    """Distance from the axis over the greatest that a paraxial ray has at a mirror; on the axis, over a voxel."""
    start, now = (np.hypot(*bundle.p[:, :2].T) for bundle in (begin, rays))
    return np.asarray(now / np.where(start > 0, _reach() * start, 1 / 16))


@cache
def _reach() -> float:
    """How far a paraxial ray comes from the axis at a mirror, over how far it starts, at most."""
    return float(max(abs(_resonator(number)[0, 0]) for number in range(1, LONG + 1)))


CASES = (
    Case(
        "mirror-focus",
        "A concave mirror at its focus",
        "The inside of a ball focuses a parallel beam at R / 2, and any source where the mirror's equation says. "
        "CAUSTIC must be set where an image lies on the segment and nowhere else, though on the axis both foci fall "
        "together and the cross-section does not change its sign.",
        focus,
    ),
    Case(
        "facing-mirrors",
        "Two balls that face each other, 60 bounces",
        "An unstable resonator multiplies the beam by its matrix at every bounce: 2e34 after 60, close to the end of "
        "float32. Growth must be the closed form's, nothing may overflow, and no flag may be set.",
        unstable,
    ),
    Case(
        "stable-resonator",
        "Two concave mirrors, 1000 bounces",
        "Each bounce is a symplectic map, so the form must not drift, rays near the axis must stay there, and on it "
        "(dp, dd) is the 1000th power of a known matrix.",
        stable,
    ),
)
