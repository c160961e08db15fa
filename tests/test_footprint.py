"""Footprints: against displaced rays on an exact shape, against NumPy's singular values, by hand."""

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfrender import Camera, Flag, Footprint, Hits, Rays, footprint, nonlinear, nonlinearity, reflect, transfer
from sdfrender.field import Mapped
from sdfrender.footprint import NONLINEAR_LIMIT, derivatives, ellipse, invariant_level, level_of_detail
from sdfrender.rays import Beam
from validate.displaced import richardson
from validate.exact import ShapeField

SIZE = (640, 200)
TORUS = (shape("torus"), Camera((0.3, 1.9, 2.3), (0.0, 0.0, 0.0), fov=42.0, size=(24, 24)))
MIRROR = (shape("mirror"), Camera((0.0, 0.0, 1.9), (0.0, 0.0, 0.0), fov=40.0, size=(24, 24)))


def moved(camera, dx, dy):
    """Rays of the pixels shifted by a part of a pixel, without differentials."""
    view, right, down = camera.frame()
    row, column = np.mgrid[0:24, 0:24]
    d = view + (column.ravel()[:, None] + 0.5 + dx - 12) * right + (row.ravel()[:, None] + 0.5 + dy - 12) * down
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    return Rays(np.broadcast_to(camera.position, d.shape), d, *(np.zeros_like(d) for _ in range(4)))


def through(field, rays, bounces):
    """Follow rays over mirrors to a last hit and its footprint."""
    hits, rays = transfer(field, rays)
    alive = hits.hit
    for _ in range(bounces):
        hits, rays = transfer(field, reflect(field, hits, rays), on_surface=True)
        alive = alive & hits.hit
    return alive, hits, footprint(field, hits, rays, size=SIZE)


@pytest.mark.parametrize(("scene", "bounces"), [(TORUS, 0), (MIRROR, 1)], ids=["torus", "mirror"])
def test_duv_is_that_of_displaced_rays(scene, bounces):
    """On the exact torus directly, on the sheet after a mirror; the truth states its own error, 3 of which it has."""
    exact, camera = scene
    field = ShapeField(exact)
    alive, hits, seen = through(field, camera.rays(), bounces)

    def displaced(dx, dy):
        met, _, there = through(field, moved(camera, dx, dy), bounces)
        wrapped = there.uv - np.round(there.uv - seen.uv)  # u and v go around the torus
        return np.where(met[:, None], wrapped, np.nan)

    truth = richardson(displaced, step=0.02)
    clear = alive & ((hits.flags & Flag.HORIZON) == 0)
    clear &= (truth.error_dx < 1e-5).all(axis=1) & (truth.error_dy < 1e-5).all(axis=1)
    assert clear.sum() > 100
    # Rounding of uv, 1e-15 of values up to 1, over half the step, and the roots of the closed form, 1e-14.
    for ours, theirs, error in ((seen.duv_dx, truth.d_dx, truth.error_dx), (seen.duv_dy, truth.d_dy, truth.error_dy)):
        assert (np.abs(ours - theirs) <= 3 * error + 1e-10)[clear].all()
    assert np.abs(seen.duv_dx[clear]).max() > 1e-2


@pytest.fixture
def jacobians(rng):
    return rng.normal(size=(2, 300, 2)) * 10.0 ** rng.uniform(-6, 2, (1, 300, 1))


def levels(engine, dx, dy, size=SIZE):
    def program(xp, a, b, c, d):
        texels = (xp.uniform(float(size[0])), xp.uniform(float(size[1])))
        return {"lod": level_of_detail(xp, (a, b), (c, d), texels), "inv": invariant_level(xp, (a, b), (c, d), texels)}

    out = engine.run(program, [*dx.T, *dy.T])
    return out["lod"], out["inv"]


def test_level_of_detail_by_its_equation(jacobians, choice):
    """Eq. 25: the longer of the two derivatives in texels. A few roundings, and half a unit of a logarithm of 30."""
    dx, dy = jacobians
    lod, _ = levels(choice.engine, dx, dy)
    lengths = np.linalg.norm(jacobians * SIZE, axis=-1)
    assert np.abs(lod - np.log2(lengths.max(axis=0))).max() < 64 * choice.engine.eps
    # By hand: 1/640 of u is one texel, level 0; 4 texels of v against 2 of u, level 2.
    by_hand, _ = levels(choice.engine, np.array([[1 / 640, 0], [2 / 640, 0]]), np.array([[0, 0], [0, 4 / 200]]))
    assert by_hand == pytest.approx([0.0, 2.0], abs=8 * choice.engine.eps)


