"""A grid with coarser levels as one surface: every ray meets the level that suits its footprint.

In: the fields of a grid's levels, finest first, and how rays spread. Out: a `Field`. Galim 2018 names levels of detail
of the grid itself as future work. It is an approximation, off unless asked for (docs/tracing.md).

A ray's width is the lesser singular value of its two pixel steps across it (about a pixel's side, straight from a
camera), where it enters the grid's box or where it leaves it, whichever is less; where there is a focus in between, 0.
It meets the coarsest level whose voxels are at most `SHARE` of that wide; without one, the finest. A ray that leaves a
place stays on that place's level: another one's surface may lie on the other side of it.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine
from sdfrender.assembly import asked
from sdfrender.field import Jet, Mapped, Spot, Spread
from sdfrender.gridfield import GridField
from sdfrender.levelreach import SHARE
from sdfrender.tables import Found
from sdfrender.vector import Symmetric, Vector, zero
from sdfrender.widths import least_width

Given = tuple[Vector, Vector, Array, tuple[Spot, ...]]  # origins, directions, which of them, the places that they leave


class LeveledField:
    """The levels of a grid.

    Parameters
    ----------
    members
        Their fields, finest first, on one engine.
    share
        Of a ray's width, that the voxels of its level have at most.

    Attributes
    ----------
    anchor, bounds
        Those of every level.
    tolerance
        The greatest of the levels'; see `GridField`.

    Raises
    ------
    ValueError
        If they are not of one grid and engine, each of a coarser level than the one before.
    """

    def __init__(self, members: Sequence[GridField], share: float = SHARE) -> None:
        first = members[0]
        spacings = [member.grid.lattice.spacing for member in members]
        together = all(
            (member.anchor == first.anchor).all() and member.engine == first.engine and member.uv_mode == first.uv_mode
            for member in members
        )
        if not (together and spacings == sorted(set(spacings))):
            raise ValueError("the members are not the levels of one grid on one engine, finest first")
        self.members = tuple(members)
        self.engine: Engine = first.engine
        self.anchor: Float[np.ndarray, " 3"] = first.anchor
        self.bounds: Float[np.ndarray, "2 3"] = first.bounds
        self.is_distance, self.part_names, self.uv_mode = first.is_distance, first.part_names, first.uv_mode
        self.tolerance = max(member.tolerance for member in members)
        low, high = self.bounds - self.anchor
        self._box = [[self.engine.uniform(float(c)) for c in corner] for corner in (low, high)]
        self._least = [self.engine.uniform(float(spacing / share)) for spacing in spacings[1:]]

    def first_hit(
        self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None, spread: Spread | None = None
    ) -> Spot:
        """Find first hits on every ray's level."""
        level = self.level_of(xp, p, d, start, spread)
        hits = _nowhere(xp, p[0])
        for number, member in enumerate(self.members):
            mine = active & (level == number)
            given: Given = (p, d, mine, () if start is None else (_on(start, number),))
            hits = xp.among(mine, partial(_meeting, xp, member), (hits, given))[0]
        return hits._replace(locator=(level, *hits.locator))

    def level_of(self, xp: Engine, p: Vector, d: Vector, start: Spot | None, spread: Spread | None) -> Array:
        """Return the number of every ray's level, from 0 for the first member."""
        level = xp.full(p[0], 0)
        if spread is not None:
            near, far = self._through(xp, p, d)
            width = least_width(xp, d, spread, near, far)
            for least in self._least:
                level = level + xp.integer(width >= least)
        return level if start is None else xp.where(start.hit, start.locator[0], level)

    def _through(self, xp: Engine, p: Vector, d: Vector) -> tuple[Array, Array]:
        """Return where rays enter the box, or begin in it, and where they leave it."""
        inverse = [1.0 / xp.where(xp.abs(c) < 1e-30, 1e-30, c) for c in d]
        ends = [[(corner[a] - p[a]) * inverse[a] for a in range(3)] for corner in self._box]
        near = xp.most([xp.minimum(low, high) for low, high in zip(*ends, strict=True)])
        far = xp.least([xp.maximum(low, high) for low, high in zip(*ends, strict=True)])
        near = xp.maximum(near, 0.0)
        return near, xp.maximum(near, far)

    def occluded(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None, limit: Array) -> Array:
        """Say which rays meet anything: those that leave a place here, on its level; others, on the finest."""
        blocked = xp.full(p[0], False)
        level = self.level_of(xp, p, d, start, None)
        for number, member in enumerate(self.members):
            mine = active & (level == number)
            left = None if start is None else _on(start, number)
            blocked = blocked | member.occluded(xp, p, d, mine, left, limit)
        return blocked

    def inside(self, xp: Engine, p: Vector, active: Array) -> Array:
        """Say which positions are inside, by the finest level."""
        return self.members[0].inside(xp, p, active)

    def locate(self, xp: Engine, p: Vector, active: Array) -> Spot:
        """Turn positions into places on the finest level."""
        spot = self.members[0].locate(xp, p, active)
        return spot._replace(locator=(xp.full(p[0], 0), *spot.locator))

    def jet_at(self, xp: Engine, spot: Spot, order: int) -> Jet:
        """Signed distance at a place, on its level, and derivatives; 0 where nothing was hit."""
        nothing = zero(xp, spot.t)
        entries: tuple[Array, ...] = (nothing[0], nothing, Symmetric(*nothing, *nothing))[: order + 1]
        for member, share in self._shares(spot):
            entries = asked(xp, share, entries, partial(_jet, xp, member, order))
        return Jet(*entries)

    def prepare_uv(self) -> None:
        """Prepare all levels; see `Field.prepare_uv`."""
        for member in self.members:
            member.prepare_uv()

    def uv_at(self, xp: Engine, spot: Spot, n: Vector | None) -> Mapped:
        """Texture coordinates at a place, on its level; see `Field.uv_at`."""
        u, *_ = nothing = zero(xp, spot.t)
        mapped = Mapped(u, u, nothing, nothing, xp.full(spot.t, -1), xp.full(spot.t, False))
        known = () if n is None else (n,)
        for member, share in self._shares(spot):
            mapped = asked(xp, share, mapped, partial(_mapping, xp, member), known)
        return mapped

    def part_at(self, xp: Engine, spot: Spot) -> Array:
        """Part at a place."""
        parts = (xp.full(spot.t, 0),)
        for member, share in self._shares(spot):
            parts = asked(xp, share, parts, partial(_part, xp, member))
        return parts[0]

    def beyond_band(self, xp: Engine, spot: Spot) -> Array:
        """Say whether values behind a place are not exact."""
        beyond = xp.full(spot.t, False)
        for member, share in self._shares(spot):
            beyond = beyond | (share.hit & member.beyond_band(xp, share))
        return beyond

    def _shares(self, spot: Spot) -> list[tuple[GridField, Spot]]:
        """Return all levels with the places on them."""
        return [(member, _on(spot, number)) for number, member in enumerate(self.members)]


