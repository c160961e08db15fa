"""Plain blocks: read back by nothing but their description, and never worse than they say."""

import json
from dataclasses import replace

import numpy as np
import pytest
from exported import pile

from sdfbake import BadInput, Grid
from sdfbake.export import export
from sdfbake.export.packing import packed
from sdfbake.export.texture import textured


@pytest.fixture(scope="module")
def grid():
    return pile()


def read(path):
    """Read all arrays as the description says."""
    record = json.loads(path.read_text())
    data = (path.parent / record["data"]).read_bytes()
    arrays, end = {}, 0
    for entry in record["arrays"]:
        kind = np.dtype(entry["dtype"]).newbyteorder("<")
        assert entry["offset"] % 256 == 0 and end <= entry["offset"] < end + 256
        end = entry["offset"] + entry["bytes"]
        assert entry["bytes"] == kind.itemsize * np.prod(entry["shape"])
        arrays[entry["name"]] = np.frombuffer(data[entry["offset"] : end], kind).reshape(entry["shape"])
    assert len(data) == -(-end // 256) * 256
    return record, arrays


@pytest.mark.parametrize("precision", [16, 32])
def test_read_by_the_description(grid, precision, tmp_path):
    done = export(grid, tmp_path / "a.json", "raw", precision=precision)
    assert [file.name for file in done.files] == ["a.json", "a.bin"]
    record, arrays = read(tmp_path / "a.json")
    whole, lattice = textured(grid), grid.lattice
    assert record["lattice"]["shape"] == list(lattice.shape) and record["lattice"]["spacing"] == lattice.spacing
    np.testing.assert_array_equal(record["lattice"]["origin"], lattice.origin)
    for name, expected in {
        "slot": grid.bricks.slot,
        "index": grid.bricks.index,
        "chart": whole.chart,
        "seam": whole.seam,
        "part": grid.part,
    }.items():
        np.testing.assert_array_equal(arrays[name], expected, err_msg=name)
    known = whole.chart >= 0
    found = arrays["uv"][known] * record["uv_scale"] + record["uv_offset"]
    # Half a step of 65535 over the range of either coordinate; the stored float32 where there are 32 bits.
    step = np.ptp(whole.uv[known], axis=0) / 65535 if precision == 16 else 0
    assert (np.abs(found - whole.uv[known]) <= 0.5 * step + 1e-12).all()
    assert not arrays["uv"][~known].any()


def test_32_bits_are_the_stored_ones(grid, tmp_path):
    export(grid, tmp_path / "a.json", "raw", precision=32)
    record, arrays = read(tmp_path / "a.json")
    assert record["distance_unit"] == "world" and record["distance_scale"] == 1
    np.testing.assert_array_equal(arrays["distance"], grid.distance)
    np.testing.assert_array_equal(arrays["far"], grid.bricks.far)
    assert record["greatest_rounding_error_in_voxels"] == 0


def test_16_bits_are_voxels_and_say_what_they_cost(grid, tmp_path):
    export(grid, tmp_path / "a.json", "raw")
    record, arrays = read(tmp_path / "a.json")
    assert record["distance_unit"] == "voxel" and record["distance_scale"] == grid.lattice.spacing
    voxels = grid.distance.astype(np.float64) / grid.lattice.spacing
    off = np.abs(arrays["distance"] - voxels)
    assert record["greatest_rounding_error_in_voxels"] == off.max()
    near = np.abs(voxels) <= 3**0.5
    assert record["greatest_rounding_error_near_the_surface_in_voxels"] == off[near].max()
    # 11 bits: below 2 voxels the steps are 2^-10, and rounding takes half of one; bricks reach 5.7 voxels and a
    # diagonal of theirs, 12.1, less than 32: steps of 2^-6 at most.
    assert 0 < off[near].max() <= 2.0**-11 and off.max() <= 2.0**-7
    assert not np.signbit(arrays["distance"][grid.distance > 0]).any()


def test_bounds_in_16_bits_are_bounds(grid):
    far = packed(grid).arrays["far"].astype(np.float64) * grid.lattice.spacing
    absent = grid.bricks.slot < 0
    assert absent.any()
    assert (np.abs(far) <= np.abs(grid.bricks.far)).all()
    np.testing.assert_allclose(far[absent], grid.bricks.far[absent], rtol=2.0**-10)  # down by a step of 11 bits
    np.testing.assert_array_equal(np.sign(far), np.sign(grid.bricks.far))


def test_huge_bounds_stay_finite():
    grid = pile(24)
    huge = replace(grid, bricks=replace(grid.bricks, far=grid.bricks.far * np.float32(1e6)))
    assert np.isfinite(packed(huge).arrays["far"]).all()


def test_nothing_that_is_not_there(sphere):
    made = packed(Grid.from_function(sphere, 24, uv_mode="none"))
    assert list(made.arrays) == ["slot", "far", "index", "distance"] and made.uv_offset is None


def test_numbers_beyond_float16_are_refused():
    grid = Grid.from_dense(np.linspace(-1e5, 1e5, 64, dtype=np.float32).reshape(4, 4, 4))
    with pytest.raises(BadInput, match="65504 voxels.*precision 32"):
        packed(grid)
    assert packed(grid, 32).arrays["distance"].dtype == np.float32


def test_other_precisions_are_refused(grid, tmp_path):
    with pytest.raises(BadInput, match="give 16 or 32"):
        export(grid, tmp_path / "a.json", "raw", precision=8)
    assert not list(tmp_path.iterdir())
