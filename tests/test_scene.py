"""Scenes: every mistake is one sentence that names the file, the key and what to do."""

import numpy as np
import pytest
from scenery import mirror_scene, sphere_scene

from datasets_synthetic.scenes import scene, scene_names
from sdfbake.complaint import BadInput
from sdfrender.scene import load_scene

GOOD = """
[camera]
position = [0.0, 0.0, 2.0]
target = [0.0, 0.0, 0.0]
[film]
size = [8, 8]
[trace]
kernel = "bspline"
[[textures]]
name = "page"
image = "page.png"
[[assets]]
grid = "grids/a.zarr.zip"
materials = [{ type = "diffuse", texture = "page" }]
"""


def load(folder, text):
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path)


PAPER = '{ type = "diffuse", texture = "page" }'


def top(text):
    return "[camera]", f"{text}\n[camera]"


def light(text):
    return "[[assets]]", f"[[lights]]\n{text}\n[[assets]]"


def asset(text):
    return "[[assets]]", f"[[assets]]\n{text}"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[film]", "[film]\nwidth = 3", "film.width"),
        ("[camera]", 'sky = "blue"\n[camera]', "sky"),
        ("[trace]", "[trace]\nbounce = 2", "trace.bounce"),
        ('texture = "page"', 'texture = "page", shine = 1', "shine"),
        ("target = [0.0, 0.0, 0.0]", "", "camera.target"),
        ('grid = "grids/a.zarr.zip"', "", "grid"),
        ('"bspline"', '"cubic"', "trace.kernel"),
        ('"bspline"', '"catmull-rom"\ntension = 1.5', "trace.tension"),
        ('"bspline"', '"bspline"\nbounces = 1025', "trace.bounces"),
        ('"bspline"', '"bspline"\nbounces = -1', "trace.bounces"),
        ('texture = "page"', 'texture = "paper"', "no texture 'paper'.*page"),
        (
            '[{ type = "diffuse", texture = "page" }]',
            '[{type="mirror", part="a"}, {type="normals", part="a"}]',
            "part 'a'",
        ),
        ('[{ type = "diffuse", texture = "page" }]', '[{type="mirror"}, {type="normals"}]', r"part '\*'"),
        ('[{ type = "diffuse", texture = "page" }]', "[]", "materials"),
        ('type = "diffuse"', 'type = "glass"', r"'assets\.0\.materials\.0\.texture' that does not exist"),
        (
            "[[textures]]",
            '[[textures]]\nname = "page"\nimage = "b.png"\n[[textures]]',
            "two textures are called 'page'",
        ),
        ('"page.png"', '"page.png"\nfilter = "cubic"', "filter"),
        ('"page.png"', '"page.png"\nwrap = "mirrored"', "wrap"),
        ("[8, 8]", "[1000000, 1000]", "pixels"),
        ("[8, 8]", "[0, 8]", "film.size"),
        ("[8, 8]", "[8, -1]", "film.size"),
        ("[8, 8]", "[8]", "film.size"),
        ("[8, 8]", "[8.5, 8]", "film.size"),
        ("[8, 8]", "[8, 8]\nsupersample = 0", "supersample"),
        ("[8, 8]", '[8, 8]\noutputs = ["rgb", "depth"]', "outputs"),
        ("[8, 8]", "[8, 8]\noutputs = []", "outputs"),
        ("[8, 8]", '[8, 8]\noutputs = ["Z", "Z"]', "outputs"),
        ("[0.0, 0.0, 2.0]", "[0.0, 0.0]", "camera.position"),
        ("[0.0, 0.0, 2.0]", "[0.0, 0.0, nan]", "camera.position"),
        ("[0.0, 0.0, 2.0]", "[0.0, 0.0, inf]", "camera.position"),
        ("[camera]", "[camera]\nfov = 180.0", "camera.fov"),
        ("[camera]", '[camera]\nfov = "wide"', "camera.fov"),
        ("[camera]", "background = [nan, 0.0, 0.0]\n[camera]", "background"),
        ("[camera]", "[camera", "not TOML"),
        (*asset("matrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]]"), "'assets.0': the matrix is singular"),
        (*asset("matrix = [[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]"), "'assets.0': the matrix shears"),
        (*asset("matrix = [[1, 0, 0, 0], [0, 1, 0, 0]]"), r"'assets\.0\.matrix'"),
        (*asset("matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]"), r"'assets\.0\.matrix\.0'"),
        (*asset("matrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]]"), "'assets.0': the last row"),
        (*asset("scale = 2.0\nmatrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]"), "'assets.0': 'matrix' says all"),
        (*asset("scale = 0.0"), r"'assets\.0\.scale'"),
        (*asset("scale = -1"), r"'assets\.0\.scale'"),
        (*asset("scale = inf"), r"'assets\.0\.scale'"),
        (*asset("rotate = [0, 0, 0, 30]"), "'assets.0': the axis of the rotation has no length"),
        (*asset("rotate = [0, 0, 1]"), r"'assets\.0\.rotate': more numbers"),
        (*asset("translate = [0, 0]"), r"'assets\.0\.translate': more numbers"),
        (
            *light('type = "spot"\nposition = [0, 0, 0]'),
            r"'lights\.0\.type': there is no 'spot', choose one of 'point', 'dir",
        ),
        (*light("position = [0, 0, 0]"), r"lacks the key 'lights\.0\.type'"),
        (*light('type = "point"'), r"lacks the key 'lights\.0\.position'"),
        (*light('type = "directional"\ndirection = [0, 0, 0]'), r"'lights\.0\.direction': a direction needs a length"),
        (
            *light('type = "point"\nposition = [0, 0, 0]\nirradiance = [1, 1, 1]'),
            r"'lights\.0\.irradiance' that does not",
        ),
        (*light('type = "point"\nposition = [0, 0, 0]\nshadows = "soft"'), r"'lights\.0\.shadows'"),
        (
            "[[assets]]",
            '[[lights]]\ntype = "point"\nposition = [0, 0, 0]\n' * 65 + "[[assets]]",
            "'lights': .*64.*not 65",
        ),
        (
            *top('background = [0, 0, 0]\nenvironment = { image = "a.png" }'),
            "is wrong: an 'environment' takes the place",
        ),
        (*top("environment = { intensity = 2.0 }"), r"lacks the key 'environment\.image'"),
        (*top('environment = { image = "a.png", intensity = -1 }'), r"'environment\.intensity'"),
        (*top('environment = { image = "a.png", filter = "trilinear" }'), r"'environment\.filter'"),
        (PAPER, '{ type = "glass", index = 0 }', r"'assets\.0\.materials\.0\.index'"),
        (PAPER, '{ type = "glass", index = inf }', r"'assets\.0\.materials\.0\.index'"),
        (PAPER, '{ type = "metal" }', r"'assets\.0\.materials\.0\.type': there is no 'metal'"),
        (PAPER, '{ texture = "page" }', r"lacks the key 'assets\.0\.materials\.0\.type'"),
        (PAPER, '{ type = "mirror", colour = [1, 1] }', r"'assets\.0\.materials\.0\.colour': more numbers"),
        ('image = "page.png"', 'type = "noise"', r"'textures\.0\.type': there is no 'noise'"),
        ('image = "page.png"', 'type = "checker"\nsquares = [0, 4]', r"'textures\.0\.squares\.0'"),
        ('image = "page.png"', 'type = "checker"\nimage = "page.png"', r"'textures\.0\.image' that does not exist"),
        ('image = "page.png"', 'type = "constant"', r"lacks the key 'textures\.0\.colour'"),
        ('image = "page.png"', 'image = "page.png"\nanisotropy = 0.5', r"'textures\.0\.anisotropy'"),
        ('name = "page"', "", r"lacks the key 'textures\.0\.name'"),
        (
            "[camera]",
            '[camera]\ntype = "fisheye"',
            r"'camera\.type': there is no 'fisheye', choose one of 'pinhole', 'orth",
        ),
        ("[camera]", "[camera]\ntype = 3", r"'camera\.type': there is no '3'"),
        ("[camera]", '[camera]\ntype = "orthographic"', r"lacks the key 'camera\.height'"),
        ("[camera]", '[camera]\ntype = "orthographic"\nheight = 0', r"'camera\.height'"),
        ("[camera]", '[camera]\ntype = "orthographic"\nheight = 1\nfov = 40', r"'camera\.fov' that does not exist"),
        ("[camera]", "[camera]\nheight = 1", r"'camera\.height' that does not exist"),
        ('"bspline"', '"bspline"\nsplits = 9', r"'trace\.splits'"),
        ("[8, 8]", "[8, 8]\nseed = -1", r"'film\.seed'"),
        ("[8, 8]", "[8, 8]\nsupersample = 65", r"'film\.supersample'"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, says):
    load(tmp_path, GOOD)
    assert old in GOOD
    with pytest.raises(BadInput, match=says) as caught:
        load(tmp_path, GOOD.replace(old, new, 1))
    said = str(caught.value)
    assert "scene.toml" in said and "\n" not in said and len(said) < 500
    assert "()" not in said and ".pinhole." not in said and "union" not in said  # nothing of how it is checked


