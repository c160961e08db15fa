"""How far the surface is from the bricks that do not exist, and on which side of it they are.

In: which bricks exist, and their signed distances. Out: per absent brick the sign times a lower bound of the distance.
The surface passes only through cells of bricks that exist, so the distance from the nearest of those is a bound; and
absent bricks that touch have one sign, that of any sample next to them.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake.bricks import SIDE
from sdfbake.lattice import Lattice
from sdfbake.sign import Winding

_ROOT3 = 3.0**0.5
_DOWN = 1 - 1e-6  # more than float32's rounding: a lower bound stays one when it is stored


def far_bounds(
    present: Bool[np.ndarray, "bx by bz"],
    index: Int[np.ndarray, "k 3"],
    distance: Float[np.ndarray, "k 8 8 8"],
    reach: float,
    lattice: Lattice,
    winding: Winding | None = None,
) -> Float[np.ndarray, "bx by bz"]:
    """Return signed bounds for absent bricks, 0 for present ones.

    Parameters
    ----------
    present, index, distance
        Which bricks exist, where they are (in the order of the distances), signed distances, world units. Every sample
        within `reach` of the surface lies in one of them.
    reach
        Voxels.
    lattice
        Where the samples lie.
    winding
        Asked where neighbours disagree: through the holes of an open mesh, inside and outside meet.

    Returns
    -------
    far
        Float32, world units: no point of the brick's closed cube of cells is nearer to the surface than that.
    """
    from scipy import ndimage  # here, so that `import sdfbake` is light

    absent, spacing = ~present, lattice.spacing
    if not absent.any():
        return np.zeros(present.shape, np.float32)
    steps = ndimage.distance_transform_edt(absent) if present.any() else np.full(present.shape, np.inf)
    # Two cubes n steps apart along an axis leave a gap of n - 1 sides. And no sample is in reach, from which no point
    # of the cells is farther than a cell's diagonal.
    bound = np.maximum(SIDE * (steps - _ROOT3), reach - _ROOT3) * spacing * _DOWN
    bound = np.minimum(bound, np.float64(np.linalg.norm(present.shape)) * SIDE * spacing)  # where nothing is present
    group, inside, outside = _touched(absent, index, distance)
    sign = np.where(inside[group], -1, 1)
    torn = absent & (inside & outside)[group]
    if winding is not None and torn.any():
        centres = lattice.to_world(np.argwhere(torn) * SIDE + SIDE / 2)
        sign[torn] = winding.signs(centres)
    return np.where(absent, bound * sign, 0).astype(np.float32)


def _touched(
    absent: Bool[np.ndarray, "bx by bz"], index: Int[np.ndarray, "k 3"], distance: Float[np.ndarray, "k 8 8 8"]
) -> tuple[Int[np.ndarray, "bx by bz"], Bool[np.ndarray, " g"], Bool[np.ndarray, " g"]]:
    """Number the connected sets of absent bricks, and say which of them touch samples inside and outside.

    A sample next to an absent brick is at least reach - 1 voxels from the surface, and one voxel from the brick's own.
    """
    from scipy import ndimage

    group, count = ndimage.label(absent)
    inside, outside = np.zeros(count + 1, bool), np.zeros(count + 1, bool)
    for axis in range(3):
        for step, layer in ((-1, 0), (1, SIDE - 1)):
            neighbour = index.astype(np.int64)
            neighbour[:, axis] += step
            within = (neighbour[:, axis] >= 0) & (neighbour[:, axis] < absent.shape[axis])
            # In a last brick, what lies beyond the lattice is nothing; its first sample never does, and there is no
            # brick on the other side.
            at = [0, 0, 0]
            at[axis] = layer
            negative = distance[(within.nonzero()[0], *at)] < 0
            touched = group[tuple(neighbour[within].T)]
            inside[touched[negative]] = True
            outside[touched[~negative]] = True
    inside[0] = outside[0] = False  # bricks that exist
    return group, inside, outside
