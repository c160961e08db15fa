"""Bricks that rays can meet: enough of them for every ray, few of them, and the same picture to the last bit."""

import json
import zipfile
from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenery import furnish, sdfrender_caller

from datasets_synthetic import shape
from sdfbake import Grid
from sdfrender import GridField, sharing
from sdfrender import stage as staging
from sdfrender.camera import Camera, OrthographicCamera
from sdfrender.instance import Instance
from sdfrender.kernels import kernel
from sdfrender.plan import make_plan
from sdfrender.rays import Rays
from sdfrender.reach import Sight, frusta, needed
from sdfrender.render import shoot
from sdfrender.scene import load_scene
from sdfrender.similarity import IDENTITY, Similarity
from sdfrender.stage import prepare
from sdfrender.unseen import Unseen
from sdfrender.viewing import CameraView, GivenView


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = furnish(tmp_path_factory.mktemp("reach"), mirror=False)
    Grid.from_function(shape("sphere"), 64).save(folder / "ball.zarr.zip")
    Grid.from_function(shape("mirror"), 48).save(folder / "pair.zarr.zip")
    return folder


@pytest.fixture
def call(monkeypatch, capsys):
    return sdfrender_caller(monkeypatch, capsys)


@pytest.fixture(scope="module")
def ball(folder):
    return Grid.load(folder / "ball.zarr.zip")


TURNED = Similarity.of_parts(0.7, (1.0, 2.0, -1.0, 40.0), (0.3, -0.2, 0.1))
CAMERAS = {
    "pinhole": Camera((0.2, 0.3, 2.5), (0.3, 0.1, 0.0), fov=12, size=(9, 7)),
    "wide": Camera((0.2, 0.3, 1.5), (0.3, 0.1, 0.0), fov=170, size=(9, 7)),
    "inside": Camera((0.1, 0.0, 0.2), (1.0, 0.4, 0.3), fov=25, size=(5, 7)),
    "orthographic": OrthographicCamera((0.5, 0.4, 0.2), (0.0, 0.1, -1.0), height=0.3, size=(9, 5)),
    "away": Camera((0.0, 0.0, 2.0), (0.0, 0.0, 3.0), fov=60, size=(9, 7)),
}


def rays_of(camera, rng, count):
    """Rays through anything in the picture: origins and directions, by the camera's own words."""
    view, right, down = camera.frame()
    x, y = (rng.uniform(-n / 2, n / 2, count)[:, None] for n in camera.size)
    across, p = x * right + y * down, np.tile(np.array(camera.position), (count, 1))
    return (p + across, np.tile(view, (count, 1))) if isinstance(camera, OrthographicCamera) else (p, view + across)


def met_by(grid, placed, p, d, rng):
    """Bricks that rays come into, by points on them."""
    along = p[:, None] + rng.uniform(0, 6, (len(p), 400, 1)) * d[:, None]
    at = np.floor(grid.lattice.to_grid(placed.to_local(along.reshape(-1, 3)))).astype(int)
    at = at[((at >= 0) & (at < np.array(grid.lattice.shape) - 1)).all(axis=1)] // 8
    slot = grid.bricks.slot[tuple(at.T)]
    return np.isin(np.arange(len(grid.bricks)), slot[slot >= 0])


@pytest.mark.parametrize("placed", [IDENTITY, TURNED], ids=["still", "turned"])
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_no_ray_leaves_what_is_in_sight(ball, rng, camera, placed):
    sight = Sight.of(frusta(CameraView(camera, 1, None)), placed, ball.lattice, 2.0)
    met, found = met_by(ball, placed, *rays_of(camera, rng, 600), rng), sight.meets(ball.bricks)
    assert not (met & ~found).any()
    if camera in (CAMERAS["pinhole"], CAMERAS["orthographic"]):  # where rays are dense enough to be counted on
        # A voxel of margin on 8: at most the bricks next to those that are met.
        table = np.zeros(ball.bricks.slot.shape, bool)
        table[tuple(ball.bricks.index[met].T)] = True
        assert not (found & ~needed_by_hand(table, ball)).any() and 0 < found.sum() < 0.5 * len(found)
    assert sight.meets_lattice(ball.lattice) == (camera is not CAMERAS["away"])
    assert camera is not CAMERAS["away"] or not found.any()


def needed_by_hand(table, grid):
    near = np.zeros(np.add(table.shape, 2), bool)
    for step in np.ndindex(3, 3, 3):
        near[tuple(slice(s, s + n) for s, n in zip(step, table.shape, strict=True))] |= table
    return near[1:-1, 1:-1, 1:-1][tuple(grid.bricks.index.T)]


