"""How much memory a bake may take.

In: what is allowed. Out: a refusal with the number, before anything large is allocated; and how many bricks may be
worked on together.
"""

import os
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from sdfbake.bricks import SIDE, counts
from sdfbake.closest import Surface
from sdfbake.complaint import BadInput
from sdfbake.lattice import Lattice

GIB = 1 << 30
MOST_BRICKS = (1 << 22) - 1  # a sample's number in the channels is a 32-bit integer
_FACE = 1200  # bytes of tables, tree and normals of a face, with room to spare
_FIXED = 250 << 20  # the libraries, and what the coarse levels take
_TABLE = 40  # bytes of tables per brick of the lattice, present or not, while they are made
_WORKED = 40 << 10  # bytes of lists and temporaries of a brick that is worked on
_FEWEST, _MOST = 256, 8192  # bricks worked on together


def available() -> float:
    """Return the bytes that can be had now without swapping; infinity where the system does not say."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (OSError, ValueError, AttributeError):  # no /proc and no sysconf: Windows
        return float("inf")


@dataclass(frozen=True, slots=True)
class Budget:
    """What a bake may take, and what it takes in any case.

    Attributes
    ----------
    limit
        Bytes.
    asked
        Whether a user set it.
    fixed
        Bytes of tables that do not depend on the bricks that are present.
    least
        Bricks that the surface needs at the very least.
    per_brick
        Bytes of a present brick's channels.
    resolution
        Named in refusals.
    """

    limit: float
    asked: bool
    fixed: float
    least: float
    per_brick: float
    resolution: int

    @staticmethod
    def of(limit: float | None, surface: Surface, lattice: Lattice, modes: tuple[str, ...], parts: int) -> "Budget":
        """Estimate; `limit` in gigabytes (2^30 bytes), None for what the machine has."""
        bricks = prod(counts(lattice.shape))
        per_sample = 4 + 4 + (12 if "grid" in modes else 0) + (18 if "layers" in modes else 0)
        per_sample += 1 if parts > 1 else 0
        fixed = _FIXED + _TABLE * bricks + _FACE * len(surface.faces)
        # A brick is crossed by no more surface than 8^2 voxels' worth on average; tight folds may share one: a half.
        least = min(surface.area / lattice.spacing**2 / SIDE**2 / 2, bricks)
        bytes_ = available() if limit is None else limit * GIB
        return Budget(bytes_, limit is not None, fixed, least, per_sample * SIDE**3, max(lattice.shape))

    def check_tables(self) -> None:
        """Refuse what cannot fit whatever the bricks turn out to be.

        Raises
        ------
        BadInput
            With the number.
        """
        self._require(self.fixed + self.least * self.per_brick)

    def bricks_at_once(self, count: int) -> int:
        """Return how many of `count` bricks to work on together; refuse what would not fit even so (BadInput)."""
        if count > MOST_BRICKS:
            raise BadInput(
                f"resolution {self.resolution} needs {count} bricks and a grid holds {MOST_BRICKS}: lower it"
            )
        channels = count * self.per_brick
        self._require(self.fixed + channels + _FEWEST * _WORKED)
        return int(np.clip((self.limit - self.fixed - channels) // _WORKED, _FEWEST, _MOST))

    def _require(self, needed: float) -> None:
        if needed > self.limit:
            raise BadInput(
                f"resolution {self.resolution} needs about {needed / GIB:.2f} GB of memory and {self.limit / GIB:.2f} "
                f"GB are {'allowed' if self.asked else 'available'}: choose a lower resolution or raise --max-memory"
            )
