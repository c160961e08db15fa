"""Glass: media and ways by tables, and the light of a ball against the whole tree of its paths by hand."""

import sys

import glassware
import numpy as np
import pytest
from glassware import Ball, exact, radiance, scene
from PIL import Image

from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfbake.engine import choose
from sdfrender import GridField, crossing, render
from sdfrender.crossing import Bodies, decide, entering
from sdfrender.render import shoot
from sdfrender.stage import prepare
from validate.exact import ShapeField

# Bodies A, B, C with indices 1.5, 1.2, 1.8 in the order of the scene; part 3 is no glass.
INDICES = (1.5, 1.2, 1.8)
A, B, C = 1, 2, 4
CASES = {
    # part, entering, within: n_i, n_t, within after
    "into A": (0, True, 0, 1.0, 1.5, A),
    "out of A": (0, False, A, 1.5, 1.0, 0),
    "into B in A": (1, True, A, 1.5, 1.2, A | B),
    "out of B in A": (1, False, A | B, 1.2, 1.5, A),
    "into A in B: B is named later": (0, True, B, 1.2, 1.2, A | B),
    "out of A in B, named later": (0, False, A | B, 1.2, 1.2, B),
    "into C in both": (2, True, A | B, 1.2, 1.8, A | B | C),
    "into B in A and C": (1, True, A | C, 1.8, 1.8, A | B | C),
    "out of C in B": (2, False, B | C, 1.8, 1.2, B),
    "into A, thought to be in it": (0, True, A, 1.0, 1.5, A),
    "out of B, thought to be outside": (1, False, A, 1.2, 1.5, A),
}


def test_media(choice):
    """eta = n_i / n_t to a rounding of the division."""
    cases = list(CASES.values())
    part, inward, within, before, beyond, after = (np.array(column) for column in zip(*cases, strict=True))
    bodies = Bodies.of(choice.engine, [0, 1, 2, -1], INDICES)

    def program(xp, part, inward, within):
        eta, inside, there = bodies.cross(xp, part, inward > 0, within, xp.full(part, True))
        return {"eta": eta, "within": inside, "there": xp.integer(there)}

    out = choice.engine.run(program, [part, inward.astype(np.int32), within])
    np.testing.assert_array_equal(out["within"], after)
    np.testing.assert_array_equal(out["there"], [name.count("later") + name.count("and C") == 0 for name in CASES])
    assert out["eta"] == pytest.approx(before / beyond, rel=2 * choice.engine.eps)


def ways(engine, cosine, eta, code, splits, most=2, glass=True):
    """Decide at a surface whose normal is +z, for rays that come down at a cosine (up where it is negative)."""

    def program(xp, c, eta, code, splits):
        zero, one = xp.full(c, 0.0), xp.full(c, 1.0)
        way = decide(
            xp, (xp.sqrt(1.0 - c * c), zero, -c), (zero, zero, one), eta, xp.full(c, glass), code, splits, most
        )
        masks = {name: xp.integer(getattr(way, name)) for name in ("mirrored", "total", "split")}
        return {**masks, "share": way.share, "entering": xp.integer(entering((zero, zero, -c), (zero, zero, one)))}

    columns = np.broadcast_arrays(np.asarray(cosine, float), np.asarray(eta, float), code, splits)
    return engine.run(program, [np.atleast_1d(np.array(column)) for column in columns])


def test_ways_at_normal_incidence(choice):
    """R = ((n - 1) / (n + 1))^2 = 0.04 for 1.5, whichever way; the code's bit number `splits` decides."""
    code, splits = np.array([0, 1, 2, 2, 3, 3, 4]), np.array([0, 0, 0, 1, 1, 2, 2])
    out = ways(choice.engine, 1.0, 1 / 1.5, code, splits)
    assert out["mirrored"].tolist() == [0, 1, 0, 1, 1, 0, 0]  # beyond the two splits the code is not asked
    assert out["split"].tolist() == [1, 1, 1, 1, 1, 0, 0]
    assert not out["total"].any() and out["entering"].all()
    assert out["share"] == pytest.approx(np.where(out["mirrored"], 0.04, 0.96), rel=8 * choice.engine.eps)


def test_ways_that_are_no_choice(choice):
    """Total reflection takes all and no split; equal indices let all pass; what is no glass is left alone."""
    cosine = np.array([-0.5, -1.0])
    out = ways(choice.engine, cosine, 1.5, 1, 0)  # from inside; sin 60 degrees times 1.5 is above 1
    assert out["total"].tolist() == [1, 0] and out["mirrored"].tolist() == [1, 1]
    assert out["split"].tolist() == [0, 1] and out["share"][0] == 1 and not out["entering"].any()
    same = ways(choice.engine, 0.3, 1.0, 1, 0)
    assert (same["mirrored"], same["split"], same["share"]) == (0, 0, 1)
    none = ways(choice.engine, 0.3, 1.5, 1, 0, glass=False)
    assert (none["mirrored"], none["total"], none["split"], none["share"]) == (0, 0, 0, 1)


ONE = Ball()


def sky(p, d):
    return np.ones(len(p))


