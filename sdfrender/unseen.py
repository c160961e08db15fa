"""A surface that no ray meets.

In: where it lies and what it is called. Out: a `Field` that answers nothing: it keeps the places and the parts of the
others what they are, and of its file the head alone was read.
"""

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine
from sdfbake.lattice import Lattice
from sdfbake.metadata import Metadata
from sdfrender.field import Jet, Mapped, Spot, Spread
from sdfrender.vector import Symmetric, Vector, zero


class Unseen:
    """A grid of which nothing is in sight.

    Parameters
    ----------
    lattice, metadata
        What its file's head says.
    engine
        That of the surfaces beside it.
    uv_mode
        How texture coordinates would be known.
    """

    def __init__(self, lattice: Lattice, metadata: Metadata, engine: Engine, uv_mode: str | None) -> None:
        self.engine, self.uv_mode = engine, uv_mode
        self.anchor: Float[np.ndarray, " 3"] = lattice.to_world((np.array(lattice.shape) - 1) / 2)
        self.bounds: Float[np.ndarray, "2 3"] = lattice.bounds
        self.is_distance = metadata.source != "dense"
        self.part_names = tuple(metadata.parts)

    def first_hit(
        self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None, spread: Spread | None = None
    ) -> Spot:
        """Find nothing."""
        return self.locate(xp, p, active)

    def occluded(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None, limit: Array) -> Array:
        """Say that nothing is met."""
        return xp.full(p[0], False)

    def inside(self, xp: Engine, p: Vector, active: Array) -> Array:
        """Say that no ray starts inside."""
        return xp.full(p[0], False)

    def locate(self, xp: Engine, p: Vector, active: Array) -> Spot:
        """Find no place."""
        return Spot(xp.full(p[0], False), xp.full(p[0], 0.0), p, ())

    def jet_at(self, xp: Engine, spot: Spot, order: int) -> Jet:
        """Return zeros."""
        nothing = zero(xp, spot.t)
        hessian = Symmetric(*nothing, *nothing)
        return Jet(nothing[0], nothing if order > 0 else None, hessian if order > 1 else None)

    def prepare_uv(self) -> None:
        """Prepare nothing."""

    def uv_at(self, xp: Engine, spot: Spot, n: Vector | None) -> Mapped:
        """Return zeros."""
        u, *_ = nothing = zero(xp, spot.t)
        return Mapped(u, u, nothing, nothing, xp.full(spot.t, 0), xp.full(spot.t, False))

    def part_at(self, xp: Engine, spot: Spot) -> Array:
        """Return the first part."""
        return xp.full(spot.t, 0)

    def beyond_band(self, xp: Engine, spot: Spot) -> Array:
        """Say that everything is exact."""
        return xp.full(spot.t, False)
