"""Smooth functions that are negative inside a solid, and how far a ray may go before one can change its sign.

In: points and directions by columns, (3, n). Out: value, gradient and Hessian in closed form (layout: see `offset`);
steps that cannot cross the zero level. If |f''| along a ray is at most K, then f keeps its sign up to the first root of

    |f| + sign(f) f' s - K s^2 / 2.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from datasets_synthetic.offset import square

#: Weights below exp(-60) are below the rounding of their sum, 1 or more.
_FAINT = -60.0


class Jet(NamedTuple):
    """Value (n,), gradient (3, n) and Hessian (6, n)."""

    value: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray


class Probe(NamedTuple):
    """Along a ray: value, derivative, and a step that cannot cross the zero level, each (n,)."""

    value: np.ndarray
    slope: np.ndarray
    free: np.ndarray


@runtime_checkable
class Field(Protocol):
    """A function with a smooth zero level on which its gradient does not vanish."""

    @property
    def steepest(self) -> float:
        """Bound of the gradient's length where rays are asked for."""
        ...

    def jet(self, p: Float[np.ndarray, "3 n"]) -> Jet:
        """Value and first two derivatives."""
        ...

    def probe(self, p: Float[np.ndarray, "3 n"], d: Float[np.ndarray, "3 n"]) -> Probe:
        """Value, derivative along unit `d`, and a certified step."""
        ...


@runtime_checkable
class Pieces(Protocol):
    """Smooth functions f_i, each with bounds of its own derivatives in all of space."""

    @property
    def steepest(self) -> float:
        """Bound of |grad f_i|, for all i."""
        ...

    @property
    def bending(self) -> Float[np.ndarray, " m"]:
        """Bound of the norm of each Hessian."""
        ...

    def slopes(self, p: Float[np.ndarray, "3 n"]) -> tuple[np.ndarray, np.ndarray]:
        """Values (m, n) and gradients (m, 3, n)."""
        ...

    def curved(self, p: Float[np.ndarray, "3 n"], weight: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "6 n"]:
        """Weighted sum of the Hessians."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SmoothMax:
    """Intersection of the solids f_i < 0 with rounded edges: F = e log sum_i exp(f_i / e); a `Field`.

    With weights w_i = exp((f_i - F) / e), which add up to 1, grad F = sum w_i g_i and the Hessian is
    sum w_i (H_i + g_i g_i^T / e) - grad F grad F^T / e. F is at least every f_i: where one of them is positive along a
    stretch of a ray, so is F.
    """

    pieces: Pieces
    rounding: float  # e, the unit's; an edge of a right angle gets the radius of curvature sqrt(2) e

    @property
    def steepest(self) -> float:
        """A mean of gradients is no steeper than the steepest."""
        return self.pieces.steepest

    @property
    def bending(self) -> float:
        """The greatest bending of a piece, and the spread of the gradients over e."""
        return float(self.pieces.bending.max()) + self.steepest**2 / self.rounding

    def jet(self, p: Float[np.ndarray, "3 n"]) -> Jet:
        """Value and first two derivatives."""
        f, g = self.pieces.slopes(p)
        value, weight = self._mixed(f)
        gradient = np.sum(weight[:, None] * g, axis=0)
        spread = sum(w * square(one - gradient) for w, one in zip(weight, g, strict=True))
        return Jet(value, gradient, self.pieces.curved(p, weight) + spread / self.rounding)

    def probe(self, p: Float[np.ndarray, "3 n"], d: Float[np.ndarray, "3 n"]) -> Probe:
        """Outside, the longest of the steps of F itself and of the pieces that are positive."""
        f, g = self.pieces.slopes(p)
        value, weight = self._mixed(f)
        along = np.sum(g * d, axis=1)
        slope = np.sum(weight * along, axis=0)
        own = certified(value, slope, np.float64(self.bending))
        theirs = np.where(f > 0, certified(np.maximum(f, 0.0), along, self.pieces.bending[:, None]), 0.0)
        return Probe(value, slope, np.maximum(own, theirs.max(axis=0)))

    def _mixed(self, f: Float[np.ndarray, "m n"]) -> tuple[np.ndarray, np.ndarray]:
        """F (n,) and the weights (m, n)."""
        greatest = f.max(axis=0)
        weight = np.exp(np.maximum((f - greatest) / self.rounding, _FAINT))
        total = weight.sum(axis=0)
        return greatest + self.rounding * np.log(total), weight / total


def certified(value: np.ndarray, slope: np.ndarray, bending: np.ndarray | np.float64) -> np.ndarray:
    """First root of |f| + sign(f) f' s - K s^2 / 2, inf if there is none (K = 0, leaving).

    Towards a transverse root of f it is Newton's step kept short of the root; past a near miss it grows again.
    """
    gap, toward = np.abs(value), np.where(value < 0, -slope, slope)
    ahead = np.sqrt(toward * toward + 2 * bending * gap)
    # Two forms of the same root, each without cancellation for its sign of the slope.
    leaving = toward > 0
    top = np.where(leaving, ahead + toward, 2 * gap)
    bottom = np.where(leaving, bending, ahead - toward)
    step: np.ndarray = np.where(bottom > 0, top / np.where(bottom > 0, bottom, 1.0), np.where(top > 0, np.inf, 0.0))
    return step
