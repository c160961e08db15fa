"""Several surfaces as one: two balls against their closed forms, and what an assembly may not change."""

from functools import cache

import numpy as np
import pytest
from charted import with_faces

from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfbake.complaint import BadInput
from sdfbake.engine import Choice, choose
from sdfbake.engine.numpy import NumpyEngine
from sdfrender import Field, GridField, Rays, footprint, leaving, reflect, refract, trace, transfer
from sdfrender.assembly import Assembly
from sdfrender.instance import Instance
from sdfrender.similarity import Similarity
from validate.exact import ShapeField

EPS = np.finfo(float).eps
NUMPY = NumpyEngine(64)
UNIT = 0.8  # radius of the ball that is placed
BALLS = {
    "apart": [(1.0, (-0.5, 0.0, 0.0)), (0.4, (0.9, 0.3, 0.2))],
    "touching": [(0.6, (-0.6, 0.0, 0.0)), (0.9, (0.9, 0.0, 0.0))],
    "overlapping": [(0.8, (-0.3, 0.0, 0.1)), (0.7, (0.4, 0.2, 0.0))],
}


@cache
def grid():
    return Grid.from_function(Sphere(UNIT), 48)


@cache
def ball(engine=NUMPY):
    """A ball as a grid: its surface is within 2e-6 of the closed form, its normals within 1e-5."""
    return GridField(grid(), "bspline", Choice(engine, "given"))


def placed(field, balls):
    """A field of the ball of radius `UNIT` where balls of other radii are."""
    return [Instance(field, Similarity.of_parts(r / UNIT, (1.0, 2.0, 3.0, 40.0), c)) for r, c in balls]


def roots(balls, p, d):
    """All ray parameters at which rays meet the balls, ascending, and the balls; infinite where there are no more."""
    found = []
    for k, (r, c) in enumerate(balls):
        q = p - np.array(c)
        b, gap = np.sum(q * d, axis=1), r * r - np.sum(np.cross(q, d) ** 2, axis=1)
        with np.errstate(invalid="ignore"):
            ends = np.stack([-b - np.sqrt(gap), -b + np.sqrt(gap)])
        found += [(np.where((gap > 0) & (t > 0), t, np.inf), np.full(len(p), k)) for t in ends]
    t, ball = (np.stack(column, axis=-1) for column in zip(*found, strict=True))
    order = np.argsort(t, axis=1, kind="stable")
    return np.take_along_axis(t, order, axis=1), np.take_along_axis(ball, order, axis=1)


def outward(balls, p, ball):
    n = p - np.array([c for _, c in balls])[ball]
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def rays_at(balls, rng, count=600):
    """Rays from a sphere around to the balls, steep enough everywhere that no root is nearly double."""
    p = rng.normal(size=(count, 3))
    p *= 4 / np.linalg.norm(p, axis=1, keepdims=True)
    d = rng.uniform(-0.9, 0.9, (count, 3)) - p
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    steep = np.ones(count, bool)
    for r, c in balls:
        near = np.linalg.norm(np.cross(p - np.array(c), d), axis=1)
        steep &= (near > 1.02 * r) | (near < 0.98 * r)  # a slope of 0.2
    return p[steep], d[steep]


def off(field):
    """Distance of a grid's surface, and rounding of places in float32, over a slope of 0.2; world units."""
    return (2e-6 if field.engine.precision == 64 else 2e-5) / 0.2


