"""Where a distance has a kink or no gradient: walls and gaps thinner than a voxel, centres, medial planes.

In: an engine. Out: cases, each with grids of its own. Hits are held against the exact distance at the place of the hit:
at a root of the interpolant it is what the kernel is off by, whatever the angle of the ray.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np
from jaxtyping import Float

from datasets_synthetic.sphere import Sphere
from sdfbake.engine import Choice
from sdfrender import GridField
from sdfrender.kernels import bspline
from validate.beam import MeshRays, only
from validate.stress.bounds import SAMPLE, amplified, kernel_error, kink
from validate.stress.brute import none_missed
from validate.stress.case import Case, Check, Finding
from validate.stress.mirrored import (
    Places,
    between,
    dense,
    finite_check,
    identity_check,
    met,
    mirror_course,
    sampled,
    towards,
)
from validate.suites.misses import PLACE, through

SEED, COUNT = 1208, 500
SIDE = 32
OBLIQUE = np.array([0.8, 0.5, 0.33]) / np.linalg.norm([0.8, 0.5, 0.33])
CENTRE = np.array([15.3, 15.9, 15.6])


def _signed(n: Float[np.ndarray, " 3"], centre: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "32 32 32"]:
    """Distances from a plane."""
    return np.asarray((np.moveaxis(np.indices((SIDE,) * 3), 0, -1) - centre) @ n)


def _in_plane(
    n: Float[np.ndarray, " 3"], centre: Float[np.ndarray, " 3"], reach: float, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Places of a plane, so far from its middle at most."""
    along = reach / np.sqrt(3) * rng.uniform(-1, 1, (COUNT, 3))
    return np.asarray(centre + along - (along @ n)[:, None] * n)


# ---- a wall, and a gap, thinner than a voxel -------------------------------------------------------------------------
WIDTHS = (0.6, 0.5, 0.4)


def wall(width: float) -> Float[np.ndarray, "32 32 32"]:
    """Distances from an oblique wall of so many voxels."""
    return np.asarray(np.abs(_signed(OBLIQUE, CENTRE)) - width / 2)


def _wall_rays(width: float) -> MeshRays:
    rng = np.random.default_rng(SEED)
    face = _in_plane(OBLIQUE, CENTRE, 8.0, rng) + width / 2 * OBLIQUE
    return towards(Places.flat(face, OBLIQUE), rng, 6.0)


def _thin(choice: Choice) -> Iterator[Check]:
    # In the middle of a wall the interpolant is at most this less half the width: if that is negative, it has a root.
    # At a root, the exact distance is what the kernel is off by: nowhere more than at the kink.
    most = kink(bspline(), OBLIQUE)
    limit = most + SIDE * PLACE * choice.engine.eps
    too_thin = (
        f"in the middle of a wall the B-spline is up to {most:.2f} voxel above the exact distance: walls and gaps of "
        f"less than {2 * most:.2f} voxel have holes where they lie between samples"
    )
    for width in WIDTHS:
        field = dense(wall(width), choice)
        known = too_thin if width / 2 <= most else ""
        name, course = f"wall of {width} voxel", mirror_course(field)
        yield Check(f"{name}: rays that pass through", "share", 0.0, partial(_passed, field, width), course, known)
        yield Check(f"{name}: hits off the exact wall", "voxel", limit, partial(_off_wall, field, width), course)
    yield from _gap(choice)
    yield none_missed("wall of 0.4 voxel: wrong by brute force", wall(0.4), bspline(), choice, through, COUNT)


def _passed(field: GridField, width: float) -> Finding:
    rays = _wall_rays(width)
    missed = ~met(field, rays).hits.hit
    return Finding(np.array([missed.mean()]), only(rays, np.array([np.argmax(missed)])))


def _off_wall(field: GridField, width: float) -> Finding:
    rays = _wall_rays(width)
    hits = met(field, rays).hits
    error = np.abs(np.abs((hits.p - CENTRE) @ OBLIQUE) - width / 2)
    return Finding(error[hits.hit], only(rays, hits.hit))


def _gap(choice: Choice) -> Iterator[Check]:
    """The wall's samples with the other sign, and what every case has."""
    width, rays = 0.6, _wall_rays(0.6)
    solid, gap = (dense(sign * wall(width), choice) for sign in (1.0, -1.0))

    def turned() -> Finding:
        ours, theirs = met(gap, rays).hits, met(solid, rays).hits
        both = ours.hit & theirs.hit
        apart = np.linalg.norm(ours.p - theirs.p, axis=1) + np.linalg.norm(ours.n + theirs.n, axis=1)
        return Finding(np.where(both, apart, np.where(ours.hit == theirs.hit, 0.0, 1.0)), rays)

    # Samples of opposite sign have opposite roundings: nothing differs.
    yield Check("gap of 0.6 voxel: hits and normals, the wall's turned", "voxel", 0.0, turned, mirror_course(gap))
    yield finite_check(solid, rays)
    yield identity_check(solid, choice, rays, 10.0)


# ---- where the distance has no gradient ------------------------------------------------------------------------------
BALL = Sphere(0.8, (0.01, 0.02, -0.03))


def _medial(choice: Choice) -> Iterator[Check]:
    yield from _centre(choice)
    yield from _speck(choice)
    yield from _slab(choice)
    yield from _no_gradient(choice)


def _from(centre: tuple[float, float, float]) -> MeshRays:
    """Rays from one place to all sides."""
    rng = np.random.default_rng(SEED)
    start = np.tile(centre, (COUNT, 1))
    return between(start, start + rng.normal(size=start.shape), rng)


