"""Glass with differentials: the symplectic form with its index, closed forms of lens, slab and critical angle, displaced
rays, Fresnel's shares, solids within and against each other; and faults that these must catch."""

from decimal import Decimal, localcontext

import numpy as np
import pytest

from beams import forms, glassy, perpendicular, perturbed, symplectic_defect
from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from datasets_synthetic.union import Union
from sdfbake import Grid
from sdfrender import Flag, GridField, Rays, fresnel, leaving, optics, reflect, refract, transfer
from sdfrender.field import Jet
from sdfrender.rays import Beam, beam, components, rays
from sdfrender.vector import Symmetric
from validate.beam import displace
from validate.displaced import richardson
from validate.exact import ShapeField

EPS = np.finfo(float).eps
INDEX = 1.5


def torus_rays(rng, count=200):
    """Rays from all around that reach the torus' tube."""
    p = rng.normal(size=(count, 3))
    p = 3 * p / np.linalg.norm(p, axis=1, keepdims=True)
    turn = rng.uniform(0, 2 * np.pi, count)
    d = 0.7 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1) + rng.uniform(-0.2, 0.2, (count, 3)) - p
    return p, d / np.linalg.norm(d, axis=1, keepdims=True)


def crossed(field, bundle, index=INDEX, on_surface=False):
    """One crossing: hits, rays at the surface, rays beyond it, and whether they came from inside."""
    hits, at = transfer(field, bundle, on_surface=on_surface)
    inside = leaving(hits, at)
    return hits, at, refract(field, hits, at, eta=np.where(inside, index, 1 / index)), inside


def through(field, bundle, crossings, index=INDEX):
    """Several crossings: which rays made them all, and the rays beyond the last."""
    alive = np.ones(len(bundle), bool)
    for number in range(crossings):
        hits, _, bundle, _ = crossed(field, bundle, index, number > 0)
        alive &= hits.hit
    return alive, bundle


@pytest.fixture(params=["exact", "bspline", "catmull-rom"])
def torus(request):
    """The torus, exact and as grids: the identities hold for the interpolant as for the shape."""
    exact = shape("torus")
    if request.param == "exact":
        return ShapeField(glassy(exact))
    return GridField(Grid.from_function(exact, 48, uv_mode="none"), request.param, "numpy")


def test_identities_on_the_way_through_glass(torus, rng):
    """In, along the inside, out or totally reflected, and on: at every step the form with its index, d . d = 1,
    d . dd = 0, n . dp = 0. A dozen roundings each, of the lengths; the lengths grow at grazing surfaces."""
    bundles = perturbed(*torus_rays(rng), rng)
    medium, alive, total = np.ones(len(bundles[0])), True, 0
    for step in range(4):
        way = [crossed(torus, b, on_surface=step > 0) for b in bundles]
        hits, inside = way[0][0], way[0][3]
        at, out = [w[1] for w in way], [w[2] for w in way]
        alive = alive & hits.hit
        rows = np.flatnonzero(alive & (np.abs(np.sum(hits.n * at[0].d, axis=1)) > 1e-3))
        assert rows.size >= 10
        assert np.array_equal(inside[rows], medium[rows] > 1)  # the side seen from d . n is the side it is on
        beyond = np.where(np.sum(out[0].d * hits.n, axis=1) < 0, INDEX, 1.0)
        before, here, after = ([b.where(rows) for b in group] for group in (bundles, at, out))
        assert symplectic_defect(before, here).max() < 1e-12
        assert symplectic_defect(here, after, medium[rows], beyond[rows]).max() < 1e-12
        n, here, after = hits.n[rows], here[0], after[0]
        assert np.abs(np.linalg.norm(n, axis=1) - 1).max() < 4 * EPS
        assert np.abs(np.linalg.norm(after.d, axis=1) - 1).max() < 64 * EPS
        slope, length = np.abs(np.sum(n * here.d, axis=1)), np.linalg.norm(here.dp_dx, axis=1)
        assert (np.abs(np.sum(n * here.dp_dx, axis=1)) < 64 * EPS * length / slope).all()
        size = np.linalg.norm(after.dd_dx, axis=1) + length + 1
        assert (np.abs(np.sum(after.d * after.dd_dx, axis=1)) < 512 * EPS * size).all()
        total += np.count_nonzero(np.array_equal(inside[rows], beyond[rows] > 1) or inside[rows] & (beyond[rows] > 1))
        bundles, medium = out, beyond
    assert total > 10


