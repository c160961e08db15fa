"""Plans of whole scenes: glass, lights, surroundings, several assets; and that what they leave out changes no bit."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scenery import CAMERA, TEXTURE, furnish

from sdfbake import Grid
from sdfbake.engine import choose
from sdfbake.engine.choose import _jit_problem
from sdfrender import stage as staging
from sdfrender.flags import Flag
from sdfrender.gridfield import GridField
from sdfrender.plan import make_plan
from sdfrender.render import shoot
from sdfrender.scene import Output, load_scene
from sdfrender.stage import prepare


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return furnish(tmp_path_factory.mktemp("scenes"), 20, mirror=False)


def _asset(grid, materials, *more):
    return "\n".join(["[[assets]]", f'grid = "{grid}.zarr.zip"', f"materials = [{materials}]", *more, ""])


GLASS = _asset("bare", '{ type = "glass" }')
MATT = _asset("bare", '{ type = "diffuse" }', "translate = [0.0, 0.0, -2.0]")
PAGE = _asset("sphere", '{ type = "diffuse", texture = "page" }', "translate = [0.0, 0.0, -2.0]")
MIRROR = _asset("bare", '{ type = "mirror" }', "translate = [0.3, 0.0, 0.2]", "scale = 0.5")
SUN = '[[lights]]\ntype = "directional"\ndirection = [-1.0, -1.0, -1.0]\n'
SKY = 'environment = { image = "page.png" }\n'
DULL = 'environment = { image = "page.png", filter = "bilinear" }\n'
D, UV, PART = {"distance"}, {"distance", "uv", "chart"}, {"distance", "part"}
# head, outputs, bounces, what follows: orders, differentials, footprints, uv, parts, splits, lit, channels
WHOLE = {
    "glass": ("", "rgb", 3, GLASS, (1,) * 4, False, False, False, False, 2, False, (D,)),
    "glass, one bounce": ("", "rgb", 1, GLASS, (1, None), False, False, False, False, 1, False, (D,)),
    "glass, no bounce": ("", "rgb", 0, GLASS, (None,), False, False, False, False, 0, False, (D,)),
    "glass, Z": ("", "Z", 3, GLASS, (None,), False, False, False, False, 0, False, (D,)),
    "glass, flags": ("", "flags", 2, GLASS, (2,) * 3, True, True, False, False, 0, False, (D,)),
    "glass, sky": (SKY, "rgb", 2, GLASS, (2,) * 3, True, False, False, False, 2, False, (D,)),
    "glass, unfiltered sky": (DULL, "rgb", 2, GLASS, (1,) * 3, False, False, False, False, 2, False, (D,)),
    "glass before a page": ("", "rgb", 2, GLASS + PAGE, (2,) * 3, True, True, True, True, 2, False, (D, UV)),
    "sun": (SUN, "rgb", 1, MATT, (1,), False, False, False, False, 0, True, (D,)),
    "sun, Z": (SUN, "Z", 1, MATT, (None,), False, False, False, False, 0, False, (D,)),
    "sun on glass alone": (SUN, "rgb", 1, GLASS, (1, None), False, False, False, False, 1, False, (D,)),
    "sky": (SKY, "rgb", 1, MATT, (1,), True, False, False, False, 0, True, (D,)),
    "sky in a mirror": (SKY, "rgb", 1, MIRROR, (2, None), True, False, False, False, 0, False, (D,)),
    "unfiltered sky in a mirror": (DULL, "rgb", 1, MIRROR, (1, None), False, False, False, False, 0, False, (D,)),
    "sky, Z and N": (SKY, "Z,N", 1, MATT, (1,), False, False, False, False, 0, False, (D,)),
    "two assets": (SUN, "rgb,part", 1, MATT + PAGE, (1,), True, True, True, True, 0, True, (PART, UV | PART)),
    "a mirror beside a page": ("", "rgb,uv", 1, MIRROR + PAGE, (2, 1), True, True, True, True, 0, False, (D, UV)),
    "flags without coordinates": ("", "flags", 1, MATT, (1,), True, True, False, False, 0, False, (D,)),
    "flags, one with, one without": ("", "flags", 1, MATT + PAGE, (1,), True, True, True, True, 0, False, (D, UV)),
    "curvature": ("", "curvature,Z", 1, GLASS, (2,), False, False, False, False, 0, False, (D,)),
    "curvature and colour": ("", "curvature,rgb", 1, GLASS, (2, None), False, False, False, False, 1, False, (D,)),
    "nonlinearity": ("", "nonlinearity", 1, PAGE, (1,), True, True, True, False, 0, False, (UV,)),
    "everything": (SUN, "rgb,Z,N,flags,ellipse,curvature", 3, GLASS + PAGE + MIRROR, (2,) * 4, True, True, True, True,
                   2, True, (D, UV, D)),
}  # fmt: skip


def whole(folder, case, size=16):
    head, outputs, bounces, rest, *_ = case
    first = head if head.startswith("environment") else "background = [0.2, 0.4, 0.6]\n"
    lamps = head if head.startswith("[[lights") else ""
    asked = ", ".join(f'"{name}"' for name in outputs.split(","))
    path = folder / "whole.toml"
    film = f"[film]\nsize = [{size}, {size}]\noutputs = [{asked}]\n[trace]\nbounces = {bounces}\n"
    path.write_text(first + CAMERA + film + (TEXTURE.format(filter="trilinear") if PAGE in rest else "") + lamps + rest)
    return path


@pytest.mark.parametrize("case", WHOLE.values(), ids=WHOLE)
def test_what_whole_scenes_need(folder, case):
    plan = make_plan(load_scene(whole(folder, case)))
    *needs, channels = case[4:]
    assert [plan.orders, plan.differentials, plan.footprints, plan.uv, plan.parts, plan.splits, plan.lit] == needs
    assert tuple(set(asset.channels) for asset in plan.assets) == channels
    left_out = {omission.what for omission in plan.left_out}
    assert ("refraction" in left_out) is ('"glass"' not in case[3] or len(plan.orders) == 1)
    assert ("lights and shadows" in left_out) is not plan.lit
    assert ("ray differentials" in left_out) is not plan.differentials
    assert ("parts" in left_out) is not plan.parts


@pytest.fixture(scope="module")
def fields(folder):
    """Surfaces with all that their grids have: preparing them for every scene would be most of the time."""
    return {name: GridField(Grid.load(folder / f"{name}.zarr.zip"), engine="numpy") for name in ("bare", "sphere")}


@pytest.mark.parametrize("case", WHOLE.values(), ids=WHOLE)
def test_whole_scenes_lack_nothing(folder, fields, case):
    """Planned = with Hessians, differentials, footprints and parts at every hit, bit for bit.

    Texture coordinates are forced only where they can be had, lights only where there are some. How the plan is loaded
    has its own tests, below.
    """
    scene = load_scene(whole(folder, case, 6))
    stage = prepare(scene, field=[fields[asset.grid.name.partition(".")[0]] for asset in scene.assets])
    assert replace(stage.plan, assets=(), capabilities=(), levels=()) == replace(
        make_plan(scene), assets=(), capabilities=()
    )
    orders = (2,) * len(stage.plan.orders)
    full = replace(stage.plan, orders=orders, differentials=True, footprints=True, parts=True)
    planned, everything = shoot(stage), shoot(replace(stage, plan=full))
    assert list(planned) == list(everything) == case[1].split(",")
    for name, array in planned.items():
        assert np.array_equal(array, everything[name]), name
        assert np.isfinite(array).all() and (np.ptp(array) > 0 or case[2] == 0)


def test_the_check_sees_what_is_missing(folder):
    """A plan without the Hessian at the first hit of a mirror gives another picture."""
    stage = prepare(whole(folder, WHOLE["a mirror beside a page"], 12), engine="numpy")
    less = replace(stage.plan, orders=(1, 1))
    with pytest.raises((AssertionError, AttributeError, TypeError)):
        assert np.array_equal(shoot(stage)["rgb"], shoot(replace(stage, plan=less))["rgb"])


OUTPUTS = get_args(Output)
COMPILED = ("rgb", "N", "lod", "flags")  # those that are compared on Dr.Jit, where every program is compiled first
# Outputs that are planned alike, so that one picture of them all is that of each alone.
ALIKE = [
    ("rgb",),
    ("Z", "P"),
    ("N",),
    ("curvature",),
    ("part",),
    ("uv", "chart"),
    ("duv_dx", "duv_dy", "lod", "lod_invariant", "ellipse", "nonlinearity"),
    ("flags",),
]
# Scenes whose ends all have texture coordinates, so that any output can be asked for: head, bounces, what follows.
PAIRED = {
    "page": (SKY, 1, PAGE),
    "mirror and page": (DULL, 1, MIRROR + PAGE),
    "glass before a page": (DULL, 2, GLASS + PAGE),
}


@pytest.fixture(scope="module")
def everything(folder):
    """Many outputs of a scene at once, everything forced on, on surfaces of which everything was read; by request."""
    known = {}

    def made(name, engine):
        if (name, engine) not in known:
            scene = load_scene(paired(folder, name, OUTPUTS if engine == "numpy" else COMPILED))
            choice = choose(engine, 64)
            made = {grid: GridField(Grid.load(grid), engine=choice) for grid in {a.grid for a in scene.assets}}
            stage = prepare(scene, field=[made[asset.grid] for asset in scene.assets])
            full = replace(stage.plan, orders=(2,) * len(stage.plan.orders), differentials=True, footprints=True)
            known[name, engine] = shoot(replace(stage, plan=replace(full, parts=True, uv=True)))
        return known[name, engine]

    return made


def paired(folder, name, outputs):
    head, bounces, rest = PAIRED[name]
    return whole(folder, (head, ",".join(outputs), bounces, rest), 6)


def compared(planned, full, output):
    """Return two arrays that are the same picture; flags without what only other outputs make them say."""
    if output != "flags":
        return planned[output], full[output]
    others = int(Flag.NONLINEAR | Flag.CLAMPED)
    return tuple(picture["flags"].astype(int) & ~others for picture in (planned, full))


def test_all_outputs_are_planned_alike_some(folder):
    assert sorted(output for outputs in ALIKE for output in outputs) == sorted(OUTPUTS)
    for name in PAIRED:
        for outputs in ALIKE:
            alone = [make_plan(load_scene(paired(folder, name, [output]))) for output in outputs]
            together = make_plan(load_scene(paired(folder, name, outputs)))
            bare = replace(together, outputs=(), capabilities=())
            assert all(replace(plan, outputs=(), capabilities=()) == bare for plan in alone)


@pytest.fixture(scope="module")
def loadings():
    return {}


@pytest.fixture
def loaded_once(loadings, monkeypatch):
    """Load once what is planned alike: preparing grids again and again would be most of the time."""
    load = staging._load

    def memoized(scene, share, told, choice):
        key = (share.needs, share.places, None in share.sights, choice.engine.name)
        if key not in loadings:
            loadings[key] = load(scene, share, told, choice)
        return loadings[key]

    monkeypatch.setattr(staging, "_load", memoized)


@pytest.mark.usefixtures("loaded_once")
@pytest.mark.parametrize("outputs", ALIKE, ids=lambda outputs: outputs[0])
@pytest.mark.parametrize("name", PAIRED)
def test_every_output_alone_is_that_of_everything(folder, everything, name, outputs):
    """Bit for bit: other orders, channels, bricks and hits than when everything is asked for."""
    planned = shoot(prepare(paired(folder, name, outputs), engine="numpy"))
    for output in outputs:
        mine, theirs = compared(planned, everything(name, "numpy"), output)
        np.testing.assert_array_equal(mine, theirs, err_msg=output)
        assert np.isfinite(mine).all() and (np.ptp(mine) > 0 or output in ("chart", "part", "flags"))


@pytest.mark.usefixtures("loaded_once")
@pytest.mark.skipif(_jit_problem() is not None, reason="Dr.Jit is not usable")
@pytest.mark.parametrize("output", COMPILED)
def test_every_output_alone_is_that_of_everything_on_drjit(folder, everything, output):
    """A few units in the last place of float64, as the compiler may fuse multiplications with additions differently."""
    planned = shoot(prepare(paired(folder, "mirror and page", [output]), engine="drjit", precision=64))
    mine, theirs = compared(planned, everything("mirror and page", "drjit"), output)
    np.testing.assert_allclose(mine, theirs, rtol=16 * 2.0**-52, atol=16 * 2.0**-52)
