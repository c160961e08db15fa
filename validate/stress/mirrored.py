"""What the cases on geometry measure: rays that meet a surface, and are mirrored there.

In: a field, rays, and what closed forms say of the place that each meets. Out: errors per ray; the checks that such
cases have in common: J in closed form, identities, and that all is finite.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache, partial

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from datasets_synthetic import ExactShape
from sdfbake import Grid
from sdfbake.engine import Choice
from sdfrender import GridField, Hits, Rays, reflect, transfer
from validate.beam import Beam, MeshRays
from validate.course import Course, Event, as_rays, defects
from validate.identities import ROUNDINGS, PerRay, perturbed
from validate.stress.case import Check, Finding

MIRROR: tuple[Event, ...] = (None,)
LEAST = 0.3  # cosine of the steepest rays
# A Hessian's entry sums 64 products of coefficients of up to 6 voxels with weights that sum to 10, per h^2; in units
# of 1 / r, with the roundings of three such and of a mirror:
SUMS = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class Met:
    """Rays at their first surface, and mirrored there."""

    hits: Hits
    at: Rays
    out: Rays


@lru_cache(maxsize=4)
def met(field: GridField, rays: MeshRays, *, on_surface: bool = False) -> Met:
    """Trace and mirror rays; the last few answers are kept, as several checks look at the same."""
    hits, at = transfer(field, as_rays(rays), on_surface=on_surface)
    return Met(hits, at, reflect(field, hits, at))


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places of a surface in closed form.

    Attributes
    ----------
    p, n
        (m, 3): where they are, world, and the outward unit normal there.
    operator
        (m, 3, 3): shape operator, dn = operator dp, per world unit.
    """

    p: Float[np.ndarray, "m 3"]
    n: Float[np.ndarray, "m 3"]
    operator: Float[np.ndarray, "m 3 3"]

    @staticmethod
    def of(shape: ExactShape, near: Float[np.ndarray, "m 3"]) -> "Places":
        """The places of a shape's surface that are closest to points."""
        p = near
        for _ in range(2):  # the second step takes off the first one's rounding
            p = p - shape.distance(p)[:, None] * shape.normal(p)
        return Places(p, shape.normal(p), shape.hessian(p))

    @staticmethod
    def flat(p: Float[np.ndarray, "m 3"], n: Float[np.ndarray, " 3"]) -> "Places":
        """Places of a plane."""
        return Places(p, np.tile(n, (len(p), 1)), np.zeros((len(p), 3, 3)))

    def mirror(self, rays: Beam) -> MeshRays:
        """Rays that meet these places, mirrored: Igehy 1999, eq. 10, 11, 14 and 15."""
        slope, t = _dot(self.n, rays.d), _dot(self.p - rays.p, rays.d)
        moved, turned = [], []
        for dp, dd in ((rays.dp_dx, rays.dd_dx), (rays.dp_dy, rays.dd_dy)):
            straight = dp + t * dd
            on = straight - _dot(self.n, straight) / slope * rays.d
            dn = np.einsum("nij,nj->ni", self.operator, on)
            moved.append(on)
            turned.append(dd - 2 * (slope * dn + (_dot(dd, self.n) + _dot(rays.d, dn)) * self.n))
        return MeshRays(self.p, rays.d - 2 * slope * self.n, moved[0], moved[1], turned[0], turned[1])


def towards(places: Places, rng: np.random.Generator, length: float, least: float = LEAST) -> MeshRays:
    """Rays that come to places from outside, from so far, at cosines from `least` to 1, perturbed at random."""
    tangent = np.cross(places.n, rng.normal(size=places.n.shape))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    cosine = rng.uniform(least, 1.0, (len(tangent), 1))
    d = -cosine * places.n + np.sqrt(1 - cosine**2) * tangent
    return perturbed(places.p - length * d, d, rng, length)[0]


