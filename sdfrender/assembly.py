"""Several surfaces as one.

In: fields on one engine, each in its place. Out: a `Field`, the union of their *surfaces*, not of the solids that they
bound: what lies inside another member is met as well. A place on it remembers the member that it belongs to, and
positions relative to that member's own anchor, so that a small member far from the middle loses no digits.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine
from sdfbake.engine.protocol import State
from sdfbake.metadata import MODES
from sdfrender.field import Field, Jet, Mapped, Spot, Spread
from sdfrender.tables import three
from sdfrender.uvmode import AUTO, EXACT, choose_mode
from sdfrender.vector import Symmetric, Vector, add, select, subtract, zero


class _Place(NamedTuple):
    """The locator of an assembly: the member's number, the position relative to its anchor, all members' locators."""

    member: Array
    p: Vector
    locators: tuple[tuple[Array, ...], ...]


class Assembly:
    """The union of surfaces: a ray's first hit is the first of the members' first hits.

    A ray that leaves a place on the surface leaves that of one member; the others it meets from its origin on, at
    parameter 0 too. So where the surfaces of two members touch exactly, rounding decides whether the other one is met
    there. In single precision a position rounds with the size of the common box, which members far apart make large.

    Parameters
    ----------
    members
        The surfaces, at least one; where two are met at the same parameter, the earlier one is.

    Attributes
    ----------
    anchor, bounds
        The middle of the common box, and that box.
    part_names
        Those of all members in their order, so that part ids are consecutive; with the member's number, from 0, where
        another member has a part of the same name ("2:sphere").
    uv_mode
        The first of `MODES` and `EXACT` that any member reads: if one needs the normal, all are given it.

    Raises
    ------
    ValueError
        If there is no member, or they are not on one engine.
    """

    def __init__(self, members: Sequence[Field]) -> None:
        if not members:
            raise ValueError("an assembly needs at least one member")
        if any(member.engine != members[0].engine for member in members):
            engines = ", ".join(f"{member.engine.name} {member.engine.precision}" for member in members)
            raise ValueError(f"the members of an assembly need one engine, they have: {engines}")
        self.members = tuple(members)
        self.engine: Engine = members[0].engine
        boxes = np.stack([member.bounds for member in members])
        self.bounds: Float[np.ndarray, "2 3"] = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
        self.anchor: Float[np.ndarray, " 3"] = self.bounds.mean(axis=0)
        self.is_distance = all(member.is_distance for member in members)
        self.part_names = _names([member.part_names for member in members])
        self.uv_mode = next((mode for mode in (*MODES, EXACT) if any(m.uv_mode == mode for m in members)), None)
        self._offsets = [
            three(self.engine.uniform(float(c)) for c in self.anchor - member.anchor) for member in members
        ]
        counts = np.cumsum([0, *(len(member.part_names) for member in members)])
        self._first_part = [self.engine.uniform(int(count)) for count in counts[:-1]]

    def first_hit(
        self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None, spread: Spread | None = None
    ) -> Spot:
        """Find the first of the members' first hits."""
        p = _origin(xp, p, start)
        spots = [
            member.first_hit(xp, add(p, offset), d, active, left, spread)
            for member, offset, left in zip(self.members, self._offsets, self._lefts(start), strict=True)
        ]
        return self._merged(xp, spots, [spot.t for spot in spots])

    def occluded(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None, limit: Array) -> Array:
        """Say which rays meet a member; none is asked about rays that another one blocks."""
        p, blocked = _origin(xp, p, start), xp.full(p[0], False)
        for member, offset, left in zip(self.members, self._offsets, self._lefts(start), strict=True):
            blocked = blocked | member.occluded(xp, add(p, offset), d, active & ~blocked, left, limit)
        return blocked

    def inside(self, xp: Engine, p: Vector, active: Array) -> Array:
        """Say which positions are inside some member."""
        within = xp.full(p[0], False)
        for member, offset in zip(self.members, self._offsets, strict=True):
            within = within | member.inside(xp, add(p, offset), active & ~within)
        return within

    def locate(self, xp: Engine, p: Vector, active: Array) -> Spot:
        """Turn positions into places on the member whose signed distance is the smallest there, whatever its sign."""
        spots = [
            member.locate(xp, add(p, offset), active)
            for member, offset in zip(self.members, self._offsets, strict=True)
        ]
        nothing = (xp.full(p[0], 0.0),)
        jets = [asked(xp, spot, nothing, self._jet(xp, k, 0)) for k, spot in enumerate(spots)]
        return self._merged(xp, spots, [xp.abs(value) for (value,) in jets])._replace(p=p)

    def _merged(self, xp: Engine, spots: list[Spot], keys: list[Array]) -> Spot:
        """Choose for every lane, among the members that hit, the first with the least key."""
        hit, t, least = spots[0].hit, spots[0].t, keys[0]
        number, own, p = xp.full(t, 0), spots[0].p, subtract(spots[0].p, self._offsets[0])
        for k, (spot, key) in enumerate(zip(spots[1:], keys[1:], strict=True), 1):
            closer = spot.hit & (~hit | (key < least))
            hit, t, least = hit | spot.hit, xp.where(closer, spot.t, t), xp.where(closer, key, least)
            number, own = xp.where(closer, k, number), select(xp, closer, spot.p, own)
            p = select(xp, closer, subtract(spot.p, self._offsets[k]), p)
        return Spot(hit, t, p, tuple(_Place(number, own, tuple(spot.locator for spot in spots))))

    def _lefts(self, start: Spot | None) -> Sequence[Spot | None]:
        """Return for every member the places that rays leave on it."""
        return [None for _ in self.members] if start is None else list(self._shares(start))

    def _shares(self, spot: Spot) -> Iterator[Spot]:
        """Return for every member the places on it."""
        place = _Place(*spot.locator)
        for k, locator in enumerate(place.locators):
            yield Spot(spot.hit & (place.member == k), spot.t, place.p, locator)

    def member_at(self, xp: Engine, spot: Spot) -> Array:
        """Return the number of the member at a place, from 0; -1 where nothing was hit."""
        return xp.where(spot.hit, _Place(*spot.locator).member, -1)

    def jet_at(self, xp: Engine, spot: Spot, order: int) -> Jet:
        """Signed distance of the member at a place, and derivatives; 0 where nothing was hit."""
        nothing = zero(xp, spot.t)
        entries: tuple[Array, ...] = (nothing[0], nothing, Symmetric(*nothing, *nothing))[: order + 1]
        for k, share in enumerate(self._shares(spot)):
            entries = asked(xp, share, entries, self._jet(xp, k, order))
        return Jet(*entries)

    def _jet(self, xp: Engine, k: int, order: int) -> Callable[[Spot], tuple[Array, ...]]:
        """Return the question for a member's jet, without what is None in it."""
        return lambda spot: tuple(self.members[k].jet_at(xp, spot, order))[: order + 1]

    def prepare_uv(self) -> None:
        """Prepare all members; see `Field.prepare_uv`."""
        for member in self.members:
            member.prepare_uv()

    def uv_at(self, xp: Engine, spot: Spot, n: Vector | None) -> Mapped:
        """Texture coordinates of the member at a place; 0, and chart -1, on a member that has none.

        Raises
        ------
        BadInput
            If no member has any.
        """
        if self.uv_mode is None:
            choose_mode((), AUTO, "the assembly")
        u, *_ = nothing = zero(xp, spot.t)
        mapped = Mapped(u, u, nothing, nothing, xp.full(spot.t, -1), xp.full(spot.t, False))
        known = () if n is None else (n,)
        for member, share in zip(self.members, self._shares(spot), strict=True):
            if member.uv_mode is not None:
                mapped = asked(xp, share, mapped, _mapping(xp, member), known)
        return mapped

    def part_at(self, xp: Engine, spot: Spot) -> Array:
        """Part id at a place; -1 where nothing was hit."""
        parts = (xp.full(spot.t, -1),)
        for member, share, first in zip(self.members, self._shares(spot), self._first_part, strict=True):
            parts = asked(xp, share, parts, _numbering(xp, member, first))
        return parts[0]

    def beyond_band(self, xp: Engine, spot: Spot) -> Array:
        """Say whether values behind a place are not exact."""
        beyond = xp.full(spot.t, False)
        for member, share in zip(self.members, self._shares(spot), strict=True):
            beyond = beyond | (share.hit & member.beyond_band(xp, share))
        return beyond


