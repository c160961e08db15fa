"""The baker's command line, run as the user runs it."""

import io
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from typing import NamedTuple
from unittest import mock

import numpy as np
import pytest
import trimesh

from sdfbake import BadInput, Grid, Mesh, commandline
from sdfbake.__main__ import cli
from sdfbake.diagnosis import diagnose
from sdfbake.meshfile import save
from sdfbake.unwrap import unwrap


class Ended(NamedTuple):
    """What a run of the program left."""

    returncode: int
    stdout: str
    stderr: str


def run(*arguments, code=0):
    """Run the program in this process, check its exit code, and return what it printed."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["sdfbake", *map(str, arguments)]),
        redirect_stdout(out),
        redirect_stderr(err),
        pytest.raises(SystemExit) as left,
    ):
        commandline.run(cli, "python -m sdfbake")
    assert left.value.code == code, err.getvalue()
    return Ended(left.value.code, out.getvalue(), err.getvalue())


def ball(subdivisions=1):
    shape = trimesh.creation.icosphere(subdivisions)
    return Mesh(np.asarray(shape.vertices), shape.faces)


@pytest.fixture(scope="module")
def unwrapped(tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    save(ball(2), folder / "ball.ply")
    run("unwrap", folder / "ball.ply", "-o", folder / "atlas.ply")
    return folder / "atlas.ply"


def test_unwrap_then_bake_then_info(unwrapped, tmp_path):
    grid = tmp_path / "made" / "ball.zarr.zip"
    ended = run("bake", unwrapped, "-o", grid, "-n", 24, "--json")
    record = json.loads(ended.stdout)
    assert ended.stderr == ""
    assert record["lattice"]["shape"] == [24, 24, 24] and record["uv_modes"] == ["faces"]
    told = json.loads(run("info", grid, "--json").stdout)
    record.pop("done")
    record.pop("thin")
    assert told == record
    loaded = Grid.load(grid)
    assert told["bricks"] == len(loaded.bricks) and told["samples"] == 24**3
    assert told["charts"] == loaded.metadata.charts == Mesh.load(unwrapped).chart.max() + 1
    assert "edge over h" in run("info", grid).stdout
    assert [path.name for path in grid.parent.iterdir()] == [grid.name]


def test_unwrapped_mesh_is_the_same_mesh(unwrapped):
    made, given = Mesh.load(unwrapped), ball(2)
    np.testing.assert_array_equal(made.vertices, given.vertices)
    np.testing.assert_array_equal(made.faces, given.faces)
    assert made.uv.min() >= 0 and made.uv.max() <= 1


def areas(p):
    """Return the areas of triangles in any number of dimensions, by Gram's determinant."""
    u, v = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    return np.sqrt((u * u).sum(-1) * (v * v).sum(-1) - (u * v).sum(-1) ** 2) / 2


def test_unwrapping_is_isotropic():
    """Both axes have one scale: edges of a face shrink alike, whatever their direction in the atlas."""
    box = trimesh.creation.box((4.0, 1, 1))
    mesh = unwrap(Mesh(np.asarray(box.vertices), box.faces))
    p = mesh.vertices[mesh.faces]
    edges, in_uv = p - np.roll(p, 1, axis=1), mesh.uv - np.roll(mesh.uv, 1, axis=1)
    ratio = np.linalg.norm(in_uv, axis=-1) / np.linalg.norm(edges, axis=-1)
    # xatlas works in float32 and snaps charts to texels: one texel of 1024 on an edge of hundreds
    assert ratio.max() / ratio.min() < 1.02
    scale = areas(mesh.uv).sum() / areas(p).sum()
    assert ratio.mean() == pytest.approx(np.sqrt(scale), rel=0.02)


def test_charts_do_not_overlap(unwrapped):
    """No point of a raster lies in two triangles of the atlas."""
    uv = Mesh.load(unwrapped).uv
    x, y = (np.stack(np.meshgrid(*2 * [np.arange(150) + 0.5])).reshape(2, -1)) / 150
    inside = np.zeros(x.shape, int)
    for a, b, c in uv:
        side = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        inside += np.all(np.array(side) > 0, axis=0) | np.all(np.array(side) < 0, axis=0)
    assert inside.max() == 1 and inside.sum() > 5000


def test_unwrap_keeps_a_mesh_its_own_uv(unwrapped, tmp_path):
    run("unwrap", unwrapped, "-o", tmp_path / "kept.ply")
    assert (tmp_path / "kept.ply").read_bytes() == unwrapped.read_bytes()
    mesh = Mesh.load(unwrapped)
    save(mesh.with_(uv=mesh.uv / 2), tmp_path / "half.ply")
    run("unwrap", tmp_path / "half.ply", "-o", tmp_path / "again.ply", "--again")
    assert (tmp_path / "again.ply").read_bytes() == unwrapped.read_bytes()  # and twice the same atlas


def test_unwrap_gives_up_in_time(tmp_path):
    with pytest.raises(BadInput, match=r"longer than 0\.05 s"):
        unwrap(ball(2), timeout=0.05)


