"""Solids F < 0 with a smooth F: displaced sphere, terrain and gyroid shell.

In: a field, a texture layout, and a way to triangulate. Out: an exact shape; its closest points are Newton's (see
`closest`), its first hits are certified (see `field`), its area and volume are integrals over the curved facets. On a
facet with normal m whose points have the feet y at signed distance d, the surface's area element is

    n.m / ((1 + d k1) (1 + d k2)),

which turns sums over the flat facets into integrals over the surface, and those of y.n / 3 into the volume.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int

from datasets_synthetic.closest import Foot, Samples, closest, polished
from datasets_synthetic.field import Field
from datasets_synthetic.layout import CubeMap, Projection
from datasets_synthetic.offset import distance_hessian, dot, frame, operator, tangential
from datasets_synthetic.revolution import line_and_slab
from sdfbake.mesh import Mesh

#: Vertices on the surface and faces, with edges about as long as asked for.
Triangulate = Callable[[float], tuple[np.ndarray, np.ndarray]]
#: The march ends in under 200 steps on the shapes here; more is a defect, not a slow ray.
_STEPS = 5000
#: Radon's seven points of degree 5 on a triangle: barycentric coordinates and weights.
_A, _B = (6 - 15**0.5) / 21, (6 + 15**0.5) / 21
_PLACES = np.array(
    [[1 / 3, 1 / 3, 1 / 3]]
    + [[w if k == j else (1 - w) / 2 for k in range(3)] for w in (1 - 2 * _A, 1 - 2 * _B) for j in range(3)]
)
_WEIGHTS = np.array([9 / 40] + [(155 - 15**0.5) / 1200] * 3 + [(155 + 15**0.5) / 1200] * 3)


@dataclass(frozen=True, slots=True, eq=False)
class Implicit:
    """A smooth implicit solid. Build it with `Implicit.of`.

    Distances are exact to rounding within the reach of the surface, and beyond but for the bound that `closest` states.

    Attributes
    ----------
    bounds
        (2, 3), of the samples, widened by their spacing's share: it holds the solid, with less than 1e-3 to spare.
    """

    field: Field
    layout: CubeMap | Projection
    triangulate: Triangulate
    samples: Samples
    bounds: Float[np.ndarray, "2 3"]
    part_names: tuple[str, ...]

    @staticmethod
    def of(field: Field, layout: CubeMap | Projection, triangulate: Triangulate, edge: float, name: str) -> "Implicit":
        """Sample the surface `edge` apart, and measure it."""
        vertices, faces = triangulate(edge)
        corners = vertices[faces]
        longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
        # No point of a triangle is farther from its corners than its longest edge over sqrt(3).
        samples = Samples.of(field, vertices, longest / 3**0.5)
        slack = 0.5 * longest**2 * np.array([[-1.0], [1.0]])
        bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)]) + slack
        return Implicit(field, layout, triangulate, samples, bounds, (name,))

    @property
    def charts(self) -> int:
        """Six sides."""
        return 6

    @property
    def area(self) -> float:
        """Integral over the curved facets, to 1e-6 of itself."""
        return _measured(self)[0]

    @property
    def volume(self) -> float:
        """Integral over the curved facets, to 1e-6 of itself."""
        return _measured(self)[1]

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Distance to the foot."""
        distance: Float[np.ndarray, " n"] = self._foot(p).distance
        return distance

    def normal(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Normal at the foot."""
        normal: Float[np.ndarray, "n 3"] = self._foot(p).n
        return normal

    def hessian(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """From the shape operator at the foot, see `offset`."""
        foot = self._foot(p)
        _, gradient, hessian = self.field.jet(foot.y.T)
        return distance_hessian(gradient, hessian, foot.distance)

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """The layout's, at the foot."""
        foot = self._foot(p)
        return self.layout.uv(foot.y, self.layout.chart(foot.y, foot.n))

    def uv_gradient(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
        """The layout's gradient in space, less its share along the normal."""
        foot = self._foot(p)
        return tangential(self.layout.gradient(foot.y, self.layout.chart(foot.y, foot.n)), foot.n)

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """The layout's, at the foot."""
        foot = self._foot(p)
        return self.layout.chart(foot.y, foot.n)

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """One part."""
        return np.zeros(len(p), np.int64)

    def intersect(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """March by steps that cannot cross the surface; a hit is where F is down to its rounding while it falls.

        F at o + t d is rounded by the rounding of that point times the slope of F. The last Newton step takes t, and so
        the point, to the rounding of the root.
        """
        at, end = _through(self.bounds, o, d)
        t, o_, d_ = np.full(len(o), np.inf), np.ascontiguousarray(o.T), np.ascontiguousarray(d.T)
        live = np.flatnonzero(at <= end)
        at = at[live]
        size = float(np.abs(self.bounds).max())
        for _ in range(_STEPS):
            if len(live) == 0:
                return t
            probe = self.field.probe(o_[:, live] + at * d_[:, live], d_[:, live])
            rounding = 4 * np.finfo(np.float64).eps * (size + at)
            near: Bool[np.ndarray, " m"] = np.abs(probe.value) <= rounding * self.field.steepest
            hit = near & (probe.slope <= 0)
            steep = hit & (probe.slope < -1e-6)
            last = np.where(steep, -probe.value / np.where(steep, probe.slope, 1.0), 0.0)
            t[live[hit]] = np.maximum(at + last, 0.0)[hit]
            at = at + np.maximum(probe.free, rounding)
            keep = ~hit & (at <= end[live])
            live, at = live[keep], at[keep]
        raise RuntimeError("a ray along an implicit solid did not end: a defect of the march")

    def mesh(self, edge: float) -> Mesh:
        """Triangulation with the layout's texture; a face is of the chart of its middle."""
        vertices, faces = self.triangulate(edge)
        chart = self.chart(vertices[faces].mean(axis=1))
        uv = self.layout.uv(vertices[faces].reshape(-1, 3), np.repeat(chart, 3)).reshape(-1, 3, 2)
        return Mesh(vertices, faces, uv, chart, part_names=self.part_names)

    def _foot(self, p: Float[np.ndarray, "n 3"]) -> Foot:
        return closest(self.field, self.samples, p)


@cache
def _measured(shape: Implicit) -> tuple[float, float]:
    """Area and volume; a place of the quadrature at a time, its feet sought from the nearest corner."""
    vertices, faces = shape.triangulate(2 * shape.samples.spacing)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = volume = 0.0
    for place, weight in zip(_PLACES, _WEIGHTS, strict=True):
        foot = polished(shape.field, place @ corners, corners[:, np.argmax(place)], shape.samples.spacing)
        _, gradient, hessian = shape.field.jet(foot.y.T)
        s11, s12, s22 = operator(frame(foot.n.T), np.sqrt(dot(gradient, gradient)), hessian)
        bend = (1 + foot.distance * s11) * (1 + foot.distance * s22) - (foot.distance * s12) ** 2
        element = weight / 2 * np.sum(foot.n * cross, axis=1) / bend
        area += float(element.sum())
        volume += float(np.sum(element * np.sum(foot.y * foot.n, axis=1))) / 3
    return area, volume


def _through(
    bounds: Float[np.ndarray, "2 3"], o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]
) -> tuple[np.ndarray, np.ndarray]:
    """Where rays enter (at least 0) and leave the bounds; enter > leave for a miss."""
    turned = [np.roll(v, -axis - 1, axis=1) for axis in range(3) for v in (o, d)]
    slabs = [line_and_slab(turned[2 * k], turned[2 * k + 1], *map(float, bounds[:, k])) for k in range(3)]
    enter, leave = (np.stack(ends) for ends in zip(*slabs, strict=True))
    return np.maximum(enter.max(axis=0), 0.0), leave.min(axis=0)
