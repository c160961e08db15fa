"""Light on matt surfaces: Lambert's law, shadows against occlusion by hand, environments with closed irradiance."""

import numpy as np
import pytest
from glassware import CAMERA, PAGE, SHAPES, Ball, exact, paper, scene

from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfbake.engine import choose
from sdfrender import GridField, render
from sdfrender.image import write_exr
from sdfrender.irradiance import directions, irradiance
from validate.exact import ShapeField

MATT = Ball(what="diffuse")
COLOUR = np.array([0.9, 0.5, 0.2])
LAMPS = {
    "point": {"type": "point", "position": (1.5, 2.0, 2.5), "intensity": (8.0, 6.0, 4.0)},
    "near": {"type": "point", "position": (0.0, 0.3, 1.1), "intensity": (1.0, 1.0, 1.0)},
    "directional": {"type": "directional", "direction": (-1.0, -2.0, -2.0), "irradiance": (3.0, 2.0, 1.0)},
    "from behind": {"type": "directional", "direction": (3.0, 0.0, 3.0), "irradiance": (3.0, 2.0, 1.0)},
}


def arriving(lamp, p, n):
    """Irradiance over pi of an unshaded lamp, and the way to it: direction and length."""
    if lamp["type"] == "point":
        way = np.array(lamp["position"]) - p
        length = np.linalg.norm(way, axis=-1)
        toward, strength = way / length[..., None], np.array(lamp["intensity"]) / length[..., None] ** 2
    else:
        toward = np.broadcast_to(-np.array(lamp["direction"]) / np.linalg.norm(lamp["direction"]), p.shape)
        length, strength = np.full(p.shape[:-1], np.inf), np.array(lamp["irradiance"])
    cosine = np.sum(n * toward, axis=-1)
    return np.maximum(cosine, 0.0)[..., None] * strength / np.pi, toward, length


def lit(lights, camera=CAMERA, balls=(MATT,), **more):
    made = scene(
        balls, camera=camera, outputs=("rgb", "P", "N", "Z"), background=(0.0, 0.0, 0.0), lights=lights, **more
    )
    data = made.model_dump(exclude_unset=True)
    data["assets"][0]["materials"] = [{"type": "diffuse", "colour": tuple(COLOUR)}]
    return type(made).model_validate(data)


@pytest.mark.parametrize("lamp", LAMPS.values(), ids=LAMPS)
def test_lamberts_law(lamp):
    """albedo E / pi with E = cos I / r^2, or cos times the irradiance; zero behind. A dozen roundings."""
    made = lit([lamp])
    out = render(made, field=ShapeField(Sphere(1.0)))
    hit = out["Z"][..., 0] > 0
    expected, *_ = arriving(lamp, out["P"], out["P"])  # a unit ball about the origin: n = p
    assert out["rgb"][hit] == pytest.approx(COLOUR * expected[hit], rel=1e-11, abs=1e-13)
    assert not out["rgb"][~hit].any()
    dark = (out["rgb"][hit] == 0).all(axis=-1).mean()
    assert 0 < dark < 1 or lamp["type"] == "point"


def test_lamps_add_up():
    """Sums of three, and every lamp twice is twice the light."""
    field = ShapeField(Sphere(1.0))
    lamps = [LAMPS[name] for name in ("point", "near", "directional")]
    single = [render(lit([lamp]), field=field)["rgb"] for lamp in lamps]
    assert render(lit(lamps), field=field)["rgb"] == pytest.approx(sum(single), rel=1e-14)
    assert render(lit(lamps * 2), field=field)["rgb"] == pytest.approx(2 * sum(single), rel=1e-14)


def test_the_side_that_is_looked_at_is_lit():
    """In a hollow ball with a lamp in it: E by the inward normal; a lamp outside is dark there."""
    eye = {"position": (0.1, 0.0, 0.3), "target": (0.0, 0.0, -1.0), "fov": 90.0}
    lamp = {**LAMPS["near"], "position": (0.3, -0.2, 0.4)}
    out = render(lit([lamp], eye), field=ShapeField(Sphere(1.0)))
    assert (out["Z"] > 0).all()
    expected, _, _ = arriving(lamp, out["P"], -out["P"])
    assert out["rgb"] == pytest.approx(COLOUR * expected, rel=1e-11) and out["rgb"].min() > 0
    outside = render(lit([LAMPS["point"]], eye), field=ShapeField(Sphere(1.0)))
    assert not outside["rgb"].any()