GLASSES = """
[[lights]]
type = "point"
position = [0, 3, 0]
[[lights]]
type = "directional"
direction = [0, -1, 0]
shadows = false
[[textures]]
name = "squares"
type = "checker"
[[textures]]
name = "grey"
type = "constant"
colour = [0.5, 0.5, 0.5]
[[assets]]
grid = "grids/b.zarr.zip"
scale = 2
rotate = [0, 1, 0, 90]
translate = [1, 2, 3]
materials = [{ type = "glass", index = 1.3 }, { type = "diffuse", part = "label", texture = "squares" }]
[[assets]]
grid = "grids/a.zarr.zip"
matrix = [[0, 0, 2, 1], [0, 2, 0, 2], [-2, 0, 0, 3], [0, 0, 0, 1]]
materials = [{ type = "mirror" }]
"""


def test_what_a_scene_may_hold(tmp_path):
    """Several assets, lights, an environment, all textures, a parallel camera; two ways to say one place."""
    text = GOOD.replace("[camera]", 'environment = { image = "sky.exr" }\n[camera]\ntype = "orthographic"\nheight = 2')
    made = load(tmp_path, text.replace('"page.png"', '"page.png"\nwrap = "mirror"\nfilter = "anisotropic"') + GLASSES)
    assert [texture.type for texture in made.textures] == ["image", "checker", "constant"]
    assert [light.type for light in made.lights] == ["point", "directional"] and made.camera.height == 2
    assert [light.shadows for light in made.lights] == [True, False] and made.textures[0].wrap == "mirror"
    assert made.environment.image == tmp_path / "sky.exr" and made.environment.filter == "anisotropic"
    first, second = made.assets[1].placed(), made.assets[2].placed()
    p = np.array([[0.3, -0.2, 0.7]])
    assert first.to_world(p) == pytest.approx(second.to_world(p), abs=1e-15) and made.assets[0].placed().is_identity
    assert len(made.materials) == 4 and made.bounces == 8


