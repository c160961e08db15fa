"""How far a ray may go at once: the side of the empty cube ahead of every cell, for each octant of directions.

In: which cells are occupied, brick by brick, and where the bricks lie. Out: one 32-bit integer per cell with a field
of four bits per octant: the side, 1 to 7, of the greatest cube of cells without surface that begins at the cell and
extends along the octant; what lies in absent bricks is empty. The bricks themselves are treated alike: a brick is a
cell of a block of 8^3 bricks.

Rows of cells along z are the bits of a word, so that all of a block's row, and what its cubes reach, are worked on at
once.
"""

from collections.abc import Sequence
from functools import partial, reduce

import numpy as np
from jaxtyping import Bool, Int

from sdfbake.bricks import SIDE
from sdfbake.engine import Array, Engine
from sdfrender.stencils import AROUND, around, brick_row

MOST = 7  # of a cube's side: three bits; the fourth of a field says something else
FIELD = 4  # bits
OCTANTS = 8
_REACH = MOST - 1  # cells beyond a block's own that its cubes reach
_WINDOW = SIDE + 2 * _REACH
_OWN = (1 << SIDE) - 1
_CHUNK = 1 << 13  # blocks at once: 13 MB for the cubes of each side


def cell_sides(xp: Engine, empty: Array, slot: Array, count: int) -> Array:
    """Return the packed sides of every cell; 0 in every field where the cell is full.

    Parameters
    ----------
    xp
        The engine.
    empty
        64 bytes per block, one for each row of cells, one bit for each cell that is empty.
    slot
        27 numbers per block: the block around it, negative where there is none and everything is empty.
    count
        Blocks.

    Returns
    -------
    Array
        512 integers per block, never negative: octant o, whose bits 0, 1, 2 say that x, y, z fall, has bits 4 o to
        4 o + 2.
    """
    return xp.joined(
        [_some_sides(xp, empty, slot, start, min(_CHUNK, count - start)) for start in range(0, count, _CHUNK)]
    )


def _some_sides(xp: Engine, empty: Array, slot: Array, start: int, count: int) -> Array:
    """Return the packed sides of the cells of some blocks that follow each other."""
    first = xp.uniform(start)
    cubes = list(
        xp.tabulated(count * _WINDOW**2, lambda lane: ((_window_row(xp, empty, slot, lane + first * _WINDOW**2),),))
    )
    while len(cubes) < MOST:
        cubes += xp.tabulated(count * _WINDOW**2, partial(_grown, xp, cubes[-1]))
    digits = xp.tabulated(count * SIDE**2 * 4, lambda lane: _digits(xp, cubes, lane))

    def packed(lane: Array) -> tuple[tuple[Array, ...]]:
        block, x, y = brick_row(lane)
        sides = [xp.full(lane, 0) for _ in range(SIDE)]
        for octant in range(OCTANTS):
            at = ((((block << 2) | (octant & 3)) << 3 | x) << 3) | y
            word = xp.gather(digits[octant >> 2], at, True)
            for z in range(SIDE):
                low, middle, high = ((word >> (SIDE * digit + z)) & 1 for digit in range(3))
                sides[z] = sides[z] | ((low | (middle << 1) | (high << 2)) << (FIELD * octant))
        return (tuple(sides),)

    (sides,) = xp.tabulated(count * SIDE**2, packed)
    return sides


def _window_row(xp: Engine, empty: Array, slot: Array, lane: Array) -> Array:
    """Return a row of the empty cells in a block and around it, as far as its cubes reach: the first cell in bit 0."""
    brick = lane // _WINDOW**2
    x = lane // _WINDOW - brick * _WINDOW
    y = lane - (brick * _WINDOW + x) * _WINDOW - _REACH
    x = x - _REACH
    column = brick * AROUND + ((x >> 3) + 1) * 9 + ((y >> 3) + 1) * 3
    row = ((x & 7) << 3) | (y & 7)
    parts = []
    for z in range(3):
        block = xp.gather(slot, column + z, True)
        parts.append(xp.where(block >= 0, xp.gather(empty, (block << 6) | row, block >= 0), _OWN))
    below, here, above = parts
    return (below >> (SIDE - _REACH)) | (here << _REACH) | ((above & ((1 << _REACH) - 1)) << (_REACH + SIDE))


def _grown(xp: Engine, cubes: Array, lane: Array) -> tuple[tuple[Array]]:
    """Return the cells of a window's row at which empty cubes begin whose side is greater by one: eight are in each.

    At the window's far ends the next row is any: no cube that begins or ends in the block reaches it.
    """
    rows = [xp.gather(cubes, lane + step, True) for step in (1, _WINDOW, _WINDOW + 1)]
    both = reduce(lambda a, b: a & b, rows, xp.gather(cubes, lane, True))
    return ((both & (both >> 1),),)


def _digits(xp: Engine, cubes: Sequence[Array], lane: Array) -> tuple[tuple[Array], tuple[Array]]:
    """Return the binary digits of the sides of a row, eight bits each, lowest first: where z rises, and where it falls.

    The lane is the block, whether x and y fall, and the row. A side is how many of the cubes of growing side that end
    in the cell, or begin there, are empty.
    """
    block, quarter = lane >> 8, (lane >> 6) & 3
    _, x, y = brick_row(lane)
    row = (block * _WINDOW + (x + _REACH)) * _WINDOW + (y + _REACH)
    back = (quarter & 1) * _WINDOW + (quarter >> 1)
    none = xp.full(lane, 0)
    up = down = (none, none, none)
    for more, level in enumerate(cubes):
        begin = xp.gather(level, row - back * more, True) >> (_REACH - more)
        up, down = _counted(up, begin >> more), _counted(down, begin)
    return (_bytes(up),), (_bytes(down),)


def _counted(digits: tuple[Array, Array, Array], bits: Array) -> tuple[Array, Array, Array]:
    """Add one to the binary numbers of the cells whose bit is set."""
    low, middle, high = digits
    carry = low & bits
    return low ^ bits, middle ^ carry, high ^ (middle & carry)


def _bytes(digits: tuple[Array, Array, Array]) -> Array:
    low, middle, high = (digit & _OWN for digit in digits)
    return low | (middle << SIDE) | (high << (2 * SIDE))


def brick_sides(xp: Engine, present: Bool[np.ndarray, "bx by bz"]) -> Int[np.ndarray, "bx by bz"]:
    """Return the packed sides, in bricks, of the empty cubes ahead of every absent brick; 0 where one is present."""
    shape = np.array(present.shape)
    blocks = -(-shape // SIDE)
    padded = np.zeros(blocks * SIDE, bool)
    padded[tuple(slice(0, n) for n in shape)] = present
    x, y, z = blocks
    full = padded.reshape(x, SIDE, y, SIDE, z, SIDE).transpose(0, 2, 4, 1, 3, 5)
    empty = xp.table(np.packbits(~full, axis=-1, bitorder="little").astype(np.int32))
    index = np.argwhere(np.ones(blocks, bool)).astype(np.int32)
    slot = xp.table(around(np.arange(x * y * z).reshape(x, y, z), index, -1))
    sides = np.array(cell_sides(xp, empty, slot, len(index))).reshape(x, y, z, SIDE, SIDE, SIDE)
    whole: Int[np.ndarray, "X Y Z"] = sides.transpose(0, 3, 1, 4, 2, 5).reshape(padded.shape)
    return np.ascontiguousarray(whole[tuple(slice(0, n) for n in shape)])
