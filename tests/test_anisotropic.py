"""The elliptical average: ramps and constants exactly, gratings by closed form, noise against brute force."""

from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.special import j0, j1

from sdfbake.engine import choose
from sdfrender.anisotropic import CUT, FINEST, KEPT, gaussian, moments, reach
from sdfrender.sampler import Sampler
from sdfrender.texels import Size, Texels
from sdfrender.texture import Texture

DOUBLE = choose("numpy", 64)


def look(choice, texture, uv, dx, dy, filtering="anisotropic", wrap="repeat", most=16.0):
    """Colours (n, channels) and the three masks, for footprints (n, 2) in uv."""
    xp = choice.engine
    sampler = Sampler(xp, texture, filtering, wrap, most)
    uv, dx, dy = (
        np.broadcast_to(np.asarray(a, float), (*np.broadcast_shapes(*map(np.shape, (uv, dx, dy)))[:-1], 2))
        for a in (uv, dx, dy)
    )

    def program(xp, u, v, a, b, c, d):
        found = sampler.look_up(xp, u, v, ((a, b), (c, d)), xp.full(u, True))
        masks = {name: xp.integer(getattr(found, name)) for name in ("below", "above", "capped")}
        return {**{f"c{i}": value for i, value in enumerate(found.colour)}, **masks}

    columns = [np.ascontiguousarray(column.ravel()) for a in (uv, dx, dy) for column in np.moveaxis(a, -1, 0)]
    out = xp.run(program, columns)
    colour = np.stack([out[f"c{i}"] for i in range(texture.levels[0].shape[2])], axis=-1).astype(float)
    return colour, {name: out[name].astype(bool) for name in ("below", "above", "capped")}


def turned(angle, a, b, size):
    """Footprint in uv whose ellipse has half axes a and b texels, the first at an angle; y and v point up."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([a * c / size[0], a * s / size[1]], -1), np.stack([-b * s / size[0], b * c / size[1]], -1)


def footprints(rng, count, size, longest=40.0, ratio=12.0):
    """Random ellipses from two texels on, with the pixel's axes turned against the ellipse's."""
    a = 2 * (longest / 2) ** rng.uniform(size=count)
    b = a / ratio ** rng.uniform(size=count)
    dx, dy = turned(rng.uniform(0, np.pi, count), a, b, size)
    mix = rng.uniform(0, 2 * np.pi, (count, 1))
    return np.cos(mix) * dx + np.sin(mix) * dy, np.cos(mix) * dy - np.sin(mix) * dx


def test_the_exponential(choice):
    q = np.linspace(0, CUT, 500)
    got = choice.engine.run(lambda xp, q: {"w": gaussian(xp, q)}, [q])["w"]
    # Taylor's remainder, at most z^10 / 10! with z = 5 / 16, relative to exp(-z), 16 times over: 5.4e-11. Then 16 x 16
    # roundings.
    assert np.abs(got / np.exp(-q) - 1).max() < 5.5e-11 + 256 * choice.engine.eps


def test_the_cut_gaussian_keeps_its_variance():
    """KEPT is the ratio of radial moments of exp(-r^2 / 2) - exp(-CUT): by quadrature, 1e5 midpoints."""
    r = (np.arange(100_000) + 0.5) / 100_000 * np.sqrt(2 * CUT)
    w = (np.exp(-r * r / 2) - np.exp(-CUT)) * r
    variance = (w * r * r).sum() / w.sum() / 2
    assert variance == pytest.approx(KEPT, rel=1e-8)


@pytest.mark.parametrize(
    ("size", "wrap"), [((64, 64), "repeat"), ((37, 50), "clamp"), ((1, 64), "mirror"), ((1, 1), "repeat")], ids=str
)
def test_a_constant(choice, rng, size, wrap):
    texture = Texture.of(np.full((size[1], size[0], 1), 0.37, np.float32))
    dx, dy = footprints(rng, 200, (64, 64), 300, 100)
    got, _ = look(choice, texture, rng.uniform(-2, 3, (200, 2)), dx, dy, wrap=wrap, most=4.0)
    # Numerator and denominator are sums of up to 2000 terms of one sign: each rounds to 2000 eps at worst.
    assert np.abs(got - np.float32(0.37)).max() < 4000 * choice.engine.eps


@pytest.mark.parametrize("size", [(256, 256), (512, 128)], ids=str)
def test_a_ramp(choice, rng, size):
    """u + 2 v at texel centres, away from the border: any ellipse returns it at its centre."""
    w, h = size
    x, y = (np.arange(w) + 0.5) / w, 1 - (np.arange(h) + 0.5) / h
    texture = Texture.of((x[None, :] + 2 * y[:, None])[..., None].astype(np.float32))
    uv = rng.uniform(0.42, 0.58, (300, 2))
    dx, dy = footprints(rng, 300, (128, 128), 12, 6)
    got, _ = look(choice, texture, uv, dx, dy, wrap="clamp")
    # Texels are stored as float32: 3 * 6e-8 each. The engine adds: sums of 2000 terms.
    assert np.abs(got[:, 0] - uv @ [1, 2]).max() < 2e-6 + 3000 * choice.engine.eps * (choice.engine.precision == 32)


def covariance(dx, dy, size):
    """J J^T / 4 in texels (n, 2, 2), y down."""
    jacobian = np.stack([dx, dy], axis=-1) * np.array([size[0], -size[1]])[:, None]
    return jacobian @ np.swapaxes(jacobian, -1, -2) / 4


def kernel(covariance):
    """Covariance of the untruncated Gaussian that is summed: less the texel's box, widened for what is cut off."""
    values, axes = np.linalg.eigh(covariance)
    values = np.maximum(values - 1 / 12, FINEST - 1 / 12) / KEPT
    return (axes * values[..., None, :]) @ np.swapaxes(axes, -1, -2)


