"""Plans: what is left out, by a table; and that leaving it out changes no bit."""

from dataclasses import replace

import numpy as np
import pytest
from scenery import furnish, mirror_scene, sphere_scene

from sdfrender.plan import make_plan
from sdfrender.render import prepare, shoot
from sdfrender.scene import load_scene


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
    "mirror, 3 bounces": (mirror_scene, {"bounces": 3}, (2, 2, 2, 1), True, True, {"distance", "uv", "chart", "part"}),
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
    assert (plan.orders, plan.differentials, plan.uv, set(plan.channels)) == (orders, differentials, uv, channels)
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
    full = replace(stage.plan, orders=(2,) * len(stage.plan.orders), differentials=True, parts=True)
    if stage.field.grid.uv is not None:
        full = replace(full, uv=True)
    planned, everything = shoot(stage), shoot(replace(stage, plan=full))
    assert list(planned) == list(everything)
    for name, array in planned.items():
        assert np.array_equal(array, everything[name]), name
        assert np.isfinite(array).all()


def test_records_are_plain(folder):
    record = make_plan(load_scene(mirror_scene(folder))).record()
    assert record["orders"] == (2, 1) and record["left_out"] == ()
