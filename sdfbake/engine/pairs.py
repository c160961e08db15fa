"""Lists of every lane, written out flat for NumPy: one entry per lane and item.

In: `Lists` and what lanes know. Out: tiles of pairs that fit the caches, worked on by a pool of threads.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from sdfbake.engine.protocol import Array, Lists, Measures

PAIRS = 1 << 15  # in a tile, unless one lane alone has more: its thirty temporaries stay in the caches


class Pairs(NamedTuple):
    """Some lanes with their items.

    Attributes
    ----------
    lanes
        Which lanes.
    item, owner
        Item of every pair, and the lane (counted from the first of these lanes) it belongs to.
    first
        First pair of every lane.
    known
        What the pairs' lanes know, repeated per pair.
    """

    lanes: slice
    item: np.ndarray
    owner: np.ndarray
    first: np.ndarray
    known: tuple[np.ndarray, ...]

    def measured(self, measures: Measures) -> tuple[np.ndarray, ...]:
        """Return what is asked of every pair."""
        with np.errstate(all="ignore"):  # faces without area divide by 0, and lose
            return measures(*self.known)(self.item)

    def least(self, values: np.ndarray) -> np.ndarray:
        """Return the least value of every lane's pairs."""
        lowest: np.ndarray = np.minimum.reduceat(values, self.first)
        return lowest


def over_tiles(lists: Lists, lane: Sequence[Array], work: Callable[[Pairs], Any]) -> list[Any]:
    """Call `work` on all lanes in order, some at a time."""
    end = np.cumsum(lists.count, dtype=np.int64)
    cuts = np.unique(np.searchsorted(end, np.arange(PAIRS, end[-1], PAIRS)))
    bounds = [0, *(cuts[(cuts > 0) & (cuts < len(end))]).tolist(), len(end)]

    def tile(number: int) -> Any:
        lanes = slice(bounds[number], bounds[number + 1])
        count = lists.count[lanes]
        first = np.cumsum(count) - count
        owner = np.repeat(np.arange(len(count)), count)
        item = lists.items[np.repeat(lists.start[lanes] - first, count) + np.arange(len(owner))]
        return work(Pairs(lanes, item, owner, first, tuple(known[lanes][owner] for known in lane)))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(tile, range(len(bounds) - 1)))
