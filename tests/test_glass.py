"""Glass bodies: total reflection, a lens' focus, Fresnel's shares, solids within and against each other."""

import numpy as np
import pytest
from beams import INDEX, crossed, perturbed

from datasets_synthetic.sphere import Sphere
from datasets_synthetic.union import Union
from sdfbake import Grid
from sdfrender import Flag, GridField, Rays, fresnel, leaving, optics, reflect, refract, transfer
from validate.exact import ShapeField


def ball(choice, n=32):
    return GridField(Grid.from_function(Sphere(0.8), n, uv_mode="none"), "bspline", choice)


def test_total_reflection_is_a_mirror(choice, rng):
    """From inside a ball: TIR where n sin >= 1, there the mirrored ray, all light in it; the flag stays."""
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


@pytest.mark.parametrize(("front", "seen"), [(-1.0, False), (-1.5, True)], ids=["before focus", "behind focus"])
def test_a_lens_has_a_focus(front, seen):
    """A ball of index 3/2 focuses r / 2 behind it, at -1.2: a wall behind that is reached through a CAUSTIC, not one
    before it; neither is the way in, through the glass, nor back from the wall, a mirror that spreads."""
    wall = Sphere(0.3, (0.0, 0.0, front - 0.3), ("wall",))
    field = ShapeField(Union((Sphere(0.8), wall), ("lens", "wall")))
    p, d, zero = np.array([[0.05, 0.02, 2.0]]), np.array([[0.0, 0.0, -1.0]]), np.zeros((1, 3))
    hits, _, inner, _ = crossed(field, Rays(p, d, np.array([[1e-3, 0, 0]]), np.array([[0, 1e-3, 0]]), zero, zero))
    again, _, out, _ = crossed(field, inner, on_surface=True)
    last, at = transfer(field, out, on_surface=True)
    assert [h.part[0] for h in (hits, again, last)] == [0, 0, 1]
    assert not (hits.flags | again.flags)[0] & Flag.CAUSTIC
    assert bool(last.flags[0] & Flag.CAUSTIC) == seen == bool(at.flags[0] & Flag.CAUSTIC)
    back, _ = transfer(field, reflect(field, last, at), on_surface=True)
    assert back.hit[0] and not back.flags[0] & Flag.CAUSTIC


def test_an_empty_shell_bends_by_both_its_spheres():
    """Nested: glass from 0.8 down to 0.5, air within. n b is kept (Bouguer): the ray leaves at the height it came in,
    turned by both spheres: 2 [(asin b/R - asin b/nR) - (asin b/r - asin b/nr)]. 64 samples: 1e-3, the kernel's."""
    axis = np.linspace(-1.0, 1.0, 64)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    r = np.sqrt(x * x + y * y + z * z)
    grid = Grid.from_dense(np.maximum(r - 0.8, 0.5 - r), origin=[-1.0] * 3, spacing=float(axis[1] - axis[0]))
    field = GridField(grid, "bspline", "numpy")
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
    field = ShapeField(Union(balls, ("one", "other")))
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
    assert mirrored[0] + passed[0] == pytest.approx(1) and mirrored[1] == passed[1] == 0


@pytest.mark.parametrize(
    "eta", [0.0, -1.5, np.nan, np.inf, np.ones(3)], ids=["zero", "negative", "nan", "inf", "shape"]
)
def test_bad_eta(eta):
    field = ShapeField(Sphere(0.8))
    p = np.array([[2.0, 0, 0]])
    hits, at = transfer(field, Rays(p, -0.5 * p, *(np.zeros((1, 3)) for _ in range(4))))
    with pytest.raises(ValueError, match="eta"):
        refract(field, hits, at, eta=eta)


def test_flags_and_rays_must_match():
    with pytest.raises((ValueError, TypeError), match="flags"):  # the tests' type checks come first
        Rays(*(np.zeros((2, 3)) for _ in range(6)), np.zeros(3, np.int32))


def shares(choice, cosine, eta):
    """Reflectance of rays at a plane, from outside."""
    d = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, -cosine], axis=1)

    def program(xp, *c):
        zero = xp.full(c[0], 0.0)
        return {"r": optics.reflectance(xp, (c[0], c[1], c[2]), (zero, zero, zero + 1.0), c[3])}

    return choice.engine.run(program, [*d.T, np.broadcast_to(eta, cosine.shape)])["r"].astype(float)


@pytest.mark.parametrize("eta", [1 / 1.5, 1 / 1.1, 0.4, 1.2])
def test_fresnel_by_angles(eta, choice):
    """(sin^2(i - t) / sin^2(i + t) + tan^2(i - t) / tan^2(i + t)) / 2, as Fresnel has it; the same from either side."""
    incident = np.radians(np.linspace(1.0, min(85.0, np.degrees(np.arcsin(min(1.0, 1 / eta))) - 2), 40))
    refracted = np.arcsin(eta * np.sin(incident))
    less, more = incident - refracted, incident + refracted
    expected = 0.5 * ((np.sin(less) / np.sin(more)) ** 2 + (np.tan(less) / np.tan(more)) ** 2)
    # c'^2 is a difference of numbers up to 5.3, 3 roundings of half an eps: 45 eps in c' >= 0.087; dR/dc' is below 6.
    limit = 400 * choice.engine.eps
    assert shares(choice, np.cos(incident), eta) == pytest.approx(expected, abs=limit)
    assert shares(choice, np.cos(refracted), 1 / eta) == pytest.approx(expected, abs=limit)


def test_fresnel_at_its_marks(choice):
    """Normal incidence ((1 - eta) / (1 + eta))^2, to rounding even near 1; nothing of p at Brewster's angle; all of the
    light at grazing incidence and beyond the critical angle, none at equal indices."""
    eta = 1 - 10.0 ** -np.arange(1.0, 6.0)
    held = eta.astype(np.float32 if choice.engine.precision == 32 else np.float64).astype(float)
    normal = shares(choice, np.ones(5), eta)
    assert normal == pytest.approx(((1 - held) / (1 + held)) ** 2, rel=32 * choice.engine.eps, abs=0)
    brewster = np.array([1 / np.sqrt(1 + INDEX**2)])
    sine, cosine = 1 / np.sqrt(1 + INDEX**2), INDEX / np.sqrt(1 + INDEX**2)  # of the refracted angle
    s_only = 0.5 * ((brewster[0] - INDEX * cosine) / (brewster[0] + INDEX * cosine)) ** 2
    assert sine == pytest.approx(np.sqrt(1 - cosine**2))
    assert shares(choice, brewster, 1 / INDEX) == pytest.approx(s_only, rel=64 * choice.engine.eps)
    at, eta = np.array([0.0, 0.5, 0.0, 0.3]), np.array([1 / INDEX, INDEX, 1.0, 1.0])
    assert shares(choice, at, eta) == pytest.approx([1, 1, 1, 0], abs=8 * choice.engine.eps)
