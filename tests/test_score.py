import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from datasets_synthetic import mesh, shape
from sdfbake import Grid
from sdfbake.commandline import run
from sdfbake.meshfile import save
from sdfrender import render
from sdfrender.image import CHANNELS, read_exr, write_exr
from sdfrender.scene import Scene, load_scene
from validate.__main__ import cli
from validate.exact import ShapeField
from validate.experiment import Run, read_runs
from validate.score import score
from validate.scorefile import HEADER
from validate.sections import scores

OUTPUTS = '["Z", "P", "N", "uv", "duv_dx", "duv_dy", "chart"]'
TEXT = """[camera]
position = [{camera}]
target = [0.0, 0.0, 0.0]
fov = 40.0
[film]
size = [32, 24]
outputs = {outputs}
[trace]
bounces = {bounces}
[[assets]]
grid = "{grid}"
materials = [{materials}]
"""
CELLS = ("P.X", "P.Y", "P.Z", "uv.U", "uv.V", "duv_dx.U", "duv_dx.V", "duv_dy.U", "duv_dy.V")
CELLS += ("Z", "N.X", "N.Y", "N.Z", "chart")
DIFFUSE = '{ type = "diffuse" }'
MIRROR = '{ type = "mirror", part = "sphere" }, { type = "diffuse", part = "sheet" }'


def described(folder: Path, name: str, materials: str, camera: str, bounces: int, grid: str = "no.zarr.zip") -> Path:
    path = folder / f"{name}.toml"
    text = TEXT.format(camera=camera, outputs=OUTPUTS, bounces=bounces, grid=grid, materials=materials)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scenes of the torus and of the mirror; footprints of exact shapes, of a grid, and the torus as a mesh."""
    folder = tmp_path_factory.mktemp("scores")
    Grid.from_function(shape("sphere"), 32).save(folder / "sphere.zarr.zip")
    described(folder, "sphere", DIFFUSE, "0.5, 0.4, 2.6", 0, "sphere.zarr.zip")
    described(folder, "torus", DIFFUSE, "0.5, 1.4, 2.6", 0)
    described(folder, "mirror", MIRROR, "0.0, 0.0, 1.9", 1)
    for name in ("torus", "mirror"):
        write_exr(folder / f"{name}.exr", render(folder / f"{name}.toml", field=ShapeField(shape(name))))
    write_exr(folder / "sphere.exr", render(folder / "sphere.toml", engine="numpy"))
    return folder


def table(folder: Path, name: str, scene: Scene, *, drop_misses: bool) -> Path:
    """The same footprints as a table."""
    arrays = render(scene, field=ShapeField(shape(name)))
    channels = {part: arrays[key][..., i] for key in arrays for i, part in enumerate(CHANNELS[key][0])}
    path = folder / f"{name}-{drop_misses}.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*HEADER.split(","), "z", "nx", "ny", "nz", "chart"])
        for y, x in np.ndindex(*arrays["Z"].shape[:2]):
            if arrays["Z"][y, x, 0] > 0 or not drop_misses:
                cells = (float(np.float32(channels[part][y, x])) for part in CELLS)
                writer.writerow([x, y, *(repr(cell) for cell in cells)])
    return path


def changed(folder: Path, name: str, **changes: object) -> Path:
    """The torus's file with some outputs replaced, by name."""
    arrays = render(folder / "torus.toml", field=ShapeField(shape("torus")))
    for key, change in changes.items():
        if change is None:
            del arrays[key]
        else:
            arrays[key] = change(arrays[key])  # type: ignore[operator]
    write_exr(folder / f"{name}.exr", arrays)
    return folder / f"{name}.exr"


@pytest.mark.parametrize("name", ["torus", "mirror"])
def test_exact_footprints_have_the_error_of_their_file(folder: Path, name: str) -> None:
    values = score(folder / f"{name}.exr", folder / f"{name}.toml", shapes=[name]).values
    # The file holds float32: 6e-8 of a value, of which a footprint's length is made by a few.
    ends = read_exr(folder / f"{name}.exr")["chart"] >= 0
    assert values["pixels"] == ends.sum() > 100 and values["missed"] == 0.0 and values["chart_mismatch"] == 0.0
    assert values["jacobian_error.max"] < 3e-7 and values["lod_error.max"] < 1e-6
    assert values["position_error.max"] < 1e-6 and values["uv_error.max"] < 1024 * 2e-7


def test_a_grid_has_the_errors_that_it_is_known_for(folder: Path) -> None:
    values = score(folder / "sphere.exr", folder / "sphere.toml", shapes=["sphere"]).values
    # A B-spline of 32: normals of order three, so some 1e-4 of a footprint in the middle of the sphere.
    assert 1e-6 < values["interior.jacobian_error.p50"] < 2e-3
    assert 0 < values["hit_error.p50"] < 1e-4


