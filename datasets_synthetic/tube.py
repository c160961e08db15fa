"""The solid within a radius of a closed curve: torus and knot are tubes.

In: a curve that finds its own closest parameter, and a radius below the curve's reach. Out: an exact shape. With c(t)
the curve's closest point to p, w = p - c, l = |w|, n = w / l and f'' = c'.c' - w.c'':

    distance = l - r,   grad t = c' / f'',   Hessian = (I - n n^T - c' c'^T / f'') / l,
    uv = (t, alpha) / 2 pi,   grad alpha = (-sin alpha N + cos alpha B) / r - (N'.B) grad t,

where (N, B) is a smooth closed frame across the curve, right-handed with its tangent (B = N x T).
"""

from dataclasses import dataclass
from math import ceil, pi
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from datasets_synthetic.net import quads
from sdfbake.mesh import Mesh

_TURN = 2 * pi
#: The march ends in under 100 steps on the shapes here; more is a defect, not a slow ray.
_STEPS = 2000


@runtime_checkable
class Curve(Protocol):
    """A smooth closed curve with parameter t in [0, 2 pi)."""

    @property
    def reach(self) -> float:
        """A distance within which every point has one closest point; no curvature exceeds 1 / reach."""
        ...

    @property
    def length(self) -> float:
        """Arc length."""
        ...

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and greatest corner."""
        ...

    def closest(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Parameter of the closest point, in [0, 2 pi)."""
        ...

    def jet(self, t: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position and its first two derivatives, each (n, 3)."""
        ...

    def across(self, t: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Unit vector N across the curve, closed and smooth, and its derivative, each (n, 3)."""
        ...


class _Foot(NamedTuple):
    """The curve's closest point to each p, and the frame there; arrays over n."""

    t: np.ndarray
    length: np.ndarray  # |p - c|
    n: np.ndarray  # unit direction from the curve to p; N on the curve itself
    d1: np.ndarray
    d2: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """A tube; four charts: halves of the parameter times halves of the angle, id = 2 (u >= 1/2) + (v >= 1/2)."""

    curve: Curve
    radius: float
    part_names: tuple[str, ...]

    def __post_init__(self) -> None:
        if not 0 < self.radius < self.curve.reach:
            raise ValueError(f"a tube of radius {self.radius} about a curve of reach {self.curve.reach} meets itself")

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Box of the curve, widened by the radius."""
        return self.curve.bounds + self.radius * np.array([[-1.0], [1.0]])

    @property
    def charts(self) -> int:
        """Two halves along times two halves around."""
        return 4

    @property
    def area(self) -> float:
        """Pappus: circumference times length."""
        return _TURN * self.radius * self.curve.length

    @property
    def volume(self) -> float:
        """Pappus: cross-section times length."""
        return pi * self.radius**2 * self.curve.length

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Distance from the curve less the radius."""
        distance: Float[np.ndarray, " n"] = self._foot(p).length - self.radius
        return distance

    def normal(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Direction from the curve; on the curve itself the frame's N."""
        n: Float[np.ndarray, "n 3"] = self._foot(p).n
        return n

    def hessian(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """(I - n n^T - c' c'^T / f'') / l; 0 on the curve, and without its c' term on the evolute (f'' = 0)."""
        foot = self._foot(p)
        bend = _dot(foot.d1, foot.d1) - foot.length * _dot(foot.n, foot.d2)
        flat = np.eye(3) - _outer(foot.n, foot.n) - _outer(foot.d1, foot.d1) * _inverse(bend)[:, None, None]
        hessian: Float[np.ndarray, "n 3 3"] = flat * _inverse(foot.length)[:, None, None]
        return hessian

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Curve parameter and angle about it, in turns."""
        foot = self._foot(p)
        N, B, _ = self._frame(foot)
        angle = np.mod(np.arctan2(_dot(foot.n, B), _dot(foot.n, N)), _TURN)
        return np.stack([foot.t, angle], axis=1) / _TURN

    def uv_gradient(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
        """Gradients of t and alpha at the foot, in turns."""
        foot = self._foot(p)
        N, B, twist = self._frame(foot)
        along = foot.d1 / (_dot(foot.d1, foot.d1) - self.radius * _dot(foot.n, foot.d2))[:, None]
        around = _dot(foot.n, N)[:, None] * B - _dot(foot.n, B)[:, None] * N
        return np.stack([along, around / self.radius - twist[:, None] * along], axis=1) / _TURN

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Quadrant of the texture square."""
        return _quadrant(self.uv(p))

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """One part."""
        return np.zeros(len(p), np.int64)

    def intersect(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Safe steps along the ray until the distance vanishes; see `_step`.

        A ray counts as a hit if it comes within a few roundings of the surface while it approaches.
        """
        start, end = self._ball(o, d)
        t = np.full(len(o), np.inf)
        live, at = np.flatnonzero(start <= end), start[start <= end]
        size = np.abs(self.bounds).max()
        for _ in range(_STEPS):
            if len(live) == 0:
                return t
            foot = self._foot(o[live] + at[:, None] * d[live])
            gap, slope = foot.length - self.radius, _dot(foot.n, d[live])
            rounding = 4 * np.finfo(np.float64).eps * (size + at)
            hit = (gap <= rounding) & (slope <= 0) & (gap >= -self.radius / 2)
            t[live[hit]] = at[hit]
            at = at + np.maximum(self._step(gap, slope), rounding)
            keep: Bool[np.ndarray, " m"] = ~hit & (at <= end[live])
            live, at = live[keep], at[keep]
        raise RuntimeError("a ray along the tube did not end: a defect of the march")

    def mesh(self, edge: float) -> Mesh:
        """Grid of rings, even in arc length within each half of the parameter, so that cuts fall on rings."""
        around = 2 * max(2, ceil(pi * self.radius / edge))
        t = self._rings(edge)
        angle = np.linspace(0.0, _TURN, around + 1)
        grid = np.stack(np.meshgrid(t, angle, indexing="ij"), axis=-1)
        corners, faces = grid.reshape(-1, 2), quads(len(t) - 1, around)
        i, j = np.divmod(np.arange(len(corners)), around + 1)
        shared = (i % (len(t) - 1)) * around + j % around
        uv = corners[faces] / _TURN
        vertices = self._point(grid[:-1, :-1].reshape(-1, 2))
        return Mesh(vertices, shared[faces], uv, _quadrant(uv.mean(axis=1)), part_names=self.part_names)

    def _rings(self, edge: float) -> Float[np.ndarray, " m"]:
        """Parameters of the rings, 0 and 2 pi included, `edge` apart where the tube is on average wide."""
        rings = [np.zeros(1)]
        for low in (0.0, pi):
            fine = np.linspace(low, low + pi, 4097)
            speed = np.linalg.norm(self.curve.jet(fine)[1], axis=1)
            arc = np.concatenate([np.zeros(1), np.cumsum(speed[1:] + speed[:-1]) * (pi / 8192)])
            count = max(2, ceil(arc[-1] / edge))
            rings.append(np.append(np.interp(np.arange(1, count) / count * arc[-1], arc, fine), low + pi))
        return np.concatenate(rings)

    def _point(self, turn: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Surface point at (t, alpha) in radians."""
        c, d1, _ = self.curve.jet(turn[:, 0])
        N, _ = self.curve.across(turn[:, 0])
        B = np.cross(N, d1 / np.linalg.norm(d1, axis=1, keepdims=True))
        cos, sin = np.cos(turn[:, 1:]), np.sin(turn[:, 1:])
        point: Float[np.ndarray, "n 3"] = c + self.radius * (cos * N + sin * B)
        return point

    def _foot(self, p: Float[np.ndarray, "n 3"]) -> _Foot:
        t = self.curve.closest(p)
        c, d1, d2 = self.curve.jet(t)
        offset = p - c
        length = np.linalg.norm(offset, axis=1)
        n = np.where((length > 0)[:, None], offset * _inverse(length)[:, None], self.curve.across(t)[0])
        return _Foot(t, length, n, d1, d2)

    def _frame(self, foot: _Foot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """N, B, each (n, 3), and the twist N'.B, (n,)."""
        N, N_t = self.curve.across(foot.t)
        B = np.cross(N, foot.d1 / np.linalg.norm(foot.d1, axis=1, keepdims=True))
        return N, B, _dot(N_t, B)

    def _step(self, gap: Float[np.ndarray, " m"], slope: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """How far a ray may go without crossing the surface.

        Either `gap` (the distance is 1-Lipschitz) or, within the reach R of the curve, the first root of
        gap + slope s - K s^2 / 2: along any line the second derivative of the distance is at least -1 / (R - l), and
        l grows by at most s, so that K = 2 / (R - l) holds for s up to (R - l) / 2. Towards a transverse hit it is
        Newton's step kept short of the root; past a near miss it doubles.
        """
        room = self.curve.reach - self.radius - gap
        K = np.where(room > 0, 2 * _inverse(room), 1.0)
        ahead = np.sqrt(slope * slope + 2 * K * np.maximum(gap, 0.0))
        # Two forms of the same root, each without cancellation for its sign of the slope.
        falling = 2 * np.maximum(gap, 0.0) * _inverse(ahead - slope)
        root = np.where(slope > 0, (ahead + slope) / K, falling)
        step: Float[np.ndarray, " m"] = np.maximum(gap, np.where(room > 0, np.minimum(root, room / 2), 0.0))
        return step

    def _ball(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Where each ray enters (at least 0) and leaves a ball around the tube; enter > leave for a miss."""
        middle = self.bounds.mean(axis=0)
        radius = np.linalg.norm(self.bounds[1] - middle)
        offset = o - middle
        centre = -_dot(offset, d)
        room = radius - np.linalg.norm(offset + centre[:, None] * d, axis=1)
        half = np.sqrt(np.maximum(room, 0.0) * (2 * radius - room))
        return np.maximum(centre - half, 0.0), np.where(room >= 0, centre + half, -1.0)


def _quadrant(uv: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    quadrant: Int[np.ndarray, " n"] = (uv >= 0.5) @ np.array([2, 1])
    return quadrant


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    product: np.ndarray = np.sum(a * b, axis=1)
    return product


def _outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    product: np.ndarray = a[:, :, None] * b[:, None, :]
    return product


def _inverse(x: np.ndarray) -> np.ndarray:
    """1 / x, and 0 where x is 0: the caller says what that limit means."""
    zero = x == 0
    return np.where(zero, 0.0, 1 / np.where(zero, 1.0, x))