def test_a_wrong_eta_breaks_the_form_by_its_square(rng):
    """Index and reciprocal exchanged: the form comes out (n_t / n_i)^2 = 2.25 times too large, whatever the ray."""
    field = ShapeField(Sphere(0.8))
    p, d = torus_rays(rng)
    at = [transfer(field, b) for b in perturbed(p, d, rng)]
    wrong = [refract(field, hits, moved, eta=INDEX) for hits, moved in at]
    hits = at[0][0]
    rows = np.flatnonzero(hits.hit & ((wrong[0].flags & Flag.TIR) == 0) & (np.sum(hits.n * d, axis=1) < -0.8))
    assert rows.size > 10
    start, end = forms([moved.where(rows) for _, moved in at]), forms([w.where(rows) for w in wrong])
    clear = np.abs(start) > 0.1
    assert (INDEX * end / start)[clear] == pytest.approx(2.25, rel=1e-11)


def faulty(fault):
    """Refraction with one mistake."""
    right = optics.refract

    def refract_(xp, incoming, n, dn_dx, dn_dy, eta):
        out, total = right(xp, incoming, n, dn_dx, dn_dy, eta)
        if fault == "dd / eta":  # as some renderers have it: eta times the transmitted differential
            ratio = 1.0 / (eta * eta)
            return out._replace(dd_dx=optics.scale(out.dd_dx, ratio), dd_dy=optics.scale(out.dd_dy, ratio)), total
        if fault == "dn not turned":
            side = xp.where(optics.dot(incoming.d, n) > 0, -1.0, 1.0)
            return right(xp, incoming, n, optics.scale(dn_dx, side), optics.scale(dn_dy, side), eta)
        # "no dmu": what the differential of mu adds along the normal is taken away again
        way = optics.passage(xp, incoming.d, n, eta)
        mu = (1.0 - eta) * (1.0 + eta) / (way.c_out + eta * way.c)

        def flat(dd, dn):
            return optics.subtract(optics.scale(dd, eta), optics.scale(dn, mu * way.facing))

        return out._replace(dd_dx=flat(incoming.dd_dx, dn_dx), dd_dy=flat(incoming.dd_dy, dn_dy)), total

    return refract_


def lens_error(field, index, b, radius=0.8):
    """A parallel beam at height b through a ball: greatest error of direction and differentials beyond it.

    In the plane of incidence the ray turns by D(b) = 2 (asin(b / r) - asin(b / (n r))), so dd_dx = dD/db; across it
    the turn about the axis gives dd_dy = sin(D) / b. Relative to the differentials' sizes.
    """
    zero, one = np.zeros_like(b), np.ones_like(b)
    p, d = np.stack([b, zero, 1.5 * one], axis=1), np.stack([zero, zero, -one], axis=1)
    across, aside = np.stack([one, zero, zero], axis=1), np.stack([zero, one, zero], axis=1)
    alive, out = through(field, Rays(p, d, across, aside, 0 * p, 0 * p), 2, index)
    assert alive.all() and not (out.flags & Flag.TIR).any()
    turn = 2 * (np.arcsin(b / radius) - np.arcsin(b / (index * radius)))
    slope = 2 * (1 / np.sqrt(radius**2 - b**2) - 1 / np.sqrt((index * radius) ** 2 - b**2))
    beyond = np.stack([-np.sin(turn), zero, -np.cos(turn)], axis=1)
    dd_dx = slope[:, None] * np.stack([-np.cos(turn), zero, np.sin(turn)], axis=1)
    dd_dy = -(np.sin(turn) / b)[:, None] * aside
    return max(
        np.abs(out.d - beyond).max(),
        (np.linalg.norm(out.dd_dx - dd_dx, axis=1) / np.abs(slope)).max(),
        (np.linalg.norm(out.dd_dy - dd_dy, axis=1) * b / np.abs(np.sin(turn))).max(),
    )


