"""Empty cubes ahead: against growing every cube by hand."""

import numpy as np
import pytest
from conftest import ENGINES

from sdfbake.engine import choose
from sdfrender import skips
from sdfrender.skips import FIELD, MOST, OCTANTS, brick_sides, cell_sides
from sdfrender.stencils import around


def largest_cubes(full, octant):
    """Grow every cube cell by cell; what lies outside is empty."""
    flipped = [axis for axis in range(3) if octant >> axis & 1]
    seen = np.pad(np.flip(full, flipped), [(0, MOST)] * 3)
    sides = np.zeros(full.shape, int)
    for cell in np.ndindex(*full.shape):
        while sides[cell] < MOST and not seen[tuple(slice(c, c + sides[cell] + 1) for c in cell)].any():
            sides[cell] += 1
    return np.flip(sides, flipped)


def sides_of(xp, full, slot):
    """The packed sides of cells given block by block."""
    rows = xp.table(np.packbits(~full, axis=-1, bitorder="little").astype(np.int32))
    near = xp.table(around(slot, np.argwhere(slot >= 0), -1))
    return np.array(cell_sides(xp, rows, near, len(full))).reshape(full.shape)


@pytest.mark.parametrize("density", [0.0, 0.004, 0.1, 1.0])
def test_cells(density, rng, monkeypatch):
    """Bricks, a third of them absent, in every octant; in each brick every cell; on every engine."""
    present = rng.uniform(size=(2, 1, 3)) < 0.7
    present[0, 0, 0] = True
    slot = np.full(present.shape, -1)
    slot[present] = np.arange(present.sum())
    full = rng.uniform(size=(present.sum(), 8, 8, 8)) < density
    dense = np.zeros(np.array(present.shape) * 8, bool)
    spans = {slot[b]: tuple(slice(8 * c, 8 * c + 8) for c in b) for b in np.ndindex(*present.shape) if present[b]}
    for number, span in spans.items():
        dense[span] = full[number]
    expected = [largest_cubes(dense, octant) for octant in range(OCTANTS)]
    monkeypatch.setattr(skips, "_CHUNK", 3)  # of up to six blocks
    for engine in ENGINES:
        packed = sides_of(choose(*engine).engine, full, slot)
        assert packed.dtype == np.int32 and (packed >= 0).all()
        for octant in range(OCTANTS):
            for number, span in spans.items():
                np.testing.assert_array_equal(packed[number] >> (FIELD * octant) & 15, expected[octant][span])


@pytest.mark.parametrize("shape", [(1, 1, 1), (9, 3, 8), (11, 5, 2)])
def test_bricks(shape, rng):
    present = rng.uniform(size=shape) < 0.03
    expected = [largest_cubes(present, octant) for octant in range(OCTANTS)]
    for engine in ENGINES:
        packed = brick_sides(choose(*engine).engine, present)
        for octant in range(OCTANTS):
            np.testing.assert_array_equal(packed >> (FIELD * octant) & 15, expected[octant])