OCCLUDER = Ball((0.3, 0.2, 0.0), 0.5, "diffuse")
HIGH = {**LAMPS["point"], "position": (0.8, 0.9, 2.0)}
LOW = {**LAMPS["point"], "position": (0.2, 0.1, -1.2)}  # between the ball and the sheet
SUN = LAMPS["directional"]
ABOVE = {"position": (-2.5, 0.0, 3.0), "target": (0.0, 0.0, -1.5), "fov": 50.0}


def shaded(p, toward, length, ball, grown=0.0):
    """Whether the way to a lamp meets a ball, grown by a margin."""
    q = p - np.array(ball.centre)
    b, gap = np.sum(q * toward, axis=-1), np.sum(q * q, axis=-1) - (ball.radius + grown) ** 2
    root = np.sqrt(np.maximum(b * b - gap, 0.0))
    return (b * b > gap) & (-b - root < length) & (-b - root > 0)


def check_shadow(out, lamp, ball, margin, inner=1.5):
    """On the front of the sheet: closed occlusion, exact but for what lies within a margin of the shadow's edge."""
    front = (np.abs(out["P"][..., 2] - PAGE[2][2]) < 1e-3) & (out["Z"][..., 0] > 0)
    front &= (np.abs(out["P"][..., :2]) < inner).all(axis=-1)
    p = out["P"][front]
    light, toward, length = arriving(lamp, p, np.array([0.0, 0.0, 1.0]) + 0 * p)
    small, large = (shaded(p, toward, length, ball, grown) for grown in (-margin, margin))
    sure = small == large
    expected = np.where(large[:, None], 0.0, light)
    assert out["rgb"][front][sure] == pytest.approx(expected[sure], rel=1e-4 if margin > 1e-3 else 1e-11, abs=1e-12)
    return large[sure].mean(), sure.mean(), front.sum()


@pytest.mark.parametrize("what", ["diffuse", "mirror", "glass"])
@pytest.mark.parametrize("lamp", [HIGH, SUN], ids=["point", "directional"])
def test_a_ball_casts_its_shadow_on_a_sheet(lamp, what):
    """Whatever it is made of; exact shapes, so the margin is a rounding."""
    ball = OCCLUDER._replace(what=what)
    made = scene([ball], paper(), camera=ABOVE, outputs=("rgb", "P", "Z"), lights=[lamp], size=(40, 40))
    share, sure, count = check_shadow(render(made, field=exact(made)), lamp, ball, 1e-9)
    assert 0.02 < share < 0.9 and sure == 1 and count > 150


def test_a_lamp_between_two_surfaces(monkeypatch):
    """The ball behind the lamp casts nothing on the sheet before it; asked without a limit it would."""
    made = scene([OCCLUDER], paper(), camera=ABOVE, outputs=("rgb", "P", "Z"), lights=[LOW], size=(40, 40))
    share, _, _ = check_shadow(render(made, field=exact(made)), LOW, OCCLUDER, 1e-9)
    assert share == 0
    right = ShapeField.occluded
    monkeypatch.setattr(ShapeField, "occluded", lambda self, xp, p, d, a, s, t: right(self, xp, p, d, a, s, t + np.inf))
    with pytest.raises(AssertionError):
        check_shadow(render(made, field=exact(made)), LOW, OCCLUDER, 1e-9)


def test_shadows_can_be_left_out():
    lamp = {**HIGH, "shadows": False}
    made = scene([OCCLUDER], paper(), camera=ABOVE, outputs=("rgb", "P", "Z"), lights=[lamp], size=(40, 40))
    out = render(made, field=exact(made))
    front = (np.abs(out["P"][..., 2] + 2) < 1e-9) & (out["Z"][..., 0] > 0)
    light, _, _ = arriving(lamp, out["P"][front], np.array([0.0, 0.0, 1.0]))
    assert out["rgb"][front] == pytest.approx(light, rel=1e-11) and light.min() > 0


@pytest.fixture(scope="module")
def grids():
    return [Grid.from_function(SHAPES[name], 40, uv_mode="none") for name in ("ball", "page")]


ENGINES = [("numpy", 64), ("numpy", 32), ("drjit", 32)]


