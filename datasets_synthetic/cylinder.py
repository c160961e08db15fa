"""The cylinder about the z axis.

In: radius and half height. Out: a `Revolution` whose profile is a rectangle: with a = r - R and b = |z| - h the
distance is |(a, b)| past the rim, else the greater of the two.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
from jaxtyping import Float

from datasets_synthetic.revolution import BOTTOM, SIDE, TOP, ProfileFoot, Revolution, line_and_cylinder, line_and_slab


@dataclass(frozen=True, slots=True)
class Rectangle:
    """Profile of a cylinder, -half <= z <= half. Where side and cap are equally near, the cap answers."""

    radius: float
    half: float
    part_name: str = "cylinder"

    @property
    def extent(self) -> tuple[float, float, float]:
        """Radius and ends."""
        return self.radius, -self.half, self.half

    @property
    def lengths(self) -> tuple[float, float, float]:
        """Radius, height, radius."""
        return self.radius, 2 * self.half, self.radius

    @property
    def area(self) -> float:
        """2 pi R (R + height)."""
        return 2 * pi * self.radius * (self.radius + 2 * self.half)

    @property
    def volume(self) -> float:
        """Pi R^2 height."""
        return 2 * pi * self.radius**2 * self.half

    def foot(self, r: Float[np.ndarray, " n"], z: Float[np.ndarray, " n"]) -> ProfileFoot:
        """Clamp outside, take the nearer of side and cap inside."""
        a, b, up = r - self.radius, np.abs(z) - self.half, np.where(z < 0, -1.0, 1.0)
        side, rim = a > b, (a > 0) & (b > 0)
        length = np.where(rim, np.hypot(a, b), 1.0)
        on = np.where(side, SIDE, np.where(z < 0, BOTTOM, TOP))
        reach = np.minimum(r, self.radius)
        return ProfileFoot(
            distance=np.where(rim, length, np.maximum(a, b)),
            nr=np.where(rim, a / length, side),
            nz=np.where(rim, b / length, ~side) * up,
            bend=np.where(rim, 1 / length, 0.0),
            r=np.where(side, self.radius, reach),
            piece=on,
            s=np.where(side, np.clip(z, -self.half, self.half) + self.half, reach),
            tr=np.where(side, 0.0, 1.0),
            tz=np.where(side, 1.0, 0.0),
        )

    def place(self, piece: int, s: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Up the side, out along the caps."""
        if piece == SIDE:
            return np.full_like(s, self.radius), s - self.half
        return s, np.full_like(s, -self.half if piece == BOTTOM else self.half)

    def interval(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Within the endless cylinder and the slab at once."""
        enter, leave = line_and_cylinder(o, d, self.radius)
        above, below = line_and_slab(o, d, -self.half, self.half)
        return np.maximum(enter, above), np.minimum(leave, below)


def cylinder(radius: float = 0.6, height: float = 1.4) -> Revolution:
    """Build a cylinder about the z axis, its middle at the origin."""
    return Revolution(Rectangle(radius, height / 2))
