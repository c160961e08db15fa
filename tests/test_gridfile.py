"""The asset on disk: whole round trips, and files that must not be believed."""

import json
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_grid import Ball

from sdfbake import BadInput, Grid
from sdfbake.gridfile import stored_bytes
from sdfbake.metadata import tool_version

CHANNELS = ("distance", "uv", "chart", "part")


@pytest.fixture(scope="module")
def grid():
    return Grid.from_function(Ball(), 24)


@pytest.fixture(scope="module")
def saved(grid, tmp_path_factory):
    path = tmp_path_factory.mktemp("grids") / "ball.zarr.zip"
    grid.save(path)
    return path


def assert_same(one, other):
    """Raise unless two grids hold the same bits."""
    assert one.lattice.shape == other.lattice.shape and one.lattice.spacing == other.lattice.spacing
    np.testing.assert_array_equal(one.lattice.origin, other.lattice.origin)
    for name in ("slot", "far", "index"):
        np.testing.assert_array_equal(getattr(one.bricks, name), getattr(other.bricks, name))
    for name in CHANNELS:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
    assert one.metadata.model_copy(update={"checksums": {}}) == other.metadata.model_copy(update={"checksums": {}})


def test_round_trip(grid, saved):
    loaded = Grid.load(saved)
    assert_same(grid, loaded)
    assert set(loaded.metadata.checksums) == {"slot", "far", *CHANNELS}
    assert loaded.metadata.tool_version == tool_version()


def test_assert_same_can_fail(grid):
    with pytest.raises(AssertionError):
        assert_same(grid, Grid.from_function(Ball(), 24, uv_mode="none"))
    with pytest.raises(AssertionError):
        assert_same(grid, Grid.from_function(Ball(), 25))


@pytest.mark.parametrize(
    "values",
    [np.ones((5, 6, 7)), np.random.default_rng(0).normal(size=(2, 2, 2)), np.zeros((20, 3, 9))],
    ids=["no brick", "tiny", "zero"],
)
def test_dense_round_trip(values, tmp_path):
    grid = Grid.from_dense(values, origin=(1e6, 0, -1e-6), spacing=1 / 3)
    grid.save(tmp_path / "a.zip")
    assert_same(grid, Grid.load(tmp_path / "a.zip"))


def test_same_bytes_twice(grid, saved, tmp_path):
    Grid.load(saved).save(tmp_path / "again.zarr.zip")
    grid.save(tmp_path / "twice.zarr.zip")
    assert (
        (tmp_path / "again.zarr.zip").read_bytes() == saved.read_bytes() == (tmp_path / "twice.zarr.zip").read_bytes()
    )


def test_only_some_channels(grid, saved):
    loaded = Grid.load(saved, channels={"chart"})
    assert loaded.uv is None and loaded.part is None
    np.testing.assert_array_equal(loaded.chart, grid.chart)
    np.testing.assert_array_equal(loaded.distance, grid.distance)
    with pytest.raises(BadInput, match="colour"):
        Grid.load(saved, channels={"colour"})


def test_stored_bytes_add_up(saved):
    with zipfile.ZipFile(saved) as archive:
        whole = sum(entry.compress_size for entry in archive.infolist())
        head = archive.getinfo("zarr.json").compress_size
    assert sum(stored_bytes(saved).values()) == whole - head


def test_nothing_left_beside(saved):
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9, 0.999])
def test_cut_short(saved, tmp_path, share):
    whole = saved.read_bytes()
    path = tmp_path / "cut.zip"
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(BadInput, match="not a grid file, or is cut short or altered"):
        Grid.load(path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.floats(0, 1, exclude_max=True), st.integers(1, 255))
def test_flipped_byte(grid, saved, tmp_path, where, flip):
    altered = bytearray(saved.read_bytes())
    altered[int(where * len(altered))] ^= flip
    path = tmp_path / "altered.zip"
    path.write_bytes(altered)
    try:
        loaded = Grid.load(path)
    except BadInput as complaint:
        assert "\n" not in str(complaint) and str(path) in str(complaint)
    else:
        assert_same(grid, loaded)  # a byte that carries nothing, such as a date of the archive


