"""Pictures from files: every kind of number, alpha, and files that are none."""

import struct
import zlib

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from sdfbake.complaint import BadInput
from sdfrender.picture import linear_to_srgb, read_picture, srgb_to_linear
from sdfrender.png16 import read_deep_png
from sdfrender.texture import Texture

KINDS = {1: 0, 2: 4, 3: 2, 4: 6}  # channels -> colour type


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def filtered(raw, kinds, depth):
    """PNG's filters by their definition, one byte after another."""
    out, above = b"", bytes(len(raw[0]))
    for row, kind in zip(raw, kinds, strict=True):
        line = bytearray([kind])
        for i, value in enumerate(row):
            a, c = (row[i - depth], above[i - depth]) if i >= depth else (0, 0)
            b, p = above[i], a + above[i] - c
            paeth = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            line.append((value - (0, a, b, (a + b) // 2, paeth)[kind]) % 256)
        out, above = out + bytes(line), row
    return out


def write_deep(path, values, kinds=None, interlaced=0):
    """Write uint16 (h, w, channels) as PNG."""
    height, width, channels = values.shape
    raw = [row.astype(">u2").tobytes() for row in values]
    head = struct.pack(">IIBBBBB", width, height, 16, KINDS[channels], 0, 0, interlaced)
    data = zlib.compress(filtered(raw, kinds or [0] * height, 2 * channels))
    parts = chunk(b"IDAT", data[:20]) + chunk(b"IDAT", data[20:])
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + parts + chunk(b"IEND", b""))


def write_exr(path, channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, dict(channels)) as file:  # which puts its own objects in
        file.write(str(path))


def test_srgb_there_and_back():
    """All 256 values come back; the curve's two pieces meet to the 1e-8 that the standard's constants leave."""
    values = np.arange(256) / 255
    assert np.array_equal(np.rint(linear_to_srgb(srgb_to_linear(values)) * 255), np.arange(256))
    assert srgb_to_linear(np.array([0.5]))[0] == pytest.approx(((0.5 + 0.055) / 1.055) ** 2.4, rel=1e-14)
    assert srgb_to_linear(np.array([0.0, 1.0])) == pytest.approx([0, 1], abs=1e-15)
    low, high = srgb_to_linear(np.array([0.04045, 0.04045 + 1e-12]))
    assert high - low < 1e-7 and (np.diff(srgb_to_linear(values)) > 0).all()


def test_files_are_read_as_srgb(tmp_path):
    pixels = np.array([[[255, 0, 128], [10, 20, 30]]], np.uint8)
    Image.fromarray(pixels).save(tmp_path / "two.png")
    texture = Texture.load(tmp_path / "two.png")
    assert texture.size == (2, 1)
    assert texture.levels[0] == pytest.approx(srgb_to_linear(pixels / 255), rel=1e-6)


@pytest.mark.parametrize("kind", ["missing", "text", "folder", "cut"])
def test_bad_textures(tmp_path, kind):
    path = tmp_path / "texture.png"
    if kind == "text":
        path.write_text("no picture")
    elif kind == "folder":
        path.mkdir()
    elif kind == "cut":
        Image.fromarray(np.zeros((64, 64, 3), np.uint8)).save(path)
        path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(BadInput, match="texture.png") as caught:
        Texture.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_sixteen_bits_come_back(tmp_path, rng, channels):
    """All 65536 values, in files with every filter; after float32 and the sRGB curve each is still itself."""
    values = rng.permutation(65536).reshape(64, 1024, 1).astype(np.uint16)
    values = np.concatenate([values, values[::-1], values[:, ::-1], np.full_like(values, 65535)], axis=2)
    values = values[..., [0, 3] if channels == 2 else list(range(channels))]
    write_deep(tmp_path / "deep.png", values[:12], kinds=[0, 1, 2, 3, 4, 4, 3, 2, 1, 0, 4, 3])
    if channels > 1:
        assert np.array_equal(read_deep_png(tmp_path / "deep.png"), values[:12])
    write_deep(tmp_path / "whole.png", values)
    linear = read_picture(tmp_path / "whole.png")
    assert linear.dtype == np.float32
    back = np.rint(linear_to_srgb(linear.astype(float)) * 65535)
    colours = values[..., :3] if channels > 2 else values[..., :1]
    assert np.array_equal(back, np.broadcast_to(colours, back.shape))


def test_sixteen_bits_are_not_eight(tmp_path):
    """Neighbouring values differ."""
    write_deep(tmp_path / "deep.png", np.array([[[32768, 0, 0], [32769, 0, 0]]], np.uint16))
    image = read_picture(tmp_path / "deep.png")
    assert image[0, 0, 0] < image[0, 1, 0]


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "PA", "CMYK"])
def test_modes(tmp_path, mode):
    """A grey picture, half of it half transparent: any mode says the same of it."""
    grey = Image.fromarray(np.array([[0, 255], [255, 0]], np.uint8))
    image = grey.convert("RGBA").convert(mode) if mode == "PA" else grey.convert(mode)
    if mode in ("LA", "RGBA"):
        image.putalpha(Image.fromarray(np.array([[255, 128], [255, 0]], np.uint8)))
    path = tmp_path / ("picture.tif" if mode in ("CMYK", "PA") else "picture.png")
    if mode == "PA":
        image = image.convert("P")
    image.save(path)
    share = 128 / 255 if mode in ("LA", "RGBA") else 1.0
    assert read_picture(path)[..., 1] == pytest.approx(np.array([[0, share], [1, 0]]), rel=1e-6)


