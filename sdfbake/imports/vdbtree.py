"""The tree of an OpenVDB grid: root, 32^3, 16^3, leaves of 8^3.

In: a cursor at the tree. Out: `Tree`: leaves, and tiles that are not background. A tree is written twice over: first
the topology of all nodes, depth first, then the values of the leaves in the same order.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from sdfbake.bricks import SIDE
from sdfbake.imports.field import corrupt
from sdfbake.imports.vdbstream import Coding, Cursor

TYPES = {"Tree_float_5_4_3": "<f4", "Tree_double_5_4_3": "<f8"}
_LEAF = SIDE**3
_UPPER, _LOWER = 5, 4  # log2 of children along an axis of the nodes between root and leaves
_SIZE = {_UPPER: 128, _LOWER: SIDE}  # samples along an axis of their children
_SPAN = 128 << _UPPER  # samples along an axis of the root's children
_REACH = 1 << 28  # farthest sample that is believed


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """What a grid stores; everything else has the value of the background.

    Attributes
    ----------
    background
        World units.
    origin
        First sample of every leaf.
    values
        Of the leaves' samples [x, y, z].
    active
        The samples that the grid calls active, a bit for each as in the file.
    tile_origin, tile_side, tile_value, tile_active
        Cubes of one value that is not the background, or that is active.
    """

    background: float
    origin: Int[np.ndarray, "k 3"]
    values: Float[np.ndarray, "k 8 8 8"]
    active: UInt8[np.ndarray, "k 64"]
    tile_origin: Int[np.ndarray, "t 3"]
    tile_side: Int[np.ndarray, " t"]
    tile_value: Float[np.ndarray, " t"]
    tile_active: Bool[np.ndarray, " t"]


def read_tree(cursor: Cursor, kind: str, compression: int, *, half: bool) -> Tree:
    """Read the tree of a grid.

    Parameters
    ----------
    cursor
        At the tree's first byte.
    kind
        A key of `TYPES`.
    compression
        Flags of the grid.
    half
        Whether values are stored in 16 bits.

    Raises
    ------
    BadInput
        If the bytes contradict themselves or end early.
    """
    if cursor.number("I") != 1:
        raise corrupt(cursor.name, "its tree has not one buffer")
    type_ = np.dtype(TYPES[kind])
    background = float(np.frombuffer(cursor.take(type_.itemsize), type_)[0])
    coding = Coding(compression, type_, np.dtype("<f2") if half else type_, background)
    tiles, children = cursor.numbers("II")
    found = _Found([], [], [])
    for _ in range(tiles):
        *corner, value, active = cursor.numbers("3i" + type_.char + "?")
        found.add_tiles(np.array([corner]), _SPAN, np.array([value]), np.array([active]), background)
    for _ in range(children):
        origin = np.array(cursor.numbers("3i"), np.int64)
        if np.abs(origin).max() > _REACH:
            raise corrupt(cursor.name, f"a node lies at {origin.tolist()}")
        _upper(cursor, coding, origin, found)
    return _with_values(cursor, coding, found)


@dataclass(frozen=True, slots=True)
class _Found:
    """What the topology has shown so far: leaves' origins and masks, tiles."""

    origins: list[np.ndarray]
    masks: list[np.ndarray]
    tiles: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]

    def add_tiles(
        self, origin: np.ndarray, side: int, value: np.ndarray, active: np.ndarray, background: float
    ) -> None:
        kept = (value != background) | active
        if kept.any():
            sides = np.full(np.count_nonzero(kept), side)
            self.tiles.append((origin[kept], sides, value[kept], active[kept]))


def _upper(cursor: Cursor, coding: Coding, origin: np.ndarray, found: _Found) -> None:
    """Read the topology of a node of 32^3 and of all below it."""
    for child in _node(cursor, coding, origin, _UPPER, found):
        leaves = _node(cursor, coding, child, _LOWER, found)
        found.origins.append(leaves)
        found.masks.append(np.frombuffer(cursor.take(len(leaves) * _LEAF // 8), np.uint8).reshape(-1, _LEAF // 8))


def _node(cursor: Cursor, coding: Coding, origin: np.ndarray, log2: int, found: _Found) -> Int[np.ndarray, "n 3"]:
    """Read masks and tiles of a node between root and leaves; return the origins of its children."""
    count = 1 << 3 * log2
    child, active = cursor.mask(count), cursor.mask(count)
    values = coding.run(cursor, active)
    side = 1 << log2
    corner = origin + _SIZE[log2] * np.stack(np.unravel_index(np.arange(count), (side, side, side)), axis=-1)
    tile = ~child
    found.add_tiles(corner[tile], _SIZE[log2], values[tile], active[tile], coding.background)
    inner: Int[np.ndarray, "n 3"] = corner[child]
    return inner


def _with_values(cursor: Cursor, coding: Coding, found: _Found) -> Tree:
    """Read the leaves' values, which follow the topology."""
    origin = np.concatenate([np.empty((0, 3), np.int64), *found.origins])
    masks = np.concatenate([np.empty((0, _LEAF // 8), np.uint8), *found.masks])
    # A leaf takes at least its mask and a byte: more leaves than that are a lie, and are not allocated.
    if len(origin) * (_LEAF // 8 + 1) > len(cursor.data) - cursor.at:
        raise corrupt(cursor.name, f"it says {len(origin)} leaves and is too short for them")
    values = np.empty((len(origin), _LEAF), coding.kind.newbyteorder("="))
    for leaf in range(len(origin)):
        values[leaf] = coding.run(cursor, cursor.mask(_LEAF))
    none = (np.empty((0, 3), np.int64), np.empty(0, np.int64), np.empty(0, coding.kind), np.empty(0, bool))
    tiles = [np.concatenate(columns) for columns in zip(none, *found.tiles, strict=True)]
    return Tree(coding.background, origin, values.reshape(-1, SIDE, SIDE, SIDE), masks, *tiles)