def test_unwrap_survives_a_crash(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(BadInput, match="could not be unwrapped"):
        unwrap(ball(1))


def test_bake_unwraps_when_asked_and_mends(tmp_path):
    mesh = ball(1)
    dirty = Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[:2]]))
    save(dirty, tmp_path / "dirty.ply")
    record = json.loads(
        run("bake", tmp_path / "dirty.ply", "-o", tmp_path / "a.zarr.zip", "-n", 16, "--unwrap", "--json").stdout
    )
    assert record["done"] == ["2 degenerate or duplicate faces removed", "unwrapped"]
    assert record["uv_modes"] == ["faces"] and record["sign"]["method"] == "pseudonormal"


def test_same_bytes_twice(unwrapped, tmp_path):
    for name in ("a", "b"):
        run("bake", unwrapped, "-o", tmp_path / f"{name}.zarr.zip", "-n", 20)
    assert (tmp_path / "a.zarr.zip").read_bytes() == (tmp_path / "b.zarr.zip").read_bytes()


def test_warnings_are_lines(tmp_path):
    left = ball(1)
    both = Mesh(np.concatenate([left.vertices, left.vertices + 0.8]), np.concatenate([left.faces, left.faces + 42]))
    save(both, tmp_path / "two.ply")
    ended = run("bake", tmp_path / "two.ply", "-o", tmp_path / "a.zarr.zip", "-n", 16, "--json")
    json.loads(ended.stdout)
    assert ended.stderr.startswith("warning: the signs by winding") and ended.stderr.count("\n") == 1


def test_check(unwrapped, tmp_path):
    record = json.loads(run("check", unwrapped, "--json").stdout)
    assert record["verdict"] == "clean" and record["findings"] == [] and record["faces"] == 320
    mesh = ball(1)
    save(mesh.with_(faces=mesh.faces[1:], chart=mesh.chart[1:], part=mesh.part[1:]), tmp_path / "open.ply")
    ended = run("check", tmp_path / "open.ply", "--json", code=2)
    (finding,) = json.loads(ended.stdout)["findings"]
    assert finding["name"] == "open" and finding["count"] == 3
    assert ended.stderr.startswith("error: the mesh is open: 3 boundary edges")


@pytest.fixture(scope="module")
def bad(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    good = ball(1)
    save(good, folder / "good.ply")
    save(good.with_(faces=good.faces[1:], chart=good.chart[1:], part=good.part[1:]), folder / "open.ply")
    save(good.with_(vertices=good.vertices * np.where(np.arange(42) == 3, np.nan, 1)[:, None]), folder / "nan.ply")
    save(Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), folder / "empty.ply")
    (folder / "text.ply").write_text("not a mesh\n")
    (folder / "file").write_text("")
    return folder


BAD = {
    "missing": (["none.ply"], "no mesh file"),
    "not a mesh": (["text.ply"], "cannot be read as a mesh"),
    "empty": (["empty.ply"], "no triangles"),
    "nan": (["nan.ply"], "non-finite: 1 vertices"),
    "open": (["open.ply"], "open: 3 boundary edges"),
    "resolution 1": (["good.ply", "-n", "1"], "resolution 1 is outside 16..8192"),
    "resolution 100000": (["good.ply", "-n", "100000"], "resolution 100000 is outside 16..8192"),
    "resolution text": (["good.ply", "-n", "many"], "many"),
    "memory": (["good.ply", "-n", "4096", "--max-memory", "0.5"], "GB"),
    "unwritable": (["good.ply", "-o", "file/x.zarr.zip"], "cannot write"),
    "uv mode": (["good.ply", "--uv-mode", "fancy"], "faces, layers, grid"),
    "uv mode without uv": (["good.ply", "--uv-mode", "faces"], "--unwrap"),
    "smoothing": (["good.ply", "--smooth", "loop"], "none or ls3"),
    "shell": (["good.ply", "--open", "shell:-1"], "above 0"),
    "sign": (["good.ply", "--sign", "dice"], "dice"),
    "option": (["good.ply", "--colour", "red"], "--colour"),
    "no mesh named": ([], "MESH"),
}


@pytest.mark.parametrize(("arguments", "match"), BAD.values(), ids=BAD)
def test_bad_input(bad, arguments, match):
    before = sorted(path.name for path in bad.iterdir())
    names = [str(bad / word) if word.endswith((".ply", ".zip")) else word for word in arguments]
    output = [] if "-o" in arguments else ["-o", str(bad / "out.zarr.zip")]
    resolution = [] if "-n" in arguments else ["-n", "16"]
    ended = run("bake", *names, *output, *resolution, code=2)
    assert ended.stdout == "" and ended.stderr.count("\n") == 1
    assert ended.stderr.startswith("error: ") and match in ended.stderr
    assert sorted(path.name for path in bad.iterdir()) == before


def test_as_a_process(bad):
    """The exit code and the one line of a real process."""
    command = [sys.executable, "-m", "sdfbake", "check", str(bad / "open.ply")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1 and "refused" in ended.stdout


def test_info_of_no_grid(bad):
    ended = run("info", bad / "good.ply", code=2)
    assert "not a grid file" in ended.stderr and ended.stdout == ""


def test_import_is_light():
    """Geometry libraries are loaded by the functions that need them."""
    heavy = ["igl", "pymeshlab", "xatlas", "trimesh", "zarr", "open3d", "drjit", "embreex", "matplotlib"]
    program = f"import sys, sdfbake; sys.exit(', '.join(set({heavy}) & set(sys.modules)) or 0)"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ended.stderr.strip() == "" and ended.returncode == 0


def test_diagnosis_of_what_was_written(unwrapped):
    assert diagnose(Mesh.load(unwrapped)).certified
