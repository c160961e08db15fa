"""The texels of pyramids on an engine: what lies where, also outside the picture.

In: images by level. Out: for texture coordinates and a level the nearest texel, or the bilinear mean of four. Texel
centres are at half-integers; coordinates are brought into range before they become integers.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine

Colour = tuple[Array, ...]
Pair = tuple[Array, Array]
Wrap = Literal["clamp", "repeat", "mirror", "sphere"]
FAR = 1024.0  # pictures: no footprint reaches back from there, and 2^16 texels of each are still integers


class Size(NamedTuple):
    """Width and height of a level, and the number of its first texel."""

    width: Array
    height: Array
    start: Array


class Look(NamedTuple):
    """What a look-up found.

    Attributes
    ----------
    colour
        Linear light, one array per channel.
    below
        The footprint is smaller than a texel of the finest level: the texture is magnified.
    above
        The footprint is larger than the pyramid's last level can say.
    capped
        The footprint is longer than is averaged: an ellipse's minor axis was widened, or a turn around a pole is all.
    """

    colour: Colour
    below: Array
    above: Array
    capped: Array


class Texels:
    """Images as tables.

    Parameters
    ----------
    xp
        The engine.
    levels
        Images (h, w, channels), all of as many channels.
    wrap
        What lies outside [0, 1]: the border's colour (`clamp`), the image again (`repeat`), the image mirrored
        (`mirror`); or the image around a sphere, which repeats in u, and beyond a pole comes back half a turn away
        (`sphere`).
    first
        The first level whose texels are kept; of those before it only the sizes are known.
    """

    def __init__(self, xp: Engine, levels: Sequence[Float[np.ndarray, "_ _ c"]], wrap: Wrap, first: int = 0) -> None:
        self.wrap = wrap
        texels = np.concatenate([level.reshape(-1, level.shape[2]) for level in levels[first:]])
        self._channels = [xp.table(texels[:, c]) for c in range(texels.shape[1])]
        self._widths = xp.table(np.array([level.shape[1] for level in levels], np.int32))
        self._heights = xp.table(np.array([level.shape[0] for level in levels], np.int32))
        counts = [level.shape[0] * level.shape[1] if k >= first else 0 for k, level in enumerate(levels)]
        self._starts = xp.table(np.cumsum([0, *counts[:-1]]).astype(np.int32))

    @property
    def channels(self) -> int:
        """The number of channels."""
        return len(self._channels)

    def size(self, xp: Engine, level: Array, active: Array) -> Size:
        """Return the size of a level."""
        return Size(*(xp.gather(table, level, active) for table in (self._widths, self._heights, self._starts)))

    def place(self, xp: Engine, u: Array, v: Array, size: Size) -> tuple[Array, Array]:
        """Return the place in texels from the centre of the first one, x to the right, y down, brought near."""
        u, v = self._near(xp, u, upright=False), self._near(xp, v, upright=True)
        return u * xp.real(size.width) - 0.5, (1.0 - v) * xp.real(size.height) - 0.5

    def nearest(self, xp: Engine, u: Array, v: Array, level: Array, active: Array) -> Colour:
        """Return the texel that a point is in."""
        size = self.size(xp, level, active)
        x, y = self.place(xp, u, v, size)
        return self.texel(xp, xp.integer(xp.floor(x + 0.5)), xp.integer(xp.floor(y + 0.5)), size, active)

    def bilinear(self, xp: Engine, u: Array, v: Array, level: Array, active: Array) -> Colour:
        """Return the bilinear mean of the four texels around a point."""
        size = self.size(xp, level, active)
        x, y = self.place(xp, u, v, size)
        left, top = xp.floor(x), xp.floor(y)
        across, down = x - left, y - top
        columns = [xp.integer(left) + step for step in (0, 1)]
        rows = [xp.integer(top) + step for step in (0, 1)]
        corners = [self.texel(xp, i, j, size, active) for j in rows for i in columns]

        def mix(a: Array, b: Array, c: Array, d: Array) -> Array:
            upper, lower = xp.fma(across, b - a, a), xp.fma(across, d - c, c)
            return xp.fma(down, lower - upper, upper)

        return tuple(mix(*values) for values in zip(*corners, strict=True))

    def texel(self, xp: Engine, x: Array, y: Array, size: Size, active: Array) -> Colour:
        """Return a texel by column and row, which may lie outside."""
        column, row = x, y
        if self.wrap == "sphere":
            beyond = (y < 0) | (y >= size.height)
            column = xp.where(beyond, x + (size.width >> 1), x)
        column = _wrapped(xp, column, size.width, "repeat" if self.wrap == "sphere" else self.wrap)
        row = _wrapped(xp, row, size.height, "mirror" if self.wrap == "sphere" else self.wrap)
        index = size.start + row * size.width + column
        return tuple(xp.gather(channel, index, active) for channel in self._channels)

    def _near(self, xp: Engine, x: Array, *, upright: bool) -> Array:
        if self.wrap == "clamp" or (self.wrap == "sphere" and upright):
            return xp.minimum(xp.maximum(x, -FAR), FAR)
        if self.wrap == "mirror":
            return x - 2.0 * xp.floor(0.5 * x)
        return x - xp.floor(x)


def _wrapped(xp: Engine, index: Array, count: Array, wrap: Wrap) -> Array:
    """Return the index inside; the last step keeps rounding, and numbers that are none, from reaching outside."""
    if wrap != "clamp":
        period = xp.real(count if wrap == "repeat" else count + count)
        index = xp.integer(xp.real(index) - period * xp.floor(xp.real(index) / period))
        if wrap == "mirror":
            index = xp.where(index < count, index, count + count - 1 - index)
    return xp.minimum(xp.maximum(index, 0), count - 1)
