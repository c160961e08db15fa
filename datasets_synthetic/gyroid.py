"""The gyroid shell: a wall along the gyroid, cut to a ball.

In: radius of the ball, wave number, half the wall's thickness, rounding of its rims. Out: an `Implicit`. With
g = sin kx cos ky + sin ky cos kz + sin kz cos kx it is the rounded intersection (`field.SmoothMax`) of

    (g - w) / k < 0,   (-g - w) / k < 0,   (|p|^2 - R^2) / 2 R < 0,

one piece with many holes (its surface is of high genus) and no edges. |grad g| / k is between 0.8 and 1.8 on the wall,
which is thinner where it is steeper.
"""

from dataclasses import dataclass
from functools import cache
from math import ceil

import numpy as np
from jaxtyping import Float

from datasets_synthetic.closest import drop
from datasets_synthetic.field import SmoothMax
from datasets_synthetic.implicit import Implicit
from datasets_synthetic.layout import Projection
from datasets_synthetic.offset import dot
from sdfbake.grid import Grid
from sdfbake.isosurface import isosurface
from sdfbake.lattice import BAND, LEAST

#: Edges of the samples' mesh.
_SAMPLES = 0.015


@dataclass(frozen=True, slots=True)
class Wall:
    """Both sides of the wall, and the ball; the `Pieces` of the gyroid shell."""

    radius: float
    wave: float
    level: float

    @property
    def steepest(self) -> float:
        """|grad g| is at most sqrt(6) k: each component is of the form cos a cos b - sin a sin c, at most sqrt(2).

        The ball's gradient, p / R, is less in a box of half width R around it.
        """
        return float(np.sqrt(6.0))

    @property
    def bending(self) -> Float[np.ndarray, " m"]:
        """Diagonal of g's Hessian at most sqrt(2) k^2, the others at most k^2, each row has two; 1 / R for the ball."""
        return np.array([(np.sqrt(2) + 2) * self.wave, (np.sqrt(2) + 2) * self.wave, 1 / self.radius])

    def slopes(self, p: Float[np.ndarray, "3 n"]) -> tuple[np.ndarray, np.ndarray]:
        """Values (3, n) and gradients (3, 3, n)."""
        s, c = np.sin(self.wave * p), np.cos(self.wave * p)
        g = s[0] * c[1] + s[1] * c[2] + s[2] * c[0]
        rise = np.stack([c[0] * c[1] - s[2] * s[0], c[1] * c[2] - s[0] * s[1], c[2] * c[0] - s[1] * s[2]])
        ball = (dot(p, p) - self.radius**2) / (2 * self.radius)
        value = np.stack([(g - self.level) / self.wave, (-g - self.level) / self.wave, ball])
        return value, np.stack([rise, -rise, p / self.radius])

    def curved(self, p: Float[np.ndarray, "3 n"], weight: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "6 n"]:
        """Diagonal -k (s_i c_j + s_h c_i), beside it -k c_i s_j, with j the axis after i and h the one before."""
        s, c = np.sin(self.wave * p), np.cos(self.wave * p)
        wall = -self.wave * (weight[0] - weight[1])
        curved = np.empty((6, p.shape[1]))
        for i, beside in ((0, 5), (1, 3), (2, 4)):
            j = (i + 1) % 3
            curved[i] = wall * (s[i] * c[j] + s[i - 1] * c[i]) + weight[2] / self.radius
            curved[beside] = wall * c[i] * s[j]
        return curved


@dataclass(frozen=True, slots=True)
class _Sampled:
    """F as a function that a grid can sample: never steeper than a distance."""

    field: SmoothMax
    bounds: Float[np.ndarray, "2 3"]

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """F over its greatest slope."""
        distance: Float[np.ndarray, " n"] = self.field.jet(p.T).value / self.field.steepest
        return distance

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Not asked for; what may be sampled has texture coordinates."""
        return np.zeros((len(p), 2))


@cache
def gyroid(radius: float = 0.9, wave: float = 4.0, level: float = 0.6, rounding: float = 0.08) -> Implicit:
    """Build a gyroid shell about the origin; the same one every time, as sampling it takes a moment."""
    field = SmoothMax(Wall(radius, wave, level), rounding)
    box = radius * np.array([[-1.0], [1.0]]) * np.ones(3)

    def triangulate(edge: float) -> tuple[np.ndarray, np.ndarray]:
        # Cells of one edge: most of a cell's triangles have sides between its own and its diagonals.
        resolution = max(LEAST, ceil(2 * radius / edge + 1 + 2 * BAND))
        grid = Grid.from_function(_Sampled(field, box), resolution, uv_mode="none")
        mesh = isosurface(grid)
        return drop(field, mesh.vertices), mesh.faces

    return Implicit.of(field, Projection((radius, radius, radius)), triangulate, _SAMPLES, "gyroid")
