"""Rays that choose among the levels of a grid: which, what they meet there, how far off that is, what is loaded."""

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import ENGINES
from scenery import sdfrender_caller

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.engine import choose
from sdfbake.engine.numpy import NumpyEngine
from sdfrender import GridField
from sdfrender.assembly import Assembly
from sdfrender.camera import Camera
from sdfrender.field import Spot, Spread
from sdfrender.instance import Instance
from sdfrender.leveled import LeveledField
from sdfrender.levelreach import SHARE, in_reach
from sdfrender.plan import make_plan
from sdfrender.render import render, shoot
from sdfrender.scene import Scene
from sdfrender.similarity import IDENTITY, Similarity
from sdfrender.stage import prepare
from sdfrender.viewing import CameraView
from sdfrender.widths import least_width
from validate.exact import ShapeField

DISTANCES = (2.0, 4.4, 20.0)
NUMPY = choose("numpy", 64)
XP = NumpyEngine(64)
RADIUS = 0.8
ONE_EACH = [pair for pair in ENGINES if pair in (("numpy", 64), ("drjit", 32))]
EXACT = ShapeField(shape("sphere"))
# The B-spline on quasi-interpolating coefficients: its transfer function is 1 - (7/240) w^4 + O(w^6), and the copies of
# the spectrum beside it add up to 2 zeta(4) / (2 pi)^4 w^4: per axis the error is at most this times h^4 d^4f/dx^4.
ERROR = 7 / 240 + 2 * (np.pi**4 / 90) / (2 * np.pi) ** 4
# Of |p|, d^4/dx^4 = 3 (1 - u) (5 u - 1) / r^3 with u = (x / r)^2; over three axes with u + v + w = 1 the magnitudes add
# up to 3 * 2.5 at most, where two of them are 1/2.
FOURTH = 7.5


@pytest.fixture(scope="module")
def grid():
    return Grid.from_function(shape("sphere"), 56, levels=2)


@pytest.fixture(scope="module")
def path(grid, tmp_path_factory):
    path = tmp_path_factory.mktemp("leveled") / "sphere.zarr.zip"
    grid.save(path)
    return path


@pytest.fixture(scope="module")
def field(grid):
    return leveled(grid)


def leveled(grid, choice=NUMPY, share=SHARE, first=0):
    """The field of the levels from one on."""
    return LeveledField([GridField(level, engine=choice) for level in (grid, *grid.levels)[first:]], share)


def three(rows):
    return tuple(np.ascontiguousarray(column) for column in np.asarray(rows, float).T)


def spread_of(rays, anchor=None):
    """How a camera's rays spread, and where they begin."""
    return Spread(*(three(getattr(rays, name)) for name in ("dp_dx", "dp_dy", "dd_dx", "dd_dy")))


def camera(distance, size=24, fov=40.0):
    return Camera((0.3 * distance, 0.2 * distance, distance), (0.0, 0.0, 0.0), fov=fov, size=(size, size))


def entered(field, rays):
    """How far rays go to the field's box, by slabs, and which do meet it."""
    with np.errstate(divide="ignore"):
        ends = (field.bounds[:, None] - rays.p) / rays.d
    near, far = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
    return near, near < far


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("share", [0.5, 1.0, 3.0])
def test_level_of_a_pinhole(grid, field, distance, share):
    """A pixel of side s at unit distance is s cos^2 t wide at the way t along its ray."""
    field, rays = LeveledField(field.members, share), camera(distance).rays()
    level = field.level_of(XP, three(rays.p - field.anchor), three(rays.d), None, spread_of(rays))
    view, right, _ = camera(distance).frame()
    near, meets = entered(field, rays)
    width = np.linalg.norm(right) * (rays.d @ view) ** 2 * near
    expected = np.floor(np.log2(np.maximum(share * width / grid.lattice.spacing, 1))).clip(0, 2)
    on_edge = np.abs(np.log2(share * width / grid.lattice.spacing) % 1 - 0.5) > 0.5 - 1e-9
    assert np.array_equal(level[meets & ~on_edge], expected[meets & ~on_edge]) and meets.sum() > 20


