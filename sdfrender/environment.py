"""Light from all around: a latitude-longitude picture, filtered by a ray's differential.

In: unit directions with their derivatives. Out: radiance, the mean over the footprint by solid angle: the texels are
multiplied by their solid angle, filtered, and divided by what the solid angle itself becomes. `sdfrender.latlong` says
which direction is where.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float

from sdfbake.complaint import BadInput
from sdfbake.engine import Array, Engine
from sdfrender.anisotropic import Pyramid, elliptical
from sdfrender.latlong import footprint, place
from sdfrender.pyramid import Texture, halved
from sdfrender.sampler import MOST_ANISOTROPIC
from sdfrender.texels import Look, Pair, Texels
from sdfrender.vector import Vector


class Environment:
    """A latitude-longitude picture on an engine.

    Towards the poles a round footprint is a wide one in the picture. So the pyramid exists for the picture, for the
    picture of half the width, and so on to one column: together 8/3 of its size. A look-up takes the one in which its
    footprint is still twice as wide as high.

    Parameters
    ----------
    xp
        The engine.
    image
        Radiance, linear, first row at the zenith.
    filtering
        `anisotropic`, or `bilinear`, which looks at the finest level only and needs no footprint.
    most
        As for `sdfrender.sampler.Sampler`.

    Raises
    ------
    BadInput
        If the image has fewer than two rows or columns.
    """

    def __init__(
        self,
        xp: Engine,
        image: Float[np.ndarray, "h w 3"],
        filtering: Literal["bilinear", "anisotropic"] = "anisotropic",
        most: float = MOST_ANISOTROPIC,
    ) -> None:
        if min(image.shape[:2]) < 2:
            raise BadInput(f"an environment of {image.shape[1]}x{image.shape[0]} texels has no directions: give a map")
        self.filtering, self.most = filtering, most
        self.size = (image.shape[1], image.shape[0])
        weighted = by_solid_angle(image)
        pyramids: list[tuple[np.ndarray, ...]] = [Texture.of(weighted).levels if self.needs_footprint else (weighted,)]
        while self.needs_footprint and weighted.shape[1] > 1:
            weighted = halved(weighted, axes=(1,))
            pyramids.append(Texture.of(weighted).levels)
        self._texels = Texels(xp, [level for levels in pyramids for level in levels], "sphere")
        last = np.cumsum([len(levels) for levels in pyramids], dtype=np.int32) - 1
        first = last + 1 - np.array([len(levels) for levels in pyramids], np.int32)
        self._first, self._last = xp.table(first), xp.table(last)
        self._narrowest = xp.uniform(len(pyramids) - 1)

    @property
    def needs_footprint(self) -> bool:
        """Whether the radiance depends on the footprint."""
        return self.filtering == "anisotropic"

    def look_up(self, xp: Engine, d: Vector, dd: tuple[Vector, Vector] | None, active: Array) -> Look:
        """Return the radiance from unit directions.

        Parameters
        ----------
        xp
            The engine.
        d
            Directions in which light is looked for, world frame.
        dd
            dd_dx and dd_dy per pixel; not read where `needs_footprint` is false.
        active
            Who asks; the others get numbers without a meaning.

        Returns
        -------
        Look
            `capped` also where a footprint around a pole was cut to one turn.
        """
        uv = place(xp, d)
        if not self.needs_footprint:
            never = xp.full(d[0], False)
            colour = self._texels.bilinear(xp, *uv, xp.full(d[0], 0), active)
            return Look(_divided(xp, colour), never, never, never)
        assert dd is not None
        turn = footprint(xp, d, *dd)
        narrow = self._narrowed(xp, turn.duv_dx, turn.duv_dy)
        pyramid = Pyramid(xp.gather(self._first, narrow, active), xp.gather(self._last, narrow, active))
        steps = (turn.duv_dx, turn.duv_dy)
        found = elliptical(xp, self._texels, pyramid, uv, steps, active, most=self.most, linear=False)
        return found._replace(colour=_divided(xp, found.colour), capped=found.capped | (active & turn.cut))

    def _narrowed(self, xp: Engine, duv_dx: Pair, duv_dy: Pair) -> Array:
        """Return how often the picture's width is halved: the footprint stays twice as wide as high, and 3 texels."""
        width, height = (xp.uniform(float(count)) for count in self.size)
        wide = (duv_dx[0] * duv_dx[0] + duv_dy[0] * duv_dy[0]) * (width * width)
        high = (duv_dx[1] * duv_dx[1] + duv_dy[1] * duv_dy[1]) * (height * height)
        ratio = 0.5 * xp.log2(xp.maximum(wide / (4.0 * xp.maximum(high, 2.0)), 1.0))
        return xp.minimum(xp.integer(ratio), self._narrowest)


def by_solid_angle(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 4"]:
    """Multiply texels by their solid angle, in units of the mean one's, and append that as a channel."""
    height, width, _ = image.shape
    edges = np.cos(np.linspace(0.0, np.pi, height + 1))
    angle = np.broadcast_to((0.5 * height * -np.diff(edges))[:, None, None], (height, width, 1))
    return np.concatenate([image * angle, angle], axis=2).astype(np.float32)


def _divided(xp: Engine, colour: tuple[Array, ...]) -> tuple[Array, ...]:
    *light, angle = colour
    inverse = 1.0 / xp.where(angle > 0, angle, 1.0)
    return tuple(value * inverse for value in light)
