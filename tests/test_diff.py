"""Differences between grids that were put there on purpose."""

import json
from dataclasses import replace

import numpy as np
import pytest
from test_bake_commands import run
from test_grid import Ball

from sdfbake import BadInput, Grid, Lattice
from sdfbake.bricks import Bricks, in_lattice
from sdfbake.compare import compare
from sdfbake.faces import NONE, FaceTable
from sdfbake.lattice import BAND
from sdfbake.metadata import Metadata


@pytest.fixture(scope="module")
def grid():
    return Grid.from_function(Ball(), 41)


def near(grid):
    inside = in_lattice(grid.bricks.index, grid.lattice.shape)
    return inside & (np.abs(grid.distance) <= BAND * grid.lattice.spacing)


def changed(grid, name, value, where):
    channel = getattr(grid, name).copy()
    channel[where] = value
    return replace(grid, **{name: channel})


def test_a_grid_is_itself(grid, tmp_path):
    grid.save(tmp_path / "a.zarr.zip")
    found = compare(grid, Grid.load(tmp_path / "a.zarr.zip"))
    assert found.within(0) and found.metadata == {} and found.tables == ()
    assert (found.common_bricks, found.only_a, found.only_b) == (len(grid.bricks), 0, 0)
    assert set(found.channels) == {"distance", "uv", "chart", "part"}
    assert all(channel.samples == np.count_nonzero(near(grid)) for channel in found.channels.values())


def test_distances_and_signs(grid):
    h = grid.lattice.spacing
    first, second = np.argwhere(near(grid) & (np.abs(grid.distance) < 0.2 * h))[:2]
    moved = grid.distance.copy()
    moved[tuple(first)] *= -1
    moved[tuple(second)] += np.float32(0.5 * h)
    found = compare(grid, replace(grid, distance=moved)).channels["distance"]
    apart = np.abs(moved.astype(np.float64) - grid.distance)[near(grid)] / h
    assert found.differ == found.anywhere == 2
    assert found.max == apart.max() == pytest.approx(0.5, rel=1e-5)
    assert found.rms == pytest.approx(np.sqrt((apart**2).mean()), rel=1e-12)
    flips = [moved[tuple(at)] * grid.distance[tuple(at)] < 0 for at in (first, second)]
    assert found.signs == sum(flips) >= 1
    assert found.share == 2 / found.samples


@pytest.mark.parametrize(("tolerance", "same"), [(0, False), (0.2, False), (0.3, True)])
def test_tolerance(grid, tolerance, same):
    at = tuple(np.argwhere(near(grid))[0])
    moved = changed(grid, "distance", grid.distance[at] * (1 - 0.25 * grid.lattice.spacing / grid.distance[at]), at)
    assert compare(grid, moved).within(tolerance) is same


def test_far_samples_count_as_bits_only(grid):
    far = in_lattice(grid.bricks.index, grid.lattice.shape) & (np.abs(grid.distance) > 8 * grid.lattice.spacing)
    found = compare(grid, replace(grid, distance=np.where(far, grid.distance / 2, grid.distance)))
    channel = found.channels["distance"]
    assert channel.differ == 0 and channel.max == 0 and channel.anywhere == np.count_nonzero(far) > 0
    assert not found.within(0) and found.within(1e-9)


def test_texture_coordinates(grid):
    at = tuple(np.argwhere(near(grid))[7])
    found = compare(grid, changed(grid, "uv", grid.uv[at] + np.float32([0, -0.25]), at))
    assert found.channels["uv"].differ == 1
    assert found.channels["uv"].max == pytest.approx(0.25, abs=1e-6)  # float32 of numbers below 2
    assert not found.within(0.2) and found.within(0.3)


@pytest.mark.parametrize("name", ["chart", "part"])
def test_ids_must_agree(grid, name):
    where = tuple(np.argwhere(near(grid))[:3].T)
    found = compare(grid, changed(grid, name, 2, where))
    channel = found.channels[name]
    assert (channel.differ, channel.max, channel.rms, channel.signs) == (3, None, None, None)
    assert channel.share == 3 / channel.samples
    assert not found.within(100)


def test_channel_of_one_only_is_named(grid):
    bare = replace(grid, uv=None)
    found = compare(grid, bare)
    assert found.channels_only_a == ("uv",) and found.channels_only_b == () and not found.within(1)
    assert compare(bare, grid).channels_only_b == ("uv",)


@pytest.mark.parametrize(("band", "unmatched"), [(True, 1), (False, 0)], ids=["in the band", "beyond"])
def test_brick_of_one_only(grid, band, unmatched):
    if not band:  # a brick without samples of the band, which a bake would not have kept
        grid = changed(grid, "distance", np.float32(9 * grid.lattice.spacing), 0)
    kept = np.arange(len(grid.bricks)) != 0
    present = grid.bricks.slot > 0
    fewer = replace(
        grid,
        bricks=Bricks.of(present, grid.bricks.far),
        **{name: getattr(grid, name)[kept] for name in ("distance", "uv", "chart", "part")},
    )
    found = compare(grid, fewer)
    assert (found.common_bricks, found.only_a, found.only_b, found.unmatched) == (len(grid.bricks) - 1, 1, 0, unmatched)
    assert all(channel.anywhere == 0 for channel in found.channels.values())  # slots of one are not those of the other
    assert not found.within(0) and found.within(1e-6) is not band