def _centre(choice: Choice) -> Iterator[Check]:
    """From the centre of a ball of ten voxels, and through it."""
    field, rays = sampled(BALL, SIDE, choice), _from(BALL.centre)
    h = field.grid.lattice.spacing

    def from_it() -> Finding:
        hits = met(field, rays).hits
        return Finding(np.where(hits.hit, np.abs(hits.t - BALL.radius) / h, 1.0), rays)

    def through_it() -> Finding:
        p = met(field, rays).hits.p
        on = between(p, np.tile(BALL.centre, (COUNT, 1)), np.random.default_rng(SEED))
        hits = met(field, on, on_surface=True).hits
        return Finding(np.where(hits.hit, np.abs(hits.t - 2 * BALL.radius) / h, 1.0), rays)

    limit = kernel_error(BALL.radius / h) + SIDE * PLACE * choice.engine.eps
    yield Check("from the centre of a ball: t", "voxel", limit, from_it, mirror_course(field))
    yield Check("through the centre of a ball: t", "voxel", 2 * limit, through_it, mirror_course(field))
    yield finite_check(field, rays)
    yield identity_check(field, choice, rays, 1.0)


def _speck(choice: Choice) -> Iterator[Check]:
    """From the centre of a ball of two voxels, which every stencil at its surface sees."""
    ball = Sphere(2.0, (7.3, 7.8, 7.5))
    p = np.moveaxis(np.indices((16, 16, 16)), 0, -1).reshape(-1, 3).astype(np.float64)
    field, rays = dense(ball.distance(p).reshape(16, 16, 16), choice), _from(ball.centre)

    def off() -> Finding:
        hits = met(field, rays).hits
        return Finding(np.where(hits.hit, np.abs(hits.t - ball.radius), 2.0), rays)

    # The distance from a point is twice the mean of |p . n| over all n: so is what the kernel is off by, and no kink is
    # worse than one along an axis.
    limit = 2 * kink(bspline(), np.eye(3)[0])
    yield Check("from the centre of a ball of two voxels: t", "voxel", limit, off, mirror_course(field))
    yield finite_check(field, rays, "ball of two voxels: ")


def _slab(choice: Choice) -> Iterator[Check]:
    """From the medial plane of a slab in all directions; a twentieth along it, which meet nothing."""
    rng = np.random.default_rng(SEED)
    field = dense(wall(10.0), choice)
    d = rng.normal(size=(COUNT, 3))
    d[::20] -= (d[::20] @ OBLIQUE)[:, None] * OBLIQUE
    start = _in_plane(OBLIQUE, CENTRE, 3.0, rng)
    rays = between(start, start + d, rng)

    def off() -> Finding:
        hits = met(field, rays).hits
        # Flatter rays may leave the lattice first, whose sides are 12 voxels away or more.
        rows = np.flatnonzero(hits.hit | (np.abs(rays.d @ OBLIQUE) > 0.5))
        error = np.abs(np.abs((hits.p - CENTRE) @ OBLIQUE) - 5.0)
        return Finding(np.where(hits.hit, error, 1.0)[rows], only(rays, rows))

    # All samples behind a hit, up to 3 voxels away along every axis, are on its side of the middle: a plane, rounded.
    limit = amplified(bspline(), 0, lambda away: SAMPLE * away) + SIDE * PLACE * choice.engine.eps
    yield Check("from the medial plane of a slab: hits off its faces", "voxel", limit, off, mirror_course(field))
    yield finite_check(field, rays, "slab: ")


def _no_gradient(choice: Choice) -> Iterator[Check]:
    """Surfaces on which the gradient vanishes: s^3, which the B-spline gives back; along an axis, to the last bit."""
    for name, n, centre in (("oblique", OBLIQUE, CENTRE), ("along x, at nodes", np.eye(3)[0], np.full(3, 16.0))):
        rng = np.random.default_rng(SEED)
        field = dense(_signed(n, centre) ** 3, choice)
        rays = towards(Places.flat(_in_plane(n, centre, 8.0, rng), n), rng, 6.0)
        # Where values are off by so much, the root of s^3 is by its cube root: samples round, and so do sums.
        value = amplified(bspline(), 0, lambda away: SAMPLE * away**3) + 2 * field.tolerance
        find, course = partial(_off_plane, field, rays, n, centre), mirror_course(field)
        yield Check(f"gradient 0 on the surface, {name}: hits", "voxel", float(np.cbrt(value)), find, course)
        yield finite_check(field, rays, f"gradient 0, {name}: ")


def _off_plane(
    field: GridField, rays: MeshRays, n: Float[np.ndarray, " 3"], centre: Float[np.ndarray, " 3"]
) -> Finding:
    hits = met(field, rays).hits
    return Finding(np.where(hits.hit, np.abs((hits.p - centre) @ n), 1.0), rays)


CASES = (
    Case(
        "thin-wall",
        "Wall and gap thinner than a voxel",
        "A ray stops wherever the interpolant has a root: brute force finds no other. What the kernel makes of a kink "
        "is known, 0.28 voxel: walls of more than twice that have no hole and hits are that close to the exact wall; "
        "thinner ones have holes, whose share is the figure.",
        _thin,
    ),
    Case(
        "medial-axis",
        "Medial axis, and a gradient that vanishes",
        "Rays that start at the centre of a ball or on the medial plane of a slab, where the distance has no gradient, "
        "or pass there, meet what is in front of them. Where the gradient vanishes on the surface itself (s^3), hits "
        "are as good as a triple root allows, and every number is finite.",
        _medial,
    ),
)
