"""Filtered look-ups in an image (Williams 1983; Greene and Heckbert 1986; Galim 2018, section 4.3).

In: a texture, texture coordinates with their footprint. Out: the colour of one texel (`point`), of the finest level
(`bilinear`), between two levels (`trilinear`, the report's way), of an ellipse (`anisotropic`); and what was clamped.
"""

from typing import Literal

from sdfbake.engine import Array, Engine
from sdfrender.anisotropic import Pyramid, elliptical
from sdfrender.footprint import level_of_detail
from sdfrender.pyramid import Texture
from sdfrender.texels import Colour, Look, Pair, Texels, Wrap

Filter = Literal["point", "bilinear", "trilinear", "anisotropic"]
MOST_ANISOTROPIC = 16.0


class Sampler:
    """A texture on an engine.

    Parameters
    ----------
    xp
        The engine.
    texture
        The pyramid.
    filtering
        `point`, `bilinear`, `trilinear` or `anisotropic`; the first two look at the finest level only and need no
        footprint.
    wrap
        What lies outside [0, 1]: the border's colour (`clamp`), the image again (`repeat`), or mirrored (`mirror`).
    most
        Greatest ratio of the ellipse's axes for `anisotropic`; beyond it the minor axis is widened.
    first
        The first level that any look-up with a footprint reaches (`sdfrender.mips`): finer ones are not kept.
    """

    def __init__(
        self,
        xp: Engine,
        texture: Texture,
        filtering: Filter,
        wrap: Wrap,
        most: float = MOST_ANISOTROPIC,
        *,
        first: int = 0,
    ) -> None:
        self.filtering, self.size, self.most = filtering, texture.size, most
        levels = texture.levels if self.needs_footprint else texture.levels[:1]
        first = first if self.needs_footprint else 0
        self._texels = Texels(xp, levels, wrap, first)
        self._first, self._top = xp.uniform(first), xp.uniform(len(levels) - 1)

    @property
    def needs_footprint(self) -> bool:
        """Whether the colour depends on the footprint."""
        return self.filtering in ("trilinear", "anisotropic")

    def look_up(self, xp: Engine, u: Array, v: Array, footprint: tuple[Pair, Pair] | None, active: Array) -> Look:
        """Look up the filtered colour; what a footprint asks for is clamped here and nowhere else.

        Parameters
        ----------
        xp
            The engine.
        u, v
            Texture coordinates.
        footprint
            duv_dx and duv_dy per pixel; not read where `needs_footprint` is false.
        active
            Who asks; the others get numbers without a meaning.
        """
        never = xp.full(u, False)
        if not self.needs_footprint:
            return Look(self.colour(xp, u, v, None, active), never, never, never)
        assert footprint is not None
        if self.filtering == "anisotropic":
            pyramid = Pyramid(xp.full(u, 0), xp.full(u, 0) + self._top, self._first)
            return elliptical(xp, self._texels, pyramid, (u, v), footprint, active, most=self.most, linear=True)
        width, height = (xp.uniform(float(count)) for count in self.size)
        lod = level_of_detail(xp, *footprint, (width, height))
        above = active & (lod > xp.real(self._top))
        return Look(self.colour(xp, u, v, lod, active), active & (lod < 0), above, never)

    def colour(self, xp: Engine, u: Array, v: Array, lod: Array | None, active: Array) -> Colour:
        """Look up by a level of detail, which is clamped to the pyramid; not for `anisotropic`."""
        level = xp.full(u, 0)
        if self.filtering == "point":
            return self._texels.nearest(xp, u, v, level, active)
        if self.filtering == "bilinear":
            return self._texels.bilinear(xp, u, v, level, active)
        assert lod is not None
        lod = xp.minimum(xp.maximum(lod, xp.real(self._first)), xp.real(self._top))
        finer = xp.integer(lod)
        coarser = xp.minimum(finer + 1, self._top)
        a, b = (self._texels.bilinear(xp, u, v, level, active) for level in (finer, coarser))
        return _mixed(xp, a, b, lod - xp.real(finer))


def _mixed(xp: Engine, a: Colour, b: Colour, share: Array) -> Colour:
    return tuple(xp.fma(share, q - p, p) for p, q in zip(a, b, strict=True))