def test_faces_are_ids_with_tables(grid):
    corner = np.eye(3)[:2]
    table = FaceTable(np.eye(3), np.array([[0, 1, 2]], np.int32), np.zeros((1, 3, 2)), np.zeros(1, np.int32))
    face = np.where(near(grid), 0, NONE).astype(np.int32)
    a = replace(grid, face=face, surface=table)
    assert compare(a, a).within(0) and set(compare(a, a).channels) > {"face"}
    found = compare(a, changed(a, "face", NONE, tuple(np.argwhere(near(grid))[:5].T)))
    assert found.channels["face"].differ == 5 and not found.within(1)
    longer = FaceTable(np.concatenate([np.eye(3), corner]), table.corners, table.uv + 1, table.chart)
    assert compare(a, replace(a, surface=longer)).tables == ("surface.uv", "surface.vertices")


def test_errors_are_a_table(grid):
    a, b = (replace(grid, error=np.full((len(grid.bricks), 3), e, np.float32)) for e in (0.1, 0.2))
    assert compare(a, a).tables == () and compare(a, b).tables == compare(grid, b).tables == ("error",)


def test_bounds_are_a_table(grid):
    bricks = Bricks(grid.bricks.slot, grid.bricks.far / 2, grid.bricks.index)
    found = compare(grid, replace(grid, bricks=bricks))
    assert found.tables == ("far",) and not found.within(0) and found.within(1e-9)


@pytest.mark.parametrize(
    ("change", "matters"),
    [({"options": {"sign": "winding"}}, False), ({"mesh_hash": "ab"}, False), ({"parts": ("front", "back")}, True)],
    ids=["options", "mesh", "parts"],
)
def test_metadata(grid, change, matters):
    other = replace(grid, metadata=grid.metadata.model_copy(update={**change, "tool_version": "another"}))
    found = compare(grid, other)
    assert set(found.metadata) == set(change)
    assert not found.within(0) and found.within(1e-9) is not matters


def test_all_of_anybodys_numbers_count(rng):
    values = rng.normal(size=(12, 9, 8)) * 100
    a, b = Grid.from_dense(values), Grid.from_dense(values + np.float32(64))
    found = compare(a, b)
    assert found.channels["distance"].samples == values.size
    assert found.channels["distance"].max == pytest.approx(64, abs=1e-4)  # float32 of numbers below 1024


@pytest.mark.parametrize(
    ("origin", "spacing", "shape", "named"),
    [
        ((0, 0, 0), 1.0, (9, 8, 8), "shapes"),
        ((0, 0, 0), 2.0, (8, 8, 8), "spacings"),
        ((1, 0, 0), 1.0, (8, 8, 8), "origins"),
    ],
    ids=["shape", "spacing", "origin"],
)
def test_lattices_must_agree(origin, spacing, shape, named):
    def empty(lattice):
        count = tuple(-(-n // 8) for n in lattice.shape)
        bricks = Bricks.of(np.zeros(count, bool), np.ones(count, np.float32))
        return Grid(lattice, bricks, np.zeros((0, 8, 8, 8), np.float32), None, None, None, Metadata(source="dense"))

    a = empty(Lattice(np.zeros(3), 1.0, (8, 8, 8)))
    assert compare(a, a).within(0)
    with pytest.raises(BadInput, match=f"different lattices, with {named}"):
        compare(a, empty(Lattice(np.array(origin, float), spacing, shape)))


def test_command(grid, tmp_path):
    at = tuple(np.argwhere(near(grid))[0])
    grid.save(tmp_path / "a.zarr.zip")
    changed(grid, "distance", grid.distance[at] + np.float32(1e-3 * grid.lattice.spacing), at).save(
        tmp_path / "b.zarr.zip"
    )
    a, b = tmp_path / "a.zarr.zip", tmp_path / "b.zarr.zip"
    assert json.loads(run("diff", a, a, "--json").stdout)["same"] is True
    record = json.loads(run("diff", a, b, "--json", code=1).stdout)
    assert record["same"] is False and record["channels"]["distance"]["differ"] == 1
    assert json.loads(run("diff", a, b, "--tolerance", 0.01, "--json").stdout)["same"] is True
    assert record["tables"] == record["channels_only_a"] == [] and record["metadata"] == {}
    bare = replace(grid, uv=None, metadata=grid.metadata.model_copy(update={"units": "mm"}))
    bare.save(tmp_path / "bare.zarr.zip")
    record = json.loads(run("diff", a, tmp_path / "bare.zarr.zip", "--tolerance", 1, "--json", code=1).stdout)
    assert record["channels_only_a"] == ["uv"] and record["metadata"] == {"units": {"a": "unit", "b": "mm"}}
    assert "distance" in run("diff", a, b, code=1).stdout
    assert "tolerance of -1.0" in run("diff", a, b, "--tolerance", -1, code=2).stderr
    assert "no grid file" in run("diff", a, tmp_path / "c.zarr.zip", code=2).stderr
