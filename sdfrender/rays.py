"""Rays and their differentials (Igehy 1999; Galim 2018, eq. 1, 2).

`Rays` are NumPy arrays for the world outside; `Beam` is the same inside a program.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sdfbake.engine import Array
from sdfrender.vector import Vector

COLUMNS = ("p", "d", "dp_dx", "dp_dy", "dd_dx", "dd_dy")


class Beam(NamedTuple):
    """A ray and its differentials inside a program; `d` has unit length, derivatives are per pixel step."""

    p: Vector
    d: Vector
    dp_dx: Vector
    dp_dy: Vector
    dd_dx: Vector
    dd_dy: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Rays with differentials, float64, world frame.

    Attributes
    ----------
    p, d
        Origins and unit directions.
    dp_dx, dp_dy, dd_dx, dd_dy
        Their derivatives per pixel step to the right and down; world units and radians.
    flags
        (n,) bits of `Flag`: what happened on the way so far, MISS apart. Left out, nothing did.

    Raises
    ------
    ValueError
        If the arrays do not all have the shape (n, 3), or the flags not (n,).
    """

    p: Float[np.ndarray, "n 3"]
    d: Float[np.ndarray, "n 3"]
    dp_dx: Float[np.ndarray, "n 3"]
    dp_dy: Float[np.ndarray, "n 3"]
    dd_dx: Float[np.ndarray, "n 3"]
    dd_dy: Float[np.ndarray, "n 3"]
    flags: Int[np.ndarray, " n"] = field(default_factory=lambda: np.zeros(0, np.int32))

    def __post_init__(self) -> None:
        for name in COLUMNS:
            values = np.asarray(getattr(self, name), np.float64)
            if values.shape != (len(self.p), 3):
                raise ValueError(f"Rays.{name} has shape {values.shape}, expected ({len(self.p)}, 3)")
            object.__setattr__(self, name, values)
        if not self.flags.size:
            object.__setattr__(self, "flags", np.zeros(len(self.p), np.int32))
        if self.flags.shape != (len(self.p),):
            raise ValueError(f"Rays.flags has shape {self.flags.shape}, expected ({len(self.p)},)")

    def __len__(self) -> int:
        return len(self.p)

    def columns(self) -> list[np.ndarray]:
        """Return the 18 components, in the order of the attributes."""
        return [component for name in COLUMNS for component in getattr(self, name).T]

    def where(self, chosen: np.ndarray) -> "Rays":
        """Return some of the rays."""
        return Rays(*(getattr(self, name)[chosen] for name in (*COLUMNS, "flags")))

    def flagged(self, flags: Int[np.ndarray, " n"]) -> "Rays":
        """Return the same rays with more flags on their way."""
        return replace(self, flags=self.flags | flags)


def beam(columns: tuple[Array, ...]) -> Beam:
    """Group 18 components."""
    return Beam(*(tuple(columns[i : i + 3]) for i in range(0, 18, 3)))


def components(beam: Beam) -> dict[str, Array]:
    """Name the 18 components, for a program's output."""
    return {f"{name}{axis}": vector[axis] for name, vector in zip(COLUMNS, beam, strict=True) for axis in range(3)}


def rays(outputs: Mapping[str, np.ndarray]) -> Rays:
    """Group a program's named components."""
    return Rays(*(vectors(outputs, name) for name in COLUMNS))


def vectors(outputs: Mapping[str, np.ndarray], name: str) -> Float[np.ndarray, "n 3"]:
    """Stack a program's components `name0`, `name1`, `name2`."""
    return np.stack([outputs[f"{name}{axis}"] for axis in range(3)], axis=-1).astype(np.float64)
