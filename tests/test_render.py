"""Pictures: grids against exact shapes, supersampling against shifted pictures, engines against each other."""

import numpy as np
import pytest
from scenery import furnish, mirror_scene, sphere_scene

from datasets_synthetic import shape
from sdfbake.complaint import BadInput
from sdfrender import Flag, render
from sdfrender.camera import Camera
from sdfrender.render import shoot
from sdfrender.scene import load_scene
from sdfrender.stage import prepare
from validate.exact import ShapeField

PAPER = '"diffuse", texture = "page"'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return furnish(tmp_path_factory.mktemp("scenes"))


def assert_pictures_agree(folder, ours, reference, mean, most):
    """Compare as floats; where they differ too much, leave the two and the difference behind."""
    difference = ours - reference
    if not (np.abs(difference).mean() <= mean and np.abs(difference).max() <= most):
        for name, array in (("ours", ours), ("reference", reference), ("difference", difference)):
            np.save(folder / f"{name}.npy", array)
        raise AssertionError(
            f"mean {np.abs(difference).mean():.3g} (limit {mean}), greatest {np.abs(difference).max():.3g} "
            f"(limit {most}); pictures in {folder}"
        )


def test_the_check_can_fail(tmp_path):
    black, white = np.zeros((2, 2, 3)), np.ones((2, 2, 3))
    assert_pictures_agree(tmp_path, black, black, 0, 0)
    with pytest.raises(AssertionError, match="pictures in"):
        assert_pictures_agree(tmp_path, black, white, 0.5, 2)
    assert np.array_equal(np.load(tmp_path / "difference.npy"), -white)


@pytest.mark.parametrize("material", ['"normals"', PAPER])
def test_a_grid_looks_like_its_shape(folder, tmp_path, choice, material):
    """The sphere at 32 samples. The mean allows for silhouette pixels (1 in 30) and, textured, cuts between charts.

    A silhouette pixel that flips differs by up to 1: the greatest difference is only bounded for what both show.
    """
    scene = sphere_scene(folder, material, outputs=("rgb", "Z"))
    ours = render(scene, engine=choice.engine.name, precision=choice.engine.precision)
    reference = render(scene, field=ShapeField(shape("sphere")))
    both = (ours["Z"] > 0) & (reference["Z"] > 0)
    assert np.count_nonzero((ours["Z"] > 0) != (reference["Z"] > 0)) <= 2
    limits = (2e-3, 5e-2) if "normals" in material else (3e-2, 1.0)
    assert_pictures_agree(tmp_path, ours["rgb"] * both, reference["rgb"] * both, *limits)
    assert np.abs(ours["Z"] - reference["Z"])[both].max() < 2e-2


def test_the_mirror_shows_what_the_exact_mirror_shows(folder, tmp_path):
    scene = mirror_scene(folder, outputs=("rgb", "uv", "duv_dx", "duv_dy", "lod", "flags", "part"))
    ours, reference = render(scene, engine="numpy"), render(scene, field=ShapeField(shape("mirror")))
    assert_pictures_agree(tmp_path, ours["rgb"], reference["rgb"], 3e-2, 1.0)
    same = (ours["part"] == reference["part"]) & (ours["part"] == 0) & (reference["uv"].any(axis=-1, keepdims=True))
    same &= (ours["flags"] == 0) & (reference["flags"] == 0)
    assert same.sum() > 60
    # Half the sheet is 3.4 voxels: its texture coordinates are affine in every stencil at its front and come back to
    # rounding. The mirror has a radius of 10.8 voxels: its curvature is good to about 1e-3 there.
    for name in ("duv_dx", "duv_dy"):
        a, b = ours[name][same[..., 0]], reference[name][same[..., 0]]
        error = np.linalg.norm(a - b, axis=-1) / np.linalg.norm(b, axis=-1)
        assert np.median(error) < 2e-3
    assert np.median(np.abs(ours["lod"] - reference["lod"])[same]) < 2e-3


