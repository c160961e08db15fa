"""A sparse channel as a tree of OpenVDB.

In: values of bricks and which of them are active. Out: the bytes of a 5-4-3 tree (nodes of 32^3, 16^3 and 8^3: a leaf
is a brick), values in active voxels only. What is inactive is the background, or minus the background inside.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Shaped, UInt8

from sdfbake.bricks import SIDE

_LEAF_BITS, _LOW_BITS, _HIGH_BITS = 3, 4, 5  # of the place of a voxel, leaf and lower node in their parent
_LOW, _HIGH = 1 << _LOW_BITS, 1 << _HIGH_BITS
# How a node says what its inactive values are (the format's codes).
_BACKGROUND, _EITHER = 0, 3
Place = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """Values of some bricks.

    Attributes
    ----------
    index
        Brick coordinates, int32: the leaf's first voxel is 8 times that.
    values
        Per sample a number, two, or a bool; read where it is active. Two are stored with a third, which is 0: the
        format has no type for two that every reader knows.
    active
        Which samples have a value.
    background
        Of all other samples: a scalar of the values' type.
    minus
        Which samples have minus the background instead; None for none. Read where a sample is not active.
    tiles
        Which bricks (bx, by, bz) without a leaf are minus the background all over; None for none.
    """

    index: Int[np.ndarray, "k 3"]
    values: Shaped[np.ndarray, "k 8 8 8 *width"]
    active: Bool[np.ndarray, "k 8 8 8"]
    background: np.generic
    minus: Bool[np.ndarray, "k 8 8 8"] | None = None
    tiles: Bool[np.ndarray, "bx by bz"] | None = None

    def kept(self) -> Int[np.ndarray, " m"]:
        """Return the bricks that need a leaf, in the order in which the tree lists its leaves."""
        flat = self.active.reshape(-1, SIDE**3)
        needed = flat.any(axis=1)
        if self.minus is not None:
            signs = self.minus.reshape(flat.shape)
            needed |= signs.any(axis=1) & ~signs.all(axis=1)
        chosen = np.flatnonzero(needed)
        return chosen[np.argsort(_place(self.index[chosen]), kind="stable")]

    def empty(self, kept: Int[np.ndarray, " m"]) -> Bool[np.ndarray, "bx by bz"] | None:
        """Return `tiles`, with the bricks that came without need of a leaf."""
        if self.tiles is None or self.minus is None:
            return self.tiles
        tiles = self.tiles.copy()
        tiles[tuple(self.index.T)] = self.minus[:, 0, 0, 0]
        tiles[tuple(self.index[kept].T)] = False
        return tiles


class Tree(NamedTuple):
    """A tree as a file has it.

    Attributes
    ----------
    topology, buffers
        The nodes, and the values of the leaves.
    voxels
        How many are active.
    box
        The first and the last of these along every axis; None where there are none.
    """

    topology: bytes
    buffers: bytes
    voxels: int
    box: tuple[Place, Place] | None

    @staticmethod
    def of(channel: Channel) -> "Tree":
        """Assemble the bytes."""
        kept = channel.kept()
        index, active = channel.index[kept], channel.active[kept]
        masks = np.packbits(active.reshape(-1, SIDE**3), axis=1, bitorder="little")
        topology = b"".join(_topology(channel, index, channel.empty(kept), masks))
        if channel.values.dtype == bool:
            buffers = _bits(index, masks, channel.values[kept] & active)
        else:
            minus = None if channel.minus is None else channel.minus[kept]
            buffers = _buffers(masks, active, minus, _taken(channel.values, kept, active))
        return Tree(topology, buffers, int(np.bitwise_count(masks).sum()), _box(index, masks))


def _box(index: Int[np.ndarray, "m 3"], masks: UInt8[np.ndarray, "m 64"]) -> tuple[Place, Place] | None:
    """Return the first and the last active voxel along every axis."""
    if not masks.any():
        return None
    rows = masks.reshape(-1, SIDE, SIDE)  # a byte is a row along z
    either = np.bitwise_or.reduce
    seen = (either(rows, axis=2) > 0, either(rows, axis=1) > 0,
            np.unpackbits(either(masks, axis=1)[:, None], axis=1, bitorder="little") > 0)  # fmt: skip
    places = []
    for axis, layers in enumerate(seen):
        leaf, layer = np.nonzero(layers)
        places.append(index[leaf, axis] * SIDE + layer)
    (x, y, z), (end_x, end_y, end_z) = ([int(of(at)) for at in places] for of in (np.min, np.max))
    return (x, y, z), (end_x, end_y, end_z)


def _taken(
    values: Shaped[np.ndarray, "k 8 8 8 *width"], kept: Int[np.ndarray, " m"], active: Bool[np.ndarray, "m 8 8 8"]
) -> Shaped[np.ndarray, " n *stored"]:
    """Return the active values of some bricks; of two numbers three, the last of them 0."""
    at = np.flatnonzero(active)
    taken = values.reshape(-1, *values.shape[4:]).take(kept[at // SIDE**3] * SIDE**3 + at % SIDE**3, axis=0)
    return np.pad(taken, ((0, 0), (0, 1))) if taken.shape[1:] == (2,) else taken


def _place(index: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, " m"]:
    """Return numbers that ascend as the tree lists leaves: by node and place in the node, x slowest."""
    place = np.zeros(len(index), np.int64)
    for shift, bits in ((_LOW_BITS + _HIGH_BITS, 8), (_LOW_BITS, _HIGH_BITS), (0, _LOW_BITS)):
        for axis in range(3):
            digit = (index[:, axis].astype(np.int64) >> shift) & ((1 << bits) - 1)
            place = (place << bits) | digit
    return place


def _topology(
    channel: Channel,
    index: Int[np.ndarray, "m 3"],
    tiles: Bool[np.ndarray, "bx by bz"] | None,
    masks: UInt8[np.ndarray, "m 64"],
) -> Iterator[bytes]:
    """Yield the nodes from the root down, each before its children."""
    size = np.maximum(index.max(axis=0, initial=0) + 1, 1 if tiles is None else tiles.shape)
    present = np.zeros(size, bool)
    present[tuple(index.T)] = True
    leaf, inside = _blocks(present, _LOW), _blocks(np.zeros_like(present) if tiles is None else tiles, _LOW)
    low, low_inside = (_blocks(table, _HIGH) for table in _above(leaf, inside))
    high = (low | low_inside).any(axis=(3, 4, 5))
    yield struct.pack("<I", 1) + _stored(channel)  # one buffer; the root's background
    yield struct.pack("<II", 0, np.count_nonzero(high))  # no tiles, children
    first = 0
    for root in np.argwhere(high):
        yield struct.pack("<3i", *(root * (_HIGH * _LOW * SIDE)))
        children = low[tuple(root)]
        yield _node(children, low_inside[tuple(root)])
        for child in np.argwhere(children) + root * _HIGH:
            leaves = leaf[tuple(child)]
            yield _node(leaves, inside[tuple(child)])
            end = first + int(np.count_nonzero(leaves))
            yield masks[first:end].tobytes()
            first = end


def _stored(channel: Channel) -> bytes:
    """Return the background as bytes: as many numbers as a value has."""
    count = 1 if channel.values.ndim == 4 else 3
    return np.full(count, channel.background, channel.values.dtype).tobytes()


def _blocks(table: Bool[np.ndarray, "x y z"], side: int) -> Bool[np.ndarray, "bx by bz s s s"]:
    """Return a table as cubes of that side, extended where it ends within one."""
    whole = np.pad(table, [(0, -n % side) for n in table.shape])
    x, y, z = (n // side for n in whole.shape)
    cubes: Bool[np.ndarray, "bx by bz s s s"] = whole.reshape(x, side, y, side, z, side).transpose(0, 2, 4, 1, 3, 5)
    return cubes


def _above(
    child: Bool[np.ndarray, "bx by bz s s s"], inside: Bool[np.ndarray, "bx by bz s s s"]
) -> tuple[Bool[np.ndarray, "bx by bz"], Bool[np.ndarray, "bx by bz"]]:
    """Return which cubes of a table need a node, and which others are inside all over."""
    within = (3, 4, 5)
    some, whole = (np.asarray(of(axis=within)) for of in (inside.any, inside.all))
    node = np.asarray(child.any(axis=within)) | (some & ~whole)
    return node, whole & ~node


def _node(child: Bool[np.ndarray, "s s s"], inside: Bool[np.ndarray, "s s s"]) -> bytes:
    """Return an inner node: its children, no active tile, and what the other tiles are."""
    masks = _packed(child) + bytes(child.size // 8)
    if not inside.any():
        return masks + bytes([_BACKGROUND])
    return masks + bytes([_EITHER]) + _packed(~inside)


def _packed(mask: Bool[np.ndarray, "..."]) -> bytes:
    """Return a mask as bits, C order, the lowest first."""
    return np.packbits(mask.reshape(-1), bitorder="little").tobytes()


def _bits(index: Int[np.ndarray, "m 3"], masks: UInt8[np.ndarray, "m 64"], on: Bool[np.ndarray, "m 8 8 8"]) -> bytes:
    """Return the leaves of a tree of bools: what is active, the first voxel, the values."""
    origin = np.ascontiguousarray(index * SIDE, "<i4").view(np.uint8)
    values = np.packbits(on.reshape(len(on), SIDE**3), axis=1, bitorder="little")
    return np.concatenate([masks, origin, values], axis=1).tobytes()


def _buffers(
    masks: UInt8[np.ndarray, "m 64"],
    active: Bool[np.ndarray, "m 8 8 8"],
    minus: Bool[np.ndarray, "m 8 8 8"] | None,
    values: Shaped[np.ndarray, " n *width"],
) -> bytes:
    """Return the leaves of other trees: what is active, which background is where, and the active values."""
    count = len(masks)
    code, either = np.full((count, 1), _BACKGROUND, np.uint8), np.zeros((count, 64), np.uint8)
    if minus is not None:
        some = (minus & ~active).reshape(count, SIDE**3).any(axis=1)
        code[some] = _EITHER
        either = np.packbits(~minus.reshape(count, SIDE**3), axis=1, bitorder="little")
    heads = np.concatenate([masks, code, either], axis=1)
    used = np.ones(heads.shape, bool)
    used[code[:, 0] != _EITHER, -64:] = False
    size = values.dtype.itemsize * (1 if values.ndim == 1 else 3)
    lengths = np.stack([used.sum(axis=1), np.bitwise_count(masks).sum(axis=1, dtype=np.int64) * size], axis=1)
    in_head = np.repeat(np.tile([True, False], count), lengths.reshape(-1))
    whole = np.empty(len(in_head), np.uint8)
    whole[in_head] = heads[used]
    whole[~in_head] = np.frombuffer(np.ascontiguousarray(values).tobytes(), np.uint8)
    return whole.tobytes()
