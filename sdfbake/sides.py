"""Which method says what is inside, and how far another one agrees.

In: signed or unsigned distances of bricks. Out: signed ones and a record for the metadata. Pseudonormals serve meshes
that are certified clean; where winding numbers of a sample of points disagree, or the mesh is not clean, winding
numbers decide, block by block.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from sdfbake.bricks import in_lattice, sample_index
from sdfbake.lattice import BAND, Lattice
from sdfbake.metadata import Sign
from sdfbake.sign import Pseudonormals, Winding

DISAGREEMENT = 1e-3  # share of the compared samples beyond which the user is told
_COMPARED = 4096  # samples that a second method looks at: enough to see a share of 1e-3
_BRICKS_AT_ONCE = 512

Progress = Callable[[str, float], None]


def compared(
    winding: Winding, lattice: Lattice, index: Int[np.ndarray, "k 3"], distance: Float[np.ndarray, "k 8 8 8"]
) -> Sign:
    """Compare signs by pseudonormals with winding numbers on an even choice of the band's samples."""
    points, given = _chosen(lattice, index, distance)
    other = winding.signs(points)
    return Sign(method="pseudonormal", checked=len(given), disagree=_share(other != given))


def wound(
    winding: Winding,
    lattice: Lattice,
    index: Int[np.ndarray, "k 3"],
    distance: Float[np.ndarray, "k 8 8 8"],
    report: Progress,
) -> tuple[Float[np.ndarray, "k 8 8 8"], Sign]:
    """Return distances with the signs of winding numbers, compared with those of pseudonormals on some samples."""
    signed, surface = np.abs(distance), winding.surface
    for start in range(0, len(index), _BRICKS_AT_ONCE):
        report("signs", start / len(index))
        part = slice(start, start + _BRICKS_AT_ONCE)
        signed[part] *= winding.brick_signs(lattice.to_world(sample_index(index[part])), signed[part])
    report("signs", 1)
    points, given = _chosen(lattice, index, signed)
    other = Pseudonormals.of(surface).signs(points, surface.closest(points))
    return signed, Sign(method="winding", checked=len(given), disagree=_share(other != given))


def _chosen(
    lattice: Lattice, index: Int[np.ndarray, "k 3"], distance: Float[np.ndarray, "k 8 8 8"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Return the positions and signs of some samples of the band, off the surface itself."""
    # Bricks first, so that no table of all samples is made.
    step = max(1, len(index) * 64 // _COMPARED)
    index, distance = index[::step], distance[::step]
    size = np.abs(distance) / lattice.spacing
    near = np.flatnonzero((size <= BAND) & (size > 1e-6) & in_lattice(index, lattice.shape))
    near = near[:: max(1, -(-len(near) // _COMPARED))]
    slot, *within = np.unravel_index(near, distance.shape)
    at = index[slot].astype(np.int64) * distance.shape[1] + np.stack(within, axis=-1)
    return lattice.to_world(at), np.where(distance.reshape(-1)[near] < 0, -1, 1).astype(np.int8)


def _share(differ: np.ndarray) -> float:
    return float(differ.mean()) if len(differ) else 0.0
