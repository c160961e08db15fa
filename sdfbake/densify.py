"""A grid as a dense array, a slab at a time.

In: a grid, and its surface where distances far from it shall be exact. Out: float32 samples in slabs of eight along x,
so that memory stays within a slab. What the bricks do not hold is filled by its signed lower bound, or asked of the
surface.
"""

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float

from sdfbake.bake import mesh_hash
from sdfbake.bricks import SIDE
from sdfbake.closest import Surface
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.lattice import BAND
from sdfbake.mesh import Mesh

Progress = Callable[[str, float], None]
_CHUNK = 1 << 17  # points asked for at once


def dense(grid: Grid, exact: Mesh | bool = False, progress: Progress | None = None) -> Float[np.ndarray, "nx ny nz"]:
    """Return all samples of a grid as one array.

    Parameters
    ----------
    grid
        Any grid.
    exact
        Whether samples beyond the exact band are float32 of the exact distance, too, rather than a bound of it: a mesh
        to ask, or True for the one that the grid carries. A query of the mesh for each takes its time: some 5 us.
    progress
        Called with a stage and the share of it that is done, 0 to 1.

    Raises
    ------
    BadInput
        If the mesh is not the one that was baked, or the grid carries none.
    """
    surface = _surface(grid, exact)
    filled = np.empty(grid.lattice.shape, np.float32)
    first = 0
    for slab in slabs(grid, surface, progress):
        filled[first : first + len(slab)] = slab
        first += len(slab)
    return filled


def slabs(
    grid: Grid, surface: Surface | None = None, progress: Progress | None = None
) -> Iterator[Float[np.ndarray, "sx ny nz"]]:
    """Yield the samples of a grid in slabs along x.

    Parameters
    ----------
    grid
        Any grid.
    surface
        What the grid's distances are from, for exact distances everywhere; None for bounds.
    progress
        Called with a stage and the share of it that is done, 0 to 1.

    Yields
    ------
    slab
        Eight samples along x, in the last slab what is left; all samples along y and z. World units, float32.
    """
    report = progress or (lambda stage, share: None)
    count = len(grid.bricks.slot)
    report("dense", 0)
    for number in range(count):
        slab = _slab(grid, number)
        yield slab if surface is None else _exact(grid, number, slab, surface)
        report("dense", (number + 1) / count)


def _surface(grid: Grid, exact: Mesh | bool) -> Surface | None:
    """Return what exact distances are asked of."""
    if exact is False:
        return None
    if exact is True:
        if grid.surface is None:
            raise BadInput(
                "the grid carries no mesh to compute exact distances from: give the mesh, or bake with uv mode 'faces'"
            )
        return Surface.of(grid.surface.mesh())
    if mesh_hash(exact) != grid.metadata.mesh_hash:
        raise BadInput("the mesh is not the one that the grid was baked from: give that mesh, repaired and unwrapped")
    return Surface.of(exact)


def _slab(grid: Grid, number: int) -> Float[np.ndarray, "sx ny nz"]:
    """Return the samples of one layer of bricks, bounds where there is no brick."""
    _, by, bz = grid.bricks.slot.shape
    nx, ny, nz = grid.lattice.shape
    values = np.empty((SIDE, by, SIDE, bz, SIDE), np.float32)
    values[:] = grid.bricks.far[number][:, None, :, None]
    first, end = np.searchsorted(grid.bricks.index[:, 0], [number, number + 1])  # slots are in C order
    _, y, z = grid.bricks.index[first:end].T
    values[:, y, :, z, :] = grid.distance[first:end]
    return values.reshape(SIDE, SIDE * by, SIDE * bz)[: nx - SIDE * number, :ny, :nz]


def _exact(
    grid: Grid, number: int, slab: Float[np.ndarray, "sx ny nz"], surface: Surface
) -> Float[np.ndarray, "sx ny nz"]:
    """Replace bounds by distances that have their signs."""
    absent = (grid.bricks.slot[number] < 0).repeat(SIDE, 0).repeat(SIDE, 1)[: slab.shape[1], : slab.shape[2]]
    asked = np.flatnonzero((np.abs(slab) > BAND * grid.lattice.spacing) | absent)
    values = slab.reshape(-1).copy()
    for start in range(0, len(asked), _CHUNK):
        at = asked[start : start + _CHUNK]
        i, j, k = np.unravel_index(at, slab.shape)
        sample = np.stack([i + SIDE * number, j, k], axis=-1)
        values[at] = np.copysign(surface.distance(grid.lattice.to_world(sample)), values[at])
    return values.reshape(slab.shape)