@cache
def tabled():
    """Fourier transform of the truncated kernel, minus its slope: splines over 0 to 300, by 1500 midpoints."""
    kappa = np.linspace(0, 300, 5500)
    r = (np.arange(1500) + 0.5) / 1500 * np.sqrt(2 * CUT)
    w = (np.exp(-r * r / 2) - np.exp(-CUT)) * r
    turns = np.multiply.outer(kappa, r)
    return CubicSpline(kappa, j0(turns) @ w / w.sum()), CubicSpline(kappa, j1(turns) @ (w * r) / w.sum())


def transform(kappa):
    """Both at |kappa| = 2 pi sqrt(f' S f)."""
    assert np.max(kappa) < 300
    return tuple(spline(kappa) for spline in tabled())


def replicas(shape, frequency):
    """Greatest error of the sum over texels in place of the integral: Poisson's sum over the replicas.

    The weights' sum is off by the replicas of 0, their mean by the slopes there; the correction multiplies the latter
    with the slope of what is looked at, and divides by the cut weights' variance. The kink where the weights end
    leaves replicas that fall as k^(-5/2): those beyond three cells add up to sqrt(3) / (sqrt(3) - 1) - 1 = 1.4 times
    those within, for a sum of k^(-3/2) over rings.
    """
    k = np.array([(i, j) for i in range(-3, 4) for j in range(-3, 4) if (i, j) != (0, 0)], float)

    def at(f):
        return transform(2 * np.pi * np.sqrt(np.einsum("...i,...ij,...j->...", f, shape[:, None], f)))

    here, slope = at(frequency[:, None])
    own, own_slope = (2.4 * np.abs(value).sum(axis=1) for value in at(k[None] + 0 * frequency[:, None]))
    shifted, shifted_slope = (2.4 * np.abs(value).sum(axis=1) for value in at(k[None] + frequency[:, None]))
    first = shifted + np.abs(here[:, 0]) * own + own_slope * (np.abs(slope[:, 0]) + shifted_slope) / KEPT
    return here[:, 0], first / (1 - own - own_slope)