def test_all_levels_are_chosen(field):
    """The cases above do reach them."""
    found = set()
    for distance in DISTANCES:
        rays = camera(distance).rays()
        found |= set(field.level_of(XP, three(rays.p - field.anchor), three(rays.d), None, spread_of(rays)).tolist())
    assert found == {0, 1, 2}


def test_width_is_the_lesser_singular_value(rng):
    """Against NumPy's decomposition at both ends, for beams without a focus between."""
    n = 500
    d = rng.normal(size=(n, 3))
    steps = rng.normal(size=(4, n, 3)) * np.array([1.0, 1.0, 0.05, 0.05])[:, None, None]
    near, far = rng.uniform(0, 0.3, n), rng.uniform(0.4, 1.0, n)
    ours = least_width(XP, three(d), Spread(*map(three, steps)), near, far)
    unit = d / np.linalg.norm(d, axis=1, keepdims=True)

    def cross_section(t):
        q = np.stack([steps[0] + t[:, None] * steps[2], steps[1] + t[:, None] * steps[3]], axis=-1)
        return q - unit[:, :, None] * (unit[:, None] @ q)

    along = np.linspace(near, far, 401)
    area = np.stack([np.linalg.det(np.concatenate([cross_section(t), unit[:, :, None]], axis=2)) for t in along])
    focus = (np.sign(area) != np.sign(area[0])).any(axis=0)
    clear = np.abs(area).min(axis=0) > 1e-3  # a double focus may hide between the places looked at
    singular = [np.linalg.svd(cross_section(t), compute_uv=False)[:, 1] for t in (near, far)]
    expected = np.where(focus, 0.0, np.minimum(*singular))
    assert focus.sum() > 5 and (~focus & clear).sum() > 100
    np.testing.assert_allclose(ours[focus | clear], expected[focus | clear], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("curvature", "focus"), [(-2.0, True), (-0.5, False), (2.0, False)])
def test_a_focus_in_the_box_takes_the_finest(grid, curvature, focus):
    """Steps 1 + curvature t: 0 at t = 1/2, inside, or beyond."""
    one, zero = np.ones(1), np.zeros(1)
    steps = Spread(*((one * a, one * b, zero) for a, b in ((1, 0), (0, 1), (curvature, 0), (0, curvature))))
    width = least_width(XP, (zero, zero, one), steps, zero, one)
    assert width == pytest.approx(0.0 if focus else min(1.0, 1.0 + curvature))


ALL = ("rgb", "Z", "N", "uv", "duv_dx", "lod", "flags", "part")


def scene_of(path, distance, size=24, levels="footprint", materials=({"type": "normals"},), outputs=ALL):
    eye = camera(distance)
    return Scene.model_validate(
        {
            "camera": {"position": eye.position, "target": eye.target, "fov": eye.fov},
            "film": {"size": [size, size], "outputs": list(outputs)},
            "trace": {"levels": levels},
            "assets": [{"grid": path, "materials": list(materials)}],
        }
    )


def assert_same_pictures(ours, theirs):
    for name, image in ours.items():
        np.testing.assert_array_equal(image, theirs[name], err_msg=name)


def test_small_footprints_change_nothing(path):
    """All rays of a picture near enough choose the finest level: bit for bit what no levels give."""
    made = prepare(scene_of(path, 2.0, 256), engine="numpy")
    assert made.read[0][1].levels == (0,)
    near = scene_of(path, 2.0, 16).model_copy(
        update={"camera": scene_of(path, 2.0).camera.model_copy(update={"fov": 2})}
    )
    levels, finest = near, near.model_copy(update={"trace": near.trace.model_copy(update={"levels": "finest"})})
    assert_same_pictures(render(levels, engine="numpy"), render(finest, engine="numpy"))


