"""The light on a matt surface: from points, from a direction, from all around, in the shadow of what is hit first.

In: hits with their normals. Out: the radiance of a white surface there, E / pi with E the irradiance. A surface is lit
on the side that is looked at. Mirrors and glass cast shadows like everything else: light that they send on is not
followed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, pi

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine
from sdfrender.environment import Environment
from sdfrender.field import Field, Spot
from sdfrender.lights import DirectionalLight, Light, PointLight
from sdfrender.vector import Vector, dot, scale, subtract, zero


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """The lights of a scene.

    Attributes
    ----------
    lights
        Points and directions.
    around
        The environment's irradiance by normal, over pi; None where there is none.
    intensity
        By which `around` is multiplied.
    """

    lights: Sequence[Light]
    around: Environment | None
    intensity: float

    def at(self, xp: Engine, field: Field, spot: Spot, n: Vector, here: Array) -> Vector:
        """Return the radiance of a white matt surface with unit normal `n`, on that normal's side."""
        total = zero(xp, spot.t)
        for light in self.lights:
            lit = _lit(xp, field, light, spot, n, here)
            total = (total[0] + lit[0], total[1] + lit[1], total[2] + lit[2])
        if self.around is None:
            return total
        red, green, blue = self.around.look_up(xp, n, None, here).colour
        share = xp.uniform(self.intensity)
        return total[0] + red * share, total[1] + green * share, total[2] + blue * share


def _lit(xp: Engine, field: Field, light: Light, spot: Spot, n: Vector, here: Array) -> Vector:
    """Return the part of one light."""
    toward, strength, limit = _arriving(xp, light, spot, field.anchor)
    cosine = dot(n, toward)
    here = here & (cosine > 0) & (strength > 0)
    if light.shadows:
        # The hit itself is left without an offset: its root is known.
        start = spot._replace(hit=here)
        here = here & ~field.occluded(xp, spot.p, toward, here, start, limit)
    amount = xp.where(here, cosine * strength * (1.0 / pi), 0.0)
    colour = light.intensity if isinstance(light, PointLight) else light.irradiance
    return amount * xp.uniform(colour[0]), amount * xp.uniform(colour[1]), amount * xp.uniform(colour[2])


def _arriving(xp: Engine, light: Light, spot: Spot, anchor: Float[np.ndarray, " 3"]) -> tuple[Vector, Array, Array]:
    """Return the unit direction towards a light, the share of its colour that arrives, and how far it is."""
    if isinstance(light, DirectionalLight):
        toward = -np.asarray(light.direction) / hypot(*light.direction)
        nothing = xp.full(spot.t, 0.0)
        x, y, z = (nothing + xp.uniform(float(c)) for c in toward)
        return (x, y, z), xp.full(spot.t, 1.0), xp.full(spot.t, float("inf"))
    at = [xp.uniform(float(c)) for c in np.subtract(light.position, anchor)]
    way = subtract((at[0], at[1], at[2]), spot.p)
    squared = dot(way, way)
    inverse = 1.0 / xp.where(squared > 0, squared, 1.0)
    distance = xp.sqrt(squared)
    return scale(way, xp.sqrt(inverse)), xp.where(squared > 0, inverse, 0.0), distance
