"""Closed-form truth: ray differentials over an exact shape, sharing no code with the renderer.

In: an exact shape and rays with differentials. Out: per hop the distance, position, normal, texture coordinates and
their derivatives per pixel, good to the rounding of float64. Igehy 1999, eq. 10 to 18; dn = H dp with H the shape
operator, which is the Hessian of the exact distance on the surface.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from datasets_synthetic import ExactShape
from validate.beam import Beam, MeshRays, only
from validate.interior import leave

# What a surface does: an index is that of a clear solid in air, None is a mirror.
Event = float | None

# A mirrored ray starts this far off its surface, in units of the shape's size: clear of the rounding of the start, and
# taken back by the Newton steps that polish the hit.
LIFT = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class ExactHits:
    """First hits on an exact shape; a miss has infinite `t`, `chart` and `part` -1, and zeros elsewhere."""

    t: Float[np.ndarray, " n"]
    p: Float[np.ndarray, "n 3"]
    n: Float[np.ndarray, "n 3"]
    uv: Float[np.ndarray, "n 2"]
    chart: Int[np.ndarray, " n"]
    part: Int[np.ndarray, " n"]
    duv_dx: Float[np.ndarray, "n 2"]
    duv_dy: Float[np.ndarray, "n 2"]

    @property
    def hit(self) -> Bool[np.ndarray, " n"]:
        """True where the ray met the shape."""
        return np.asarray(np.isfinite(self.t))


@dataclass(frozen=True, slots=True, eq=False)
class ExactStep:
    """One segment and the surface at its end, of the m rays that have met a surface at every step before.

    Attributes
    ----------
    alive
        Their numbers among the rays that are followed.
    hits, at, after
        What they meet, the rays there, and the rays beyond that surface (those at it, for the last one).
    """

    alive: Int[np.ndarray, " m"]
    hits: ExactHits
    at: MeshRays
    after: MeshRays


@dataclass(frozen=True, slots=True, eq=False)
class ExactReference:
    """Ray differentials over an exact shape."""

    shape: ExactShape

    def transfer(self, rays: Beam, *, on_surface: bool = False) -> tuple[ExactHits, MeshRays]:
        """Carry rays to their first hit, from either side; with `on_surface` they start on the shape and leave it."""
        t, p, n = self._meet(rays.p, rays.d, on_surface=on_surface)
        hit = np.isfinite(t)
        column, length = hit[:, None], np.where(hit, t, 0.0)[:, None]
        slope = np.sum(n * rays.d, axis=1, keepdims=True)
        slope = np.where(slope != 0.0, slope, np.inf)
        dp_dx, dp_dy = (
            moved - np.sum(n * moved, axis=1, keepdims=True) / slope * rays.d
            for moved in (rays.dp_dx + length * rays.dd_dx, rays.dp_dy + length * rays.dd_dy)
        )
        gradient = _at_hits(self.shape.uv_gradient, p, hit)
        duv_dx, duv_dy = (np.einsum("nkj,nj->nk", gradient, dp) for dp in (dp_dx, dp_dy))
        uv = _at_hits(self.shape.uv, p, hit)
        chart, part = (np.where(hit, _at_hits(ids, p, hit), -1) for ids in (self.shape.chart, self.shape.part))
        hits = ExactHits(t, np.where(column, p, 0.0), n, uv, chart, part, duv_dx, duv_dy)
        return hits, MeshRays(np.where(column, p, rays.p), rays.d, dp_dx, dp_dy, rays.dd_dx, rays.dd_dy)

    def reflect(self, hits: ExactHits, rays: Beam) -> MeshRays:
        """Mirror rays at their hits; misses pass unchanged."""
        n, d = hits.n, rays.d
        along = np.sum(d * n, axis=1, keepdims=True)
        operator = _at_hits(self.shape.hessian, hits.p, hits.hit)
        turned = []
        for dp, dd in ((rays.dp_dx, rays.dd_dx), (rays.dp_dy, rays.dd_dy)):
            dn = np.einsum("nij,nj->ni", operator, dp)
            turned.append(dd - 2.0 * (along * dn + np.sum(dd * n + d * dn, axis=1, keepdims=True) * n))
        return MeshRays(rays.p, d - 2.0 * along * n, rays.dp_dx, rays.dp_dy, turned[0], turned[1])

    def refract(self, hits: ExactHits, rays: Beam, index: float) -> MeshRays:
        """Let rays pass the surface of a clear solid in air, or mirror them where nothing passes; misses stay.

        Igehy 1999, eq. 15 to 18 with N towards the ray, c = -D.N and c' = -D'.N: D' = eta D - mu N. In place of
        mu = c' - eta c, which has no digits left near eta = 1, stands (1 - eta^2) / (c' + eta c).
        """
        slope = np.sum(rays.d * hits.n, axis=1, keepdims=True)
        outward = slope > 0
        n, c = np.where(outward, -hits.n, hits.n), np.abs(slope)
        eta = np.where(outward, index, 1.0 / index)
        step = (1.0 - eta) * (1.0 + eta)
        squared = step + (eta * c) ** 2  # 1 - eta^2 (1 - c^2)
        passes = squared > 0
        beyond = np.sqrt(np.where(passes, squared, 1.0))
        mu = step / (beyond + eta * c)
        operator = _at_hits(self.shape.hessian, hits.p, hits.hit)
        turned = []
        for dp, dd in ((rays.dp_dx, rays.dd_dx), (rays.dp_dy, rays.dd_dy)):
            dn = np.where(outward, -1.0, 1.0) * np.einsum("nij,nj->ni", operator, dp)
            dmu = (eta - eta * eta * c / beyond) * np.sum(dd * n + rays.d * dn, axis=1, keepdims=True)
            turned.append(eta * dd - (mu * dn + dmu * n))
        mirrored = self.reflect(hits, rays)
        through = passes & hits.hit[:, None]
        d, dd_dx, dd_dy = (
            np.where(through, new, old)
            for new, old in (
                (eta * rays.d - mu * n, mirrored.d),
                (turned[0], mirrored.dd_dx),
                (turned[1], mirrored.dd_dy),
            )
        )
        return MeshRays(rays.p, d, rays.dp_dx, rays.dp_dy, dd_dx, dd_dy)

    def steps(self, rays: Beam, events: Sequence[Event]) -> Iterator[ExactStep]:
        """Trace rays to one surface more than there are events, which say what the surfaces before it do."""
        alive, beam = np.arange(len(rays.p)), rays
        for number in range(len(events) + 1):
            hits, at = self.transfer(beam, on_surface=number > 0)
            after = self._beyond(hits, at, events[number]) if number < len(events) else at
            yield ExactStep(alive, hits, at, after)
            hit = np.flatnonzero(hits.hit)
            alive, beam = alive[hit], only(after, hit)

    def follow(self, rays: Beam, events: int | Sequence[Event]) -> list[ExactHits]:
        """Trace rays through events, or so many mirrors; one `ExactHits` per hop, the camera's own first."""
        course = (None,) * events if isinstance(events, int) else events
        return [_spread(step.hits, step.alive, len(rays.p)) for step in self.steps(rays, course)]

    def _beyond(self, hits: ExactHits, at: MeshRays, event: Event) -> MeshRays:
        return self.reflect(hits, at) if event is None else self.refract(hits, at, event)

    @property
    def _size(self) -> float:
        low, high = self.shape.bounds
        return float(np.linalg.norm(high - low))

    def _meet(
        self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], *, on_surface: bool
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Distance, position and normal of the first hit; the distance polished by two Newton steps."""
        inside = np.sum(self.shape.normal(o) * d, axis=1) < 0 if on_surface else self.shape.distance(o) < 0
        start = o + LIFT * self._size * self.shape.normal(o) if on_surface else o
        t = np.empty(len(o))
        t[~inside] = self.shape.intersect(start[~inside], d[~inside])
        t[inside] = leave(self.shape, o[inside], d[inside], self._size)
        rows = np.flatnonzero(np.isfinite(t))
        for _ in range(2):
            p = o[rows] + t[rows, None] * d[rows]
            slope = np.sum(self.shape.normal(p) * d[rows], axis=1)
            # At a silhouette the closed form is as good as it gets: a step there would divide by nothing.
            steep = np.abs(slope) > 1e-6
            t[rows] -= np.where(steep, self.shape.distance(p) / np.where(steep, slope, 1.0), 0.0)
        p = o + np.where(np.isfinite(t), t, 0.0)[:, None] * d
        return t, p, _at_hits(self.shape.normal, p, np.isfinite(t))


def _at_hits(
    answer: Callable[[np.ndarray], np.ndarray], p: Float[np.ndarray, "n 3"], hit: Bool[np.ndarray, " n"]
) -> np.ndarray:
    """What a shape answers at the hits, 0 elsewhere: it may be slow."""
    rows = np.flatnonzero(hit)
    found = answer(p[rows])
    out = np.zeros((len(p), *found.shape[1:]), found.dtype)
    out[rows] = found
    return out


def _spread(hits: ExactHits, where: Int[np.ndarray, " m"], count: int) -> ExactHits:
    """Hits of some rays among `count`; the others missed."""

    def spread(values: np.ndarray, blank: float | int) -> np.ndarray:
        out = np.full((count, *values.shape[1:]), blank, values.dtype)
        out[where] = values
        return out

    return ExactHits(
        t=spread(hits.t, np.inf),
        p=spread(hits.p, 0.0),
        n=spread(hits.n, 0.0),
        uv=spread(hits.uv, 0.0),
        chart=spread(hits.chart, -1),
        part=spread(hits.part, -1),
        duv_dx=spread(hits.duv_dx, 0.0),
        duv_dy=spread(hits.duv_dy, 0.0),
    )
