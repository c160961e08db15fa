"""Transfer and reflection: closed forms, identities, the symplectic form, and faults that they must catch."""

import numpy as np
import pytest
from beams import perturbed

from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from datasets_synthetic.union import Union
from sdfbake import Grid
from sdfrender import GridField, Rays, optics, reflect, transfer
from sdfrender.field import Jet
from sdfrender.rays import beam, components, rays
from sdfrender.vector import Symmetric
from validate.closed import ExactReference
from validate.exact import ShapeField
from validate.identities import across, symplectic_defect

EPS = np.finfo(float).eps


def mirror_rays(rng, count=300):
    """Rays from before the report's mirror sphere that reach the sheet behind them."""
    aim = rng.uniform(-0.45, 0.45, (count, 3)) * [1, 1, 0] + [0, 0, 0.5]
    p = np.array([0.0, 0.0, 1.9]) + rng.uniform(-0.1, 0.1, (count, 3)) * [1, 1, 0.5]
    d = aim - p
    return p, d / np.linalg.norm(d, axis=1, keepdims=True)


def through_mirror(field, bundles):
    """Transfer, mirror, transfer; the rays that make it, before and after, and what lies between."""
    after, middle, ok = [], [], True
    for bundle in bundles:
        hits, at = transfer(field, bundle)
        out = reflect(field, hits, at)
        again, end = transfer(field, out, on_surface=True)
        ok = ok & hits.hit & again.hit
        middle.append((hits, at, out, again))
        after.append(end)
    rows = np.flatnonzero(ok)
    return [b.where(rows) for b in bundles], [a.where(rows) for a in after], middle, rows


@pytest.fixture(params=["exact", "bspline", "catmull-rom"])
def field(request):
    """The report's scene, exact and as grids: the identities hold for the interpolant as for the shape."""
    exact = shape("mirror")
    if request.param == "exact":
        return ShapeField(exact)
    return GridField(Grid.from_function(exact, 48, uv_mode="none"), request.param, "numpy")


def test_the_form_is_kept_on_the_whole_way(field, rng):
    bundles = perturbed(*mirror_rays(rng), rng)
    before, after, _, rows = through_mirror(field, bundles)
    assert len(rows) > 80
    defect = symplectic_defect(before, after)
    assert defect.max() <= 1e-12, defect.max()


def test_a_wrong_curvature_keeps_the_form_but_not_the_closed_one(rng, monkeypatch):
    """Curvature times 3 is the curvature of another mirror, which is as symplectic; the closed form sees it."""
    field, bundles = ShapeField(shape("mirror")), perturbed(*mirror_rays(rng), rng)
    reference = ExactReference(shape("mirror"))
    closed = reference.reflect(*reference.transfer(bundles[0]))

    def error():
        before, after, middle, rows = through_mirror(field, bundles)
        assert symplectic_defect(before, after).max() <= 1e-12
        wrong = np.linalg.norm(middle[0][2].dd_dx - closed.dd_dx, axis=1)[rows]
        return wrong / np.linalg.norm(closed.dd_dx, axis=1)[rows]

    assert error().max() < 1e-9
    right = optics.normal_differential
    monkeypatch.setattr(optics, "normal_differential", lambda *a: optics.scale(right(*a), 3.0))
    assert np.median(error()) > 0.1


@pytest.mark.parametrize("fault", ["no dt", "no d.dn", "asymmetric"])
def test_faults_break_the_form(fault, rng, monkeypatch):
    """A transfer without dt_dx (the report's table lacks it), a mirror that forgets a term, a skew Hessian.

    The form is blind to terms along the normal, as n . dp = 0; d . dd = 0 is not.
    """
    if fault == "no dt":

        def straight(xp, beam, jet, p, t):
            dp = [
                tuple(a + t * b for a, b in zip(*pair, strict=True))
                for pair in ((beam.dp_dx, beam.dd_dx), (beam.dp_dy, beam.dd_dy))
            ]
            return beam._replace(p=p, dp_dx=dp[0], dp_dy=dp[1])

        monkeypatch.setattr(optics, "transfer", straight)
    elif fault == "no d.dn":

        def forgetful(beam, n, dn_dx, dn_dy):
            def mirrored(dd, dn):
                change = optics.dot(dd, n)
                bent = optics.add(optics.scale(dn, 2.0 * optics.dot(beam.d, n)), optics.scale(n, 2.0 * change))
                return optics.subtract(dd, bent)

            d = optics.reflected(beam.d, n)
            return beam._replace(d=d, dd_dx=mirrored(beam.dd_dx, dn_dx), dd_dy=mirrored(beam.dd_dy, dn_dy))

        monkeypatch.setattr(optics, "reflect", forgetful)
    else:

        def skew(xp, jet, n, dp):
            turned = optics.cross(n, dp)
            return optics.add(optics.scale(dp, 1.0), optics.scale(turned, 0.3))

        monkeypatch.setattr(optics, "normal_differential", skew)
    before, after, middle, rows = through_mirror(ShapeField(shape("mirror")), perturbed(*mirror_rays(rng), rng))
    if fault == "no d.dn":
        out = middle[0][2].where(rows)
        assert np.median(np.abs(np.sum(out.d * out.dd_dx, axis=1))) > 1e-3
        return
    assert np.median(symplectic_defect(before, after)) > 1e-6


