"""What light asks of a surface: starts of both kinds in one call, whether anything is in the way, what is inside."""

import numpy as np
import pytest

from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfrender import GridField, trace
from sdfrender.field import Spot
from validate.exact import ShapeField

R = 0.8


@pytest.fixture
def field(request, choice):
    """A ball as a grid, on every engine."""
    return GridField(Grid.from_function(Sphere(R), 40, uv_mode="none"), "bspline", choice)


def ask(field, p, d, limit=None, left=None):
    """March: (hit, t), or a mask of what is met before a limit; rays of `left` leave the place at their origin."""
    left = np.zeros(len(p), bool) if left is None else left

    def program(xp, *c):
        p, d, active = c[:3], c[3:6], c[6] > 0
        start = field.locate(xp, p, active & (c[7] > 0))
        if limit is None:
            spot = field.first_hit(xp, p, d, active, start)
            return {"hit": xp.integer(spot.hit), "t": spot.t}
        return {"hit": xp.integer(field.occluded(xp, p, d, active, start, c[8]))}

    active = np.arange(len(p)) % 7 != 0
    columns = [*(p - field.anchor).T, *d.T, active.astype(np.int32), left.astype(np.int32)]
    out = field.engine.run(program, columns if limit is None else [*columns, np.broadcast_to(limit, len(p))])
    assert not out["hit"][~active].any()
    return out["hit"][active] > 0, out.get("t", out["hit"])[active], active


def bundle(directions, rng):
    """Rays from the ball's surface, inward and outward, and from elsewhere, inside and outside."""
    left = rng.uniform(size=len(directions)) < 0.5
    p = directions * np.where(left, R, rng.uniform(0.1, 1.2, len(directions)))[:, None]
    d = rng.normal(size=p.shape)
    return p, d / np.linalg.norm(d, axis=1, keepdims=True), left


def chords(p, d, left):
    """First meetings with the sphere after 0, in closed form; infinite for none. What starts on it has one at 0."""
    b, c = np.sum(p * d, axis=1), np.where(left, 0.0, np.sum(p * p, axis=1) - R * R)
    root = np.sqrt(np.maximum(b * b - c, 0.0))
    first, last = -b - root, -b + root
    t = np.where(left | (c < 0), last, first)
    return np.where((b * b >= c) & (t > 1e-9), t, np.inf)


def test_rays_that_leave_and_rays_that_do_not(field, directions, rng):
    """In one call: t in closed form, up to the kernel's error of 1e-4 over the slope."""
    p, d, left = bundle(directions, rng)
    hit, t, active = ask(field, p, d, left=left)
    p, d, left = p[active], d[active], left[active]
    truth = chords(p, d, left)
    closest = np.linalg.norm(p - np.sum(p * d, axis=1)[:, None] * d, axis=1)
    clear = np.sqrt(np.abs(R * R - closest * closest)) > 0.1  # the slope of what is met, times R
    clear &= left | (np.abs(np.linalg.norm(p, axis=1) - R) > 1e-2)
    assert np.array_equal(hit[clear], np.isfinite(truth)[clear])
    assert np.abs(t - truth)[clear & hit].max() < 1e-3
    for kind in (left, ~left):
        assert np.count_nonzero(clear & hit & kind) > 100 and np.count_nonzero(clear & ~hit & kind) > 50


def test_the_start_is_the_place_not_the_position(choice):
    """Rays with a start leave it whatever `p`; those whose start is no hit begin at `p`."""
    field = GridField(Grid.from_function(Sphere(R), 24, uv_mode="none"), "bspline", choice)

    def program(xp, x, on):
        zero = xp.full(x, 0.0)
        place = field.locate(xp, (zero, zero, zero), on > 0)
        spot = field.first_hit(xp, (x, zero, zero), (zero + 1, zero, zero), on >= 0, Spot(on > 0, *place[1:]))
        return {"t": xp.where(spot.hit, spot.t, -1.0)}

    t = field.engine.run(program, [np.array([-1.0, -1.0, 0.5, 2.0]) - field.anchor[0], np.array([1, 0, 0, 0])])["t"]
    assert t == pytest.approx([R, 1 - R, R - 0.5, -1], abs=2e-3)


def test_occluded_is_a_first_hit_before_the_limit(field, directions, rng):
    """To the last digit: limits at a hit, one float after it, far before and beyond, infinite, 0 and negative."""
    p, d, left = bundle(directions, rng)
    p, d, left = (np.concatenate([x] * 6) for x in (p, d, left))
    kind = np.float64 if field.engine.precision == 64 else np.float32
    hit, t, active = ask(field, p, d, left=left)
    whole = np.zeros(len(p), kind)
    whole[active] = t
    part = np.arange(len(p)) // len(directions)
    limit = np.choose(part, [whole, np.nextafter(whole, kind(9)), whole * rng.uniform(0, 2, len(p)), np.inf, 0, -1])
    limit = limit.astype(kind)
    seen, _, _ = ask(field, p, d, limit.astype(float), left)
    assert np.array_equal(seen, hit & (t < limit[active]))
    counts = [np.count_nonzero(seen[part[active] == number]) for number in range(6)]
    assert counts[0] == counts[4] == counts[5] == 0 and min(counts[1], counts[3]) > 400 and 100 < counts[2] < 400