def test_a_palette_with_transparent_colours(tmp_path):
    image = Image.new("P", (2, 1))
    image.putpalette([255, 255, 255, 0, 255, 0])
    image.putdata([0, 1])
    image.save(tmp_path / "palette.png", transparency=0)
    assert read_picture(tmp_path / "palette.png").tolist() == [[[0, 0, 0], [0, 1, 0]]]


@pytest.mark.parametrize("names", ["RGB", "RGBA", "Y", "A"])
def test_exr_is_linear(tmp_path, rng, names):
    """Float values as they are, also above 1; grey three times; alpha is in the colours already."""
    values = {name: rng.uniform(0, 5, (3, 4)).astype(np.float32) for name in names}
    write_exr(tmp_path / "light.exr", values)
    expected = [values[name] for name in ("RGB" if "R" in names else names * 3)]
    assert np.array_equal(read_picture(tmp_path / "light.exr"), np.stack(expected, axis=-1))


def test_half_floats(tmp_path):
    write_exr(tmp_path / "half.exr", {name: np.full((2, 2), 0.1, np.float16) for name in "RGB"})
    assert (read_picture(tmp_path / "half.exr") == np.float32(np.float16(0.1))).all()


@pytest.mark.parametrize("kind", ["other", "nan", "cut"])
def test_bad_exr(tmp_path, kind):
    path, ones = tmp_path / "bad.exr", np.ones((8, 8), np.float32)
    ones[0, 0] = np.nan if kind == "nan" else 1
    write_exr(path, dict.fromkeys(("depth",) if kind == "other" else "RGB", ones))
    if kind == "cut":
        path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(BadInput, match="bad.exr") as caught:
        read_picture(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["cut", "interlaced", "filter", "huge"])
def test_bad_deep_png(tmp_path, rng, kind):
    path, values = tmp_path / "bad.png", rng.integers(0, 65536, (5, 6, 3)).astype(np.uint16)
    write_deep(path, values, interlaced=int(kind == "interlaced"))
    data = bytearray(path.read_bytes())
    if kind == "cut":
        data = data[:80]
    elif kind == "huge":
        data[16:24] = struct.pack(">II", 2**31 - 1, 2**31 - 1)
    elif kind == "filter":
        rows = bytearray(zlib.decompress(data[41:61] + data[73:-16]))
        rows[0] = 9
        data = data[:33] + chunk(b"IDAT", zlib.compress(bytes(rows)))
    path.write_bytes(bytes(data))
    with pytest.raises(BadInput, match="bad.png"):
        read_picture(path)