@pytest.mark.parametrize("level", [0, 2], ids=lambda level: f"level{level}")
def test_gratings(choice, rng, level):
    """A sine under a Gaussian is the sine times exp(-2 pi^2 f' S f)."""
    size, n, side = (128, 128), 150, 2**level
    period = np.array([14, -9])
    x, y = np.arange(128) + 0.5, np.arange(128) + 0.5
    f = period / 128
    image = np.sin(2 * np.pi * (f[0] * x[None, :] + f[1] * y[:, None]))
    texture = Texture.of(image[..., None].astype(np.float32))
    minor = rng.uniform(np.sqrt(2), 2 * np.sqrt(2) - 1e-9, n) * side
    major = np.maximum(minor * rng.uniform(1, 5, n), 2 * side)  # shorter ones are mixed with bilinear
    dx, dy = turned(rng.uniform(0, np.pi, n), major, minor, size)
    uv = rng.uniform(size=(n, 2))
    got, masks = look(choice, texture, uv, dx, dy)
    assert not any(mask.any() for mask in masks.values())
    phase = 2 * np.pi * 128 * (uv[:, 0] * f[0] + (1 - uv[:, 1]) * f[1])
    # In texels of the level, where the box over side texels has taken its share of the amplitude.
    box = np.prod(np.sinc(f * side) / np.sinc(f))
    spread = covariance(dx, dy, size) / side**2
    passed, error = replicas(kernel(spread), np.tile(f * side, (n, 1)))
    rounding = 1e-6 + 4000 * choice.engine.eps
    assert (np.abs(got[:, 0] - passed * box * np.sin(phase)) <= abs(box) * error + rounding).all()
    # Against the Gaussian: the cut one's transform is off by its fourth moment, at most DEVIATION; so is box * sinc.
    attenuation = np.exp(-2 * np.pi**2 * np.einsum("i,nij,j->n", f * side, spread, f * side))
    boxes = np.abs(np.prod(np.sinc(f * side)) - np.exp(-np.sum((np.pi * f * side) ** 2) / 6))
    exact = attenuation * np.sin(phase)
    off = np.abs(got[:, 0] * np.prod(np.sinc(f)) - exact)
    assert (off <= error + deviation() + boxes + rounding).all()


def deviation():
    """Greatest difference of the cut Gaussian's transform from the Gaussian's of the same variance."""
    kappa = np.linspace(0, 12, 600)
    return np.abs(transform(kappa / np.sqrt(KEPT))[0] - np.exp(-kappa * kappa / 2)).max()


def test_the_cut_gaussian_is_nearly_one():
    assert 1e-3 < deviation() < 0.02


def test_ellipses_by_least_squares(rng):
    """The whole sum again: all texels of a tiling, weights by the inverse matrix, a plane fitted by least squares."""
    size, n = (16, 24), 40
    image = rng.uniform(size=(24, 16, 2)).astype(np.float32)
    dx, dy = turned(rng.uniform(0, np.pi, n), rng.uniform(2.8, 9, n), rng.uniform(1.42, 2.8, n), size)
    uv = rng.uniform(size=(n, 2))
    got, _ = look(DOUBLE, Texture.of(image), uv, dx, dy)
    tiled = np.tile(image, (5, 5, 1)).reshape(-1, 2)
    y, x = (index.ravel() + 0.5 for index in np.mgrid[-48:72, -32:48])
    for i, shape in enumerate(kernel(covariance(dx, dy, size))):
        d = np.stack([x - uv[i, 0] * 16, y - (1 - uv[i, 1]) * 24], axis=-1)
        q = 0.5 * np.einsum("ni,ij,nj->n", d, np.linalg.inv(shape), d)
        w = np.where(q < CUT, np.exp(-q) - np.exp(-CUT), 0)
        plane = np.linalg.lstsq(
            np.sqrt(w)[:, None] * np.column_stack([np.ones_like(x), d]), np.sqrt(w)[:, None] * tiled
        )
        # Weights are off by 6e-11 relative, colours up to 1, the correction no larger than the mean.
        assert np.abs(got[i] - plane[0][0]).max() < 1e-9


