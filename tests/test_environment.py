"""Light from all around: where directions lie, their derivatives, and means by solid angle at poles and seams."""

import numpy as np
import pytest

from sdfbake.complaint import BadInput
from sdfbake.engine import choose
from sdfrender.environment import Environment, by_solid_angle
from sdfrender.latlong import angle, footprint, place

AXES = [(0, 0, -1), (1, 0, 0), (0, 0, 1), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (-0.0, 0, 1)]


def centres(height, width):
    """Directions (h, w, 3) of the texels' centres."""
    latitude = np.pi / 2 - (np.arange(height) + 0.5)[:, None] * np.pi / height
    longitude = ((np.arange(width) + 0.5) / width - 0.5)[None, :] * 2 * np.pi
    x, z = np.cos(latitude) * np.sin(longitude), -np.cos(latitude) * np.cos(longitude)
    return np.stack([x, np.sin(latitude) + 0 * longitude, z], axis=-1)


def tangents(d, rng=None):
    """Two unit vectors across directions, turned at random."""
    helper = np.where(np.abs(d[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 0, 1.0]])
    a = np.cross(d, helper)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(d, a)
    turn = np.zeros((len(d), 1)) if rng is None else rng.uniform(0, np.pi, (len(d), 1))
    return np.cos(turn) * a + np.sin(turn) * b, np.cos(turn) * b - np.sin(turn) * a


def look(engine, image, d, wide=None, filtering="anisotropic", rng=None):
    """Radiance (n, 3) and the capped mask, for round footprints of so many radians per pixel."""
    environment = Environment(engine, np.asarray(image, np.float32), filtering)
    d = np.asarray(d, float)
    across = np.stack(tangents(d, rng), axis=0) * np.reshape(0.0 if wide is None else wide, (-1, 1))

    def program(xp, *c):
        found = environment.look_up(xp, c[:3], (c[3:6], c[6:9]), xp.full(c[0], True))
        return {**dict(zip("rgb", found.colour, strict=True)), "capped": xp.integer(found.capped)}

    out = engine.run(program, [np.ascontiguousarray(column) for column in (*d.T, *across[0].T, *across[1].T)])
    return np.stack([out[c] for c in "rgb"], axis=-1).astype(float), out["capped"].astype(bool)


def test_angles(choice, rng):
    y, x = rng.normal(size=(2, 5000)) * 10.0 ** rng.uniform(-6, 6, (2, 5000))
    y[:4], x[:4] = [0, 0, 1, -1], [1, -1, 0, 0]
    got = choice.engine.run(lambda xp, y, x: {"angle": angle(xp, y, x)}, [y, x])["angle"]
    kind = np.float32 if choice.engine.precision == 32 else np.float64
    exact = np.arctan2(y.astype(kind).astype(float), x.astype(kind).astype(float))
    # A ratio, two halvings, a series, two differences from multiples of pi: a dozen roundings of up to pi.
    assert np.abs(got - exact).max() < 12 * choice.engine.eps


def test_where_directions_lie(choice):
    """-z is the middle, x a quarter to the right, z the seam, y the top."""

    def program(xp, *d):
        return dict(zip("uv", place(xp, d), strict=True))

    out = choice.engine.run(program, list(np.array(AXES, float).T))
    assert out["u"] == pytest.approx([0.5, 0.75, 1, 0.25, 0.5, 0.5, 1], abs=4 * choice.engine.eps)
    assert out["v"] == pytest.approx([0.5, 0.5, 0.5, 0.5, 1, 0, 0.5], abs=4 * choice.engine.eps)


def test_derivatives_by_differences(rng):
    """Richardson's central differences of NumPy's own angles."""
    d = rng.normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    dx, dy = (t * rng.uniform(0.01, 0.2, (500, 1)) for t in tangents(d, rng))

    def program(xp, *c):
        turn = footprint(xp, c[:3], c[3:6], c[6:9])
        names = ("ux", "vx", "uy", "vy")
        return {**dict(zip(names, (*turn.duv_dx, *turn.duv_dy), strict=True)), "cut": xp.integer(turn.cut)}

    out = choose("numpy", 64).engine.run(program, [*d.T, *dx.T, *dy.T])
    whole = out["cut"] == 0
    assert whole.mean() > 0.9

    def at(p):
        return np.stack(
            [np.arctan2(p[:, 0], -p[:, 2]) / (2 * np.pi), np.arctan2(p[:, 1], np.hypot(p[:, 0], p[:, 2])) / np.pi]
        )

    def difference(step, way):
        delta = at(d + step * way) - at(d - step * way)
        return (delta - np.array([[1.0], [0]]) * np.round(delta)) / (2 * step)

    for (u, v), way in ((("ux", "vx"), dx), (("uy", "vy"), dy)):
        fine, coarse = difference(5e-4, way), difference(1e-3, way)
        truth, error = (4 * fine - coarse) / 3, np.abs(fine - coarse)
        # Differences of angles of up to 1, rounded to 2e-16, over 1e-3.
        assert (np.abs(out[u] - truth[0]) <= error[0] + 1e-11)[whole].all()
        assert (np.abs(out[v] - truth[1]) <= error[1] + 1e-11)[whole].all()


