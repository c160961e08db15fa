"""The reference: ray differentials over the mesh itself, hits by Embree, numbers in float64.

In: a mesh and rays with differentials. Out: per hop the face, distance, position, normal, texture coordinates and
their derivatives per pixel. Igehy 1999 (transfer, reflection, interpolated normals). This file never sees a grid: it
shares no code with what it judges.
"""

from dataclasses import dataclass, replace

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int

from sdfbake.mesh import Mesh
from validate.beam import Beam, MeshRays
from validate.facets import Facets, Normals, unit

# In the unit box that Embree works in, float32 positions are good to 6e-8 and an intersection to a few of those; a
# start point is lifted off its face by this much, in the query alone.
LIFT = 2e-6
# A barycentric coordinate in float64 is good to a few units of 2e-16 times the face's slenderness; beyond this the ray
# crosses another face than the one that float32 named.
OUTSIDE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class MeshHits:
    """First hits on the mesh; a miss has `face`, `chart` and `part` -1, `t` infinite and zeros elsewhere.

    Attributes
    ----------
    face
        Face id.
    t
        Ray distance in the mesh's unit.
    p
        Position o + t d.
    barycentric
        Weights of the three corners, clamped to the face.
    n
        Unit normal, geometric or interpolated as asked, on the mesh's own outer side.
    uv, chart, part
        Texture coordinates, chart and part.
    duv_dx, duv_dy
        Derivative of the texture coordinates per pixel step; zero from `first_hit`, which knows no pixels.
    clamped
        True where no face around the one that Embree named contains the float64 hit (silhouettes).
    """

    face: Int[np.ndarray, " n"]
    t: Float[np.ndarray, " n"]
    p: Float[np.ndarray, "n 3"]
    barycentric: Float[np.ndarray, "n 3"]
    n: Float[np.ndarray, "n 3"]
    uv: Float[np.ndarray, "n 2"]
    chart: Int[np.ndarray, " n"]
    part: Int[np.ndarray, " n"]
    duv_dx: Float[np.ndarray, "n 2"]
    duv_dy: Float[np.ndarray, "n 2"]
    clamped: Bool[np.ndarray, " n"]

    @property
    def hit(self) -> Bool[np.ndarray, " n"]:
        """True where the ray met the mesh."""
        return np.asarray(self.face >= 0)