def between(p: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> MeshRays:
    """Rays from places to targets, perturbed at random."""
    d = target - p
    return perturbed(p, d / np.linalg.norm(d, axis=1, keepdims=True), rng)[0]


def change(ours: Beam, truth: Beam, length: float) -> PerRay:
    """||J - J*|| / ||J*|| with J all four differentials, positions in units of `length`."""
    names = (("dp_dx", length), ("dp_dy", length), ("dd_dx", 1.0), ("dd_dy", 1.0))
    a, b = (np.concatenate([getattr(beam, name) / unit for name, unit in names], axis=1) for beam in (ours, truth))
    return np.asarray(np.linalg.norm(a - b, axis=1) / np.linalg.norm(b, axis=1))


def bend_limit(choice: Choice, h: float, r: float) -> float:
    """Of the relative error of a mirrored J at a surface of least radius r sampled at h: the kernel's and rounding's.

    Along a line at an angle with sine s and cosine c to the normal, the fourth derivative of |p| - r is
    3 s^2 (5 c^2 - 1) / r^3, at most 3 / r^3. A second derivative of the B-spline is off by h^2 / 12 of it to leading
    order (h^2 / 8 of a chord, h^2 / 12 of the coefficients, of opposite sign); so the matrix of curvatures, with three
    such entries and the mixed ones, by half of (h / r)^2 / r; a mirror doubles it.
    """
    return (h / r) ** 2 + SUMS * choice.engine.eps * r / h


def mirror_check(field: GridField, places: Places, rays: MeshRays, r: float, limit: float, of: str = "") -> Check:
    """A mirrored J against the closed form, lengths in units of r; a miss has no J and counts as 1."""

    def find() -> Finding:
        found = met(field, rays)
        return Finding(np.where(found.hits.hit, change(found.out, places.mirror(rays), r), 1.0), rays)

    return Check(f"{of}mirrored J against the closed form", "relative", limit, find, mirror_course(field))


@dataclass(frozen=True, slots=True)
class Frame:
    """Another frame for the same scene: p' = scale * p[axes] + move."""

    scale: float = 1.0
    move: float = 0.0
    axes: tuple[int, ...] = (0, 1, 2)

    def point(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Positions there."""
        return np.asarray(self.scale * p[:, self.axes] + self.move)

    def beam(self, rays: Beam) -> MeshRays:
        """Rays there."""
        a = list(self.axes)
        moves = (self.scale * rays.dp_dx[:, a], self.scale * rays.dp_dy[:, a], rays.dd_dx[:, a], rays.dd_dy[:, a])
        return MeshRays(self.point(rays.p), rays.d[:, a], *moves)


def differences(ours: Met, theirs: Met, length: float, frame: Frame = Frame()) -> tuple[PerRay, PerRay]:
    """How far two answers about the same rays are apart, ours in a frame of its own.

    Parameters
    ----------
    ours, theirs
        The answers.
    length
        Unit of lengths, in their frame: a voxel.
    frame
        From their frame to ours.

    Returns
    -------
    places, rest
        (n,) each: distance of the hits, and the greatest of the differences of normal, mirrored direction and mirrored
        J (relative); 1 where only one of them hits, 0 where neither does.
    """
    out, both = frame.beam(theirs.out), ours.hits.hit & theirs.hits.hit
    unit = length * frame.scale
    place = np.linalg.norm(ours.hits.p - frame.point(theirs.hits.p), axis=1) / unit
    n = np.linalg.norm(ours.hits.n - theirs.hits.n[:, list(frame.axes)], axis=1)
    d = np.linalg.norm(ours.out.d - out.d, axis=1)
    rest = np.maximum.reduce([n, d, change(ours.out, out, unit)])
    lone = np.where(ours.hits.hit == theirs.hits.hit, 0.0, 1.0)
    return np.where(both, place, lone), np.where(both, rest, lone)


def same_checks(
    name: str,
    field: GridField,
    rays: MeshRays,
    pair: Callable[[], tuple[PerRay, PerRay]],
    limits: tuple[float, float],
) -> tuple[Check, Check]:
    """Two checks, of the places and of the rest of `differences`.

    Parameters
    ----------
    name
        What is compared with what.
    field, rays
        Our side of it, for replay.
    pair
        Finds the differences.
    limits
        Of the places, voxels, and of the rest, relative.
    """
    course, both = mirror_course(field), cache(pair)
    return (
        Check(f"{name}: places", "voxel", limits[0], lambda: Finding(both()[0], rays), course),
        Check(f"{name}: n and mirrored J", "relative", limits[1], lambda: Finding(both()[1], rays), course),
    )


def dense(values: np.ndarray, choice: Choice, origin: ArrayLike = (0.0, 0.0, 0.0), spacing: float = 1.0) -> GridField:
    """The B-spline of dense samples."""
    return GridField(Grid.from_dense(values, origin=np.asarray(origin, float), spacing=spacing), "bspline", choice)


def sampled(shape: ExactShape, resolution: int, choice: Choice) -> GridField:
    """The B-spline of an exact shape's samples."""
    return GridField(Grid.from_function(shape, resolution, uv_mode="none"), "bspline", choice)


def mirror_course(field: GridField) -> Callable[[], Course]:
    """What `Check.course` is of rays that are mirrored at a field."""
    return partial(Course, field, MIRROR)


def infinite(found: Met) -> PerRay:
    """1 for rays with any number that is not finite, but for the parameters of misses."""
    t = np.where(np.isposinf(found.hits.t), 0.0, found.hits.t)
    columns = [*found.at.columns(), *found.out.columns(), *found.hits.p.T, *found.hits.n.T, t]
    return np.asarray((~np.isfinite(columns)).any(axis=0)).astype(np.float64)


def finite_check(field: GridField, rays: MeshRays, of: str = "") -> Check:
    """Every number of every ray is finite; `of` says which rays, where a case has several."""

    def find() -> Finding:
        return Finding(infinite(met(field, rays)), rays)

    return Check(f"{of}hits and mirrored J not finite", "count", 0.0, find, mirror_course(field))


def identity_check(field: GridField, choice: Choice, rays: MeshRays, length: float, of: str = "") -> Check:
    """The identities hold at the hit, at the mirror, and at the next hit where there is one."""
    course = Course(field, MIRROR)

    def find() -> Finding:
        return Finding(defects(course, rays, np.random.default_rng(12), length).greatest, rays)

    return Check(f"{of}identities through a mirror", "relative", ROUNDINGS * choice.engine.eps, find, lambda: course)


def _dot(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 1"]:
    return np.asarray(np.sum(a * b, axis=1, keepdims=True))