def test_solid_angles():
    """They sum to the sphere: their mean is 1; the first row's is that of a cap."""
    weighted = by_solid_angle(np.ones((8, 16, 3), np.float32))
    assert weighted[..., 3].mean() == pytest.approx(1, abs=1e-6)
    assert weighted[0, 0, 3] == pytest.approx(4 * (1 - np.cos(np.pi / 8)), rel=1e-6)


@pytest.mark.parametrize("shape", [(32, 64), (5, 9), (2, 2)], ids=str)
def test_a_constant(choice, directions, rng, shape):
    d = np.concatenate([directions[:60], AXES])
    image = np.full((*shape, 3), 0.37)
    for wide in (0.0, 1e-3, 0.1, 1.0, 100.0, 1e30):
        got, _ = look(choice.engine, image, d, wide, rng=rng)
        assert np.abs(got - 0.37).max() < 1e-6


def linear_map(height, width):
    """Radiance 2 + direction: between 1 and 3."""
    return 2 + centres(height, width)


@pytest.mark.parametrize("filtering", ["bilinear", "anisotropic"])
def test_a_map_of_directions(choice, directions, filtering):
    """Magnified: bilinear, with rows weighed by their solid angle."""
    d = np.concatenate([directions, AXES])
    got, _ = look(choice.engine, linear_map(64, 128), d, 1e-6, filtering)
    h = np.pi / 64
    # Second derivatives by latitude and longitude are at most 1: 2 h^2 / 8. Rows whose weights have the ratio q shift a
    # place between them by at most h (q - 1) / 4, and q - 1 is at most h / tan(colatitude of the first one's centre).
    colatitude = np.maximum(np.arccos(np.minimum(np.abs(d[:, 1]), 1.0)) - h / 2, h / 2)
    tolerance = 2 * h * h / 8 + h * h / np.tan(colatitude) / 4 + 1e-5
    assert (np.abs(got - 2 - d).max(axis=1) <= tolerance).all()
    assert np.median(tolerance) < 2e-3


@pytest.mark.parametrize("wide", [0.1, 0.3])
def test_a_filtered_map_of_directions(choice, directions, rng, wide):
    """A direction under a Gaussian on the sphere shrinks by exp(-s^2), s = wide / 2, per axis."""
    d = np.concatenate([directions[:300], AXES])
    got, capped = look(choice.engine, linear_map(64, 128), d, wide, rng=rng)
    exact = d * np.exp(-((wide / 2) ** 2))
    # The picture's Gaussian is one in longitude and latitude. It differs from the sphere's where the parallels bend: of
    # second order in s / colatitude, and at most one deviation, at the pole itself.
    s = wide / 2
    colatitude = np.arccos(np.clip(np.abs(d[:, 1]), 0, 1))
    tolerance = s * np.minimum(1.0, (s / np.maximum(colatitude, 1e-9))) + (np.pi / 64) ** 2
    assert (np.abs(got - 2 - exact).max(axis=1) <= tolerance).all()
    assert capped[-3:-1].all()


def test_turning_about_the_axis(choice, directions, rng):
    """By a quarter, whole texels also of pictures of an eighth of the width: the columns move along."""
    image = rng.uniform(size=(16, 32, 3))
    turn = np.pi / 2
    d = directions[:200]
    # Longitude grows from -z to x.
    c, s = np.cos(turn), np.sin(turn)
    moved = np.stack([c * d[:, 0] - s * d[:, 2], d[:, 1], s * d[:, 0] + c * d[:, 2]], axis=-1)
    for wide in (0.0, 0.15):
        a, _ = look(choice.engine, image, d, wide)
        b, _ = look(choice.engine, np.roll(image, 8, axis=1), moved, wide)
        # Slopes of up to 1 per texel of 1/5 radian, places to 32 eps, and towards the poles as 1 / cos latitude.
        steep = 1 / np.maximum(np.hypot(d[:, 0], d[:, 2]), 1e-3)
        assert (np.abs(a - b).max(axis=1) < 500 * choice.engine.eps * steep).all()