def _mapping(xp: Engine, member: Field) -> Callable[..., Mapped]:
    """Return the question for texture coordinates."""
    return lambda spot, n=None: member.uv_at(xp, spot, n)


def _numbering(xp: Engine, member: Field, first: Array) -> Callable[[Spot], tuple[Array]]:
    """Return the question for parts, the first of which has a number of its own."""
    return lambda spot: (first + member.part_at(xp, spot),)


def asked(xp: Engine, share: Spot, answer: State, ask: Callable[..., State], known: tuple[Vector, ...] = ()) -> State:
    """Ask a member about the places on it, and keep the answers for the others: they cost nothing on NumPy."""

    def body(state: tuple[State, Spot, tuple[Vector, ...]]) -> tuple[State, Spot, tuple[Vector, ...]]:
        _, share, known = state
        return ask(share, *known), share, known

    return xp.among(share.hit, body, (answer, share, known))[0]


def _origin(xp: Engine, p: Vector, start: Spot | None) -> Vector:
    """Return where rays start."""
    return p if start is None else select(xp, start.hit, start.p, p)


def _names(members: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the names of all members' parts, with the member's number where another one has the same."""
    owners = Counter(name for names in members for name in set(names))
    numbered = [(k, name) for k, names in enumerate(members) for name in names]
    return tuple(f"{k}:{name}" if owners[name] > 1 else name for k, name in numbered)
