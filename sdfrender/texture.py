"""Textures as mip pyramids in linear light (Williams 1983; Galim 2018, section 4.3).

In: an image file. Out: a `Texture`, and for texture coordinates and a level of detail the filtered colour: of one
texel (`point`), of one level (`bilinear`), between two levels (`trilinear`, the report's way).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, UnidentifiedImageError

from sdfbake.complaint import BadInput
from sdfbake.engine import Array, Engine

Colour = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A mip pyramid.

    Attributes
    ----------
    levels
        Images (h, w, 3), float32, linear light, first row on top; each half the size of the one before, down to 1x1.
    """

    levels: tuple[Float[np.ndarray, "_ _ 3"], ...]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the finest level, texels."""
        height, width, _ = self.levels[0].shape
        return width, height

    @staticmethod
    def load(path: str | Path) -> "Texture":
        """Read an 8-bit image and build its pyramid.

        Raises
        ------
        BadInput
            If there is no such file, or it is no image.
        """
        try:
            with Image.open(path) as image:
                pixels = np.asarray(image.convert("RGB"), np.uint8)
        except FileNotFoundError:
            raise BadInput(f"there is no texture {path}: correct the path, or make it first") from None
        except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
            raise BadInput(f"{path} cannot be read as an image ({error}): give a PNG or JPEG file") from None
        return Texture.of(srgb_to_linear(pixels / np.float32(255)))

    @staticmethod
    def of(image: Float[np.ndarray, "h w 3"]) -> "Texture":
        """Build the pyramid of an image in linear light; every level is the exact box average of the one before."""
        levels = [np.ascontiguousarray(image, np.float32)]
        while max(levels[-1].shape[:2]) > 1:
            levels.append(_half(levels[-1]))
        return Texture(tuple(levels))


def srgb_to_linear(values: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Undo the sRGB transfer curve (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Apply the sRGB transfer curve to values from 0 to 1."""
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * np.maximum(values, 0.0031308) ** (1 / 2.4) - 0.055)


def _half(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h2 w2 3"]:
    """Average by area: of 2 m + 1, each of the m texels takes its 2 + 1 / m (Pillow's box takes whole ones)."""
    for axis in (0, 1):
        rows = np.moveaxis(image, axis, 0).astype(np.float64)
        count = max(len(rows) // 2, 1)
        sums = np.concatenate([np.zeros_like(rows[:1]), np.cumsum(rows, axis=0)])
        edges = np.arange(count + 1) * (len(rows) / count)
        whole = np.minimum(edges.astype(int), len(rows) - 1)
        upto = sums[whole] + (edges - whole)[:, None, None] * rows[whole]
        image = np.moveaxis(np.diff(upto, axis=0) * (count / len(rows)), 0, axis)
    return np.ascontiguousarray(image, np.float32)


class Sampler:
    """A texture on an engine.

    Parameters
    ----------
    xp
        The engine.
    texture
        The pyramid.
    filtering
        `point`, `bilinear` or `trilinear`; the first two look at the finest level only and need no footprint.
    wrap
        What lies outside [0, 1]: the border's colour (`clamp`) or the image again (`repeat`).
    """

    def __init__(self, xp: Engine, texture: Texture, filtering: str, wrap: str) -> None:
        self.filtering, self.wrap = filtering, wrap
        self.size = texture.size
        levels = texture.levels if filtering == "trilinear" else texture.levels[:1]
        texels = np.concatenate([level.reshape(-1, 3) for level in levels])
        self._channels = [xp.table(texels[:, c]) for c in range(3)]
        self._widths = xp.table(np.array([level.shape[1] for level in levels], np.int32))
        self._heights = xp.table(np.array([level.shape[0] for level in levels], np.int32))
        counts = [level.shape[0] * level.shape[1] for level in levels]
        self._starts = xp.table(np.cumsum([0, *counts[:-1]]).astype(np.int32))
        self._top = xp.uniform(len(levels) - 1)

    @property
    def needs_footprint(self) -> bool:
        """Whether a level of detail is asked for."""
        return self.filtering == "trilinear"

    def colour(self, xp: Engine, u: Array, v: Array, lod: Array | None, active: Array) -> Colour:
        """Look up the filtered colour; the level of detail is clamped to the pyramid here and nowhere else."""
        if self.filtering == "trilinear":
            assert lod is not None
            lod = xp.minimum(xp.maximum(lod, 0.0), xp.real(self._top))
            finer = xp.integer(lod)
            coarser = xp.minimum(finer + 1, self._top)
            share = lod - xp.real(finer)
            a, b = self._bilinear(xp, u, v, finer, active), self._bilinear(xp, u, v, coarser, active)
            return tuple(xp.fma(share, q - p, p) for p, q in zip(a, b, strict=True))
        level = xp.full(u, 0)
        return (
            self._bilinear(xp, u, v, level, active) if self.filtering == "bilinear" else self._point(xp, u, v, active)
        )

    def _point(self, xp: Engine, u: Array, v: Array, active: Array) -> Colour:
        width, height = (xp.gather(table, xp.full(u, 0), active) for table in (self._widths, self._heights))
        x, y = xp.integer(xp.floor(u * xp.real(width))), xp.integer(xp.floor((1.0 - v) * xp.real(height)))
        return self._texel(xp, self._wrapped(xp, x, width), self._wrapped(xp, y, height), width, xp.full(u, 0), active)

    def _bilinear(self, xp: Engine, u: Array, v: Array, level: Array, active: Array) -> Colour:
        width, height, start = (
            xp.gather(table, level, active) for table in (self._widths, self._heights, self._starts)
        )
        x, y = u * xp.real(width) - 0.5, (1.0 - v) * xp.real(height) - 0.5
        left, top = xp.floor(x), xp.floor(y)
        across, down = x - left, y - top
        columns = [self._wrapped(xp, xp.integer(left) + o, width) for o in (0, 1)]
        rows = [self._wrapped(xp, xp.integer(top) + o, height) for o in (0, 1)]
        a, b, c, d = (self._texel(xp, i, j, width, start, active) for j in rows for i in columns)

        def mix(a: Array, b: Array, c: Array, d: Array) -> Array:
            upper, lower = xp.fma(across, b - a, a), xp.fma(across, d - c, c)
            return xp.fma(down, lower - upper, upper)

        return mix(a[0], b[0], c[0], d[0]), mix(a[1], b[1], c[1], d[1]), mix(a[2], b[2], c[2], d[2])

    def _wrapped(self, xp: Engine, index: Array, count: Array) -> Array:
        if self.wrap == "clamp":
            return xp.minimum(xp.maximum(index, 0), count - 1)
        shifted = xp.real(index) - xp.real(count) * xp.floor(xp.real(index) / xp.real(count))
        return xp.minimum(xp.maximum(xp.integer(shifted), 0), count - 1)

    def _texel(self, xp: Engine, x: Array, y: Array, width: Array, start: Array, active: Array) -> Colour:
        index = start + y * width + x
        r, g, b = (xp.gather(channel, index, active) for channel in self._channels)
        return r, g, b