@pytest.mark.parametrize("index", [1.5, 2.4, 0.75, 1 + 1e-6], ids=["glass", "diamond", "bubble", "nearly air"])
def test_a_ball_lens_by_its_closed_form(index):
    """To 1e-11, the roundings of a few differences of asin; nearly air, those are over the turn of 1e-6."""
    b = np.linspace(0.02, 0.55, 12)
    assert lens_error(ShapeField(glassy(Sphere(0.8))), index, b) < (1e-11 if abs(index - 1) > 1e-3 else 1e-8)


@pytest.mark.parametrize("fault", ["dd / eta", "dn not turned", "no dmu"])
def test_faults_show_on_the_lens(fault, monkeypatch):
    monkeypatch.setattr(optics, "refract", faulty(fault))
    field, b = ShapeField(glassy(Sphere(0.8))), np.linspace(0.02, 0.55, 12)
    assert lens_error(field, INDEX, b) > 1e-2


@pytest.mark.parametrize("fault", ["dd / eta", "no dmu"])
def test_faults_break_the_form(fault, rng, monkeypatch):
    """The form sees a wrong scale at once. Terms along the normal it cannot see, as n . dp = 0: d . dd = 0 does."""
    monkeypatch.setattr(optics, "refract", faulty(fault))
    field = ShapeField(Sphere(0.8))
    way = [crossed(field, b) for b in perturbed(*torus_rays(rng), rng)]
    rows = np.flatnonzero(way[0][0].hit)
    here, after = [w[1].where(rows) for w in way], [w[2].where(rows) for w in way]
    if fault == "no dmu":
        assert np.median(np.abs(np.sum(after[0].d * after[0].dd_dx, axis=1))) > 1e-3
    else:
        assert np.median(symplectic_defect(here, after, 1.0, INDEX)) > 1e-3


def test_a_ball_lens_on_a_grid(choice):
    """The kernel's curvature error at 48 samples, under 2 %, on every engine."""
    field = GridField(Grid.from_function(Sphere(0.8), 48, uv_mode="none"), "bspline", choice)
    assert lens_error(field, INDEX, np.linspace(0.05, 0.5, 40)) < 4e-2


def test_a_ball_lens_converges_with_the_grid():
    """dn comes from the Hessian of a cubic kernel, of order 2: from 24 to 96 samples the error falls 16-fold."""
    sizes, b = np.array([24, 48, 96]), np.linspace(0.05, 0.5, 100)
    errors = [lens_error(GridField(Grid.from_function(Sphere(0.8), n, uv_mode="none"), "bspline", "numpy"), INDEX, b)
              for n in sizes]  # fmt: skip
    order = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert 1.6 < order < 3.2, (order, errors)


def test_refraction_is_that_of_displaced_rays(rng):
    """Into the torus and out of it (or along): the truth states its own error, 3 of which it has."""
    field = ShapeField(glassy(shape("torus")))
    p, d = torus_rays(rng)
    start = perturbed(p, d, rng)[0]
    start = Rays(p, d, *(1e-2 * move for move in (start.dp_dx, start.dp_dy, start.dd_dx, start.dd_dy)))
    alive, out = through(field, start, 2)

    def displaced(dx, dy):
        moved = displace(start, dx, dy)
        met, beyond = through(field, Rays(moved.p, moved.d, *(np.zeros((len(p), 3)) for _ in range(4))), 2)
        return np.where(met[:, None], np.concatenate([beyond.p, beyond.d], axis=1), np.nan)

    truth = richardson(displaced, step=0.02)
    clear = alive & (truth.error_dx < 1e-4).all(axis=1) & (truth.error_dy < 1e-4).all(axis=1)
    assert clear.sum() > 100
    # Rounding of p and d, some 1e-14 after two crossings, over half the step.
    for dp, dd, theirs, error in (
        (out.dp_dx, out.dd_dx, truth.d_dx, truth.error_dx),
        (out.dp_dy, out.dd_dy, truth.d_dy, truth.error_dy),
    ):
        ours = np.concatenate([dp, dd], axis=1)
        assert (np.abs(ours - theirs) <= 3 * error + 1e-11)[clear].all()