def test_derivatives_of_two_pixels_are_wrong_by_a_level(folder: Path) -> None:
    path = changed(folder, "twice", duv_dx=lambda a: 2 * a, duv_dy=lambda a: 2 * a)
    values = score(path, folder / "torus.toml", shapes=["torus"]).values
    for key in ("p50", "max"):
        assert values[f"lod_error.{key}"] == pytest.approx(1.0, abs=1e-6)
        assert values[f"jacobian_error.{key}"] == pytest.approx(1.0, abs=1e-6)
    found = scores.section([Run("scores", "torus", {"file": "a", "truth": "b"}, {}, "error", values)])
    assert "speaks of other units" in found.finding[0]


def test_hits_that_a_file_lacks_are_missed(folder: Path) -> None:
    def left(array: np.ndarray) -> np.ndarray:
        return np.where(np.arange(array.shape[1])[None, :, None] < 16, array, 0.0)

    values = score(
        changed(folder, "half", uv=left, duv_dx=left, duv_dy=left), folder / "torus.toml", shapes=["torus"]
    ).values
    hits = read_exr(folder / "torus.exr")["chart"][..., 0] >= 0
    assert values["missed"] == pytest.approx(hits[:, 16:].sum() / hits.sum())
    assert values["pixels"] == hits[:, :16].sum()


def test_swapped_texture_axes_keep_the_level_but_not_the_footprint(folder: Path) -> None:
    path = changed(folder, "swapped", duv_dx=lambda a: a[..., ::-1], duv_dy=lambda a: a[..., ::-1])
    values = score(path, folder / "torus.toml", shapes=["torus"]).values
    # A permutation of rows: the lengths of both columns stay as they are, on a square texture.
    assert values["lod_error.max"] < 1e-6 and values["jacobian_error.p50"] > 0.1


def test_the_header_is_the_one_that_is_documented() -> None:
    assert HEADER == "x,y,px,py,pz,u,v,dudx,dvdx,dudy,dvdy"


@pytest.mark.parametrize("drop_misses", [True, False], ids=["hits alone", "all pixels"])
def test_a_table_scores_like_the_picture(folder: Path, drop_misses: bool) -> None:
    path = table(folder, "torus", load_scene(folder / "torus.toml"), drop_misses=drop_misses)
    picture = score(folder / "torus.exr", folder / "torus.toml", shapes=["torus"]).values
    assert score(path, folder / "torus.toml", shapes=["torus"]).values == picture


def test_what_a_file_does_not_have_is_not_judged(folder: Path) -> None:
    path = changed(folder, "bare", N=None, chart=None, Z=None)
    values = score(path, folder / "torus.toml", shapes=["torus"]).values
    assert not any("normal_angle" in key or "chart_mismatch" in key for key in values)
    assert values["lod_error.max"] < 1e-6


def test_a_mesh_is_truth_by_embree(folder: Path) -> None:
    save(mesh("torus", 0.05), folder / "torus.ply")
    values = score(folder / "torus.exr", folder / "torus.toml", meshes=[folder / "torus.ply"]).values
    # Chords of edges h = 0.05 on a tube of radius 0.3 lie up to h^2 / (8 r) = 1.1e-3 deep, seen at some slant.
    assert values["position_error.p50"] < 2e-3 and values["lod_error.p50"] < 0.1 and values["missed"] < 0.1


def test_through_a_flat_mirror_meshes_and_shapes_agree(folder: Path) -> None:
    materials = '{ type = "mirror", part = "sheet" }, { type = "diffuse", part = "sphere" }'
    scene = described(folder, "flat", materials, "1.2, 0.6, -3.0", 1)
    write_exr(folder / "flat.exr", render(scene, field=ShapeField(shape("mirror"))))
    save(mesh("mirror", 0.1), folder / "mirror.ply")
    values = score(folder / "flat.exr", scene, meshes=[folder / "mirror.ply"]).values
    # Both parts end paths, straight or by the mirror: none of them is lost but at rims of faces.
    assert values["pixels"] > 100 and values["lod_error.p50"] < 0.05 and values["missed"] < 0.1
    assert values["chart_mismatch"] < 0.1  # a mirror that ended paths would show its own chart


