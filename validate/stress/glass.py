"""Glass: the critical angle, indices next to 1, a plate and a ball, against Snell's law in closed form.

In: an engine. Out: `CASES`. eta = n_i / n_t is rounded to the engine's precision, and truth is that of the rounded one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from sdfbake.engine import Choice
from sdfrender import Flag, Rays
from validate.course import Course, Step
from validate.identities import across
from validate.stress.case import Case, Check
from validate.stress.optical import (
    BALL_CURVATURE,
    BALL_NORMAL,
    BALL_RADIUS,
    PLANE_NORMAL,
    PLANE_PLACE,
    SLOPE,
    SPREAD,
    USELESS,
    PerRay,
    Vectors,
    Way,
    ball,
    field,
    frames,
    met,
    oblique,
    relative,
)

INDEX = 1.5
# c'^2 = 1 - eta^2 (1 - c^2) is off by 2 eta^2 c s of the normal's error, 2.25, and that is over 2 delta; half in c'.
CRITICAL = 2.25 * PLANE_NORMAL / 4


def critical(choice: Choice) -> Iterator[Check]:
    """From inside, at sin = (1 - delta) / n, both sides of the critical angle."""
    rng, eps = np.random.default_rng(1), choice.engine.eps
    surface = field(oblique(np.arange(16.0)) - 37.25, (0.0, 0.0, 0.0), 1.0, choice)
    course = Course(surface, (INDEX,))
    for power in range(2, 13):
        delta = np.full(8, 10.0**-power)
        way, along, aside = _near(course, delta, rng, choice)
        bound = CRITICAL * eps * 10.0**power
        yield way.check(
            f"delta 1e-{power}: growth of dd against n c / c'",
            "relative",
            min(bound, USELESS),
            partial(_bent, dd_dx=along, dd_dy=aside),
            known="float32 keeps no digit of so small a cosine of the refracted ray" if bound > USELESS else "",
        )
    delta = np.repeat(np.concatenate([s * np.logspace(-2, -12, 21) for s in (1, -1)] + [np.zeros(2)]), 4)
    way, along, aside = _near(course, delta, rng, choice)
    total, decided = delta < 0, np.abs(delta) > 4 * CRITICAL * eps
    turned = (way.rays.dd_dx, way.rays.dd_dy)

    def wrong(steps: tuple[Step, ...], among: np.ndarray) -> PerRay:
        flag = (steps[0].after.flags & Flag.TIR) != 0
        return np.where(among, (flag != total) | ~steps[0].hits.hit, False).astype(float)

    def mirrored(steps: tuple[Step, ...]) -> PerRay:
        n, after = SLOPE / 3, steps[0].after
        errors = [
            relative(new, old - 2 * (old @ n)[:, None] * n)
            for new, old in zip((after.dd_dx, after.dd_dy, after.d), (*turned, way.rays.d), strict=True)
        ]
        return np.where(total & decided, np.maximum.reduce(errors), 0.0)

    yield way.check("TIR beyond the critical angle and not before", "count", 0.0, lambda steps: wrong(steps, decided))
    if choice.engine.precision == 32:
        known = "float32 knows the critical angle to 3e-5: closer rays may fall either way"
        near = (delta != 0) & ~decided
        yield way.check("TIR, closer to the angle than rounding", "count", 0.0, lambda s: wrong(s, near), known=known)
    # Twice the normal's error, in n and in d . n.
    yield way.check("what is reflected totally, against the mirror", "relative", 4 * PLANE_NORMAL * eps, mirrored)
    yield from way.guards(rng)


def _near(course: Course, delta: PerRay, rng: np.random.Generator, choice: Choice) -> tuple[Way, Vectors, Vectors]:
    """Rays at sin = (1 - delta) / n, and the closed forms of dd_dx and dd_dy beyond the surface.

    In the plane of incidence d turns n c / c' times as fast, across it n times, as sin' = n sin.
    """
    n, count = SLOPE / 3, len(delta)
    place = np.full(3, 7.5) - 0.25 / 3 * n + across(rng.uniform(-2, 2, (count, 3)), np.tile(n, (count, 1)))
    tangent = across(rng.normal(size=(count, 3)), np.tile(n, (count, 1)))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    aside, sine = np.cross(n, tangent), ((1 - delta) / INDEX)[:, None]
    c = np.sqrt(1 - sine**2)
    d, dd = c * n + sine * tangent, SPREAD * (c * tangent - sine * n)
    zero = np.zeros_like(d)
    rays = Rays(place - 3 * d, d, zero, zero, dd, SPREAD * aside)
    out = np.sqrt(np.maximum(delta * (2 - delta), 1e-30))[:, None]
    beyond = out * tangent - (1 - delta)[:, None] * n
    return Way.of(course, rays, choice), SPREAD * INDEX * c / out * beyond, SPREAD * INDEX * aside


def _bent(steps: tuple[Step, ...], dd_dx: Vectors, dd_dy: Vectors) -> PerRay:
    """Errors of both differentials beyond the surface, relative to the greater."""
    step, size = steps[0], np.linalg.norm(dd_dx, axis=1)
    pairs = ((step.after.dd_dx, dd_dx), (step.after.dd_dy, dd_dy))
    return met(step, np.maximum(*(relative(ours, truth, size) for ours, truth in pairs)))


def nothing(choice: Choice) -> Iterator[Check]:
    """Through a ball of an index 1 + 10^-k: eta below 1 on the way in, above on the way out."""
    rng, eps = np.random.default_rng(2), choice.engine.eps
    surface = ball(choice)
    light = Parallel.at(np.linspace(0.05, 0.8, 24), rng)
    rays, d, e, aside = light.rays(), light.d, light.e, light.aside
    # dd is made of mu dn and of the change of mu, at both surfaces: the curvature's and twice the normal's error,
    # over cos^2 for the latter at slopes down to 0.6.
    limit = (2 * BALL_CURVATURE + 8 * BALL_NORMAL / 0.36) * eps
    for power in range(1, 16):
        index = 1 + 10.0**-power
        way = Way.of(Course(surface, (index, index)), rays, choice)
        yield way.check(
            f"index 1 + 1e-{power}: dd, relative to itself",
            "relative",
            limit,
            partial(light.differentials, etas=_rounded(index, choice)),
        )
        if eps * 10.0**power > USELESS and choice.engine.precision == 32 and power in (8, 15):
            yield way.check(
                f"index 1 + 1e-{power}: dd, for the index as given",
                "relative",
                limit,
                partial(light.differentials, etas=(1 / index, index)),
                known="float32 holds no index between 1 and 1 + 1.2e-7",
            )
    moving = Rays(rays.p, d, 0.1 * e, 0.1 * aside, 1e-3 * (e + aside), 1e-3 * (e - aside))
    same = Way.of(Course(surface, (1.0, 1.0)), moving, choice)
    yield same.check("index 1: everything passes bit for bit", "absolute", 0.0, _unchanged)
    close = Way.of(Course(surface, (1 + 1e-6, 1 + 1e-6)), moving, choice)
    yield from close.guards(rng)


def _unchanged(steps: tuple[Step, ...]) -> PerRay:
    """Greatest change of any number at the two surfaces; a ray that misses one counts 1."""
    change = [
        np.max(np.abs(np.array(step.after.columns()) - np.array(step.at.columns())), axis=0) for step in steps[:2]
    ]
    return np.where(steps[0].hits.hit & steps[1].hits.hit, np.maximum(*change), 1.0)


def _rounded(index: float, choice: Choice) -> tuple[float, float]:
    """Ratios of indices on the way in and on the way out, as the engine holds them."""
    kind = np.float32 if choice.engine.precision == 32 else np.float64
    return float(kind(1.0 / index)), float(kind(index))


def _turned(b: PerRay, eta: float) -> tuple[PerRay, PerRay]:
    """Angle asin b - asin(eta b) and its derivative by b, with the digits of 1 - eta."""
    step, c, c_out = (1 - eta) * (1 + eta), np.sqrt(1 - b * b), np.sqrt(1 - (eta * b) ** 2)
    return np.arcsin(b * step / (c_out + eta * c)), step / (c * c_out * (c_out + eta * c))


@dataclass(frozen=True, slots=True, eq=False)
class Parallel:
    """A parallel beam through the unit ball, and what becomes of it.

    In the plane of incidence the ray turns by D(b), first asin b - asin(eta b) and then as much on the way out, so
    dd_dx = D' across the ray; the plane turns about the axis through the centre, so dd_dy = sin(D) / b.

    Attributes
    ----------
    b
        Heights over the axis.
    d, e, aside
        Direction of the rays, that of their height, and across both.
    """

    b: PerRay
    d: Vectors
    e: Vectors
    aside: Vectors

    @staticmethod
    def at(b: PerRay, rng: np.random.Generator) -> "Parallel":
        """Rays at given heights, each turned at random."""
        return Parallel(b, *frames(rng, b.size))

    def rays(self) -> Rays:
        """Rays with a beam of width 1."""
        zero = np.zeros_like(self.d)
        return Rays(self.b[:, None] * self.e - 3 * self.d, self.d, self.e, self.aside, zero, zero)

    def direction(self, steps: tuple[Step, ...], etas: tuple[float, float]) -> PerRay:
        """Error of d beyond the ball."""
        turn, _ = self._turned(etas)
        return self._met(steps, relative(steps[1].after.d, _across(np.cos(turn), self.d, -np.sin(turn), self.e)))

    def differentials(self, steps: tuple[Step, ...], etas: tuple[float, float]) -> PerRay:
        """Error of dd_dx and dd_dy beyond the ball, each relative to itself."""
        turn, slope = self._turned(etas)
        dd_dx = slope[:, None] * _across(-np.sin(turn), self.d, -np.cos(turn), self.e)
        on_axis = self.b == 0
        spin = np.where(on_axis, slope, np.sin(turn) / np.where(on_axis, 1.0, self.b))
        out = steps[1].after
        errors = relative(out.dd_dx, dd_dx), relative(out.dd_dy, -spin[:, None] * self.aside)
        return self._met(steps, np.maximum(*errors))

    def focal(self, steps: tuple[Step, ...], index: float) -> PerRay:
        """On the axis |dp| / |dd| is the focal length, with the |dp| of the beam before the ball, 1."""
        power = 2 * abs(index - 1) / index
        error = np.abs(np.linalg.norm(steps[1].after.dd_dx, axis=1) / power - 1)
        return np.where(self.b == 0, self._met(steps, error), 0.0)

    def _turned(self, etas: tuple[float, float]) -> tuple[PerRay, PerRay]:
        """D and D'."""
        (first, slope), (second, other) = _turned(self.b, etas[0]), _turned(etas[0] * self.b, etas[1])
        return first - second, slope - etas[0] * other

    def _met(self, steps: tuple[Step, ...], errors: PerRay) -> PerRay:
        return met(steps[0], met(steps[1], errors))


