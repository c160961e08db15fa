"""Cells whose texture coordinates come from several charts.

In: ids per sample. Out: per cell, whether the samples behind its coefficients have different ids: a seam.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import reduce

import numpy as np
from jaxtyping import Float, Int, Integer

from sdfbake.bricks import SIDE, Bricks, in_lattice
from sdfrender.kernels import Kernel
from sdfrender.stencils import around

_LOW, _HIGH = 2, 3  # samples beyond a brick's own that the widest stencil and its prefilter touch
_CHUNK = 32  # bricks at once: 0.6 MB of samples stay in the caches


def _places() -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Say of every sample of a padded brick which of the 27 bricks it is in, and where in there."""
    brick, inside = np.divmod(np.arange(-_LOW, SIDE + _HIGH), SIDE)
    x, y, z = np.ix_(brick + 1, brick + 1, brick + 1)
    i, j, k = np.ix_(inside, inside, inside)
    return ((x * 3 + y) * 3 + z).ravel(), ((i * SIDE + j) * SIDE + k).ravel()


_BRICK, _INSIDE = _places()


def mixed_cells(
    ids: Integer[np.ndarray, "k 8 8 8"], bricks: Bricks, shape: tuple[int, int, int], kernel: Kernel
) -> Integer[np.ndarray, "k 8 8 8"]:
    """Say of every cell, as uint8, whether the samples behind its coefficients have different ids (a seam).

    A program of array engines would look at six samples along every axis of every cell; here the few bricks that see
    more than one chart are found first.
    """
    out = np.zeros((len(bricks), SIDE, SIDE, SIDE), np.uint8)
    known = np.where(in_lattice(bricks.index, shape), ids, np.nan)
    # After all samples a brick of NaN, which stands for every absent one.
    values = np.append(known.ravel(), np.full(SIDE**3, np.nan))
    near = around(np.where(bricks.slot < 0, len(bricks), bricks.slot), bricks.index, len(bricks))

    def prepare(start: int) -> None:
        rows = slice(start, start + _CHUNK)
        padded = values.take(near[rows].astype(np.int64).take(_BRICK, axis=1) * SIDE**3 + _INSIDE)
        several = np.fmin.reduce(padded, axis=1) != np.fmax.reduce(padded, axis=1)
        side = SIDE + _LOW + _HIGH
        out[rows][several] = _differ(padded[several].reshape(-1, side, side, side), kernel)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(prepare, range(0, len(bricks), _CHUNK)))
    return out


def _differ(padded: Float[np.ndarray, "m 13 13 13"], kernel: Kernel) -> np.ndarray:
    """Compare the least and the greatest id about every cell."""
    reach = 1 if kernel.filtered else 0
    first, width = _LOW + kernel.first - reach, kernel.taps + 2 * reach
    least = most = padded
    for axis in (1, 2, 3):
        starts = [(slice(None),) * axis + (slice(first + o, first + o + SIDE),) for o in range(width)]
        least, most = (
            reduce(pick, [bound[start] for start in starts]) for bound, pick in ((least, np.fmin), (most, np.fmax))
        )
    differ: np.ndarray = least != most
    return differ
