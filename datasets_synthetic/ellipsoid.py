"""The ellipsoid with three different axes.

In: half axes a > b > c along x, y, z. Out: an exact shape. The closest point to p is a_i w_i with a unit vector
w_i = a_i p_i / (s + a_i^2 - c^2), where s >= 0 is the greatest root of |w| = 1 (Eberly 2013); Newton's iteration on
1 / |w| = 1 (More and Sorensen 1983) grows towards it from any lower bound. Then, with t = s - c^2,

    distance = t |w_i / a_i|,   n = (w_i / a_i) / |w_i / a_i|.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic.layout import CubeMap
from datasets_synthetic.offset import distance_hessian, tangential
from sdfbake.mesh import Mesh

#: Newton from a lower bound ends in under ten steps but near the medial axis, where a step grows s at least by
#: |w|^2 (|w| - 1); more than this is a defect.
_STEPS = 500
#: Nearer to the plane z = 0 than this, in units of c, p counts as on it: the foot moves by less than its rounding
#: unless s is 0 too, and the iteration need not climb from 1e-300.
_FLAT = 1e-40
#: A step this small, in units of s, is of its own rounding.
_ROUNDING = 2 * np.finfo(np.float64).eps


class _Foot(NamedTuple):
    """Unit vectors w (n, 3) of the feet a w, and t = s - c^2 (n,), negative inside."""

    w: np.ndarray
    t: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """An ellipsoid about the origin; six charts, the cube map of p / a.

    On the part of the plane z = 0 that is the medial axis, the foot above it is used.
    """

    half: tuple[float, float, float]
    part_names: tuple[str, ...] = ("ellipsoid",)

    def __post_init__(self) -> None:
        if not self.half[0] > self.half[1] > self.half[2] > 0:
            raise ValueError("half axes must fall from x to z")

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Half axes."""
        return np.stack([-self._a, self._a])

    @property
    def charts(self) -> int:
        """Six faces of the cube map."""
        return 6

    @property
    def area(self) -> float:
        """Legendre's form: 2 pi (c^2 + a b (E sin^2 phi + F cos^2 phi) / sin phi), cos phi = c / a."""
        from scipy.special import ellipeinc, ellipkinc  # costs 0.1 s, and only the area needs it

        a, b, c = self.half
        phi = np.arccos(c / a)
        m = (a * a * (b * b - c * c)) / (b * b * (a * a - c * c))
        mixed = ellipeinc(phi, m) * np.sin(phi) ** 2 + ellipkinc(phi, m) * np.cos(phi) ** 2
        return float(2 * np.pi * (c * c + a * b * mixed / np.sin(phi)))

    @property
    def volume(self) -> float:
        """(4 / 3) pi a b c."""
        return float(4 / 3 * np.pi * np.prod(self._a))

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """T |w / a|."""
        foot = self._foot(p)
        distance: Float[np.ndarray, " n"] = foot.t * np.linalg.norm(foot.w / self._a, axis=1)
        return distance

    def normal(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """W / a, of unit length."""
        gradient = self._foot(p).w / self._a
        normal: Float[np.ndarray, "n 3"] = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
        return normal

    def hessian(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """From F = (|y / a|^2 - 1) / 2 at the foot: gradient w / a, Hessian diag(1 / a^2)."""
        foot = self._foot(p)
        gradient = foot.w / self._a
        curved = np.repeat(np.append(1 / self._a**2, np.zeros(3))[:, None], len(p), axis=1)
        return distance_hessian(gradient.T, curved, foot.t * np.linalg.norm(gradient, axis=1))

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Cube map of the foot."""
        return self._map.uv(self._foot(p).w * self._a, self.chart(p))

    def uv_gradient(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
        """The cube map's gradient in space, less its share along the normal."""
        y, n = self._foot(p).w * self._a, self.normal(p)
        return tangential(self._map.gradient(y, self._map.chart(y, n)), n)

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Face of the cube map at the foot."""
        w = self._foot(p).w
        return self._map.chart(w * self._a, w)

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """One part."""
        return np.zeros(len(p), np.int64)

    def intersect(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Unit sphere in p / a: lesser root from the line's closest approach there."""
        origin, direction = o / self._a, d / self._a
        speed = np.linalg.norm(direction, axis=1)
        direction = direction / speed[:, None]
        middle = -np.sum(origin * direction, axis=1)
        closest = np.linalg.norm(origin + middle[:, None] * direction, axis=1)
        t = (middle - np.sqrt(np.maximum((1 - closest) * (1 + closest), 0.0))) / speed
        return np.where((closest <= 1) & (t >= 0), t, np.inf)

    def mesh(self, edge: float) -> Mesh:
        """Cube-sphere in p / a, with fewer steps along shorter axes."""
        q, faces = self._map.lattice(edge)
        vertices = q * self._a
        chart = self._map.chart(vertices[faces].mean(axis=1), np.zeros((len(faces), 3)))
        uv = self._map.uv(vertices[faces].reshape(-1, 3), np.repeat(chart, 3)).reshape(-1, 3, 2)
        return Mesh(vertices, faces, uv, chart, part_names=self.part_names)

    @property
    def _a(self) -> Float[np.ndarray, " 3"]:
        return np.asarray(self.half)

    @property
    def _map(self) -> CubeMap:
        return CubeMap(self.half)

    def _foot(self, p: Float[np.ndarray, "n 3"]) -> _Foot:
        """Closest points; by symmetry those of |p|, with the signs put back (+ for 0)."""
        a, least = self._a, self.half[2]
        q = np.abs(p)
        q[:, 2] = np.where(q[:, 2] < _FLAT * least, 0.0, q[:, 2])
        spread = a * a - least * least
        # Where one component alone makes |w| >= 1, s is a lower bound.
        s = np.maximum((a * q - spread).max(axis=1), 0.0)
        live = np.arange(len(p))
        for _ in range(_STEPS):
            w = _over(a * q[live], s[live, None] + spread)
            length = np.sqrt(np.sum(w * w, axis=1))
            slope = np.sum(_over(w * w, s[live, None] + spread), axis=1)
            step = np.where(length > 1, _over(length**2, slope) * (length - 1), 0.0)
            s[live] += step
            live = live[step > _ROUNDING * s[live]]
            if len(live) == 0:
                break
        else:
            raise RuntimeError("the closest point of an ellipsoid was not found: a defect of the iteration")
        w = _over(a * q, s[:, None] + spread)
        # On the medial axis s is 0 and the third component is what the others leave.
        w[:, 2] = np.where(s == 0, np.sqrt(np.maximum(1 - w[:, 0] ** 2 - w[:, 1] ** 2, 0.0)), w[:, 2])
        w = w / np.linalg.norm(w, axis=1, keepdims=True)
        return _Foot(np.where(p < 0, -w, w), s - least * least)


def ellipsoid(a: float = 0.95, b: float = 0.7, c: float = 0.5) -> Ellipsoid:
    """Build an ellipsoid about the origin with half axes a > b > c along x, y, z."""
    return Ellipsoid((a, b, c))


def _over(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Divide, with 0 / 0 = 0: a component that p lacks, the foot lacks too."""
    zero = x == 0
    return np.where(zero, 0.0, x / np.where(zero, 1.0, y))
