"""The renderer's command line: what it writes, and that mistakes cost one line and nothing else."""

import json
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from scenery import furnish, mirror_scene, sdfrender_caller, sphere_scene

from sdfrender.image import read_exr

PAPER = '"diffuse", texture = "page"'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return furnish(tmp_path_factory.mktemp("scenes"))


@pytest.fixture
def call(monkeypatch, capsys):
    """Run the command line in this process: exit code, standard output, standard error."""
    return sdfrender_caller(monkeypatch, capsys)


def test_render_as_a_process(folder, tmp_path):
    """The one run with a start-up of its own: files, size, outputs, and one JSON object on standard output."""
    scene, exr, png = mirror_scene(folder), tmp_path / "out" / "a.exr", tmp_path / "a.png"
    command = [sys.executable, "-m", "sdfrender", "render", scene, "-o", exr, "--png", png, "--size", "20x12"]
    command += ["--outputs", "rgb,Z,lod", "--engine", "numpy", "--json"]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=True)
    record = json.loads(done.stdout)
    assert (
        record["engine"] == "numpy" and record["precision"] == 64 and record["plan"]["outputs"] == ["rgb", "Z", "lod"]
    )
    assert record["uv_mode"] == record["plan"]["assets"][0]["uv_mode"] == "grid"
    assert done.stderr == ""
    arrays = read_exr(exr)
    assert set(arrays) == {"rgb", "Z", "lod"} and arrays["rgb"].shape == (12, 20, 3)
    with Image.open(png) as picture:
        assert picture.size == (20, 12)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a.exr", "a.png", "out"]


def test_render_says_what_it_did(call, folder, tmp_path):
    code, out, err = call(
        "render", sphere_scene(folder), "-o", tmp_path / "a.exr", "--engine", "numpy", "--kernel", "linear"
    )
    assert code == 0 and out == ""
    assert "numpy" in err and "left out" in err and err.count("\n") == 1


def test_precision_and_kernel_reach_the_picture(call, folder, tmp_path):
    pictures = []
    for extra in ([], ["--kernel", "linear"], ["--precision", 32]):
        assert call("render", sphere_scene(folder), "-o", tmp_path / "a.exr", "--engine", "numpy", *extra)[0] == 0
        pictures.append(read_exr(tmp_path / "a.exr")["rgb"])
    assert np.abs(pictures[0] - pictures[1]).max() > 1e-3
    assert 0 < np.abs(pictures[0] - pictures[2]).mean() < 1e-4


def test_plan(call, folder):
    code, out, err = call("plan", sphere_scene(folder), "--json")
    plan = json.loads(out)
    assert code == 0 and err == "" and plan["differentials"] is False and plan["assets"][0]["channels"] == ["distance"]
    assert "Hessians" in [omission["what"] for omission in plan["left_out"]]
    code, out, err = call("plan", mirror_scene(folder))
    assert code == 0 and err == "" and "Hessian" in out


BAD = {
    "missing scene": (["none.toml"], "none.toml"),
    "folder": (["."], "cannot be read"),
    "unknown key": (["odd.toml"], "film.colour"),
    "missing grid": (["gridless.toml"], "none.zarr.zip"),
    "not a grid": (["text.toml"], "page.png"),
    "missing texture": (["plain.toml"], "none.png"),
    "unknown output": (["good.toml", "--outputs", "rgb,depth"], "depth"),
    "no output": (["good.toml", "--outputs", ""], "output"),
    "bad size": (["good.toml", "--size", "512"], "--size"),
    "zero size": (["good.toml", "--size", "0x5"], "film.size"),
    "huge size": (["good.toml", "--size", "100000x100000"], "pixels"),
    "unknown engine": (["good.toml", "--engine", "cuda"], "cuda"),
    "unknown kernel": (["good.toml", "--kernel", "cubic"], "cubic"),
    "unknown precision": (["good.toml", "--precision", "16"], "16"),
    "unknown option": (["good.toml", "--frames", "3"], "--frames"),
    "png without rgb": (["good.toml", "--outputs", "Z", "--png", "x.png"], "rgb"),
    "unwritable output": (["good.toml", "-o", "page.png/a.exr"], "page.png"),
    "unwritable png": (["good.toml", "--png", "page.png/a.png"], "page.png"),
    "output is a folder": (["good.toml", "-o", "."], "folder"),
}


@pytest.mark.parametrize(("arguments", "says"), BAD.values(), ids=BAD)
def test_mistakes(call, folder, tmp_path, monkeypatch, arguments, says):
    """Exit code 2, one line on standard error, no file."""
    monkeypatch.chdir(folder)
    good = sphere_scene(folder, PAPER, size=(8, 8)).rename(folder / "good.toml").read_text()
    changes = {
        "odd": ("[film]", "[film]\ncolour = 1"),
        "gridless": ("sphere.zarr", "none.zarr"),
        "text": ("sphere.zarr.zip", "page.png"),
        "plain": ("page.png", "none.png"),
    }
    for name, (old, new) in changes.items():
        (folder / f"{name}.toml").write_text(good.replace(old, new))
    before = sorted(folder.rglob("*"))
    output = [] if "-o" in arguments else ["-o", tmp_path / "a.exr"]
    engine = [] if "--engine" in arguments else ["--engine", "numpy"]
    code, out, err = call("render", *arguments, *output, *engine)
    assert (code, out) == (2, "")
    assert err.startswith("error: ") and err.endswith("\n") and err.count("\n") == 1, err
    assert says in err
    assert list(tmp_path.iterdir()) == [] and sorted(folder.rglob("*")) == before


def test_no_output_is_asked_for(call, folder):
    code, out, err = call("render", sphere_scene(folder))
    assert (code, out, err.count("\n")) == (2, "", 1) and "output" in err
