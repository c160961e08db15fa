"""OpenVDB files: every voxel where it belongs, as the format is written down and as libopenvdb reads it."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from exported import Pile, pile, points, spread
from vdbfiles import READERS, by_openvdb, by_struct, leaves_by_tinyvdb, openvdb_arrays

from datasets_synthetic import mesh
from sdfbake import BadInput, Grid, Lattice, bake
from sdfbake.bricks import Bricks
from sdfbake.export import export
from sdfbake.export.vdb import HALF_WIDTH
from sdfbake.export.vdbfile import Named, save
from sdfbake.export.vdbtree import Channel
from sdfbake.metadata import Metadata


@pytest.fixture(scope="module")
def grid():
    """(120, 98, 85) samples: bricks are absent inside, too, and the last ones are cut."""
    made = pile(120)
    assert len(set(made.lattice.shape)) == 3 and any(n % 8 for n in made.lattice.shape)
    assert (made.bricks.far < 0).any() and (made.bricks.far > 0).any()
    return made


@pytest.fixture(scope="module")
def file(grid, tmp_path_factory):
    path = tmp_path_factory.mktemp("vdb") / "pile.vdb"
    assert export(grid, path, "vdb").files == (path,)
    return path


@pytest.fixture(scope="module", params=list(READERS))
def read(request, grid, file):
    return READERS[request.param](file, grid.lattice.shape)


@pytest.fixture(scope="module")
def stored(grid):
    """Distances as they are stored, and far ones where none are; signs are the shape's own."""
    values = spread(grid, grid.distance, np.float32(np.inf))
    outside = Pile().distance(points(grid.lattice).reshape(-1, 3)).reshape(values.shape) >= 0
    return np.where(np.isfinite(values), values, np.where(outside, np.inf, -np.inf))


def test_distances_are_exact_in_the_band_and_clamped_beyond(grid, stored, read):
    half = np.float32(HALF_WIDTH * grid.lattice.spacing)
    found = read["sdf"]
    assert found.background == half
    np.testing.assert_array_equal(found.active, np.abs(stored) < half)
    np.testing.assert_array_equal(found.values, np.clip(stored, -half, half))
    # It would not fit the other way round: all three axes differ.
    assert (np.sign(found.values[::-1]) != np.sign(found.values)).any()


def test_the_file_says_what_it_is(grid, read):
    assert set(read) == {"sdf", "uv", "chart", "seam", "part"}
    assert read["sdf"].entries["class"] == "level set"
    assert read["uv"].entries["vector_type"] == "invariant"
    assert read["part"].entries["parts"] == '["body", "knobs"]'
    for name, found in read.items():
        assert found.entries["name"] == name
        np.testing.assert_array_equal(found.voxel, [grid.lattice.spacing] * 3)
        np.testing.assert_array_equal(found.origin, grid.lattice.origin)


def test_texture_coordinates_are_where_a_hit_asks(grid, stored, read):
    reach = 3**0.5 * grid.lattice.spacing
    near = np.abs(stored) <= reach
    sure = near | (np.abs(stored) > 1.001 * reach)  # rounding decides between
    p = points(grid.lattice)[near]
    for name, width in (("uv", 3), ("chart", 1), ("part", 1)):
        found = read[name]
        np.testing.assert_array_equal(found.active[sure], near[sure])
        assert (found.values[~found.active] == (0 if width == 3 else -1)).all()
    np.testing.assert_array_equal(read["uv"].values[near], np.pad(Pile().uv(p).astype(np.float32), ((0, 0), (0, 1))))
    np.testing.assert_array_equal(read["chart"].values[near], Pile().chart(p))
    np.testing.assert_array_equal(read["part"].values[near], Pile().part(p))
    # Every corner of every cell with surface in it is there.
    corners = [stored[x : x - 1 or None, y : y - 1 or None, z : z - 1 or None] for x, y, z in np.ndindex(2, 2, 2)]
    crossed = (np.min(corners, axis=0) <= 0) & (np.max(corners, axis=0) >= 0)
    for x, y, z in np.ndindex(2, 2, 2):
        assert read["uv"].active[x : x - 1 or None, y : y - 1 or None, z : z - 1 or None][crossed].all()


