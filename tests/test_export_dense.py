"""Dense exports: every sample where its format says, less than a slab in memory, refused before a byte is written."""

import json
import shutil
import struct
import tracemalloc
import xml.etree.ElementTree as ET
from types import SimpleNamespace

import numpy as np
import pytest
from exported import Pile, known, pile, points, silent, spread

from datasets_synthetic import mesh
from sdfbake import BadInput, Grid, bake
from sdfbake.atomic import replacing_all
from sdfbake.densify import order, planes
from sdfbake.export import FORMATS, export, room, texture
from sdfbake.export.mitsuba import shape_to_world, volume_to_world
from sdfbake.export.slabs import carried, sample_bytes, slab_bytes, stream
from sdfbake.export.texture import textured
from sdfbake.lattice import Lattice

DENSE = {"npy": ".npy", "vti": ".vti", "vol": ".vol", "coefficients": ".npy"}


@pytest.fixture(scope="module")
def grid():
    made = pile()
    assert len(set(made.lattice.shape)) == 3 and any(n % 8 for n in made.lattice.shape)
    return made


@pytest.fixture(scope="module")
def truth(grid):
    """All channels as dense arrays, by the plainest way there is."""
    whole = textured(grid)
    chart = spread(grid, whole.chart, -1)
    beyond = np.pad(chart, (0, 1), constant_values=-1)
    corners = np.stack(
        [beyond[x : x - 1 or None, y : y - 1 or None, z : z - 1 or None] for x, y, z in np.ndindex(2, 2, 2)]
    )
    seam = np.where(corners < 0, 1 << 30, corners).min(axis=0) < corners.max(axis=0)
    return {
        "distance": grid.to_dense(),
        "uv": spread(grid, whole.uv, 0),
        "chart": chart,
        "seam": seam.astype(np.uint8),
        "part": spread(grid, grid.part, 0),
    }


def test_truth_is_the_shape(grid, truth):
    """The oracle of the other tests, against closed forms."""
    near, p = known(grid), points(grid.lattice)
    np.testing.assert_allclose(truth["uv"][near], Pile().uv(p[near]), rtol=1e-6)  # float32
    np.testing.assert_array_equal(
        truth["chart"], np.where(near, Pile().chart(p.reshape(-1, 3)).reshape(near.shape), -1)
    )
    for turned in (truth["distance"][::-1], truth["distance"][:, ::-1], truth["distance"][..., ::-1]):
        assert (np.sign(turned) != np.sign(truth["distance"])).any()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_planes_along_every_axis(grid, truth, axis):
    slow, fast = order(axis)
    assert (slow, fast) == {0: (1, 2), 1: (0, 2), 2: (1, 0)}[axis]
    np.testing.assert_array_equal(
        np.stack(list(planes(grid, axis=axis))), truth["distance"].transpose(axis, slow, fast)
    )


@pytest.fixture(scope="module", params=["faces", "grid", "layers"])
def box(request):
    return bake(mesh("box"), 32, uv_mode=request.param)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_texture_plane_by_plane_is_that_of_the_whole(box, axis):
    whole, found = textured(box), {"uv": [], "chart": [], "seam": []}
    stream(box, axis, {name: pieces.append for name, pieces in found.items()}, None, silent)
    assert whole.seam.any()
    for name, pieces in found.items():
        values = spread(box, getattr(whole, name), -1 if name == "chart" else 0)
        turned = np.moveaxis(values, (axis, *order(axis)), (0, 1, 2))
        np.testing.assert_array_equal(np.stack(pieces), turned, err_msg=name)


def test_npy(grid, truth, tmp_path):
    done = export(grid, tmp_path / "a.npy", "npy")
    record = json.loads((tmp_path / "a.npy.json").read_text())
    assert set(record["arrays"]) == set(truth) and record["lattice"]["shape"] == list(grid.lattice.shape)
    assert {file.name for file in done.files} == {*record["arrays"].values(), "a.npy.json"}
    for name, file in record["arrays"].items():
        values = np.load(tmp_path / file, mmap_mode="r")
        assert values.dtype == truth[name].dtype and values.flags.c_contiguous
        np.testing.assert_array_equal(values, truth[name], err_msg=name)
    np.testing.assert_array_equal(record["lattice"]["origin"], grid.lattice.origin)
    assert record["lattice"]["spacing"] == grid.lattice.spacing