def test_invariant_level_is_the_largest_singular_value(jacobians, choice):
    dx, dy = jacobians
    _, invariant = levels(choice.engine, dx, dy)
    values = np.linalg.svd(np.stack([dx, dy], axis=-1) * np.array(SIZE)[:, None], compute_uv=False)
    assert np.abs(invariant - np.log2(values[:, 0])).max() < 64 * choice.engine.eps


@pytest.mark.parametrize("angle", [0.3, np.pi / 4, 2.0])
def test_turning_the_pixel_axes_leaves_the_invariant_level(jacobians, choice, angle):
    """The report's level changes by up to half a level; a footprint of equal and perpendicular axes by none."""
    dx, dy = jacobians
    c, s = np.cos(angle), np.sin(angle)
    (lod, invariant), (turned_lod, turned) = (
        levels(choice.engine, a, b) for a, b in ((dx, dy), (c * dx + s * dy, c * dy - s * dx))
    )
    assert np.abs(invariant - turned).max() < 64 * choice.engine.eps
    assert 0.1 < np.abs(lod - turned_lod).max() <= 0.5 + 64 * choice.engine.eps
    assert (lod <= invariant + 64 * choice.engine.eps).all()


def test_a_footprint_of_no_extent_has_a_level(choice):
    nothing = np.zeros((3, 2))
    lod, invariant = levels(choice.engine, nothing, nothing)
    assert np.isfinite(lod).all() and np.isfinite(invariant).all() and (lod < -50).all()


def test_ellipse_is_the_image_of_the_circle(jacobians):
    """Points of the unit circle of pixels land on the ellipse: (along / major)^2 + (across / minor)^2 = 1."""
    dx, dy = jacobians
    major, minor, angle = ellipse(dx, dy, SIZE)
    values = np.linalg.svd(np.stack([dx, dy], axis=-1) * np.array(SIZE)[:, None], compute_uv=False)
    assert major == pytest.approx(values[:, 0], rel=1e-14) and minor == pytest.approx(values[:, 1], rel=1e-9)
    assert (np.abs(angle) <= np.pi / 2).all()
    fat = minor > 1e-3 * major
    assert fat.mean() > 0.9
    for turn in np.linspace(0, 2 * np.pi, 9):
        point = (np.cos(turn) * dx + np.sin(turn) * dy) * SIZE
        along = np.cos(angle) * point[:, 0] + np.sin(angle) * point[:, 1]
        across = np.cos(angle) * point[:, 1] - np.sin(angle) * point[:, 0]
        # The thinnest has an axis ratio of 1e3, which magnifies rounding; squared, twice.
        assert ((along / major) ** 2 + (across / minor) ** 2)[fat] == pytest.approx(1, abs=1e-9)


def test_ellipse_by_hand():
    major, minor, angle = ellipse(np.array([[0.0, 0.5], [0.1, 0.1]]), np.array([[0.1, 0.0], [-0.05, 0.05]]), (10, 10))
    assert major == pytest.approx([5, np.sqrt(2)], rel=1e-14)
    assert minor == pytest.approx([1, np.sqrt(0.5)], rel=1e-14)
    assert np.abs(angle) == pytest.approx([np.pi / 2, np.pi / 4], rel=1e-14) and angle[1] > 0


def test_what_points_along_the_normal_has_no_part(choice, rng):
    """A texture gradient's share along the normal does not show: displacements lie in the tangent plane."""
    n = np.array([0.0, 0.6, 0.8])
    tangent = rng.normal(size=(50, 3))
    tangent -= np.outer(tangent @ n, n)
    gradient = rng.normal(size=(50, 3))

    def program(xp, *c):
        dp, du, along = c[0:3], c[3:6], c[6:9]
        more = tuple(a + b for a, b in zip(du, along, strict=True))
        zero = xp.full(c[0], 0.0)
        beam = Beam(dp, dp, dp, dp, dp, dp)
        (a, _), _ = derivatives(Mapped(zero, zero, du, du, zero, zero), beam)
        (b, _), _ = derivatives(Mapped(zero, zero, more, more, zero, zero), beam)
        return {"a": a, "b": b}

    out = choice.engine.run(program, [*tangent.T, *gradient.T, *np.outer(rng.normal(size=50) * 3, n).T])
    assert np.abs(out["a"] - out["b"]).max() < 256 * choice.engine.eps
    assert np.abs(out["a"] - np.sum(tangent * gradient, axis=1)).max() < 64 * choice.engine.eps


