"""From a scene to what it needs, and from that to a grid: only what is needed, as fine as its pixels."""

import json

import numpy as np
import pytest
import trimesh
from scenery import sdfrender_caller
from test_bake_commands import run

from sdfbake import BadInput, Grid, Mesh
from sdfbake.gridfile import stored_bytes
from sdfbake.lattice import BAND
from sdfbake.meshfile import save
from sdfbake.needs import GridNeeds, Needs, Orthographic, Pinhole, load_needs
from sdfbake.resolving import FINEST, nearest_depth, resolution_for
from sdfrender.needs import needs_of
from sdfrender.render import render
from sdfrender.scene import load_scene

EYE = Pinhole(
    position=(0, 0, 5), view=(0, 0, -1), right=(1, 0, 0), down=(0, -1, 0), tangents=(0.4, 0.3), radians_per_pixel=0.01
)


def box(low, high):
    return _mesh(trimesh.creation.box(bounds=[low, high]))


def _mesh(shape):
    return Mesh(np.asarray(shape.vertices), shape.faces)


def needs(*cameras, name="a.zarr.zip", primary_only=True, **more):
    return GridNeeds(
        grid=name, kernel="bspline", band=BAND, primary_only=primary_only, cameras=cameras or (EYE,), **more
    )


# A mesh, and the depth at which the camera at z = 5 sees it first.
SEEN = {
    "inside a face": (box([-9, -3, -1], [20, 20, 1]), 4.0),  # no vertex and no edge is in view
    "a vertex": (_mesh(trimesh.creation.cone(0.5, 1.0).apply_translation([0, 0, 1])), 3.0),
    "behind": (box([-1, -1, 6], [1, 1, 7]), np.inf),
    "beside": (box([9, -1, 0], [11, 1, 1]), np.inf),
    "a half in view": (box([1.8, -0.1, 0], [9, 0.1, 1]), 4.5),  # x = 0.4 z at z = 4.5, above the face at depth 4
    "around the camera": (box([-1, -1, 3], [1, 1, 7]), 2.0),
    "through the camera": (box([-1, -1, 5], [1, 1, 7]), 0.0),
}


@pytest.mark.parametrize(("mesh", "depth"), SEEN.values(), ids=SEEN)
def test_nearest_depth(mesh, depth):
    """Closed forms; positions are of order 10, so that 1e-12 is a few thousand roundings."""
    assert nearest_depth(mesh, EYE) == pytest.approx(depth, abs=1e-12)


def test_nearest_depth_is_that_of_dense_points(rng):
    """No point of the surface in view is nearer, and one of many is nearly as near."""
    ball = trimesh.creation.icosphere(2)
    for _ in range(10):
        shape = ball.copy().apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        shape.apply_translation(rng.uniform(-2, 2, 3))
        points = trimesh.sample.sample_surface(shape, 20000, seed=1)[0] * [1, -1, -1] + [0, 0, 5]
        x, y, z = points.T
        dense = z.min(where=(np.abs(x) < 0.4 * z) & (np.abs(y) < 0.3 * z), initial=np.inf)
        depth = nearest_depth(_mesh(shape), EYE)
        # 20,000 points on an area of 4 pi stand 0.025 apart; the view may slant by 1 in cos(60 degrees) and more.
        assert depth <= dense and (dense < depth + 0.2 or np.isinf(dense))


def test_voxels_are_half_a_pixel():
    mesh = box([-1, -1, -1], [1, 1, 1])
    n, why = resolution_for(mesh, needs())
    spacing = 2 / (n - 1 - 2 * BAND)
    assert 0.5 * 4 * 0.01 * 0.98 < spacing <= 0.5 * 4 * 0.01  # one more sample changes it by 1 %
    assert "half a pixel" in why and "4 away" in why and "mirrors" not in why
    assert "mirrors" in resolution_for(mesh, needs(primary_only=False))[1]


def test_the_nearest_of_several_cameras_decides():
    mesh, far = box([-1, -1, -1], [1, 1, 1]), EYE.model_copy(update={"position": (0, 0, 50)})
    assert resolution_for(mesh, needs(far, EYE))[0] == resolution_for(mesh, needs(EYE))[0]
    flat = Orthographic(view=(0, 0, -1), units_per_pixel=0.01)
    n = resolution_for(mesh, needs(flat, far))[0]
    assert 2 / (n - 1 - 2 * BAND) == pytest.approx(0.005, rel=0.01)


