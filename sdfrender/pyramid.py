"""Mip pyramids (Williams 1983).

In: an image in linear light. Out: its levels, each half the size of the one before, down to one texel. A texel is the
exact mean over its area, so every level has the image's mean; sizes need not be powers of two.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sdfrender.picture import read_picture


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A mip pyramid.

    Attributes
    ----------
    levels
        Images (h, w, channels), float32, linear light, first row on top; each half the size of the one before, down to
        1x1.
    """

    levels: tuple[Float[np.ndarray, "_ _ c"], ...]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the finest level, texels."""
        height, width, _ = self.levels[0].shape
        return width, height

    @staticmethod
    def load(path: str | Path) -> "Texture":
        """Read an image and build its pyramid; see `sdfrender.picture.read_picture`.

        Raises
        ------
        BadInput
            If there is no such file, or it is no image.
        """
        return Texture.of(read_picture(path))

    @staticmethod
    def of(image: Float[np.ndarray, "h w c"]) -> "Texture":
        """Build the pyramid of an image in linear light; every level is the exact box average of the one before."""
        levels = [np.ascontiguousarray(image, np.float32)]
        while max(levels[-1].shape[:2]) > 1:
            levels.append(halved(levels[-1]))
        return Texture(tuple(levels))


def halved(image: Float[np.ndarray, "h w c"], axes: tuple[int, ...] = (0, 1)) -> Float[np.ndarray, "h2 w2 c"]:
    """Average by area: of 2 m + 1, each of the m texels takes its 2 + 1 / m (Pillow's box takes whole ones).

    Parameters
    ----------
    image
        Any number of channels.
    axes
        Along which to halve; an axis of one texel stays.

    Returns
    -------
    image
        Float32; sums are taken in float64.
    """
    for axis in axes:
        rows = np.moveaxis(image, axis, 0).astype(np.float64)
        count = max(len(rows) // 2, 1)
        sums = np.concatenate([np.zeros_like(rows[:1]), np.cumsum(rows, axis=0)])
        edges = np.arange(count + 1) * (len(rows) / count)
        whole = np.minimum(edges.astype(int), len(rows) - 1)
        upto = sums[whole] + (edges - whole)[:, None, None] * rows[whole]
        image = np.moveaxis(np.diff(upto, axis=0) * (count / len(rows)), 0, axis)
    return np.ascontiguousarray(image, np.float32)