def test_bounces_where_a_scene_does_not_say(tmp_path):
    assert load(tmp_path, GOOD).bounces == 1
    assert load(tmp_path, GOOD.replace(PAPER, '{ type = "glass" }')).bounces == 8
    assert load(tmp_path, GOOD.replace('"bspline"', '"bspline"\nbounces = 0')).bounces == 0
    assert load(tmp_path, GOOD.replace('"bspline"', '"bspline"\nbounces = 1024')).bounces == 1024


def test_files_that_are_no_scene(tmp_path):
    with pytest.raises(BadInput, match=r"no scene .*none\.toml"):
        load_scene(tmp_path / "none.toml")
    with pytest.raises(BadInput, match="cannot be read"):
        load_scene(tmp_path)
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="cannot be read"):
        load_scene(tmp_path / "bytes.toml")
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(BadInput, match="lacks the key 'camera'"):
        load_scene(tmp_path / "empty.toml")


def test_paths_are_relative_to_the_scene(tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    made = load(tmp_path, GOOD)
    assert made.assets[0].grid == tmp_path / "grids/a.zarr.zip"
    assert made.textures[0].image == tmp_path / "page.png"
    absolute = load(tmp_path, GOOD.replace("grids/a", "/elsewhere/a"))
    assert str(absolute.assets[0].grid) == "/elsewhere/a.zarr.zip"


def test_defaults(tmp_path):
    made = load(tmp_path, GOOD.replace("[film]\nsize = [8, 8]", "").replace('kernel = "bspline"', ""))
    assert made.film.size == (512, 512) and made.film.outputs == ("rgb",) and made.film.supersample == 1
    assert made.trace.kernel == "bspline" and made.trace.bounces is None and made.bounces == 1
    assert made.trace.tension == 0.5 and made.trace.splits == 2 and made.film.seed is None and made.lights == ()
    assert made.camera.fov == 45 and made.camera.up == (0, 1, 0) and made.background == (0, 0, 0)
    assert made.textures[0].filter == "trilinear" and made.textures[0].wrap == "clamp"


def test_overrides(tmp_path):
    made = load(tmp_path, GOOD)
    changed = made.with_(size=(3, 4), outputs=("Z",), kernel="linear")
    assert (changed.film.size, changed.film.outputs, changed.trace.kernel) == ((3, 4), ("Z",), "linear")
    assert made.film.size == (8, 8) and changed.assets == made.assets
    assert made.with_(size=None, outputs=None, kernel=None) == made
    full = load(tmp_path, GOOD.replace("[camera]", 'environment = { image = "sky.exr" }\n[camera]') + GLASSES)
    assert full.with_(size=None, outputs=None, kernel=None) == full
    with pytest.raises(BadInput, match="no kernel 'cubic'"):
        made.with_(size=None, outputs=None, kernel="cubic")
    with pytest.raises(BadInput, match="command line.*film.size"):
        made.with_(size=(0, 4), outputs=None, kernel=None)


@pytest.mark.parametrize("name", scene_names())
def test_our_own_scenes_are_scenes(tmp_path, name):
    assert load(tmp_path, scene(name)).camera.camera((4, 4)).rays().d.shape == (16, 3)


def test_the_tests_scenes_are_scenes(tmp_path):
    assert load_scene(mirror_scene(tmp_path)).trace.bounces == 1
    assert load_scene(sphere_scene(tmp_path)).film.size == (32, 32)
