"""Rays and lattices in special position: at nodes and edges, on the box, at any scale and place, of any size.

In: an engine. Out: cases, each with grids of its own. Mostly the same scene is asked in two ways that may differ by
rounding only: places by 11 N u voxels each (docs/tracing.md), N samples along the longest axis.
"""

from collections.abc import Iterator
from functools import cache, partial
from itertools import product

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Choice
from sdfrender import GridField
from sdfrender.kernels import bspline
from validate.beam import MeshRays, only
from validate.course import Course
from validate.identities import perturbed
from validate.stress import frames
from validate.stress.bounds import SAMPLE, kernel_error
from validate.stress.brute import none_missed
from validate.stress.case import Case, Check, Finding
from validate.stress.frames import BALL, COUNT, ORIGIN, RADIUS, SEED, SIDE, ball, noise, rounding, summing
from validate.stress.mirrored import (
    LEAST,
    between,
    dense,
    differences,
    finite_check,
    identity_check,
    met,
    mirror_course,
    same_checks,
)
from validate.suites.misses import axis_aligned

NUDGE = 1e-6  # voxels


# ---- along axes, through nodes and edges -----------------------------------------------------------------------------
def _on_nodes() -> MeshRays:
    """From nodes, middles of edges, faces and cells, along axes and all diagonals; half of the zeros negative."""
    rng, starts = np.random.default_rng(SEED), COUNT // 5
    ways = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
    half = np.array(list(product(np.arange(-3.0, 3.5, 0.5), repeat=3)))
    start = np.repeat(half[rng.permutation(len(half))[:starts]], len(ways), axis=0)
    d = np.tile(ways / np.linalg.norm(ways, axis=1, keepdims=True), (starts, 1))
    sheet = np.array(list(product(np.arange(-8.0, 8.5, 0.5), repeat=2)))
    sheet = sheet[np.linalg.norm(sheet, axis=1) < 8.0]
    axes = [np.insert(sheet, axis, -20.0, axis=1) for axis in range(3)]
    outer = np.repeat(np.eye(3), len(sheet), axis=0)
    p, d = np.concatenate([start, *axes]), np.concatenate([d, outer])
    negative = rng.uniform(size=p.shape) < 0.5
    return perturbed(np.where((p == 0) & negative, -0.0, p), np.where((d == 0) & negative, -0.0, d), rng)[0]


def _nodes(choice: Choice) -> Iterator[Check]:
    field, rays = dense(ball(), choice, ORIGIN), _on_nodes()
    course = mirror_course(field)
    seen = cache(lambda: met(field, rays))

    def lost() -> Finding:
        return Finding((~seen().hits.hit).astype(np.float64), rays)

    def off() -> Finding:
        hits = seen().hits
        return Finding(np.where(hits.hit, np.abs(BALL.distance(hits.p)), 1.0), rays)

    def signed() -> tuple[np.ndarray, np.ndarray]:
        plain = [getattr(rays, name) + 0.0 for name in ("p", "d", "dp_dx", "dp_dy", "dd_dx", "dd_dy")]
        return differences(seen(), met(field, MeshRays(*plain)), 1.0)

    def nudged() -> tuple[np.ndarray, np.ndarray]:
        move = NUDGE * np.random.default_rng(SEED).uniform(-1, 1, rays.p.shape)
        aside = MeshRays(rays.p + move, rays.d, rays.dp_dx, rays.dp_dy, rays.dd_dx, rays.dd_dy)
        return differences(seen(), met(field, aside), 1.0)

    yield Check("rays at nodes, edges and faces that slip through", "count", 0.0, lost, course)
    yield Check(
        "their hits off the exact ball", "voxel", kernel_error(RADIUS) + rounding(choice) + SAMPLE * 16, off, course
    )
    yield from same_checks("-0.0 in place of 0.0", field, rays, signed, (0.0, 0.0))
    # A ray that is moved aside meets the surface farther away by that over its cosine, and there the normal is turned
    # by it over r; J has the cosine squared below it. Both ways: twice.
    aside = 2 * np.sqrt(3) * NUDGE / LEAST
    limits = (aside + rounding(choice), aside / LEAST / RADIUS + summing(choice))
    yield from same_checks("against rays a millionth of a voxel aside", field, rays, nudged, limits)
    yield none_missed(
        "noise, along axes: wrong by brute force", noise((21, 17, 19)), bspline(), choice, axis_aligned, COUNT
    )
    yield finite_check(field, rays)
    yield identity_check(field, choice, rays, RADIUS)
    yield from _zeros(choice)


def _zeros(choice: Choice) -> Iterator[Check]:
    """Planes whose samples are 0 at nodes, met there and in the middles of edges and faces: at the ends of segments."""
    p = np.moveaxis(np.indices((SIDE,) * 3), 0, -1) + ORIGIN
    for name, n in (("across x", np.eye(3)[0]), ("across a diagonal", np.ones(3) / np.sqrt(3))):
        # Whole numbers, so that nothing is rounded: not a distance, where n is oblique.
        field = dense(p @ np.sign(n), choice, ORIGIN)
        ways = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if abs(way @ np.sign(n)) > 0])
        on = np.array([q for q in product(np.arange(-4.0, 4.5, 0.5), repeat=3) if q @ np.sign(n) == 0])
        d = np.repeat(ways, len(on), axis=0)
        rays = straight(np.tile(on, (len(ways), 1)) - 5.5 * d, d / np.linalg.norm(d, axis=1, keepdims=True))

        def off(field: GridField = field, rays: MeshRays = rays, n: np.ndarray = n) -> Finding:
            hits = met(field, rays).hits
            return Finding(np.where(hits.hit, np.abs(hits.p @ n), 1.0), rays)

        yield Check(f"plane through nodes, {name}: hits", "voxel", rounding(choice), off, mirror_course(field))