def test_vti(grid, truth, tmp_path):
    export(grid, tmp_path / "a.vti", "vti")
    data = (tmp_path / "a.vti").read_bytes()
    head, rest = data.split(b'<AppendedData encoding="raw">\n_', 1)
    assert rest.endswith(b"\n</AppendedData>\n</VTKFile>\n")
    image = ET.fromstring(head + b"</VTKFile>").find("ImageData")
    nx, ny, nz = shape = grid.lattice.shape
    assert image.get("WholeExtent") == f"0 {nx - 1} 0 {ny - 1} 0 {nz - 1}" == image.find("Piece").get("Extent")
    np.testing.assert_array_equal([float(x) for x in image.get("Origin").split()], grid.lattice.origin)
    np.testing.assert_array_equal([float(x) for x in image.get("Spacing").split()], [grid.lattice.spacing] * 3)
    kinds = {"Float32": "<f4", "Int32": "<i4", "UInt8": "|u1"}
    arrays = {}
    for array in image.iter("DataArray"):
        start, parts = int(array.get("offset")), int(array.get("NumberOfComponents"))
        (size,) = struct.unpack_from("<Q", rest, start)
        values = np.frombuffer(rest[start + 8 : start + 8 + size], kinds[array.get("type")])
        values = values.reshape(nz, ny, nx, parts).transpose(2, 1, 0, 3)
        arrays[array.get("Name")] = values if parts > 1 else values[..., 0]
    assert image.find("Piece/PointData").get("Scalars") == "sdf"
    assert {"distance" if name == "sdf" else name for name in arrays} == set(truth)
    for name, values in arrays.items():
        assert values.shape[:3] == shape
        np.testing.assert_array_equal(values, truth["distance" if name == "sdf" else name], err_msg=name)


def volume(path):
    """Read a volume of Mitsuba's: its box and values [x, y, z, channel]."""
    data = path.read_bytes()
    magic, version, kind, nx, ny, nz, channels, *box = struct.unpack_from("<3sB5i6f", data)
    assert (magic, version, kind) == (b"VOL", 3, 1)
    values = np.frombuffer(data[48:], "<f4").reshape(nz, ny, nx, channels)
    return np.reshape(box, (2, 3)), values.transpose(2, 1, 0, 3)


def test_vol(grid, truth, tmp_path):
    done = export(grid, tmp_path / "a.vol", "vol")
    assert [file.name for file in done.files] == ["a.vol", "a.uv.vol", "a.xml"]
    (nx, ny, nz), n = grid.lattice.shape, max(grid.lattice.shape)
    box, values = volume(tmp_path / "a.vol")
    assert values.shape == (n, n, n, 1)
    np.testing.assert_array_equal(values[:nx, :ny, :nz, 0], truth["distance"])
    cells, coordinates = volume(tmp_path / "a.uv.vol")
    np.testing.assert_array_equal(coordinates[:nx, :ny, :nz, :2], truth["uv"])
    np.testing.assert_array_equal(coordinates[:nx, :ny, :nz, 2], truth["seam"])
    assert not coordinates[nx:].any() and not coordinates[:, ny:].any() and not coordinates[..., nz:, :].any()
    half = grid.lattice.spacing / 2
    first, last = grid.lattice.to_world(np.array([[0, 0, 0], [n - 1] * 3]))
    np.testing.assert_allclose(box, [first, last], rtol=1e-6)  # float32
    np.testing.assert_allclose(cells, [first - half, last + half], rtol=1e-6)
    assert any("part" in sentence for sentence in done.dropped)