def through_all(field, balls, rng):
    """From root to root through both balls, entries and exits, one inside the other, and whose they are.

    Where two roots are closer than the error of either they may change places: those rays are left out.
    """
    p, d = rays_at(balls, rng)
    t, which = roots(balls, p, d)
    gaps = np.diff(np.nan_to_num(t, posinf=9.0), axis=1, append=99.0)
    rows = np.flatnonzero(((gaps > 4 * off(field)) | np.isinf(t)).all(axis=1))
    assert len(rows) > 0.9 * len(p)
    at = p.copy()
    for step in range(5):
        hits = trace(field, at[rows], d[rows], on_surface=step > 0)
        met = np.isfinite(t[rows, step]) if step < 4 else np.zeros(len(rows), bool)
        np.testing.assert_array_equal(hits.hit, met)
        rows, p_hit, n, part = rows[met], hits.p[met], hits.n[met], hits.part[met]
        if not rows.size:
            return step
        np.testing.assert_array_equal(part, which[rows, step])
        assert np.abs(np.linalg.norm(p_hit - p[rows], axis=1) - t[rows, step]).max() < off(field)
        assert np.abs(n - outward(balls, p_hit, part)).max() < 1e-4 + 4 * off(field)
        at[rows] = p_hit
    raise AssertionError("more roots than there are")


def test_all_roots_in_order(choice, rng):
    balls = BALLS["overlapping"]
    assert through_all(Assembly(placed(ball(choice.engine), balls)), balls, rng) == 4


def test_all_roots_of_touching_balls_in_order(rng):
    balls = BALLS["touching"]
    assert through_all(Assembly(placed(ball(), balls)), balls, rng) == 4


def test_a_root_that_is_left_out_is_seen(rng):
    """Without the second ball, and with both but in the wrong order, the check above fails."""
    members = placed(ball(), BALLS["overlapping"])
    for wrong in (members[:1], members[::-1]):
        with pytest.raises(AssertionError):
            through_all(Assembly(wrong), BALLS["overlapping"], rng)


def bundle(p, d):
    """Rays with the differentials of a pixel 1e-3 wide."""
    x = np.cross(d, [0.3, -0.4, 0.5])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    none = np.zeros_like(p)
    return Rays(p, d, none, none, 1e-3 * x, 1e-3 * np.cross(d, x))


@pytest.fixture(params=["exact", "grid"])
def surface(request):
    """The ball in closed form, and as a grid on the fastest engine there is."""
    return ShapeField(Sphere(UNIT)) if request.param == "exact" else ball(choose("auto").engine)


def test_a_mirror_ball_sees_the_other(surface, rng):
    """Hit, mirror, hit: closed forms; differentials and footprint: those of the balls alone.

    The first ball's normal is off by the place's error over the radius, twice that turns the ray, 2 units go by.
    """
    balls = BALLS["apart"]
    members = placed(surface, balls)
    field = Assembly(members)
    p, d = rays_at(balls, rng, 2000)
    rays = bundle(p, d)
    hits, at = transfer(field, rays)
    mirror = hits.part == 0
    out = reflect(field, hits, at).where(mirror)
    again, there = transfer(field, out, on_surface=True)
    seen = footprint(field, again, there, size=(64, 64))

    t, which = roots(balls, p[mirror], d[mirror])
    np.testing.assert_array_equal(which[:, 0], 0)
    first = p[mirror] + t[:, :1] * d[mirror]
    n = outward(balls, first, which[:, 0])
    mirrored = d[mirror] - 2 * np.sum(d[mirror] * n, axis=1, keepdims=True) * n
    exact = isinstance(surface, ShapeField)
    off_by = 1e-13 if exact else off(field)
    assert np.abs(out.d - mirrored).max() < 1e-12 if exact else 1e-4
    t2, _ = roots(balls[1:], first, mirrored)
    n2 = outward(balls[1:], first + np.nan_to_num(t2[:, :1], posinf=0) * mirrored, np.zeros(len(t2), int))
    steep = np.abs(np.sum(n2 * mirrored, axis=1)) > 0.2
    assert np.count_nonzero(again.hit != np.isfinite(t2[:, 0])) <= (0 if exact else 2)
    both = steep & again.hit & np.isfinite(t2[:, 0])
    assert both.sum() > 10 and (again.part[both] == 1).all()
    assert np.abs(again.t[both] - t2[both, 0]).max() < 100 * off_by

    alone = members[0], members[1]
    own, here = transfer(alone[0], rays.where(mirror))
    left = reflect(alone[0], own, here)
    met, arrived = transfer(alone[1], left)
    print_ = footprint(alone[1], met, arrived, size=(64, 64))
    for one, two in ((left.dd_dx, out.dd_dx), (left.dp_dy, out.dp_dy), (arrived.dp_dx, there.dp_dx)):
        assert np.median(np.linalg.norm(one - two, axis=1)) <= 1e4 * field.engine.eps * np.abs(one).max()
    same = both & (print_.chart == seen.chart) & ((print_.flags | seen.flags) == 0)
    assert np.median(np.abs(print_.uv - seen.uv)[same]) < 1e3 * field.engine.eps and same.sum() > 5
    assert np.median(np.abs(print_.duv_dy - seen.duv_dy)[same]) < 1e5 * field.engine.eps * np.abs(seen.duv_dy).max()


