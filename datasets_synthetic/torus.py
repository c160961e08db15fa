"""The torus: a tube around a circle about the z axis.

In: major and minor radius. Out: a `Tube` whose closest parameter is in closed form, phi = atan2(y, x).
"""

from dataclasses import dataclass
from math import pi

import numpy as np
from jaxtyping import Float

from datasets_synthetic.tube import Tube


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle about the z axis, in the plane z = 0; a `Curve`."""

    radius: float

    @property
    def reach(self) -> float:
        """The radius: only the axis is equally far from all of the circle."""
        return self.radius

    @property
    def length(self) -> float:
        """Circumference."""
        return 2 * pi * self.radius

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Flat in z."""
        return self.radius * np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])

    def closest(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Azimuth; 0 on the axis."""
        azimuth: Float[np.ndarray, " n"] = np.mod(np.arctan2(p[:, 1], p[:, 0]), 2 * pi)
        return azimuth

    def jet(self, t: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """R (cos t, sin t, 0) and its derivatives."""
        outward, forward = self.across(t)
        return self.radius * outward, self.radius * forward, -self.radius * outward

    def across(self, t: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Outward direction and its derivative, which is the tangent."""
        cos, sin, zero = np.cos(t), np.sin(t), np.zeros_like(t)
        return np.stack([cos, sin, zero], axis=1), np.stack([-sin, cos, zero], axis=1)


def torus(major: float = 0.7, minor: float = 0.3) -> Tube:
    """Build a torus about the z axis; u is the azimuth, v the angle about the tube (0 outermost, 1/4 on top)."""
    return Tube(Circle(major), minor, ("torus",))