def test_a_wall_between_two_points(choice):
    """What lies beyond the limit is not in the way; lengths are in units of the direction."""
    x = np.arange(16.0)[:, None, None] + np.zeros((16, 16, 16))
    field = GridField(Grid.from_dense(np.abs(x - 7.3) - 0.4), "linear", choice)  # from 6.9 to 7.7
    p, d = np.array([[1.0, 7.0, 7.0]] * 7), np.array([[2.0, 0.0, 0.0]] * 7)
    seen, _, _ = ask(field, p, d, np.array([9.0, 2.9, 2.96, 3.1, 40.0, np.inf, 0.0]))
    assert seen.tolist() == [False, True, True, True, True, False]


def test_inside_is_where_the_value_is_negative(field, directions, rng):
    """By the interpolant near the surface, by the bound where no brick is, and nowhere outside the lattice."""
    radius = rng.choice([0.0, 0.3, R - 1e-3, R + 1e-3, 1.0, 3.0], len(directions))
    p = directions * radius[:, None]

    def program(xp, x, y, z, on):
        return {"inside": xp.integer(field.inside(xp, (x, y, z), on > 0))}

    on = np.arange(len(p)) % 5
    inside = field.engine.run(program, [*(p - field.anchor).T, on])["inside"] > 0
    assert np.array_equal(inside, (radius < R) & (on > 0))
    assert (field.grid.bricks.slot < 0).any()


def test_a_lattice_that_ends_inside_is_not_inside_beyond(choice):
    x = np.arange(9.0)[:, None, None] + np.zeros((9, 9, 9))
    field = GridField(Grid.from_dense(x - 8.5), "bspline", choice)
    p = np.array([[0.0, 0, 0], [8.0, 8, 8], [-0.01, 4, 4], [4, 8.01, 4], [4, 4, -3], [4, 4, 4]])

    def program(xp, x, y, z):
        return {"inside": xp.integer(field.inside(xp, (x, y, z), xp.full(x, True)))}

    assert field.engine.run(program, list((p - field.anchor).T))["inside"].tolist() == [1, 1, 0, 0, 0, 1]


@pytest.mark.parametrize("name", ["sphere", "torus", "box"])
def test_exact_shapes_answer_alike(name, directions, rng):
    """First hits from inside too: on the surface, not later than any sign change of the distance along the ray."""
    field = ShapeField(shape(name))
    low, high = field.bounds
    p = rng.uniform(1.2 * low, 1.2 * high, directions.shape)
    hit, t, active = ask(field, p, directions)
    p, d = p[active], directions[active]
    inside = field.shape.distance(p) < 0
    assert np.count_nonzero(inside) > 50 and hit[inside].all()
    size = np.linalg.norm(high - low)
    assert np.abs(field.shape.distance(p + t[:, None] * d))[hit].max() < 1e-6 * size
    steps = np.linspace(0, 1, 300)[1:-1]
    for rows, reach in ((hit, t), (~hit, size)):
        at = p[rows, None] + (np.broadcast_to(reach, t.shape)[rows, None] * steps)[..., None] * d[rows, None]
        value = field.shape.distance(at.reshape(-1, 3)).reshape(at.shape[:2])
        assert (value * np.where(inside, -1, 1)[rows, None] > -1e-6 * size).all()
    limit = np.where(np.arange(len(t)) % 2, t + 1e-9, t - 1e-9)
    whole = np.zeros(len(directions))
    whole[active] = limit
    rays = np.zeros_like(directions), np.ones_like(directions)
    rays[0][active], rays[1][active] = p, d
    assert np.array_equal(ask(field, *rays, whole)[0], hit & (np.arange(len(t)) % 2 == 1))


def test_an_exact_chord(directions, rng):
    """From the exact sphere inward: 2 r cos, and the same way back; directions of any length."""
    field, d = ShapeField(Sphere(R)), rng.normal(size=directions.shape)
    d *= -np.sign(np.sum(d * directions, axis=1))[:, None]
    length = np.linalg.norm(d, axis=1)
    cosine = -np.sum(d * directions, axis=1) / length
    hits = trace(field, R * directions, d, on_surface=True)
    # A root is a value's rounding over its slope off, and there is none in the first 1e-9 of the shape's size.
    assert hits.hit.all() and (np.abs(hits.t * length - 2 * R * cosine) < 1e-15 / cosine + 3e-9).all()
    assert (np.abs(hits.t * length - 2 * R * cosine)[cosine > 1e-4] < 1e-11).all()
    back = trace(field, hits.p, -d, on_surface=True)
    assert np.abs(back.p - R * directions)[cosine > 1e-4].max() < 1e-11
