"""Closest points of a smooth level surface.

In: a `Field` and dense samples of its zero level. Out: for points p, the feet y, to the rounding of float64, on

    F(y) = 0,   P (p - y) = 0,   P = I - n n^T,   n = grad F / |grad F|.

Newton's iteration on these conditions starts from the nearest sample; with d = (p - y).n and the shape operator S, its
step is -F / |grad F| along n, and (I + d S)^-1 of what is left in the tangent plane.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic.field import Field
from datasets_synthetic.offset import dot, frame, operator, times

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

#: Quadratic convergence takes 4 to 6 steps; the rest are for points at a centre of curvature, where it is linear.
_STEPS = 80
#: Steps no longer than this, in the shape's unit (its size is about 1), are the last.
_SETTLED = 1e-9
#: Points at a time: their arrays stay in the processor's cache.
_CHUNK = 4096
#: Samples compared around a point that may be equally far from two sheets.
_RIVALS = 6


class Foot(NamedTuple):
    """Feet y (n, 3), unit normals there (n, 3), and signed distances of p (n,)."""

    y: np.ndarray
    n: np.ndarray
    distance: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Points on the surface, so dense that the nearest one leads to the closest point.

    Attributes
    ----------
    point, normal
        (m, 3) each.
    tree
        Of the points.
    spacing
        No point of the surface is farther than this from a sample.
    alone
        Nearer to the surface than this, a point has one closest point: 0.8 of the least radius of curvature at the
        samples (sheets of the shapes here are farther apart than that).
    """

    point: Float[np.ndarray, "m 3"]
    normal: Float[np.ndarray, "m 3"]
    tree: "cKDTree"
    spacing: float
    alone: float

    @staticmethod
    def of(field: Field, point: Float[np.ndarray, "m 3"], spacing: float) -> "Samples":
        """Take points on the surface."""
        from scipy.spatial import cKDTree  # costs 0.2 s, and only such shapes need it

        at = field.jet(point.T)
        size = np.sqrt(dot(at.gradient, at.gradient))
        normal = at.gradient / size
        s11, s12, s22 = operator(frame(normal), size, at.hessian)
        curvature = np.abs(s11 + s22) / 2 + np.hypot((s11 - s22) / 2, s12)
        alone = 0.8 / float(curvature.max())
        return Samples(point, np.ascontiguousarray(normal.T), cKDTree(point), spacing, alone)


def closest(field: Field, samples: Samples, p: Float[np.ndarray, "n 3"]) -> Foot:
    """Feet of `p`.

    The foot is the closest point, to rounding, wherever every other local minimum of the distance is farther by more
    than spacing^2 (1 + d k) / 2 d, so everywhere within the reach. Next to the medial axis, where the nearest samples
    show a second sheet, both are followed and the better one wins; should they not show it, the distance is too long
    by at most that.
    """
    p = np.ascontiguousarray(p)
    feet = [_closest(field, samples, p[start : start + _CHUNK]) for start in range(0, len(p), _CHUNK)]
    if not feet:
        return Foot(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    return Foot(*(np.concatenate(column) for column in zip(*feet, strict=True)))


def _closest(field: Field, samples: Samples, p: Float[np.ndarray, "n 3"]) -> Foot:
    length, nearest = (np.asarray(found) for found in samples.tree.query(p, k=_RIVALS))
    foot = polished(field, p, samples.point[nearest[:, 0]], samples.spacing)
    far = np.flatnonzero(length[:, 0] > samples.alone)
    other = _rival(samples, length[far], nearest[far])
    where, other = far[other >= 0], other[other >= 0]
    if len(where) == 0:
        return foot
    second = polished(field, p[where], samples.point[other], samples.spacing)
    better = np.abs(second.distance) < np.abs(foot.distance[where])
    for kept, found in zip(foot, second, strict=True):
        kept[where[better]] = found[better]
    return foot


def drop(field: Field, y: Float[np.ndarray, "n 3"], steps: int = 6) -> Float[np.ndarray, "n 3"]:
    """Move points that are nearly on the zero level onto it, along the gradient."""
    y = y.T
    for _ in range(steps):
        value, gradient, _ = field.jet(y)
        y = y - value / dot(gradient, gradient) * gradient
    return np.ascontiguousarray(y.T)


def _rival(
    samples: Samples, length: Float[np.ndarray, "n k"], nearest: Int[np.ndarray, "n k"]
) -> Int[np.ndarray, " n"]:
    """Among the nearest samples, the one whose normal is least like the first's, if it is of another sheet; else -1."""
    normal = samples.normal[nearest]
    alike = np.einsum("nki,ni->nk", normal, normal[:, 0])
    # The sheet of a sample at length l may be as near as sqrt(l^2 - spacing^2).
    may_win = length**2 - samples.spacing**2 < length[:, :1] ** 2
    alike = np.where(may_win, alike, 1.0)
    least = np.argmin(alike, axis=1)
    row = np.arange(len(nearest))
    rival: Int[np.ndarray, " n"] = np.where(alike[row, least] < 0.9, nearest[row, least], -1)
    return rival


def polished(field: Field, p: Float[np.ndarray, "n 3"], start: Float[np.ndarray, "n 3"], spacing: float) -> Foot:
    """Feet by Newton's iteration from given starts; each point leaves it as its step reaches its own rounding."""
    y, p_ = np.ascontiguousarray(start.T), np.ascontiguousarray(p.T)
    live = np.arange(len(p))
    for _ in range(_STEPS):
        step = _newton(field, p_[:, live], y[:, live])
        size = np.sqrt(dot(step, step))
        y[:, live] += step * np.minimum(1.0, spacing / np.where(size > 0, size, 1.0))
        # Convergence is quadratic: after a step of 1e-9 the next would be rounding.
        live = live[size > _SETTLED]
        if len(live) == 0:
            break
    # What is left is at a centre of curvature: any place near the foot is as far, if only it is on the surface.
    y[:, live] = drop(field, y[:, live].T).T
    gradient = field.jet(y).gradient
    n = gradient / np.sqrt(dot(gradient, gradient))
    return Foot(np.ascontiguousarray(y.T), np.ascontiguousarray(n.T), dot(p_ - y, n))


def _newton(field: Field, p: Float[np.ndarray, "3 n"], y: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "3 n"]:
    """Step of the iteration from y; where the second-order condition of a minimum fails, one that descends."""
    value, gradient, hessian = field.jet(y)
    size = np.sqrt(dot(gradient, gradient))
    at = frame(gradient / size)
    h1, h2 = times(hessian, at.e1), times(hessian, at.e2)
    off, sunk = p - y, -value / size
    lever = dot(off, at.n) / size
    s11, s12, s22 = lever * dot(h1, at.e1), lever * dot(h1, at.e2), lever * dot(h2, at.e2)
    # A step of `sunk` along n turns the tangent equation by d times what the normal changes along n.
    r1 = dot(off, at.e1) - lever * sunk * dot(h1, at.n)
    r2 = dot(off, at.e2) - lever * sunk * dot(h2, at.n)
    a, c = 1 + s11, 1 + s22
    determinant = a * c - s12 * s12
    convex = (determinant > 0) & (a + c > 0)
    inverse = 1 / np.where(convex, determinant, 1.0)
    calm = 1 / (1 + np.abs(s11) + np.abs(s22) + np.abs(s12))
    t1 = np.where(convex, (c * r1 - s12 * r2) * inverse, r1 * calm)
    t2 = np.where(convex, (a * r2 - s12 * r1) * inverse, r2 * calm)
    step: Float[np.ndarray, "3 n"] = sunk * at.n + t1 * at.e1 + t2 * at.e2
    return step