@pytest.mark.parametrize("angle", [0.5, np.pi / 2, 2.5])
def test_turning_a_round_blob(choice, rng, angle):
    """Footprint and place turned together, on a Gaussian blob: both are the blob of the summed covariances."""
    size, n, wide = (128, 128), 100, 10.0
    x = np.arange(128) + 0.5 - 64
    image = np.exp(-(x[None, :] ** 2 + x[:, None] ** 2) / (2 * wide**2))
    texture = Texture.of(image[..., None].astype(np.float32))
    minor = rng.uniform(np.sqrt(2), 2.8, n)
    turn, major, away = rng.uniform(0, np.pi, n), minor * rng.uniform(1, 6, n), rng.uniform(-15, 15, (n, 2))
    c, s = np.cos(angle), np.sin(angle)
    there = away @ np.array([[c, s], [-s, c]])
    a, _ = look(choice, texture, 0.5 + away / 128, *turned(turn, major, minor, size))
    b, _ = look(choice, texture, 0.5 + there / 128, *turned(turn + angle, major, minor, size))
    spread = covariance(*turned(turn, major, minor, size), size)
    total = spread + wide**2 * np.eye(2)
    d = away * [1, -1]
    exact = (
        wide**2 / np.sqrt(np.linalg.det(total)) * np.exp(-0.5 * np.einsum("ni,nij,nj->n", d, np.linalg.inv(total), d))
    )
    # The blob's spectrum ends at 4 / (2 pi wide) = 0.064 per texel; the texels hold samples, not means, of it, which
    # is 1/12 less of a variance of 100; and the cut Gaussian's transform is off by its fourth moment.
    f = np.array([[0.064, 0.0]]).repeat(n, axis=0)
    _, error = replicas(kernel(spread), f)
    tolerance = error + deviation() + 1 / 12 / wide**2 + 4000 * choice.engine.eps
    assert (np.abs(a[:, 0] - b[:, 0]) <= 2 * error + 1e-6 + 4000 * choice.engine.eps).all()
    assert (np.abs(a[:, 0] - exact) <= tolerance).all()


@pytest.mark.parametrize("lod", [1, 2, 3])
def test_round_footprints_agree_with_trilinear(choice, rng, lod):
    """Equal variance at whole levels: on waves of 16 texels of the level they differ from the fourth moment on."""
    side = 2**lod
    x = np.arange(256) + 0.5
    image = np.sin(2 * np.pi * x / (16 * side))[None, :, None] * np.ones((256, 1, 1))
    texture = Texture.of(image.astype(np.float32))
    uv = rng.uniform(size=(100, 2))
    dx, dy = turned(rng.uniform(0, np.pi, 100), side, side, (256, 256))
    # Turned axes of a circle: eq. 25 takes the longer derivative, which is side for any angle.
    a, _ = look(choice, texture, uv, dx, dy)
    b, _ = look(choice, texture, uv, dx, dy, "trilinear")
    # Bilinear interpolation of a wave of 1/16: the nearest replica passes with (1/15)^2 times, the next (1/17)^2, and
    # so on, 2 sum (1/16k)^2 = 0.0129; fourth moments differ by less than (2 pi / 32)^4 = 0.0015; the ellipse's replicas
    # are as in the test of gratings, 0.001 at this frequency.
    assert np.abs(a - b).max() < 0.0129 + 0.0015 + 0.001
    assert np.abs(b).max() > 0.85


def test_magnified_it_is_trilinear(choice, rng):
    """Footprints within a texel: the finest level, bilinear; both say so."""
    texture = Texture.of(rng.uniform(size=(32, 32, 3)).astype(np.float32))
    uv = rng.uniform(size=(200, 2))
    dx, dy = turned(rng.uniform(0, np.pi, 200), rng.uniform(0, 0.99, 200), rng.uniform(0, 0.99, 200), (32, 32))
    dx[0], dy[0] = 0, 0
    a, masks = look(choice, texture, uv, dx, dy)
    b, others = look(choice, texture, uv, dx, dy, "trilinear")
    assert np.abs(a - b).max() < 64 * choice.engine.eps
    assert masks["below"].all() and others["below"].all()
    assert not masks["above"].any() and not masks["capped"].any()


def test_it_is_continuous():
    """Along a growing footprint: through the share of bilinear, from level to level, into the cap."""
    x = np.arange(64) + 0.5
    wave = np.sin(2 * np.pi * 2 * x / 64)[None, :] * np.cos(2 * np.pi * x / 64)[:, None]
    texture = Texture.of(wave[..., None].astype(np.float32))
    a = np.geomspace(0.5, 100, 3000)
    dx, dy = turned(0.7, a, np.minimum(a, 3.5), (64, 64))
    got, masks = look(DOUBLE, texture, (0.4, 0.3), dx, dy)
    assert masks["below"][0] and masks["capped"][-1]
    # The slope by log a is at most 1 (attenuation by a Gaussian); a step of a is 0.18 %. Levels differ by replicas of
    # waves of up to 1/8 per texel of the level, below 0.005.
    assert np.abs(np.diff(got[:, 0])).max() < 0.0018 + 0.005