def bend(engine, d, n, dn, dd, eta):
    """Refract single beams at hand-made surfaces: (rays, total)."""
    count, zero = len(d), np.zeros((len(d), 3))

    def program(xp, *c):
        incoming = beam(c[:18])
        out, total = optics.refract(xp, incoming, c[18:21], c[21:24], c[24:27], c[27])
        return {**components(out), "total": xp.integer(total)}

    columns = [*zero.T, *d.T, *zero.T, *zero.T, *dd.T, *zero.T, *n.T, *dn.T, *zero.T, np.broadcast_to(eta, (count,))]
    out = engine.run(program, columns)
    return rays(out), out["total"] > 0


@pytest.mark.parametrize("cosine", [1.0, 0.6])
@pytest.mark.parametrize("sign", [-1, 1], ids=["below", "above"])
def test_an_index_near_one_keeps_its_digits(cosine, sign, choice):
    """mu = c' - eta c, from 1e-1 down to the last digits of eta, against 50 digits: ten roundings, relative.

    A normal that turns out of the plane of incidence by dn shows it alone: dd' = -mu dn.
    """
    kind = choice.engine.float_type if hasattr(choice.engine, "float_type") else np.float64
    kind = np.float32 if choice.engine.precision == 32 else np.float64
    powers = np.arange(1, 16 if choice.engine.precision == 64 else 7)
    eta, c = (1 + sign * 10.0**-powers).astype(kind), kind(cosine)
    d = np.broadcast_to([np.sqrt(1 - float(c) ** 2), 0.0, -float(c)], (len(eta), 3))
    n, dn = np.broadcast_to([0.0, 0.0, 1.0], d.shape), np.broadcast_to([0.0, 1.0, 0.0], d.shape)
    out, total = bend(choice.engine, d, n, dn, 0 * d, eta.astype(float))
    with localcontext() as digits:
        digits.prec = 50
        exact = []
        for ratio in eta:
            e, cos = Decimal(float(ratio)), Decimal(float(c))
            exact.append(float((1 - e * e * (1 - cos * cos)).sqrt() - e * cos))
    assert not total.any()
    assert -out.dd_dx[:, 1] == pytest.approx(np.array(exact), rel=10 * choice.engine.eps)
    assert np.abs(np.sum(out.d * d, axis=1) - 1).max() < 0.02


def test_near_the_critical_angle(choice):
    """From glass at sin = (1 - delta) / n the differential grows by n c / c', c'^2 = delta (2 - delta): delta^-1/2.

    c'^2 is a difference of numbers near 1.25 with some 4 roundings: 8 eps / (2 delta) relative, half of it in c'.
    """
    delta = np.logspace(-2, -12, 21)
    delta = delta[8 * choice.engine.eps / delta < 0.05]
    for side in (1, -1):
        sine = (1 - side * delta) / INDEX
        c, zero = np.sqrt(1 - sine**2), 0 * sine
        d, n = np.stack([sine, zero, c], axis=1), np.stack([zero, zero, zero + 1], axis=1)
        dd = np.stack([c, zero, -sine], axis=1)
        out, total = bend(choice.engine, d, n, 0 * d, dd, INDEX)
        if side < 0:
            assert total.all()
            assert np.abs(out.d - d * [1, 1, -1]).max() < 8 * choice.engine.eps
            assert np.abs(out.dd_dx - dd * [1, 1, -1]).max() < 8 * choice.engine.eps
            continue
        assert not total.any()
        grown = np.linalg.norm(out.dd_dx, axis=1)
        expected = INDEX * c / np.sqrt(delta * (2 - delta))
        assert (np.abs(grown / expected - 1) < 16 * choice.engine.eps / delta).all()
        if choice.engine.precision == 64:
            assert np.polyfit(np.log(delta), np.log(grown), 1)[0] == pytest.approx(-0.5, abs=5e-3)