def camera_rays(made):
    rays = made.camera.camera(made.film.size).rays()
    return rays.p, rays.d


def clear(rays, balls, share=0.02):
    """Which rays pass no ball at a slope below sqrt(2 share): there a rounding decides, and R changes fast."""
    p, d = rays
    good = np.full(len(p), True)
    for ball in balls:
        near = np.linalg.norm(np.cross(p - ball.centre, d), axis=1) / ball.radius
        good &= np.abs(near - 1) > share
    return good


@pytest.mark.parametrize("splits", [0, 1, 2, 4, 6])
def test_what_a_ball_of_glass_loses(splits):
    """In light of 1 all around: 1 - (1 - R) R^S, as inside every reflection has the share R of the first surface.

    Every picture against the tree by hand too: a dozen roundings, R being steep at the edge by 1 / slope.
    """
    made = scene([ONE], trace={"splits": splits, "bounces": 8})
    rays = camera_rays(made)
    rgb = render(made, field=ShapeField(Sphere(1.0)))["rgb"].reshape(-1, 3)
    expected = radiance([ONE], sky, rays, splits, 9)
    good = clear(rays, [ONE], 1e-3)
    assert np.abs(rgb - expected[:, None])[good].max() < 1e-11
    met = glassware.meet([ONE], *rays, np.full(len(rays[0]), -1))
    hit = np.flatnonzero(np.isfinite(met.t))
    share, *_ = glassware.crossed(
        [ONE], rays[1][hit], glassware.Met(*(c[hit] for c in met)), np.zeros((len(hit), 1), bool)
    )
    closed = np.ones(len(rays[0]))
    closed[hit] = 1 - (1 - share) * share**splits if splits else (1 - share) ** 2
    assert np.abs(rgb[:, 0] - closed)[good].max() < 1e-11
    assert 0.2 < hit.size / len(closed) < 0.8
    if splits == 6:  # R is below 0.25 up to 78 degrees: 0.75 * 0.25^6 = 2e-4
        near = np.linalg.norm(np.cross(*rays), axis=1)
        assert (1 - rgb[near < 0.97]).max() < 2e-4


def test_the_check_sees_a_wrong_share(monkeypatch):
    """With the code's bit read one surface late the picture is wrong by more than the tolerance."""
    right = crossing.decide
    monkeypatch.setattr(
        "sdfrender.path.decide", lambda xp, d, n, eta, g, code, s, most: right(xp, d, n, eta, g, code, s + 1, most)
    )
    made = scene([ONE], trace={"splits": 2, "bounces": 8})
    rgb = render(made, field=ShapeField(Sphere(1.0)))["rgb"].reshape(-1, 3)
    expected = radiance([ONE], sky, camera_rays(made), 2, 9)
    assert np.abs(rgb - expected[:, None]).max() > 1e-2


@pytest.mark.parametrize("bounces", [0, 1, 2, 3])
def test_paths_that_are_cut_short_are_black(bounces):
    made = scene([ONE], trace={"splits": 2, "bounces": bounces})
    rays = camera_rays(made)
    rgb = render(made, field=ShapeField(Sphere(1.0)))["rgb"].reshape(-1, 3)
    expected = radiance([ONE], sky, rays, 2, bounces + 1)
    good = clear(rays, [ONE], 1e-3)
    assert np.abs(rgb - expected[:, None])[good].max() < 1e-11


@pytest.fixture(scope="module")
def grid():
    return Grid.from_function(Sphere(1.0), 40, uv_mode="none")


@pytest.mark.parametrize("engine", [("numpy", 64), ("numpy", 32), ("drjit", 32)], ids=lambda e: f"{e[0]}{e[1]}")
def test_a_ball_as_a_grid(engine, grid):
    """Normals of the cubic kernel at 40 samples are within 2e-5 (h^3), and dR/dc is below 3 off the edge; float32
    adds 20 roundings of 6e-8 over the slope of 0.2. The chord back to where it entered is met, or the light is lost."""
    if engine[0] == "drjit" and choose("auto").engine.name != "drjit":
        pytest.skip("Dr.Jit cannot run here")
    made = scene([ONE], trace={"splits": 3})
    rays = camera_rays(made)
    rgb = render(made, field=GridField(grid, "bspline", choose(*engine)))["rgb"].reshape(-1, 3)
    expected = radiance([ONE], sky, rays, 3, 9)
    good = clear(rays, [ONE])
    assert np.abs(rgb - expected[:, None])[good].max() < 2e-4
    assert np.abs(rgb - expected[:, None]).mean() < 2e-3  # the edge itself: 1 in 20 pixels


def test_an_environment_is_no_other_light_than_a_background(tmp_path):
    Image.fromarray(np.full((8, 16, 3), 255, np.uint8)).save(tmp_path / "white.png")
    around = {"image": tmp_path / "white.png"}
    field = ShapeField(Sphere(1.0))
    white = render(scene([ONE]), field=field)["rgb"]
    # Texels and their solid angles are float32; 100 of them in a footprint.
    assert render(scene([ONE], environment=around), field=field)["rgb"] == pytest.approx(white, rel=1e-6)
    half = scene([ONE], environment={**around, "intensity": 0.5, "filter": "bilinear"})
    assert render(half, field=field)["rgb"] == pytest.approx(0.5 * white, rel=1e-6)


