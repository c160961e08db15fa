"""The displaced sphere: a sphere with smooth bumps along its radii.

In: radius, height of the bumps, and three wave numbers. Out: an `Implicit`. With the direction u = p / |p|,

    F(p) = |p| - R - a b(u),   b(u) = (sin k_1 u_x + sin k_2 u_y + sin k_3 u_z) / 3,

so that the surface is at |p| = R + a b(u) in closed form. With P = I - u u^T,

    grad F = u - a P b' / |p|,
    H_F = P / |p| - a (P b'' P - (u.b') P - u (P b')^T - (P b') u^T) / |p|^2.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from datasets_synthetic.field import Jet, Probe, certified
from datasets_synthetic.implicit import Implicit
from datasets_synthetic.layout import CubeMap
from datasets_synthetic.offset import dot, mixed, square

#: Rays are looked after outside this share of the core's radius, where the derivatives of F are bounded.
_DEPTH = 0.8
#: Edges of the samples' mesh; 1 / curvature is above 0.05.
_SAMPLES = 0.02


@dataclass(frozen=True, slots=True)
class Bumps:
    """F of the displaced sphere; a `Field`, but for the origin, where it has no derivatives (those of +z are used)."""

    radius: float
    height: float
    waves: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not 0 <= self.height < self.radius:
            raise ValueError(f"bumps {self.height} high on a sphere of radius {self.radius} reach its middle")

    @property
    def core(self) -> float:
        """Radius of a ball without surface in it."""
        return self.radius - self.height

    @property
    def steepest(self) -> float:
        """|grad F|^2 = 1 + a^2 |P b'|^2 / |p|^2, with |b'| at most |k| / 3."""
        return float(np.hypot(1.0, self.height * np.linalg.norm(self.waves) / 3 / (_DEPTH * self.core)))

    @property
    def bending(self) -> float:
        """Norm of H_F at least `_DEPTH` of the core's radius from the middle; the mixed terms' is |P b'|, once each."""
        least, k = _DEPTH * self.core, np.asarray(self.waves)
        return float(1 / least + self.height / 3 * ((k * k).max() + 2 * np.linalg.norm(k)) / least**2)

    def jet(self, p: Float[np.ndarray, "3 n"]) -> Jet:
        """Value and first two derivatives."""
        r, u, sine, slope = self._radial(p)
        toward = dot(slope, u)
        flat, a, k = slope - toward * u, self.height / r, np.asarray(self.waves)[:, None]
        # With D = b'', P D P = D - u (D u)^T - (D u) u^T + (u.D u) u u^T; the last two terms of H_F join in.
        second = -k * k / 3 * sine
        swing = second * u + flat
        around = dot(second * u, u) + toward
        curved = np.concatenate([second - toward, np.zeros_like(u)]) - mixed(u, swing) + around * square(u)
        identity = np.concatenate([np.ones_like(u), np.zeros_like(u)])
        value = r - self.radius - self.height / 3 * sine.sum(axis=0)
        return Jet(value, u - a * flat, (identity - square(u)) / r - a / r * curved)

    def probe(self, p: Float[np.ndarray, "3 n"], d: Float[np.ndarray, "3 n"]) -> Probe:
        """Steps end outside `_DEPTH` of the core; from within the core they go to its far side."""
        r, u, sine, slope = self._radial(p)
        value = r - self.radius - self.height / 3 * sine.sum(axis=0)
        along = dot(u - self.height / r * (slope - dot(slope, u) * u), d)
        middle = -dot(p, d)
        across = middle + np.sqrt(np.maximum(self.core**2 - r * r + middle * middle, 0.0))
        step = np.minimum(certified(value, along, np.float64(self.bending)), r - _DEPTH * self.core)
        return Probe(value, along, np.where(r <= self.core, across, step))

    def surface(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Surface points in the given unit directions."""
        bump = np.sin(np.asarray(self.waves) * directions).sum(axis=1) / 3
        surface: Float[np.ndarray, "n 3"] = (self.radius + self.height * bump)[:, None] * directions
        return surface

    def _radial(self, p: Float[np.ndarray, "3 n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """|p|, u, sin k u and b'; at the origin, those of a point just above it."""
        r = np.sqrt(dot(p, p))
        centre = r == 0
        r = np.where(centre, np.finfo(np.float64).eps, r)
        u = np.where(centre, np.array([[0.0], [0.0], [1.0]]), p / r)
        k = np.asarray(self.waves)[:, None]
        return r, u, np.sin(k * u), k / 3 * np.cos(k * u)


@cache
def bumps(radius: float = 0.75, height: float = 0.15, waves: tuple[float, float, float] = (7.0, 6.0, 8.0)) -> Implicit:
    """Build a displaced sphere about the origin; the same one every time, as sampling it takes a moment."""
    field, layout = Bumps(radius, height, waves), CubeMap((radius, radius, radius))

    def triangulate(edge: float) -> tuple[np.ndarray, np.ndarray]:
        directions, faces = layout.lattice(edge)
        return field.surface(directions), faces

    return Implicit.of(field, layout, triangulate, _SAMPLES, "bumps")
