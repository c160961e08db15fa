"""Every output: alone and with all others, through files; curvatures, ellipses, flags against their forms."""

import sys

import numpy as np
import pytest
from glassware import SHAPES, Ball, exact, paper, scene
from PIL import Image
from scenery import furnish, mirror_scene

from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from datasets_synthetic.torus import torus
from sdfbake import Grid
from sdfbake.commandline import run
from sdfbake.engine import choose
from sdfrender import Flag, GridField, render
from sdfrender.__main__ import cli
from sdfrender.footprint import ellipse
from sdfrender.image import CHANNELS, read_exr, write_exr
from sdfrender.render import shoot
from sdfrender.stage import prepare
from validate.exact import ShapeField

EVERY = tuple(CHANNELS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return furnish(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def everything(folder):
    """All outputs of the mirror's scene at once."""
    return render(mirror_scene(folder, outputs=EVERY, size=(16, 14)), field=ShapeField(shape("mirror")))


def test_all_of_them(everything):
    assert tuple(everything) == EVERY and len(EVERY) == 15
    for name, array in everything.items():
        assert array.shape == (14, 16, len(CHANNELS[name][0])) and np.isfinite(array).all(), name
        assert np.ptp(array) > 0, name


@pytest.mark.parametrize("name", EVERY)
def test_each_alone_is_the_same(folder, everything, name):
    """What else is asked for changes no bit of an output, but for CLAMPED, which speaks of the colours' look-ups."""
    alone = render(mirror_scene(folder, outputs=(name,), size=(16, 14)), field=ShapeField(shape("mirror")))
    assert list(alone) == [name]
    expected = everything[name]
    if name == "flags":
        expected = expected.astype(int) & ~int(Flag.CLAMPED | Flag.NONLINEAR)
    assert np.array_equal(alone[name], expected)


def command(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["sdfrender", *map(str, arguments)])
    with pytest.raises(SystemExit) as left:
        run(cli, "python -m sdfrender")
    return left.value.code, capsys.readouterr().err


def test_through_the_command_line_and_back(folder, tmp_path, monkeypatch, capsys):
    """Float32 in the file; channel names as documented; the meaning of each in the header."""
    import OpenEXR

    path = mirror_scene(folder, outputs=("rgb",), size=(24, 20))
    names = ",".join(EVERY)
    code, err = command(
        monkeypatch, capsys, "render", path, "-o", tmp_path / "a.exr", "--outputs", names, "--engine", "numpy"
    )
    assert code == 0, err
    found = read_exr(tmp_path / "a.exr")
    assert set(found) == set(EVERY)
    for name, array in render(mirror_scene(folder, outputs=EVERY, size=(24, 20)), engine="numpy").items():
        assert np.array_equal(found[name], array.astype(np.float32)), name
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels, header = set(file.channels()), dict(file.header())
    assert channels == {channel for names, _ in CHANNELS.values() for channel in names}
    assert all(header[f"meaning of {name}"] == meaning for name, (_, meaning) in CHANNELS.items())


def test_files_of_single_outputs(tmp_path, everything):
    for name, array in everything.items():
        write_exr(tmp_path / f"{name}.exr", {name: array})
        assert np.array_equal(read_exr(tmp_path / f"{name}.exr")[name], array.astype(np.float32))


def test_curvature_of_a_ball(choice):
    """Both are 1 / r, to h^2 = 4e-3 of it; float32 adds 6e-8 / h^2. Per world unit: twice the size, half of it."""
    field = GridField(Grid.from_function(Sphere(1.0), 32, uv_mode="none"), "bspline", choice)
    for radius in (1.0, 2.0):
        eye = {"position": (0.0, 0.0, 3.0 * radius), "target": (0.0, 0.0, 0.0)}
        made = scene([Ball(radius=radius, what="diffuse")], camera=eye, outputs=("curvature", "Z"), size=(16, 16))
        out = render(made, field=field)
        hit = out["Z"][..., 0] > 0
        assert out["curvature"][hit] == pytest.approx(1 / radius + 0 * out["curvature"][hit], rel=4e-3)
        assert not out["curvature"][~hit].any() and hit.any()


def test_curvatures_of_a_torus():
    """1 / r across the tube, cos / (R + r cos) along it: greatest and least by eigenvalues that are known."""
    made = scene([Ball(what="diffuse")], outputs=("curvature", "P", "Z"), size=(32, 32))
    ring = torus()
    out = render(made, field=ShapeField(ring))
    hit = out["Z"][..., 0] > 0
    h = ring.hessian(out["P"][hit])
    values = np.sort(np.linalg.eigvalsh(h), axis=1)
    # One of the three is the normal's, 0; the other two are what remains.
    drop = np.argmin(np.abs(values), axis=1)
    kept = np.array([np.delete(row, k) for row, k in zip(values, drop, strict=True)])
    assert out["curvature"][hit] == pytest.approx(kept, rel=1e-6, abs=1e-6) and hit.sum() > 80
    assert out["curvature"][hit][:, 0].min() < -0.1


def test_the_ellipse_is_the_singular_value_decomposition(everything):
    """NumPy's SVD of the same Jacobian in texels; the angle counts where the axes differ, and modulo pi."""
    flat = {name: everything[name].reshape(-1, everything[name].shape[-1]) for name in EVERY}
    there = flat["chart"][:, 0] >= 0
    dx, dy, found = flat["duv_dx"][there], flat["duv_dy"][there], flat["ellipse"][there]
    major, minor, angle = ellipse(dx, dy, (64, 64))
    assert found[:, 0] == pytest.approx(major, rel=1e-12)
    # |det| / major: the lesser one keeps the digits of the determinant, 1e-16 of major squared.
    assert np.abs(found[:, 1] - minor).max() < 1e-12 * major.max()
    turn = np.abs(np.angle(np.exp(2j * (found[:, 2] - angle))))
    assert turn[major > 1.01 * minor].max() < 1e-11
    assert (np.abs(found[:, 2]) <= np.pi / 2 + 1e-12).all() and np.ptp(found[:, 2]) > 0.1
    assert flat["lod_invariant"][there, 0] == pytest.approx(np.log2(major), abs=1e-12)
    texels = np.stack([np.linalg.norm(64 * d, axis=1) for d in (dx, dy)])
    assert flat["lod"][there, 0] == pytest.approx(np.log2(texels.max(axis=0)), abs=1e-12)
    assert not flat["ellipse"][~there].any() and there.sum() > 20


def test_nonlinearity_is_that_of_the_outputs():
    """By the documented formula, pixel by pixel; towards a ball's edge it exceeds the limit."""
    made = scene([Ball(what="diffuse")], outputs=("nonlinearity", "flags", "duv_dx", "duv_dy", "chart"), size=(20, 16))
    out = render(made, field=ShapeField(Sphere(1.0)))
    jacobian = np.stack([out["duv_dx"], out["duv_dy"]], axis=-1)
    chart, (height, width) = out["chart"][..., 0], jacobian.shape[:2]
    expected = np.zeros((height, width))
    for row, column in np.ndindex(height, width):
        for near in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
            if 0 <= near[0] < height and 0 <= near[1] < width and chart[near] == chart[row, column] >= 0:
                change = np.linalg.norm(jacobian[near] - jacobian[row, column])
                expected[row, column] = max(expected[row, column], change / np.linalg.norm(jacobian[row, column]))
    assert out["nonlinearity"][..., 0] == pytest.approx(expected, rel=1e-12)
    flagged = (out["flags"][..., 0].astype(int) & Flag.NONLINEAR) > 0
    assert np.array_equal(flagged, expected > 2 - np.sqrt(2)) and 0 < flagged.mean() < 0.5


def test_charts(everything, folder):
    """The sheet is one chart, what misses has none, and a sphere has its six by the exact shape."""
    miss = (everything["flags"][..., 0].astype(int) & Flag.MISS) > 0
    assert (everything["chart"][miss] == -1).all()
    made = scene([Ball(what="diffuse")], outputs=("chart", "P", "Z"))
    out = render(made, field=ShapeField(Sphere(1.0)))
    hit = out["Z"][..., 0] > 0
    assert np.array_equal(out["chart"][hit][:, 0], Sphere(1.0).chart(out["P"][hit]))
    assert (out["chart"][~hit] == -1).all() and len(np.unique(out["chart"])) > 2


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Pages of 8 and 64 texels."""
    folder = tmp_path_factory.mktemp("pages")
    rng = np.random.default_rng(1)
    for size in (8, 64):
        Image.fromarray(rng.integers(0, 255, (size, size, 3), np.uint8)).save(folder / f"{size}.png")
    return folder


def sheets(pages, texels, filtering, height, **more):
    """A sheet seen at a slant from afar: levels of detail from below 0 to above the top."""
    eye = {"type": "orthographic", "position": (0.0, -3.0, -1.5), "target": (0.0, 0.0, -2.0), "height": height}
    texture = {"name": "page", "image": pages / f"{texels}.png", "filter": filtering, **more}
    outputs = ("rgb", "lod", "flags", "ellipse", "chart")
    made = scene([], paper(texture="page"), camera=eye, outputs=outputs, textures=(texture,), size=(13, 13))
    return render(made, field=ShapeField(SHAPES["page"]))


@pytest.mark.parametrize("texels", [8, 64])
@pytest.mark.parametrize("height", [0.05, 1.0, 30.0], ids=["near", "middle", "far"])
def test_clamped_by_level(pages, texels, height):
    """Exactly where the recorded level is below 0 or above log2 of the size; both ways, and neither."""
    out = sheets(pages, texels, "trilinear", height)
    there = out["chart"][..., 0] >= 0
    lod, flags = out["lod"][..., 0], out["flags"][..., 0].astype(int)
    outside = (lod < 0) | (lod > np.log2(texels))
    assert np.array_equal((flags & Flag.CLAMPED) > 0, outside & there) and there.any()
    assert outside[there].any() if height != 1.0 else True


@pytest.mark.parametrize("most", [2.0, 8.0, 64.0])
def test_clamped_by_anisotropy(pages, most):
    """A sheet at a slope of about 1 in 6: its ellipses are longer than 2, shorter than 64."""
    out = sheets(pages, 64, "anisotropic", 1.0, anisotropy=most)
    there = out["chart"][..., 0] >= 0
    major, minor, _ = np.moveaxis(out["ellipse"], -1, 0)
    ratio = (major / np.where(minor > 0, minor, 1.0))[there]
    flagged = (out["flags"][there][:, 0].astype(int) & Flag.CLAMPED) > 0
    inside = (minor[there] > 1) & (major[there] / most < 8)
    assert inside.any() and not (np.abs(ratio / most - 1) < 0.01).any()
    assert np.array_equal(flagged[inside], (ratio > most)[inside])


def test_nothing_is_clamped_where_nothing_is_filtered(pages):
    for filtering in ("point", "bilinear"):
        assert not (sheets(pages, 8, filtering, 30.0)["flags"].astype(int) & Flag.CLAMPED).any()


def test_misses(everything):
    """MISS is of all rays of a path; a first miss records nothing else."""
    first = everything["part"][..., 0] < 0
    flags = everything["flags"][..., 0].astype(int)
    assert ((flags[first] & Flag.MISS) > 0).all() and first.any()
    for name in ("Z", "P", "N", "curvature", "uv", "duv_dx", "lod", "ellipse", "nonlinearity"):
        assert not everything[name][first].any(), name
    beyond = ((flags & Flag.MISS) > 0) & ~first
    assert beyond.any() and (everything["chart"][beyond] == -1).all() and (everything["Z"][beyond] > 0).all()


def test_flags_of_a_grid_without_texture_coordinates(folder):
    """Nothing to say about seams; all else as ever. One asset without beside one with them, too."""
    text = mirror_scene(folder, outputs=("flags",)).read_text()
    head = text[: text.index("[[textures]]")]
    bare = folder / "bare.toml"
    bare.write_text(head + "[[assets]]\ngrid = 'bare.zarr.zip'\nmaterials = [{ type = 'diffuse' }]\n")
    plain = folder / "plain.toml"
    plain.write_text(head + "[[assets]]\ngrid = 'sphere.zarr.zip'\nmaterials = [{ type = 'diffuse' }]\n")
    ours, theirs = (render(path, engine="numpy")["flags"].astype(int) for path in (bare, plain))
    assert np.array_equal(ours, theirs & ~int(Flag.SEAM)) and (ours & Flag.MISS).any() and (ours == 0).any()
    both = folder / "both.toml"
    beside = "[[assets]]\ngrid = 'bare.zarr.zip'\ntranslate = [0.0, 0.0, -2.0]\nmaterials = [{ type = 'diffuse' }]\n"
    both.write_text(plain.read_text() + beside)
    out = render(both, engine="numpy")["flags"].astype(int)
    assert np.array_equal(out[theirs == 0], theirs[theirs == 0])


def test_the_engines_flags_are_the_same(folder):
    """Bits, not numbers in between: in float64 all of them, but where a rounding decides."""
    if choose("auto").engine.name != "drjit":
        pytest.skip("Dr.Jit cannot run here")
    path = mirror_scene(folder, outputs=("flags", "chart", "part"), size=(24, 20))
    ours, theirs = (render(path, engine=name, precision=64) for name in ("drjit", "numpy"))
    for name, array in theirs.items():
        assert (ours[name] == array).mean() > 0.99 and (ours[name] % 1 == 0).all()


def test_a_glass_scenes_outputs():
    """Z, N and part of the outside of the glass; uv of the sheet behind it."""
    made = scene([Ball()], paper(), outputs=EVERY, trace={"bounces": 4})
    out = render(made, field=exact(made))
    stage = prepare(made, field=exact(made))
    assert all(np.isfinite(array).all() for array in out.values()) and stage.plan.splits == 2
    first = out["part"][..., 0] == 0
    assert np.abs(np.linalg.norm(out["P"], axis=-1)[first] - 1).max() < 1e-12
    assert out["N"][first] == pytest.approx(out["P"][first], abs=1e-12)
    assert out["curvature"][first] == pytest.approx(1.0 + 0 * out["curvature"][first])
    assert (out["chart"][first] >= 0).any() and np.array_equal(shoot(stage)["flags"], out["flags"])


@pytest.fixture(scope="module")
def glass():
    """A hollow ball of glass before the sheet, and all outputs of it."""
    balls = (Ball(), Ball((0.2, 0.1, -0.1), 0.5, index=1.0))
    made = scene(balls, paper(), outputs=EVERY, size=(12, 12), trace={"bounces": 4, "splits": 1})
    return made, render(made, field=exact(made))


@pytest.mark.parametrize("name", ["rgb", "Z", "uv", "nonlinearity", "flags"])
def test_each_alone_behind_glass_is_the_same(glass, name):
    """Without colours no path is split; those that pass wherever they can are the same ones."""
    made, whole = glass
    film = made.film.model_copy(update={"outputs": (name,)})
    alone = render(made.model_copy(update={"film": film}), field=exact(made))[name]
    expected = whole[name]
    if name == "flags":
        assert (expected.astype(int) & Flag.TIR).any()
        expected = expected.astype(int) & ~int(Flag.NONLINEAR)
    assert np.array_equal(alone, expected)
