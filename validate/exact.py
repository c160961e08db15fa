"""Exact shapes in place of grids: the truth that a grid's answers are held against.

In: a shape with closed forms. Out: a `Field` that `trace`, `transfer`, `reflect`, `footprint` and `render` take like a
grid's, on NumPy in float64.
"""

import numpy as np
from jaxtyping import Bool, Float

from datasets_synthetic import ExactShape
from sdfbake.engine import Array, Engine
from sdfbake.engine.numpy import NumpyEngine
from sdfrender.field import Jet, Mapped, Spot, Spread
from sdfrender.uvmode import EXACT
from sdfrender.vector import Symmetric, Vector, select
from validate.interior import CLEAR, leave


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

    def first_hit(
        self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None, spread: Spread | None = None
    ) -> Spot:
        """First hits: entries in closed form; from inside, or inward from a place, where the ray leaves the solid."""
        left = np.zeros(len(active), bool) if start is None else start.hit & active
        if start is not None:
            p = select(xp, left, start.locator, p)
        rows = np.flatnonzero(active)
        o, along = _points(p)[rows], _points(d)[rows]
        length = np.linalg.norm(along, axis=1)
        t = np.full(len(active), np.inf)
        if rows.size:
            t[rows] = self._intersect(o, along / length[:, None], left[rows]) / length
        hit = np.isfinite(t)
        t = np.where(hit, t, 0.0)
        at: Vector = (p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2])
        return Spot(hit, t, at, at)

    def _intersect(
        self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], left: Bool[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Intersect rays from either side, `d` of unit length; `left`: the origin is a place on the surface."""
        low, high = self.shape.bounds
        size = float(np.linalg.norm(high - low))
        inside = left | ((o > low - CLEAR * size) & (o < high + CLEAR * size)).all(axis=1)
        rows = np.flatnonzero(inside)
        value, slope = self.shape.distance(o[rows]), np.sum(self.shape.normal(o[rows]) * d[rows], axis=1)
        on_surface = left[rows] | (np.abs(value) <= CLEAR * size)
        inside[rows] = np.where(on_surface, slope < 0, value < 0)
        t = np.empty(len(o))
        t[~inside] = self.shape.intersect(o[~inside], d[~inside])
        t[inside] = leave(self.shape, o[inside], d[inside], size)
        return t

    def occluded(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None, limit: Array) -> Array:
        """Say which rays meet anything before `limit`."""
        spot = self.first_hit(xp, p, d, active, start)
        return spot.hit & (spot.t < limit)

    def inside(self, xp: Engine, p: Vector, active: Array) -> Array:
        """Say which positions are inside, by the distance."""
        return active & (self.shape.distance(_points(p)) < 0)

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

    def prepare_uv(self) -> None:
        """Nothing to prepare."""

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

    def beyond_band(self, xp: Engine, spot: Spot) -> Array:
        """Nowhere: every value is exact."""
        return xp.full(spot.t, False)

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