def test_resolutions_have_their_limits():
    mesh = box([-1, -1, -1], [1, 1, 1])
    touching = EYE.model_copy(update={"position": (0, 0, 1)})
    n, why = resolution_for(mesh, needs(touching))
    assert n == FINEST and "32 to 1024" in why
    n, why = resolution_for(mesh, needs(EYE.model_copy(update={"position": (0, 0, 500)})))
    assert n == 32 and "asks for" in why
    with pytest.raises(BadInput, match="a.zarr.zip directly.*-n"):
        resolution_for(mesh, needs(EYE.model_copy(update={"position": (0, 0, -5)})))


SCENE = """
[camera]
position = [0.0, 0.0, 5.0]
target = [0.0, 0.0, 0.0]
fov = 40.0
[film]
size = [32, 24]
outputs = [{outputs}]
[[textures]]
name = "squares"
type = "checker"
[[assets]]
grid = "ball.zarr.zip"
materials = [{{ {material} }}]
{more}
"""
PAPER = 'type = "diffuse", texture = "squares"'


def scene(folder, material=PAPER, outputs='"rgb"', more=""):
    path = folder / "scene.toml"
    path.write_text(SCENE.format(material=material, outputs=outputs, more=more))
    return path


# material, outputs: uv modes, required, parts, primary rays only
WISHES = {
    "textured": (PAPER, '"rgb"', (("faces",), True, False, True)),
    "matt": ('type = "diffuse"', '"rgb"', ((), False, False, True)),
    "depth of textured": (PAPER, '"Z"', ((), False, False, True)),
    "mirror": ('type = "mirror"', '"rgb"', ((), False, False, False)),
    "depth of mirror": ('type = "mirror"', '"Z"', ((), False, False, True)),
    "flags": ('type = "diffuse"', '"flags"', (("faces",), False, False, True)),
    "parts": ('type = "diffuse"', '"part"', ((), False, True, True)),
}


@pytest.mark.parametrize(("material", "outputs", "wish"), WISHES.values(), ids=WISHES)
def test_what_scenes_need(tmp_path, material, outputs, wish):
    (needed,) = needs_of(load_scene(scene(tmp_path, material, outputs))).grids
    assert (needed.uv_modes, needed.uv_required, needed.parts, needed.primary_only) == wish
    assert needed.grid.endswith("ball.zarr.zip") and needed.kernel == "bspline" and needed.band == BAND


def test_places_of_a_grid_are_one_entry_in_its_own_frame(tmp_path):
    """A camera at (0, 0, 5) before a ball twice as large at (0, 0, -5), turned: 5 of its units away."""
    more = '[[assets]]\ngrid = "ball.zarr.zip"\nscale = 2.0\nrotate = [0, 1, 0, 90]\ntranslate = [0, 0, -5]\n'
    more += 'materials = [{ type = "mirror" }]'
    (needed,) = needs_of(load_scene(scene(tmp_path, more=more))).grids
    near, far = needed.cameras
    assert near.position == (0, 0, 5) and near.tangents[1] == pytest.approx(np.tan(np.radians(20)))
    assert near.radians_per_pixel == pytest.approx(2 * np.tan(np.radians(20)) / 24)
    np.testing.assert_allclose(far.position, [-5, 0, 0], atol=1e-12)  # z of the world is -x of what is turned by 90
    np.testing.assert_allclose(far.view, [1, 0, 0], atol=1e-12)
    ball = _mesh(trimesh.creation.icosphere(3))
    assert nearest_depth(ball, near) == pytest.approx(4, abs=0.01) == nearest_depth(ball, far)


def test_an_orthographic_camera_in_the_frame_of_an_asset(tmp_path):
    path = scene(tmp_path)
    text = path.read_text().replace("fov = 40.0", 'type = "orthographic"\nheight = 12.0')
    path.write_text(text.replace("materials", "scale = 2.0\nmaterials"))
    (camera,) = needs_of(load_scene(path)).grids[0].cameras
    assert camera == Orthographic(view=(0, 0, -1), units_per_pixel=0.25)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """A ball with texture coordinates and two parts, and one with neither."""
    folder = tmp_path_factory.mktemp("meshes")
    ball = _mesh(trimesh.creation.icosphere(2))
    uv = 0.5 + 0.4 * ball.vertices[ball.faces][..., :2]
    part = (ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0).astype(np.int32)
    save(ball.with_(uv=uv, part=part, part_names=("low", "high")), folder / "ball.ply")
    save(ball, folder / "bare.ply")
    return folder


