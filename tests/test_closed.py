"""Closed-form rays through glass and mirrors: displaced rays, the closed form of a lens, the identities."""

import numpy as np
import pytest

from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from sdfrender import Camera
from validate.beam import MeshRays, displace
from validate.closed import ExactReference
from validate.displaced import richardson
from validate.identities import direction_defect, perturbed, surface_defect, symplectic_defect

INDEX = 1.5
COURSES = {
    "sphere, glass": ("sphere", (INDEX,)),
    "sphere, glass and its inner mirror": ("sphere", (INDEX, None, None)),
    "torus, glass": ("torus", (INDEX, INDEX, INDEX)),
    "torus, mirrors": ("torus", (None, None)),
    "torus, bubble": ("torus", (1 / INDEX,)),
}


def camera(course):
    """Onto the torus' hole; for glass from its side, where its tube is behind its tube; for mirrors in the tube."""
    places = {"torus, glass": ((2.6, 0.0, 0.3), (0.0, 0.0, 0.0)), "torus, mirrors": ((0.7, 0.0, 0.1), (0.7, 1.0, 0.0))}
    place, target = places.get(course, ((0.9, 0.8, 2.6), (0.0, 0.0, 0.0)))
    return Camera(place, target, fov=40.0, size=(48, 48)).rays()


def ended(reference, rays, events):
    """Position and direction where rays end, NaN for those that did not get there; and the last step."""
    *_, last = reference.steps(rays, events)
    met = last.alive[last.hits.hit]
    out = np.full((len(rays.p), 6), np.nan)
    out[met] = np.hstack([last.at.p, last.at.d])[last.hits.hit]
    return out, last


@pytest.mark.parametrize("course", COURSES)
def test_displaced_rays_agree(course):
    name, events = COURSES[course]
    reference, rays = ExactReference(shape(name)), camera(course)
    middle, last = ended(reference, rays, events)

    def outputs(dx, dy):
        near = ended(reference, displace(rays, dx, dy), events)[0]
        # A ray that takes another way (another sheet, total reflection) lands elsewhere: not a displacement.
        return np.where(np.abs(near - middle).max(axis=1, keepdims=True) < 0.3, near, np.nan)

    truth = richardson(outputs, step=0.004)
    rows = last.alive[last.hits.hit]
    ours, theirs, bar = np.zeros((3, len(rays.p), 6, 2))
    columns = np.stack([np.hstack([last.at.dp_dx, last.at.dd_dx]), np.hstack([last.at.dp_dy, last.at.dd_dy])], axis=2)
    ours[rows] = columns[last.hits.hit]
    theirs, bar = np.stack([truth.d_dx, truth.d_dy], axis=2), np.stack([truth.error_dx, truth.error_dy], axis=2)
    size = np.linalg.norm(theirs, axis=(1, 2))
    good = np.isfinite(bar).all(axis=(1, 2)) & (size > 0)
    good &= np.linalg.norm(np.where(np.isfinite(bar), bar, 0.0), axis=(1, 2)) < 1e-3 * size
    assert good.sum() > 60
    # |D - D(e/2)| is three times the error of what D extrapolates from: it covers D's own. Rounding of places and
    # directions, 1e-14 after three curved surfaces, over the step of 0.002.
    excess = np.linalg.norm((ours - theirs)[good], axis=(1, 2)) - np.linalg.norm(bar[good], axis=(1, 2))
    assert (excess / size[good]).max() < 1e-9


def test_a_ball_lens():
    """A parallel beam at height b leaves the ball turned by D = 2 (asin(b / r) - asin(b / (n r))), so dd_dx = dD/db,
    and about the axis dd_dy = sin(D) / b. Roundings of a few differences of asin: 1e-11."""
    radius, b = 0.8, np.linspace(0.02, 0.55, 12)
    zero, one = np.zeros_like(b), np.ones_like(b)
    p, d = np.stack([b, zero, 1.5 * one], axis=1), np.stack([zero, zero, -one], axis=1)
    across, aside = np.stack([one, zero, zero], axis=1), np.stack([zero, one, zero], axis=1)
    beam = MeshRays(p, d, across, aside, 0 * p, 0 * p)
    out = list(ExactReference(Sphere(radius)).steps(beam, (INDEX, INDEX)))[1].after
    turn = 2 * (np.arcsin(b / radius) - np.arcsin(b / (INDEX * radius)))
    slope = 2 * (1 / np.sqrt(radius**2 - b**2) - 1 / np.sqrt((INDEX * radius) ** 2 - b**2))
    assert np.abs(out.d - np.stack([-np.sin(turn), zero, -np.cos(turn)], axis=1)).max() < 1e-11
    dd_dx = slope[:, None] * np.stack([-np.cos(turn), zero, np.sin(turn)], axis=1)
    assert (np.linalg.norm(out.dd_dx - dd_dx, axis=1) / np.abs(slope)).max() < 1e-11
    assert np.abs(out.dd_dy + (np.sin(turn) / b)[:, None] * aside).max() < 1e-11


