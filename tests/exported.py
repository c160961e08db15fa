"""A shape whose three axes cannot be mistaken for each other, on a lattice that is no cube, for tests of exports."""

import numpy as np

from sdfbake import Grid
from sdfbake.bricks import REACH, SIDE
from sdfbake.lattice import Lattice

CENTRES = np.array([[0.0, 0, 0], [1.0, 0.3, 0], [0.1, 0.75, 0.2], [0.0, 0.1, 0.5]])
RADII = np.array([0.4, 0.3, 0.2, 0.15])


class Pile:
    """Balls, far along x, less along y, least along z; charts are balls, parts are the first and the rest.

    Its distance is exact outside, 1-Lipschitz inside.
    """

    part_names = ("body", "knobs")
    bounds = np.array([(CENTRES - RADII[:, None]).min(axis=0), (CENTRES + RADII[:, None]).max(axis=0)])

    def distance(self, p):
        return self._all(p).min(axis=-1)

    def uv(self, p):
        return np.stack([0.2 + p[:, 0] / 3, 0.3 + p[:, 1] / 5 + p[:, 2] / 7], axis=-1)

    def chart(self, p):
        return self._all(p).argmin(axis=-1).astype(np.int32)

    def part(self, p):
        return (self.chart(p) > 0).astype(np.uint8)

    def _all(self, p):
        return np.linalg.norm(p[:, None] - CENTRES, axis=-1) - RADII


def pile(resolution=61):
    """Return the grid of a pile: (61, 50, 44) samples at first."""
    return Grid.from_function(Pile(), resolution)


def points(lattice: Lattice):
    """Return the positions of all samples (nx, ny, nz, 3)."""
    return lattice.to_world(np.moveaxis(np.indices(lattice.shape), 0, -1))


def spread(grid, values, absent):
    """Put what is stored per sample into a dense array, brick by brick: the plainest way there is."""
    filled = np.full(tuple(n * SIDE for n in grid.bricks.slot.shape) + values.shape[4:], absent, values.dtype)
    for (x, y, z), brick in zip(grid.bricks.index * SIDE, values, strict=True):
        filled[x : x + SIDE, y : y + SIDE, z : z + SIDE] = brick
    nx, ny, nz = grid.lattice.shape
    return filled[:nx, :ny, :nz]


def known(grid):
    """Say of which samples of the lattice the closest point is known (nx, ny, nz)."""
    return spread(grid, np.abs(grid.distance) <= REACH * grid.lattice.spacing, False)


def silent(stage, share):
    """Show no progress."""
