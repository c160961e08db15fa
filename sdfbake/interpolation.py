"""How well kernels interpolate a grid: its error bar, brick by brick.

In: signed distances in bricks, and exact ones at the centres of some cells with surface. Out: per brick and kernel the
greatest difference. At a centre every kernel is one filter of six samples per axis, so three small matrix products per
brick evaluate all its centres.
"""

import numpy as np
from jaxtyping import Float, Int

from sdfbake.bricks import SIDE, Bricks
from sdfbake.grid import KERNELS

_HALO = 2  # samples before the first of a brick that a centre in it needs; and after the last
_WIDE = SIDE + 2 * _HALO
_EVERY = 2  # the cells whose first sample has even indices
_BRICKS_AT_ONCE = 1024

# Taps -2 to 3 of a cell for its centre: Galim 2018, eq. 9; eq. 21 with tension 1/2; and the cubic B-spline's
# (1, 23, 23, 1) / 48 after its prefilter (-1, 8, -1) / 6.
TAPS = {
    "linear": np.array([0, 0, 1, 1, 0, 0]) / 2,
    "catmull-rom": np.array([0, -1, 9, 9, -1, 0]) / 16,
    "bspline": np.convolve([1, 23, 23, 1], [-1, 8, -1]) / 288,
}


def brick_errors(
    bricks: Bricks, distance: Float[np.ndarray, "k 8 8 8"], centre: Float[np.ndarray, "k 4 4 4"], spacing: float
) -> Float[np.ndarray, "k 3"]:
    """Compare interpolated with exact distances.

    Parameters
    ----------
    bricks, distance
        The grid; world units.
    centre
        Exact distances, signed or not, at the centres of every other cell along each axis (first samples 0, 2, 4, 6);
        NaN where nothing is to be compared.
    spacing
        World units per voxel.

    Returns
    -------
    error
        Voxels, float32, one column for each of `KERNELS`; 0 where nothing was compared. Magnitudes are compared.
    """
    error = np.zeros((len(bricks), len(KERNELS)), np.float32)
    some = np.flatnonzero(~np.isnan(centre).all(axis=(1, 2, 3)))
    for start in range(0, len(some), _BRICKS_AT_ONCE):
        slots = some[start : start + _BRICKS_AT_ONCE]
        wide, exact = _widened(bricks, distance, slots), np.abs(centre[slots])
        for column, name in enumerate(KERNELS):
            off = np.abs(np.abs(_centres(wide, TAPS[name])) - exact)
            error[slots, column] = np.nan_to_num(off, nan=0.0).max(axis=(1, 2, 3)) / spacing
    return error


def _centres(wide: Float[np.ndarray, "b 12 12 12"], taps: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "b 4 4 4"]:
    """Interpolate the centres of a widened brick's even cells."""
    filters = np.zeros((_WIDE, SIDE // _EVERY), np.float32)
    for cell in range(SIDE // _EVERY):
        filters[_EVERY * cell : _EVERY * cell + 6, cell] = taps
    for _ in range(3):  # each time the last axis is filtered and becomes the first after the bricks
        wide = np.moveaxis(wide @ filters, -1, 1)
    return wide


def _widened(
    bricks: Bricks, distance: Float[np.ndarray, "k 8 8 8"], slots: Int[np.ndarray, " b"]
) -> Float[np.ndarray, "b 12 12 12"]:
    """Return bricks with two more samples on every side; NaN where there is no brick."""
    wide = np.full((len(slots), _WIDE, _WIDE, _WIDE), np.nan, np.float32)
    table = np.pad(bricks.slot, 1, constant_values=-1)
    # Where a neighbour's samples come from, and where they go.
    cuts = {-1: (slice(SIDE - _HALO, SIDE), slice(0, _HALO)), 0: (slice(0, SIDE), slice(_HALO, _HALO + SIDE)),
            1: (slice(0, _HALO), slice(_HALO + SIDE, _WIDE))}  # fmt: skip
    for step in np.ndindex(3, 3, 3):
        side = np.array(step) - 1
        near = table[tuple((bricks.index[slots] + 1 + side).T)]
        there = np.flatnonzero(near >= 0)
        source, goal = zip(*(cuts[int(s)] for s in side), strict=True)
        wide[(there, *goal)] = distance[(near[there], *source)]
    return wide