def test_needed_are_those_in_sight_and_around(ball):
    """All neighbours of bricks in sight, and no brick but those and some 10 voxels from a ray."""
    sight = Sight.of(frusta(CameraView(CAMERAS["pinhole"], 1, None)), IDENTITY, ball.lattice, 2.0)
    table = np.zeros(ball.bricks.slot.shape, bool)
    table[tuple(ball.bricks.index[sight.meets(ball.bricks)].T)] = True
    found, beside = needed([sight], ball.bricks), replace(sight, margin=sight.margin + 10).meets(ball.bricks)
    around = needed_by_hand(table, ball)
    assert (
        not (around & ~found).any() and not (beside & ~found & ~around).any() and not (found & ~around & ~beside).any()
    )
    assert table.sum() < found.sum() < len(found)
    other = Sight.of(frusta(CameraView(CAMERAS["orthographic"], 1, None)), IDENTITY, ball.lattice, 2.0)
    assert np.array_equal(needed([sight, other], ball.bricks), found | needed([other], ball.bricks))


def given(p, d):
    nothing = np.zeros_like(p)
    return Rays(p, d / np.linalg.norm(d, axis=1, keepdims=True), nothing, nothing, nothing, nothing)


def test_given_rays_stay_in_sight(ball, rng):
    """Origins and directions scattered, in a picture of 6 x 5 and in a list."""
    p = np.array([0.0, 0.2, 2.0]) + 0.1 * rng.normal(size=(30, 3))
    d = np.array([0.1, 0.0, -1.0]) + 0.05 * rng.normal(size=(30, 3))
    for size in ((6, 5), (30, 1), (1, 30)):
        sight = Sight.of(frusta(GivenView(given(p, d), size)), TURNED, ball.lattice, 2.0)
        met, found = met_by(ball, TURNED, p, d, rng), sight.meets(ball.bricks)
        assert not (met & ~found).any() and 0 < met.sum() <= found.sum() < len(found)


def test_rays_in_all_directions_may_meet_everything(rng):
    d = rng.normal(size=(400, 3))
    assert frusta(GivenView(given(np.zeros((400, 3)), d), (400, 1))) is None
    assert frusta(GivenView(given(np.zeros((2, 3)), np.array([[1.0, 0, 0], [-1.0, 0, 0]])), (1, 2))) is not None


def test_rounding_of_a_large_scene_is_allowed_for(ball):
    """Eleven halves of float32's eps of the scene's size (docs/tracing.md) beside a voxel."""
    size = 1e6 * ball.lattice.spacing
    sight = Sight.of(frusta(CameraView(CAMERAS["pinhole"], 1, None)), IDENTITY, ball.lattice, size)
    assert sight.margin == pytest.approx(1 + 11 * 2.0**-24 * 1e6)


def _ball(grid="ball", material='{ type = "normals" }', *more):
    return "\n".join(["[[assets]]", f'grid = "{grid}.zarr.zip"', f"materials = [{material}]", *more, ""])


