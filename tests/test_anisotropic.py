"""The elliptical average: ramps and constants exactly, gratings by closed form, noise against brute force."""

import numpy as np
import pytest
from scipy.special import j0

from sdfrender.anisotropic import CUT, FINEST, KEPT, gaussian, moments
from sdfrender.sampler import Sampler
from sdfrender.texture import Texture


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
    # Taylor's remainder, at most 0.25^9 / 9!, relative to exp(-0.25), 16 times over: 2.16e-10. Then 16 x 16 roundings.
    assert np.abs(got / np.exp(-q) - 1).max() < 2.2e-10 + 256 * choice.engine.eps


def test_the_cut_gaussian_keeps_its_variance():
    """KEPT is the ratio of radial moments of exp(-r^2 / 2) - exp(-CUT): by quadrature, 1e5 midpoints."""
    r = (np.arange(100_000) + 0.5) / 100_000 * np.sqrt(2 * CUT)
    w = (np.exp(-r * r / 2) - np.exp(-CUT)) * r
    assert KEPT == pytest.approx((w * r * r).sum() / w.sum() / 2, rel=1e-8)


@pytest.mark.parametrize("size", [(64, 64), (37, 50), (1, 64), (64, 1), (1, 1)], ids=str)
@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror"])
def test_a_constant(choice, rng, size, wrap):
    texture = Texture.of(np.full((size[1], size[0], 1), 0.37, np.float32))
    dx, dy = footprints(rng, 200, (64, 64), 300, 100)
    got, _ = look(choice, texture, rng.uniform(-2, 3, (200, 2)), dx, dy, wrap=wrap)
    # Numerator and denominator are sums of up to 2000 terms of one sign: each rounds to 2000 eps at worst.
    assert np.abs(got - np.float32(0.37)).max() < 4000 * choice.engine.eps


@pytest.mark.parametrize("size", [(256, 256), (512, 128)], ids=str)
def test_a_ramp(choice, rng, size):
    """u + 2 v at texel centres, away from the border: any ellipse returns it at its centre."""
    w, h = size
    x, y = (np.arange(w) + 0.5) / w, 1 - (np.arange(h) + 0.5) / h
    texture = Texture.of((x[None, :] + 2 * y[:, None])[..., None].astype(np.float32))
    uv = rng.uniform(0.42, 0.58, (300, 2))
    dx, dy = footprints(rng, 300, (128, 128), 14, 12)
    got, _ = look(choice, texture, uv, dx, dy, wrap="clamp")
    # Texels are stored as float32: 3 * 6e-8 each. The engine adds: sums of 2000 terms.
    assert np.abs(got[:, 0] - uv @ [1, 2]).max() < 2e-6 + 3000 * choice.engine.eps * (choice.engine.precision == 32)