def test_glass_balls_in_a_row(surface, rng):
    """A ray through the middle of both goes straight; the others leave the first ball as they leave it alone."""
    balls = [(0.8, (0.0, 0.0, 0.0)), (0.5, (2.0, 0.0, 0.0))]
    members = placed(surface, balls)
    field = Assembly(members)
    p = np.concatenate([[[-3.0, 0.0, 0.0]], [-3.0, 0.0, 0.0] + rng.uniform(-0.3, 0.3, (50, 3)) * [0, 1, 1]])
    rays, alone = (bundle(p, np.tile([1.0, 0.0, 0.0], (51, 1))) for _ in range(2))
    for step in range(4):
        hits, at = transfer(field, rays, on_surface=step > 0)
        assert hits.hit[0] and hits.part[0] == step // 2 and leaving(hits, at)[0] == (step % 2 == 1)
        rays = refract(field, hits, at, eta=np.where(leaving(hits, at), 1.5, 1 / 1.5))
        if step < 2:
            hits, at = transfer(members[0], alone, on_surface=step > 0)
            alone = refract(members[0], hits, at, eta=np.where(leaving(hits, at), 1.5, 1 / 1.5))
            assert np.abs(alone.d - rays.d).max() < 1e5 * field.engine.eps
            assert np.abs(alone.dd_dx - rays.dd_dx).max() < 1e6 * field.engine.eps * np.abs(alone.dd_dx).max()
    assert np.abs(rays.d[0] - [1, 0, 0]).max() < 1e-4 and hits.p[0] == pytest.approx([2.5, 0, 0], abs=1e-4)


def asked(field, points, **more):
    """All that a field says about positions: jet, part, texture coordinates, inside, the member."""

    def program(xp, *p):
        everywhere = xp.full(p[0], True)
        spot = field.locate(xp, p, everywhere)
        jet, mapped = field.jet_at(xp, spot, 2), field.uv_at(xp, spot, field.jet_at(xp, spot, 1).gradient)
        entries = [jet.value, *jet.gradient, *jet.hessian, mapped.u, mapped.v, *mapped.du, *mapped.dv, mapped.chart]
        entries += [field.part_at(xp, spot), xp.integer(field.inside(xp, p, everywhere)), xp.integer(spot.hit)]
        if isinstance(field, Assembly):
            entries.append(field.member_at(xp, spot))
        return {str(i): entry for i, entry in enumerate(entries)}

    out = field.engine.run(program, list((points - field.anchor).T))
    return np.stack([out[str(i)] for i in range(len(out))], axis=-1)


def test_an_assembly_of_one_is_its_member(surface, rng):
    """Anchors are computed in two ways: places differ by a rounding, Hessians by 1e3 of them over the spacing."""
    balls = BALLS["apart"]
    (member, _) = placed(surface, balls)
    for field in (Assembly([member]), Assembly([Assembly([member])])):
        points = balls[0][1] + 1.01 * outward([(1.0, (0.0, 0.0, 0.0))], rng.normal(size=(300, 3)), np.zeros(300, int))
        one, two = asked(member, points), asked(field, points)
        assert np.abs(one - two[:, :-1]).max() < 3e4 * field.engine.eps and (two[:, -1] == 0).all()
        assert np.abs(field.bounds - member.bounds).max() == 0 and field.part_names == member.part_names
        p, d = rays_at(balls, rng)
        ours, theirs = trace(field, p, d), trace(member, p, d)
        np.testing.assert_array_equal(ours.hit, theirs.hit)
        assert np.abs(ours.p - theirs.p).max() < 64 * field.engine.eps / 0.2


