"""Textures: what is on them, and how they are written."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datasets_synthetic import save_texture, texture, textures
from sdfbake.complaint import BadInput


@pytest.mark.parametrize("name", textures())
def test_textures_are_grey_srgb_squares_drawn_the_same_each_time(name: str) -> None:
    image = texture(name)
    assert image.shape == (1024, 1024, 3) and image.dtype == np.uint8
    assert np.ptp(image, axis=2).max() == 0
    assert image.min() == 0 and image.max() == 255
    assert np.array_equal(image, texture(name))


@pytest.mark.parametrize("name", textures())
def test_png_round_trip_with_the_same_bytes(name: str, tmp_path: Path) -> None:
    first, second = tmp_path / "a.png", tmp_path / "new" / "b.png"
    save_texture(name, first)
    save_texture(name, second)
    assert first.read_bytes() == second.read_bytes()
    with Image.open(first) as image:
        assert np.array_equal(np.asarray(image), texture(name))


def runs(row: np.ndarray) -> np.ndarray:
    """Lengths of the dark runs of a row of texels."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], row < 128, [0]])))
    lengths: np.ndarray = edges[1::2] - edges[::2]
    return lengths


def test_page_has_white_margins_and_print_that_shrinks_downwards() -> None:
    page = texture("page")[:, :, 0]
    for margin in (page[:60], page[-30:], page[:, :60], page[:, -60:]):
        assert margin.min() == 255
    ink = 1 - page.mean() / 255
    assert 0.05 < ink < 0.3
    inked = np.flatnonzero(page.min(axis=1) < 128)
    # Lines of print: first, and last. Strokes of the title are several texels wide, those of the last line are one.
    top, bottom = page[inked[0] : inked[0] + 60], page[inked[-1] - 6 : inked[-1] + 1]
    strokes = [np.median(np.concatenate([runs(row) for row in block])) for block in (top, bottom)]
    assert strokes[0] > 5 and strokes[1] < 3
    assert inked[-1] > 900, "the page is full"


def test_checker_squares() -> None:
    board = texture("checker")[:, :, 0]
    assert board[0, 0] == 255 and board[0, 32] == 0 and board[32, 0] == 0 and board[31, 31] == 255
    assert np.all(runs(board[5]) == 32)
    assert board.mean() == 127.5


def decoded(image: np.ndarray) -> np.ndarray:
    """Linear light of sRGB bytes, IEC 61966-2-1."""
    value = image / 255.0
    linear: np.ndarray = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return linear


def test_zone_plate_frequency_grows_with_the_radius() -> None:
    linear = decoded(texture("zone")[:, :, 0])
    assert np.array_equal(linear, linear[::-1]) and np.array_equal(linear, linear.T)
    # A window of 64 texels about 128, 256, 384 from the middle: the chirp sweeps 1/16 of a period per texel there, so
    # the energy's centre is at rho / 1024 within that.
    for rho in (128, 256, 384):
        window = (linear[512, 512 + rho - 32 : 512 + rho + 32] - 0.5) * np.hanning(64)
        power = np.abs(np.fft.rfft(window)) ** 2
        centre = np.sum(np.fft.rfftfreq(64) * power) / power.sum()
        assert centre == pytest.approx(rho / 1024, abs=1 / 128)
    # The mean of the cosine over many rings; the plate has sharp borders, worth one ring of 1/512 of the area.
    assert linear.mean() == pytest.approx(0.5, abs=5e-3)


def test_refusals_leave_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="choose one of page, checker, zone"):
        save_texture("plaid", tmp_path / "plaid.png")
    with pytest.raises(BadInput, match=r"end in \.png"):
        save_texture("page", tmp_path / "page.exr")
    assert list(tmp_path.iterdir()) == []
