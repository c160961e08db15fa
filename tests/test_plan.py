"""Plans: what is left out, by a table; and that leaving it out changes no bit."""

import json
from dataclasses import replace

import numpy as np
import pytest
from charted import layers_of, with_all
from scenery import SPHERE, furnish, mirror_scene, sphere_scene

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.complaint import BadInput
from sdfbake.gridfile import stored_bytes
from sdfbake.layers import FULL
from sdfrender.plan import make_plan
from sdfrender.render import shoot
from sdfrender.scene import load_scene
from sdfrender.stage import prepare


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return furnish(tmp_path_factory.mktemp("scenes"))


PAPER = '"diffuse", texture = "page"'
# scene, options, orders, differentials, uv, channels
TABLE = {
    "normals": (sphere_scene, {}, (1,), False, False, {"distance"}),
    "matt": (sphere_scene, {"material": '"diffuse"'}, (None,), False, False, {"distance"}),
    "textured": (sphere_scene, {"material": PAPER}, (1,), True, True, {"distance", "uv", "chart"}),
    "unfiltered": (
        sphere_scene,
        {"material": PAPER, "filtering": "bilinear"},
        (None,),
        False,
        True,
        {"distance", "uv", "chart"},
    ),
    "depth": (sphere_scene, {"material": PAPER, "outputs": ("Z",)}, (None,), False, False, {"distance"}),
    "N of textured": (sphere_scene, {"material": PAPER, "outputs": ("N",)}, (1,), False, False, {"distance"}),
    "lod": (sphere_scene, {"outputs": ("lod",)}, (1,), True, True, {"distance", "uv", "chart"}),
    "part": (sphere_scene, {"outputs": ("part",)}, (None,), False, False, {"distance", "part"}),
    "mirror": (mirror_scene, {}, (2, 1), True, True, {"distance", "uv", "chart", "part"}),
    "mirror, 3 bounces": (mirror_scene, {"bounces": 3}, (2, 2, 2, 2), True, True, {"distance", "uv", "chart", "part"}),
    "mirror, no bounce": (mirror_scene, {"bounces": 0}, (1,), True, True, {"distance", "uv", "chart", "part"}),
    "mirror, bilinear": (
        mirror_scene,
        {"filtering": "bilinear"},
        (1, None),
        False,
        True,
        {"distance", "uv", "chart", "part"},
    ),
    "mirror, uv": (mirror_scene, {"outputs": ("uv",)}, (1, None), False, True, {"distance", "uv", "chart", "part"}),
    "mirror, Z": (mirror_scene, {"outputs": ("Z", "P", "N")}, (1,), False, False, {"distance"}),
    "mirror, flags": (mirror_scene, {"outputs": ("flags",)}, (2, 1), True, True, {"distance", "uv", "chart", "part"}),
}


@pytest.mark.parametrize("case", TABLE.values(), ids=TABLE)
def test_needs(folder, case):
    make, options, orders, differentials, uv, channels = case
    plan = make_plan(load_scene(make(folder, **options)))
    assert (plan.orders, plan.differentials, plan.uv) == (orders, differentials, uv)
    assert set(plan.assets[0].channels) == channels
    left_out = {omission.what for omission in plan.left_out}
    assert ("ray differentials" in left_out) is not differentials
    assert ("texture coordinates" in left_out) is not uv
    assert ("Hessians" in left_out) is (2 not in orders)
    assert ("gradients" in left_out) is (set(orders) == {None})
    assert ("parts" in left_out) is ("part" not in channels)
    assert all(omission.reason for omission in plan.left_out)


def test_only_the_channels_of_the_plan_are_loaded(folder):
    grid = prepare(sphere_scene(folder), engine="numpy").field.grid
    assert grid.uv is None and grid.chart is None
    stage = prepare(sphere_scene(folder, PAPER), engine="numpy")
    assert stage.field.grid.uv is not None and set(stage.samplers) == {"page"}
    assert prepare(sphere_scene(folder, PAPER, outputs=("Z",)), engine="numpy").samplers == {}


@pytest.mark.parametrize("case", TABLE.values(), ids=TABLE)
def test_the_planned_result_is_the_full_one(folder, case):
    """Everything forced on, bit for bit: Hessians, differentials, parts, and texture coordinates where there are."""
    make, options, *_ = case
    stage = prepare(make(folder, **options), engine="numpy")
    full = replace(stage.plan, orders=(2,) * len(stage.plan.orders), differentials=True, footprints=True, parts=True)
    if stage.field.grid.uv is not None:
        full = replace(full, uv=True)
    planned, everything = shoot(stage), shoot(replace(stage, plan=full))
    assert list(planned) == list(everything)
    for name, array in planned.items():
        assert np.array_equal(array, everything[name]), name
        assert np.isfinite(array).all()