def test_the_critical_ray_itself_is_finite(choice):
    """At sin = 1 / eta, and for grazing light at equal indices: no division by nothing."""
    d = np.array([[0.8, 0.0, 0.6], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    n, dd = np.broadcast_to([0.0, 0.0, 1.0], d.shape), np.array([[0.6, 0, -0.8], [0, 0, 1.0], [0, 0, 1.0]])
    out, _ = bend(choice.engine, d, n, 0 * d, dd, np.array([1.25, 1.0, 1 / 1.5]))
    assert all(np.isfinite(getattr(out, name)).all() for name in ("d", "dd_dx", "dd_dy"))


def ball(choice, n=32):
    return GridField(Grid.from_function(Sphere(0.8), n, uv_mode="none"), "bspline", choice)


def test_total_reflection_is_a_mirror(choice, rng):
    """From inside a ball: TIR where n sin >= 1, there the mirrored ray, all light in it, and the flag stays on the way."""
    field = ball(choice)
    d = rng.normal(size=(400, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    inside = perturbed(np.broadcast_to([0.6, 0.0, 0.0], d.shape), d, rng)[0]
    hits, at = transfer(field, inside)
    assert hits.hit.all() and leaving(hits, at).all()
    out, mirror = refract(field, hits, at, eta=INDEX), reflect(field, hits, at)
    sine = np.linalg.norm(np.cross(hits.n, at.d), axis=1)
    clear = np.abs(INDEX * sine - 1) > 1e-5
    total = INDEX * sine >= 1
    assert 50 < np.count_nonzero(total) < 350
    assert np.array_equal(((out.flags & Flag.TIR) > 0)[clear], total[clear])
    rows = np.flatnonzero(total & clear)
    scale = 1 + np.abs(mirror.dd_dx).max()
    for name in ("d", "dd_dx", "dd_dy"):
        assert np.abs(getattr(out, name) - getattr(mirror, name))[rows].max() < 64 * choice.engine.eps * scale
    mirrored, passed = fresnel(field, hits, at, eta=INDEX)
    assert (mirrored[rows] == 1).all() and (passed[rows] == 0).all()
    assert (mirrored[clear & ~total] < 1).all()
    again, beyond = transfer(field, out, on_surface=True)
    assert not (again.flags & Flag.TIR).any() and ((beyond.flags & Flag.TIR) > 0)[rows].all()


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0])
def test_a_parallel_slab(degrees, choice):
    """A plate of 16 voxels: the direction and dd come out as they went in; on its far side dp is the closed form's.

    With a and L the ways across air and plate, tan' that of the refracted angle: y = a tan + L tan', so
    dp_dx = a / cos^2 + L cos / (n cos'^3), and across the plane of incidence a / cos + L / (n cos').
    Kernels reproduce planes; rounding of coefficients up to 20 and of the way: 800 eps over the cosine.
    """
    x = np.arange(48.0)[:, None, None] + np.zeros((48, 24, 80))
    field = GridField(Grid.from_dense(np.abs(x - 23.25) - 8), "bspline", choice)
    angle = np.radians(degrees)
    sine, cosine = np.sin(angle), np.cos(angle)
    d, along, aside = (np.array([v]) for v in ([-cosine, 0, sine], [sine, 0, cosine], [0.0, 1.0, 0.0]))
    p, zero = np.array([[31.25, 11.5, 10.0]]) - 10.0 * d, np.zeros((1, 3))
    a, plate = 10.0 * cosine, 16.0
    hits, _, inner, _ = crossed(field, Rays(p, d, zero, zero, 1e-3 * along, 1e-3 * aside))
    again, at, out, inside = crossed(field, inner, on_surface=True)
    inner_cosine = np.sqrt(1 - (sine / INDEX) ** 2)
    limit = 2000 * choice.engine.eps / cosine
    assert hits.hit[0] and again.hit[0] and inside[0]
    assert again.t[0] == pytest.approx(plate / inner_cosine, rel=limit)
    assert np.abs(out.d - d).max() < limit
    assert np.abs(out.dd_dx - 1e-3 * along).max() < 1e-3 * limit
    assert np.abs(out.dd_dy - 1e-3 * aside).max() < 1e-3 * limit
    in_plane = a / cosine**2 + plate * cosine / (INDEX * inner_cosine**3)
    across = a / cosine + plate / (INDEX * inner_cosine)
    assert np.abs(at.dp_dx - 1e-3 * in_plane * np.array([0, 0, 1])).max() < 1e-3 * limit * in_plane
    assert np.abs(at.dp_dy - 1e-3 * across * aside).max() < 1e-3 * limit * across


def test_facing_mirrors_grow_by_their_matrix(choice):
    """Sixty bounces between two balls of radius 1, half a unit apart: (dp, dd) by the matrix of a step, gain 2.618.

    All its entries are positive, so nothing cancels: 8 roundings a step. The beam reaches 1e22, its square passes
    float32: no overflow, and no caustic in a beam that spreads.
    """
    bounces, gap, radius = 60, 0.5, 1.0
    step = np.array([[1, 0], [2 / radius, 1]]) @ np.array([[1, gap], [0, 1]])
    starts = np.array([[1e-3, 0.0], [0.0, 2e-3]])
    ends = [np.linalg.matrix_power(step, bounces) @ start for start in starts]

    def program(xp, x, y, size):
        zero, one, r = xp.full(x, 0.0), xp.full(x, 1.0), xp.full(x, 1.0 / radius)
        thin = Beam((zero, zero, zero), (zero, zero, one), (x, zero, zero), (zero, zero, zero), (zero,) * 3, (zero, y, zero))
        caustic, toward = x < 0, 1.0
        for _ in range(bounces):
            n = (zero, zero, one * -toward)
            jet = Jet(zero, n, Symmetric(r, r, zero, zero, zero, zero))
            caustic = caustic | optics.passes_caustic(xp, thin, size)
            at = optics.transfer(xp, thin, jet, (zero, zero, zero), size)
            turns = [optics.normal_differential(xp, jet, n, dp) for dp in (at.dp_dx, at.dp_dy)]
            thin, toward = optics.reflect(at, n, *turns), -toward
        return {**components(thin), "caustic": xp.integer(caustic)}

    named = choice.engine.run(program, [starts[:1, 0], starts[1:, 1], np.array([gap])])
    out = rays(named)
    limit = 8 * bounces * choice.engine.eps
    assert ends[0][0] > 1e21 and not named["caustic"].any()
    assert [out.dp_dx[0, 0], out.dd_dx[0, 0]] == pytest.approx(list(ends[0]), rel=limit)
    assert [out.dp_dy[0, 1], out.dd_dy[0, 1]] == pytest.approx(list(ends[1]), rel=limit)


@pytest.mark.parametrize("size", [1e-30, 1e-7, 1.0, 1e30])
def test_a_caustic_does_not_depend_on_the_beams_width(size, choice):
    """Two foci at 1 and 2 of a beam of any width: none seen up to 0.9, one up to 1.1, both up to 2.1 (the cross-section
    is positive again), and none from 2.1 on."""
    def program(xp, x, dx, dy, begin, t):
        zero, one = xp.full(x, 0.0), xp.full(x, 1.0)
        thin = Beam((zero,) * 3, (zero, zero, one), (x + begin * dx, zero, zero), (zero, x + begin * dy, zero),
                    (dx, zero, zero), (zero, dy, zero))  # fmt: skip
        return {"seen": xp.integer(optics.passes_caustic(xp, thin, t))}

    begin, t = np.array([0.0, 0.0, 0.0, 2.1]), np.array([0.9, 1.1, 2.1, 3.0])
    out = choice.engine.run(program, [np.full(4, size), np.full(4, -size), np.full(4, -size / 2), begin, t])
    assert out["seen"].tolist() == [0, 1, 1, 0]


@pytest.mark.parametrize(("front", "seen"), [(-1.0, False), (-1.5, True)], ids=["before focus", "behind focus"])
def test_a_lens_has_a_focus(front, seen):
    """A ball of index 3/2 focuses r / 2 behind it, at -1.2: a wall behind that is reached through a CAUSTIC, not one
    before it; neither is the way in, through the glass, nor back from the wall, a mirror that spreads."""
    wall = Sphere(0.3, (0.0, 0.0, front - 0.3), ("wall",))
    field = ShapeField(glassy(Union((Sphere(0.8), wall), ("lens", "wall"))))
    p, d, zero = np.array([[0.05, 0.02, 2.0]]), np.array([[0.0, 0.0, -1.0]]), np.zeros((1, 3))
    hits, _, inner, _ = crossed(field, Rays(p, d, np.array([[1e-3, 0, 0]]), np.array([[0, 1e-3, 0]]), zero, zero))
    again, _, out, _ = crossed(field, inner, on_surface=True)
    last, at = transfer(field, out, on_surface=True)
    assert [h.part[0] for h in (hits, again, last)] == [0, 0, 1]
    assert not (hits.flags | again.flags)[0] & Flag.CAUSTIC
    assert bool(last.flags[0] & Flag.CAUSTIC) == seen == bool(at.flags[0] & Flag.CAUSTIC)
    back, _ = transfer(field, reflect(field, last, at), on_surface=True)
    assert back.hit[0] and not back.flags[0] & Flag.CAUSTIC


def shares(choice, cosine, eta):
    """Reflectance of rays at a plane, from outside."""
    d = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, -cosine], axis=1)

    def program(xp, *c):
        zero = xp.full(c[0], 0.0)
        return {"r": optics.reflectance(xp, (c[0], c[1], c[2]), (zero, zero, zero + 1.0), c[3])}

    return choice.engine.run(program, [*d.T, np.broadcast_to(eta, cosine.shape)])["r"].astype(float)