def test_padding_is_a_bound_outside(grid, tmp_path):
    export(grid, tmp_path / "a.vol", "vol")
    n = max(grid.lattice.shape)
    values = volume(tmp_path / "a.vol")[1][..., 0]
    cube = Lattice(grid.lattice.origin, grid.lattice.spacing, (n, n, n))
    padded = np.ones(values.shape, bool)
    padded[tuple(slice(count) for count in grid.lattice.shape)] = False
    exact = Pile().distance(points(cube)[padded])
    assert (values[padded] > 0).all()
    # The values of border samples are rounded to float32, by a 2^-24 th.
    assert (values[padded] <= exact * (1 + 2.0**-23)).all()
    outside = np.argwhere(padded)
    nearest = np.minimum(outside, np.array(grid.lattice.shape) - 1)
    away = np.linalg.norm(outside - nearest, axis=-1) * grid.lattice.spacing
    expected = np.hypot(grid.to_dense()[tuple(nearest.T)].astype(np.float64), away)
    # Rounded down by 1e-7 and to float32.
    np.testing.assert_allclose(values[padded], expected, rtol=2e-7)
    assert (values[padded] <= expected).all()


def test_padding_of_a_cut_surface_is_told(tmp_path):
    values = np.ones((12, 10, 12), np.float32)
    values[:, 6:] = -1
    done = export(Grid.from_dense(values), tmp_path / "a.vol", "vol")
    assert any("closed there" in note for note in done.notes)
    padded = volume(tmp_path / "a.vol")[1][..., 0]
    assert padded.shape == (12, 12, 12) and (padded[:, 10:] > 0).all()


@pytest.mark.parametrize("to_world, corner", [(shape_to_world, 0.0), (volume_to_world, 0.5)], ids=["nodes", "cells"])
def test_to_world_of_mitsuba(grid, to_world, corner):
    # sdfgrid has sample i of n at i / (n - 1) of the unit cube, gridvolume at (i + 1/2) / n.
    n = max(grid.lattice.shape)
    index = np.array([[0, 0, 0], [3, 5, 7], [n - 1, 2, 1]])
    unit = (index + corner) / (n - 1 + 2 * corner)
    found = (to_world(grid.lattice) @ np.c_[unit, np.ones(3)].T)[:3].T
    np.testing.assert_allclose(found, grid.lattice.to_world(index), rtol=1e-13, atol=1e-13)


def test_scene_of_mitsuba(grid, tmp_path):
    export(grid, tmp_path / 'a "&" b.vol', "vol")
    scene = ET.parse(tmp_path / 'a "&" b.xml')
    names = {entry.get("value") for entry in scene.iter("string") if entry.get("name") == "filename"}
    assert names == {'a "&" b.vol', 'a "&" b.uv.vol'}
    matrices = [np.array(list(map(float, m.get("value").split(",")))) for m in scene.iter("matrix")]
    np.testing.assert_array_equal(matrices[0].reshape(4, 4), shape_to_world(grid.lattice))
    np.testing.assert_array_equal(matrices[1].reshape(4, 4), volume_to_world(grid.lattice))
    look = scene.find("sensor/transform/lookat")
    eye, target = (np.array(list(map(float, look.get(name).split(",")))) for name in ("origin", "target"))
    cosine = (points(grid.lattice).reshape(-1, 3) - eye) @ (target - eye)
    cosine /= np.linalg.norm(points(grid.lattice).reshape(-1, 3) - eye, axis=-1) * np.linalg.norm(target - eye)
    assert (cosine > np.cos(np.radians(15))).all()  # all samples are in a cone inside of the view's 30 degrees


def test_exact_everywhere(tmp_path):
    made = bake(mesh("box"), 20, uv_mode="faces")
    expected = made.to_dense(exact=True)
    assert (expected != made.to_dense()).any()
    for to, suffix in (("npy", ".npy"), ("vol", ".vol")):
        assert not any("bound" in note for note in export(made, tmp_path / f"a{suffix}", to, exact=True).notes)
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), expected)
    nx, ny, nz = made.lattice.shape
    np.testing.assert_array_equal(volume(tmp_path / "a.vol")[1][:nx, :ny, :nz, 0], expected)


@pytest.mark.parametrize("to", DENSE)
def test_exact_without_a_mesh_is_refused(grid, to, tmp_path):
    with pytest.raises(BadInput, match="carries no mesh"):
        export(grid, tmp_path / f"a{DENSE[to]}", to, exact=True)
    assert not list(tmp_path.iterdir())