def test_records_are_plain(folder):
    record = make_plan(load_scene(mirror_scene(folder))).record()
    assert record["orders"] == (2, 1) and json.loads(json.dumps(record))["splits"] == 0
    left_out = [omission["what"] for omission in record["left_out"]]
    assert left_out[:5] == ["refraction", "error channel", "grid levels", "lights and shadows", "environment"]
    assert [row for row in record["capabilities"] if not row["needed"]] == record["left_out"]


@pytest.fixture(scope="module")
def charted(folder):
    """A textured sphere whose grid has all three representations of its texture coordinates."""
    exact = shape("sphere")
    grid = Grid.from_function(exact, 32)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.lattice.shape), indexing="ij"), axis=-1)
    p = grid.lattice.to_world(index).reshape(-1, 3)
    codes, normal = np.rint(FULL * np.clip(0.5 + p[:, :2] / 3, 0, 1)), exact.normal(p)
    near = np.where(np.abs(exact.distance(p)) < 3 * grid.lattice.spacing, -8.0, np.inf)
    one = (1, *grid.lattice.shape)
    layers = layers_of(grid, codes.reshape(*one, 2), near.reshape(one), normal.reshape(*one, 3))
    with_all(grid, exact.mesh(0.2), layers).save(folder / "charted.zarr.zip")

    def scene(uv=None, **options):
        path = sphere_scene(folder, PAPER, **options)
        wish = f'uv = "{uv}"\n' if uv else ""
        path.write_text(path.read_text().replace('grid = "sphere.zarr.zip"\n', f'grid = "charted.zarr.zip"\n{wish}'))
        return path

    return scene


MODES = {
    None: ("faces", {"distance", "face"}),
    "auto": ("faces", {"distance", "face"}),
    "faces": ("faces", {"distance", "face"}),
    "layers": ("layers", {"distance", "layers"}),
    "grid": ("grid", {"distance", "uv", "chart"}),
}


@pytest.mark.parametrize("wish", MODES)
def test_only_the_texture_coordinates_that_are_used_are_read(charted, wish):
    mode, channels = MODES[wish]
    stage = prepare(charted(wish, filtering="bilinear"), engine="numpy")
    plan, grid = stage.plan, stage.field.grid
    (asset,) = plan.assets
    assert (asset.uv_mode, set(asset.channels), stage.field.uv_mode) == (mode, channels, mode)
    # Faces and layers ask for the normal where the path ends; interpolation does not.
    assert plan.orders == ((None,) if mode == "grid" else (1,)) and not plan.differentials
    held = {"faces": grid.face, "layers": grid.layers, "grid": grid.uv}
    assert {name for name, values in held.items() if values is not None} == {mode}
    others = {f"texture coordinates as {other}" for other in held if other != mode}
    assert others <= {omission.what for omission in plan.left_out}


@pytest.mark.parametrize("wish", ["faces", "layers", "grid"])
@pytest.mark.parametrize("filtering", ["bilinear", "trilinear"])
def test_no_representation_needs_more_than_is_planned(charted, wish, filtering):
    stage = prepare(charted(wish, filtering=filtering, outputs=("rgb", "uv")), engine="numpy")
    planned = shoot(stage)
    everything = shoot(replace(stage, plan=replace(stage.plan, orders=(2,), differentials=True, parts=True)))
    for name, array in planned.items():
        assert np.array_equal(array, everything[name]), name
    seen = planned["uv"][..., 0] != 0
    assert seen.mean() > 0.3 and np.ptp(planned["rgb"][seen]) > 0.1


def test_faces_show_the_texture_of_the_sphere(charted):
    """A mesh of edge 0.2 has the sphere's texture coordinates at its corners, and within 0.2^2 / 8 of them between."""
    scene = load_scene(charted("faces", outputs=("uv", "P", "part")))
    out = shoot(prepare(scene, engine="numpy"))
    hit = out["part"][..., 0] >= 0
    exact = shape("sphere").uv(out["P"][hit])
    close = np.abs(out["uv"][hit] - exact).max(axis=1) < 0.01
    assert hit.mean() > 0.3 and close.mean() > 0.97  # the rest is across a cut


def test_texture_coordinates_that_are_not_there(charted, folder):
    path = sphere_scene(folder, PAPER)
    path.write_text(path.read_text().replace('.zarr.zip"\n', '.zarr.zip"\nuv = "layers"\n'))
    with pytest.raises(BadInput, match="sphere.zarr.zip.*'layers'.*--uv-mode layers"):
        make_plan(load_scene(path))
    path.write_text(path.read_text().replace("sphere.zarr.zip", "none.zarr.zip"))
    plan = make_plan(load_scene(path))
    assert plan.assets[0].uv_mode == "layers" and not any("texture" in omission.what for omission in plan.left_out)


