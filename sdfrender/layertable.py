"""Layers laid out for look-ups in cells: every brick's rows, padded to the corners of all its cells.

In: the layers of a grid and where its bricks lie. Out: rows per brick, and their samples, 9^3 each.
"""

from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from sdfbake.bricks import SIDE, Bricks
from sdfbake.layers import Layers

PADDED = SIDE + 1  # corners of a brick's cells per axis
CORNERS = tuple(product((0, 1), repeat=3))  # of a cell, z fastest
_CHUNK = 256  # rows at once: 1.5 MB of samples


class Rows(NamedTuple):
    """Rows per brick as `sdfrender.layermap.LayerMap` has them, and of what they are made.

    Row target[i] takes from the stored row source[i] those samples that a brick sees of its neighbour in direction
    `offset[i]`, a row of `CORNERS`; ascending by target.
    """

    first: Int[np.ndarray, " k1"]
    chart: Int[np.ndarray, " r"]
    target: Int[np.ndarray, " e"]
    source: Int[np.ndarray, " e"]
    offset: Int[np.ndarray, " e"]


def rows_of(layers: Layers, bricks: Bricks) -> Rows:
    """Give every brick a row for each chart that it or a neighbour's first samples speak of."""
    spoken = np.isfinite(layers.border)
    parts = []
    for number, offset in enumerate(CORNERS):
        index = bricks.index[layers.brick] - np.array(offset)
        x, y, z = np.maximum(index, 0).T
        slot = np.where((index >= 0).all(axis=1), bricks.slot[x, y, z], -1)
        seen = spoken[(slice(None), *_span(offset)[1])].any(axis=(1, 2, 3))
        source = np.flatnonzero((slot >= 0) & seen)
        parts.append(np.stack([slot[source], layers.chart[source], source, np.full(len(source), number)]))
    brick, chart, source, offset_ = np.concatenate(parts, axis=1).astype(np.int64)
    charts = len(layers.of)
    rows, target = np.unique(brick * charts + chart, return_inverse=True)
    order = np.argsort(target.reshape(-1), kind="stable")
    first = np.searchsorted(rows, np.arange(len(bricks) + 1) * charts)
    return Rows(first, rows % charts, target.reshape(-1)[order], source[order], offset_[order])


def _span(offset: tuple[int, ...]) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return where a neighbour's samples go in a padded row, and which they are."""
    to = tuple(slice(SIDE, PADDED) if o else slice(0, SIDE) for o in offset)
    return to, tuple(slice(0, 1) if o else slice(0, SIDE) for o in offset)


def padded(
    layers: Layers, rows: Rows
) -> tuple[Int[np.ndarray, "r 9 9 9"], Float[np.ndarray, "r 9 9 9"], Int[np.ndarray, "r 8 8 8"]]:
    """Return `uv`, `border` and `cells` of `sdfrender.layermap.LayerMap`."""
    count = len(rows.chart)
    uv = np.zeros((count, PADDED, PADDED, PADDED), np.int32)
    border = np.zeros((count, PADDED, PADDED, PADDED), np.float32)
    cells = np.empty((count, SIDE, SIDE, SIDE), np.int32)
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        spoken = np.zeros(border[part].shape, bool)
        normal = np.zeros((*spoken.shape, 3), np.int16)
        for to, at in _takes(rows, start):
            finite = np.isfinite(layers.border[at])
            code = layers.uv[at].astype(np.uint32)
            word = (code[..., 0] | (code[..., 1] << np.uint32(16))).view(np.int32)
            uv[part][to] = np.where(finite, word, 0)
            border[part][to] = np.where(finite, layers.border[at], 0)
            spoken[to] = finite
            normal[to] = np.where(finite[..., None], layers.normal[at], 0)
        cells[part] = _cells(spoken, normal)
    return uv, border, cells


def _takes(rows: Rows, start: int) -> Iterator[tuple[Any, Any]]:
    """Return which samples of a chunk of rows are which of the stored rows, as indices, one direction at a time."""
    low, high = np.searchsorted(rows.target, (start, start + _CHUNK))
    for number, offset in enumerate(CORNERS):
        chosen = low + np.flatnonzero(rows.offset[low:high] == number)
        to, taken = _span(offset)
        yield (rows.target[chosen] - start, *to), (rows.source[chosen], *taken)


def _cells(spoken: Bool[np.ndarray, "c 9 9 9"], normal: Integer[np.ndarray, "c 9 9 9 3"]) -> Int[np.ndarray, "c 8 8 8"]:
    """Pack which corners of a cell are there and their mean normal."""
    word = np.zeros((len(spoken), SIDE, SIDE, SIDE), np.int64)
    total = np.zeros((*word.shape, 3), np.int64)
    for number, at in enumerate(CORNERS):
        corner = (slice(None), *(slice(a, a + SIDE) for a in at))
        word |= spoken[corner].astype(np.int64) << number
        total += normal[corner]
    mean = np.rint(total / 8).astype(np.int64) + 128
    for shift, component in zip((8, 16, 24), np.moveaxis(mean, -1, 0), strict=True):
        word |= component << shift
    return word.astype(np.uint32).view(np.int32)