def test_misses_have_no_footprint():
    field = ShapeField(shape("torus"))
    rays = moved(TORUS[1], 0, 0).where(np.arange(2))
    hits, after = transfer(field, Rays(rays.p, -rays.d, *(np.ones((2, 3)) for _ in range(4))))
    seen = footprint(field, hits, after)
    assert isinstance(hits, Hits) and isinstance(seen, Footprint)
    assert not seen.uv.any() and not seen.duv_dx.any() and not seen.lod.any() and (seen.chart == -1).all()
    assert (seen.flags == Flag.MISS).all()


def growing(rate, height=5, width=7):
    """Footprints that grow by e^rate from column to column, on one chart."""
    size = np.exp(rate * np.arange(width))
    jacobian = np.array([[1.0, 0.3], [-0.2, 2.0]]) * size[:, None, None]
    whole = np.ones((height, width), bool)
    return np.broadcast_to(jacobian, (height, width, 2, 2)).copy(), whole, np.zeros((height, width), int)


@pytest.mark.parametrize("turned", [False, True], ids=["columns", "rows"])
def test_nonlinearity_is_the_change_to_the_next_pixel(turned):
    """e^0.1 - 1 upward, 1 - e^-0.1 from the last column back; whatever the unit, along either axis."""
    for unit in (1.0, 1e-6):
        jacobian, hit, chart = growing(0.1)
        if turned:
            jacobian, hit, chart = jacobian.swapaxes(0, 1), hit.T, chart.T
        share = nonlinearity(unit * jacobian, hit, chart)
        share = share.T if turned else share
        assert share[:, :-1] == pytest.approx(np.expm1(0.1), rel=1e-13)
        assert share[:, -1] == pytest.approx(-np.expm1(-0.1), rel=1e-13)


def test_linear_footprints_are_linear():
    """Equal ones have a share of 0; a single one has nothing to be compared with."""
    assert not nonlinearity(*growing(0.0)).any()
    assert nonlinearity(*growing(3.0, 1, 1)).tolist() == [[0.0]]


def test_other_charts_and_misses_are_not_compared():
    """A column on a chart of its own, a pixel that hit nothing with nonsense in it: neither counts, for nobody."""
    jacobian, hit, chart = growing(0.0)
    jacobian[:, 3] *= 50
    chart[:, 3] = 1
    jacobian[2, 0], hit[2, 0] = 1e9, False
    assert not nonlinearity(jacobian, hit, chart).any()
    chart[:, 3] = 0
    share = nonlinearity(jacobian, hit, chart)
    assert share[0].tolist() == pytest.approx([0, 0, 49, 0.98, 49, 0, 0], rel=1e-13)


def test_the_flag_is_half_a_level():
    """Growth by 2 - sqrt(2) of itself per pixel is 1 - 1/sqrt(2) within half a one: a level off by 1/2 at its side."""
    assert np.log2(1 - NONLINEAR_LIMIT / 2) == pytest.approx(-0.5, rel=1e-14)
    for rate, flag in ((np.log1p(0.99 * NONLINEAR_LIMIT), 0), (np.log1p(1.01 * NONLINEAR_LIMIT), Flag.NONLINEAR)):
        assert (nonlinear(nonlinearity(*growing(rate)))[:, :-1] == flag).all()


def test_a_footprint_of_no_extent_is_not_linear_beside_one():
    jacobian, hit, chart = growing(0.0)
    jacobian[2, 2] = 0
    share = nonlinearity(jacobian, hit, chart)
    assert np.isfinite(share).all() and share[2, 2] > 1e15 and share[2, 3] == 1


def test_nonlinearity_halves_with_the_pixels():
    """The torus' footprints change smoothly: half the pixel, half the share, away from its silhouette."""
    field, shares = ShapeField(TORUS[0]), []
    for size in (48, 96):
        rays = Camera((0.3, 1.9, 2.3), (0.0, 0.0, 0.0), fov=42.0, size=(size, size)).rays()
        hits, at = transfer(field, rays)
        seen = footprint(field, hits, at)
        image = np.stack([seen.duv_dx, seen.duv_dy], axis=-1).reshape(size, size, 2, 2)
        hit = hits.hit.reshape(size, size)
        share = nonlinearity(image, hit, seen.chart.reshape(size, size))
        shares.append(np.median(share[hit]))
    assert 1.7 < shares[0] / shares[1] < 2.3, shares