@pytest.mark.parametrize("eta", [1 / 1.5, 1 / 1.1, 0.4, 1.2])
def test_fresnel_by_angles(eta, choice):
    """(sin^2(i - t) / sin^2(i + t) + tan^2(i - t) / tan^2(i + t)) / 2, Fresnel's own form; the same from either side."""
    incident = np.radians(np.linspace(1.0, min(89.0, np.degrees(np.arcsin(min(1.0, 1 / eta))) - 2), 40))
    refracted = np.arcsin(eta * np.sin(incident))
    less, more = incident - refracted, incident + refracted
    expected = 0.5 * ((np.sin(less) / np.sin(more)) ** 2 + (np.tan(less) / np.tan(more)) ** 2)
    limit = 200 * choice.engine.eps  # roundings of the cosine, over that of 1 to 88 degrees
    assert shares(choice, np.cos(incident), eta) == pytest.approx(expected, abs=limit)
    assert shares(choice, np.cos(refracted), 1 / eta) == pytest.approx(expected, abs=limit)


def test_fresnel_at_its_marks(choice):
    """Normal incidence ((1 - eta) / (1 + eta))^2, to rounding even near 1; nothing of p at Brewster's angle; all of the
    light at grazing incidence and beyond the critical angle, none at equal indices."""
    eta = 1 - 10.0 ** -np.arange(1.0, 6.0)
    held = eta.astype(np.float32 if choice.engine.precision == 32 else np.float64).astype(float)
    normal = shares(choice, np.ones(5), eta)
    assert normal == pytest.approx(((1 - held) / (1 + held)) ** 2, rel=32 * choice.engine.eps)
    brewster = np.array([1 / np.sqrt(1 + INDEX**2)])
    sine, cosine = 1 / np.sqrt(1 + INDEX**2), INDEX / np.sqrt(1 + INDEX**2)  # of the refracted angle
    s_only = 0.5 * ((brewster[0] - INDEX * cosine) / (brewster[0] + INDEX * cosine)) ** 2
    assert sine == pytest.approx(np.sqrt(1 - cosine**2))
    assert shares(choice, brewster, 1 / INDEX) == pytest.approx(s_only, rel=64 * choice.engine.eps)
    assert shares(choice, np.array([0.0, 0.5, 0.0, 0.3]), np.array([1 / INDEX, INDEX, 1.0, 1.0])).tolist() == [1, 1, 1, 0]


