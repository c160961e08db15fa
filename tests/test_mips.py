"""Mip levels that footprints can reach: bounds that no look-up falls below, and pictures that they leave alone."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from scenery import sdfrender_caller

from datasets_synthetic import shape
from sdfbake import Grid, Mesh, bake
from sdfbake.metadata import Sign
from sdfbake.stretch import stretch_of, stretches
from sdfrender import GridField, mips
from sdfrender.camera import Camera, OrthographicCamera
from sdfrender.forecast import forecast
from sdfrender.plan import make_plan
from sdfrender.render import shoot
from sdfrender.scene import load_scene
from sdfrender.stage import prepare
from sdfrender.viewing import CameraView, GivenView

SIZE = (256, 128)  # texels


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A box, whose normals are askew to its faces along edges, and a torus; a texture of noise, that shows a change."""
    folder = tmp_path_factory.mktemp("mips")
    noise = np.random.default_rng(3).integers(0, 256, (SIZE[1], SIZE[0], 3), np.uint8)
    Image.fromarray(noise).save(folder / "noise.png")
    bake(unwrapped(trimesh.creation.box((1.0, 0.8, 0.6))), 32).save(folder / "box.zarr.zip")
    bake(shape("torus").mesh(0.15), 40).save(folder / "torus.zarr.zip")
    Grid.from_function(shape("sphere"), 24).save(folder / "ball.zarr.zip")
    return folder


def unwrapped(box):
    """Texture coordinates by the two axes along each face: 0.3 per unit along one, 0.2 along the other."""
    p = np.asarray(box.vertices)[box.faces]
    along = np.array([[1, 2], [0, 2], [0, 1]])[np.abs(box.face_normals).argmax(axis=1)]
    uv = np.take_along_axis(p, along[:, None, :], axis=2) * [0.3, 0.2] + 0.5
    return Mesh(np.asarray(box.vertices), box.faces, uv)


def test_stretch_of_a_box():
    least, greatest = stretch_of(unwrapped(trimesh.creation.box((1.0, 0.8, 0.6))), Sign())
    assert (least, greatest) == pytest.approx((0.2, 0.3), rel=1e-14)


def test_stretches_are_singular_values(rng):
    """Those of U E^+. Faces 1e6 times as long as wide lose six of sixteen digits, once for each of two edges."""
    corner, uv = rng.normal(size=(200, 3, 3)), rng.normal(size=(200, 3, 2))
    corner[100:, 2] = corner[100:, 1] + 1e-6 * corner[100:, 2]
    edges, sides = (np.swapaxes(x[:, 1:] - x[:, :1], 1, 2) for x in (corner, uv))
    greatest, least = np.linalg.svd(sides @ np.linalg.pinv(edges, rcond=1e-12), compute_uv=False).T
    ours = stretches(corner, uv)
    np.testing.assert_allclose(ours[0], least, rtol=1e-6)
    np.testing.assert_allclose(ours[1], greatest, rtol=1e-8)


def test_stretch_of_what_bounds_nothing():
    box = unwrapped(trimesh.creation.box())
    flat = np.concatenate([box.faces, [[0, 0, 1]]])
    assert stretch_of(box.with_(uv=0 * box.uv), Sign())[0] == 0
    assert stretch_of(Mesh(box.vertices, flat, np.concatenate([box.uv, box.uv[:1]])), Sign())[0] == 0
    assert stretch_of(Mesh(box.vertices, box.faces), Sign()) is None
    assert stretch_of(box, Sign(method="winding", checked=10, disagree=0.1)) is None
    torn = unwrapped(trimesh.Trimesh(box.vertices, box.faces[1:]))
    assert bake(torn, 16, open="winding").metadata.stretch is None
    assert bake(box, 16, uv_mode="grid").metadata.stretch is None


SCENE = """
background = [0.2, 0.4, 0.6]
[camera]
{camera}
[film]
size = [{size}, {size}]
outputs = [{outputs}]
{film}
[trace]
bounces = 1
[[textures]]
name = "noise"
image = "noise.png"
filter = "{filter}"
wrap = "repeat"
anisotropy = {most}
{assets}
"""
PAPER = '{ type = "diffuse", texture = "noise" }'
FAR = "position = [3.0, 5.0, 12.0]\ntarget = [0.0, 0.1, 0.0]\nfov = 26.0"
FARTHER = FAR.replace("26.0", "90.0")
FLAT = 'type = "orthographic"\nposition = [3.0, 5.0, 12.0]\ntarget = [0.0, 0.1, 0.0]\nheight = 5.0'


