"""How far a ray may go at once: the side of the empty cube ahead of every cell, for each octant of directions.

In: which cells are occupied, brick by brick, and where the bricks lie. Out: one 32-bit integer per cell with a field
of four bits per octant: the side, 1 to 7, of the greatest cube of cells without surface that begins at the cell and
extends along the octant; what lies in absent bricks is empty. The bricks themselves are treated alike: a brick is a
cell of a block of 8^3 bricks.

Rows of cells along z are the bits of a word, so that sixteen cells are worked on at once.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Bool, Int, Integer, UInt8, UInt16

from sdfbake.bricks import SIDE

MOST = 7  # of a cube's side: three bits; the fourth of a field says something else
FIELD = 4  # bits
OCTANTS = 8
_CHUNK = 256  # blocks at once: 0.1 MB of words
_WINDOW = SIDE + MOST - 1  # cells along an axis that the cubes of a block's cells can reach

_REVERSED = np.packbits(np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1)[:, ::-1], axis=1).ravel()
# Bit j of a byte, as byte j of eight.
_SPREAD = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little").view("<u8").ravel()


def cell_sides(full: Bool[np.ndarray, "k 8 8 8"], slot: Integer[np.ndarray, "bx by bz"]) -> Int[np.ndarray, "k 8 8 8"]:
    """Return the packed sides of every cell; 0 in every field where the cell is full.

    Parameters
    ----------
    full
        Which cells of the blocks are full.
    slot
        Where the blocks lie: the number of the block, or -1 where there is none and everything is empty.

    Returns
    -------
    numpy.ndarray
        int32, never negative: octant o, whose bits 0, 1, 2 say that x, y, z fall, has bits 4 o to 4 o + 2.
    """
    count = len(full)
    rows = np.packbits(~full, axis=-1, bitorder="little").reshape(count, SIDE, SIDE)
    rows = np.concatenate([rows, np.full((1, SIDE, SIDE), 0xFF, np.uint8)])
    table = np.pad(np.where(slot < 0, count, slot), 1, constant_values=count)
    index = np.empty((count, 3), np.int64)
    index[slot[slot >= 0]] = np.argwhere(slot >= 0) + 1
    out = np.empty((count, SIDE, SIDE, SIDE), np.int32)

    def work(start: int) -> None:
        part = slice(start, start + _CHUNK)
        out[part] = _packed(rows, table, index[part])

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(work, range(0, count, _CHUNK)))
    return out


def brick_sides(present: Bool[np.ndarray, "bx by bz"]) -> Int[np.ndarray, "bx by bz"]:
    """Return the packed sides, in bricks, of the empty cubes ahead of every absent brick; 0 where one is present."""
    shape = np.array(present.shape)
    blocks = -(-shape // SIDE)
    padded = np.zeros(blocks * SIDE, bool)
    padded[tuple(slice(0, n) for n in shape)] = present
    x, y, z = blocks
    full = padded.reshape(x, SIDE, y, SIDE, z, SIDE).transpose(0, 2, 4, 1, 3, 5).reshape(-1, SIDE, SIDE, SIDE)
    sides = cell_sides(full, np.arange(x * y * z).reshape(x, y, z)).reshape(x, y, z, SIDE, SIDE, SIDE)
    whole: Int[np.ndarray, "X Y Z"] = sides.transpose(0, 3, 1, 4, 2, 5).reshape(padded.shape)
    return np.ascontiguousarray(whole[tuple(slice(0, n) for n in shape)])


def _packed(
    rows: UInt8[np.ndarray, "n 8 8"], table: Integer[np.ndarray, "bx by bz"], index: Int[np.ndarray, "m 3"]
) -> Int[np.ndarray, "m 8 8 8"]:
    """Pack the sides of all octants of some blocks."""
    fields = np.zeros((len(index), SIDE, SIDE, SIDE, OCTANTS // 2), np.uint8)  # two octants to a byte
    for pair in range(OCTANTS // 2):
        both = np.zeros((len(index), SIDE, SIDE), np.uint64)
        for octant in (2 * pair, 2 * pair + 1):
            falls = (octant & 1 > 0, octant & 2 > 0, octant & 4 > 0)
            digits = _digits(_window(rows, table, index, falls))
            for place, digit in enumerate(digits):
                back = digit[:, :: -1 if falls[0] else 1, :: -1 if falls[1] else 1]
                bits = _SPREAD.take(_REVERSED.take(back) if falls[2] else back)
                both |= bits << np.uint64(place + FIELD * (octant & 1))
        fields[..., pair] = both[..., None].view(np.uint8)
    return fields.view("<i4")[..., 0].astype(np.int32, copy=False)


def _window(
    rows: UInt8[np.ndarray, "n 8 8"],
    table: Integer[np.ndarray, "bx by bz"],
    index: Int[np.ndarray, "m 3"],
    falls: tuple[bool, bool, bool],
) -> UInt16[np.ndarray, "m 14 14"]:
    """Return the empty cells ahead of a block and in it, mirrored so that ahead is up along every axis."""
    out = np.empty((len(index), _WINDOW, _WINDOW), np.uint16)
    step = [-1 if fall else 1 for fall in falls]
    spans = (slice(0, SIDE), slice(SIDE, _WINDOW))
    for i, x in enumerate(spans):
        for j, y in enumerate(spans):
            words = np.zeros((len(index), SIDE, SIDE), np.uint16)
            for k in (0, 1):
                block = rows[table[index[:, 0] + i * step[0], index[:, 1] + j * step[1], index[:, 2] + k * step[2]]]
                block = _REVERSED.take(block) if falls[2] else block
                words |= block.astype(np.uint16) << np.uint16(SIDE * k)
            mirrored = words[:, :: step[0], :: step[1]]
            out[:, x, y] = mirrored[:, : x.stop - x.start, : y.stop - y.start]
    return out


def _digits(empty: UInt16[np.ndarray, "m 14 14"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the binary digits of the sides, lowest first, as rows of eight cells.

    A cube of side k is empty if the eight cubes of side k - 1 in it are.
    """
    fits, cubes = [], empty
    for side in range(1, MOST + 1):
        if side > 1:
            cubes = cubes & (cubes >> np.uint16(1))
            cubes = cubes[:, :-1] & cubes[:, 1:]
            cubes = cubes[:, :, :-1] & cubes[:, :, 1:]
        fits.append(cubes[:, :SIDE, :SIDE].astype(np.uint8))
    one, two, three, four, five, six, seven = fits
    return (one & ~two) | (three & ~four) | (five & ~six) | seven, (two & ~four) | six, four