def test_an_index_near_one_keeps_its_digits():
    """With index 1 + e a ray turns by e tan(angle) to first order: mu by a difference would be wrong in its third digit
    at e = 1e-13. Next order and the rounding of the index itself: 1e-3."""
    d = np.array([[-0.8, 0.6, 0.0]])
    start = MeshRays(np.array([[0.8, 0.0, 0.0]]) - d, d, *(np.zeros((1, 3)) for _ in range(4)))
    for e in (1e-6, 1e-9, 1e-13):
        first = next(ExactReference(Sphere(0.8)).steps(start, (1 + e,)))
        sine = np.linalg.norm(np.cross(d, first.after.d))
        assert sine == pytest.approx(e * 0.6 / 0.8, rel=1e-3)


@pytest.mark.parametrize("course", COURSES)
def test_the_identities_hold(course):
    """Four perturbations: a dozen roundings a step, of lengths that grow towards grazing (slopes above 1e-2 here)."""
    name, events = COURSES[course]
    rng, rays = np.random.default_rng(5), camera(course)
    first, second = perturbed(rays.p, rays.d, rng)
    reference = ExactReference(shape(name))
    before, count = (first, second), 0
    for one, two in zip(reference.steps(first, events), reference.steps(second, events), strict=True):
        rows = np.flatnonzero(one.hits.hit)
        clear = np.abs(np.sum(one.hits.n * one.at.d, axis=1))[rows] > 1e-2
        at, after = ((one.at, two.at), (one.after, two.after))
        assert symplectic_defect(before, at)[rows][clear].max() < 1e-12
        sides = [np.sum(one.hits.n * d, axis=1) < 0 for d in (one.at.d, one.after.d)]
        glass = INDEX if "bubble" not in course else 1 / INDEX
        # Before a surface a ray that looks inward is in air; behind it one that looks inward is in the solid.
        index, beyond = np.where(sides[0], 1.0, glass), np.where(sides[1], glass, 1.0)
        if "glass" not in course and "bubble" not in course:
            index = beyond = np.ones(len(index))
        last = one.alive.size and after[0] is at[0]
        if not last:
            assert symplectic_defect(at, after, index, beyond)[rows][clear].max() < 1e-12
        assert max(direction_defect(b)[rows][clear].max() for b in after) < 1e-11
        assert max(surface_defect(one.hits.n, b)[rows][clear].max() for b in at) < 1e-12
        count += clear.sum()
        before = tuple(
            MeshRays(*(getattr(b, k)[rows] for k in ("p", "d", "dp_dx", "dp_dy", "dd_dx", "dd_dy"))) for b in after
        )
    assert count > 100


def test_from_inside_the_far_side_is_met():
    """A camera in the middle of the ball sees its inside at r, and its mirror image of itself at r again."""
    rays = Camera((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), fov=60.0, size=(8, 8)).rays()
    hops = ExactReference(Sphere(0.8)).follow(rays, 2)
    assert hops[0].t == pytest.approx(0.8, rel=1e-14)
    for hop in hops[1:]:
        assert hop.t == pytest.approx(1.6, rel=1e-12)  # starts are rounded to 1e-16 of the radius


def test_beyond_the_critical_angle_light_is_mirrored():
    """In glass at 45 degrees, beyond the critical 41.8: as a mirror does it, to the last digit."""
    start = np.array([[0.8 * np.sqrt(0.5), 0.0, 0.0]])
    up = np.array([[0.0, 0.0, 1.0]])
    rays = MeshRays(start, up, np.eye(3)[:1], np.eye(3)[1:2], 0 * up, 0 * up)
    reference = ExactReference(Sphere(0.8))
    glass, mirror = (next(reference.steps(rays, (event,))).after for event in (INDEX, None))
    for name in ("d", "dd_dx", "dd_dy"):
        assert np.array_equal(getattr(glass, name), getattr(mirror, name))


def test_misses_pass_unchanged():
    rays = Camera((0.0, 0.0, 3.0), (0.0, 0.0, 6.0), fov=20.0, size=(4, 4)).rays()
    reference = ExactReference(Sphere(0.8))
    (first, second) = reference.steps(rays, (INDEX,))
    assert not first.hits.hit.any() and np.array_equal(first.after.d, rays.d) and second.alive.size == 0
    assert all(not hop.hit.any() and len(hop.t) == 16 for hop in reference.follow(rays, (INDEX,)))