def asset(grid, material=PAPER, *more):
    return "\n".join(["[[assets]]", f'grid = "{grid}.zarr.zip"', f"materials = [{material}]", *more, ""])


def written(folder, camera, assets, outputs="rgb", filtering="trilinear", film="", size=16, most=16.0):
    asked = ", ".join(f'"{name}"' for name in outputs.split(","))
    path = folder / "mips.toml"
    path.write_text(
        SCENE.format(camera=camera, size=size, outputs=asked, film=film, filter=filtering, most=most, assets=assets)
    )
    return path


# camera, assets, outputs, filter, film, greatest ratio of an ellipse
FEWER = {
    "box": (FAR, asset("box"), "rgb,flags", "trilinear", "", 16.0),
    "torus": (FAR, asset("torus"), "rgb,lod,flags", "trilinear", "", 16.0),
    "orthographic": (FLAT, asset("torus"), "rgb", "trilinear", "", 16.0),
    "samples": (FAR, asset("torus"), "rgb", "trilinear", "supersample = 2\nseed = 3\n", 16.0),
    "placed": (FAR, asset("torus", PAPER, "scale = 0.4", "rotate = [1, 2, 3, 50]"), "rgb", "trilinear", "", 16.0),
    "two": (FAR, asset("box") + asset("torus", PAPER, "translate = [0, 0, -3]"), "rgb", "trilinear", "", 16.0),
    "one of two in sight": (
        FAR,
        asset("torus") + asset("ball", PAPER, "translate = [50, 0, 0]"),
        "rgb",
        "trilinear",
        "",
        16.0,
    ),
    "ellipses": (FARTHER, asset("torus"), "rgb,flags", "anisotropic", "", 2.0),
}


@pytest.fixture(scope="module")
def fields(folder):
    return {
        name: GridField(Grid.load(folder / f"{name}.zarr.zip"), engine="numpy") for name in ("box", "torus", "ball")
    }


def whole(path, fields):
    """The scene with all mip levels: of surfaces that are given nothing is known."""
    scene = load_scene(path)
    names = [asset.grid.name.partition(".")[0] for asset in scene.assets]
    stage = prepare(scene, field=[fields[name] for name in names])
    assert [known.first for known in stage.plan.levels] == [0]
    return stage


@pytest.mark.parametrize("case", FEWER.values(), ids=FEWER)
def test_fewer_levels_are_the_same_picture(folder, fields, case):
    path = written(folder, *case[:2], outputs=case[2], filtering=case[3], film=case[4], most=case[5])
    stage = prepare(path, engine="numpy")
    (known,) = stage.plan.levels
    assert 0 < known.first < known.last == 8
    everything = whole(path, fields)
    (ours, theirs) = (each.samplers["noise"]._texels._channels[0].size for each in (stage, everything))
    assert ours <= theirs // 4**known.first + 100
    planned, full = shoot(stage), shoot(everything)
    for name, array in planned.items():
        np.testing.assert_array_equal(array, full[name], err_msg=name)
    assert np.ptp(planned["rgb"]) > 0.1
    assert forecast(load_scene(path), make_plan(load_scene(path))).plan.levels == stage.plan.levels


def test_too_many_levels_left_out_are_seen(folder, fields, monkeypatch):
    path = written(folder, FAR, asset("torus"))
    monkeypatch.setattr(mips, "MARGIN", -3.0)
    assert not np.array_equal(shoot(prepare(path, engine="numpy"))["rgb"], shoot(whole(path, fields))["rgb"])


@pytest.mark.parametrize("grid", ["box", "torus"])
def test_no_footprint_falls_below_the_bound(folder, fields, rng, grid):
    """Random cameras of all kinds, near and far: the least level of any pixel is at least the bound, and not far above.

    Along a box's edges normals are askew to faces, at its silhouettes footprints are long.
    """
    field, excess = fields[grid], []
    told = (field.grid.lattice, field.grid.metadata)
    scene = load_scene(written(folder, FAR, asset(grid), "rgb,lod"))
    texture = scene.texture("noise")
    for number in range(24):
        eye = tuple((rng.uniform(1.2, 9.0) * (e := rng.normal(size=3)) / np.linalg.norm(e)).tolist())
        size = tuple(rng.integers(5, 40, 2).tolist())
        camera = (
            OrthographicCamera(eye, (0.0, 0.0, 0.0), height=float(rng.uniform(0.5, 3.0)), size=size)
            if number % 4 == 0
            else Camera(eye, tuple(rng.uniform(-0.3, 0.3, 3).tolist()), fov=float(rng.uniform(5, 140)), size=size)
        )
        view = CameraView(camera, 1, None)
        stage = prepare(scene, field=field, view=view)
        found = mips.grounds(scene, stage.plan, view, [told], lambda _: field.grid.bricks)
        (ground,) = found
        if ground.depth <= 0:
            continue
        bound = mips.finest(texture, min(SIZE) * mips.spread(view, ground.depth) * ground.stretch)
        lod = shoot(replace(stage, plan=replace(stage.plan, outputs=("lod",))))["lod"]
        hit = lod != 0
        if hit.any():
            excess.append(lod[hit].min() - bound)
    assert len(excess) > 12 and min(excess) >= 0
    # Half a level for two columns, one for texels twice as wide as high; the stretch, depths within a brick or two.
    assert np.median(excess) < 2.5 + np.log2(1.5 if grid == "box" else 3.4)