def test_the_seam_is_none(choice, rng):
    """On both sides of +-pi, half a texel apart or less: a picture that is smooth there is."""
    image = linear_map(32, 64)
    latitude = rng.uniform(-1.2, 1.2, 50)
    for wide in (1e-3, 0.2):
        sides = []
        for offset in (-1e-5, 1e-5):
            longitude = np.pi + offset
            d = np.stack(
                [np.cos(latitude) * np.sin(longitude), np.sin(latitude), -np.cos(latitude) * np.cos(longitude)], -1
            )
            sides.append(look(choice.engine, image, d, wide)[0])
        # 2e-5 of a slope of 1, and what float32 makes of u next to 1, 1e-7 turns of 64 texels.
        assert np.abs(sides[0] - sides[1]).max() < 2e-5 + 1e-5


@pytest.mark.parametrize("pole", [1.0, -1.0])
def test_beyond_a_pole_lies_the_other_side(choice, rng, pole):
    """A quarter of a texel from it: a quarter of the first row half a turn away, three of the row here."""
    image = rng.uniform(size=(16, 32, 3)).astype(np.float32)
    row, colatitude = image[0 if pole > 0 else -1], np.pi / 16 / 4
    longitude = ((np.arange(32) + 0.5) / 32 - 0.5) * 2 * np.pi
    r = np.sin(colatitude)
    d = np.stack([r * np.sin(longitude), np.full(32, pole * np.cos(colatitude)), -r * np.cos(longitude)], axis=-1)
    got, _ = look(choice.engine, image, d, filtering="bilinear")
    # Longitudes to a few eps, 32 texels, slopes of 1; the place between rows as well.
    assert np.abs(got - 0.75 * row - 0.25 * np.roll(row, 16, axis=0)).max() < 256 * choice.engine.eps + 1e-6


@pytest.mark.parametrize("pole", [1.0, -1.0])
def test_the_mean_distance_from_a_pole(choice, pole):
    """The mean of the colatitude under a round Gaussian of deviation s is s sqrt(pi / 2), by solid angle.

    Weighed by latitude alone it would be s sqrt(2 / pi), a third less.
    """
    height = 256
    colatitude = np.arccos(pole * centres(height, 2 * height)[..., 1:2])
    for wide in (0.1, 0.2):
        got, capped = look(choice.engine, colatitude * np.ones(3), [(0, pole, 0)], wide)
        s = wide / 2
        # The sphere's solid angle differs from the plane's by s^2 / 6. The cut Gaussian's first moment differs from the
        # whole one's by 1 % where their variances are equal.
        assert got[0, 0] == pytest.approx(s * np.sqrt(np.pi / 2), rel=0.03)
        assert capped.all()


@pytest.mark.parametrize("away", [0.0, 0.02, 0.6, 1.2])
def test_noise_by_brute_force(rng, away):
    """Means over a million directions around one, of the nearest texels."""
    height, wide, n = 32, 0.6, 12
    image = rng.uniform(size=(height, 2 * height, 3)).astype(np.float32)
    longitude = rng.uniform(-np.pi, np.pi, n)
    d = np.stack([np.sin(away) * np.sin(longitude), np.full(n, np.cos(away)), -np.sin(away) * np.cos(longitude)], -1)
    got, _ = look(choose("numpy", 64).engine, image, d, wide)
    grid = centres(4 * height, 8 * height).reshape(-1, 3)
    solid = np.hypot(grid[:, 0], grid[:, 2])
    dense = np.repeat(np.repeat(image, 4, 0), 4, 1).reshape(-1, 3)
    s2 = (wide / 2) ** 2 - (np.pi / height) ** 2 / 12  # nearest texels have a spread of their own
    exact = []
    for centre in d:
        w = solid * np.exp(-0.5 * np.arccos(np.clip(grid @ centre, -1, 1)) ** 2 / s2)
        exact.append(w @ dense / w.sum())
    spread = np.std(exact)
    error = np.sqrt(np.mean((got - exact) ** 2))
    # A mean over k texels of noise has the deviation 0.29 / sqrt(k), k = 4 pi s^2 in texels of pi / 32: 117 at the
    # equator. Where the level's texels are means over 4 x 4, of 0.58 texels of variance per axis, a kernel that is
    # constant on them differs from the Gaussian by sqrt(1 / (12 0.58)) = 0.38 of its amplitude; by 0.1 for all else.
    assert error < 0.29 / np.sqrt(117) * 0.48
    assert spread < 0.1


def test_too_small():
    with pytest.raises(BadInput, match="1x1 texels"):
        Environment(choose("numpy", 64).engine, np.ones((1, 1, 3), np.float32))