def test_rays_on_the_finest_level_among_others(field, path):
    """Where rays differ, those on the finest level get the same bits as without the others."""
    made, rays = scene_of(path, 3.0, 32), camera(3.0, 32).rays()
    near, _ = entered(field, rays)
    mixed = LeveledField(field.members, 2 * field.members[0].grid.lattice.spacing / np.median(near * 0.02275 * 0.97))
    level = mixed.level_of(XP, three(rays.p - field.anchor), three(rays.d), None, spread_of(rays)).reshape(32, 32)
    ours, theirs = (render(made, field=each) for each in (mixed, field.members[0]))
    hit = theirs["Z"][..., 0] > 0
    assert (hit & (level == 0)).any() and (hit & (level > 0)).any()
    for name in ours:
        np.testing.assert_array_equal(ours[name][level == 0], theirs[name][level == 0], err_msg=name)
    assert (ours["Z"] != theirs["Z"])[hit & (level > 0)].all()


@pytest.mark.parametrize("number", [0, 1, 2])
def test_bias_of_hits(grid, field, number):
    """The level set of the interpolant lies within its error of the sphere; a ray crosses it at the cosine."""
    level = (grid, *grid.levels)[number]
    eye = camera(3.0, 48)
    out = render(scene_of("none", 3.0, 48), field=field.members[number])
    z, n = out["Z"][..., 0].ravel(), out["N"].reshape(-1, 3)
    rays, hit = eye.rays(), z > 0
    b = np.sum(rays.p * rays.d, axis=1)
    root = b**2 - np.sum(rays.p**2, axis=1) + RADIUS**2
    cosine = np.sqrt(np.maximum(root, 0.0)) / RADIUS
    steep = hit & (cosine > 0.3)
    h = level.lattice.spacing
    # Half as much again for the next order, (h / r)^2 of it at h / r = 0.18 and less; samples are float32, of 6 h at
    # most; the surface's slope along the ray is the cosine.
    bound = 1.5 * ERROR * FOURTH * h**4 / RADIUS**3 + 2**-24 * 6 * h
    distance = np.abs(z - (-b - np.sqrt(np.maximum(root, 0.0))))
    assert steep.sum() > 300
    assert (distance[steep] <= bound / (cosine[steep] - 0.02)).all()
    if number:  # the bound is no idle one
        assert distance[steep].max() > 0.1 * bound
    p = rays.p + z[:, None] * rays.d
    turned = np.linalg.norm(np.cross(n, p / np.linalg.norm(p, axis=1, keepdims=True)), axis=1)
    assert turned[steep].max() < 2 * h**3  # third order: the gradient


def test_bias_is_of_fourth_order(field):
    exact, *found = (render(scene_of("none", 3.0), field=each)["Z"] for each in (EXACT, *field.members[1:]))
    hit = (exact > 0) & (found[0] > 0) & (found[1] > 0)
    worst = [np.median(np.abs(z - exact)[hit]) for z in found]
    assert 3.5 < np.log2(worst[1] / worst[0]) < 4.5


@pytest.mark.parametrize("choice", ONE_EACH, indirect=True)
def test_leaving_rays_stay_on_their_level(grid, choice):
    """The place lies off the finest surface by the bias; still nothing is met on the way out."""
    field = leveled(grid, choice, first=1)

    def program(xp, s):
        zero, one, everybody = s * 0, s * 0 + 1, xp.full(s, True)
        wide = Spread(*((one * a, one * b, zero) for a, b in ((1, 0), (0, 1), (0, 0), (0, 0))))
        narrow = Spread(*((zero, zero, zero) for _ in range(4)))
        first = field.first_hit(xp, (s, zero, one * 2), (zero, zero, -one), everybody, None, wide)
        back = field.first_hit(xp, first.p, (zero, zero, one), first.hit, first, narrow)
        jet, hit = field.jet_at(xp, first, 1), xp.integer(first.hit)
        return {"level": first.locator[0], "hit": hit, "again": xp.integer(back.hit), "z": jet.gradient[2]}

    x = np.linspace(-0.3, 0.3, 7)
    out = field.engine.run(program, [x])
    assert (out["level"] == 1).all() and (out["hit"] == 1).all() and (out["again"] == 0).all()
    # The gradient of the interpolant, of third order in h / r = 0.18.
    np.testing.assert_allclose(out["z"], np.sqrt(1 - (x / RADIUS) ** 2), atol=0.02)


