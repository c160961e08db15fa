"""Refraction with differentials: the symplectic form with its index, lens, slab and critical angle in closed form,
displaced rays; and faults that these must catch."""

from decimal import Decimal, localcontext

import numpy as np
import pytest
from beams import INDEX, crossed, perturbed

from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfrender import Flag, GridField, Rays, optics, refract, transfer
from sdfrender.rays import beam, components, rays, vectors
from validate.beam import displace
from validate.displaced import richardson
from validate.exact import ShapeField
from validate.identities import forms, symplectic_defect

EPS = np.finfo(float).eps


def torus_rays(rng, count=200):
    """Rays from all around that reach the torus' tube."""
    p = rng.normal(size=(count, 3))
    p = 3 * p / np.linalg.norm(p, axis=1, keepdims=True)
    turn = rng.uniform(0, 2 * np.pi, count)
    d = 0.7 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1) + rng.uniform(-0.2, 0.2, (count, 3)) - p
    return p, d / np.linalg.norm(d, axis=1, keepdims=True)


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
        return ShapeField(exact)
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
        total += np.count_nonzero(inside[rows] & (beyond[rows] > 1))
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

        def flat(dd, dn):
            return optics.subtract(optics.scale(dd, eta), optics.scale(dn, way.mu * way.facing))

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
    assert lens_error(ShapeField(Sphere(0.8)), index, b) < (1e-11 if abs(index - 1) > 1e-3 else 1e-8)


@pytest.mark.parametrize("fault", ["dd / eta", "dn not turned", "no dmu"])
def test_faults_show_on_the_lens(fault, monkeypatch):
    monkeypatch.setattr(optics, "refract", faulty(fault))
    field, b = ShapeField(Sphere(0.8)), np.linspace(0.02, 0.55, 12)
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
    """The kernel's curvature error at 48 samples, 3e-4 with h = 0.045; float32 adds 10 taps of 6e-8 / h^2, 3e-4."""
    field = GridField(Grid.from_function(Sphere(0.8), 48, uv_mode="none"), "bspline", choice)
    assert lens_error(field, INDEX, np.linspace(0.05, 0.5, 40)) < 1e-3


def test_a_ball_lens_converges_with_the_grid():
    """dn comes from the Hessian of a cubic kernel, of order 2 or better: from 24 to 96 samples at least 16-fold."""
    sizes, b = (24, 48, 96), np.linspace(0.05, 0.5, 100)
    grids = [Grid.from_function(Sphere(0.8), n, uv_mode="none") for n in sizes]
    errors = [lens_error(GridField(grid, "bspline", "numpy"), INDEX, b) for grid in grids]
    order = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert 1.6 < order < 3.2, (order, errors)


def test_refraction_is_that_of_displaced_rays(rng):
    """Into the torus and out of it (or along): the truth states its own error, 3 of which it has."""
    field = ShapeField(shape("torus"))
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
        alone, _ = optics.refracted(xp, incoming.d, c[18:21], c[27])
        return {**components(out), "total": xp.integer(total), **{f"alone{a}": alone[a] for a in range(3)}}

    columns = [*zero.T, *d.T, *zero.T, *zero.T, *dd.T, *zero.T, *n.T, *dn.T, *zero.T, np.broadcast_to(eta, (count,))]
    out = engine.run(program, columns)
    assert np.abs(vectors(out, "alone") - vectors(out, "d")).max() < 4 * engine.eps
    return rays(out), out["total"] > 0


@pytest.mark.parametrize("cosine", [1.0, 0.6])
@pytest.mark.parametrize("sign", [-1, 1], ids=["below", "above"])
def test_an_index_near_one_keeps_its_digits(cosine, sign, choice):
    """mu = c' - eta c, from 1e-1 down to the last digits of eta, against 50 digits: ten roundings, relative.

    A normal that turns out of the plane of incidence by dn shows it alone: dd' = -mu dn.
    """
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
    assert -out.dd_dx[:, 1] == pytest.approx(np.array(exact), rel=10 * choice.engine.eps, abs=0)
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


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0])
def test_a_parallel_slab(degrees, choice):
    """A plate of 16 voxels: the direction and dd come out as they went in; on its far side dp is the closed form's.

    With a and L the ways across air and plate, tan' that of the refracted angle: y = a tan + L tan', so
    dp_dx = a / cos^2 + L cos / (n cos'^3), and across the plane of incidence a / cos + L / (n cos').
    Kernels reproduce planes; rounding of coefficients up to 20 and of ways up to 60: 2000 eps over the cosine.
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
