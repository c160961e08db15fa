"""Grids of which only some bricks are read: the same rows, the same tables for rays, and no more of the file."""

import zipfile

import numpy as np
import pytest
from charted import layers_of, with_all
from test_grid import Ball
from test_gridfile import assert_same, rewritten

from datasets_synthetic import shape
from sdfbake import BadInput, Grid, gridfile, gridlayout
from sdfbake.gridfile import load_counted
from sdfbake.layers import FULL
from sdfrender import GridField, trace
from sdfrender.kernels import NAMES
from sdfrender.stencils import around, width
from sdfrender.tables import INCOMPLETE

BY_BRICK = ("distance", "uv", "chart", "part", "face", "error")
BY_ROW = ("chart", "uv", "border", "normal")


@pytest.fixture(scope="module")
def grid():
    """A sphere with all representations of texture coordinates; its two charts lie below and above z = 0."""
    exact = shape("sphere")
    grid = Grid.from_function(exact, 64)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.lattice.shape), indexing="ij"), axis=-1)
    p = grid.lattice.to_world(index).reshape(-1, 3)
    codes, normal = np.rint(FULL * np.clip(0.5 + p[:, :2] / 3, 0, 1)), exact.normal(p)
    near = np.abs(exact.distance(p)) < 3 * grid.lattice.spacing
    border = np.stack([np.where(near & (side * p[:, 2] < 0.2), -8.0, np.inf) for side in (1, -1)])
    dense = (2, *grid.lattice.shape)
    both = [np.stack([values, values]).reshape(*dense, -1) for values in (codes, normal)]
    return with_all(grid, exact.mesh(0.3), layers_of(grid, both[0], border.reshape(dense), both[1]))


@pytest.fixture(scope="module")
def saved(grid, tmp_path_factory):
    path = tmp_path_factory.mktemp("grids") / "sphere.zarr.zip"
    grid.save(path)
    return path


def only(kept):
    return lambda lattice, bricks: kept


def corner(grid, share):
    """Bricks of a corner of the grid."""
    return (grid.bricks.index < share * np.array(grid.bricks.slot.shape)).all(axis=1)


MASKS = {
    "corner": lambda grid, rng: corner(grid, 0.5),
    "scattered": lambda grid, rng: rng.random(len(grid.bricks)) < 0.3,
    "one": lambda grid, rng: np.arange(len(grid.bricks)) == 17,
    "none": lambda grid, rng: np.zeros(len(grid.bricks), bool),
    "all but one": lambda grid, rng: np.arange(len(grid.bricks)) != 5,
}


@pytest.mark.parametrize("mask", MASKS.values(), ids=MASKS)
def test_rows_are_those_of_the_whole(grid, saved, rng, mask):
    kept = mask(grid, rng)
    part = Grid.load(saved, bricks=only(kept))
    assert np.array_equal(part.bricks.index, grid.bricks.index[kept])
    assert np.array_equal(part.bricks.slot[tuple(part.bricks.index.T)], np.arange(kept.sum()))
    assert np.array_equal(part.bricks.left_out | (part.bricks.slot >= 0), grid.bricks.slot >= 0)
    absent = grid.bricks.slot < 0
    assert np.array_equal(part.bricks.far[absent], grid.bricks.far[absent]) and not part.bricks.far[~absent].any()
    for name in BY_BRICK:
        whole = getattr(grid, name)
        assert (whole is None) == (getattr(part, name) is None)
        if whole is not None:
            assert np.array_equal(getattr(part, name), whole[kept]), name
    rows = kept[grid.layers.brick]
    assert np.array_equal(part.layers.brick, (np.cumsum(kept) - 1)[grid.layers.brick[rows]])
    for name in BY_ROW:
        assert np.array_equal(getattr(part.layers, name), getattr(grid.layers, name)[rows]), name
    assert np.array_equal(part.surface.corners, grid.surface.corners)