@pytest.mark.parametrize("at", ["distance/c/0/0/0/0", "uv/c/0/0/0/0/0", "slot/c/0/0/0", "zarr.json", "far/zarr.json"])
def test_flipped_content(saved, tmp_path, at):
    altered = bytearray(saved.read_bytes())
    with zipfile.ZipFile(saved) as archive:
        info = archive.getinfo(at)
    start = info.header_offset + 30 + len(at)  # a local header is 30 bytes and the name
    altered[start + info.file_size // 2] ^= 1
    path = tmp_path / "altered.zip"
    path.write_bytes(altered)
    with pytest.raises(BadInput, match="altered"):
        Grid.load(path)


def rewritten(source, target, changes):
    """Copy an archive with some entries changed, and sums that fit: what an attacker would do."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for info in old.infolist():
            data = old.read(info)
            if info.filename in changes:
                data = changes[info.filename](data)
            if data is not None:
                new.writestr(info.filename, data)
    return target


def edited(*keys, value):
    """Return a change of one entry of a JSON document."""

    def change(data):
        document = json.loads(data)
        inner = document
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value
        return json.dumps(document).encode()

    return change


def test_rewritten_file_is_read(grid, saved, tmp_path):
    assert_same(grid, Grid.load(rewritten(saved, tmp_path / "same.zip", {})))


CODECS = [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "numcodecs.pickle", "configuration": {}}]
HOSTILE = {
    "huge lattice": {"zarr.json": edited("attributes", "shape", value=[60000, 60000, 60000])},
    "beyond any": {"zarr.json": edited("attributes", "shape", value=[10**12, 2, 2])},
    "negative": {"zarr.json": edited("attributes", "shape", value=[-24, 24, 24])},
    "text": {"zarr.json": edited("attributes", "shape", value="24")},
    "spacing": {"zarr.json": edited("attributes", "spacing", value=0)},
    "version": {"zarr.json": edited("attributes", "metadata", "format_version", value=99)},
    "unknown entry": {"zarr.json": edited("attributes", "metadata", "colour", value="red")},
    "kind": {"zarr.json": edited("attributes", "kind", value="cake")},
    "many bricks": {"distance/zarr.json": edited("shape", value=[10**9, 8, 8, 8])},
    "wide uv": {"uv/zarr.json": edited("shape", value=[27, 8, 8, 8, 10**9])},
    "chunk": {"distance/zarr.json": edited("chunk_grid", "configuration", "chunk_shape", value=[10**9, 8, 8, 8])},
    "type": {"distance/zarr.json": edited("data_type", value="float64")},
    "codec": {"distance/zarr.json": edited("codecs", value=CODECS)},
    "blosc size": {"distance/c/0/0/0/0": lambda data: data[:4] + b"\xff\xff\xff\x7f" + data[8:]},
    "missing chunk": {"uv/c/0/0/0/0/0": lambda data: None},
    "missing array": {"slot/zarr.json": lambda data: None},
    "not json": {"zarr.json": lambda data: b"{"},
    "empty": {"zarr.json": lambda data: b""},
}


@pytest.mark.parametrize("changes", HOSTILE.values(), ids=HOSTILE)
def test_hostile_file(saved, tmp_path, changes):
    with pytest.raises(BadInput, match="not a grid file, or is cut short or altered"):
        Grid.load(rewritten(saved, tmp_path / "hostile.zip", changes))


def test_version_is_named(saved, tmp_path):
    with pytest.raises(BadInput, match="format version 99, this tool reads 2"):
        Grid.load(rewritten(saved, tmp_path / "new.zip", HOSTILE["version"]))


@pytest.mark.parametrize("content", [b"", b"PK", b"ply\n", b"\0" * 1000])
def test_not_a_grid(tmp_path, content):
    (tmp_path / "x.zip").write_bytes(content)
    with pytest.raises(BadInput, match="not a grid file"):
        Grid.load(tmp_path / "x.zip")


def test_missing_file(tmp_path):
    for path in (tmp_path / "none.zip", tmp_path):
        with pytest.raises(BadInput, match="no grid file"):
            Grid.load(path)


def test_unwritable(grid, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="cannot write"):
        grid.save(tmp_path / "file" / "x.zarr.zip")
    with pytest.raises(BadInput, match="cannot write"):
        grid.save(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
