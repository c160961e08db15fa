"""Coarser levels of a grid: on the same nodes, with bands of their own, in the same file, read only when asked for."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from test_bake_commands import run
from test_grid import Ball
from test_gridfile import assert_same, edited, rewritten

from datasets_synthetic import shape
from sdfbake import BadInput, Grid, Mesh, bake
from sdfbake.bricks import REACH, in_lattice, sample_index
from sdfbake.closest import Surface
from sdfbake.commands.info import describe
from sdfbake.compare import compare
from sdfbake.foretelling import Tables
from sdfbake.gridfile import load_counted, stored_bytes, whole_head
from sdfbake.lattice import BAND, LEAST, Lattice
from sdfbake.meshfile import save

TORUS = shape("torus").mesh(0.3)
BOX = np.array([[-1.0, -0.7, -0.4], [1.0, 0.7, 0.4]])


def dense(grid, name):
    """A channel on the whole lattice, and where it is known to be exact."""
    channel = getattr(grid, name)
    inside = in_lattice(grid.bricks.index, grid.lattice.shape)
    at = tuple(sample_index(grid.bricks.index)[inside].T)
    values = np.zeros((*grid.lattice.shape, *channel.shape[4:]), channel.dtype)
    values[at] = channel[inside]
    near = np.zeros(grid.lattice.shape, bool)
    near[at] = np.abs(grid.distance[inside]) <= BAND * grid.lattice.spacing
    return values, near


def assert_shared(grid, names):
    """Raise unless every level has the values of the one before at every second node of its exact band."""
    for fine, coarse in zip((grid, *grid.levels), grid.levels, strict=False):
        for name in names:
            (a, near), (b, also) = dense(fine, name), dense(coarse, name)
            shared = near[::2, ::2, ::2]
            assert shared.any() and also[shared].all()
            assert np.array_equal(a[::2, ::2, ::2][shared], b[shared]), name


@pytest.fixture(scope="module")
def baked():
    return bake(TORUS, 48, levels=2, uv_mode="faces,layers,grid")


@pytest.fixture(scope="module")
def saved(baked, tmp_path_factory):
    path = tmp_path_factory.mktemp("levels") / "torus.zarr.zip"
    baked.save(path)
    return path


@pytest.mark.parametrize("cube", [False, True], ids=["box", "cube"])
@pytest.mark.parametrize("levels", [1, 2, 3])
def test_lattices_share_box_and_nodes(levels, cube):
    finest = Lattice.around(BOX, 96, cube=cube, levels=levels)
    assert finest.spacing == Lattice.around(BOX, 96, cube=cube).spacing
    level = finest
    for number in range(1, levels + 1):
        level = level.coarser()
        assert level.spacing == finest.spacing * 2**number  # a power of two: no rounding
        assert np.array_equal(level.bounds, finest.bounds) and np.array_equal(level.origin, finest.origin)
        index = np.argwhere(np.ones(level.shape))
        assert np.array_equal(level.to_world(index), finest.to_world(index * 2**number))
    # The whole stencil of any cell with surface is there, on the coarsest as well: a thousandth of a voxel is rounded.
    margin = np.abs(level.bounds - BOX).min() / level.spacing
    assert margin >= BAND - 2e-3


def test_a_lattice_without_room_has_no_coarser_one():
    with pytest.raises(ValueError, match="no coarser one"):
        Lattice.around(BOX, 48).coarser()


@pytest.mark.parametrize("levels", [-1, 3, 9, 10])
def test_too_many_levels(levels):
    with pytest.raises(BadInput, match=r"level") as complaint:
        bake(TORUS, 32, levels=levels)
    assert "\n" not in str(complaint.value)


def test_the_coarsest_has_enough_samples():
    for n in (32, 64, 200):
        granted = [k for k in range(1, 8) if _granted(n, k)]
        assert granted == list(range(1, len(granted) + 1))  # no gap
        assert max(Lattice.around(BOX, n, levels=granted[-1]).shape) // 2 ** granted[-1] + 1 >= LEAST


def _granted(n, levels):
    try:
        return bool(Lattice.around(BOX, n, levels=levels).shape)
    except BadInput:
        return False


def test_baked_levels_share_values(baked):
    assert [level.lattice.spacing / baked.lattice.spacing for level in baked.levels] == [2, 4]
    assert_shared(baked, ("distance", "face", "uv", "chart"))


def test_assert_shared_can_fail(baked):
    level = baked.levels[0]
    near = np.abs(level.distance) < level.lattice.spacing
    off = replace(level, distance=np.where(near, np.nextafter(level.distance, np.float32(9)), level.distance))
    with pytest.raises(AssertionError):
        assert_shared(replace(baked, levels=(off,)), ("distance",))


@pytest.mark.parametrize(
    "options",
    [{"sign": "winding"}, {"open": "shell:0.2"}, {"smooth": "ls3"}, {"engine": "numpy"}],
    ids=["winding", "shell", "smooth", "numpy"],
)
def test_other_ways_share_values(options):
    grid = bake(TORUS, 32, levels=1, **options)
    assert_shared(grid, ("distance",))
    assert grid.levels[0].metadata.sign.method == grid.metadata.sign.method


@pytest.mark.parametrize("name", ["sphere", "torus", "mirror"])
def test_sampled_levels_share_values(name):
    grid = Grid.from_function(shape(name), 64, levels=2)
    assert_shared(grid, ("distance", "uv"))


def test_levels_are_baked_not_thinned(baked):
    """The band of a level is wider than that of the one before: an independent query knows it."""
    level, surface = baked.levels[-1], Surface.of(TORUS)
    values, near = dense(level, "distance")
    found = surface.closest(level.lattice.to_world(np.argwhere(near)))
    # Rounded to float32; closest points are found in float64.
    assert np.allclose(np.abs(values[near]), found.distance, rtol=2**-23, atol=1e-12)
    finest_band = REACH * baked.lattice.spacing
    assert (np.abs(values[near]) > 3 * finest_band).any()


def test_round_trip(baked, saved, tmp_path):
    loaded = Grid.load(saved)
    assert whole_head(saved).levels == len(loaded.levels) == 2
    for one, other in zip((baked, *baked.levels), (loaded, *loaded.levels), strict=True):
        assert_same(one, other)
        assert np.array_equal(one.face, other.face) and np.array_equal(one.layers.uv, other.layers.uv)
        assert other.surface is loaded.surface  # one table, once in memory
    loaded.save(tmp_path / "again.zarr.zip")
    assert (tmp_path / "again.zarr.zip").read_bytes() == saved.read_bytes()


def test_without_levels_nothing_of_them_is_read(baked, saved, monkeypatch):
    read = []
    whole = zipfile.ZipFile.read
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda self, info: read.append(info.filename) or whole(self, info))
    finest = Grid.load(saved, levels=False)
    assert finest.levels == () and not [name for name in read if name.startswith("level")]
    assert_same(finest, baked)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_one_level_alone(baked, saved, level):
    grid, reading = load_counted(saved, level=level)
    assert_same(grid, (baked, *baked.levels)[level])
    assert reading.levels == (level,) and reading == Tables.of(saved, level).foretell(
        {"face", "uv", "chart", "layers", "error"}
    )
    sizes = stored_bytes(saved)
    others = sum(sizes[f"level{number}"] for number in (1, 2) if number != level)
    assert reading.bytes <= saved.stat().st_size - others


def test_a_level_in_part(baked, saved):
    level = baked.levels[0]
    kept = level.bricks.index[:, 0] < 2
    part, reading = load_counted(saved, {"distance"}, lambda lattice, bricks: kept, 1)
    assert np.array_equal(part.distance, level.distance[kept]) and reading.of_bricks == len(level.bricks)


def test_files_without_levels_are_as_they_were(tmp_path):
    grid = Grid.from_function(Ball(), 24)
    grid.save(tmp_path / "old.zarr.zip")
    with zipfile.ZipFile(tmp_path / "old.zarr.zip") as archive:
        assert b'"levels"' not in archive.read("zarr.json")
    assert Grid.load(tmp_path / "old.zarr.zip").levels == () and whole_head(tmp_path / "old.zarr.zip").levels == 0


def test_the_faces_are_stored_once(saved):
    with zipfile.ZipFile(saved) as archive:
        assert [name for name in archive.namelist() if "surface." in name and name.startswith("level")] == []


def test_a_part_is_not_saved(baked, saved, tmp_path):
    part, _ = load_counted(saved, level=1, bricks=lambda lattice, bricks: np.arange(len(bricks)) > 3)
    finest = Grid.load(saved, levels=False)
    with pytest.raises(BadInput, match="only a part"):
        replace(finest, levels=(part,)).save(tmp_path / "part.zarr.zip")


HOSTILE = {
    "more than there are": {"zarr.json": edited("attributes", "levels", value=3)},
    "no number": {"zarr.json": edited("attributes", "levels", value="2")},
    "beyond bounds": {"zarr.json": edited("attributes", "levels", value=10**9)},
    "another origin": {"level1/zarr.json": edited("attributes", "origin", value=[0.0, 0.0, 0.0])},
    "another spacing": {"level2/zarr.json": edited("attributes", "spacing", value=0.01)},
    "another version": {"level1/zarr.json": edited("attributes", "metadata", "format_version", value=9)},
    "another sum": {"level2/zarr.json": edited("attributes", "metadata", "checksums", "distance", value="0" * 64)},
    "other arrays": {"level2/zarr.json": edited("attributes", "metadata", "checksums", value={})},
    "no json": {"level1/zarr.json": lambda data: b"{"},
    "no chunk": {"level2/distance/c/0/0/0/0": lambda data: b""},
    "another table": {"surface.uv/c/0/0/0": lambda data: data[:-1] + b"x"},
}


@pytest.mark.parametrize("changes", HOSTILE.values(), ids=HOSTILE)
def test_hostile_levels(saved, tmp_path, changes):
    rewritten(saved, tmp_path / "bad.zarr.zip", changes)
    with pytest.raises(BadInput, match="altered") as complaint:
        Grid.load(tmp_path / "bad.zarr.zip")
    assert "\n" not in str(complaint.value)


def test_a_level_that_is_not_there(saved):
    with pytest.raises(BadInput, match="level 3"):
        load_counted(saved, level=3)


def test_levels_are_compared(baked):
    assert compare(baked, baked).within(0)
    level = baked.levels[1]
    other = replace(level, distance=level.distance * np.float32(1.001))
    found = compare(baked, replace(baked, levels=(baked.levels[0], other)))
    assert not found.within(0) and found.within(0.1) and found.levels[0].within(0)
    assert found.record()["levels"][1]["channels"]["distance"]["differ"] > 0
    shorter = compare(baked, replace(baked, levels=baked.levels[:1]))
    assert shorter.levels_only_a == 1 and not shorter.within(1.0)


def test_info_tells_of_levels(baked, saved):
    told = describe(baked, saved)["levels"]
    assert [entry["bricks"] for entry in told] == [len(level.bricks) for level in baked.levels]
    assert [entry["bytes"] for entry in told] == [stored_bytes(saved)[f"level{number}"] for number in (1, 2)]


def test_levels_that_do_not_fit_are_refused(baked):
    with pytest.raises(ValueError, match="second node"):
        replace(baked, levels=(baked.levels[1],))


def test_one_face_alone_has_levels():
    """Bricks may be few: a level still has its band."""
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    grid = bake(flat, 32, levels=1, open="shell:0.2")
    assert_shared(grid, ("distance",))


def test_the_command_bakes_levels(tmp_path):
    save(TORUS, tmp_path / "torus.ply")
    mesh, grid = tmp_path / "torus.ply", tmp_path / "torus.zarr.zip"
    told = json.loads(run("bake", mesh, "-o", grid, "-n", 24, "--levels", 1, "--uv-mode", "none", "--json").stdout)
    assert [level["bricks"] for level in told["levels"]] == [len(Grid.load(grid).levels[0].bricks)]
    assert told["options"]["resolution"] == 24 and told["options"]["levels"] == 1
    ended = run("bake", mesh, "-o", grid, "-n", 24, "--levels", 6, code=2)
    assert "ask for fewer levels" in ended.stderr and ended.stderr.count("\n") == 1