@pytest.mark.parametrize("camera", [Camera((0, 0, 4), (0.3, 0.2, 0), fov=100, size=(31, 17)),
                                    OrthographicCamera((0, 0, 4), (0.3, 0.2, 0), height=3.0, size=(31, 17))],
                         ids=["pinhole", "orthographic"])  # fmt: skip
def test_spread_is_the_least_of_the_picture(camera):
    """Half-lines one step apart, at depth 2 along the view, by the beams' own derivatives; the least is in a corner."""
    view = CameraView(camera, 2, None)
    rays, forward = camera.rays(), camera.frame()[0]
    t = 2.0 / (rays.d @ forward)[:, None]
    steps = np.stack([rays.dp_dx + t * rays.dd_dx, rays.dp_dy + t * rays.dd_dy], axis=-1) / 2
    least = np.linalg.svd(steps, compute_uv=False)[:, 1].min()
    assert mips.spread(view, 2.0) <= least < 1.1 * mips.spread(view, 2.0)


MIRROR = asset("ball", '{ type = "mirror" }')
ALL = {
    "mirror": (FAR, asset("torus") + MIRROR, "rgb", "mirrors and glass"),
    "interpolated": (FAR, asset("ball"), "rgb", "as grid are bounded by no face"),
    "close": ("position = [0.0, 0.0, 0.9]\ntarget = [0.3, 0.1, 0.0]\nfov = 60.0", asset("box"), "rgb", "texels long"),
    "inside": ("position = [0.75, 0.0, 0.3]\ntarget = [0.0, 0.1, 0.9]\nfov = 90.0", asset("torus"), "rgb", "among"),
}


@pytest.mark.parametrize(("camera", "assets", "outputs", "says"), ALL.values(), ids=ALL)
def test_why_all_levels_are_kept(folder, camera, assets, outputs, says):
    scene = load_scene(written(folder, camera, assets, outputs))
    (known,) = forecast(scene, make_plan(scene)).plan.levels
    assert (known.first, known.last) == (0, 8) and says in known.reason


def test_what_is_not_looked_at_keeps_the_last_level(folder):
    aside = written(folder, FAR, asset("torus", PAPER, "translate = [90, 0, 0]"))
    (known,) = prepare(aside, engine="numpy").plan.levels
    assert known.first == 8 and "no surface that has it" in known.reason
    stage = prepare(written(folder, FAR, asset("torus"), "lod"), engine="numpy")
    (known,) = stage.plan.levels
    assert known.first == 8 and stage.samplers["noise"]._texels._channels[0].size == 1
    row = next(row for row in stage.plan.capabilities if row.what == "texture 'noise'")
    assert row.how == "its size alone"


def test_given_rays_have_no_bound(folder):
    scene = load_scene(written(folder, FAR, asset("torus")))
    view = GivenView(scene.camera.camera((16, 16)).rays(), (16, 16))
    (known,) = prepare(scene, engine="numpy", view=view).plan.levels
    assert known.first == 0 and "one by one" in known.reason


def test_older_grids_have_no_bound(folder):
    grid = Grid.load(folder / "torus.zarr.zip")
    replace(grid, metadata=grid.metadata.model_copy(update={"stretch": None})).save(folder / "old.zarr.zip")
    (known,) = prepare(written(folder, FAR, asset("old")), engine="numpy").plan.levels
    assert known.first == 0 and "old.zarr.zip does not say" in known.reason


def test_the_plan_says_the_levels(folder, monkeypatch, capsys):
    code, out, _ = sdfrender_caller(monkeypatch, capsys)("plan", written(folder, FAR, asset("torus")), "--json")
    record = json.loads(out)
    (known,) = record["levels"]
    row = next(row for row in record["capabilities"] if row["what"] == "texture 'noise'")
    assert code == 0 and row["how"] == f"mip levels {known['first']} to 8 of 0 to 8" and "away" in row["reason"]