def test_an_empty_shell_bends_by_both_its_spheres():
    """Nested: glass from 0.8 down to 0.5, air within. n b is kept (Bouguer): the ray leaves at the height it came in,
    turned by both spheres: 2 [(asin b/R - asin b/nR) - (asin b/r - asin b/nr)]. 64 samples: 1e-3, the kernel's."""
    axis = np.linspace(-1.0, 1.0, 64)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    r = np.sqrt(x * x + y * y + z * z)
    spacing = axis[1] - axis[0]
    field = GridField(Grid.from_dense(np.maximum(r - 0.8, 0.5 - r), origin=[-1.0] * 3, spacing=spacing), "bspline", "numpy")
    b, zero = 0.2, np.zeros((1, 3))
    bundle, sides, ends = Rays(np.array([[b, 0, 0.95]]), np.array([[0, 0, -1.0]]), zero, zero, zero, zero), [], []
    for number in range(4):
        hits, _, bundle, inside = crossed(field, bundle, INDEX, number > 0)
        assert hits.hit[0]
        sides.append(bool(inside[0]))
        ends.append(np.linalg.norm(hits.p[0]))
    assert sides == [False, True, False, True]
    assert ends == pytest.approx([0.8, 0.5, 0.5, 0.8], abs=1e-3)
    assert np.linalg.norm(np.cross(bundle.p[0], bundle.d[0])) == pytest.approx(b, abs=1e-3)
    outer, inner = (np.arcsin(b / s) - np.arcsin(b / (INDEX * s)) for s in (0.8, 0.5))
    assert np.arcsin(-bundle.d[0, 0]) == pytest.approx(2 * (outer - inner), abs=2e-3)
    assert not transfer(field, bundle, on_surface=True)[0].hit[0]


