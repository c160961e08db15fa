"""Which places of a scene share one grid in memory, and what of it their rays can meet.

In: a scene, its plan, where its rays come from, the lattices of its grids. Out: a `Share` for every grid that is read,
with the sight of each of its places: what is loaded, and what a plan says of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from sdfbake.bricks import Bricks
from sdfbake.lattice import Lattice
from sdfbake.metadata import Metadata
from sdfrender.levelreach import in_reach
from sdfrender.planned import AssetPlan, Plan
from sdfrender.reach import Frustum, Sight, frusta, needed
from sdfrender.scene import Scene
from sdfrender.viewing import View


@dataclass(frozen=True, slots=True, eq=False)
class Share:
    """What is read of a grid once for several of its places.

    Attributes
    ----------
    needs
        The file, and the channels that are enough for all of them.
    places
        Numbers of the assets.
    sights
        What is seen of the grid there; None for all of it.
    levels
        Which of its levels rays can choose, the finest being 0.
    """

    needs: AssetPlan
    places: tuple[int, ...]
    sights: tuple[Sight | None, ...]
    levels: range = range(1)

    def met(self, lattice: Lattice) -> tuple[bool, ...]:
        """Say in which places any ray comes into the lattice."""
        return tuple(sight is None or sight.meets_lattice(lattice) for sight in self.sights)

    def is_whole(self, metadata: Metadata) -> bool:
        """Say whether all bricks are read: of distances alone is known what others may be."""
        return None in self.sights or metadata.source == "dense"

    def wanted(self, bricks: Bricks, level: int = 0) -> Bool[np.ndarray, " k"]:
        """Return the bricks of a level that are read where not all are."""
        return needed([sight.on_level(level) for sight in self._seen], bricks)

    def reachable(self, bricks: Bricks, level: int = 0) -> Bool[np.ndarray, " k"]:
        """Return the bricks of a level that rays can come into."""
        if None in self.sights:
            return np.ones(len(bricks), bool)
        met = [sight.on_level(level).meets(bricks) for sight in self._seen]
        found: Bool[np.ndarray, " k"] = np.any(met, axis=0)
        return found

    @property
    def _seen(self) -> list[Sight]:
        return [sight for sight in self.sights if sight is not None]


def shares(scene: Scene, plan: Plan, view: View, lattices: Sequence[Lattice]) -> tuple[Share, ...]:
    """Return what is read of the grids of a scene.

    One reading serves all places of a grid, if what is read for one of them is enough for the others.

    Parameters
    ----------
    scene, plan, view
        What is rendered.
    lattices
        That of every asset's grid.
    """
    serving = [
        max((other for other in plan.assets if _serves(other, least)), key=lambda other: len(other.channels))
        for least in plan.assets
    ]
    around = frusta(view) if all(asset.in_sight for asset in plan.assets) else None
    seen: Sequence[Sight | None] = [None] * len(serving) if around is None else sights(scene, around, lattices)
    found = []
    for needs in dict.fromkeys(serving):
        places = tuple(place for place, other in enumerate(serving) if other == needs)
        ways = [(scene.assets[place].placed(), lattices[place]) for place in places]
        numbers = [number for way in ways for number in in_reach(view, *way, needs.levels, direct=around is not None)]
        levels = range(min(numbers), max(numbers) + 1)
        found.append(Share(needs, places, tuple(seen[place] for place in places), levels))
    return tuple(found)


def sights(scene: Scene, around: Sequence[Frustum], lattices: Sequence[Lattice]) -> tuple[Sight, ...]:
    """Return what rays within some convex sets see of the grid of every asset."""
    placed = [asset.placed() for asset in scene.assets]
    boxes = np.stack([place.bounds(lattice.bounds) for place, lattice in zip(placed, lattices, strict=True)])
    size = float(np.linalg.norm(boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)))
    return tuple(Sight.of(around, place, lattice, size) for place, lattice in zip(placed, lattices, strict=True))


def _serves(other: AssetPlan, needs: AssetPlan) -> bool:
    enough = set(needs.channels) <= set(other.channels) and needs.uv_mode in (None, other.uv_mode)
    return other.grid == needs.grid and enough