def test_shadows_stay_on_their_level(field):
    """From places on the coarsest level nothing is in the way outward, and the ball itself inward."""

    def program(xp, x):
        zero, one, everybody = x * 0, x * 0 + 1, xp.full(x, True)
        wide = Spread(*((one * a, one * b, zero) for a, b in ((1, 0), (0, 1), (0, 0), (0, 0))))
        first = field.first_hit(xp, (x, zero, 2 * one), (zero, zero, -one), everybody, None, wide)
        ways = {"outward": one, "inward": -one}
        found = {n: field.occluded(xp, first.p, (zero, zero, z), everybody, first, one * 9) for n, z in ways.items()}
        return {"level": first.locator[0], **{name: xp.integer(mask) for name, mask in found.items()}}

    out = field.engine.run(program, [np.linspace(-0.3, 0.3, 7)])
    assert (out["level"] == 2).all() and (out["outward"] == 0).all() and (out["inward"] == 1).all()


def test_an_instance_chooses_the_same_level(field):
    """Twice as large and twice as far is the same picture, however it is turned."""
    placed = Similarity.of_parts(2.0, (1.0, 1.0, 0.0, 70.0), (0.3, -0.2, 0.5))
    rays = camera(4.4).rays()
    shown = Instance(field, placed)
    there = replace(
        rays,
        p=placed.to_world(rays.p),
        d=rays.d @ placed.rotation.T,
        dd_dx=rays.dd_dx @ placed.rotation.T,
        dd_dy=rays.dd_dy @ placed.rotation.T,
    )
    everybody = np.full(len(rays), True)
    ours = shown.first_hit(XP, three(there.p - shown.anchor), three(there.d), everybody, None, spread_of(there))
    theirs = field.first_hit(XP, three(rays.p - field.anchor), three(rays.d), everybody, None, spread_of(rays))
    assert np.array_equal(ours.hit, theirs.hit) and ours.locator[0][ours.hit].max() > 0
    assert np.array_equal(ours.locator[0][ours.hit], theirs.locator[0][theirs.hit])
    np.testing.assert_allclose(ours.t[ours.hit], 2 * theirs.t[theirs.hit], rtol=1e-12)


def test_members_of_an_assembly_choose_for_themselves(field):
    near = Instance(field, Similarity.of_parts(translate=(-1.0, 0.0, 0.0)))
    far = Instance(field, Similarity.of_parts(translate=(1.0, 0.0, -20.0)))
    both = Assembly([near, far])
    rays = Camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), fov=50.0, size=(48, 48)).rays()
    spot = both.first_hit(
        XP, three(rays.p - both.anchor), three(rays.d), np.full(len(rays), True), None, spread_of(rays)
    )
    levels = [Spot(*share).locator[0][share.hit] for share in both._shares(spot)]
    assert levels[0].size and levels[1].size and levels[0].max() < levels[1].min()


@pytest.mark.parametrize(
    ("distance", "supersample"), [(2.0, 1), (4.4, 1), (60.0, 1), (6.0, 3)], ids=["near", "apart", "far", "samples"]
)
def test_only_levels_in_reach_are_read(grid, field, path, distance, supersample):
    """No ray's choice is cut off: the picture is that of all levels, bit for bit."""
    made = scene_of(path, distance)
    made = made.model_copy(update={"film": made.film.model_copy(update={"supersample": supersample})})
    stage = prepare(made, engine="numpy")
    levels = stage.read[0][1].levels
    view = CameraView(camera(distance), supersample, None)
    assert levels == tuple(in_reach(view, IDENTITY, grid.lattice, 2, direct=True))
    assert_same_pictures(shoot(stage), render(made, field=field))
    if distance == 2.0:
        assert levels == (0, 1)
    if distance == 60.0:
        assert levels == (2,) and stage.read[0][1].bytes < 0.1 * path.stat().st_size