BAKE = r"python -m sdfbake bake MESH -n {n} -o \S*{name}.zarr.zip"
# What is asked of a grid that does not have it: its name, changes of its metadata, the scene, what is said.
LACKING = {
    "no uv": ("bare", {}, {"material": PAPER}, BAKE.format(n=32, name="poor") + " --uv-mode faces'"),
    "no uv for an output": ("bare", {}, {"outputs": ("uv",)}, BAKE.format(n=32, name="poor") + " --uv-mode faces'"),
    "narrow band": ("sphere", {"band": 3.0}, {}, "3 voxels.*bspline.*5.2.*" + BAKE.format(n=32, name="poor")),
    "no parts": ("sphere", {"parts": ("a", "b")}, {"outputs": ("part",)}, "without its parts.* --uv-mode grid'"),
    "unknown part": ("sphere", {}, {"material": '"diffuse", part = "head"'}, "no part 'head'"),
}


@pytest.mark.parametrize(("source", "claims", "options", "says"), LACKING.values(), ids=LACKING)
def test_what_a_grid_lacks_is_said_before_it_is_read(folder, monkeypatch, source, claims, options, says):
    grid = Grid.load(folder / f"{source}.zarr.zip")
    replace(grid, metadata=grid.metadata.model_copy(update=claims)).save(folder / "poor.zarr.zip")
    path = sphere_scene(folder, **options)
    path.write_text(path.read_text().replace("sphere.zarr.zip", "poor.zarr.zip"))
    monkeypatch.setattr("sdfrender.stage.load_counted", None)  # calling it would be another error
    with pytest.raises(BadInput, match=f"poor.zarr.zip.*{says}"):
        prepare(path, engine="numpy")


def test_flags_say_where_a_band_is_too_narrow(folder):
    grid = Grid.load(folder / "sphere.zarr.zip")
    replace(grid, metadata=grid.metadata.model_copy(update={"band": 3.0})).save(folder / "poor.zarr.zip")
    path = sphere_scene(folder, outputs=("Z", "flags"), size=(8, 8))
    path.write_text(path.read_text().replace("sphere.zarr.zip", "poor.zarr.zip"))
    assert (shoot(prepare(path, engine="numpy"))["flags"].astype(int) & 32).any()


def test_a_kernel_without_second_derivatives(folder):
    scene = load_scene(sphere_scene(folder, outputs=("curvature",)))
    with pytest.raises(BadInput, match="curvature.*sphere.zarr.zip.*linear.*bspline"):
        make_plan(scene.with_(size=None, outputs=None, kernel="linear"))
    make_plan(scene)


def test_a_missing_grid_is_named_before_another_is_read(folder, monkeypatch):
    path = sphere_scene(folder)
    path.write_text(path.read_text() + SPHERE.format(material='"diffuse"').replace("sphere.zarr", "none.zarr"))
    monkeypatch.setattr("sdfrender.stage.load_counted", None)
    with pytest.raises(BadInput, match="none.zarr.zip.*python -m sdfbake bake"):
        prepare(path, engine="numpy")


def test_materials_that_no_part_is_made_of_cost_nothing(folder):
    path = mirror_scene(folder)
    path.write_text(path.read_text().replace("materials = [", 'materials = [\n    { type = "glass" },'))
    plan = make_plan(load_scene(path))
    assert (plan.splits, plan.orders) == (0, (2, 1))  # with glass eight bounces and both ways
    assert "glass for '*' of mirror.zarr.zip" in {row.what for row in plan.left_out}


def test_bytes_that_stay_unread_are_those_of_the_file(charted, folder):
    plan = make_plan(load_scene(charted("layers")))
    sizes, said = stored_bytes(folder / "charted.zarr.zip"), {row.what: row.bytes for row in plan.left_out}
    faces = sizes["face"] + sum(size for name, size in sizes.items() if name.startswith("surface."))
    assert said["texture coordinates as faces"] == faces
    assert said["texture coordinates as grid"] == sizes["uv"] + sizes["chart"]
    assert sum(said.values()) == sum(
        size for name, size in sizes.items() if name.split(".")[0] in ("face", "surface", "uv", "chart", "error")
    )


def test_time_saved_is_of_what_would_be_done_otherwise(folder):
    """Nine samples instead of one take eight times longer on top; Hessians take some, refraction of no glass none."""
    rows = {
        row.what: row for row in make_plan(load_scene(sphere_scene(folder, outputs=("Z",), supersample=3))).left_out
    }
    assert rows["further samples"].saving.numpy == rows["further samples"].saving.drjit == 8
    assert 0 < rows["Hessians"].saving.drjit < rows["texture coordinates"].saving.drjit < 1
    assert rows["refraction"].saving is None