class MeshReference:
    """Ray differentials over a triangle mesh.

    Parameters
    ----------
    mesh
        Triangles, with texture coordinates where `uv` and its derivatives are wanted (zeros otherwise).

    Raises
    ------
    BadInput
        If the mesh has no faces.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.facets = Facets(mesh)
        low, high = mesh.bounds
        self._centre = (low + high) / 2
        self._scale = 1.0 / max(float((high - low).max()) / 2, np.finfo(np.float64).tiny)
        self._scene = EmbreeScene(robust=True)
        boxed = ((mesh.vertices - self._centre) * self._scale).astype(np.float32)
        TriangleMesh(self._scene, boxed, mesh.faces.astype(np.int32))

    def first_hit(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        start: Int[np.ndarray, " n"] | None = None,
        normals: Normals = "faceted",
    ) -> MeshHits:
        """Find the first face along each ray.

        Embree names the face in float32; distance, barycentrics and position are computed anew in float64, and where
        they lie outside that face the faces around it are asked.

        Parameters
        ----------
        origins, directions
            World frame; directions of unit length.
        start
            Face that a ray starts on, -1 for none; it is never hit again.
        normals
            Geometric normals, or vertex normals averaged by area or by angle and interpolated.
        """
        o, d = np.asarray(origins, np.float64), np.asarray(directions, np.float64)
        start = np.full(len(o), -1, np.int64) if start is None else np.asarray(start, np.int64)
        face, t, weights, clamped = self._recompute(o, d, start, self._query(o, d, start))
        hit = face >= 0
        column, row = hit[:, None], np.where(hit, face, 0)
        return MeshHits(
            face=face,
            t=np.where(hit, t, np.inf),
            p=np.where(column, o + t[:, None] * d, 0.0),
            barycentric=weights,
            n=np.where(column, self._normal(row, weights, normals), 0.0),
            uv=np.where(column, np.einsum("nc,nck->nk", weights, self.facets.uv[row]), 0.0),
            chart=np.where(hit, self.mesh.chart[row], -1),
            part=np.where(hit, self.mesh.part[row], -1),
            duv_dx=np.zeros((len(o), 2)),
            duv_dy=np.zeros((len(o), 2)),
            clamped=clamped,
        )

    def _query(
        self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], start: Int[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
        """Ask Embree for face ids, from origins brought near the box and lifted off their own face."""
        boxed = (o - self._centre) * self._scale
        # The box lies within sqrt 3 of its centre; float32 resolves a start just outside that, not one far away.
        boxed = boxed + np.maximum(-np.sum(boxed * d, axis=1) - 2.0, 0.0)[:, None] * d
        own = np.where(start[:, None] >= 0, self.facets.normal[start], 0.0)
        boxed = boxed + LIFT * np.sign(np.sum(own * d, axis=1))[:, None] * own
        face = np.full(len(o), -1, np.int64)
        todo = np.arange(len(o))
        for step in (0.0, LIFT, 8 * LIFT, 64 * LIFT):  # a ray that skims its own face may need a push along its way
            if len(todo) == 0:
                break
            where = (boxed[todo] + step * d[todo]).astype(np.float32)
            face[todo] = self._scene.run(where, d[todo].astype(np.float32))
            todo = todo[(face[todo] == start[todo]) & (face[todo] >= 0)]
        face[todo] = -1
        return face

    def _recompute(
        self,
        o: Float[np.ndarray, "n 3"],
        d: Float[np.ndarray, "n 3"],
        start: Int[np.ndarray, " n"],
        named: Int[np.ndarray, " n"],
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
        """Face, distance and barycentrics in float64, and where they had to be clamped."""
        face = named.copy()
        t, weights = self.facets.cross_plane(o, d, np.where(face >= 0, face, 0))
        wrong = np.flatnonzero((face >= 0) & (weights.min(axis=1) < -OUTSIDE))
        clamped = np.zeros(len(o), bool)
        if len(wrong):
            place, candidate = self.facets.ring(face[wrong])
            ray = wrong[place]
            near, inside = self.facets.cross_plane(o[ray], d[ray], candidate)
            good = (inside.min(axis=1) >= -OUTSIDE) & (near >= 0) & (candidate != start[ray])
            order = np.flatnonzero(good)
            order = order[np.lexsort((-candidate[order], -near[order]))]  # written last wins: nearest, then lowest id
            face[ray[order]], t[ray[order]], weights[ray[order]] = candidate[order], near[order], inside[order]
            clamped[np.setdiff1d(wrong, ray[order])] = True
        weights = np.clip(weights, 0.0, 1.0)
        return face, np.maximum(t, 0.0), weights / weights.sum(axis=1, keepdims=True), clamped

    def _normal(
        self, face: Int[np.ndarray, " n"], weights: Float[np.ndarray, "n 3"], normals: Normals
    ) -> Float[np.ndarray, "n 3"]:
        if normals == "faceted":
            return np.asarray(self.facets.normal[face])
        return unit(np.einsum("nc,nck->nk", weights, self.facets.corner_normal(normals)[face]))

    def _normal_derivative(
        self, hits: MeshHits, dp: Float[np.ndarray, "n 3"], normals: Normals
    ) -> Float[np.ndarray, "n 3"]:
        """Derivative of the unit normal for a step `dp` in the face: differentiate, project, normalise."""
        if normals == "faceted":
            return np.zeros_like(dp)
        row = np.where(hits.hit, hits.face, 0)
        corner = self.facets.corner_normal(normals)[row]
        m = np.einsum("nc,nck->nk", hits.barycentric, corner)
        dm = np.einsum("ncj,nj,nck->nk", self.facets.barycentric_gradient[row], dp, corner)
        length = np.linalg.norm(m, axis=1, keepdims=True)
        dm = dm - hits.n * np.sum(hits.n * dm, axis=1, keepdims=True)
        return np.where(hits.hit[:, None], dm / np.where(length > 0, length, 1.0), 0.0)

    def transfer(
        self, rays: Beam, start: Int[np.ndarray, " n"] | None = None, normals: Normals = "faceted"
    ) -> tuple[MeshHits, MeshRays]:
        """Carry rays to their first hit (Igehy 1999, eq. 10), on the geometric face whatever the shading normal.

        Returns
        -------
        MeshHits
            With `duv_dx` and `duv_dy`, the footprint.
        MeshRays
            The rays at the hits: dp = (dp + t dd) + dt d, tangent to the face. Misses keep their origin.
        """
        hits = self.first_hit(rays.p, rays.d, start, normals)
        column, row = hits.hit[:, None], np.where(hits.hit, hits.face, 0)
        n, t = self.facets.normal[row], np.where(column, hits.t[:, None], 0.0)
        slope = np.sum(n * rays.d, axis=1, keepdims=True)
        slope = np.where(column & (slope != 0.0), slope, np.inf)  # nothing moves along a ray that lies in its face
        dp_dx, dp_dy = (
            moved - np.sum(n * moved, axis=1, keepdims=True) / slope * rays.d
            for moved in (rays.dp_dx + t * rays.dd_dx, rays.dp_dy + t * rays.dd_dy)
        )
        gradient = np.where(column[..., None], self.facets.uv_gradient[row], 0.0)
        duv_dx, duv_dy = (np.einsum("nkj,nj->nk", gradient, dp) for dp in (dp_dx, dp_dy))
        at = MeshRays(np.where(column, hits.p, rays.p), rays.d, dp_dx, dp_dy, rays.dd_dx, rays.dd_dy)
        return replace(hits, duv_dx=duv_dx, duv_dy=duv_dy), at

    def reflect(self, hits: MeshHits, rays: Beam, normals: Normals = "faceted") -> MeshRays:
        """Mirror rays at their hits (Igehy 1999, eq. 13): d - 2 (d.n) n, and its derivative.

        `normals` must be those that `hits` were found with. Misses pass unchanged: their normal is zero.
        """
        n, d = hits.n, rays.d
        along = np.sum(d * n, axis=1, keepdims=True)
        turned = []
        for dp, dd in ((rays.dp_dx, rays.dd_dx), (rays.dp_dy, rays.dd_dy)):
            dn = self._normal_derivative(hits, dp, normals)
            turned.append(dd - 2.0 * (along * dn + np.sum(dd * n + d * dn, axis=1, keepdims=True) * n))
        return MeshRays(rays.p, d - 2.0 * along * n, rays.dp_dx, rays.dp_dy, turned[0], turned[1])

    def follow(self, rays: Beam, bounces: int, normals: Normals = "faceted") -> list[MeshHits]:
        """Trace through `bounces` mirror reflections; one `MeshHits` per hop, the camera's own first.

        A ray that an interpolated normal sends below the face it starts on ends there: beyond lies the inside of the
        mesh.
        """
        hits, at = self.transfer(rays, None, normals)
        hops = [hits]
        for _ in range(bounces):
            reflected = self.reflect(hits, at, normals)
            own = self.facets.normal[hits.face]
            turned = np.sum(own * at.d, axis=1) * np.sum(own * reflected.d, axis=1) < 0
            alive = hits.hit & turned
            hits, at = self.transfer(reflected, hits.face, normals)
            hits = _where(hits, alive)
            hops.append(hits)
        return hops


def _where(hits: MeshHits, alive: Bool[np.ndarray, " n"]) -> MeshHits:
    """Turn the hits of dead rays into misses."""
    keep = hits.hit & alive
    column = keep[:, None]
    ids = {name: np.where(keep, getattr(hits, name), -1) for name in ("face", "chart", "part")}
    vectors = {name: np.where(column, getattr(hits, name), 0.0) for name in ("p", "n", "uv", "duv_dx", "duv_dy")}
    return replace(hits, t=np.where(keep, hits.t, np.inf), clamped=hits.clamped & keep, **ids, **vectors)