PAIRS = {
    "inside, same index": (Ball(), Ball((0.2, 0.1, -0.1), 0.5)),
    "inside, other index": (Ball(), Ball((0.2, 0.1, -0.1), 0.5, index=1.2)),
    "inside, named first": (Ball((0.2, 0.1, -0.1), 0.5, index=1.2), Ball()),
    "air in glass": (Ball(), Ball((0.0, 0.0, 0.0), 0.9, index=1.0)),
    "overlapping": (Ball((-0.4, 0.0, 0.0), 0.7), Ball((0.4, 0.1, 0.2), 0.6, index=1.8)),
    "overlapping, other order": (Ball((0.4, 0.1, 0.2), 0.6, index=1.8), Ball((-0.4, 0.0, 0.0), 0.7)),
    "apart": (Ball((-0.6, 0.0, 0.0), 0.5), Ball((0.6, 0.0, 0.3), 0.5, index=1.3)),
    "mirror in glass": (Ball(), Ball((0.2, 0.1, -0.1), 0.5, "mirror")),
    "glass and mirror": (Ball((-0.6, 0.0, 0.0), 0.5), Ball((0.6, 0.0, 0.3), 0.5, "mirror")),
}


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_two_balls_are_the_tree_by_hand(pair):
    """All ways at the first two surfaces; where a path comes within a rounding of a ball's edge after bending the
    two trees may part, which is so for few pixels. Sums of 4 paths of up to 10 surfaces: some 1e-12 elsewhere."""
    made = scene(pair, trace={"splits": 2, "bounces": 10}, size=(14, 14))
    rays = camera_rays(made)
    rgb = render(made, field=exact(made))["rgb"].reshape(-1, 3)
    expected = radiance(pair, sky, rays, 2, 11)
    error = np.abs(rgb - expected[:, None]).max(axis=1)[clear(rays, pair, 1e-3)]
    assert (error < 1e-9).mean() > 0.99 and np.ptp(expected) > 3e-3


def test_a_ball_of_the_same_index_is_not_seen():
    """Later or earlier, tinted or not where it is hidden: the picture of the outer ball alone."""
    trace = {"splits": 1, "bounces": 8}
    inner = Ball((0.2, 0.1, -0.1), 0.5)
    alone = render(scene([ONE], trace=trace), field=ShapeField(Sphere(1.0)))["rgb"]
    for pair in ([ONE, inner], [inner, ONE]):
        made = scene(pair, trace=trace)
        assert np.abs(render(made, field=exact(made))["rgb"] - alone).max() < 1e-11
    made = scene([inner, ONE], trace=trace)
    hidden = made.assets[0].materials[0].model_copy(update={"colour": (0.5, 0.5, 0.5)})
    tinted = made.assets[0].model_copy(update={"materials": (hidden,)})
    made = made.model_copy(update={"assets": (tinted, made.assets[1])})
    assert np.abs(render(made, field=exact(made))["rgb"] - alone).max() < 1e-11


def test_colours_count_for_every_passage():
    """A tint of 1/2 leaves a quarter of what passes twice; what is mirrored at the first surface keeps its colour."""
    made = scene([ONE], trace={"splits": 1, "bounces": 8})
    tinted = made.assets[0].materials[0].model_copy(update={"colour": (1.0, 0.5, 0.25)})
    coloured = made.model_copy(update={"assets": (made.assets[0].model_copy(update={"materials": (tinted,)}),)})
    rgb = render(coloured, field=ShapeField(Sphere(1.0)))["rgb"].reshape(-1, 3)
    rays = camera_rays(made)
    whole, passed = radiance([ONE], sky, rays, 1, 9), radiance([ONE], sky, rays, 0, 9)
    hit = clear(rays, [ONE], 1e-3) & (np.linalg.norm(np.cross(*rays), axis=1) < 1)
    back = (whole - passed)[:, None]
    assert np.abs(rgb - back - passed[:, None] * np.array([1.0, 0.25, 0.0625]))[hit].max() < 1e-11


def test_batches_of_branches_are_no_larger_than_batches(monkeypatch):
    """Memory does not grow with the splits; and the picture does not depend on how it is cut."""
    module = sys.modules["sdfrender.render"]
    made = scene([ONE], trace={"splits": 2}, size=(12, 12), film={"supersample": 2})
    stage = prepare(made, field=ShapeField(Sphere(1.0)))
    whole, widths = shoot(stage)["rgb"], []
    traced = module._traced
    monkeypatch.setattr(module, "BATCH", 400)
    monkeypatch.setattr(
        module, "_traced", lambda s, o, lanes, w: widths.append(len(lanes.pixel)) or traced(s, o, lanes, w)
    )
    assert np.abs(shoot(stage)["rgb"] - whole).max() < 1e-15 * 64
    assert max(widths) <= 400 and len(widths) > 10
