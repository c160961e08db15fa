"""A grid as a dense array, a plane at a time.

In: a grid, and its surface where distances far from it shall be exact. Out: float32 samples in planes across an axis,
so that memory stays within a few planes. What the bricks do not hold is filled by its signed lower bound, or asked of
the surface.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sdfbake.bake import mesh_hash
from sdfbake.bricks import SIDE, Bricks, counts
from sdfbake.closest import Surface
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.lattice import BAND, Lattice
from sdfbake.mesh import Mesh

Progress = Callable[[str, float], None]
Part = tuple[slice, slice, slice]  # of the samples of a brick
_CHUNK = 1 << 15  # points asked for at once


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
    for number, values in enumerate(planes(grid, surface, progress)):
        filled[number] = values
    return filled


def planes(
    grid: Grid, surface: Surface | None = None, progress: Progress | None = None, axis: int = 0
) -> Iterator[Float[np.ndarray, "slow fast"]]:
    """Yield the samples of a grid in planes.

    Parameters
    ----------
    grid
        Any grid.
    surface
        What the grid's distances are from, for exact distances everywhere; None for bounds.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    axis
        Across which the planes lie, one after the other.

    Yields
    ------
    plane
        Indexed by the two other axes, the one next to `axis` first: [y, z] across x, [y, x] across z; C order. World
        units, float32. The caller's own.
    """
    report = progress or (lambda stage, share: None)
    count = grid.lattice.shape[axis]
    report("dense", 0)
    for number in range(count):
        yield plane(grid, number, axis, surface)
        report("dense", (number + 1) / count)


def order(axis: int) -> tuple[int, int]:
    """Return the axes of a plane across that one: the next to it, which is the slower, and the farthest."""
    slow, fast = sorted((other for other in range(3) if other != axis), key=lambda other: abs(other - axis))
    return slow, fast


def plane(grid: Grid, number: int, axis: int = 0, surface: Surface | None = None) -> Float[np.ndarray, "slow fast"]:
    """Return the plane of that number; see `planes`."""
    far = grid.bricks.far.take(number // SIDE, axis)
    cut = Cut.of(grid.bricks, number, axis)
    values = cut.spread(grid.lattice, cut.taken(grid.distance), far if axis < 2 else far.T)
    if surface is not None:
        _make_exact(values, grid, cut, surface)
    return values


class Cut(NamedTuple):
    """A plane of samples across an axis.

    Attributes
    ----------
    number, axis
        Which plane, counted along which axis.
    slots
        The bricks that it cuts.
    place
        Where they are, bricks.
    """

    number: int
    axis: int
    slots: Int[np.ndarray, " n"]
    place: Int[np.ndarray, "n 3"]

    @staticmethod
    def of(bricks: Bricks, number: int, axis: int) -> "Cut":
        """Find the bricks."""
        slots = np.flatnonzero(bricks.index[:, axis] == number // SIDE)
        return Cut(number, axis, slots, bricks.index[slots])

    @property
    def part(self) -> Part:
        """Which samples of these bricks lie on it."""
        step = self.number % SIDE
        x, y, z = (slice(step, step + 1) if axis == self.axis else slice(0, SIDE) for axis in range(3))
        return x, y, z

    def taken(self, values: np.ndarray) -> np.ndarray:
        """Return what is stored for these samples, of (k, 8, 8, 8, ...): (n, 8, 8, ...) with 1 along the axis."""
        x, y, z = self.part
        found: np.ndarray = values[:, x, y, z][self.slots]
        return found

    def spread(self, lattice: Lattice, values: np.ndarray, absent: np.ndarray | float) -> np.ndarray:
        """Return the plane.

        Parameters
        ----------
        lattice
            Of the grid.
        values
            As `taken` returns them.
        absent
            What samples have whose brick is absent: one number, or one per brick [slow, fast].

        Returns
        -------
        plane
            (slow, fast, ...), fresh.
        """
        slow, fast = order(self.axis)
        wide, width = counts(lattice.shape), values.shape[4:]
        filled = np.empty((wide[slow], SIDE, wide[fast], SIDE, *width), values.dtype)
        filled[:] = np.broadcast_to(absent, (wide[slow], wide[fast])).reshape(
            wide[slow], 1, wide[fast], 1, *[1] * len(width)
        )
        blocks = values.squeeze(1 + self.axis)
        filled[self.place[:, slow], :, self.place[:, fast]] = blocks if slow < fast else blocks.swapaxes(1, 2)
        whole = filled.reshape(wide[slow] * SIDE, wide[fast] * SIDE, *width)
        return whole[: lattice.shape[slow], : lattice.shape[fast]]


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


def _make_exact(values: Float[np.ndarray, "slow fast"], grid: Grid, cut: Cut, surface: Surface) -> None:
    """Replace bounds, in a plane, by distances that have their signs; in place."""
    slow, fast = order(cut.axis)
    absent = grid.bricks.slot.take(cut.number // SIDE, cut.axis) < 0
    away = (absent if slow < fast else absent.T).repeat(SIDE, 0).repeat(SIDE, 1)[: values.shape[0], : values.shape[1]]
    asked = np.flatnonzero((np.abs(values) > BAND * grid.lattice.spacing) | away)
    for start in range(0, len(asked), _CHUNK):
        place = np.unravel_index(asked[start : start + _CHUNK], values.shape)
        sample = np.full((len(place[0]), 3), cut.number)
        sample[:, slow], sample[:, fast] = place
        values[place] = np.copysign(surface.distance(grid.lattice.to_world(sample)), values[place])
