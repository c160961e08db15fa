"""Exact shapes in place of grids: the truth that a grid's answers are held against.

In: a shape with closed forms. Out: a `Field` that `trace`, `transfer`, `reflect`, `footprint` and `render` take like a
grid's, on NumPy in float64.
"""

import numpy as np
from jaxtyping import Float

from datasets_synthetic import ExactShape
from sdfbake.engine import Array, Engine
from sdfbake.engine.numpy import NumpyEngine
from sdfrender.field import Jet, Mapped, Spot
from sdfrender.uvmode import EXACT
from sdfrender.vector import Symmetric, Vector


class ShapeField:
    """The surface of an exact shape.

    Parameters
    ----------
    shape
        A shape of `datasets_synthetic`.
    """

    def __init__(self, shape: ExactShape) -> None:
        self.shape = shape
        self.engine: Engine = NumpyEngine(64)
        self.anchor: Float[np.ndarray, " 3"] = np.zeros(3)
        self.is_distance = True
        self.uv_mode = EXACT

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Box around the shape."""
        return self.shape.bounds

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the shape's parts."""
        return self.shape.part_names

    def first_hit(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None) -> Spot:
        """Closed-form first hits; a place that a ray leaves is not met again."""
        asked = np.flatnonzero(active if start is None else active & start.hit)
        t = np.full(len(active), np.inf)
        if asked.size:
            t[asked] = self.shape.intersect(_points(p)[asked], _points(d)[asked])
        hit = np.isfinite(t)
        t = np.where(hit, t, 0.0)
        at: Vector = (p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2])
        return Spot(hit, t, at, at)

    def locate(self, xp: Engine, p: Vector, active: Array) -> Spot:
        """Every position is a place."""
        return Spot(active, np.zeros(len(active)), p, p)

    def jet_at(self, xp: Engine, spot: Spot, order: int) -> Jet:
        """Distance, normal and the derivative of the normal; 0 where nothing was hit."""
        rows, points = self._asked(spot)
        value = _spread(self.shape.distance(points), rows, spot)
        gradient = _vector(_spread(self.shape.normal(points), rows, spot)) if order > 0 else None
        if order < 2:
            return Jet(value, gradient)
        h = _spread(self.shape.hessian(points), rows, spot)
        entries = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        return Jet(value, gradient, Symmetric(*(h[:, i, j] for i, j in entries)))

    def uv_at(self, xp: Engine, spot: Spot, n: Vector | None) -> Mapped:
        """Texture coordinates and their gradients in the surface."""
        rows, points = self._asked(spot)
        uv = _spread(self.shape.uv(points), rows, spot)
        gradient = _spread(self.shape.uv_gradient(points), rows, spot)
        chart = _spread(self.shape.chart(points), rows, spot)
        du, dv = _vector(gradient[:, 0]), _vector(gradient[:, 1])
        return Mapped(uv[:, 0], uv[:, 1], du, dv, chart, np.zeros(len(chart), bool))

    def part_at(self, xp: Engine, spot: Spot) -> Array:
        """Part of the surface."""
        rows, points = self._asked(spot)
        return _spread(self.shape.part(points), rows, spot)

    def _asked(self, spot: Spot) -> tuple[np.ndarray, Float[np.ndarray, "m 3"]]:
        rows = np.flatnonzero(spot.hit)
        return rows, _points(spot.locator)[rows]


def _points(vector: Vector) -> Float[np.ndarray, "n 3"]:
    return np.stack(vector, axis=-1)


def _vector(points: Float[np.ndarray, "n 3"]) -> Vector:
    return points[:, 0], points[:, 1], points[:, 2]


def _spread(values: np.ndarray, rows: np.ndarray, spot: Spot) -> np.ndarray:
    """Put the answers for some rays among zeros for the others."""
    out = np.zeros((len(spot.hit), *values.shape[1:]), values.dtype)
    out[rows] = values
    return out