def peak(made, path, to):
    """Return the most bytes in memory at once during an export."""
    export(made, path, to)  # what is imported and cached once
    tracemalloc.start()
    export(made, path, to)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most


@pytest.fixture(scope="module")
def large(request):
    return bake(mesh("box"), 128, uv_mode=request.param)


# Faces take their time when every allocation is watched: they are looked up for one format, as for the others.
HELD = [(mode, to) for mode in ("none", "faces", "grid", "layers") for to in DENSE if mode != "faces" or to == "vti"]


@pytest.mark.parametrize(("large", "to"), HELD, indirect=["large"])
def test_memory_stays_within_a_slab(to, large, tmp_path, monkeypatch):
    """At the worst: a plane along each face of the box is all band."""
    # Points that are looked up together are as many at any resolution: here as large a share of a plane as at 512.
    monkeypatch.setattr(texture, "_CHUNK", texture._CHUNK // 16)
    names = {"vol": ("distance", "uv and seam") if large.metadata.uv_modes else ("distance",),
             "coefficients": ("distance",)}.get(to, carried(large))  # fmt: skip
    nx, ny, nz = large.lattice.shape
    across = {"vti": nx * ny, "vol": max(nx, ny, nz) ** 2}.get(to, ny * nz)
    slab = 8 * across * sample_bytes(names)
    assert to == "vol" or slab == slab_bytes(large, names, 2 if to == "vti" else 0)
    most = peak(large, tmp_path / f"a{DENSE[to]}", to)
    # Buffers of files, and what interpreters hold.
    assert most < slab + (1 << 16)


@pytest.mark.parametrize("to", DENSE)
def test_memory_does_not_grow_with_the_number_of_planes(to, sphere, tmp_path):
    longest = 2 if to in ("vti", "vol") else 0
    shape, most = np.full(3, 32), []
    for count in (32, 96):
        shape[longest] = count
        origin = -0.06 * (shape - 1) / 2
        made = Grid.from_function(sphere, lattice=Lattice(origin, 0.06, tuple(shape.tolist())))
        most.append(peak(made, tmp_path / f"a{DENSE[to]}", to))
    # A volume for Mitsuba is a cube: its planes become 9 times as large, and 10 of them are in memory.
    larger = 40 * 96**2 if to == "vol" else 0
    assert most[1] < most[0] * 1.1 + larger


def test_formats_of_one_name_share_no_file(sphere, tmp_path):
    """But for two that are asked for under the same name."""
    made, seen = Grid.from_function(sphere, 24), set()
    for to in ("npy", "raw", "vti", "vol", "vdb"):
        files = set(export(made, tmp_path / f"a{FORMATS[to].suffix}", to).files)
        assert not files & seen
        seen |= files
    files = export(made, tmp_path / "b.npy", "coefficients").files
    assert [file.name for file in files] == ["b.npy", "b.npy.json"]


@pytest.mark.parametrize("to", DENSE)
def test_what_does_not_fit_is_refused(grid, to, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1 << 17))
    with pytest.raises(BadInput, match=r"needs \d+\.\d MB of disk space and 0\.1 MB are free"):
        export(grid, tmp_path / f"a{DENSE[to]}", to)
    monkeypatch.undo()
    monkeypatch.setattr(room, "available", lambda: 1 << 12)
    with pytest.raises(BadInput, match=r"needs \d+\.\d MB of memory and 0\.0 MB are available"):
        export(grid, tmp_path / f"a{DENSE[to]}", to)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("to", DENSE)
def test_nothing_is_left_where_an_export_ends_early(grid, to, tmp_path):
    def stop(stage, share):
        if share > 0.5:
            raise KeyboardInterrupt

    old = tmp_path / f"a{DENSE[to]}"
    old.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        export(grid, old, to, progress=stop)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]


def test_all_files_or_none(tmp_path):
    with pytest.raises(ValueError, match="late"), replacing_all([tmp_path / "a", tmp_path / "b"]) as (first, second):
        first.write_text("1")
        second.write_text("2")
        raise ValueError("late")
    assert not list(tmp_path.iterdir())
    with replacing_all([tmp_path / "a", tmp_path / "b"]) as both:
        for file in both:
            file.write_text(file.name)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a", "b"]
