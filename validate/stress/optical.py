"""What the optical cases share: surfaces without discretisation error, and the checks that every case has.

In: an engine, a course, rays. Out: fields, `Check`s. A cubic kernel of order four reproduces planes and quadrics, and
their values at dyadic places are float32 numbers: the surface that is traced *is* the plane or the ball, and closed
forms hold to rounding, which is derived here once.

Rounding. A derivative of the interpolant is a sum over 4 x 4 x 4 taps: along each axis 4 products and sums with weights
of 5 roundings, the stored coefficient 1 more, 30 in all, u = eps / 2 each, relative to the greatest |tap|, M, times the
sum of the weights' magnitudes (1, 2 / h, 4 / h^2). A ray's place is good to 11 N u voxels, a root's value to
2 tau = 150 u M (docs/tracing.md). Taps lie within 2 sqrt(3) voxels of a hit.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float

from sdfbake import Grid
from sdfbake.engine import Choice
from sdfrender import GridField, Rays
from validate.course import Course, Step, defects, follow
from validate.identities import ROUNDINGS
from validate.stress.case import Check, Finding

Vectors = Float[np.ndarray, "n 3"]
PerRay = Float[np.ndarray, " n"]

RADIUS = 8  # voxels, of a ball of radius 1
MARGIN = 5  # voxels around a surface that no stencil reaches
SPREAD = 1e-3  # radians per pixel
USELESS = 0.1  # of a footprint: beyond, no figure of it is worth having
# A ball: |p|^2 - 1 has M = 1.06 behind a hit, a gradient of 2, a Hessian of 2. The normal is good to
# 30 u M (2 / h) / 2 = 130 eps, the curvature to 30 u M (4 / h^2) / 2 = 2040 eps, the radius to
# (150 u M / 2 + 11 * 32 u h) = 62 eps.
BALL_NORMAL, BALL_CURVATURE, BALL_RADIUS = 130.0, 2040.0, 62.0
# A plane: |g . x - c| / |g| is at most 2 voxels times |g|_1 / |g|, 3.4 for g = (2, 1, 2); the normal is good to
# 30 u M 2 = 100 eps, the place to (150 u M + 11 N u) = 340 eps voxels for N = 16, 520 for N = 48.
PLANE_NORMAL, PLANE_PLACE = 100.0, 520.0


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Rays along a course, traced when first asked for, and once.

    Attributes
    ----------
    course, rays
        What is traced.
    choice
        The engine that does.
    steps
        Gives the steps, one per surface.
    """

    course: Course
    rays: Rays
    choice: Choice
    steps: Callable[[], tuple[Step, ...]]

    @staticmethod
    def of(course: Course, rays: Rays, choice: Choice) -> "Way":
        """Prepare a course and its rays."""
        return Way(course, rays, choice, cache(lambda: tuple(follow(course, rays))))

    @property
    def eps(self) -> float:
        """Distance from 1 to the next float of the engine."""
        return self.choice.engine.eps

    def check(
        self, name: str, unit: str, limit: float, errors: Callable[[tuple[Step, ...]], PerRay], *, known: str = ""
    ) -> Check:
        """Judge the steps: an error per ray."""
        return Check(name, unit, limit, lambda: Finding(errors(self.steps()), self.rays), lambda: self.course, known)

    def guards(self, rng: np.random.Generator, length: float = 1.0, about: str = "") -> Iterator[Check]:
        """Make the checks of every optical case: nothing is NaN or infinite, and the identities hold.

        At a surface dp is a difference of terms 1 / |d . n| long, and rounded relative to those: the symplectic defect
        is multiplied by the cosine. `about` says which rays, where a case has several ways.
        """
        yield self.check(f"finite{about}", "count", 0.0, unfinite)
        seed = int(rng.integers(2**31))

        def identities() -> Finding:
            found = defects(self.course, self.rays, np.random.default_rng(seed), length)
            slope = np.abs([np.sum(step.hits.n * step.at.d, axis=1) for step in self.steps()])
            every = np.maximum.reduce([slope * found.symplectic, found.direction, found.surface])
            return Finding(every.max(axis=0), self.rays)

        yield Check(f"identities{about}", "relative", ROUNDINGS * self.eps, identities, lambda: self.course)


def unfinite(steps: tuple[Step, ...]) -> PerRay:
    """How many numbers of a ray are NaN or infinite, over all steps; the distance of a miss, infinite, is none."""
    count = np.zeros(len(steps[0].hits.t))
    for step in steps:
        columns = [*step.hits.p.T, *step.hits.n.T, np.where(step.hits.hit, step.hits.t, 0.0)]
        for rays in (step.before, step.at, step.after):
            columns += rays.columns()
        count += np.sum(~np.isfinite(columns), axis=0)
    return np.asarray(count)


def relative(ours: Vectors, truth: Vectors, size: PerRay | float | None = None) -> PerRay:
    """|ours - truth| / |truth|, or over another size; where the truth is 0, whether ours is not."""
    length = np.linalg.norm(truth, axis=1) if size is None else np.broadcast_to(size, len(truth))
    difference = np.linalg.norm(ours - truth, axis=1)
    shares = difference / np.where(length > 0, length, 1.0)
    return np.asarray(np.where(length > 0, shares, (difference > 0).astype(float)))


def met(step: Step, errors: PerRay) -> PerRay:
    """Errors at a surface; a ray that misses it has lost everything, 1."""
    return np.where(step.hits.hit, np.nan_to_num(errors, nan=np.inf), 1.0)


def flagged(step: Step, flag: int) -> Bool[np.ndarray, " n"]:
    """Which hits carry a flag."""
    return np.asarray((step.hits.flags & flag) != 0)


def frames(rng: np.random.Generator, count: int) -> tuple[Vectors, Vectors, Vectors]:
    """Three unit vectors across each other, turned at random, right-handed."""
    first, second = rng.normal(size=(2, count, 3))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second -= np.sum(second * first, axis=1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    return first, second, np.cross(first, second)


def ball(choice: Choice) -> GridField:
    """The unit ball about the origin, as |p|^2 - 1 on a grid of RADIUS voxels: no distance, but the same surface."""
    x = np.arange(-RADIUS - MARGIN, RADIUS + MARGIN + 1) / RADIUS
    values = (x**2)[:, None, None] + (x**2)[:, None] + x**2 - 1.0
    return field(values, (x[0], x[0], x[0]), 1 / RADIUS, choice)


SLOPE = np.array([2.0, 1.0, 2.0])  # of the oblique plane, whose unit normal it is times 3


def oblique(x: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m m m"]:
    """SLOPE . p on the cube of nodes x."""
    return np.asarray(SLOPE[0] * x[:, None, None] + SLOPE[1] * x[:, None] + SLOPE[2] * x)


def field(
    values: Float[np.ndarray, "nx ny nz"],
    origin: tuple[float, float, float],
    spacing: float,
    choice: Choice,
    kernel: str = "bspline",
) -> GridField:
    """Read samples as a surface.

    Raises
    ------
    ValueError
        If float32 does not hold the samples exactly: the closed forms would be those of another surface.
    """
    if not np.array_equal(values.astype(np.float32), values):
        raise ValueError("samples are not float32 numbers: choose dyadic places")
    return GridField(Grid.from_dense(values, origin=origin, spacing=spacing), kernel, choice)