def test_identities_at_every_step(field, rng):
    """n.n = 1, d.d = 1, n.dp = 0 on the surface, d.dd = 0 before and after: a dozen roundings each, of the lengths."""
    hits, at = transfer(field, perturbed(*mirror_rays(rng), rng)[0])
    out = reflect(field, hits, at)
    again, end = transfer(field, out, on_surface=True)
    for h, moved in ((hits, at), (again, end)):
        on = h.hit
        assert np.abs(np.linalg.norm(h.n[on], axis=1) - 1).max() < 4 * EPS
        for dp in (moved.dp_dx[on], moved.dp_dy[on]):
            slope = np.abs(np.sum(h.n[on] * moved.d[on], axis=1))
            length = np.linalg.norm(dp, axis=1)
            assert (np.abs(np.sum(h.n[on] * dp, axis=1)) < 64 * EPS * length / slope).all()
    for r in (at, out):
        assert np.abs(np.linalg.norm(r.d, axis=1) - 1).max() < 16 * EPS
        for dd in (r.dd_dx, r.dd_dy):
            size = np.linalg.norm(dd, axis=1) + np.linalg.norm(r.dp_dx, axis=1) + np.linalg.norm(r.dp_dy, axis=1)
            assert (np.abs(np.sum(r.d * dd, axis=1)) < 512 * EPS * (size + 1)).all()


def test_normals_turn_across_themselves(choice, sphere, directions, rng):
    """n . dn = 0, and on the sphere dn = dp / r for dp along the surface."""
    field = (
        ShapeField(sphere)
        if choice.engine.precision == 64
        else GridField(Grid.from_function(sphere, 64, uv_mode="none"), "bspline", choice)
    )
    move = across(rng.normal(size=directions.shape), directions)

    def program(xp, *c):
        spot = field.locate(xp, (c[0], c[1], c[2]), xp.full(c[0], True))
        jet = field.jet_at(xp, spot, 2)
        n = optics.normal(xp, jet)
        dn = optics.normal_differential(xp, jet, n, (c[3], c[4], c[5]))
        return {**{f"n{a}": n[a] for a in range(3)}, **{f"dn{a}": dn[a] for a in range(3)}}

    out = field.engine.run(program, [*(0.8 * directions - field.anchor).T, *move.T])
    n, dn = (np.stack([out[f"{name}{a}"] for a in range(3)], axis=-1).astype(float) for name in ("n", "dn"))
    size = np.linalg.norm(dn, axis=1)
    assert np.abs(np.linalg.norm(n, axis=1) - 1).max() < 4 * field.engine.eps
    assert (np.abs(np.sum(n * dn, axis=1)) < 64 * field.engine.eps * size).all()
    limit = 1e-13 if isinstance(field, ShapeField) else 2e-2  # the kernel's own error of curvature, and float32's
    assert np.median(np.linalg.norm(dn - move / 0.8, axis=1) / size) < limit