def test_places_are_on_the_nearest_member(surface, rng):
    """A hundredth off either ball, out and in, the answers are that ball's, whatever the other one says."""
    balls = BALLS["overlapping"]
    members = placed(surface, balls)
    field = Assembly(members)
    assert isinstance(field, Field) and field.is_distance and field.uv_mode == surface.uv_mode
    assert field.part_names == ("0:sphere", "1:sphere")
    unit = rng.normal(size=(400, 3))
    unit *= rng.choice([0.99, 1.01], (400, 1)) / np.linalg.norm(unit, axis=1, keepdims=True)
    points = np.concatenate([c + r * part for (r, c), part in zip(balls, np.split(unit, 2), strict=True)])
    distances = np.stack([np.linalg.norm(points - np.array(c), axis=1) - r for r, c in balls], axis=1)
    clear = (np.abs(distances) > 1e-4).all(axis=1) & (np.ptp(np.abs(distances), axis=1) > 1e-4)
    points, distances = points[clear], distances[clear]
    found, nearest = asked(field, points), np.abs(distances).argmin(axis=1)
    np.testing.assert_array_equal(found[:, -1], nearest)
    np.testing.assert_array_equal(found[:, -4], nearest)  # parts: one each
    np.testing.assert_array_equal(found[:, -3] > 0, (distances < 0).any(axis=1))
    own = np.stack([asked(member, points) for member in members])[nearest, np.arange(len(points))]
    stable = own[:, 18] == found[:, 18]  # the chart; at a border of the cube map rounding decides
    assert stable.mean() > 0.98 and np.abs(found[:, :18] - own[:, :18])[stable].max() < 1e5 * field.engine.eps


def test_either_member_blocks(surface, rng):
    """Blocked where either closed form has a root before the limit; from a place on a surface, wherever `p` is."""
    balls = BALLS["apart"]
    field = Assembly(placed(surface, balls))
    p, d = rays_at(balls, rng)
    t, _ = roots(balls, p, d)
    limit = rng.uniform(2.5, 5.5, len(p))
    start = trace(field, p, d)

    def program(xp, *c):
        every = xp.full(c[0], True)
        free = field.occluded(xp, c[:3], c[3:6], every, None, c[6])
        left = field.occluded(xp, c[:3], c[10:13], every, field.locate(xp, c[7:10], every), xp.full(c[0], np.inf))
        return {"free": xp.integer(free), "left": xp.integer(left)}

    at, on = np.where(start.hit[:, None], start.p, [2.0, 2.0, 2.0]), start.hit
    away = start.n + 1.5 * np.roll(start.n, 1, axis=1)
    away = np.where(on[:, None], away * np.sign(np.sum(away * start.n, axis=1, keepdims=True)), d)
    columns = [*(p - field.anchor).T, *d.T, limit, *(at - field.anchor).T, *away.T]
    out = field.engine.run(program, columns)
    clear = np.abs(t - limit[:, None]).min(axis=1) > off(field)
    np.testing.assert_array_equal(out["free"][clear] > 0, (t[:, 0] < limit)[clear])
    assert 0.2 < (out["free"] > 0).mean() < 0.8
    unit = away / np.linalg.norm(away, axis=1, keepdims=True)
    other, near = roots(balls, at, unit)
    beyond = np.where((near != start.part[:, None]) | (other > 0.01), other, np.inf).min(axis=1)  # not its own root
    sure = on & (np.sum(unit * start.n, axis=1) > 0.05) & rays_clear(balls, at, unit)
    np.testing.assert_array_equal(out["left"][sure] > 0, np.isfinite(beyond)[sure])
    assert (out["left"][sure] > 0).sum() > 10


def rays_clear(balls, p, d):
    """Rays that no ball is grazed by."""
    near = np.stack([np.linalg.norm(np.cross(p - np.array(c), d), axis=1) / r for r, c in balls], axis=1)
    return (np.abs(near - 1) > 0.02).all(axis=1)