def _across(a: PerRay, u: Vectors, b: PerRay, v: Vectors) -> Vectors:
    return np.asarray(a[:, None] * u + b[:, None] * v)


THICK, AHEAD = 16.0, 10.0  # voxels: of the plate, and from a ray's origin to it


def slab(choice: Choice) -> Iterator[Check]:
    """A plate that lies obliquely in its grid, at angles to 75 degrees."""
    rng, eps, n = np.random.default_rng(3), choice.engine.eps, SLOPE / 3
    values = np.abs(oblique(np.arange(48.0)) - 117.25) - 3 * THICK / 2
    surface = field(values, (0.0, 0.0, 0.0), 1.0, choice)
    count = 120
    angle, flat = np.radians(np.linspace(0.0, 75.0, count)), np.tile(n, (count, 1))
    tangent = across(rng.normal(size=(count, 3)), flat)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    aside = np.cross(n, tangent)
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    inner = np.sqrt(1 - (s / INDEX) ** 2)
    d = s * tangent - c * n
    middle = np.full(3, 23.5) - 0.25 / 3 * n
    entry = middle + THICK / 2 * n - THICK / 2 * (s / INDEX / inner) * tangent
    zero = np.zeros_like(d)
    rays = Rays(entry - AHEAD * d, d, zero, zero, SPREAD * (c * tangent + s * n), SPREAD * aside)
    way = Way.of(Course(surface, (INDEX, INDEX)), rays, choice)
    # The normal's error turns a refracted ray by less than itself, over c' > 0.7 on the way in and over c on the way
    # out; places move by theirs over c.
    limit = (4 * PLANE_NORMAL + PLANE_PLACE / AHEAD) * eps
    cosine = c[:, 0]

    def shift(steps: tuple[Step, ...]) -> PerRay:
        moved = across(steps[1].at.p - steps[0].at.p, d)
        truth = THICK * s * (c / (INDEX * inner) - 1) * (c * tangent + s * n)
        return np.asarray(cosine * met(steps[1], relative(moved, truth, THICK)))

    def beyond(steps: tuple[Step, ...]) -> PerRay:
        out = steps[1].after
        errors = [relative(a, b) for a, b in ((out.d, d), (out.dd_dx, rays.dd_dx), (out.dd_dy, rays.dd_dy))]
        return np.asarray(cosine**2 * met(steps[1], np.maximum.reduce(errors)))

    def footprint(steps: tuple[Step, ...]) -> PerRay:
        # y = a tan + L tan' with the ways a and L across air and plate.
        within = AHEAD / c + THICK * c / (INDEX * inner**3)
        aside_ = AHEAD + THICK / (INDEX * inner)
        pairs = ((steps[1].at.dp_dx, SPREAD * within * tangent), (steps[1].at.dp_dy, SPREAD * aside_ * aside))
        return np.asarray(cosine**2 * met(steps[1], np.maximum(*(relative(ours, truth) for ours, truth in pairs))))

    yield way.check("displacement, times cos, over the thickness", "relative", limit, shift)
    yield way.check("error of d and dd beyond, times cos^2", "relative", limit, beyond)
    yield way.check("error of J on the far side, times cos^2", "relative", limit, footprint)
    yield from way.guards(rng, THICK)


