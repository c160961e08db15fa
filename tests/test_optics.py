"""Transfer and reflection: closed forms, identities, the symplectic form, and faults that they must catch."""

import numpy as np
import pytest

from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfrender import Camera, Flag, GridField, Rays, optics, reflect, transfer
from validate.closed import ExactReference
from validate.exact import ShapeField

EPS = np.finfo(float).eps


def perpendicular(vectors, d):
    return vectors - np.sum(vectors * d, axis=1, keepdims=True) * d


def perturbed(p, d, rng):
    """Rays with four independent perturbations each, as two bundles of two."""
    n = len(p)
    moves = [(perpendicular(rng.normal(size=(n, 3)), d), perpendicular(rng.normal(size=(n, 3)), d)) for _ in range(4)]
    return [Rays(p, d, a[0], b[0], a[1], b[1]) for a, b in (moves[:2], moves[2:])]


def perturbations(bundles):
    """The four (dp, dd) of two bundles, dp taken across the ray, where the form looks."""
    pairs = [(b.dp_dx, b.dd_dx) for b in bundles] + [(b.dp_dy, b.dd_dy) for b in bundles]
    return [(perpendicular(dp, bundles[0].d), dd) for dp, dd in pairs]


def symplectic_defect(before, after):
    """Greatest change of dd_1 . dp_2 - dd_2 . dp_1 over all pairs, relative to the map's gain squared.

    Omega is a number per pair of perturbations and must stay; rounding grows with the squared length of the results.
    """
    start, end = perturbations(before), perturbations(after)
    size = np.max([np.sum(dp * dp + dd * dd, axis=1) for dp, dd in start + end], axis=0)

    def form(moves, i, j):
        (dp_i, dd_i), (dp_j, dd_j) = moves[i], moves[j]
        return np.sum(dd_i * dp_j - dd_j * dp_i, axis=1)

    defects = [np.abs(form(start, i, j) - form(end, i, j)) / size for i in range(4) for j in range(i)]
    return np.max(defects, axis=0)


def mirror_rays(rng, count=300):
    """Rays from before the report's mirror sphere that reach the sheet behind them."""
    aim = rng.uniform(-0.45, 0.45, (count, 3)) * [1, 1, 0] + [0, 0, 0.5]
    p = np.array([0.0, 0.0, 1.9]) + rng.uniform(-0.1, 0.1, (count, 3)) * [1, 1, 0.5]
    d = aim - p
    return p, d / np.linalg.norm(d, axis=1, keepdims=True)


def through_mirror(field, bundles):
    """Transfer, mirror, transfer; the rays that make it, before and after, and what lies between."""
    after, middle, ok = [], [], True
    for rays in bundles:
        hits, at = transfer(field, rays)
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
    rays = perturbed(*mirror_rays(rng), rng)[0]
    hits, at = transfer(field, rays)
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
    move = perpendicular(rng.normal(size=directions.shape), directions)

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


def hollow(choice, n=48):
    """The inside of a ball of radius 0.8 as empty space: a concave mirror all around."""
    ball = Grid.from_function(Sphere(0.8), n, uv_mode="none")
    axis = [
        np.arange(count) * ball.lattice.spacing + ball.lattice.origin[a] for a, count in enumerate(ball.lattice.shape)
    ]
    x, y, z = np.meshgrid(*axis, indexing="ij")
    values = 0.8 - np.sqrt(x * x + y * y + z * z)
    return GridField(
        Grid.from_dense(values, origin=ball.lattice.origin, spacing=ball.lattice.spacing), "bspline", choice
    )


