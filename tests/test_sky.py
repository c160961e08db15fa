"""The sky: the same numbers every time, its sun where it is said to be, and as bright."""

import numpy as np
import pytest

from datasets_synthetic.sky import SIZE, SUN, SUN_RADIANCE, SUN_RADIUS, save_sky, sky
from sdfbake.complaint import BadInput
from sdfrender.irradiance import directions
from sdfrender.picture import read_picture


def test_the_sun_is_where_it_is_said_to_be():
    image = sky().astype(float)
    assert image.shape == (SIZE[1], SIZE[0], 3) and np.isfinite(image).all() and image.min() > 0
    assert np.linalg.norm(SUN) == pytest.approx(1, abs=1e-12)
    d, bright = directions(*SIZE), image[..., 0] > 0.9 * SUN_RADIANCE[0]
    assert np.degrees(np.arccos(np.clip(d[bright] @ SUN, -1, 1))).max() <= np.degrees(SUN_RADIUS) + 0.4  # a texel


def test_the_sun_is_as_bright_as_it_is_said_to_be():
    """What falls on a surface across it is pi sin^2 of its radius times its radiance; a rim softens it."""
    image, d = sky().astype(float), directions(*SIZE)
    height, width = image.shape[:2]
    edges = np.sin(np.pi / 2 - np.arange(height + 1) / height * np.pi)
    angle = (-np.diff(edges) * 2 * np.pi / width)[:, None, None]
    near = (d @ SUN > np.cos(2 * SUN_RADIUS))[..., None]
    sky_itself = np.median(image[near[..., 0] & (image[..., 0] < 2)], axis=0)
    falls = ((image - sky_itself) * angle * near * np.maximum(d @ SUN, 0)[..., None]).sum(axis=(0, 1))
    assert falls == pytest.approx(
        np.pi * np.sin(SUN_RADIUS) ** 2 * np.array(SUN_RADIANCE), rel=0.03
    )  # texels of a tenth of its radius


def test_a_file_of_the_sky(tmp_path):
    save_sky(tmp_path / "sky.exr")
    assert np.array_equal(read_picture(tmp_path / "sky.exr"), sky())
    with pytest.raises(BadInput, match="end in .exr"):
        save_sky(tmp_path / "sky.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["sky.exr"]