@pytest.mark.parametrize("scene", ["mirror", "textured"])
def test_engines_agree(folder, choice, scene):
    """Float64: to 1e-10 relative, except where a rounding decides between two cells' charts; float32: in the mean."""
    outputs = ("rgb", "Z", "P", "N", "uv", "duv_dx", "duv_dy", "lod")
    path = mirror_scene(folder, outputs=outputs) if scene == "mirror" else sphere_scene(folder, PAPER, outputs=outputs)
    ours = render(path, engine=choice.engine.name, precision=choice.engine.precision)
    reference = render(path, engine="numpy", precision=64)
    for name, array in reference.items():
        scale = np.maximum(np.abs(array), np.abs(array).mean())
        error = np.abs(ours[name] - array) / scale
        if choice.engine.precision == 64:
            assert error.max() < 1e-10, (name, error.max())
        else:
            assert np.median(error) < 1e-3 and error.mean() < 5e-2, (name, error.mean())


def test_supersampling_is_the_mean_of_shifted_pictures(folder):
    """A picture of twice the size has its pixels where the four sub-pixels are: an independent route to them."""
    fine = render(sphere_scene(folder, size=(64, 64)), engine="numpy")["rgb"]
    mean = fine.reshape(32, 2, 32, 2, 3).mean(axis=(1, 3))
    ours = render(sphere_scene(folder, supersample=2), engine="numpy")["rgb"]
    assert np.abs(ours - mean).max() < 1e-12


def test_supersampled_footprints_are_those_of_sub_pixels(folder):
    """Textures are filtered for sub-pixels: the mean of the picture of twice the size, again."""
    fine = render(mirror_scene(folder, size=(64, 64)), engine="numpy")["rgb"]
    ours = render(mirror_scene(folder, supersample=2), engine="numpy")["rgb"]
    assert np.abs(ours - fine.reshape(32, 2, 32, 2, 3).mean(axis=(1, 3))).max() < 1e-10


def test_what_is_no_colour_does_not_depend_on_supersampling(folder):
    """Three by three sub-pixels have one in the middle: the same ray, derivatives still per pixel."""
    outputs = ("Z", "P", "N", "uv", "duv_dx", "duv_dy", "lod", "part")
    one, nine = (render(mirror_scene(folder, outputs=outputs, supersample=s), engine="numpy") for s in (1, 3))
    for name, array in one.items():
        assert nine[name] == pytest.approx(array, rel=1e-11, abs=1e-12), name
    assert np.abs(one["duv_dx"]).max() > 1e-3


def test_what_a_path_ends_on(folder):
    """No bounce left: black. Nothing hit: the background. A tinted mirror: the tint times what it shows."""
    background = (0.1, 0.2, 0.3)
    black = render(mirror_scene(folder, bounces=0, outputs=("rgb", "part")), engine="numpy")
    assert not black["rgb"][black["part"][..., 0] == 0].any()
    assert (black["rgb"][black["part"][..., 0] == -1] == background).all()
    white = render(mirror_scene(folder, outputs=("rgb", "part")), engine="numpy")
    tinted = render(mirror_scene(folder, tint=(0.5, 0.25, 1.0)), engine="numpy")
    mirror = white["part"][..., 0] == 0
    assert mirror.any() and not mirror.all()
    assert np.array_equal(tinted["rgb"][mirror], white["rgb"][mirror] * [0.5, 0.25, 1.0])
    assert np.array_equal(tinted["rgb"][~mirror], white["rgb"][~mirror])


def test_normals_as_colours_and_the_first_hit(folder):
    scene = sphere_scene(folder, outputs=("rgb", "Z", "P", "N", "part", "flags"))
    out = render(scene, engine="numpy")
    hit = out["Z"][..., 0] > 0
    assert (out["part"][..., 0] == np.where(hit, 0, -1)).all()
    assert np.array_equal(out["rgb"][hit], 0.5 * out["N"][hit] + 0.5)
    rays = Camera((0.0, 0.0, 1.9), (0.0, 0.0, 0.0), fov=53.13, size=(32, 32)).rays()
    along = rays.p.reshape(32, 32, 3) + out["Z"] * rays.d.reshape(32, 32, 3)
    assert np.abs(out["P"] - along)[hit].max() < 1e-13
    assert ((out["flags"][..., 0].astype(int) & Flag.MISS) > 0).tolist() == (~hit).tolist()
    assert not out["P"][~hit].any() and not out["N"][~hit].any()
    # y goes down the picture: the upper half shows normals that point up.
    assert out["N"][8, 16, 1] > 0.2 > -0.2 > out["N"][24, 16, 1] and out["N"][16, 24, 0] > 0.2