def test_parallel_rays_choose_one_level(grid, field, path):
    made = scene_of(path, 3.0)
    flat = {"type": "orthographic", "position": [0.0, 0.0, 3.0], "target": [0.0, 0.0, 0.0], "height": 2.0}
    made = Scene.model_validate({**made.model_dump(exclude_unset=True), "camera": flat})
    stage = prepare(made, engine="numpy")
    assert stage.read[0][1].levels == (int(np.log2(2.0 / 24 / grid.lattice.spacing)),)
    assert_same_pictures(shoot(stage), render(made, field=field))


def test_all_levels_where_rays_go_on(path):
    stage = prepare(scene_of(path, 60.0, materials=[{"type": "mirror"}]), engine="numpy")
    assert stage.read[0][1].levels == (0, 1, 2) and stage.plan.differentials


@pytest.mark.parametrize("choice", ONE_EACH, indirect=True)
def test_engines_agree(path, choice):
    """Rays on the edge between two levels may choose otherwise; few are, and what they meet is near."""
    made = scene_of(path, 4.4, outputs=("Z", "N"))
    ours, found = (shoot(prepare(made, engine=e.engine.name, precision=e.engine.precision)) for e in (NUMPY, choice))
    apart = np.abs(found["Z"] - ours["Z"])
    assert (apart > 1e-5).mean() < 0.01 and apart.max() < 1e-2


def row_of(plan):
    (row,) = [row for row in plan.capabilities if row.what == "grid levels"]
    return row


def test_the_plan_says_that_it_is_an_approximation(path):
    asked, unasked = make_plan(scene_of(path, 3.0)), make_plan(scene_of(path, 3.0, levels="finest"))
    assert asked.grid_levels and row_of(asked).needed and "APPROXIMATE" in row_of(asked).reason
    assert not unasked.grid_levels and not row_of(unasked).needed and "approximation" in row_of(unasked).reason
    assert unasked.assets[0].levels == 0 and asked.assets[0].levels == 2


def test_levels_that_are_not_read_are_counted(path, tmp_path):
    from sdfbake.gridfile import stored_bytes

    sizes = stored_bytes(path)
    unasked = row_of(make_plan(scene_of(path, 3.0, levels="finest")))
    assert unasked.bytes == sum(sizes[f"level{number}"] for number in (1, 2))
    Grid.load(path, levels=False).save(tmp_path / "bare.zarr.zip")
    none = row_of(make_plan(scene_of(tmp_path / "bare.zarr.zip", 3.0)))
    assert not none.needed and "--levels" in none.reason and none.bytes == 0


def test_fields_that_are_no_levels_are_refused(field):
    fields = field.members
    for wrong in (fields[::-1], (fields[0], fields[0]), (fields[0], GridField(Grid.from_function(shape("torus"), 32)))):
        with pytest.raises(ValueError, match="levels of one grid"):
            LeveledField(wrong)


def test_the_command_overrides_the_scene(monkeypatch, capsys, path, tmp_path):
    call = sdfrender_caller(monkeypatch, capsys)
    scene = tmp_path / "scene.toml"
    scene.write_text(
        "[camera]\nposition = [0.0, 0.0, 60.0]\ntarget = [0.0, 0.0, 0.0]\n[film]\nsize = [8, 8]\n"
        f'[[assets]]\ngrid = "{path}"\nmaterials = [{{ type = "normals" }}]\n'
    )
    for option, levels in ((), [0]), (("--levels", "footprint"), [2]):
        code, out, _ = call("render", scene, "-o", tmp_path / "a.exr", "--engine", "numpy", "--json", *option)
        assert code == 0 and json.loads(out)["read"][0]["levels"] == levels
    assert call("render", scene, "-o", tmp_path / "a.exr", "--levels", "coarse")[0] == 2