@pytest.fixture(params=ENGINES, ids=[f"{name}{bits}" for name, bits in ENGINES])
def engine(request):
    if request.param[0] == "drjit" and choose("auto").engine.name != "drjit":
        pytest.skip("Dr.Jit cannot run here")
    return choose(*request.param)


def test_shadows_of_grids(engine, grids):
    """A voxel of the ball is 0.06 of its radius, 0.03 here: no pixel further from the edge than that is wrong.

    Six voxels of the sheet, 0.5, from its border its normals feel its edges; 0.27 per voxel, as B-splines do.
    """
    fields = [GridField(grid, "bspline", engine) for grid in grids]
    made = scene([OCCLUDER], paper(), camera=ABOVE, outputs=("rgb", "P", "Z"), lights=[HIGH], size=(40, 40))
    share, sure, count = check_shadow(render(made, field=fields), HIGH, OCCLUDER, 0.03, 1.0)
    assert 0.02 < share < 0.9 and sure > 0.85 and count > 150


def test_a_ball_does_not_shade_itself(engine, grids):
    """Every place that a lamp is above the horizon of is lit, and by Lambert's law; float32 to 1e-3 of a slope."""
    made = lit([{**SUN, "direction": (-3.0, -1.0, -0.5)}], size=(48, 48))
    out = render(made, field=GridField(grids[0], "bspline", engine))
    hit = out["Z"][..., 0] > 0
    light, toward, _ = arriving(made.lights[0].model_dump(), out["P"][hit], out["N"][hit])
    slope = np.sum(out["N"][hit] * toward, axis=-1)
    seen = out["rgb"][hit]
    assert np.count_nonzero((slope > 0.01) & (seen[:, 0] == 0)) == 0
    assert not seen[slope < -1e-6].any()
    assert np.abs(seen - COLOUR * light)[slope > 0.01].max() < 1e-5
    assert np.count_nonzero(slope > 0.01) > 300 < np.count_nonzero(slope < -0.01)


def test_a_hollow_grid_does_not_shade_itself(engine, grids):
    """From inside a lamp's light comes through the solid: the place that it falls on is no surface in its way.

    A kernel's normals are good to 2e-5, places to 1e-5 at a distance of 0.6 from the lamp.
    """
    eye = {"position": (0.1, 0.0, 0.3), "target": (0.0, 0.0, -1.0), "fov": 90.0}
    lamp = {**LAMPS["near"], "position": (0.3, -0.2, 0.4)}
    out = render(lit([lamp], eye, size=(48, 48)), field=GridField(grids[0], "bspline", engine))
    expected, _, _ = arriving(lamp, out["P"], -out["N"])
    assert np.count_nonzero(out["rgb"][..., 0] == 0) == 0
    assert out["rgb"] == pytest.approx(COLOUR * expected, rel=1e-4)


@pytest.fixture(scope="module")
def skies(tmp_path_factory):
    """A constant sky, and one that is linear in the direction."""
    folder = tmp_path_factory.mktemp("skies")
    constant = np.broadcast_to(np.array([0.25, 0.5, 2.0]), (32, 64, 3))
    write_exr(folder / "constant.exr", {"rgb": constant})
    write_exr(folder / "linear.exr", {"rgb": linear(directions(256, 128))})
    return folder


SLOPE = np.array([[0.5, 0.2, -0.3], [0.0, 0.6, 0.0], [-0.3, 0.0, 0.6]])


def linear(d):
    return 1.0 + d @ SLOPE.T


@pytest.mark.parametrize("intensity", [1.0, 3.0])
def test_a_constant_sky_shows_the_albedo(skies, intensity):
    """The mean of a constant is the constant: float32 tables, two look-ups, 1e-6."""
    made = scene([MATT], environment={"image": skies / "constant.exr", "intensity": intensity}, outputs=("rgb", "Z"))
    out = render(made, field=ShapeField(Sphere(1.0)))
    assert out["rgb"] == pytest.approx(intensity * np.array([0.25, 0.5, 2.0]) + 0 * out["rgb"], rel=2e-6)
    assert 0.2 < (out["Z"] > 0).mean() < 0.8


def test_a_linear_sky_has_a_linear_irradiance():
    """a + b . d gives a + 2/3 b . n. The sum over 128 x 64 texels: the kink of the cosine costs h^2 = 0.0024 times
    less than the slope's 0.6."""
    sums = irradiance(linear(directions(256, 128)).astype(np.float32))
    exact_ = 1.0 + 2 / 3 * directions(64, 32) @ SLOPE.T
    assert np.abs(sums - exact_).max() < 1e-3
    assert np.abs(sums - linear(directions(64, 32))).max() > 0.1