def lens(choice: Choice) -> Iterator[Check]:
    """A parallel beam through a ball, on its axis and off it."""
    rng, eps = np.random.default_rng(4), choice.engine.eps
    surface = ball(choice)
    for index in (INDEX, 2.4, 0.75):
        heights = np.concatenate([np.zeros(8), np.linspace(0.01, 0.9 * min(index, 1.0), 40)])
        light, etas = Parallel.at(heights, rng), _rounded(index, choice)
        way = Way.of(Course(surface, (index, index)), light.rays(), choice)
        # Two surfaces, each off by its curvature, and by the normal's and the radius' errors over the cosines squared;
        # the least cosine is that of sin = 0.9.
        limit = 2 * (BALL_CURVATURE + (4 * BALL_NORMAL + 2 * BALL_RADIUS) / (1 - 0.9**2)) * eps
        checks = {
            "d beyond": partial(light.direction, etas=etas),
            "dd beyond": partial(light.differentials, etas=etas),
            "focal length n R / (2 (n - 1))": partial(light.focal, index=index),
        }
        for name, errors in checks.items():
            yield way.check(f"index {index}: {name}", "relative", limit, errors)
        yield from way.guards(rng, about=f", index {index}")


CASES = (
    Case(
        "critical-angle",
        "Refraction next to the critical angle",
        "At sin = (1 - delta) / n the differential grows by n c / c', like delta^-1/2; at the angle and beyond it all "
        "light is reflected, flagged TIR, with the mirror's differentials. Its relative error may grow like eps / "
        "delta, and nothing may be infinite, at the angle itself neither.",
        critical,
    ),
    Case(
        "index-near-one",
        "Indices of 1 + 1e-1 to 1 + 1e-15, and 1",
        "What a ball of almost no index does to a beam is as small as n - 1 and must keep its relative digits, so that "
        "c' - eta c may not be computed as it stands. An index of 1 must not change a bit.",
        nothing,
    ),
    Case(
        "parallel-slab",
        "A plate of glass",
        "A plate displaces a ray and leaves its direction; on its far side the footprint is the closed form's. What "
        "refraction does wrong twice in opposite ways would pass here, and not in the ball.",
        slab,
    ),
    Case(
        "ball-lens",
        "A ball of glass, of diamond, and a bubble",
        "A parallel beam turns by D(b) = 2 (asin b - asin(b / n)), its differentials are D' and sin(D) / b, and on the "
        "axis the focal length is n R / (2 (n - 1)).",
        lens,
    ),
)
