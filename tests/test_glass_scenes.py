"""What is seen through glass: texture coordinates and their derivatives against rays bent by hand, mirrors in glass,
an eye in glass, engines against each other."""

import numpy as np
import pytest
from glassware import CAMERA, SHAPES, Ball, exact, meet, on_paper, paper, scene, straight
from PIL import Image

from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfbake.engine import choose
from sdfrender import Flag, GridField, Rays, render
from sdfrender.plan import make_plan
from sdfrender.render import shoot
from sdfrender.stage import prepare
from sdfrender.viewing import GivenView
from validate.displaced import richardson

ONE = Ball()
SEEN = ("uv", "duv_dx", "duv_dy", "flags")
PAIRS = {
    "one ball": (ONE,),
    "nested": (ONE, Ball((0.2, 0.1, -0.1), 0.5, index=1.2)),
    "overlapping": (Ball((-0.4, 0.0, 0.0), 0.7), Ball((0.4, 0.1, 0.2), 0.6, index=1.8)),
    "nearly air": (Ball((0.1, 0.0, 0.0), index=1.0 + 1e-6),),
}


def offset_rays(made, dx, dy):
    """Rays through displaced pixels of a scene's camera: positions and directions from the picture's plane."""
    camera, (width, height) = made.camera, made.film.size
    x = np.arange(width)[None, :] + 0.5 + dx - width / 2 + np.zeros((height, 1))
    y = np.arange(height)[:, None] + 0.5 + dy - height / 2 + np.zeros((1, width))
    pixel = 2 * np.tan(np.radians(camera.fov) / 2) / height
    assert camera.target[:2] == camera.position[:2] and camera.up == (0, 1, 0)  # right is x, down is -y
    d = np.stack([x * pixel, -y * pixel, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    return np.broadcast_to(camera.position, d.shape).copy(), d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("balls", PAIRS.values(), ids=PAIRS)
def test_the_sheet_behind_glass(balls):
    """Texture coordinates through up to six surfaces to rounding; derivatives within the truth's own error."""
    made = scene(balls, paper(), outputs=SEEN, trace={"bounces": 8})
    out = {name: array.reshape(-1, array.shape[-1]) for name, array in render(made, field=exact(made)).items()}

    def by_hand(dx, dy):
        p, d, free, total = straight(balls, offset_rays(made, dx, dy), 9)
        return np.where((free & ~total)[:, None], on_paper(p, d), np.nan)

    uv, truth = by_hand(0, 0), richardson(by_hand, step=0.02)
    there = np.isfinite(uv).all(axis=1)
    assert there.sum() > 150
    close = np.abs(out["uv"] - uv).max(axis=1) < 1e-11
    assert close[there].mean() > 0.995  # a ray that grazes an edge falls either way
    assert not out["uv"][~there & np.isfinite(by_hand(0.5, 0.5)).all(axis=1) & (out["flags"][:, 0] == 1)].any()
    for name, theirs, error in (("duv_dx", truth.d_dx, truth.error_dx), ("duv_dy", truth.d_dy, truth.error_dy)):
        clear = there & close & (error < 1e-5).all(axis=1)
        assert clear.sum() > 0.85 * there.sum()
        # Rounding of 1e-13 after some surfaces, over half the step.
        assert (np.abs(out[name] - theirs) <= 3 * error + 1e-10)[clear].all(), name
    through = np.isfinite(meet(balls, *offset_rays(made, 0, 0), np.full(len(uv), -1)).t)
    assert (there & through).sum() > 50


def test_a_wrong_eta_is_seen(monkeypatch):
    """With all bodies one, an inner ball of its own index is bent by as if it stood in air: the test above fails."""
    monkeypatch.setattr("sdfrender.stage._glass", lambda *_: None)
    with pytest.raises(AssertionError):
        test_the_sheet_behind_glass(PAIRS["nested"])


def test_total_reflection_is_flagged():
    """A ball of air in glass: rays that meet it flat are mirrored and flagged, by hand and in the picture."""
    balls = (ONE, Ball((0.0, 0.0, 0.0), 0.7, index=1.0))
    made = scene(balls, outputs=("flags",), size=(32, 32), trace={"bounces": 8})
    flags = render(made, field=exact(made))["flags"].ravel().astype(int)
    _, _, free, total = straight(balls, offset_rays(made, 0, 0), 9)
    differs = ((flags & Flag.TIR) > 0) != total
    assert 30 < total.sum() < 600 and free.all()
    # The critical ray is the tangent to the ring where 1.5 sin = 1: some pixels within 1e-3 of it may differ: none.
    assert differs.sum() == 0
    assert ((flags & Flag.MISS) > 0).all()


def test_a_mirror_inside_glass():
    """Its first hit is the glass, its end the sheet behind the eye: the mirrored page, by hand."""
    eye = {"position": (0.0, 0.0, -1.9), "target": (0.0, 0.0, 3.0), "fov": 20.0}
    balls = (Ball((0.0, 0.0, 1.5)), Ball((0.0, 0.0, 1.5), 0.6, "mirror"))
    made = scene(balls, paper(), camera=eye, outputs=("uv", "part"), trace={"bounces": 4}, size=(32, 32))
    out = render(made, field=exact(made))
    rays = made.camera.camera(made.film.size).rays()
    p, d, free, total = straight(balls, (rays.p, rays.d), 5)
    uv = np.where((free & ~total)[:, None], on_paper(p, d), np.nan)
    there = np.isfinite(uv).all(axis=1)
    assert there.sum() > 40 and out["part"].ravel()[there].max() == 0
    assert (np.abs(out["uv"].reshape(-1, 2) - uv).max(axis=1)[there] < 1e-11).all()


EYES = {
    "in the ball": ((ONE,), (0.0, 0.0, 0.3)),
    "in both": ((ONE, Ball((0.2, 0.1, 0.0), 0.6, index=1.2)), (0.0, 0.0, 0.3)),
    "in the outer one": ((ONE, Ball((0.1, 0.1, -0.5), 0.3, index=1.2)), (0.0, 0.0, 0.5)),
    "in the first, the second around it": ((Ball((0.2, 0.1, 0.0), 0.6, index=1.2), ONE), (0.0, 0.0, 0.3)),
}


@pytest.mark.parametrize("case", EYES.values(), ids=EYES)
def test_an_eye_inside_glass(case):
    """What holds the eye is asked of the surfaces, not of the path: the page through the last surfaces by hand."""
    balls, position = case
    eye = {"position": position, "target": (*position[:2], -1.0), "fov": 60.0}
    made = scene(balls, paper(), camera=eye, outputs=("uv",), trace={"bounces": 6})
    uv = render(made, field=exact(made))["uv"].reshape(-1, 2)
    p, d, free, total = straight(balls, offset_rays(made, 0, 0), 7)
    expected = np.where((free & ~total)[:, None], on_paper(p, d), np.nan)
    there = np.isfinite(expected).all(axis=1)
    assert there.sum() > 100
    assert (np.abs(uv - expected).max(axis=1) < 1e-11)[there].mean() > 0.99


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Grids of a ball and of the sheet, and a page."""
    folder = tmp_path_factory.mktemp("glass")
    Grid.from_function(Sphere(1.0), 40, uv_mode="none").save(folder / "ball.zarr.zip")
    Grid.from_function(SHAPES["page"], 40).save(folder / "page.zarr.zip")
    row, column = np.mgrid[0:64, 0:64]
    squares = np.where((row // 8 + column // 8) % 2, 230, 20).astype(np.uint8)
    Image.fromarray(np.stack([squares, row.astype(np.uint8) * 3, 255 - squares], axis=-1)).save(folder / "page.png")
    return folder


def stored(folder, made):
    """Return the scene with grids from the folder."""
    assets = tuple(asset.model_copy(update={"grid": folder / asset.grid}) for asset in made.assets)
    textures = tuple(t.model_copy(update={"image": folder / t.image}) for t in made.textures)
    return made.model_copy(update={"assets": assets, "textures": textures})


TEXTURE = ({"name": "page", "image": "page.png"},)
ALL = ("rgb", "Z", "P", "N", "uv", "duv_dx", "lod", "flags", "part")


@pytest.fixture(scope="module")
def two_balls(folder):
    """Two bodies before a textured sheet, and its picture."""
    trace = {"bounces": 4, "splits": 1}
    made = scene(PAIRS["overlapping"], paper(texture="page"), outputs=ALL, textures=TEXTURE, trace=trace, size=(16, 16))
    made = stored(folder, made)
    return made, render(made, engine="numpy")


@pytest.mark.parametrize("engine", [("numpy", 32), ("drjit", 64)], ids=lambda e: f"{e[0]}{e[1]}")
def test_engines_agree(two_balls, engine):
    """Two bodies and a textured sheet, all outputs. In float64 where no rounding decides; in float32 in the middle."""
    if engine[0] == "drjit" and choose("auto").engine.name != "drjit":
        pytest.skip("Dr.Jit cannot run here")
    made, reference = two_balls
    ours = render(made, engine=engine[0], precision=engine[1])
    same = (reference["flags"] == ours["flags"]) & (reference["part"] == ours["part"])
    assert same.mean() > (0.999 if engine[1] == 64 else 0.97)
    for name, array in reference.items():
        error = np.abs(ours[name] - array) / np.maximum(np.abs(array), np.abs(array).mean())
        if engine[1] == 64:  # 1e-16 after four surfaces that magnify
            assert np.quantile(error, 0.995) < 1e-9, name
        else:
            assert np.median(error) < 1e-5 and np.quantile(error, 0.9) < 5e-3, (name, np.median(error))
    assert {0, 1, 2, -1} == set(np.unique(reference["part"]).astype(int))


def test_grids_show_what_exact_shapes_show(folder):
    """Positions within 2e-6, normals 2e-5, magnified by the ball some ten times: the page is 3 wide."""
    made = scene((ONE,), paper(), outputs=("uv", "flags"), trace={"bounces": 4})
    ours, reference = render(stored(folder, made), engine="numpy"), render(made, field=exact(made))
    both = (ours["flags"].astype(int) | reference["flags"].astype(int)) & Flag.MISS == 0
    assert both.mean() > 0.5
    inner = both[..., 0] & (np.abs(reference["uv"] - 0.5).max(axis=-1) < 0.45)
    assert np.quantile(np.abs(ours["uv"] - reference["uv"])[inner], 0.95) < 1e-3


def test_touching_balls_are_finite(folder):
    """At the place where they touch, at the edge, anywhere: numbers, and no more light than there is."""
    pair = (Ball((-0.5, 0.0, 0.0), 0.5), Ball((0.5, 0.0, 0.0), 0.5, index=1.3))
    made = stored(folder, scene(pair, paper(), outputs=ALL, size=(12, 12), trace={"bounces": 3, "splits": 1}))
    for precision in (32, 64):
        out = render(made, engine="numpy", precision=precision)
        assert all(np.isfinite(array).all() for array in out.values())
        assert out["rgb"].max() <= 1 + 1e-6 and out["rgb"].min() >= 0 and out["rgb"].mean() > 0.9


def test_the_short_program_is_the_long_one(folder):
    """Paths of two hits at most: unrolled for one bounce, hit by hit for three. The same bits."""
    made = scene((Ball((0.0, 0.0, 0.5), 0.6, "mirror"),), paper(texture="page"), outputs=ALL, textures=TEXTURE)
    camera = {**CAMERA, "position": (0.0, 0.0, -1.5), "target": (0.0, 0.0, 1.0), "fov": 25.0}
    data = {**made.model_dump(exclude_unset=True), "camera": camera}
    for engine in ("numpy", choose("auto").engine.name):
        pictures = []
        for bounces in (1, 3):
            cut = stored(folder, type(made).model_validate({**data, "trace": {"bounces": bounces}}))
            assert len(make_plan(cut).orders) == bounces + 1
            pictures.append(render(cut, engine=engine, precision=64))
        short, long = pictures
        for name, array in short.items():
            if engine == "numpy":
                assert np.array_equal(array, long[name]), name
            else:  # its compiler contracts the two programs' products and sums differently
                assert array == pytest.approx(long[name], rel=1e-9, abs=1e-11), name
        assert len(np.unique(short["rgb"])) > 100 and (short["flags"] == 0).mean() > 0.1


def test_rays_that_start_in_different_bodies():
    """`within` is asked of every ray's own origin: from inside the inner ball, the outer one, and from air."""
    balls = (ONE, Ball((0.2, 0.1, -0.1), 0.5, index=1.2))
    p = np.array([[0.2, 0.1, 0.0], [0.1, 0.0, 0.8], [0.1, 0.1, 2.5], [-0.5, -0.3, 0.1], [0.0, 0.0, 0.2]])
    d = np.array([[0.2, 0.1, -1.0]]) + 0 * p
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    made = scene(balls, paper(), outputs=("uv",), trace={"bounces": 6})
    view = GivenView(Rays(p, d, *(0 * p for _ in range(4))), (5, 1))
    uv = render(made, field=exact(made), view=view)["uv"][0]
    q, e, free, total = straight(balls, (p, d), 7)
    expected = on_paper(q, e)
    assert free.all() and not total.any() and np.isfinite(expected).all()
    assert np.abs(uv - expected).max() < 1e-11
    turned = prepare(made, field=exact(made), view=view)
    assert turned.within().tolist() == [3, 1, 0, 1, 3]
    assert np.array_equal(shoot(turned)["uv"][0], uv)


def test_a_single_pixel_of_surfaces_that_are_given(folder):
    """Grids with texture coordinates in place of the scene's: prepared before a compiled program asks for them; and
    one path alone, which to an engine looks like a number that all share."""
    grids = [Grid.load(folder / name) for name in ("ball.zarr.zip", "page.zarr.zip")]
    camera = {**CAMERA, "position": (0.0, 0.0, -1.5), "target": (0.1, 0.0, 1.0)}
    made = scene(
        (Ball((0.0, 0.0, 0.5), 0.6, "mirror"),), paper(), camera=camera, outputs=("rgb", "uv", "Z"), size=(1, 1)
    )
    pixels = []
    for name in ("numpy", choose("auto").engine.name):
        fields = [GridField(grid, "bspline", choose(name, 64)) for grid in grids]
        pixels.append(render(made, field=fields))
    ours, theirs = pixels
    assert all(ours[name] == pytest.approx(theirs[name], rel=1e-9) for name in ours) and ours["uv"].all()
