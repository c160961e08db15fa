"""The knot: a tube around the (2, 3) torus knot.

In: the radii of the torus that the curve winds on, and of the tube. Out: a `Tube`. With a = R + b cos 3t the curve is
c(t) = (a cos 2t, a sin 2t, b sin 3t); its frame vector N is the normal of that torus. The closest parameter comes from
dense samples and a safeguarded Newton iteration on (c(t) - p).c'(t) = 0 to the rounding of float64.
"""

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic.tube import Tube

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_SAMPLES = 768
#: Arcs searched one by one when p may be equally far from several strands: none holds two strands.
_ARCS = 6
_STEP = 2 * pi / _SAMPLES


@dataclass(frozen=True, slots=True, eq=False)
class TorusKnot:
    """The (2, 3) torus knot about the z axis; a `Curve`. Build it with `TorusKnot.wound`.

    Within the reach the nearest sample is next to the closest point. Farther out, two strands may be nearly equally
    far: there each arc answers for itself and the closest answer wins.
    """

    major: float
    minor: float
    tree: "cKDTree"
    arcs: tuple["cKDTree", ...]
    reach: float

    @staticmethod
    def wound(major: float, minor: float) -> "TorusKnot":
        """Sample the curve and measure its reach."""
        from scipy.spatial import cKDTree  # costs 0.2 s, and only the knot needs it

        t = _STEP * np.arange(_SAMPLES)
        c = _jet(major, minor, t)[0]
        arcs = tuple(cKDTree(arc) for arc in c.reshape(_ARCS, -1, 3))
        return TorusKnot(major, minor, cKDTree(c), arcs, _reach(major, minor))

    @property
    def length(self) -> float:
        """Trapezoid rule on a periodic analytic function: exact to rounding with this many samples."""
        speed = np.linalg.norm(self.jet(_STEP * np.arange(_SAMPLES))[1], axis=1)
        return float(speed.mean() * 2 * pi)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Extremes of the coordinates, found on the samples and polished by Newton on c' = 0 of that coordinate."""
        c = self.jet(_STEP * np.arange(_SAMPLES))[0]
        t, axis = _STEP * np.concatenate([c.argmin(axis=0), c.argmax(axis=0)]), np.tile(np.arange(3), 2)
        for _ in range(4):
            _, d1, d2 = self.jet(t)
            t = t - d1[np.arange(6), axis] / d2[np.arange(6), axis]
        bounds: Float[np.ndarray, "2 3"] = self.jet(t)[0][np.arange(6), axis].reshape(2, 3)
        return bounds

    def closest(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Parameter of the closest point, in [0, 2 pi)."""
        t, squared = self._polish(p, np.asarray(self.tree.query(p, workers=-1)[1]))
        # A tenth inside the reach, the runner-up is farther by more than the samples' error.
        far = np.flatnonzero(squared > (0.9 * self.reach) ** 2)
        if len(far):
            size = _SAMPLES // _ARCS
            for start, arc in enumerate(self.arcs):
                length, nearest = (np.asarray(found) for found in arc.query(p[far], workers=-1))
                # A sample is at most half a step from the arc's closest point: beyond that the arc cannot win.
                rival = length - self._half_step < np.sqrt(squared[far])
                where = far[rival]
                t_arc, squared_arc = self._polish(p[where], nearest[rival] + start * size)
                better = squared_arc < squared[where]
                t[where[better]], squared[where[better]] = t_arc[better], squared_arc[better]
        closest: Float[np.ndarray, " n"] = np.mod(t, 2 * pi)
        return closest

    def jet(self, t: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position and its first two derivatives."""
        return _jet(self.major, self.minor, t)

    def across(self, t: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Normal of the torus that the curve winds on, and its derivative."""
        c2, s2, c3, s3 = np.cos(2 * t), np.sin(2 * t), np.cos(3 * t), np.sin(3 * t)
        N = np.stack([c3 * c2, c3 * s2, s3], axis=1)
        return N, np.stack([-3 * s3 * c2 - 2 * c3 * s2, -3 * s3 * s2 + 2 * c3 * c2, 3 * c3], axis=1)

    @property
    def _half_step(self) -> float:
        """Half a step times a bound of the speed, |c'|^2 <= 4 (R + b)^2 + 9 b^2."""
        return _STEP / 2 * float(np.hypot(2 * (self.major + self.minor), 3 * self.minor))

    def _polish(self, p: Float[np.ndarray, "n 3"], nearest: Int[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Newton within one sample of the nearest one, bisection where it would leave; t and |p - c|^2, each (n,)."""
        t = _STEP * nearest
        low, high = t - _STEP, t + _STEP
        live = np.arange(len(p))
        for _ in range(60):
            c, d1, d2 = self.jet(t[live])
            slope = np.sum((c - p[live]) * d1, axis=1)
            bend = np.sum(d1 * d1 + (c - p[live]) * d2, axis=1)
            high[live] = np.where(slope > 0, t[live], high[live])
            low[live] = np.where(slope > 0, low[live], t[live])
            middle = (low[live] + high[live]) / 2
            newton = t[live] - slope / np.where(bend > 0, bend, 1.0)
            inside = (bend > 0) & (newton >= low[live]) & (newton <= high[live])
            following = np.where(inside, newton, middle)
            moved = np.abs(following - t[live]) > 2e-16 * 2 * pi
            t[live] = following
            live = live[moved]
            if len(live) == 0:
                break
        squared: Float[np.ndarray, " n"] = np.sum((self.jet(t)[0] - p) ** 2, axis=1)
        return t, squared


def knot(major: float = 0.6, minor: float = 0.28, radius: float = 0.14) -> Tube:
    """Build the knotted tube; u runs along the knot, v around the tube (0 away from the torus it winds on)."""
    return Tube(TorusKnot.wound(major, minor), radius, ("knot",))


def _jet(major: float, minor: float, t: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """c, c', c'' at t; a = R + b cos 3t is the distance from the axis."""
    c2, s2, c3, s3 = np.cos(2 * t), np.sin(2 * t), np.cos(3 * t), np.sin(3 * t)
    a, a1, a2 = major + minor * c3, -3 * minor * s3, -9 * minor * c3
    c = np.stack([a * c2, a * s2, minor * s3], axis=1)
    d1 = np.stack([a1 * c2 - 2 * a * s2, a1 * s2 + 2 * a * c2, 3 * minor * c3], axis=1)
    turned = 4 * a1
    d2 = np.stack([(a2 - 4 * a) * c2 - turned * s2, (a2 - 4 * a) * s2 + turned * c2, -9 * minor * s3], axis=1)
    return c, d1, d2


def _reach(major: float, minor: float) -> float:
    """Reach by Federer 1959, theorem 4.18: inf |q - p|^2 / (2 dist(q - p, tangent at p)) over pairs of the curve.

    Found on 1024 samples, which overestimate it by less than 1e-4 of itself; a hundredth is taken off.
    """
    c, d1, _ = _jet(major, minor, 2 * pi / 1024 * np.arange(1024))
    tangent = d1 / np.linalg.norm(d1, axis=1, keepdims=True)
    chord = c[None] - c[:, None]
    along = np.sum(chord * tangent[:, None], axis=2)
    squared = np.sum(chord * chord, axis=2) + np.eye(1024)
    across = np.sqrt(np.maximum(squared - along * along, 1e-300))
    return 0.99 * float(np.min(squared / (2 * across) + 1e300 * np.eye(1024)))
