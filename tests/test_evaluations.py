"""What a plan says is done, hit by hit, is what counters count: no more, no less."""

from dataclasses import replace

import numpy as np
import pytest
from scenery import furnish, mirror_scene, sphere_scene

from sdfbake import Grid
from sdfrender import GridField, reflect, transfer
from sdfrender.costs import evaluations
from sdfrender.render import shoot
from sdfrender.scene import load_scene
from sdfrender.stage import prepare
from validate.counters import Counters

SIZE = (10, 10)
PAPER = '"diffuse", texture = "page"'
# scene, options
SCENES = {
    "distances": (sphere_scene, {"outputs": ("Z",)}),
    "flat": (sphere_scene, {"material": '"diffuse"'}),
    "normals": (sphere_scene, {}),
    "curvature": (sphere_scene, {"outputs": ("Z", "curvature")}),
    "point": (sphere_scene, {"material": PAPER, "filtering": "point"}),
    "bilinear": (sphere_scene, {"material": PAPER, "filtering": "bilinear"}),
    "trilinear": (sphere_scene, {"material": PAPER}),
    "level of detail": (sphere_scene, {"outputs": ("lod",)}),
    "mirror, distances": (mirror_scene, {"outputs": ("Z", "N")}),
    "mirror, uv": (mirror_scene, {"outputs": ("uv",)}),
    "mirror, bilinear": (mirror_scene, {"filtering": "bilinear"}),
    "mirror": (mirror_scene, {}),
    "two mirrors": (mirror_scene, {"bounces": 2}),
    "parts": (mirror_scene, {"outputs": ("part",)}),
}
# Texels of three channels, and the size of a level by three tables, for each look-up of a filter.
TEXELS = {"point": 3 + 3, "bilinear": 3 + 12, "trilinear": 2 * (3 + 12)}


PALETTE = 3  # look-ups of a material: its row, its kind, its texture; and which it is, where there are several
PART, COORDINATES = 2, 6  # of a brick and a sample; of two stencils, and the chart and the seam in the same way


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return furnish(tmp_path_factory.mktemp("counted"))


@pytest.fixture(scope="module")
def fields(folder):
    return {name: GridField(Grid.load(folder / f"{name}.zarr.zip"), engine="numpy") for name in ("sphere", "mirror")}


def followed(field, rays, turns, mirrors):
    """Send rays and mirror them by the public functions: how many are sent and hit per turn, how many end."""
    sent, met, ended = [0] * turns, [0] * turns, 0
    for turn in range(turns):
        sent[turn] = len(rays.p)
        if not len(rays.p):
            break
        hits, at = transfer(field, rays, on_surface=turn > 0)
        onward = hits.hit & (hits.part == 0) & mirrors
        met[turn], ended = int(hits.hit.sum()), ended + int((hits.hit & ~onward).sum())
        rays = reflect(field, hits, at).where(np.flatnonzero(onward))
    return sent, met, ended


def worked(stage, field):
    """Count what a picture takes."""
    counters = Counters()
    watched = counters.watch(field)
    shoot(replace(stage, field=watched, choice=replace(stage.choice, engine=watched.engine)))
    return counters.work


@pytest.mark.parametrize(("make", "options"), SCENES.values(), ids=SCENES)
def test_counters_count_what_the_plan_says(folder, fields, make, options):
    mirrors = make is mirror_scene
    field = fields["mirror" if mirrors else "sphere"]
    scene = load_scene(make(folder, size=SIZE, **options))
    stage = prepare(scene, field=field)
    work, plan = worked(stage, field), stage.plan
    sent, met, ended = followed(field, scene.camera.camera(SIZE).rays(), len(plan.orders), mirrors)
    said = evaluations(plan, sent, met, ended)
    assert (work.marches, work.values, work.gradients, work.hessians) == (
        said.marches, said.values, said.gradients, said.hessians)  # fmt: skip
    assert work.channels == PART * said.parts + COORDINATES * said.coordinates
    assert work.stencils == work.polynomials + said.values + 2 * said.coordinates
    texels = TEXELS[options.get("filtering", "trilinear")] if "rgb" in plan.outputs and plan.uv else 0
    assert work.scene == (PALETTE + mirrors) * sum(met) + texels * ended
    assert work.polynomials >= sum(met) > 0


@pytest.mark.parametrize("name", ["distances", "mirror, bilinear"])
def test_what_is_left_out_changes_no_march(folder, fields, name):
    """With everything on rays pass the same cells; only the jets and looks at hits are more, by as much as is said."""
    make, options = SCENES[name]
    field = fields["mirror" if make is mirror_scene else "sphere"]
    stage = prepare(load_scene(make(folder, size=SIZE, **options)), field=field)
    orders = (2,) * len(stage.plan.orders)
    full = replace(stage, plan=replace(stage.plan, orders=orders, differentials=True, footprints=True))
    ours, theirs = worked(stage, field), worked(full, field)
    for count in ("marches", "cubes", "absent", "slabs", "polynomials"):
        assert getattr(ours, count) == getattr(theirs, count)
    rays = stage.scene.camera.camera(SIZE).rays()
    sent, met, ended = followed(field, rays, len(orders), make is mirror_scene)
    assert ours.hessians == 0 and theirs.hessians == evaluations(full.plan, sent, met, ended).hessians == sum(met)
