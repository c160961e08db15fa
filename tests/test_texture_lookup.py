"""Texture look-ups: pyramids against NumPy's means, filters against values by hand, both engines."""

import itertools

import numpy as np
import pytest

from sdfrender.texture import Checker, Sampler, Texture


@pytest.fixture
def picture(rng):
    """Random texels, 8 wide and 4 high."""
    return rng.uniform(size=(4, 8, 3)).astype(np.float32)


def look(engine, texture, uv, lod=None, filtering="trilinear", wrap="clamp"):
    """Colours (n, 3) at texture coordinates (n, 2)."""
    uv = np.atleast_2d(np.asarray(uv, float))
    lod = np.broadcast_to(0.0 if lod is None else np.asarray(lod, float), len(uv))
    sampler = Sampler(engine, texture, filtering, wrap)

    def program(xp, u, v, lod):
        level = lod if sampler.needs_footprint else None
        return dict(zip("rgb", sampler.colour(xp, u, v, level, xp.full(u, True)), strict=True))

    out = engine.run(program, [*uv.T, lod])
    return np.stack([out[c] for c in "rgb"], axis=-1).astype(float)


def centre(column, row, width, height):
    """Texture coordinates of a texel's centre; row 0 is the top one, where v is near 1."""
    return (column + 0.5) / width, 1 - (row + 0.5) / height


