"""The capsule about the z axis: all points within a radius of a segment.

In: radius, and half the length of the segment. Out: a `Revolution` whose distance is that to the segment less the
radius; its curvature jumps where the half spheres begin.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
from jaxtyping import Float

from datasets_synthetic.revolution import BOTTOM, SIDE, TOP, ProfileFoot, Revolution, line_and_cylinder, line_and_slab


@dataclass(frozen=True, slots=True)
class Stadium:
    """Profile of a capsule about the segment -half <= z <= half; +x is the normal on the segment itself."""

    radius: float
    half: float
    part_name: str = "capsule"

    @property
    def extent(self) -> tuple[float, float, float]:
        """Radius and poles."""
        return self.radius, -self.half - self.radius, self.half + self.radius

    @property
    def lengths(self) -> tuple[float, float, float]:
        """Quarter circle, segment, quarter circle."""
        return pi / 2 * self.radius, 2 * self.half, pi / 2 * self.radius

    @property
    def area(self) -> float:
        """4 pi R^2 and 2 pi R times the segment."""
        return 4 * pi * self.radius * (self.radius + self.half)

    @property
    def volume(self) -> float:
        """(4 / 3) pi R^3 and pi R^2 times the segment."""
        return 2 * pi * self.radius**2 * (2 / 3 * self.radius + self.half)

    def foot(self, r: Float[np.ndarray, " n"], z: Float[np.ndarray, " n"]) -> ProfileFoot:
        """From the closest point of the segment."""
        over = z - np.clip(z, -self.half, self.half)
        length = np.hypot(r, over)
        safe = np.where(length > 0, length, 1.0)
        nr, nz = np.where(length > 0, r / safe, 1.0), over / safe
        cap = over != 0
        lean = np.where(cap, np.arctan2(r, np.abs(over)), 0.0)  # angle from the pole
        return ProfileFoot(
            distance=length - self.radius,
            nr=nr,
            nz=nz,
            bend=np.where(cap, 1 / safe, 0.0),
            r=self.radius * nr,
            piece=np.where(cap, np.where(over < 0, BOTTOM, TOP), SIDE),
            s=np.where(cap, self.radius * lean, np.clip(z, -self.half, self.half) + self.half),
            tr=np.where(cap, np.abs(nz), 0.0),
            tz=np.where(cap, -np.sign(over) * nr, 1.0),
        )

    def place(self, piece: int, s: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Up the side, down or up the quarter circles from their poles."""
        if piece == SIDE:
            return np.full_like(s, self.radius), s - self.half
        up = -1.0 if piece == BOTTOM else 1.0
        lean = s / self.radius
        return self.radius * np.sin(lean), up * (self.half + self.radius * np.cos(lean))

    def interval(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
        """From the first entry to the last exit among the cylinder and both balls: their union is convex."""
        enter, leave = line_and_cylinder(o, d, self.radius)
        above, below = line_and_slab(o, d, -self.half, self.half)
        pieces = [(np.maximum(enter, above), np.minimum(leave, below))]
        pieces += [self._ball(o - np.array([0.0, 0.0, z]), d) for z in (-self.half, self.half)]
        first = [np.where(start <= end, start, np.inf) for start, end in pieces]
        last = [np.where(start <= end, end, -np.inf) for start, end in pieces]
        return np.min(first, axis=0), np.max(last, axis=0)

    def _ball(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Entry and exit from the closest approach, which does not cancel far away."""
        middle = -np.sum(o * d, axis=1)
        closest = np.linalg.norm(o + middle[:, None] * d, axis=1)
        half = np.sqrt(np.maximum((self.radius - closest) * (self.radius + closest), 0.0))
        missed = closest > self.radius
        return np.where(missed, np.inf, middle - half), np.where(missed, -np.inf, middle + half)


def capsule(radius: float = 0.5, straight: float = 0.9) -> Revolution:
    """Build a capsule about the z axis, its middle at the origin; `straight` is the height of its cylinder."""
    return Revolution(Stadium(radius, straight / 2))