def test_seams_are_cells_that_see_several_charts(read):
    chart, seam = read["chart"].values, read["seam"]
    corners = np.stack(
        [chart[x : x - 1 or None, y : y - 1 or None, z : z - 1 or None] for x, y, z in np.ndindex(2, 2, 2)]
    )
    several = np.where(corners < 0, np.inf, corners).min(axis=0) < corners.max(axis=0)
    assert several.any()
    np.testing.assert_array_equal(seam.active[:-1, :-1, :-1], several)
    np.testing.assert_array_equal(seam.values, seam.active)


def test_tinyvdb_reads_the_same_leaves(grid, file):
    """The lattice lies in one node of 16^3 leaves, which lists them x slowest."""
    ours = by_struct(file, tuple(-(-n // 8) * 8 for n in grid.lattice.shape))
    for name, (theirs, leaves, active) in leaves_by_tinyvdb(file).items():
        assert active == ours[name].active.sum()
        assert theirs.transform["translation"] == tuple(grid.lattice.origin)
        assert theirs.transform["voxel_size"] == (grid.lattice.spacing,) * 3
        if name == "seam":
            continue  # it does not tell the values of bools
        values = ours[name].values.reshape(*ours[name].active.shape, -1)
        starts = [at for at in np.ndindex(grid.bricks.slot.shape) if ours[name].active[_cube(at)].any()]
        assert leaves == [np.ascontiguousarray(values[_cube(at)]).tobytes() for at in starts]


def _cube(at):
    return tuple(slice(8 * n, 8 * n + 8) for n in at)


def scattered(rng, shape):
    """Leaves here and there with values and signs of any kind, among tiles inside and outside."""
    leaf = rng.random(shape) < 0.02
    tiles = np.zeros(shape, bool)
    tiles[: 33 if shape[0] < 100 else 700, :20, 1:] = True  # whole nodes of both levels, and some of parts
    leaf[16:32, :16, :16] = False
    tiles &= ~leaf
    index = np.argwhere(leaf).astype(np.int32)
    values = rng.normal(size=(len(index), 8, 8, 8)).astype(np.float32)
    active = rng.random(values.shape) < rng.random((len(index), 1, 1, 1))
    minus = rng.random(values.shape) < rng.integers(3, size=(len(index), 1, 1, 1)) / 2  # none, half or all
    active[:3], minus[0], minus[1] = False, True, False  # leaves that turn into tiles
    return Channel(index, values, active, np.float32(2.5), minus, tiles)


@pytest.mark.parametrize("shape", [(40, 33, 17), (1030, 2, 3), (2, 3, 1030)], ids=["levels", "along-x", "along-z"])
@pytest.mark.parametrize("reader", list(READERS))
def test_nodes_of_all_levels(rng, tmp_path, reader, shape):
    if shape[2] == 1030:
        made = scattered(rng, shape[::-1])
        turned = (0, 3, 2, 1)
        channel = Channel(made.index[:, ::-1].copy(), *(a.transpose(turned).copy() for a in (made.values, made.active)),
                          made.background, made.minus.transpose(turned).copy(), made.tiles.T.copy())  # fmt: skip
    else:
        channel = scattered(rng, shape)
    expected = np.where(channel.tiles, -channel.background, channel.background)
    expected = expected.repeat(8, 0).repeat(8, 1).repeat(8, 2)
    active = np.zeros(expected.shape, bool)
    background = np.where(channel.minus, -channel.background, channel.background)
    for at, values, on in zip(
        channel.index, np.where(channel.active, channel.values, background), channel.active, strict=True
    ):
        expected[_cube(at)], active[_cube(at)] = values, on
    save(tmp_path / "tree.vdb", Lattice(np.zeros(3), 1.0, expected.shape), [Named("tree", channel, {})])
    found = READERS[reader](tmp_path / "tree.vdb", expected.shape)["tree"]
    np.testing.assert_array_equal(found.active, active)
    np.testing.assert_array_equal(found.values, expected)


def test_what_a_grid_has_not_is_not_written(tmp_path):
    box = bake(mesh("box"), 24, uv_mode="none")
    done = export(box, tmp_path / "box.vdb", "vdb")
    assert set(by_struct(tmp_path / "box.vdb", box.lattice.shape)) == {"sdf"}
    assert done.size == (tmp_path / "box.vdb").stat().st_size and len(done.dropped) == 1


def test_faces_and_samples_give_the_same_bytes(tmp_path):
    """A bake to faces knows what a bake to samples stores; and the same grid gives the same file."""
    both = bake(mesh("box"), 24, uv_mode="faces,grid")
    faces = replace(both, uv=None, chart=None)
    files = [tmp_path / f"{n}.vdb" for n in range(3)]
    for each, path in zip((replace(both, face=None, surface=None), faces, faces), files, strict=True):
        export(each, path, "vdb")
    assert files[0].read_bytes() == files[1].read_bytes() == files[2].read_bytes()
    export(replace(faces, distance=-faces.distance), files[2], "vdb")  # another grid, another identity
    assert files[0].read_bytes()[21:57] != files[2].read_bytes()[21:57]


def test_numbers_that_are_no_distances_are_all_kept(rng, tmp_path):
    """Eight-bit noise around 100: half a brick wide band would lose every surface."""
    values = rng.normal(size=(19, 9, 12)).astype(np.float32) * 100
    grid = Grid.from_dense(values, origin=(1, 2, 3), spacing=0.25)
    done = export(grid, tmp_path / "noise.vdb", "vdb")
    found = by_struct(tmp_path / "noise.vdb", values.shape)["sdf"]
    assert found.active.all() and found.background == np.abs(values).max()
    np.testing.assert_array_equal(found.values, values)
    assert any("need not be distances" in note for note in done.notes)


def test_a_grid_without_bricks(tmp_path):
    """All outside: a tree without nodes."""
    lattice = Lattice(np.zeros(3), 1.0, (9, 9, 9))
    bricks = Bricks.of(np.zeros((2, 2, 2), bool), np.full((2, 2, 2), 5.0, np.float32))
    empty = Grid(lattice, bricks, np.zeros((0, 8, 8, 8), np.float32), None, None, None, Metadata(source="function"))
    export(empty, tmp_path / "empty.vdb", "vdb")
    found = by_struct(tmp_path / "empty.vdb", lattice.shape)["sdf"]
    assert not found.active.any() and (found.values == HALF_WIDTH).all()
    by_openvdb(tmp_path / "empty.vdb", lattice.shape)


def test_nanovdb_holds_the_same(grid, file, tmp_path):
    """There and back by the tools, which would say so if a checksum or an index were wrong."""
    if shutil.which("nanovdb_convert") is None:
        pytest.skip("the NanoVDB tools are not installed")
    done = export(grid, tmp_path / "pile.nvdb", "nvdb")
    assert [path.name for path in tmp_path.iterdir()] == ["pile.nvdb"] == [path.name for path in done.files]
    back = tmp_path / "back.vdb"
    subprocess.run(["nanovdb_convert", "-f", tmp_path / "pile.nvdb", back], check=True, capture_output=True)
    ours, theirs = by_struct(file, grid.lattice.shape), openvdb_arrays(back, grid.lattice.shape)
    for name, (values, active) in theirs.items():
        np.testing.assert_array_equal(active, ours[name].active)
        np.testing.assert_array_equal(values, ours[name].values)


def test_nanovdb_without_its_tools(grid, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(BadInput, match="libnanovdb-tools"):
        export(grid, tmp_path / "pile.nvdb", "nvdb")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("script, said", [("echo 'no room' >&2; exit 1", "no room"), ("echo 'sdf: failed'", "failed")])
def test_nanovdb_tools_that_fail(grid, tmp_path, monkeypatch, script, said):
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("nanovdb_convert", "nanovdb_validate"):
        (tools / name).write_text(f"#!/bin/sh\n{script}\n")
        (tools / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tools))
    (tmp_path / "out").mkdir()
    with pytest.raises(BadInput, match=said):
        export(grid, tmp_path / "out" / "pile.nvdb", "nvdb")
    assert not list((tmp_path / "out").iterdir())