def test_a_concave_mirror_has_a_focus(choice):
    """Near the axis rays that run parallel meet at r / 2; the beam's cross-section vanishes there: CAUSTIC.

    Before the mirror the beam has none. A ray that stops at a surface short of the focus has none either: that is
    tested on the beam itself, at 0.9 and 1.1 of the focal length.
    """
    field = hollow(choice)
    p, d = np.array([[0.05, 0.02, -0.5]]), np.array([[0.0, 0.0, 1.0]])
    width = np.array([[1e-3, 0, 0]]), np.array([[0, 1e-3, 0]])
    rays = Rays(p, d, *width, np.zeros((1, 3)), np.zeros((1, 3)))
    hits, at = transfer(field, rays)
    assert hits.hit.all() and not hits.flags[0] & Flag.CAUSTIC
    out = reflect(field, hits, at)
    again, _ = transfer(field, out, on_surface=True)
    assert again.hit.all() and again.flags[0] & Flag.CAUSTIC
    # The focus: p + t d with dp + t dd = 0, r / 2 from the mirror; spherical aberration of (0.05 / 0.8)^2.
    focus = -np.sum(out.dp_dx * out.dd_dx, axis=1) / np.sum(out.dd_dx**2, axis=1)
    assert focus[0] == pytest.approx(0.4, rel=2e-2)

    def program(xp, *c):
        beam = optics.Beam(*(tuple(c[i : i + 3]) for i in range(0, 18, 3)))
        return {str(share): xp.integer(optics.passes_caustic(xp, beam, share * c[18])) for share in (0.9, 1.1)}

    out = choice.engine.run(program, [*out.columns(), focus])
    assert (out["0.9"].item(), out["1.1"].item()) == (0, 1)


def test_a_diverging_beam_has_no_caustic(choice, sphere):
    field = GridField(Grid.from_function(sphere, 32, uv_mode="none"), "bspline", choice)
    hits, at = transfer(field, Camera((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), size=(16, 16)).rays())
    assert not (hits.flags & Flag.CAUSTIC).any()
    mirrored = reflect(field, hits, at)
    again, _ = transfer(field, mirrored, on_surface=True)
    assert not (again.flags & Flag.CAUSTIC).any()


def test_grazing_footprints_cross_the_horizon(choice):
    """A plane seen at cosine c by pixels of 1e-2 rad: half a pixel of 5e-3 crosses the horizon iff c is below it."""
    x = np.arange(32.0)[:, None, None] + np.zeros((32, 8, 8))
    field = GridField(Grid.from_dense(x - 15.25), "linear", choice)
    cosines = np.array([0.5, 0.1, 0.02, 0.006, 0.004, 0.001])
    sine = np.sqrt(1 - cosines**2)
    d = np.stack([-cosines, sine, 0 * sine], axis=-1)
    across = 1e-2 * np.stack([sine, cosines, 0 * sine], axis=-1)
    p = np.array([15.25, 3.5, 3.5]) - 2.0 * d
    hits, _ = transfer(field, Rays(p, d, 0 * d, 0 * d, across, 0 * d + [0, 0, 1e-2]))
    assert hits.hit.all()
    assert ((hits.flags & Flag.HORIZON) > 0).tolist() == [False, False, False, False, True, True]


def test_an_edge_says_so(choice):
    """A box's edge is where interpolation cannot have a unit gradient; its faces can. Noise is no distance at all."""
    box = shape("box")
    field = GridField(Grid.from_function(box, 40, uv_mode="none"), "bspline", choice)
    low, high = box.bounds
    middle = 0.5 * (low + high)
    edge = np.array([high[0], high[1], middle[2]])
    targets = np.array([edge, [high[0], middle[1], middle[2]], [middle[0], middle[1], high[2]]])
    outward = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    nothing = np.zeros((3, 3))
    rays = Rays(targets + outward, -outward, nothing, nothing, nothing, nothing)
    hits, _ = transfer(field, rays)
    assert hits.hit.all()
    assert ((hits.flags & Flag.EDGE) > 0).tolist() == [True, False, False]
    values = np.random.default_rng(3).normal(size=(9, 9, 9))
    noise = GridField(Grid.from_dense(values), "bspline", choice)
    hits, _ = transfer(
        noise, Rays(np.full((1, 3), 4.0) - [[9, 0, 0]], np.array([[1.0, 0, 0]]), *(nothing[:1] for _ in range(4)))
    )
    assert hits.hit.all() and not hits.flags[0] & Flag.EDGE