# ---- starts ----------------------------------------------------------------------------------------------------------
def _on_box(rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Places on the box: its corners, edges and faces."""
    p = 16.0 * rng.uniform(-1, 1, (COUNT, 3))
    fixed = rng.permuted(np.arange(3) < rng.integers(1, 4, (COUNT, 1)), axis=1)
    return np.where(fixed, 16.0 * rng.choice([-1.0, 1.0], p.shape), p)


_OUTSIDE = (
    "a place on the box is inside or not by its last bit: where coordinates are not whole, a ray along a face of the "
    "box may be rounded to outside, where there is nothing"
)


def _starts(choice: Choice) -> Iterator[Check]:
    field = dense(ball(), choice, ORIGIN)
    rng = np.random.default_rng(SEED)
    inner = rng.normal(size=(COUNT, 3))
    # Within 0.9 r of the centre, so that cosines are sqrt(1 - 0.81) = 0.43 or more.
    inner *= 0.9 * RADIUS * rng.uniform(size=(COUNT, 1)) / np.linalg.norm(inner, axis=1, keepdims=True)
    rays = between(_on_box(rng), BALL.centre + inner, rng)
    outer = from_behind(rays, 7.0)
    entry = cache(lambda: met(field, outer))

    def on_box() -> tuple[np.ndarray, np.ndarray]:
        return differences(met(field, rays), entry(), 1.0)

    yield from same_checks(
        "on the box, and 7 voxels before it", field, rays, on_box, (rounding(choice), summing(choice))
    )

    def far_side() -> Finding:
        """On from the hit, and from halfway to the next."""
        first = entry()
        on = met(field, straight(first.hits.p, rays.d), on_surface=True)
        halfway = 0.5 * (first.hits.p + on.hits.p)
        return Finding(_apart(met(field, straight(halfway, rays.d)).hits.p, on.hits.p), straight(halfway, rays.d))

    def back() -> Finding:
        """Through the ball, and back from there."""
        first = entry()
        on = met(field, straight(first.hits.p, rays.d), on_surface=True)
        again = straight(on.hits.p, -rays.d)
        return Finding(_apart(met(field, again, on_surface=True).hits.p, first.hits.p), again)

    def outward() -> Finding:
        first = entry()
        away = straight(first.hits.p, first.out.d)
        return Finding(met(field, away, on_surface=True).hits.hit.astype(np.float64), away)

    course = mirror_course(field)
    yield Check("inside the ball, and on its surface: far side", "voxel", rounding(choice), far_side, course)
    on_surface = partial(Course, field, (None,), on_surface=True)
    yield Check("there and back along a chord", "voxel", rounding(choice), back, on_surface)
    yield Check("leave the ball and meet it again", "count", 0.0, outward, on_surface)
    yield finite_check(field, rays)
    yield from _along_the_box(choice)


def _along_the_box(choice: Choice) -> Iterator[Check]:
    """Rays in the faces and edges of the box, to a plane across it, on whole and on odd coordinates."""
    for name, spacing, origin, known in (("whole", 1.0, -16.0, ""), ("odd", 0.0371, 0.317, _OUTSIDE)):
        field = dense(spacing * (np.indices((SIDE,) * 3)[0] - 1.73), choice, [origin] * 3, spacing)
        low, high = field.bounds
        side = np.random.default_rng(SEED).uniform(low, high, (COUNT, 3))
        number = np.arange(COUNT)[:, None] % 3  # y on the box, z on the box, both
        p = np.where((number == [3, 0, 1]) | (number == [3, 2, 2]), np.where(side < (low + high) / 2, low, high), side)
        p[:, 0] = low[0] - 5 * spacing
        rays = straight(p, np.tile([1.0, 0.0, 0.0], (COUNT, 1)))

        def lost(field: GridField = field, rays: MeshRays = rays) -> Finding:
            missed = ~met(field, rays).hits.hit
            return Finding(np.array([missed.mean()]), only(rays, np.array([np.argmax(missed)])))

        yield Check(f"rays along the box, {name} coordinates: lost", "share", 0.0, lost, mirror_course(field), known)


def straight(p: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> MeshRays:
    """Rays whose differentials nobody asks for."""
    still = np.zeros_like(p)
    return MeshRays(p, d, still, still, still, still)


def from_behind(rays: MeshRays, by: float) -> MeshRays:
    """The same rays, from farther back: where they start now, p and dp are those that they had."""
    dp_dx, dp_dy = rays.dp_dx - by * rays.dd_dx, rays.dp_dy - by * rays.dd_dy
    return MeshRays(rays.p - by * rays.d, rays.d, dp_dx, dp_dy, rays.dd_dx, rays.dd_dy)


def _apart(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    return np.asarray(np.linalg.norm(a - b, axis=1))


CASES = (
    Case(
        "lattice-nodes",
        "Along axes, through nodes and edges",
        "Cells share their faces, edges and nodes, and the sign is carried across: no ray slips through between them, "
        "hits are those of rays a millionth of a voxel aside, and the sign of a zero means nothing.",
        _nodes,
    ),
    Case(
        "starts",
        "Start on the box, inside, on the surface",
        "Where on its way to a surface a ray starts changes the hit by rounding only: on faces, edges and corners of "
        "the box, inside the solid, or on the surface, which it does not meet again.",
        _starts,
    ),
    *frames.CASES,
)
