"""Which bricks of 8^3 samples exist, where they lie, and how far the surface is from the others.

In: a lattice and a distance. Out: `Bricks`, found coarse to fine by the 1-Lipschitz bound: no point of a cube of
half-diagonal R is nearer to the surface than |distance(centre)| - R.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake.lattice import BAND, Lattice

SIDE = 8
# A root of the interpolant may lie off the surface by a fraction of a voxel; its stencil must still be complete.
REACH = BAND + 0.5
_CHUNK = 64  # bricks whose samples are evaluated at once: 2^15 points, whose columns stay in the caches
_DOWN = 1 - 1e-6  # more than float32's rounding: a lower bound stays one when it is stored

Distance = Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, " n"]]


@dataclass(frozen=True, slots=True, eq=False)
class Bricks:
    """Table of the bricks of a lattice.

    Attributes
    ----------
    slot
        Per brick of the lattice its place in the channel arrays, int32, numbered in C order of the brick's index; -1
        where it is absent.
    far
        Per absent brick, the sign of the distance times a lower bound of its magnitude over the brick's closed cube of
        cells (samples 0 to 8 along each axis), float32, world units; 0 where the brick is present.
    index
        Brick coordinates of every slot, int32; brick b holds the samples 8 b to 8 b + 7.
    left_out
        Bricks that the grid's file has and that were not loaded: absent here, and what is in them is not known (their
        `far` is 0). None where all were.
    """

    slot: Int[np.ndarray, "bx by bz"]
    far: Float[np.ndarray, "bx by bz"]
    index: Int[np.ndarray, "k 3"]
    left_out: Bool[np.ndarray, "bx by bz"] | None = None

    @staticmethod
    def of(present: Bool[np.ndarray, "bx by bz"], far: Float[np.ndarray, "bx by bz"]) -> "Bricks":
        """Number the present bricks; `far` is kept where they are absent."""
        index = np.argwhere(present).astype(np.int32)
        slot = np.full(present.shape, -1, np.int32)
        slot[present] = np.arange(len(index), dtype=np.int32)
        return Bricks(slot, np.where(present, 0, far).astype(np.float32), index)

    def __len__(self) -> int:
        return len(self.index)


def counts(shape: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return the number of bricks along each axis of a lattice of that many samples."""
    nx, ny, nz = (-(-n // SIDE) for n in shape)
    return nx, ny, nz


def sample_index(index: Int[np.ndarray, "k 3"]) -> Int[np.ndarray, "k 8 8 8 3"]:
    """Return the lattice index of every sample of some bricks."""
    at: Int[np.ndarray, "k 8 8 8 3"] = index[:, None, None, None, :].astype(np.int64) * SIDE + _corners(SIDE)
    return at


def in_lattice(index: Int[np.ndarray, "k 3"], shape: tuple[int, int, int]) -> Bool[np.ndarray, "k 8 8 8"]:
    """Say which samples of some bricks the lattice has; the rest of a last brick is stored as 0 and never used."""
    x, y, z = ((index[:, axis, None] * SIDE + np.arange(SIDE)) < shape[axis] for axis in range(3))
    inside: Bool[np.ndarray, "k 8 8 8"] = x[:, :, None, None] & y[:, None, :, None] & z[:, None, None, :]
    return inside


def sampled(
    lattice: Lattice,
    index: Int[np.ndarray, "k 3"],
    function: Callable[[Float[np.ndarray, "n 3"]], np.ndarray],
    out: np.ndarray,
    among: Bool[np.ndarray, "k 8 8 8"] | None = None,
) -> np.ndarray:
    """Fill `out` (k, 8, 8, 8, ...), fresh from the caller, with a function of the samples' world positions.

    Samples outside the lattice, or not `among` those that are wanted, stay as they are. Chunks run on threads.
    """

    def fill(part: slice) -> None:
        wanted = in_lattice(index[part], lattice.shape)
        if among is not None:
            wanted &= among[part]
        out[part][wanted] = function(lattice.to_world(sample_index(index[part])[wanted]))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(fill, [slice(start, start + _CHUNK) for start in range(0, len(index), _CHUNK)]))
    return out


def _corners(side: int) -> Int[np.ndarray, "side side side 3"]:
    """Return the indices of a cube of that many samples."""
    corners: Int[np.ndarray, "side side side 3"] = np.moveaxis(np.indices((side, side, side)), 0, -1)
    return corners


def candidates(
    lattice: Lattice, distance: Distance, reach: float = REACH
) -> tuple[Int[np.ndarray, "k 3"], Float[np.ndarray, "bx by bz"]]:
    """Descend the octree of bricks to all that may hold a sample within reach of the surface.

    Parameters
    ----------
    lattice
        Where the samples lie.
    distance
        Signed distance of world points, 1-Lipschitz.
    reach
        Half width of what is wanted, voxels.

    Returns
    -------
    index, far
        Brick coordinates in C order, int32; and the signed bound of every other brick (see `Bricks.far`).
    """
    count, last = np.array(counts(lattice.shape)), np.array(lattice.shape) - 1
    level = int(np.ceil(np.log2(count.max())))
    nodes, far = np.zeros((1, 3), np.int64), np.zeros((1, 1, 1), np.float32)
    child = _corners(2).reshape(-1, 3)
    while True:
        first = nodes * (SIDE << level)
        end = np.minimum(first + (SIDE << level), last)
        radius = lattice.spacing * np.linalg.norm(end - first, axis=-1) / 2
        d = distance(lattice.to_world((first + end) / 2))
        pruned = np.abs(d) > reach * lattice.spacing + radius
        far[tuple(nodes[pruned].T)] = (np.sign(d) * (np.abs(d) - radius) * _DOWN)[pruned]
        nodes = nodes[~pruned]
        if level == 0:
            return nodes[np.lexsort(nodes.T[::-1])].astype(np.int32), far
        level -= 1
        size = -(-count // (1 << level))
        nodes = (2 * nodes[:, None] + child).reshape(-1, 3)
        nodes = nodes[(nodes < size).all(axis=-1)]
        far = far.repeat(2, 0).repeat(2, 1).repeat(2, 2)[: size[0], : size[1], : size[2]]


def settle(
    lattice: Lattice,
    found: tuple[Int[np.ndarray, "k 3"], Float[np.ndarray, "bx by bz"]],
    values: Float[np.ndarray, "k 8 8 8"],
    reach: float = REACH,
) -> tuple[Bricks, Bool[np.ndarray, " k"]]:
    """Keep the candidates that do hold a sample within reach.

    Parameters
    ----------
    lattice, reach
        As for `candidates`.
    found
        What `candidates` returned.
    values
        Signed distances of the candidates' samples, world units.

    Returns
    -------
    bricks, kept
        The table, and which candidates are in it.
    """
    index, far = found
    inside = in_lattice(index, lattice.shape)
    least = np.where(inside, np.abs(values), np.inf).min(axis=(1, 2, 3), initial=np.inf)
    kept: Bool[np.ndarray, " k"] = least <= reach * lattice.spacing
    far, present = far.copy(), np.zeros(far.shape, bool)
    # The first sample of a brick is always in the lattice. A point of the brick's cells is at most a voxel's diagonal
    # from one of its samples.
    bound = np.sign(values[:, 0, 0, 0]) * (least - np.sqrt(3) * lattice.spacing).clip(0) * _DOWN
    far[tuple(index[~kept].T)] = bound[~kept]
    present[tuple(index[kept].T)] = True
    return Bricks.of(present, far), kept


def active(lattice: Lattice, distance: Distance, reach: float = REACH) -> Bricks:
    """Return exactly the bricks with a sample whose |distance| is at most `reach` voxels.

    Parameters and errors are those of `candidates`; this evaluates their samples too.
    """
    found = candidates(lattice, distance, reach)
    values = sampled(lattice, found[0], distance, np.zeros((len(found[0]), SIDE, SIDE, SIDE)))
    return settle(lattice, found, values, reach)[0]
