"""What a plan says will be read, to the byte; what rays reach; what is said of grids that nobody sees or baked."""

import json

import pytest
from scenery import furnish, sdfrender_caller

from datasets_synthetic import shape
from sdfbake import BadInput, Grid, bake
from sdfbake.foretelling import Tables
from sdfbake.gridfile import load_counted
from sdfrender.forecast import forecast
from sdfrender.plan import make_plan
from sdfrender.scene import load_scene
from sdfrender.stage import prepare


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = furnish(tmp_path_factory.mktemp("forecast"), 24)
    Grid.from_function(shape("sphere"), 64).save(folder / "ball.zarr.zip")
    mesh = shape("torus").mesh(0.2)
    bake(mesh, 40, uv_mode="faces,layers,grid", levels=1).save(folder / "torus.zarr.zip")
    return folder


@pytest.fixture
def call(monkeypatch, capsys):
    return sdfrender_caller(monkeypatch, capsys)


CHANNELS = [(), ("face",), ("layers",), ("uv", "chart", "part"), ("error",), ("face", "layers", "uv", "chart", "error")]


@pytest.mark.parametrize("level", [0, 1], ids=["finest", "coarser"])
@pytest.mark.parametrize("share", [None, 0.0, 0.02, 0.5], ids=str)
def test_foretold_is_what_is_read(folder, rng, level, share):
    """Channels and bricks at random, none and all among them."""
    tables = Tables.of(folder / "torus.zarr.zip", level)
    kept = None if share is None else rng.random(len(tables.bricks)) < share
    for channels in CHANNELS:
        wanted = None if kept is None else lambda _, bricks: kept
        _, read = load_counted(folder / "torus.zarr.zip", {"distance", *channels}, wanted, level)
        assert tables.foretell({"distance", *channels}, kept) == read


def test_a_broken_table_is_said(folder, tmp_path):
    whole = (folder / "torus.zarr.zip").read_bytes()
    (tmp_path / "cut.zarr.zip").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(BadInput, match="cut.zarr.zip is not a grid file, or is cut short"):
        Tables.of(tmp_path / "cut.zarr.zip")


CLOSE = "position = [0.2, 0.3, 2.5]\ntarget = [0.25, 0.15, 0.0]\nfov = 6.0"
WIDE = CLOSE.replace("6.0", "60.0")
PAPER = '{ type = "diffuse", texture = "page" }'
PAGE = '[[textures]]\nname = "page"\nimage = "page.png"\n'
SUN = '[[lights]]\ntype = "directional"\ndirection = [-1.0, -1.0, -1.0]\n'
ASIDE = "translate = [9.0, 0.0, 0.0]"


def asset(grid, material='{ type = "normals" }', *more):
    return "\n".join(["[[assets]]", f'grid = "{grid}.zarr.zip"', f"materials = [{material}]", *more, ""])


def written(folder, camera, rest, outputs="rgb"):
    asked = ", ".join(f'"{name}"' for name in outputs.split(","))
    (folder / "seen.toml").write_text(f"[camera]\n{camera}\n[film]\nsize = [8, 6]\noutputs = [{asked}]\n{rest}")
    return folder / "seen.toml"


# camera, what follows, outputs: bricks that rays reach are all, some or none, grid by grid
SCENES = {
    "close": (CLOSE, asset("ball"), "rgb", ["some"]),
    "wide": (WIDE, asset("ball"), "rgb", ["all"]),
    "textured": (CLOSE, PAGE + asset("torus", PAPER, "translate = [-0.6, 0.0, 0.0]"), "rgb,lod", ["some"]),
    "two places": (CLOSE, asset("ball") + asset("ball", '{ type = "normals" }', ASIDE), "rgb", ["some"]),
    "one out of sight": (CLOSE, asset("ball") + asset("mirror", '{ type = "normals" }', ASIDE), "Z", ["some", "none"]),
    "all out of sight": (CLOSE, asset("ball", '{ type = "normals" }', ASIDE), "rgb", ["none"]),
    "shadows": (CLOSE, SUN + asset("ball", '{ type = "diffuse" }'), "rgb", ["all"]),
    "mirror": (CLOSE, asset("ball", '{ type = "mirror" }') + asset("sphere"), "rgb", ["all", "all"]),
}