def test_levels_are_box_averages(picture):
    """Of a power of two: the mean of 2x2 texels, so the picture's mean stays. Float32 rounds to 6e-8 per level."""
    levels = Texture.of(picture).levels
    assert [level.shape[:2] for level in levels] == [(4, 8), (2, 4), (1, 2), (1, 1)]
    for fine, coarse in itertools.pairwise(levels):
        h, w, _ = coarse.shape
        blocks = fine.astype(float).reshape(h, fine.shape[0] // h, w, fine.shape[1] // w, 3)
        assert np.abs(coarse - blocks.mean(axis=(1, 3))).max() < 1.2e-7
        assert np.abs(coarse.mean(axis=(0, 1)) - picture.mean(axis=(0, 1))).max() < 4e-7
        assert coarse.dtype == np.float32


@pytest.mark.parametrize("size", [(5, 3), (7, 1), (1, 1), (17, 30)], ids=str)
def test_a_constant_stays_constant(size):
    levels = Texture.of(np.full((*size, 3), 0.37, np.float32)).levels
    assert levels[-1].shape == (1, 1, 3)
    assert all(np.abs(level - np.float32(0.37)).max() < 1e-7 for level in levels)


def test_odd_sizes_average_by_area():
    """Three texels into one weigh a third each; five into two weigh 1, 1, 1/2 of 5/2."""
    row = np.array([1.0, 2, 4, 8, 16], np.float32)[None, :, None] + np.zeros((1, 1, 3), np.float32)
    levels = Texture.of(row).levels
    assert levels[1][0, :, 0] == pytest.approx([(1 + 2 + 2) / 2.5, (2 + 8 + 16) / 2.5], rel=1e-6)


@pytest.mark.parametrize("size", [(5, 3), (1, 100), (37, 50), (255, 64)], ids=str)
def test_every_level_has_the_mean_of_the_image(size, rng):
    """Sums are exact to float64; a level's float32 rounds by 6e-8 per texel, over 8 levels at worst."""
    image = rng.uniform(size=(*size, 3)).astype(np.float32)
    for level in Texture.of(image).levels:
        assert level.mean(axis=(0, 1), dtype=float) == pytest.approx(image.mean(axis=(0, 1), dtype=float), abs=5e-7)


def test_the_first_row_is_the_top(picture, choice):
    """v = 1 shows row 0, v = 0 the last one; u = 0 shows column 0."""
    texture = Texture.of(picture)
    for filtering in ("point", "bilinear", "trilinear"):
        got = look(choice.engine, texture, [(0, 1), (1, 1), (0, 0), (1, 0)], filtering=filtering)
        assert np.array_equal(got, picture[[0, 0, -1, -1], [0, -1, 0, -1]])


@pytest.mark.parametrize("filtering", ["point", "bilinear", "trilinear"])
def test_texels_come_back_at_their_centres(picture, choice, filtering):
    row, column = (index.ravel() for index in np.mgrid[0:4, 0:8])
    got = look(choice.engine, Texture.of(picture), np.stack(centre(column, row, 8, 4), axis=-1), filtering=filtering)
    # Texel coordinates up to 8 round to 8 eps / 2, once more for the division; colours differ by up to 1.
    assert np.abs(got - picture[row, column]).max() < 16 * choice.engine.eps


def test_bilinear_by_hand(choice):
    """A texel pattern of 0, 1, 2, 3: a quarter of the way across, and half way down."""
    image = np.array([[0, 1], [2, 3]], np.float32)[..., None] + np.zeros(3, np.float32)
    uv = [(0.375, 0.75), (0.5, 0.5), (0.5, 0.625), (0.25, 0.5)]
    got = look(choice.engine, Texture.of(image), uv, filtering="bilinear")
    assert got[:, 0] == pytest.approx([0.25, 1.5, 1.0, 1.0], abs=16 * choice.engine.eps)


def test_trilinear_is_linear_between_levels(picture, choice, rng):
    """Whole levels are the bilinear look-up in that level's image; between, the share of each is lod's fraction."""
    texture = Texture.of(picture)
    uv = rng.uniform(0, 1, (100, 2))
    whole = [look(choice.engine, Texture((level,)), uv, filtering="bilinear") for level in texture.levels]
    tolerance = 32 * choice.engine.eps
    for level, expected in enumerate(whole):
        assert np.abs(look(choice.engine, texture, uv, level) - expected).max() < tolerance
    for lod in (0.25, 1.5, 2.9):
        finer = int(lod)
        expected = whole[finer] + (lod - finer) * (whole[finer + 1] - whole[finer])
        assert np.abs(look(choice.engine, texture, uv, lod) - expected).max() < tolerance


@pytest.mark.parametrize(("lod", "level"), [(-3.0, 0), (-1e30, 0), (99.0, 3), (3.0, 3)])
def test_levels_end_at_both_ends(picture, choice, lod, level):
    texture, uv = Texture.of(picture), [(0.3, 0.6), (0.9, 0.1)]
    expected = look(choice.engine, texture, uv, float(level))
    assert np.array_equal(look(choice.engine, texture, uv, lod), expected)


@pytest.mark.parametrize("filtering", ["point", "bilinear"])
def test_clamping_shows_the_border(picture, choice, filtering):
    texture = Texture.of(picture)
    got = look(choice.engine, texture, [(-0.7, 2.0), (3.0, -4.0), (-1e4, 0.5 / 4)], filtering=filtering)
    assert np.array_equal(got, picture[[0, -1, -1], [0, -1, 0]])


@pytest.mark.parametrize("filtering", ["point", "bilinear", "trilinear"])
@pytest.mark.parametrize("shift", [(1, 0), (0, -1), (-3, 5)], ids=str)
def test_repeating_shows_the_picture_again(picture, choice, rng, filtering, shift):
    """Whole shifts change nothing but the rounding of the coordinates, eps times 6 times 8 texels, slope 2."""
    texture, uv = Texture.of(picture), rng.integers(0, 64, (200, 2)) / 64 + 1 / 128
    lod = 0.5 if filtering == "trilinear" else None
    here = look(choice.engine, texture, uv, lod, filtering, "repeat")
    there = look(choice.engine, texture, uv + shift, lod, filtering, "repeat")
    assert np.abs(here - there).max() < 6 * 8 * 4 * choice.engine.eps


def test_repeating_blends_across_the_border(choice):
    """Half way between the last texel and the first of the next copy."""
    image = np.array([[0, 1, 5, 7]], np.float32)[..., None] + np.zeros(3, np.float32)
    got = look(choice.engine, Texture.of(image), [(0, 0.5), (1, 0.5), (-2, 0.5)], filtering="bilinear", wrap="repeat")
    assert got[:, 0] == pytest.approx([3.5] * 3, abs=64 * choice.engine.eps)


@pytest.mark.parametrize("filtering", ["point", "bilinear"])
def test_mirroring_turns_back(picture, choice, filtering):
    """Beyond u = 1 comes the last column again, then the one before it."""
    texture = Texture.of(picture)
    outside = [centre(8 + i, 1, 8, 4) for i in range(8)] + [centre(3, 4 + j, 8, 4) for j in range(4)]
    inside = [centre(7 - i, 1, 8, 4) for i in range(8)] + [centre(3, 3 - j, 8, 4) for j in range(4)]
    got = look(choice.engine, texture, outside, filtering=filtering, wrap="mirror")
    assert np.abs(got - look(choice.engine, texture, inside, filtering=filtering)).max() < 64 * choice.engine.eps


def test_what_was_clamped_is_said(choice):
    """A footprint of a texel is level 0, one of the picture the last one."""
    sampler = Sampler(choice.engine, Texture.of(np.ones((8, 8, 1), np.float32)), "trilinear", "clamp")
    wide = np.array([0.9, 1.0, 7.9, 8.1]) / 8

    def program(xp, wide):
        zero = xp.full(wide, 0.0)
        found = sampler.look_up(xp, zero, zero, ((wide, zero), (zero, wide)), wide > 0)
        return {name: xp.integer(getattr(found, name)) for name in ("below", "above", "capped")}

    out = choice.engine.run(program, [wide])
    assert list(out["below"]) == [1, 0, 0, 0] and list(out["above"]) == [0, 0, 0, 1] and not out["capped"].any()


def check(engine, checker, uv, dx, dy):
    """Share of the second colour, which is 1, of a checker's first, which is 0."""

    def program(xp, u, v, a, b, c, d):
        return {"r": checker.look_up(xp, u, v, ((a, b), (c, d)), xp.full(u, True)).colour[0]}

    return engine.run(program, [np.ascontiguousarray(c, float) for c in (*uv.T, *dx.T, *dy.T)])["r"]


BLACK_WHITE = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


def test_checkers_by_brute_force(choice, rng):
    """Means over 200 x 200 points of the box: an edge is off by half a point, on either axis."""
    n, squares = 60, np.array([8, 6])
    uv, dx, dy = rng.uniform(-2, 3, (n, 2)), *(rng.normal(size=(2, n, 2)) * 10.0 ** rng.uniform(-3, -0.5, (1, n, 1)))
    got = check(choice.engine, Checker(BLACK_WHITE, (8, 6)), uv, dx, dy)
    steps = (np.arange(200) + 0.5) / 200 - 0.5
    box = (np.abs(dx) + np.abs(dy))[:, None] * steps[None, :, None]
    column, row = np.moveaxis(np.floor((uv[:, None] + box) * squares), -1, 0)
    exact = np.mean((column[:, :, None] + row[:, None, :]) % 2, axis=(1, 2))
    # Per edge 1/400 of the mean; the widest box has two edges per square of 12.
    edges = 1 + np.sum((np.abs(dx) + np.abs(dy)) * squares, axis=1)
    assert (np.abs(got - exact) < (edges + 1) / 400 + 300 * choice.engine.eps / box.max(axis=(1, 2)).min()).all()


def test_checkers_by_hand(choice):
    """The square at the origin has the first colour; an edge is half way; very wide footprints are grey."""
    uv = np.array([[0.1, 0.1], [0.3, 0.1], [0.3, 0.3], [0.25, 0.1], [0.125, 0.125], [0.1, 0.1], [0.1, 0.1], [0.2, 0.1]])
    dx = np.array([[0, 0], [0, 0], [0, 0], [0.1, 0], [0.25, 0], [1e30, 0], [0.5, 0.0], [0.2, 0.0]])
    got = check(choice.engine, Checker(BLACK_WHITE, (4, 4)), uv, dx, np.zeros((8, 2)))
    # The last one: from 0.1 to 0.3, a quarter of it in the second square.
    assert got == pytest.approx([0, 1, 0, 0.5, 0, 0.5, 0.5, 0.25], abs=1e-6)
