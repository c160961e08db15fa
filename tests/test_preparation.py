"""What is prepared of a grid: coefficients against a dense convolution, whole stencils by hand, no program anew."""

import numpy as np
import pytest
from scipy.ndimage import convolve1d

from sdfbake import Grid
from sdfbake.bricks import SIDE, Bricks
from sdfbake.lattice import Lattice
from sdfbake.metadata import Metadata
from sdfrender import GridField
from sdfrender.kernels import NAMES, kernel
from sdfrender.stencils import Blocks, stencils, width
from sdfrender.tables import INCOMPLETE

# No sample of the last brick but one, a brick of one sample, bricks that are full, the smallest lattice.
SHAPES = [(11, 18, 9), (8, 16, 24), (17, 10, 25), (2, 3, 2)]
MARGIN = 8  # samples that the lattice is continued by, on every side


def holey(rng, shape, share):
    """Noise in a lattice some bricks of which are missing; the bounds there are like no sample."""
    present = rng.uniform(size=[-(-n // SIDE) for n in shape]) >= share
    present.flat[0] = True
    bricks = Bricks.of(present, rng.uniform(5, 9, present.shape))
    values = rng.normal(size=[n * SIDE for n in present.shape]).astype(np.float32)
    for axis, n in enumerate(shape):
        np.moveaxis(values, axis, 0)[n:] = 0
    blocks = values.reshape([n for b in present.shape for n in (b, SIDE)]).transpose(0, 2, 4, 1, 3, 5)
    lattice = Lattice(np.zeros(3), 1.0, shape)
    return Grid(lattice, bricks, np.ascontiguousarray(blocks[present]), None, None, None, Metadata(source="dense"))


def continued(dense):
    """Continue an array linearly, one axis after the other."""
    for axis in range(3):
        rows = np.moveaxis(dense, axis, 0)
        step = np.arange(1, MARGIN + 1).reshape(-1, 1, 1)
        low, high = rows[0] + step[::-1] * (rows[0] - rows[1]), rows[-1] + step * (rows[-1] - rows[-2])
        dense = np.moveaxis(np.concatenate([low, rows, high]), 0, axis)
    return dense


def expected(grid, k):
    """Coefficients and whole cells, from a dense array in which every sample that is absent is NaN."""
    shape, index = grid.lattice.shape, grid.bricks.index
    samples, bounds = (np.full([n * SIDE for n in grid.bricks.slot.shape], np.nan) for _ in range(2))
    for b, block in zip(index, grid.distance, strict=True):
        samples[tuple(slice(8 * c, 8 * c + 8) for c in b)] = block
    bounds = np.where(np.isnan(samples), grid.bricks.far.repeat(8, 0).repeat(8, 1).repeat(8, 2), samples)
    inside = tuple(slice(0, n) for n in shape)
    exact, bounds = continued(samples[inside]), continued(bounds[inside])
    for axis in range(3) if k.filtered else ():
        exact = convolve1d(exact, k.prefilter, axis=axis, mode="nearest")
    made = np.where(np.isnan(exact), bounds, exact)
    size, taps = width(k), [range(k.first, k.first + k.taps)] * 3
    cells, whole = [], []
    for b in index:
        first = 8 * b + MARGIN + k.first
        # What a last brick keeps beyond one coefficient past the lattice, no cell reads.
        end = np.minimum(first + size, np.array(shape) + MARGIN + 1)
        cells.append(made[tuple(slice(*ends) for ends in zip(first, end, strict=True))])
        block = np.zeros((8, 8, 8), bool)
        for cell in np.ndindex(8, 8, 8):
            at = 8 * b + cell
            if (at < np.array(shape) - 1).all():
                block[cell] = not np.isnan(exact[np.ix_(*(at[a] + MARGIN + np.array(taps[a]) for a in range(3)))]).any()
        whole.append(block)
    return cells, np.array(whole)


@pytest.mark.parametrize("share", [0.0, 0.3])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("name", NAMES)
def test_coefficients_and_whole_cells(name, shape, share, choice, rng):
    """Sums of at most 27 products in float64, of terms of up to (5/3)^3 of the greatest value; then one rounding.

    A value continued by two voxels along three axes is up to 5^3 samples.
    """
    grid, k, xp = holey(rng, shape, share), kernel(name), choice.engine
    made = stencils(xp, grid.distance, Blocks.of(xp, grid.bricks, shape), k)
    coefficients = np.array(made.coefficients).reshape(-1, *[width(k)] * 3)
    bits = np.array(made.complete).astype(np.uint8).reshape(-1, 8, 8, 1)
    cells, whole = expected(grid, k)
    assert np.array_equal(np.unpackbits(bits, axis=-1, bitorder="little").astype(bool), whole)
    largest = max(np.abs(cell).max() for cell in cells)
    for ours, theirs in zip(coefficients, cells, strict=True):
        difference = np.abs(ours[tuple(slice(0, n) for n in theirs.shape)] - theirs)
        assert difference.max() <= xp.eps * largest + 200 * 2.0**-53 * 125 * 9


def test_tables_name_what_was_found(choice, sphere):
    """Cells with a slab are numbered in order; cells of whole stencils without a slab keep off 0."""
    grid = Grid.from_function(sphere, 40, uv_mode="none")
    field = GridField(grid, "bspline", choice)
    cells = np.array(field._tables.cells)
    number = -1 - cells[cells < 0]
    assert np.array_equal(number, np.arange(len(number)))
    assert len(np.array(field._tables.planes)) == 4 * len(number) == 4 * len(np.array(field._tables.deltas))
    brick, local = np.divmod(np.flatnonzero((cells >= 0) & ((cells & INCOMPLETE) == 0)), SIDE**3)
    place = 8 * grid.bricks.index[brick] + np.stack([local >> 6, local >> 3 & 7, local & 7], axis=1)
    # The interpolant of an exact distance is off by far less than a tenth of a voxel.
    middle = np.abs(sphere.distance(grid.lattice.to_world(place + 0.5)))
    corners = [sphere.distance(grid.lattice.to_world(place + corner)) for corner in np.ndindex(2, 2, 2)]
    clear = np.abs(np.sign(corners).sum(axis=0)) == 8
    assert (clear | (np.abs(corners).min(axis=0) < 0.1 * grid.lattice.spacing)).all() and len(middle) > 1000


def test_a_grid_without_bricks(choice):
    """A surface that is nowhere near: no hit, no failure."""
    far = np.full((2, 2, 2), 3.0)
    bricks = Bricks.of(np.zeros((2, 2, 2), bool), far)
    nothing = np.zeros((0, 8, 8, 8), np.float32)
    grid = Grid(Lattice(np.zeros(3), 1.0, (12, 12, 12)), bricks, nothing, None, None, None, Metadata(source="dense"))
    field = GridField(grid, "bspline", choice)
    assert field.jet(np.array([[5.0, 5.0, 5.0]]), 0)[0] == 3.0


@pytest.mark.parametrize("name", NAMES)
def test_another_size_is_the_same_program(name, choice, sphere):
    if choice.engine.name != "drjit":
        pytest.skip("nothing is compiled")
    import drjit as dr

    programs = []
    for n in (33, 47):
        grid = Grid.from_function(sphere, n, uv_mode="none")
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            GridField(grid, name, choice)
            history = dr.kernel_history([dr.KernelType.JIT])
        programs.append({program["hash"] for program in history})
    assert len(programs[0]) > 5 and programs[0] == programs[1]
