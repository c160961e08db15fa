"""Files of pictures: every output there and back, the names of the channels, nothing left behind."""

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from sdfbake.complaint import BadInput
from sdfrender.image import CHANNELS, read_exr, write_exr, write_png
from sdfrender.texture import srgb_to_linear

NAMES = {
    "rgb": ["R", "G", "B"],
    "Z": ["Z"],
    "P": ["P.X", "P.Y", "P.Z"],
    "N": ["N.X", "N.Y", "N.Z"],
    "uv": ["uv.U", "uv.V"],
    "duv_dx": ["duv_dx.U", "duv_dx.V"],
    "duv_dy": ["duv_dy.U", "duv_dy.V"],
    "lod": ["lod"],
    "lod_invariant": ["lod_invariant"],
    "ellipse": ["ellipse.major", "ellipse.minor", "ellipse.angle"],
    "nonlinearity": ["nonlinearity"],
    "curvature": ["curvature.min", "curvature.max"],
    "chart": ["chart"],
    "flags": ["flags"],
    "part": ["part"],
}


@pytest.fixture
def arrays(rng):
    """Random numbers for every output; flags and parts are integers."""
    made = {name: rng.normal(size=(5, 7, len(channels))) for name, channels in NAMES.items()}
    made["flags"] = rng.integers(0, 256, (5, 7, 1)).astype(float)
    made["part"] = rng.integers(-1, 256, (5, 7, 1)).astype(float)
    return made


def test_outputs_come_back_as_float32(tmp_path, arrays):
    write_exr(tmp_path / "all.exr", arrays)
    back = read_exr(tmp_path / "all.exr")
    assert set(back) == set(arrays) == set(CHANNELS)
    for name, array in arrays.items():
        assert back[name].dtype == np.float32 and np.array_equal(back[name], array.astype(np.float32)), name


def test_channels_are_named_and_explained(tmp_path, arrays):
    write_exr(tmp_path / "all.exr", arrays)
    with OpenEXR.File(str(tmp_path / "all.exr"), separate_channels=True) as file:
        assert set(file.channels()) == {channel for channels in NAMES.values() for channel in channels}
        for name, channels in NAMES.items():
            assert len(file.header()[f"meaning of {name}"]) > 10
            for i, channel in enumerate(channels):
                assert np.array_equal(file.channels()[channel].pixels, arrays[name][..., i].astype(np.float32))


@pytest.mark.parametrize("some", [("Z",), ("uv", "rgb"), ("flags", "part")], ids=str)
def test_some_outputs(tmp_path, arrays, some):
    write_exr(tmp_path / "some.exr", {name: arrays[name] for name in some})
    assert set(read_exr(tmp_path / "some.exr")) == set(some)


def test_the_first_row_is_the_top(tmp_path):
    """Row 0 and column 0 at the upper left, in both kinds of file; brighter than white is white."""
    rgb = np.zeros((4, 6, 3))
    rgb[0, 0], rgb[3, 5] = [7.0, 0.5, -1.0], srgb_to_linear(np.array([10, 20, 30]) / 255)
    write_png(tmp_path / "a.png", rgb)
    with Image.open(tmp_path / "a.png") as picture:
        pixels = np.asarray(picture)
    assert pixels.shape == (4, 6, 3)
    assert pixels[0, 0].tolist() == [255, 188, 0] and pixels[3, 5].tolist() == [10, 20, 30]
    write_exr(tmp_path / "a.exr", {"rgb": rgb})
    assert read_exr(tmp_path / "a.exr")["rgb"][0, 0].tolist() == [7.0, 0.5, -1.0]


@pytest.mark.parametrize("kind", ["exr", "png"])
def test_folders_that_cannot_be_written(tmp_path, kind):
    file = tmp_path / "file"
    file.write_text("in the way")
    write = (
        (lambda p: write_exr(p, {"rgb": np.zeros((2, 2, 3))}))
        if kind == "exr"
        else (lambda p: write_png(p, np.zeros((2, 2, 3))))
    )
    with pytest.raises(BadInput, match="cannot"):
        write(file / f"a.{kind}")
    with pytest.raises(BadInput, match="folder"):
        write(tmp_path)
    assert list(tmp_path.iterdir()) == [file]
    write(tmp_path / "new" / f"a.{kind}")
    assert [p.name for p in (tmp_path / "new").iterdir()] == [f"a.{kind}"]


def test_the_same_picture_is_the_same_file(tmp_path, arrays):
    for name in ("a.exr", "b.exr"):
        write_exr(tmp_path / name, arrays)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
