"""The cone about the z axis, point up.

In: radius, height and the place of the base. Out: a `Revolution`. With l the coordinate along the slant from the rim,
the closest point is the apex past its end, the slant's foot in front of it, else the base or its rim. Around the apex
the slant's texture is a disc of its own, by the distance from the apex, so that no chart is pinched.
"""

from dataclasses import dataclass
from math import hypot, pi

import numpy as np
from jaxtyping import Float

from datasets_synthetic.revolution import BOTTOM, SIDE, TOP, ProfileFoot, Revolution, line_and_slab


@dataclass(frozen=True, slots=True)
class Wedge:
    """Profile of a cone with its base at z = low; the piece on top is half of the slant.

    Where slant and base are equally near, the slant answers.
    """

    radius: float
    height: float
    low: float
    part_name: str = "cone"

    @property
    def extent(self) -> tuple[float, float, float]:
        """Radius, base and apex."""
        return self.radius, self.low, self.low + self.height

    @property
    def slant(self) -> float:
        """Length from the rim to the apex."""
        return hypot(self.radius, self.height)

    @property
    def lengths(self) -> tuple[float, float, float]:
        """Radius, and two halves of the slant."""
        return self.radius, self.slant / 2, self.slant / 2

    @property
    def area(self) -> float:
        """Pi R (R + slant)."""
        return pi * self.radius * (self.radius + self.slant)

    @property
    def volume(self) -> float:
        """Pi R^2 height / 3."""
        return pi * self.radius**2 * self.height / 3

    def foot(self, r: Float[np.ndarray, " n"], z: Float[np.ndarray, " n"]) -> ProfileFoot:
        """By region: apex, slant, base or rim outside; the nearer of slant and base inside."""
        tr, tz = -self.radius / self.slant, self.height / self.slant  # up the slant; its normal is (tz, -tr)
        off = (r - self.radius) * tz - (z - self.low) * tr
        up = (r - self.radius) * tr + (z - self.low) * tz
        under = self.low - z
        slanted = (up >= 0) & (off >= np.minimum(under, 0.0))
        past = up > self.slant
        cr, cz = np.where(past, 0.0, self.radius), np.where(past, self.low + self.height, self.low)
        length = np.hypot(r - cr, z - cz)
        corner = (past | ((up < 0) & (r > self.radius))) & (length > 0)
        length = np.where(corner, length, 1.0)
        tip = slanted & (up > self.slant / 2)
        arc = np.clip(up, 0.0, self.slant)
        reach = np.minimum(r, self.radius)
        return ProfileFoot(
            distance=np.where(corner, length, np.where(slanted, off, under)),
            nr=np.where(corner, (r - cr) / length, np.where(slanted, tz, 0.0)),
            nz=np.where(corner, (z - cz) / length, np.where(slanted, -tr, -1.0)),
            bend=np.where(corner, 1 / length, 0.0),
            r=np.where(slanted, self.radius + arc * tr, reach),
            piece=np.where(tip, TOP, np.where(slanted, SIDE, BOTTOM)),
            s=np.where(tip, self.slant - arc, np.where(slanted, arc, reach)),
            tr=np.where(tip, -tr, np.where(slanted, tr, 1.0)),
            tz=np.where(tip, -tz, np.where(slanted, tz, 0.0)),
        )

    def place(self, piece: int, s: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Out along the base, up the lower half of the slant, down the upper half from the apex."""
        if piece == BOTTOM:
            return s, np.full_like(s, self.low)
        fallen = (self.slant - s if piece == SIDE else s) / self.slant  # share of the slant, from the apex
        return self.radius * fallen, self.low + self.height * (1 - fallen)

    def interval(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Within the endless cone below the apex and above the base at once."""
        top = self.low + self.height
        enter, leave = _line_and_cone(o - np.array([0.0, 0.0, top]), d, self.radius / self.height)
        above, below = line_and_slab(o, d, self.low, top)
        return np.maximum(enter, above), np.minimum(leave, below)


def cone(radius: float = 0.7, height: float = 1.4) -> Revolution:
    """Build a cone about the z axis; the origin is at half its height."""
    return Revolution(Wedge(radius, height, -height / 2))


def _line_and_cone(
    o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], k: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Where lines enter and leave r <= -k z, z <= 0.

    With the form Q(v) = x^2 + y^2 - k^2 z^2 and t from the closest approach to the apex, roots of
    a t^2 + 2 b t + c = Q(o + t d). Their discriminant b^2 - a c is k^2 (m_x^2 + m_y^2) - m_z^2 with m = o x d, which
    does not cancel far away.
    """
    metric = np.array([1.0, 1.0, -k * k])
    near = -np.sum(o * d, axis=1)
    start = o + near[:, None] * d
    a, b, c = d**2 @ metric, (start * d) @ metric, start**2 @ metric
    moment = np.cross(start, d)
    room = k * k * (moment[:, 0] ** 2 + moment[:, 1] ** 2) - moment[:, 2] ** 2
    # The root of greater size first, the other from the product of both; a line along the slant has one root only.
    q = -(b + np.where(b < 0, -1.0, 1.0) * np.sqrt(np.maximum(room, 0.0)))
    one = np.where(a != 0, q / np.where(a != 0, a, 1.0), np.where(q > 0, np.inf, -np.inf))
    other = np.where(q != 0, c / np.where(q != 0, q, 1.0), 0.0)
    low, high = np.minimum(one, other), np.maximum(one, other)
    # Across the cone it is between the roots, in the lower nappe or the upper one; steeper than the slant, beyond them.
    across = a > 0
    inside = (room >= 0) & (start[:, 2] + (low / 2 + high / 2) * d[:, 2] <= 0)
    enter = np.where(across, np.where(inside, low, np.inf), np.where(d[:, 2] < 0, high, -np.inf))
    leave = np.where(across, np.where(inside, high, -np.inf), np.where(d[:, 2] < 0, np.inf, low))
    return near + enter, near + leave