def test_all_of_them_is_the_whole(grid, saved):
    every = np.ones(len(grid.bricks), bool)
    assert_same(Grid.load(saved, bricks=only(every)), grid)
    read = load_counted(saved, bricks=only(every))[1]
    assert read == load_counted(saved)[1] and read.bricks == read.of_bricks == len(grid.bricks)
    assert 0.8 * read.of_bytes < read.bytes < read.of_bytes  # the archive's own headers are not counted


def test_what_was_read_is_counted(grid, saved):
    """A chunk has 16 bricks, which lie together: those of a corner are in less than half of the file."""
    kept = corner(grid, 0.5)
    part, read = load_counted(saved, {"distance", "chart"}, only(kept))
    assert read.channels == ("distance", "chart") and read.of_bricks == len(grid.bricks)
    assert len(part.bricks) == kept.sum() <= read.bricks <= 0.4 * len(grid.bricks)
    with zipfile.ZipFile(saved) as archive:
        sizes = {info.filename: info.file_size for info in archive.infolist()}
    chunks = np.unique(gridlayout_place(grid)[kept] // 16)
    names = [f"{name}/c/{chunk}/0/0/0" for name in ("distance", "chart") for chunk in chunks]
    heads = [name for name in sizes if name.endswith("zarr.json") or name.split("/")[0] in ("slot", "far")]
    assert read.bytes == sum(sizes[name] for name in {*names, *heads})
    counts = np.bincount(gridlayout_place(grid) // 16)
    assert read.bricks == counts[chunks].sum()


def gridlayout_place(grid):
    """Where in the file every brick is."""
    return np.argsort(gridlayout.file_order(grid.bricks.index))


def test_chunks_of_other_bricks_are_not_read(grid, saved, tmp_path):
    """They may be broken; one that is needed may not, though no checksum of the whole is looked at."""
    kept = corner(grid, 0.4)
    needed = set(np.unique(gridlayout_place(grid)[kept] // 16).tolist())
    assert 0 < len(needed) < -(-len(grid.bricks) // 16)
    data = bytearray(saved.read_bytes())
    with zipfile.ZipFile(saved) as archive:
        infos = {number: archive.getinfo(f"distance/c/{number}/0/0/0") for number in range(-(-len(grid.bricks) // 16))}

    def broken(numbers):
        altered = bytearray(data)
        for number in numbers:
            altered[infos[number].header_offset + 30 + len(infos[number].filename) + 200] ^= 1
        (tmp_path / "broken.zip").write_bytes(altered)
        return tmp_path / "broken.zip"

    part = Grid.load(broken(set(infos) - needed), {"distance"}, only(kept))
    assert np.array_equal(part.distance, grid.distance[kept])
    with pytest.raises(BadInput, match="not a grid file, or is cut short or altered"):
        Grid.load(broken({min(needed)}), {"distance"}, only(kept))
    with pytest.raises(BadInput, match="altered"):
        Grid.load(broken(set(infos) - needed), {"distance"})


def _zeros(name):
    return {name: lambda data: data[:4] + b"\xff\xff\xff\x7f" + data[8:]}


LIES = {
    "size of a chunk": _zeros("distance/c/0/0/0/0"),
    "no chunk": {"distance/c/0/0/0/0": lambda data: None},
    "no table": {"slot/zarr.json": lambda data: None},
    "short chunk": {"distance/c/0/0/0/0": lambda data: data[:10]},
    "no brick": {"slot/c/0/0/0": lambda data: data[:40] + bytes([data[40] ^ 255]) + data[41:]},
}


@pytest.mark.parametrize("changes", LIES.values(), ids=LIES)
def test_a_part_of_a_hostile_file(grid, saved, tmp_path, changes):
    kept = gridlayout_place(grid) < 16  # all in the first chunk
    with pytest.raises(BadInput, match="not a grid file, or is cut short or altered"):
        Grid.load(rewritten(saved, tmp_path / "x.zip", changes), {"distance"}, only(kept))


SLOTS = {
    "twice": lambda slot: np.where(slot == 3, 4, slot),
    "beyond": lambda slot: np.where(slot == 3, slot.max() + 1, slot),
    "negative": lambda slot: np.where(slot == -1, -2, slot),
    "one less": lambda slot: np.where(slot == slot.max(), -1, slot),
    "exchanged": lambda slot: np.select([slot == 3, slot == 4], [4, 3], slot),
}


@pytest.mark.parametrize("lie", SLOTS.values(), ids=SLOTS)
def test_a_table_that_lies(grid, tmp_path, monkeypatch, lie):
    """What is no numbering is refused; two rows exchanged are another grid, which has another checksum."""
    stored = gridfile._in_file_order

    def lying(arrays, bricks):
        made = stored(arrays, bricks)
        return {**made, "slot": lie(made["slot"]).astype(np.int32)}

    monkeypatch.setattr(gridfile, "_in_file_order", lying)
    grid.save(tmp_path / "lie.zip")
    with pytest.raises(BadInput, match="altered"):
        Grid.load(tmp_path / "lie.zip")


def test_files_of_before_are_read(grid, saved, tmp_path, monkeypatch):
    """Chunks of a megabyte, bricks in the order of their index."""

    def chunks(name, shape):
        axes, kind = gridlayout.LAYOUT[name]
        if axes[0] == "bx":
            return tuple(min(n, 64) for n in shape)
        rows = gridlayout.CHUNK_BYTES // gridlayout.row_bytes(shape, kind)
        return (max(1, min(shape[0], rows)), *shape[1:])

    with monkeypatch.context() as before:
        before.setattr(gridfile, "chunks", chunks)
        before.setattr(gridfile, "file_order", lambda index: np.arange(len(index)))
        grid.save(tmp_path / "old.zip")
    with zipfile.ZipFile(tmp_path / "old.zip") as old, zipfile.ZipFile(saved) as new:
        assert len(old.namelist()) < len(new.namelist())
    assert_same(Grid.load(tmp_path / "old.zip"), grid)
    kept = corner(grid, 0.5)
    part = Grid.load(tmp_path / "old.zip", bricks=only(kept))
    assert np.array_equal(part.distance, grid.distance[kept])
    assert np.array_equal(part.layers.uv, grid.layers.uv[kept[grid.layers.brick]])


def test_a_part_is_not_saved(grid, saved, tmp_path):
    with pytest.raises(BadInput, match="only a part of this grid was read"):
        Grid.load(saved, bricks=only(corner(grid, 0.5))).save(tmp_path / "x.zip")
    assert not list(tmp_path.iterdir())


def test_bricks_of_a_chunk_lie_together():
    """Along Morton's curve 64 bricks of a full lattice are a cube of 4^3."""
    index = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.int32)
    for chunk in index[gridlayout.file_order(index)].reshape(8, 64, 3):
        assert (np.ptp(chunk, axis=0) == 3).all()


def test_what_chunks_are_believed():
    shape_ = (1000, 8, 8, 8)
    assert all(gridlayout.is_chunk("distance", shape_, [rows, 8, 8, 8]) for rows in (1, 64, 512))
    for claimed in ([0, 8, 8, 8], [513, 8, 8, 8], [64, 8, 8, 4], [64, 8, 8], [64.0, 8, 8, 8], [True, 8, 8, 8], "64"):
        assert not gridlayout.is_chunk("distance", shape_, claimed)
    assert gridlayout.is_chunk("slot", (70, 3, 3), [64, 3, 3])
    assert not gridlayout.is_chunk("slot", (70, 3, 3), [70, 3, 3])


@pytest.mark.parametrize("name", NAMES)
def test_tables_of_bricks_with_all_their_neighbours(grid, saved, name):
    """Every number that a march or a jet reads in such a brick, or where none is, to the last bit."""
    seen = corner(grid, 0.3)
    table = np.zeros(grid.bricks.slot.shape, int)
    table[tuple(grid.bricks.index[seen].T)] = 1
    kept = around(table, grid.bricks.index, 0).any(axis=1)
    # How far rays go at once depends on 7 cells and 3 samples beyond a cell: here on two bricks.
    table[tuple(grid.bricks.index[kept].T)] = 1
    kept = around(table, grid.bricks.index, 0).any(axis=1)
    assert seen.sum() < kept.sum() < len(kept)
    part = GridField(Grid.load(saved, {"distance"}, only(kept)), name, engine="numpy")
    whole = GridField(Grid.load(saved, {"distance"}), name, engine="numpy")
    mine, ours = np.flatnonzero(seen), (np.cumsum(kept) - 1)[seen]
    size = width(whole.kernel)
    for values, rows in (("coefficients", size**3), ("bounds", 1)):
        a, b = (np.array(getattr(field._tables, values)).reshape(-1, rows) for field in (whole, part))
        assert np.array_equal(a[mine], b[ours]) and a[mine].any(), values
    cells = [np.array(field._tables.cells).reshape(-1, 512)[rows] for field, rows in ((whole, mine), (part, ours))]
    occupied = cells[0] < 0
    assert np.array_equal(occupied, cells[1] < 0) and np.array_equal(cells[0][~occupied], cells[1][~occupied])
    assert occupied.any() and ((cells[0][~occupied] & INCOMPLETE) > 0).any()
    for values, columns in (("planes", 4), ("deltas", 1)):
        a, b = (
            np.array(getattr(field._tables, values)).reshape(-1, columns)[-1 - of[occupied]]
            for field, of in zip((whole, part), cells, strict=True)
        )
        assert np.array_equal(a, b), values
    slots = [np.array(field._tables.slots).reshape(grid.bricks.slot.shape) for field in (whole, part)]
    assert np.array_equal(slots[0][grid.bricks.slot < 0], slots[1][grid.bricks.slot < 0])


def test_rays_pass_bricks_that_were_not_loaded(grid, saved):
    """They are empty space: rays through them end, and hit what was loaded behind."""
    z = grid.bricks.index[:, 2]
    part = GridField(Grid.load(saved, {"distance"}, only(z < z.max() / 2)), engine="numpy")
    whole = GridField(grid, engine="numpy")
    p, d = np.array([[0.1, 0.05, 3.0], [0.0, 0.0, -3.0]]), np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    through, direct = trace(part, p, d), trace(whole, p, d)
    assert through.t[0] == pytest.approx(3 + np.sqrt(0.64 - 0.0125), abs=1e-3) and direct.t[0] < 2.3
    assert through.t[1] == direct.t[1]


def test_nothing_at_all_is_hit(grid, saved, choice):
    empty = GridField(Grid.load(saved, {"distance"}, only(np.zeros(len(grid.bricks), bool))), engine=choice)
    assert not trace(empty, np.array([[0.0, 0.0, 3.0]]), np.array([[0.0, 0.0, -1.0]])).hit.any()


def test_inside_where_it_is_known(grid, saved):
    """Absent bricks keep their bounds; of bricks that were not loaded nothing is claimed."""
    part = GridField(Grid.load(saved, {"distance"}, only(corner(grid, 0.4))), engine="numpy")
    (value,) = part.jet(np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0]]), order=0)
    assert value[0] == GridField(grid, engine="numpy").jet(np.zeros((1, 3)), order=0)[0][0] < 0
    assert value[1] == 0


def test_channels_of_a_part(tmp_path):
    ball = Grid.from_function(Ball(), 40)
    ball.save(tmp_path / "ball.zip")
    kept = ball.bricks.index[:, 0] < 3
    part, read = load_counted(tmp_path / "ball.zip", {"part"}, only(kept))
    assert np.array_equal(part.part, ball.part[kept]) and part.uv is None and read.channels == ("distance", "part")
