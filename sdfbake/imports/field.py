"""What a reader of somebody else's file gives: samples on a box, and what the file says of them.

In: nothing. Out: `Field`, and a refusal of what would not fit into memory.
"""

import mmap
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np
from jaxtyping import Float, Real

from sdfbake.complaint import BadInput
from sdfbake.memory import GIB, available

_FARTHEST = 1e30  # squares of it still are finite in float64, and so are its reciprocals
_LONGEST = 1e3  # edges of a voxel over each other
_PER_SAMPLE = 24  # bytes: the file's values, ours, and what the search for bricks takes; 21 were measured


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Samples as a file has them, p = origin + spacing * [i, j, k].

    Attributes
    ----------
    values
        Indexed [x, y, z], of the file's type; may be a view of the file.
    origin
        Position of values[0, 0, 0], world, float64.
    spacing
        Distance between neighbours along x, y, z, world, float64.
    name
        Of the array in the file; empty where it has none.
    half_width
        World distance up to which the file says that its values are distances; None where it does not say.
    placed
        Whether the file or the user says where its samples lie; if not, spacing and origin are assumed.
    notes
        A sentence for everything that was assumed.
    """

    values: Real[np.ndarray, "nx ny nz"]
    origin: Float[np.ndarray, "3"]
    spacing: Float[np.ndarray, "3"]
    name: str = ""
    half_width: float | None = None
    placed: bool = True
    notes: tuple[str, ...] = ()


def mapped(path: Path) -> memoryview:
    """Return the bytes of a file, read when they are looked at."""
    if not path.stat().st_size:
        return memoryview(b"")
    with path.open("rb") as file:
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def require_memory(name: str, shape: tuple[int, ...]) -> None:
    """Refuse samples that would not fit, with the number; `name` is the file's.

    Raises
    ------
    BadInput
        Before anything is allocated.
    """
    needed, there = prod(map(int, shape)) * _PER_SAMPLE, available()
    if needed > there:
        size = " x ".join(map(str, shape))
        raise BadInput(
            f"{name} spans {size} samples, which take about {needed / GIB:.2f} GB of memory and {there / GIB:.2f} GB "
            "are available: crop it or sample it more coarsely"
        )


def require_lattice(name: str, origin: Float[np.ndarray, "3"], spacing: Float[np.ndarray, "3"]) -> None:
    """Refuse positions that no computation could use; `name` is the file's (BadInput)."""
    if not (np.abs(origin) < _FARTHEST).all() or not ((spacing > 1 / _FARTHEST) & (spacing < _FARTHEST)).all():
        raise BadInput(
            f"the samples of {name} would lie from {origin.tolist()} on with the spacing {spacing.tolist()}: give it "
            "finite positions and a positive spacing"
        )
    if spacing.max() > _LONGEST * spacing.min():
        raise BadInput(f"the voxels of {name} measure {spacing.tolist()}: sample it with less elongated ones")


def corrupt(name: str, what: str) -> BadInput:
    """Return the complaint for a file that contradicts itself."""
    return BadInput(f"{name} is corrupt or not of its kind: {what}; export it again")