def test_a_linear_sky_on_a_ball(skies, choice):
    """Bilinear look-ups between texels of 0.1 rad: 0.1^2 / 8 of 2/3 |b|, 1e-3, and the sum's own error."""
    made = scene([MATT], environment={"image": skies / "linear.exr"}, outputs=("rgb", "N", "Z"))
    field = ShapeField(Sphere(1.0)) if choice.engine.precision == 64 and choice.engine.name == "numpy" else None
    field = field or GridField(Grid.from_function(Sphere(1.0), 24, uv_mode="none"), "bspline", choice)
    out = render(made, field=field)
    hit = out["Z"][..., 0] > 0
    expected = 1.0 + 2 / 3 * out["N"] @ SLOPE.T
    assert np.abs(out["rgb"] - expected)[hit].max() < 2.5e-3
    rays = made.camera.camera(made.film.size).rays().d.reshape(out["rgb"].shape)
    assert np.abs(out["rgb"] - linear(rays))[~hit].max() < 1e-3  # beside the ball: the sky itself, texels of 0.025


def test_lamps_and_sky_add_up(skies):
    field, around = ShapeField(Sphere(1.0)), {"image": skies / "linear.exr", "intensity": 0.5}
    made = [
        scene([MATT], outputs=("rgb", "Z"), **more)
        for more in ({"environment": around, "lights": [SUN]}, {"environment": around}, {"lights": [SUN]})
    ]
    both, sky, lamp = (render(one, field=field) for one in made)
    hit = both["Z"][..., 0] > 0
    assert both["rgb"][hit] == pytest.approx(sky["rgb"][hit] + lamp["rgb"][hit], rel=1e-13)


def test_no_light_at_all_shows_the_albedo():
    made = lit([])
    out = render(made, field=ShapeField(Sphere(1.0)))
    hit = out["Z"][..., 0] > 0
    assert (out["rgb"][hit] == COLOUR).all() and not out["rgb"][~hit].any()


def test_normals_do_not_care_for_lamps():
    made = scene([Ball(what="normals")], outputs=("rgb", "N", "Z"), lights=[SUN])
    out = render(made, field=ShapeField(Sphere(1.0)))
    hit = out["Z"][..., 0] > 0
    assert np.array_equal(out["rgb"][hit], 0.5 * out["N"][hit] + 0.5)


def test_a_mirror_shows_what_is_lit():
    """The shadow in the mirror is the shadow: both balls' light where the mirrored ray ends, by hand."""
    mirror = Ball((0.0, 0.0, 0.5), 0.6, "mirror")
    eye = {"position": (0.0, 0.0, -1.9), "target": (0.0, 0.0, 1.0), "fov": 30.0}
    made = scene([mirror], paper(), camera=eye, outputs=("rgb", "P", "N", "part"), lights=[HIGH], size=(40, 40))
    out = render(made, field=exact(made))
    met = out["part"][..., 0] == 0
    d = made.camera.camera(made.film.size).rays().d.reshape(40, 40, 3)[met]
    p, n = out["P"][met], out["N"][met]
    d = d - 2 * np.sum(d * n, axis=-1, keepdims=True) * n
    t = (PAGE[2][2] - p[:, 2]) / np.where(d[:, 2] < 0, d[:, 2], np.nan)
    at = p + t[:, None] * d
    on = (np.abs(at[:, :2]) < 1.5).all(axis=1)
    light, toward, length = arriving(HIGH, at[on], np.array([0.0, 0.0, 1.0]) + 0 * at[on])
    expected = np.where(shaded(at[on], toward, length, mirror)[:, None], 0.0, light)
    assert on.sum() > 40 and 0 < (expected == 0).mean() < 1
    assert out["rgb"][met][on] == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("length", [1e-200, 1e200], ids=str)
def test_a_direction_may_have_any_length(length):
    field, direction = ShapeField(Sphere(1.0)), np.array(SUN["direction"])
    long = {**SUN, "direction": tuple(length * direction)}
    ours, theirs = (render(lit([lamp]), field=field)["rgb"] for lamp in (long, SUN))
    assert ours == pytest.approx(theirs, rel=1e-13) and ours.any()