CLOSE = "[camera]\nposition = [0.2, 0.3, 2.5]\ntarget = [0.25, 0.15, 0.0]\nfov = 6.0\n"
FLAT = '[camera]\ntype = "orthographic"\nposition = [0.2, 0.3, 2.5]\ntarget = [0.2, 0.3, 0.0]\nheight = 0.3\n'
WITHIN = "[camera]\nposition = [0.1, 0.2, 0.79]\ntarget = [0.6, 0.6, 0.4]\nfov = 20.0\n"
CORE = "[camera]\nposition = [0.1, 0.2, 0.1]\ntarget = [0.6, 0.6, 0.4]\nfov = 20.0\n"
PAGE = '[[textures]]\nname = "page"\nimage = "page.png"\nfilter = "trilinear"\n'
PAPER = '{ type = "diffuse", texture = "page" }'
SUN = '[[lights]]\ntype = "directional"\ndirection = [-1.0, -1.0, -1.0]\nshadows = false\n'
PLACED = ("scale = 0.8", "rotate = [1.0, 2.0, -1.0, 40.0]", "translate = [0.1, 0.1, -0.2]")
ASIDE = "translate = [9.0, 0.0, 0.0]"
TWO = (_ball(), _ball("ball", '{ type = "normals" }', "translate = [0.55, 0.3, -1.0]"))
# camera, film, outputs, what follows
SCENES = {
    "close-up": (CLOSE, "", "rgb,Z,N,P,curvature,flags", _ball()),
    "only the distance": (CLOSE, "", "Z", _ball()),
    "orthographic": (FLAT, "", "rgb,Z", _ball()),
    "camera in a brick": (WITHIN, "", "rgb,Z", _ball()),
    "camera in the solid": (CORE, "", "rgb,Z", _ball()),
    "samples": (CLOSE, "supersample = 2\n", "rgb,N", _ball()),
    "seeded samples": (CLOSE, "supersample = 2\nseed = 4\n", "rgb,N", _ball()),
    "turned": (CLOSE, "", "rgb,Z,flags", _ball("ball", '{ type = "normals" }', *PLACED)),
    "two places": (CLOSE, "", "rgb,Z,part", "".join(TWO)),
    "texture": (CLOSE, "", "rgb,uv,lod,flags", PAGE + _ball("ball", PAPER)),
    "light without shadows": (CLOSE, "", "rgb", SUN + _ball("ball", '{ type = "diffuse" }')),
    "beside one out of sight": (CLOSE, "", "rgb,Z,part", _ball("pair", '{ type = "normals" }', ASIDE) + _ball()),
    "texture beside one": (CLOSE, "", "rgb,uv,flags", PAGE + _ball("sphere", PAPER, ASIDE) + _ball("ball", PAPER)),
    "linear": (CLOSE, "", "rgb,Z", '[trace]\nkernel = "linear"\n' + _ball()),
    "catmull-rom": (CLOSE, "", "rgb,Z", '[trace]\nkernel = "catmull-rom"\n' + _ball()),
}


def written(folder, scene, size=(9, 7)):
    camera, film, outputs, rest = scene
    asked = ", ".join(f'"{name}"' for name in outputs.split(","))
    text = f"background = [0.2, 0.4, 0.6]\n{camera}[film]\nsize = {list(size)}\n{film}outputs = [{asked}]\n{rest}"
    (folder / "reach.toml").write_text(text)
    return folder / "reach.toml"


def whole(path, view=None):
    """The scene with its grids loaded whole, all channels."""
    scene = load_scene(path)
    made = make_plan(scene)
    given_ = [copy(prepared(asset.grid, scene.trace.kernel)) for asset in made.assets]
    for field, asset in zip(given_, made.assets, strict=True):
        field.uv_mode = asset.uv_mode
    return prepare(scene, field=given_, view=view)


@cache
def prepared(grid, name):
    """A whole grid on NumPy, once for all tests: preparing it takes longer than the pictures."""
    return GridField(Grid.load(grid), kernel(name), "numpy")


def assert_equal(some, everything):
    planned, full = shoot(some), shoot(everything)
    assert list(planned) == list(full)
    for name, array in planned.items():
        assert np.array_equal(array, full[name]), name
        assert np.ptp(array) > 0 or name in ("flags", "part"), name


def left_out(stage):
    fields = [member.field if isinstance(member, Instance) else member for member in stage.members]
    return [field.grid.bricks.left_out for field in fields if isinstance(field, GridField)]


@pytest.fixture(scope="module")
def loadings():
    return {}


@pytest.fixture
def loaded_once(loadings, monkeypatch):
    """Load once what several scenes see alike: preparing grids takes longer than the pictures."""
    load = staging._load

    def memoized(scene, share, told, choice):
        stands = [(asset.scale, asset.rotate, asset.translate) for asset in scene.assets]
        key = repr((scene.camera, stands, scene.trace.kernel, share.needs, share.places))
        if key not in loadings:
            loadings[key] = load(scene, share, told, choice)
        return loadings[key]

    monkeypatch.setattr(staging, "_load", memoized)


@pytest.mark.usefixtures("loaded_once")
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_the_picture_is_that_of_whole_grids(folder, scene):
    path = written(folder, scene)
    some = prepare(path, engine="numpy")
    assert all(out.any() for out in left_out(some))
    assert_equal(some, whole(path))