@pytest.mark.parametrize(("centre", "heights"), [
    (0.6, [1.089898, 0.110102, -0.110102, -1.089898]),
    (0.5, [0.989898, 0.010102, -0.010102, -0.989898]),
    (0.3, [0.789898, -0.789898]),
], ids=["apart", "touching", "overlapping"])  # fmt: skip
def test_two_balls_are_one_surface(centre, heights):
    """A ray 0.1 beside the axis of two balls of radius 0.5: it meets what bounds the union, z = +-c +- sqrt(0.24),
    entering and leaving in turn; between overlapping balls there is nothing. An eta of 1 changes no direction."""
    balls = tuple(Sphere(0.5, (0.0, 0.0, z)) for z in (centre, -centre))
    field = ShapeField(glassy(Union(balls, ("one", "other"))))
    zero = np.zeros((1, 3))
    bundle, met = Rays(np.array([[0.1, 0.0, 2.0]]), np.array([[0.0, 0.0, -1.0]]), zero, zero, zero, zero), []
    for number in range(len(heights)):
        hits, _, bundle, inside = crossed(field, bundle, 1.0, number > 0)
        assert bool(inside[0]) == bool(number % 2)
        met.append(hits.p[0, 2])
    assert met == pytest.approx(heights, abs=1e-6)
    assert bundle.d[0].tolist() == [0.0, 0.0, -1.0]
    assert not transfer(field, bundle, on_surface=True)[0].hit[0]


def test_misses_pass_unchanged_and_flags_stay(choice):
    field = ball(choice)
    p, d = np.array([[2.0, 0, 0], [2.0, 2.0, 0]]), np.array([[-1.0, 0, 0], [-1.0, 0, 0]])
    start = Rays(p, d, *(np.ones((2, 3)) for _ in range(4)), np.array([0, int(Flag.CAUSTIC)], np.int32))
    hits, at = transfer(field, start)
    out = refract(field, hits, at, eta=np.array([0.5, 0.5]))
    assert hits.hit.tolist() == [True, False] and out.flags[1] == Flag.CAUSTIC
    assert np.array_equal(out.d[1], d[1]) and np.array_equal(out.p[1], p[1])
    mirrored, passed = fresnel(field, hits, at, eta=0.5)
    assert mirrored[0] + passed[0] == 1 and mirrored[1] == passed[1] == 0


@pytest.mark.parametrize("eta", [0.0, -1.5, np.nan, np.inf, np.ones(3)], ids=["zero", "negative", "nan", "inf", "shape"])
def test_bad_eta(eta):
    field = ShapeField(Sphere(0.8))
    p = np.array([[2.0, 0, 0]])
    hits, at = transfer(field, Rays(p, -0.5 * p, *(np.zeros((1, 3)) for _ in range(4))))
    with pytest.raises(ValueError, match="eta"):
        refract(field, hits, at, eta=eta)


def test_flags_and_rays_must_match():
    with pytest.raises(ValueError, match="flags"):
        Rays(*(np.zeros((2, 3)) for _ in range(6)), np.zeros(3, np.int32))


def test_perpendicular_takes_out_the_ray(rng):
    """The helper itself: what is left has no part along the ray."""
    d = rng.normal(size=(5, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    assert np.abs(np.sum(perpendicular(rng.normal(size=(5, 3)), d) * d, axis=1)).max() < 8 * EPS
