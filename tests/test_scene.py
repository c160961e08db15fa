"""Scenes: every mistake is one sentence that names the file, the key and what to do."""

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
        ('"bspline"', '"bspline"\nbounces = 65', "trace.bounces"),
        ('"bspline"', '"bspline"\nbounces = -1', "trace.bounces"),
        ('texture = "page"', 'texture = "paper"', "no texture 'paper'.*page"),
        (
            '[{ type = "diffuse", texture = "page" }]',
            '[{type="mirror", part="a"}, {type="normals", part="a"}]',
            "part 'a'",
        ),
        ('[{ type = "diffuse", texture = "page" }]', '[{type="mirror"}, {type="normals"}]', r"part '\*'"),
        ('[{ type = "diffuse", texture = "page" }]', "[]", "materials"),
        ('type = "diffuse"', 'type = "glass"', "glass|materials"),
        (
            "[[textures]]",
            '[[textures]]\nname = "page"\nimage = "b.png"\n[[textures]]',
            "two textures are called 'page'",
        ),
        ('"page.png"', '"page.png"\nfilter = "cubic"', "filter"),
        ('"page.png"', '"page.png"\nwrap = "mirror"', "wrap"),
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
        ("[[assets]]", "[[assets]]\ngrid = 'b.zarr.zip'\nmaterials = [{type='mirror'}]\n[[assets]]", "assets"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, says):
    load(tmp_path, GOOD)
    assert old in GOOD
    with pytest.raises(BadInput, match=says) as caught:
        load(tmp_path, GOOD.replace(old, new, 1))
    said = str(caught.value)
    assert "scene.toml" in said and "\n" not in said and len(said) < 500


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
    assert made.trace.kernel == "bspline" and made.trace.bounces == 1 and made.trace.tension == 0.5
    assert made.camera.fov == 45 and made.camera.up == (0, 1, 0) and made.background == (0, 0, 0)
    assert made.textures[0].filter == "trilinear" and made.textures[0].wrap == "clamp"


def test_overrides(tmp_path):
    made = load(tmp_path, GOOD)
    changed = made.with_(size=(3, 4), outputs=("Z",), kernel="linear")
    assert (changed.film.size, changed.film.outputs, changed.trace.kernel) == ((3, 4), ("Z",), "linear")
    assert made.film.size == (8, 8) and changed.assets == made.assets
    assert made.with_(size=None, outputs=None, kernel=None) == made
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
