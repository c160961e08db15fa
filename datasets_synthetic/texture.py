"""Textures drawn by rule: a page of text, a checker, a zone plate.

In: a name. Out: (height, width, 3) uint8 in sRGB, first row on top; or the same as a PNG file.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from sdfbake.atomic import replacing
from sdfbake.complaint import BadInput

SIZE = 1024
_MARGIN = 72
#: Type size in texels and text. The last ones are about as fine as the texels: a renderer without footprints turns
#: them to noise.
_PAGE = (
    (84, "Ray differentials"),
    (44, "How wide is a ray of light?"),
    (
        30,
        "A picture asks one question per pixel, and a ray answers for a single point. Between that point and its "
        "neighbour lies everything the ray did not see. A ray differential keeps the answer honest: beside the ray it "
        "carries two small arrows that say where the ray would have gone, had the pixel been one step to the right, "
        "or one step down.",
    ),
    (44, "Through the looking glass"),
    (
        25,
        "On a flat mirror the arrows only turn around. On a round one they spread, because the normal turns as the "
        "point moves, and how fast it turns is the curvature of the surface. A distance field knows its curvature "
        "without being told: the gradient is the normal, and the derivative of the gradient, nine numbers of which "
        "six are different, says how the normal will turn.",
    ),
    (
        18,
        "When the arrows arrive on a page like this one, they frame a small slanted window. Inside of it no letter "
        "can be told from another, so the right colour for the pixel is the mean of the window: black and white in "
        "the share of ink to paper. A window of half a letter keeps the word readable. A window of ten lines leaves "
        "an even grey. Take it too small and the letters crawl whenever the eye moves; take it too large and the "
        "page is fog.",
    ),
    (
        12,
        "Small print. The terms of this page are that it is read in a mirror, and that it is too fine to be read. "
        "Whoever can make out these words in a picture of a picture has either very many samples or a very flat "
        "mirror. Lines of this size alternate between ink and paper about every eight texels, which is close to what "
        "a texture can hold at all, and far beyond what a curved mirror will give back near its rim. There the "
        "windows grow long and thin, and no square window fits: either it blurs along the line, or it aliases across.",
    ),
    (
        9,
        "Smaller print still, for the edge of the sphere. Each letter here is five texels wide and as many high. One "
        "step down the mip pyramid it is a blot, two steps down a shade. If a pixel in this paragraph is not grey, "
        "then it is either close to the eye or wrong. The quick test is to move by half a pixel and to look whether "
        "the paragraph boils. The slow test is to take sixty-four rays for every pixel and to compare.",
    ),
)


def textures() -> tuple[str, ...]:
    """Names of all textures."""
    return tuple(_RULES)


def texture(name: str) -> UInt8[np.ndarray, "h w 3"]:
    """Draw a texture.

    Parameters
    ----------
    name
        One of `textures()`: `page` (text of many sizes on white), `checker` (32-texel squares), `zone` (a zone plate
        that reaches the Nyquist frequency in the middle of each side).

    Returns
    -------
    array
        (1024, 1024, 3) uint8, sRGB, first row on top; the same numbers every time.

    Raises
    ------
    BadInput
        For an unknown name.

    Examples
    --------
    >>> texture("checker").shape
    (1024, 1024, 3)
    """
    if name not in _RULES:
        raise BadInput(f"there is no texture named {name!r}: choose one of {', '.join(_RULES)}")
    grey = np.rint(255 * _RULES[name]()).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


def save_texture(name: str, path: str | Path) -> None:
    """Write a texture as PNG: whole or not at all, the same bytes for the same name.

    Raises
    ------
    BadInput
        For an unknown name, a file name that does not end in .png, or a folder that cannot be written.
    """
    from PIL import Image  # only drawing and writing need it

    if Path(path).suffix.lower() != ".png":
        raise BadInput(f"textures are written as PNG: let {path} end in .png")
    image = Image.fromarray(texture(name))
    with replacing(path) as temporary:
        image.save(temporary, format="PNG", compress_level=9)


def _page() -> Float[np.ndarray, "h w"]:
    """Text in Pillow's own scalable font, so that no font file is looked for."""
    from PIL import Image, ImageDraw, ImageFont

    page = Image.new("L", (SIZE, SIZE), 255)
    draw = ImageDraw.Draw(page)
    top = float(_MARGIN)
    for size, text in _PAGE:
        font = ImageFont.load_default(size=size)
        for line in _lines(text, font.getlength, SIZE - 2 * _MARGIN):
            draw.text((_MARGIN, top), line, fill=0, font=font)
            top += round(1.3 * size)
        top += 16
    return np.asarray(page, np.float64) / 255


def _lines(text: str, width: Callable[[str], float], limit: float) -> list[str]:
    """Break `text` at blanks into lines no wider than `limit`."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if width(longer) <= limit:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _checker() -> Float[np.ndarray, "h w"]:
    """White in the upper left corner; the mean in linear light is exactly 1/2."""
    square = np.arange(SIZE) // 32
    return 1.0 - (square[:, None] + square[None, :]) % 2


def _zone() -> Float[np.ndarray, "h w"]:
    """1/2 + cos(pi rho^2 / SIZE) / 2 in linear light: rho / SIZE periods per texel at rho texels from the middle."""
    middle = np.arange(SIZE) + 0.5 - SIZE / 2
    linear = 0.5 + 0.5 * np.cos(np.pi / SIZE * (middle[:, None] ** 2 + middle[None, :] ** 2))
    # The sRGB curve, IEC 61966-2-1.
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


_RULES = {"page": _page, "checker": _checker, "zone": _zone}
