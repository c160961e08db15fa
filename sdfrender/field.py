"""What the renderer asks of a surface, be it a grid or an exact shape.

In: rays and places on the surface as engine arrays, world units, relative to the field's `anchor` (so that float32
sees no large offsets). Out: first hits, jets, texture coordinates. `sdfrender.gridfield` answers from a grid.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine
from sdfrender.vector import Symmetric, Vector


class Spot(NamedTuple):
    """Where a ray met the surface.

    Attributes
    ----------
    hit
        Mask: False where there is nothing.
    t
        Ray parameter, in units of the direction's length; 0 where there is nothing.
    p
        Position relative to the field's anchor.
    locator
        What the field needs to answer more questions about the place; nobody else looks into it.
    """

    hit: Array
    t: Array
    p: Vector
    locator: tuple[Array, ...]


class Spread(NamedTuple):
    """How a ray's footprint grows: derivatives of its position, where the parameter is 0, and of its direction."""

    dp_dx: Vector
    dp_dy: Vector
    dd_dx: Vector
    dd_dy: Vector


class Jet(NamedTuple):
    """Value and derivatives of the signed distance, world frame; None above the order that was asked for."""

    value: Array
    gradient: Vector | None = None
    hessian: Symmetric | None = None


class Mapped(NamedTuple):
    """Texture coordinates at a place: value, gradients of u and of v in space, chart, whether a seam is near."""

    u: Array
    v: Array
    du: Vector
    dv: Vector
    chart: Array
    seam: Array


@runtime_checkable
class Field(Protocol):
    """A surface that rays can be traced against."""

    @property
    def engine(self) -> Engine:
        """The engine whose arrays it takes."""
        ...

    @property
    def anchor(self) -> Float[np.ndarray, " 3"]:
        """The world point that positions are relative to."""
        ...

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """World box outside which there is no surface."""
        ...

    @property
    def is_distance(self) -> bool:
        """Whether it is a distance, whose gradient has unit length away from edges."""
        ...

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts."""
        ...

    def first_hit(
        self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None, spread: Spread | None = None
    ) -> Spot:
        """Find where rays first meet the surface.

        Rays with a `start` that is a hit leave that place, whatever `p`, and do not meet it again; the other active
        rays start at `p`. Only a surface with levels of detail looks at how they spread.
        """
        ...

    def occluded(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None, limit: Array) -> Array:
        """Say which rays meet anything before the parameter `limit`, which may be infinite; else as `first_hit`."""
        ...

    def inside(self, xp: Engine, p: Vector, active: Array) -> Array:
        """Say which positions are inside, where the signed distance is negative."""
        ...

    def locate(self, xp: Engine, p: Vector, active: Array) -> Spot:
        """Turn positions into places to ask about."""
        ...

    def jet_at(self, xp: Engine, spot: Spot, order: int) -> Jet:
        """Signed distance at a place: value, gradient from order 1, Hessian from order 2."""
        ...

    @property
    def uv_mode(self) -> str | None:
        """How texture coordinates are known: one of `sdfbake.metadata.MODES`, or "exact"; None if they are not."""
        ...

    def prepare_uv(self) -> None:
        """Prepare what `uv_at` needs, where that takes time; before programs that may not be interrupted for it."""
        ...

    def uv_at(self, xp: Engine, spot: Spot, n: Vector | None) -> Mapped:
        """Texture coordinates at a place with that unit normal, which may be None where `uv_mode` asks for none.

        `sdfrender.uvmode.BY_NORMAL` says which do.
        """
        ...

    def part_at(self, xp: Engine, spot: Spot) -> Array:
        """Part id at a place."""
        ...

    def beyond_band(self, xp: Engine, spot: Spot) -> Array:
        """Say whether values that are not exact stand behind the surface at a place."""
        ...