def _meeting(xp: Engine, member: GridField, state: tuple[Spot, Given]) -> tuple[Spot, Given]:
    """Find first hits on one level."""
    _, (p, d, mine, left) = state
    return member.first_hit(xp, p, d, mine, left[0] if left else None), state[1]


def _jet(xp: Engine, member: GridField, order: int, spot: Spot) -> tuple[Array, ...]:
    return tuple(member.jet_at(xp, spot, order))[: order + 1]


def _mapping(xp: Engine, member: GridField, spot: Spot, n: Vector | None = None) -> Mapped:
    return member.uv_at(xp, spot, n)


def _part(xp: Engine, member: GridField, spot: Spot) -> tuple[Array]:
    return (member.part_at(xp, spot),)


def _nowhere(xp: Engine, like: Array) -> Spot:
    """Return places that are none, on no level."""
    hit, (x, y, z), cell = xp.full(like, False), zero(xp, like), xp.full(like, 0)
    return Spot(hit, x, (x, y, z), tuple(Found(hit, x, (cell, cell, cell), (x, y, z), cell)))


def _on(spot: Spot, number: int) -> Spot:
    """Return the places on a level."""
    level, *locator = spot.locator
    return Spot(spot.hit & (level == number), spot.t, spot.p, tuple(locator))
