"""A grid as a dense array, a slab at a time.

In: a grid, and its surface where distances far from it shall be exact. Out: float32 samples in slabs of eight along an
axis, so that memory stays within a slab. What the bricks do not hold is filled by its signed lower bound, or asked of
the surface.
"""

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float

from sdfbake.bake import mesh_hash
from sdfbake.bricks import SIDE, Bricks
from sdfbake.closest import Surface
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.lattice import BAND, Lattice
from sdfbake.mesh import Mesh

Progress = Callable[[str, float], None]
_CHUNK = 1 << 17  # points asked for at once
_COPIED = 64  # bricks copied at once: what is fetched of them is small beside a slab


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
    surface = surface_of(grid, exact)
    filled = np.empty(grid.lattice.shape, np.float32)
    first = 0
    for slab in slabs(grid, surface, progress):
        filled[first : first + len(slab)] = slab
        first += len(slab)
    return filled


def slabs(
    grid: Grid, surface: Surface | None = None, progress: Progress | None = None, axis: int = 0
) -> Iterator[Float[np.ndarray, "sx sy sz"]]:
    """Yield the samples of a grid in slabs.

    Parameters
    ----------
    grid
        Any grid.
    surface
        What the grid's distances are from, for exact distances everywhere; None for bounds.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    axis
        Along which the slabs follow each other.

    Yields
    ------
    slab
        Indexed [x, y, z]: eight samples along the axis, in the last slab what is left; all samples along the others.
        In memory the axis is the slowest, then the next to it (see `order`). World units, float32. The caller's own:
        whoever lets go of it before asking for the next has one at a time in memory.
    """
    report = progress or (lambda stage, share: None)
    count = grid.bricks.slot.shape[axis]
    report("dense", 0)
    for number in range(count):
        yield slab(grid, number, axis, surface)
        report("dense", (number + 1) / count)


def order(axis: int) -> tuple[int, int, int]:
    """Return the axes of a slab as they lie in memory, the slowest first: x y z along x, z y x along z."""
    slowest, middle, fastest = sorted(range(3), key=lambda other: abs(other - axis))
    return slowest, middle, fastest


def slab(grid: Grid, number: int, axis: int = 0, surface: Surface | None = None) -> Float[np.ndarray, "sx sy sz"]:
    """Return the slab of that number; see `slabs`."""
    bricks = grid.bricks
    values = layer(bricks, grid.lattice, grid.distance, bricks.far.take([number], axis), number, axis)
    if surface is not None:
        _make_exact(values, grid, number, axis, surface)
    return values


def layer(
    bricks: Bricks, lattice: Lattice, values: np.ndarray, absent: np.ndarray | float, number: int, axis: int
) -> np.ndarray:
    """Return what is stored per sample, of one layer of bricks.

    Parameters
    ----------
    bricks, lattice
        Where the values are.
    values
        (k, 8, 8, 8, ...), a row per brick.
    absent
        What samples have whose brick is absent: one number, or one per brick of the layer, of the table's shape but for
        1 along the axis.
    number, axis
        Which layer, counted along which axis.

    Returns
    -------
    slab
        (sx, sy, sz, ...), in memory as `slabs` has it, fresh.
    """
    wide, width = np.array(bricks.slot.shape), values.shape[4:]
    wide[axis] = 1
    turned, rest = order(axis), tuple(range(3, 3 + len(width)))
    stored = np.empty((*(size for turn in turned for size in (wide[turn], SIDE)), *width), values.dtype)
    back = [turned.index(x) for x in range(3)]
    blocks = stored.transpose([2 * place + k for place in back for k in (0, 1)] + [3 + later for later in rest])
    far = np.broadcast_to(absent, wide)
    blocks[:] = far.reshape(wide[0], 1, wide[1], 1, wide[2], 1, *[1] * len(width))
    slots = np.flatnonzero(bricks.index[:, axis] == number)
    for start in range(0, len(slots), _COPIED):
        some = slots[start : start + _COPIED]
        place = bricks.index[some]
        place[:, axis] = 0
        x, y, z = place.T
        blocks[x, :, y, :, z] = values[some]
    whole = stored.reshape(*(wide[turn] * SIDE for turn in turned), *width).transpose(*back, *rest)
    left = np.array(lattice.shape)
    left[axis] -= SIDE * number
    sx, sy, sz = np.minimum(left, wide * SIDE)
    return whole[:sx, :sy, :sz]


def surface_of(grid: Grid, exact: Mesh | bool) -> Surface | None:
    """Return what exact distances are asked of; parameters and errors are those of `dense`."""
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


def _make_exact(values: Float[np.ndarray, "sx sy sz"], grid: Grid, number: int, axis: int, surface: Surface) -> None:
    """Replace bounds, in the slab of that number, by distances that have their signs; plane by plane, in place."""
    absent = grid.bricks.slot.take(number, axis) < 0
    for step, plane in enumerate(np.moveaxis(values, axis, 0)):
        away = absent.repeat(SIDE, 0).repeat(SIDE, 1)[: plane.shape[0], : plane.shape[1]]
        asked = np.argwhere((np.abs(plane) > BAND * grid.lattice.spacing) | away)
        for start in range(0, len(asked), _CHUNK):
            at = asked[start : start + _CHUNK]
            sample = np.insert(at, axis, SIDE * number + step, axis=1)
            place = tuple(at.T)
            plane[place] = np.copysign(surface.distance(grid.lattice.to_world(sample)), plane[place])