@pytest.mark.parametrize(("camera", "rest", "outputs", "reached"), SCENES.values(), ids=SCENES)
def test_the_forecast_comes_true(folder, camera, rest, outputs, reached):
    """Bytes and bricks of every grid as loading reads them, and the same mip levels."""
    path = written(folder, camera, rest, outputs)
    scene = load_scene(path)
    found, stage = forecast(scene, make_plan(scene)), prepare(path, engine="numpy")
    assert found.plan == stage.plan
    for said, (grid, read), reach in zip(found.grids, stage.read, reached, strict=True):
        assert said.grid == grid and said.opened == (reach != "none")
        assert (said.channels, said.bytes, said.of_bytes) == (read.channels, read.bytes, read.of_bytes)
        assert said.bricks == read.bricks and said.of_bricks == len(Tables.of(grid).bricks)
        bounds = {"all": (said.of_bricks, said.of_bricks), "some": (1, said.bricks - 1), "none": (0, 0)}[reach]
        assert bounds[0] <= said.reachable <= bounds[1]
    assert found.total.bytes >= sum(grid.bytes for grid in found.grids)


def test_totals_are_those_of_everything(folder):
    """All files and pictures; and times of a flat picture that are shares of one with all that costs."""
    scene = load_scene(written(folder, CLOSE, PAGE + asset("ball", '{ type = "diffuse" }')))
    total = forecast(scene, make_plan(scene)).total
    assert total.of_bytes == sum((folder / name).stat().st_size for name in ("ball.zarr.zip", "page.png"))
    assert total.bytes < 0.5 * total.of_bytes
    assert total.seconds.drjit < 0.6 * total.of_seconds.drjit and total.seconds.numpy < 0.95 * total.of_seconds.numpy
    larger = scene.model_copy(update={"film": scene.film.model_copy(update={"size": (16, 12)})})
    assert forecast(larger, make_plan(larger)).total.seconds.numpy == pytest.approx(4 * total.seconds.numpy)


def test_everything_planned_is_everything(folder):
    """A picture that records all there is has nothing to save."""
    outputs = "rgb,Z,P,N,curvature,part,uv,chart,duv_dx,duv_dy,lod,lod_invariant,ellipse,nonlinearity,flags"
    scene = load_scene(written(folder, CLOSE, PAGE + asset("sphere", PAPER), outputs))
    total = forecast(scene, make_plan(scene)).total
    assert total.seconds == total.of_seconds


def test_grids_that_do_not_exist(folder, call):
    path = written(folder, CLOSE, asset("ball") + asset("none"))
    scene = load_scene(path)
    there, absent = forecast(scene, make_plan(scene)).grids
    assert there.bytes > 0 and there.reachable == there.of_bricks and not absent.opened and absent.of_bricks is None
    code, out, err = call("plan", path)
    assert code == 0 and err == "" and "does not exist yet" in out


def test_the_command_says_it_all(folder, call, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    path = written(folder, *SCENES["one out of sight"][:3])
    code, out, err = call("plan", path, "--json")
    record = json.loads(out)
    ball, mirror = record["grids"]
    assert code == 0 and err == "" and not mirror["opened"] and 0 < ball["reachable"] < ball["bricks"]
    assert record["total"]["bytes"] == ball["bytes"] + mirror["bytes"] < record["total"]["of_bytes"]
    code, out, _ = call("plan", path)
    lines = {line.split("│")[1].strip(): line for line in out.splitlines() if line.startswith("│")}
    assert code == 0 and f"{ball['reachable']:,}" in lines["bricks that rays can reach"]
    assert "not opened" in lines["mirror.zarr.zip"] and "no ray can meet it" in lines["mirror.zarr.zip"]
    assert f"{record['total']['bytes']:,}" in lines["TOTAL bytes"]
    assert {"TOTAL seconds on drjit", "TOTAL seconds on numpy"} <= set(lines)


def test_needs_say_nothing_of_grids_that_are_there(folder, call, tmp_path):
    path = written(folder, CLOSE, asset("ball"))
    code, out, _ = call("plan", path, "--needs", tmp_path / "needs.json", "--json")
    assert code == 0 and "grids" not in json.loads(out)