def test_noise_by_brute_force(rng):
    """White noise under long ellipses: closer to the Gaussian mean over 16 points per texel than trilinear is."""
    size, n = (64, 64), 40
    image = rng.uniform(size=(64, 64, 1)).astype(np.float32)
    dx, dy = turned(rng.uniform(0, np.pi, n), rng.uniform(8, 16, n), rng.uniform(1.5, 3, n), size)
    uv = rng.uniform(size=(n, 2))
    exact = []
    points = (np.arange(64 * 4) + 0.5) / 4
    dense = np.repeat(np.repeat(image[..., 0], 4, 0), 4, 1)
    for at, spread in zip(uv, covariance(dx, dy, size), strict=True):
        # Nearest texels add 1/12 per axis; distances go around the torus, 32 texels are 4 deviations.
        inverse = np.linalg.inv(spread - np.eye(2) / 12)
        x, y = np.meshgrid(*((points - c + 32) % 64 - 32 for c in (at[0] * 64, (1 - at[1]) * 64)))
        w = np.exp(-0.5 * (inverse[0, 0] * x * x + 2 * inverse[0, 1] * x * y + inverse[1, 1] * y * y))
        exact.append((w * dense).sum() / w.sum())

    def off(filtering):
        got, _ = look(DOUBLE, Texture.of(image), uv, dx, dy, filtering)
        return np.sqrt(np.mean((got[:, 0] - exact) ** 2))

    # Parseval: the noise's deviation, 0.29, over the square root of the texels that are averaged, 4 pi 4 0.75 = 38 of
    # the least; times a difference of the kernels of DEVIATION plus replicas, 0.1.
    assert off("anisotropic") < 0.29 / np.sqrt(38) * 0.1
    assert off("anisotropic") < 0.25 * off("trilinear")


@pytest.mark.parametrize("filtering", ["bilinear", "trilinear", "anisotropic"])
@pytest.mark.parametrize("wrap", ["repeat", "mirror"])
def test_wrapping_is_a_larger_picture(choice, rng, filtering, wrap):
    """The picture and its neighbours, as one picture that repeats."""
    image = rng.uniform(size=(16, 8, 1)).astype(np.float32)
    across = np.concatenate([image, image[:, ::-1] if wrap == "mirror" else image], axis=1)
    # The first picture is at the bottom, where v is from 0 to 1/2.
    larger = np.concatenate([across[::-1] if wrap == "mirror" else across, across], axis=0)
    uv = rng.integers(-300, 300, (100, 2)) / 64 + 1 / 128
    dx, dy = turned(rng.uniform(0, np.pi, 100), rng.uniform(0.1, 7, 100), rng.uniform(0.1, 3, 100), (8, 16))
    a, _ = look(choice, Texture.of(image), uv, dx, dy, filtering, wrap)
    b, _ = look(choice, Texture.of(larger), uv / 2, dx / 2, dy / 2, filtering, "repeat")
    # Places up to 5 x 16 texels round by 80 eps in texels; slopes up to 2 per texel, and the weights' as much.
    assert np.abs(a - b).max() < 2000 * choice.engine.eps


def test_clamping_is_a_wider_border(rng):
    image = rng.uniform(size=(16, 16, 1)).astype(np.float32)
    padded = np.pad(image, ((24, 24), (24, 24), (0, 0)), mode="edge")
    uv = rng.uniform(-0.2, 1.2, (100, 2))
    dx, dy = turned(rng.uniform(0, np.pi, 100), rng.uniform(2, 6, 100), rng.uniform(1.42, 2.8, 100), (16, 16))
    a, _ = look(DOUBLE, Texture.of(image), uv, dx, dy, wrap="clamp")
    b, _ = look(DOUBLE, Texture.of(padded), (uv * 16 + 24) / 64, dx / 4, dy / 4, wrap="clamp")
    assert np.abs(a - b).max() < 1e-11


@pytest.mark.parametrize(("size", "wrap"), [((64, 64), "clamp"), ((1, 200), "mirror"), ((33, 7), "repeat")], ids=str)
def test_extremes(choice, rng, wrap, size):
    """Any footprint gives a mean of the texture, and says what was clamped."""
    image = rng.uniform(0.25, 0.75, (size[1], size[0], 1)).astype(np.float32)
    texels = np.array(
        [[1e30, 1e30], [1e30, 0], [1e5, 1e2], [300, 0.3], [0.3, 1e-4], [0, 0], [1e-30, 1e-30], [1e4, 1e4]]
    )
    dx, dy = turned(np.full(8, 0.3), texels[:, 0], texels[:, 1], size)
    got, masks = look(choice, Texture.of(image), rng.uniform(-1e4, 1e4, (8, 2)), dx, dy, wrap=wrap, most=4.0)
    assert np.isfinite(got).all() and (got > 0.2).all() and (got < 0.8).all()
    assert list(masks["below"]) == [0, 0, 0, 0, 1, 1, 1, 0]
    assert list(masks["capped"]) == [0, 1, 1, 1, 0, 0, 0, 0]
    assert list(masks["above"]) == [1, 1, 1, 0, 0, 0, 0, 1]
    if wrap != "clamp":
        assert got[0, 0] == pytest.approx(image.mean(), abs=1e-5)


