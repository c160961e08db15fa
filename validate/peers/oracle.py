"""The truth that every tool is held against: float64 distances, winding numbers, faces beyond ties.

In: a mesh, a lattice, and what a tool says at samples near the surface. Out: `Judged` figures in voxels. libigl finds
the distances and winding numbers; of our own baker only the tables around them are used.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sdfbake import triangle
from sdfbake.closest import Surface
from sdfbake.engine.numpy import NumpyEngine
from sdfbake.lattice import Lattice
from sdfbake.mesh import Mesh
from sdfbake.sign import Winding
from sdfbake.topology import twice_areas

NEAR = 3.0  # voxels: what the narrowest band of a tool reaches
# Of faces that differ by less than this part of the mesh's half extent none is nearer: 1e6 roundings of float64.
_TIE = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class Oracle:
    """A mesh, ready to be asked."""

    mesh: Mesh
    surface: Surface
    winding: Winding

    @staticmethod
    def of(mesh: Mesh) -> "Oracle":
        """Build the trees."""
        surface = Surface.of(mesh)
        return Oracle(mesh, surface, Winding.of(surface))

    def chosen(self, lattice: Lattice, count: int, seed: int) -> "Truth":
        """Choose up to `count` samples of a lattice within `NEAR` voxels of the surface, and ask about them."""
        rng = np.random.default_rng(seed)
        area = twice_areas(self.mesh.vertices, self.mesh.faces)
        face = rng.choice(len(area), 3 * count, p=area / area.sum())
        weights = rng.dirichlet([1.0, 1.0, 1.0], 3 * count)
        on_surface = np.einsum("nk,nkd->nd", weights, self.mesh.vertices[self.mesh.faces[face]])
        about = lattice.to_grid(on_surface) + rng.uniform(-NEAR, NEAR, on_surface.shape)
        index = np.unique(np.rint(about).astype(np.int64).clip(0, np.array(lattice.shape) - 1), axis=0)
        distance = self.surface.distance(lattice.to_world(index))
        near = rng.permutation(np.flatnonzero(distance <= NEAR * lattice.spacing))[:count]
        index, distance = index[near], distance[near]
        return Truth(self, lattice, index, distance, self.winding.signs(lattice.to_world(index)))


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is true at some samples.

    Attributes
    ----------
    oracle, lattice
        Where this comes from.
    index
        Of the samples.
    distance
        Unsigned, world units.
    sign
        -1 inside.
    """

    oracle: Oracle
    lattice: Lattice
    index: Int[np.ndarray, "n 3"]
    distance: Float[np.ndarray, " n"]
    sign: Int[np.ndarray, " n"]

    def judge(self, distance: Float[np.ndarray, " n"], face: Int[np.ndarray, " n"] | None) -> dict[str, float]:
        """Compare a tool's signed distances, world units, and faces if it names them.

        Returns
        -------
        dict
            `error.max`, `.p99`, `.p50` of the unsigned distance in voxels; `samples`; `wrong_signs`; `wrong_faces`,
            those that are farther than the nearest beyond a tie.

        Raises
        ------
        ValueError
            If a distance is not finite.
        """
        if not np.isfinite(distance).all():
            raise ValueError(f"{int((~np.isfinite(distance)).sum())} of {len(distance)} distances are not finite")
        error = np.abs(np.abs(distance) - self.distance) / self.lattice.spacing
        p50, p99 = np.percentile(error, [50, 99])
        values = {"samples": float(len(error)), "error.max": float(error.max()), "error.p99": float(p99)}
        values |= {"error.p50": float(p50), "wrong_signs": float(np.sum((distance < 0) != (self.sign < 0)))}
        return values if face is None else values | {"wrong_faces": float(np.sum(self._farther(face)))}

    def _farther(self, face: Int[np.ndarray, " n"]) -> np.ndarray:
        """Where a face is not among the nearest; one that does not exist is not."""
        surface, mesh = self.oracle.surface, self.oracle.mesh
        named = (face >= 0) & (face < len(mesh.faces))
        q = surface.to_unit(self.lattice.to_world(self.index))
        p = surface.vertices[mesh.faces[np.where(named, face, 0)]]
        a, b, c = ((v[:, 0], v[:, 1], v[:, 2]) for v in np.moveaxis(p, 1, 0))
        with np.errstate(all="ignore"):  # faces without an area divide by it, and are masked out there
            at = triangle.nearest(NumpyEngine(64), (q[:, 0], q[:, 1], q[:, 2]), (a, b, c))
        return np.asarray(~named | (at.distance > self.distance / surface.scale + _TIE))
