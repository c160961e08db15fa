"""Where the samples of a grid lie: the only map between world and grid coordinates.

In: a box and a resolution. Out: `Lattice`, with p = origin + spacing * index (Galim 2018, eq. 11, on nodes).
"""

from dataclasses import dataclass
from operator import index as integer

import numpy as np
from jaxtyping import Float, Num

from sdfbake.complaint import BadInput

# The farthest sample that a surface cell's 4^3 stencil with the prefilter's halo of one can touch is 3 sqrt(3) = 5.196
# voxels from the surface.
BAND = 5.2
LEAST, MOST = 16, 8192
_MOST_LEVELS = 9  # a grid of 8192 samples has 16 then


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Sample positions p = origin + spacing * [i, j, k], with [i, j, k] along [x, y, z].

    Attributes
    ----------
    origin
        Position of sample [0, 0, 0], world, float64.
    spacing
        Distance between neighbouring samples, the same along every axis, world units.
    shape
        Samples along x, y, z, each at least 2.
    """

    origin: Float[np.ndarray, "3"]
    spacing: float
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "origin", np.array(self.origin, np.float64).reshape(3))
        set_(self, "spacing", float(self.spacing))
        nx, ny, nz = (integer(n) for n in self.shape)
        set_(self, "shape", (nx, ny, nz))
        if not (np.isfinite(self.origin).all() and np.isfinite(self.spacing) and self.spacing > 0):
            raise BadInput(f"a lattice with origin {self.origin} and spacing {self.spacing}: give finite numbers, > 0")
        if min(self.shape) < 2:
            raise BadInput(f"a lattice of {self.shape} samples has no cell: give at least 2 samples along every axis")

    @staticmethod
    def around(bounds: Float[np.ndarray, "2 3"], resolution: int, *, cube: bool = False, levels: int = 0) -> "Lattice":
        """Return the lattice of a box plus the band on every side.

        Parameters
        ----------
        bounds
            Least and greatest corner of the box, world.
        resolution
            Samples along the longest axis; spacing = extent / (resolution - 1 - 2 BAND).
        cube
            Give every axis that many samples.
        levels
            Make room for as many coarser lattices on the same nodes: the band around the box is that of the coarsest,
            and every axis has a multiple of 2^levels cells. The spacing is the same as without.

        Raises
        ------
        BadInput
            If the resolution is outside 16..8192, the box is empty or not finite, or the coarsest lattice would have
            fewer than 16 samples along its longest axis.

        Examples
        --------
        >>> Lattice.around(np.array([[-1.0, -1, -1], [1, 1, 1]]), 64).shape
        (64, 64, 64)
        """
        n = check_resolution(resolution)
        low, high = np.asarray(bounds, np.float64)
        extent = high - low
        if not np.isfinite(extent).all() or extent.max() <= 0 or extent.min() < 0:
            raise BadInput(f"the box from {low} to {high} is empty or not finite: check the vertices of the mesh")
        spacing = extent.max() / (n - 1 - 2 * BAND)
        # A thousandth of a voxel of slack, so that a cube is not given one sample more along one axis by rounding.
        count = np.ceil(extent / spacing + 2 * BAND - 1e-3).astype(int) + 1
        count = np.full(3, n) if cube else np.minimum(count, n)
        if levels:
            step = 1 << check_levels(levels)
            count = step * np.ceil((count - 1 - 2 * BAND) / step + 2 * BAND - 1e-3).astype(int) + 1
            _require_coarsest(int((count.max() - 1) // step + 1), n, levels)
        origin = (low + high) / 2 - spacing * (count - 1) / 2
        nx, ny, nz = count.tolist()
        return Lattice(origin, float(spacing), (nx, ny, nz))

    def coarser(self) -> "Lattice":
        """Return the lattice of every second node.

        Raises
        ------
        ValueError
            If an axis has an odd number of cells: then the last node would be left out.
        """
        if any(n % 2 == 0 for n in self.shape):
            raise ValueError(f"a lattice of {self.shape} samples has no coarser one on its nodes")
        nx, ny, nz = (n // 2 + 1 for n in self.shape)
        return Lattice(self.origin, 2 * self.spacing, (nx, ny, nz))

    def is_same(self, other: "Lattice") -> bool:
        """Say whether another lattice has the same nodes, bit for bit."""
        same = self.shape == other.shape and self.spacing == other.spacing
        return same and bool((self.origin == other.origin).all())

    def to_grid(self, p: Num[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Return grid coordinates of world points: (p - origin) / spacing."""
        p_grid: Float[np.ndarray, "*n 3"] = (np.asarray(p, np.float64) - self.origin) / self.spacing
        return p_grid

    def to_world(self, index: Num[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Return world points of grid coordinates (whole or not): origin + spacing * index."""
        p: Float[np.ndarray, "*n 3"] = self.origin + self.spacing * np.asarray(index, np.float64)
        return p

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """First and last sample, world."""
        return self.to_world(np.array([[0, 0, 0], self.shape]) - [[0], [1]])


def _require_coarsest(samples: int, resolution: int, levels: int) -> None:
    """Raise BadInput where the coarsest of several lattices has too few samples along its longest axis."""
    if samples < LEAST:
        raise BadInput(
            f"{levels} coarser levels of a grid of {resolution} samples leave {samples} along the longest axis and at "
            f"least {LEAST} are needed: ask for fewer levels"
        )


def check_levels(levels: int) -> int:
    """Return the number of coarser levels if a bake can have as many, else raise BadInput."""
    if not 0 <= levels <= _MOST_LEVELS:
        raise BadInput(f"{levels} coarser levels are outside 0..{_MOST_LEVELS}: ask for 3, or for none")
    return integer(levels)


def check_resolution(resolution: int) -> int:
    """Return the resolution if a bake can have it, else raise BadInput."""
    if not LEAST <= resolution <= MOST:
        raise BadInput(f"resolution {resolution} is outside {LEAST}..{MOST}: the band alone takes 11 samples; try 64")
    return integer(resolution)
