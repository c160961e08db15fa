"""Plans: what is left out, by a table; and that leaving it out changes no bit."""

import json
from dataclasses import replace

import numpy as np
import pytest
from charted import layers_of, with_all
from scenery import furnish, mirror_scene, sphere_scene

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.complaint import BadInput
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
    "mirror, Z": (mirror_scene, {"outputs": ("Z", "P", "N")}, (1,), False, False, {"distance", "part"}),
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
    assert [omission["what"] for omission in record["left_out"]] == ["refraction", "lights and shadows"]


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
