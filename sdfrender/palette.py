"""The materials of a scene on an engine: what a hit's part is made of.

In: the material of every part. Out: tables that say per hit which kind it is, its colour, its index of refraction, its
texture. A scene with one material looks nothing up by part.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sdfbake.engine import Array, Engine
from sdfrender.materials import Diffuse, Glass, Material, Mirror, Normals
from sdfrender.vector import Vector

MIRROR, GLASS, DIFFUSE, NORMALS = range(4)
_KINDS = {Mirror: MIRROR, Glass: GLASS, Diffuse: DIFFUSE, Normals: NORMALS}


class Surface(NamedTuple):
    """What a hit is made of: kind, colour, index of refraction, number of the texture (-1 for none)."""

    kind: Array
    colour: Vector
    index: Array
    texture: Array


@dataclass(frozen=True, slots=True, eq=False)
class Palette:
    """Materials as tables.

    Attributes
    ----------
    kinds
        Which kinds of material there are at all.
    of_part
        Material of every part.
    kind, texture
        Of every material.
    rows
        Colour and index of every material.
    several
        Whether there is more than one material.
    """

    kinds: frozenset[int]
    of_part: Array
    kind: Array
    texture: Array
    rows: Array
    several: bool

    @staticmethod
    def of(xp: Engine, by_part: Sequence[Material], textures: Sequence[str]) -> "Palette":
        """Put the materials of all parts on an engine; `textures` are the names of those that are looked up."""
        materials = list(dict.fromkeys(material.model_copy(update={"part": "*"}) for material in by_part))
        number = [materials.index(material.model_copy(update={"part": "*"})) for material in by_part]
        kinds = [_KINDS[type(material)] for material in materials]
        rows = [(*m.colour, m.index) if isinstance(m, Glass) else (*_colour(m), 1.0) for m in materials]
        named = [m.texture if isinstance(m, Diffuse) else None for m in materials]
        numbers = [textures.index(name) if name in textures else -1 for name in named]
        return Palette(
            kinds=frozenset(kinds),
            of_part=xp.table(np.array(number, np.int32)),
            kind=xp.table(np.array(kinds, np.int32)),
            texture=xp.table(np.array(numbers, np.int32)),
            rows=xp.table(np.array(rows, np.float64)),
            several=len(materials) > 1,
        )

    def look_up(self, xp: Engine, part: Array, active: Array) -> Surface:
        """Return what parts are made of."""
        material = xp.gather(self.of_part, part, active) if self.several else xp.full(part, 0)
        red, green, blue, index = xp.rows(self.rows, material, active)
        return Surface(
            xp.gather(self.kind, material, active), (red, green, blue), index, xp.gather(self.texture, material, active)
        )

    def made_of(self, xp: Engine, surface: Surface, kind: int, hit: Array) -> Array:
        """Return which hits are of a kind."""
        if kind not in self.kinds:
            return xp.full(surface.kind, False)
        return hit if len(self.kinds) == 1 else hit & (surface.kind == kind)


def _colour(material: Material) -> tuple[float, float, float]:
    return (1.0, 1.0, 1.0) if isinstance(material, Normals) else material.colour
