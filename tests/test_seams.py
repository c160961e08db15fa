"""Where charts meet."""

import numpy as np
import pytest

from datasets_synthetic import mesh
from sdfbake import BadInput, Mesh, bake
from sdfbake.bricks import in_lattice, sample_index
from sdfbake.seams import seam_cells


def sheet_of_two_charts():
    """A slab whose top and bottom are cut into two charts at x = 0; u is never 0, so that samples in reach show it."""
    box = mesh("box")
    chart = (box.vertices[box.faces].mean(axis=1)[:, 0] > 0).astype(np.int32)
    return box.with_(uv=np.full((len(box.faces), 3, 2), 0.5), chart=chart)


@pytest.mark.parametrize("mode", ["faces", "grid"])
def test_cells_whose_samples_name_several_charts(mode):
    grid = bake(sheet_of_two_charts(), 24, uv_mode=mode)
    every = bake(sheet_of_two_charts(), 24, uv_mode="faces")
    # The oracle looks every sample up in a dense array.
    dense = np.full(tuple(8 * n for n in grid.bricks.slot.shape), -1)
    at = sample_index(grid.bricks.index)
    dense[tuple(at.reshape(-1, 3).T)] = np.append(every.surface.chart, -1)[every.face].reshape(-1)
    inside = in_lattice(grid.bricks.index, grid.lattice.shape)
    found, expected = seam_cells(grid), np.zeros(at.shape[:4], bool)
    padded = np.pad(dense, (0, 1), constant_values=-1)
    for slot, i, j, k in np.argwhere(inside):
        x, y, z = at[slot, i, j, k]
        seen = {*padded[x : x + 2, y : y + 2, z : z + 2].reshape(-1)} - {-1}
        expected[slot, i, j, k] = len(seen) > 1
    assert expected.any() and not expected.all()
    np.testing.assert_array_equal(found[inside], expected[inside])


def test_a_grid_without_texture_coordinates_is_refused():
    box: Mesh = mesh("box")
    with pytest.raises(BadInput, match="--uv-mode faces"):
        seam_cells(bake(box, 16, uv_mode="none"))