def test_a_far_camera_sees_the_same(folder, choice):
    """Ten thousand radii away, through a lens of 0.01 degree: float32 keeps the place to a fortieth of the radius.

    Positions are brought to the box in float64 elsewhere; here the camera's beam is made on the engine.
    """
    scene = load_scene(sphere_scene(folder, outputs=("P", "Z")))
    far = scene.camera.model_copy(update={"position": (0.0, 0.0, 1e4), "fov": 0.012})
    scene = scene.model_copy(update={"camera": far})
    ours = render(scene, engine=choice.engine.name, precision=choice.engine.precision)
    reference = render(scene, field=ShapeField(shape("sphere")))
    both = (ours["Z"] > 0) & (reference["Z"] > 0)
    assert both.sum() > 300
    assert np.abs((ours["P"] - reference["P"]) * both).max() < 2e-2


def test_progress_and_rendering_twice(folder):
    seen = []
    stage = prepare(sphere_scene(folder, supersample=2), engine="numpy")
    first = shoot(stage, lambda done, total: seen.append((done, total)))
    assert seen == [(0, 1)]
    assert np.array_equal(first["rgb"], shoot(stage)["rgb"])


def test_what_is_missing_says_so(folder):
    bare = sphere_scene(folder, PAPER)
    text = bare.read_text()
    bare.write_text(text.replace("sphere.zarr.zip", "bare.zarr.zip"))
    with pytest.raises(BadInput, match=r"bare\.zarr\.zip has no texture coordinates"):
        render(bare, engine="numpy")
    bare.write_text(text.replace("sphere.zarr.zip", "none.zarr.zip"))
    with pytest.raises(BadInput, match=r"none\.zarr\.zip"):
        render(bare, engine="numpy")
    bare.write_text(text.replace("page.png", "none.png"))
    with pytest.raises(BadInput, match=r"none\.png"):
        render(bare, engine="numpy")
    bare.write_text(text.replace('type = "diffuse"', 'type = "diffuse", part = "head"'))
    with pytest.raises(BadInput, match="no part 'head'"):
        render(bare, engine="numpy")
    mirror = mirror_scene(folder)
    mirror.write_text(mirror.read_text().replace('{ type = "diffuse", part = "sheet", texture = "page" },', ""))
    with pytest.raises(BadInput, match="part 'sheet'.*no material"):
        render(mirror, engine="numpy")


def test_a_texture_of_one_colour_asks_for_no_coordinates(folder):
    """It is multiplied into the material's colour: on a grid without texture coordinates, too."""
    path = sphere_scene(folder, '"diffuse", colour = [0.5, 1.0, 2.0], texture = "paint"')
    text = path.read_text().replace("sphere.zarr.zip", "bare.zarr.zip").replace('name = "page"\nimage = "page.png"', "")
    paint = '[[textures]]\nname = "paint"\ntype = "constant"\ncolour = [0.25, 0.5, 0.1]\n'
    path.write_text(text.replace('[[textures]]\n\nfilter = "trilinear"\n', paint))
    out = render(path, engine="numpy")["rgb"]
    assert np.allclose(np.unique(out.reshape(-1, 3), axis=0), [[0, 0, 0], [0.125, 0.5, 0.2]], atol=1e-15)


def test_one_field_serves_all_places_of_a_grid(folder):
    """A mirror needs the distances alone; the textured ball of the same file has them, too."""
    path = sphere_scene(folder, PAPER)
    mirror = '[[assets]]\ngrid = "sphere.zarr.zip"\ntranslate = [0.0, 0.0, -2.0]\nmaterials = [{ type = "mirror" }]\n'
    path.write_text(path.read_text() + mirror)
    stage = prepare(path, engine="numpy")
    textured, moved = stage.members
    assert moved.field is textured and textured.grid.uv is not None
    assert stage.plan.assets[1].channels == ("distance",)
