"""What a path does at glass: which media meet there, and which of the two ways it takes.

In: hits on surfaces of glass. Out: eta; the way, mirrored or through, and its share of the light. A path is told by a
code how to go: at its k-th surface of glass where both ways exist it is mirrored if bit k of the code is set. So every
code follows one path of the tree, and a picture is the sum over codes; beyond the splits light passes, and what is
mirrored there is lost.

Several bodies of glass are one inside the other or overlap: a path knows by a bit for each body which it is in, and of
those the one that the scene names last decides (Schmidt and Budge 2002).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sdfbake.engine import Array, Engine
from sdfrender import optics
from sdfrender.vector import Vector, dot


class Way(NamedTuple):
    """How a path goes on from glass.

    Attributes
    ----------
    mirrored
        Mask; elsewhere it passes.
    total
        Mask: nothing passes.
    share
        Of the light.
    split
        Mask: both ways were open.
    """

    mirrored: Array
    total: Array
    share: Array
    split: Array


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Bodies of glass that a path can be in several of at once.

    Attributes
    ----------
    bit
        Bit of the body of every part, 0 for what is no glass.
    index
        Index of refraction of the body of every bit, ascending.
    """

    bit: Array
    index: tuple[Array, ...]

    @staticmethod
    def of(xp: Engine, number: Sequence[int], index: Sequence[float]) -> "Bodies":
        """Number the bodies: of every part (-1: no glass), and their indices."""
        bits = np.array([1 << k if k >= 0 else 0 for k in number], np.int32)
        return Bodies(xp.table(bits), tuple(xp.uniform(float(value)) for value in index))

    def cross(self, xp: Engine, part: Array, entering: Array, within: Array, hit: Array) -> tuple[Array, Array, Array]:
        """Return eta at the surface of a part, which bodies a path is in beyond it, and whether there is a surface.

        What the path was thought to be in before does not matter for the body that it crosses: its side tells. Inside
        a body that is named later there is none: nothing bends, and nothing is tinted.
        """
        bit = xp.gather(self.bit, part, hit)
        outside = within & ~bit
        inside = within | bit
        before, after = xp.where(entering, outside, inside), xp.where(entering, inside, outside)
        return self._medium(xp, before) / self._medium(xp, after), after, bit > outside

    def _medium(self, xp: Engine, within: Array) -> Array:
        index = xp.full(within, 1.0)
        for number, value in enumerate(self.index):
            index = xp.where((within & (1 << number)) != 0, value, index)
        return index


def decide(xp: Engine, d: Vector, n: Vector, eta: Array, glass: Array, code: Array, splits: Array, most: int) -> Way:
    """Choose the way at glass.

    Parameters
    ----------
    xp
        The engine.
    d, n
        Unit directions, and outward unit normals.
    eta
        n_i / n_t.
    glass
        Which hits are on glass.
    code, splits
        The path's code, and at how many surfaces both ways were open so far.
    most
        At how many the code decides.
    """
    total = glass & optics.passage(xp, d, n, eta).total
    reflectance = optics.reflectance(xp, d, n, eta)
    split = glass & ~total & (reflectance > 0) & (splits < most)
    mirrored = split & (((code >> splits) & 1) == 1)
    share = xp.where(total, 1.0, xp.where(mirrored, reflectance, 1.0 - reflectance))
    return Way(total | mirrored, total, xp.where(glass, share, 1.0), split)


def entering(d: Vector, n: Vector) -> Array:
    """Return which rays come from outside."""
    return dot(d, n) < 0