def test_a_small_member_far_from_the_middle_keeps_its_digits():
    """In float32 a place 100 from the middle rounds to 4e-6, on a ball of 1e-3; its own frame knows it to 1e-9."""
    members = placed(ball(choose("numpy", 32).engine), [(1.0, (-100.0, 0.0, 0.0)), (1e-3, (100.0, 0.0, 0.0))])
    field = Assembly(members)

    def program(xp, *c):
        every = xp.full(c[0], True)
        first = field.first_hit(xp, c[:3], c[3:6], every)
        second = field.first_hit(xp, c[:3], c[3:6], every, first)
        values = {str(i): field.jet_at(xp, spot, 0).value for i, spot in enumerate((first, second))}
        return {**values, "t": second.t, "hit": xp.integer(first.hit & second.hit)}

    columns = [*(np.array([[99.5, 0.0, 0.0]]) - field.anchor).T, *np.array([[1.0, 0.0, 0.0]]).T]
    out = field.engine.run(program, columns)
    assert out["hit"].all() and out["t"] == pytest.approx(2e-3, rel=1e-4)
    assert max(np.abs(out["0"]), np.abs(out["1"])) < 1e-8


def test_parts_names_and_textures_of_unlike_members():
    """Ids go on from member to member, names that meet are numbered, textures are there where a member has some."""
    mirror = GridField(Grid.from_function(shape("mirror"), 24, uv_mode="none"), engine="numpy")
    textured = Instance(ball(), Similarity.of_parts(0.5, translate=(6.0, 0.0, 0.0)))
    field = Assembly([mirror, textured, Instance(mirror, Similarity.of_parts(translate=(0.0, 9.0, 0.0)))])
    assert mirror.part_names == ("sphere", "sheet")
    assert field.part_names == ("0:sphere", "0:sheet", "1:sphere", "2:sphere", "2:sheet")
    assert field.uv_mode == "grid" and field.is_distance
    p, d = np.array([[0.0, 0.0, 1.5], [0.0, 9.0, 1.5], [6.0, 0.05, 1.9]]), np.tile([[0.0, 0.0, -1.0]], (3, 1))
    hits, at = transfer(field, bundle(p, d))
    seen = footprint(field, hits, at)
    np.testing.assert_array_equal(hits.part, [0, 3, 2])
    assert not seen.uv[:2].any() and not seen.duv_dx[:2].any() and (seen.chart[:2] == -1).all()
    assert seen.uv[2].all() and seen.duv_dx[2].any() and seen.chart[2] >= 0
    with pytest.raises(BadInput, match="texture coordinates"):
        footprint(Assembly([mirror]), hits, at)


def test_texture_modes_that_need_the_normal_come_first(rng):
    """Then all members are given it: faces answer as they do alone, but where rounding decides between two."""
    assert Assembly([ShapeField(Sphere(1.0)), ball()]).uv_mode == "grid"
    assert Assembly([ShapeField(Sphere(1.0))]).uv_mode == "exact"
    faces = GridField(with_faces(grid(), Sphere(UNIT).mesh(0.3)), engine="numpy")
    field = Assembly([Instance(ball(), Similarity.of_parts(0.5, translate=(1.0, 1.5, 0.0))), faces])
    assert field.uv_mode == "faces"
    hits, at = transfer(faces, bundle(*rays_at([(UNIT, (0.0, 0.0, 0.0))], rng)))
    one, two = (footprint(surface, hits, at) for surface in (faces, field))
    same = np.abs(one.duv_dx - two.duv_dx).max(axis=1) < 1e4 * EPS
    assert same[hits.hit].mean() > 0.95 and hits.hit.sum() > 200


def test_members_share_an_engine():
    with pytest.raises(ValueError, match="numpy 64, numpy 32"):
        Assembly([ball(), ball(choose("numpy", 32).engine)])
    with pytest.raises(ValueError, match="at least one"):
        Assembly([])