@pytest.mark.parametrize("cosine", [1.0, 0.5, 1e-1, 1e-2, 1e-4])
def test_a_plane_stretches_by_the_cosine(cosine, choice):
    """The footprint of dd across the plane's line of sight is t / cos; along the horizon it is t. Exact in the plane.

    The plane x = 0.25 is a grid that every kernel reproduces. Relative error: the gradient's rounding, 100 units in
    the last place of the coefficients (8 at most, slope 1), over the cosine.
    """
    x = np.arange(16.0)[:, None, None] + np.zeros((16, 16, 16))
    field = GridField(Grid.from_dense(x - 7.25), "bspline", choice)
    sine = np.sqrt(1 - cosine * cosine)
    d = np.array([[-cosine, sine, 0.0]])
    across, along = np.array([[sine, cosine, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    far = min(3.0, 1.0 / cosine)
    p = np.array([[7.25, 7.5, 7.5]]) - far * d
    hits, moved = transfer(field, Rays(p, d, np.zeros((1, 3)), np.zeros((1, 3)), 1e-3 * across, 1e-3 * along))
    rounding = 800 * choice.engine.eps / cosine
    if rounding > 0.1:
        return  # float32 has no digits of the cosine left
    assert hits.t[0] == pytest.approx(far, abs=rounding * far)
    assert np.linalg.norm(moved.dp_dx[0]) == pytest.approx(1e-3 * far / cosine, rel=rounding)
    assert np.linalg.norm(moved.dp_dy[0]) == pytest.approx(1e-3 * far, rel=rounding)
    assert abs(moved.dp_dx[0, 0]) < 1e-3 * far * rounding / cosine


def test_a_sphere_by_its_closed_form(sphere, directions, rng):
    """Transfer and reflection against code that shares nothing with them: Igehy's equations with H = (I - n n^T) / r.

    Rays at slopes above 0.05: conditions of 1 / slope^2 at 1e-16 leave 1e-12.
    """
    p = 3 * directions + 0.3 * rng.normal(size=directions.shape)
    d = -p + 0.5 * rng.normal(size=p.shape)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    rays = perturbed(p, d, rng)[0]
    field, reference = ShapeField(sphere), ExactReference(sphere)
    hits, at = transfer(field, rays)
    out = reflect(field, hits, at)
    truth, moved = reference.transfer(rays)
    closed = reference.reflect(truth, moved)
    assert np.array_equal(hits.hit, truth.hit)
    clear = hits.hit & (np.abs(np.sum(hits.n * d, axis=1)) > 0.05)
    assert clear.sum() > 500
    for name, ours, theirs in (
        ("dp_dx", at, moved),
        ("dp_dy", at, moved),
        ("dd_dx", out, closed),
        ("dd_dy", out, closed),
    ):
        a, b = getattr(ours, name)[clear], getattr(theirs, name)[clear]
        assert (np.linalg.norm(a - b, axis=1) / np.linalg.norm(b, axis=1)).max() < 1e-11
    assert np.abs(out.d - closed.d)[clear].max() < 1e-12


BOUNCES, GAP = 60, 0.5  # between two balls of radius 1 that face each other: an unstable resonator
STARTS = np.array([[1e-3, 0.0], [0.0, 2e-3]])  # (dp, dd) in the two planes through the axis
STEP = np.array([[1, 0], [2, 1]]) @ np.array([[1, GAP], [0, 1]])  # transfer, then mirror: gain 2.618
ENDS = [np.linalg.matrix_power(STEP, BOUNCES) @ start for start in STARTS]


def axial(start_x, start_y):
    """A ray along z with a beam around it, one plane each."""
    zero, (px, qx), (py, qy) = np.zeros((1, 3)), start_x, start_y
    moves = [np.array([v]) for v in ([px, 0, 0], [0, py, 0], [qx, 0, 0], [0, qy, 0])]
    return Rays(zero, np.array([[0.0, 0.0, 1.0]]), *moves)


def grown(out, eps):
    """Check a beam after all bounces. All entries of the matrix are positive: nothing cancels, 8 roundings a step."""
    limit = 8 * BOUNCES * eps
    assert ENDS[0][0] > 1e21
    assert [out.dp_dx[0, 0], out.dd_dx[0, 0]] == pytest.approx(list(ENDS[0]), rel=limit)
    assert [out.dp_dy[0, 1], out.dd_dy[0, 1]] == pytest.approx(list(ENDS[1]), rel=limit)


def test_facing_mirrors_grow_by_their_matrix(choice):
    """(dp, dd) by the matrix. The beam reaches 1e22 and its square passes float32: no overflow, and no caustic, as it
    spreads."""

    def bounce(xp, *c):
        thin, zero, one = beam(c[:18]), xp.full(c[0], 0.0), xp.full(c[0], 1.0)
        none, n = (zero, zero, zero), (zero, zero, -thin.d[2])
        jet = Jet(zero, n, Symmetric(one, one, zero, zero, zero, zero))
        at = optics.transfer(xp, thin, jet, none, c[18])
        turns = [optics.normal_differential(xp, jet, n, dp) for dp in (at.dp_dx, at.dp_dy)]
        out = components(optics.reflect(at, n, *turns))
        return {**out, "caustic": xp.integer(optics.passes_caustic(xp, thin, c[18]))}

    bundle = axial(*STARTS)
    for _ in range(BOUNCES):
        named = choice.engine.run(bounce, [*bundle.columns(), np.array([GAP])])
        assert not named["caustic"].any()
        bundle = rays(named)
    grown(bundle, choice.engine.eps)


def test_facing_balls_grow_by_their_matrix():
    """The same along the axis of two exact balls, where symmetry keeps the ray: hit by hit, through `transfer`."""
    balls = (Sphere(1.0, (0.0, 0.0, 1.0 + GAP)), Sphere(1.0, (0.0, 0.0, -1.0)))
    field, bundle = ShapeField(Union(balls, ("far", "near"))), axial(*STARTS)
    for number in range(BOUNCES):
        hits, at = transfer(field, bundle, on_surface=number > 0)
        assert hits.t[0] == pytest.approx(GAP, rel=4 * EPS) and not hits.flags[0]
        bundle = reflect(field, hits, at)
    grown(bundle, EPS)
