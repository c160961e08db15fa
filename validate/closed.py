"""Closed-form truth: ray differentials over an exact shape, sharing no code with the renderer.

In: an exact shape and rays with differentials. Out: per hop the distance, position, normal, texture coordinates and
their derivatives per pixel, good to the rounding of float64. Igehy 1999, eq. 10 to 13; dn = H dp with H the shape
operator, which is the Hessian of the exact distance on the surface.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from datasets_synthetic import ExactShape
from validate.beam import Beam, MeshRays, only

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
class ExactReference:
    """Ray differentials over an exact shape."""

    shape: ExactShape

    def transfer(self, rays: Beam, *, on_surface: bool = False) -> tuple[ExactHits, MeshRays]:
        """Carry rays to their first hit; with `on_surface` they start on the shape and leave it."""
        t, p, n = self._meet(rays.p, rays.d, on_surface=on_surface)
        hit = np.isfinite(t)
        column, length = hit[:, None], np.where(hit, t, 0.0)[:, None]
        slope = np.sum(n * rays.d, axis=1, keepdims=True)
        slope = np.where(slope != 0.0, slope, np.inf)
        dp_dx, dp_dy = (
            moved - np.sum(n * moved, axis=1, keepdims=True) / slope * rays.d
            for moved in (rays.dp_dx + length * rays.dd_dx, rays.dp_dy + length * rays.dd_dy)
        )
        gradient = np.where(column[..., None], self.shape.uv_gradient(p), 0.0)
        duv_dx, duv_dy = (np.einsum("nkj,nj->nk", gradient, dp) for dp in (dp_dx, dp_dy))
        uv = np.where(column, self.shape.uv(p), 0.0)
        chart, part = (np.where(hit, ids, -1) for ids in (self.shape.chart(p), self.shape.part(p)))
        hits = ExactHits(t, np.where(column, p, 0.0), n, uv, chart, part, duv_dx, duv_dy)
        return hits, MeshRays(np.where(column, p, rays.p), rays.d, dp_dx, dp_dy, rays.dd_dx, rays.dd_dy)

    def reflect(self, hits: ExactHits, rays: Beam) -> MeshRays:
        """Mirror rays at their hits; misses pass unchanged."""
        n, d = hits.n, rays.d
        along = np.sum(d * n, axis=1, keepdims=True)
        operator = np.where(hits.hit[:, None, None], self.shape.hessian(hits.p), 0.0)
        turned = []
        for dp, dd in ((rays.dp_dx, rays.dd_dx), (rays.dp_dy, rays.dd_dy)):
            dn = np.einsum("nij,nj->ni", operator, dp)
            turned.append(dd - 2.0 * (along * dn + np.sum(dd * n + d * dn, axis=1, keepdims=True) * n))
        return MeshRays(rays.p, d - 2.0 * along * n, rays.dp_dx, rays.dp_dy, turned[0], turned[1])

    def follow(self, rays: Beam, bounces: int) -> list[ExactHits]:
        """Trace through `bounces` mirror reflections; one `ExactHits` per hop, the camera's own first."""
        count = len(rays.p)
        alive = np.arange(count)
        hits, at = self.transfer(rays)
        hops = [hits]
        for _ in range(bounces):
            hit = np.flatnonzero(hits.hit)
            alive = alive[hit]
            hits, at = self.transfer(only(self.reflect(hits, at), hit), on_surface=True)
            hops.append(_spread(hits, alive, count))
        return hops

    @property
    def _size(self) -> float:
        low, high = self.shape.bounds
        return float(np.linalg.norm(high - low))

    def _meet(
        self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], *, on_surface: bool
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Distance, position and normal of the first hit; the distance polished by two Newton steps."""
        start = o + LIFT * self._size * self.shape.normal(o) if on_surface else o
        t = self.shape.intersect(start, d)
        hit = np.isfinite(t)
        length = np.where(hit, t, 0.0)
        for _ in range(2):
            p = o + length[:, None] * d
            slope = np.sum(self.shape.normal(p) * d, axis=1)
            # At a silhouette the closed form is as good as it gets: a step there would divide by nothing.
            step = np.where(np.abs(slope) > 1e-6, -self.shape.distance(p) / np.where(slope == 0, 1.0, slope), 0.0)
            length = length + np.where(hit, step, 0.0)
        p = o + length[:, None] * d
        n = np.where(hit[:, None], self.shape.normal(p), 0.0)
        return np.where(hit, length, np.inf), p, n


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