@pytest.fixture
def call(monkeypatch, capsys):
    """Call the command line in this process: exit code, standard output, standard error."""

    def called(*arguments: object) -> tuple[object, str, str]:
        monkeypatch.setattr(sys, "argv", ["validate", "score", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            run(cli, "python -m validate")
        said = capsys.readouterr()
        return left.value.code, said.out, said.err

    return called


def test_the_command_prints_and_keeps(folder: Path, call, tmp_path: Path) -> None:
    common = (folder / "torus.exr", "--scene", folder / "torus.toml", "--shape", "torus")
    code, out, _ = call(*common, "-o", tmp_path / "runs.jsonl", "--json")
    assert code == 0 and json.loads(out)["values"]["missed"] == 0.0
    (kept,) = read_runs([tmp_path / "runs.jsonl"])
    assert kept.suite == "scores" and kept.setup == {"file": "torus.exr", "truth": "exact torus"}
    assert "against exact torus" in scores.section([kept]).finding[0]
    code, out, _ = call(*common)
    assert code == 0 and "level-of-detail" in out and "in the interior" in out


def _nan(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[5, 7, 1] = np.nan
    return array


BAD = {
    "nothing there": (lambda f: f / "none.exr", "there is no file"),
    "no picture": (lambda f: _text(f / "text.exr", "hello"), "cannot be read as OpenEXR"),
    "no derivatives": (lambda f: changed(f, "lacking", duv_dy=None), "has no channel duv_dy.U, duv_dy.V"),
    "no number": (lambda f: changed(f, "nan", duv_dx=_nan), "the value nan in duv_dx.V at pixel (7, 5), and 1 such"),
    "no header": (lambda f: _text(f / "a.csv", "1,2,3"), "has no column x, y, px"),
    "empty": (lambda f: _text(f / "b.csv", ""), "b.csv is empty"),
    "words": (lambda f: _text(f / "c.csv", HEADER + "\n" + "a," * 10 + "b"), "line 2 does not have 11 numbers"),
    "short line": (lambda f: _text(f / "g.csv", HEADER + "\n1"), "line 2 does not have 11 numbers"),
    "off the film": (
        lambda f: _text(f / "d.csv", HEADER + "\n32" + ",0" * 10),
        "a pixel (32, 0) that the film of 32x24",
    ),
    "half a pixel": (lambda f: _text(f / "e.csv", HEADER + "\n0.5" + ",0" * 10), "a pixel (0.5, 0) that"),
    "twice": (lambda f: _text(f / "f.csv", HEADER + ("\n3" + ",0" * 10) * 2), "has the pixel (3, 0) twice"),
}


def _text(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_one_sentence(folder: Path, call, tmp_path: Path, case: str) -> None:
    make, said = BAD[case]
    output = tmp_path / "runs.jsonl"
    code, out, err = call(make(folder), "--scene", folder / "torus.toml", "--shape", "torus", "-o", output)
    assert (code, out) == (2, "") and said in err and err.count("\n") == 1
    assert not output.exists()


def test_another_size_is_named(folder: Path, call) -> None:
    scene = folder / "large.toml"
    scene.write_text((folder / "torus.toml").read_text().replace("[32, 24]", "[64, 24]"))
    code, _, err = call(folder / "torus.exr", "--scene", scene, "--shape", "torus")
    assert code == 2 and "is 32x24 pixels" in err and "film 64x24" in err


@pytest.mark.parametrize(
    ("truth", "said"),
    [
        ((), "either exact shapes or meshes"),
        (("--shape", "torus", "--mesh", "torus.ply"), "either exact shapes or meshes"),
        (("--shape", "blob"), "no shape named 'blob'"),
        (("--shape", "torus", "--shape", "torus"), "has 1 assets, and 2"),
        (("--mesh", "nowhere.ply"), "nowhere.ply"),
    ],
    ids=["none", "both", "unknown", "too many", "no mesh"],
)
def test_truth_must_belong_to_the_scene(folder: Path, call, truth: tuple[str, ...], said: str) -> None:
    code, out, err = call(folder / "torus.exr", "--scene", folder / "torus.toml", *truth)
    assert (code, out) == (2, "") and said in err and err.count("\n") == 1


def test_unknown_keys_of_a_scene_are_named(folder: Path, call) -> None:
    scene = folder / "odd.toml"
    scene.write_text((folder / "torus.toml").read_text() + "[extra]\n")
    code, _, err = call(folder / "torus.exr", "--scene", scene, "--shape", "torus")
    assert code == 2 and "a key 'extra' that does not exist" in err


def test_glass_has_no_truth_in_meshes(folder: Path, call) -> None:
    scene = described(folder, "glass", '{ type = "glass" }, { type = "diffuse", part = "surface" }', "0, 0, 3", 2)
    code, _, err = call(folder / "torus.exr", "--scene", scene, "--mesh", folder / "any.ply")
    assert code == 2 and "no truth for glass" in err


def test_nothing_but_failed_scores_is_said() -> None:
    failed = Run("scores", "p", {"file": "a", "truth": "b"}, {}, "error", status="failed: why")
    assert scores.section([failed]).finding == ("No file was scored.",)
    assert CliRunner().invoke(cli, ["score", "--help"]).exit_code == 0