def test_plan_then_bake_then_render(meshes, tmp_path, monkeypatch, capsys):
    """Only what is needed is baked, and the picture is that of a grid with everything."""
    path, file, grid = scene(tmp_path), tmp_path / "needs.json", tmp_path / "ball.zarr.zip"
    path.write_text(path.read_text().replace("[32, 24]", "[24, 18]"))
    code, out, _ = sdfrender_caller(monkeypatch, capsys)("plan", path, "--needs", file, "--json")
    assert code == 0 and json.loads(out)["assets"][0]["uv_mode"] == "faces"
    record = json.loads(run("bake", meshes / "ball.ply", "--needs", file, "-n", "auto", "-o", grid, "--json").stdout)
    assert record["resolution"].startswith(f"{record['options']['resolution']}: voxels of half a pixel")
    spacing = record["lattice"]["spacing"]
    # The ball comes within 4 of the camera, a little less near between its 162 vertices; 18 rows in 40 degrees.
    assert spacing == pytest.approx(0.5 * 4 * 2 * np.tan(np.radians(20)) / 18, rel=0.06)
    assert {name.split(".")[0] for name in stored_bytes(grid)} == {"distance", "face", "far", "slot", "surface"}
    lean = render(path, engine="numpy")["rgb"]
    n = record["options"]["resolution"]
    run("bake", meshes / "ball.ply", "--uv-mode", "faces,layers,grid", "-n", n, "-o", grid)
    assert len(stored_bytes(grid)) > 12 and Grid.load(grid).error is not None
    np.testing.assert_array_equal(lean, render(path, engine="numpy")["rgb"])


def test_parts_are_baked_where_they_are_needed(meshes, tmp_path):
    file = tmp_path / "needs.json"
    needs_of(load_scene(scene(tmp_path, 'type = "diffuse"', '"part"'))).save(file)
    run("bake", meshes / "ball.ply", "--needs", file, "-n", 20, "-o", tmp_path / "ball.zarr.zip")
    grid = Grid.load(tmp_path / "ball.zarr.zip")
    assert grid.part is not None and np.ptp(grid.part) == 1 and grid.face is None and grid.error is None


def test_texture_coordinates_that_are_not_required(meshes, tmp_path):
    file, grid = tmp_path / "needs.json", tmp_path / "ball.zarr.zip"
    needs_of(load_scene(scene(tmp_path, 'type = "diffuse"', '"flags"'))).save(file)
    assert not Grid.load(_baked(meshes / "bare.ply", file, grid)).metadata.uv_modes
    assert Grid.load(_baked(meshes / "ball.ply", file, grid)).metadata.uv_modes == ("faces",)
    needs_of(load_scene(scene(tmp_path))).save(file)
    said = run("bake", meshes / "bare.ply", "--needs", file, "-n", 20, "-o", grid, code=2).stderr
    assert "--unwrap" in said and said.count("\n") == 1


def _baked(mesh, file, grid):
    run("bake", mesh, "--needs", file, "-n", 20, "-o", grid)
    return grid


WRONG = {
    "both": (["--uv-mode", "faces", "--needs", "two.json", "-n", "20"], "--uv-mode"),
    "no such file": (["--needs", "none.json", "-n", "20"], "none.json"),
    "no json": (["--needs", "ball.ply", "-n", "20"], "ball.ply are wrong"),
    "another version": (["--needs", "later.json", "-n", "20"], "version"),
    "unknown entry": (["--needs", "odd.json", "-n", "20"], "colour"),
    "a wide band": (["--needs", "wide.json", "-n", "20"], "band of 9"),
    "which": (["--needs", "two.json", "-n", "20"], "a.zarr.zip, b.zarr.zip"),
    "auto without needs": (["-n", "auto"], "--needs FILE"),
    "no number": (["-n", "many"], "many"),
    "out of view": (["--needs", "away.json", "-n", "auto"], "-n"),
}


@pytest.mark.parametrize(("arguments", "says"), WRONG.values(), ids=WRONG)
def test_mistakes(meshes, monkeypatch, arguments, says):
    monkeypatch.chdir(meshes)
    two = Needs(grids=(needs(), needs(name="b.zarr.zip")))
    two.save("two.json")
    one = json.loads(Needs(grids=(needs(),)).model_dump_json())
    away = Needs(grids=(needs(EYE.model_copy(update={"view": (0, 0, 1)})),))
    away.save("away.json")
    Needs(grids=(needs().model_copy(update={"band": 9.0}),)).save("wide.json")
    for name, change in {"later": {"version": 2}, "odd": {"colour": "red"}}.items():
        (meshes / f"{name}.json").write_text(json.dumps({**one, **change}))
    ended = run("bake", "ball.ply", "-o", "c.zarr.zip", *arguments, code=2)
    assert says in ended.stderr and ended.stderr.count("\n") == 1 and not (meshes / "c.zarr.zip").exists()


def test_the_grid_with_the_outputs_name(tmp_path):
    two = Needs(grids=(needs(), needs(name="grids/b.zarr.zip", parts=True)))
    two.save(tmp_path / "two.json")
    assert load_needs(tmp_path / "two.json") == two
    assert two.of(tmp_path / "b.zarr.zip").parts and not two.of(tmp_path / "a.zarr.zip").parts