def test_given_rays_see_the_same(folder):
    path = written(folder, SCENES["close-up"])
    view = GivenView(load_scene(path).camera.camera((9, 7)).rays(), (9, 7))
    some = prepare(path, engine="numpy", view=view)
    assert left_out(some)[0].any()
    assert_equal(some, whole(path, view))


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_too_small_a_reach_is_seen(folder, monkeypatch, share):
    """The frustum of a camera with a smaller field of view."""

    def smaller(view):
        return frusta(replace(view, camera=replace(view.camera, fov=share * view.camera.fov)))

    path = written(folder, (CLOSE.replace("6.0", "20.0"), "", "rgb,Z", _ball()))
    monkeypatch.setattr(sharing, "frusta", smaller)
    some = prepare(path, engine="numpy")
    monkeypatch.undo()
    with pytest.raises(AssertionError):
        assert_equal(some, whole(path))
    assert_equal(prepare(path, engine="numpy"), whole(path))


def test_a_grid_out_of_sight_stays_closed(folder, tmp_path):
    """Of its file the head alone is right, and its parts are counted all the same."""
    with zipfile.ZipFile(folder / "pair.zarr.zip") as old, zipfile.ZipFile(folder / "shell.zarr.zip", "w") as new:
        new.writestr("zarr.json", old.read("zarr.json"))
    scene = (CLOSE, "", "rgb,Z,part", _ball("shell", '{ type = "normals" }', ASIDE) + _ball())
    some = prepare(written(folder, scene), engine="numpy")
    assert isinstance(some.members[0].field, Unseen) and some.members[0].part_names == ("sphere", "sheet")
    (shell, closed), (_, read) = some.read
    assert shell.endswith("shell.zarr.zip") and closed.channels == () and closed.of_bricks is None
    assert 0 < read.bricks < read.of_bricks
    part = shoot(some)["part"]
    assert set(np.unique(part)) <= {-1, 2} and (part == 2).any()


def test_nothing_in_sight(folder):
    path = written(folder, (CLOSE, "", "rgb,Z,N,flags,part", _ball("ball", '{ type = "normals" }', ASIDE)))
    stage = prepare(path, engine="numpy")
    found = shoot(stage)
    expected = shoot(whole(path))
    assert all(np.array_equal(found[name], expected[name]) for name in expected)
    assert isinstance(stage.members[0].field, Unseen) and (found["part"] == -1).all()


ONWARD = {
    "mirror": _ball("ball", '{ type = "mirror" }'),
    "glass": _ball("ball", '{ type = "glass" }'),
    "shadows": SUN.replace("false", "true") + _ball("ball", '{ type = "diffuse" }'),
}


@pytest.mark.parametrize("rest", ONWARD.values(), ids=ONWARD)
def test_rays_that_go_on_may_meet_everything(folder, rest):
    path = written(folder, (CLOSE, "", "rgb", rest))
    stage = prepare(path, engine="numpy")
    assert left_out(stage) == [None] and stage.read[0][1].bricks == stage.read[0][1].of_bricks
    alone = prepare(written(folder, (CLOSE, "", "Z", rest)), engine="numpy")
    assert left_out(alone)[0].any() and "bricks out of sight" in [omission.what for omission in alone.plan.left_out]


def test_all_in_sight_is_the_whole_file(folder):
    stage = prepare(written(folder, (CLOSE.replace("6.0", "60.0"), "", "Z", _ball())), engine="numpy")
    assert left_out(stage) == [None]


def test_an_unseen_surface_answers_nothing(folder, choice):
    """Alone and beside others, on every engine."""
    path = written(folder, SCENES["texture beside one"], (6, 4))
    stage = prepare(path, engine=choice.engine.name, precision=choice.engine.precision)
    images = shoot(stage)
    assert all(np.isfinite(image).all() for image in images.values())
    alone = replace(stage, field=stage.members[0])
    assert not shoot(alone)["uv"].any()


def test_the_command_says_what_it_read(call, folder, tmp_path):
    path = written(folder, SCENES["beside one out of sight"])
    code, out, err = call("render", path, "-o", tmp_path / "a.exr", "--engine", "numpy", "--json")
    assert code == 0 and err == ""
    closed, read = json.loads(out)["read"]
    assert closed["channels"] == [] and closed["of_bricks"] is None and closed["bytes"] < 4000 < closed["of_bytes"]
    assert read["channels"] == ["distance"] and 0 < read["bricks"] < read["of_bricks"]
    assert read["bytes"] < 0.5 * read["of_bytes"] == 0.5 * (folder / "ball.zarr.zip").stat().st_size
    code, out, err = call("render", path, "-o", tmp_path / "a.exr", "--engine", "numpy")
    assert (code, out) == (0, "") and err.count("\n") == 1
    assert f"read {read['bricks']} of {read['of_bricks']} bricks" in err and "1 of 2 grids out of sight" in err