@pytest.mark.parametrize("most", [1.0, 4.0, 16.0])
def test_the_number_of_texels_is_bounded(choice, rng, most):
    """Counted: the columns of the longest ellipse, 2 sqrt(2 CUT V) + 1, times the texels of the fattest column."""
    n = 500
    a, b = 10.0 ** rng.uniform(-6, 12, (2, n))
    dx, dy = turned(rng.uniform(0, np.pi, n), a, b, (256, 256))

    def program(xp, u, v, a, b, c, d):
        texels = Texels(xp, [np.zeros((256, 256, 1), np.float32)], "repeat")
        size = Size(xp.full(u, 256), xp.full(u, 256), xp.full(u, 0))
        found = reach(xp, texels, (u, v), ((a, b), (c, d)), size, most)
        return {"columns": found.columns, "count": found.count}

    out = choice.engine.run(program, [*rng.uniform(size=(2, n)), *dx.T, *dy.T])
    # A column's variance is major minor / ss, and ss is the mean of the two at least: twice the minor one at most.
    variances = (2 - 1 / 12) / KEPT * 2, (2 * most**2 - 1 / 12) / KEPT
    widest, longest = (2 * np.sqrt(2 * CUT * variance) * (1 + 1e-5) for variance in variances)
    assert out["columns"].min() >= 1 and out["count"].min() >= 1
    assert out["columns"].max() <= longest + 1 and out["count"].max() <= widest + 1


def test_a_thousand_to_one_is_widened(rng):
    """The cap makes the minor axis major / most: the same as a footprint that is as wide."""
    texture = Texture.of(rng.uniform(size=(64, 64, 1)).astype(np.float32))
    uv, turn = rng.uniform(size=(50, 2)), rng.uniform(0, np.pi, 50)
    thin, masks = look(DOUBLE, texture, uv, *turned(turn, 40.0, 0.04, (64, 64)), most=4.0)
    wide, none = look(DOUBLE, texture, uv, *turned(turn, 40.0, 10 * (1 + 1e-9), (64, 64)), most=4.0)
    assert masks["capped"].all() and not none["capped"].any()
    assert np.abs(thin - wide).max() < 1e-7


@pytest.mark.parametrize("ratio", [1, 3, 1e3, 1e6])
def test_moments_are_singular_values(choice, rng, ratio):
    n = 200
    dx, dy = turned(rng.uniform(0, np.pi, n), np.full(n, 30.0), np.full(n, 30 / ratio), (640, 200))
    mix = rng.uniform(0, np.pi, (n, 1))
    dx, dy = np.cos(mix) * dx + np.sin(mix) * dy, np.cos(mix) * dy - np.sin(mix) * dx

    def program(xp, a, b, c, d):
        found = moments(xp, (a, b), (c, d), xp.uniform(640.0), xp.uniform(200.0))
        return {"major": found.major, "minor": found.minor, "x": found.axis[0], "y": found.axis[1]}

    out = choice.engine.run(program, [*dx.T, *dy.T])
    values, axes = np.linalg.eigh(covariance(dx, dy, (640, 200)))
    eps = choice.engine.eps
    assert out["major"] == pytest.approx(values[:, 1], rel=64 * eps)
    # The determinant's rounding is relative to its products, which are ratio times greater than it.
    assert out["minor"] == pytest.approx((15 / ratio) ** 2, rel=64 * eps * ratio + (16 * eps * ratio) ** 2)
    if ratio > 1:
        along = out["x"] * axes[:, 0, 1] + out["y"] * axes[:, 1, 1]
        # sin^2 of the angle between them: rounding over the gap of the variances, twice.
        assert np.abs(np.abs(along) - 1).max() < 16 * eps
