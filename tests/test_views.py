"""Where rays come from: parallel cameras, far cameras, samples in their shares."""

import sys

import numpy as np
import pytest
from glassware import PAGE, SHAPES, Ball, paper, scene
from scenery import sphere_scene

from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfbake.complaint import BadInput
from sdfbake.engine import choose
from sdfrender import GridField, OrthographicCamera, render
from sdfrender.viewing import CameraView
from validate.exact import ShapeField

FRONT = {"type": "orthographic", "position": (0.1, -0.2, 1.0), "target": (0.1, -0.2, -2.0), "height": 2.0}


def test_parallel_rays():
    """One direction; origins a grid of square pixels in the plane of the camera; no direction's derivative."""
    camera = OrthographicCamera((1.0, 2.0, 3.0), (1.0, 2.0, -5.0), height=6.0, size=(5, 3))
    rays = camera.rays()
    assert (rays.d == [0, 0, -1]).all() and not rays.dd_dx.any() and not rays.dd_dy.any()
    x, y = np.meshgrid(np.arange(5) - 2.0, 1.0 - np.arange(3))
    expected = np.stack([1 + 2 * x, 2 + 2 * y, 3 + 0 * x], axis=-1).reshape(-1, 3)
    assert rays.p == pytest.approx(expected, abs=1e-14)
    assert np.array_equal(rays.dp_dx, np.tile([2.0, 0, 0], (15, 1))) and np.array_equal(
        rays.dp_dy, -rays.dp_dx[:, [1, 0, 2]]
    )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"height": 0.0}, "height"),
        ({"height": float("inf")}, "height"),
        ({"target": (1.0, 2.0, 3.0)}, "looks at itself"),
        ({"up": (0.0, 0.0, 1.0)}, "along 'up'"),
        ({"size": (4, 0)}, "size"),
    ],
    ids=str,
)
def test_parallel_cameras_that_cannot_be(change, says):
    with pytest.raises(BadInput, match=says):
        OrthographicCamera(**{"position": (1.0, 2.0, 3.0), "target": (1.0, 2.0, -5.0), **change})


@pytest.mark.parametrize("supersample", [1, 3])
def test_the_footprint_of_a_sheet_seen_head_on(supersample):
    """duv_dx = pixel / sheet, whatever the distance and the samples; Z the distance of the planes. To rounding."""
    made = scene([], paper(), camera=FRONT, outputs=("uv", "duv_dx", "duv_dy", "Z", "lod"), size=(20, 10),
                 film={"supersample": supersample})  # fmt: skip
    out = render(made, field=ShapeField(SHAPES["page"]))
    hit = out["Z"][..., 0] > 0
    assert hit.mean() > 0.7 and out["Z"][hit] == pytest.approx(3.0, rel=1e-14)
    pixel, (width, height) = 0.2, PAGE[0]
    assert out["duv_dx"][hit] == pytest.approx(np.tile([pixel / width, 0.0], (hit.sum(), 1)), abs=1e-14)
    assert out["duv_dy"][hit] == pytest.approx(np.tile([0.0, -pixel / height], (hit.sum(), 1)), abs=1e-14)
    column, row = np.meshgrid(np.arange(20) + 0.5 - 10, 5 - np.arange(10) - 0.5)
    uv = np.stack([(0.1 + pixel * column) / width + 0.5, (-0.2 + pixel * row) / height + 0.5], axis=-1)
    assert out["uv"][hit] == pytest.approx(uv[hit], abs=1e-13)


@pytest.fixture(scope="module")
def grid():
    return Grid.from_function(Sphere(1.0), 32, uv_mode="none")


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
@pytest.mark.parametrize("engine", [("numpy", 32), ("drjit", 32)], ids=lambda e: e[0])
def test_a_camera_a_million_radii_away(engine, kind, grid):
    """Float32 next to float64. Z rounds once, 6e-8 of it; P is a root found within 1e-5 of the ball (some 100 roundings
    of 6e-8) over a slope; N follows with the curvature of 1."""
    if engine[0] == "drjit" and choose("auto").engine.name != "drjit":
        pytest.skip("Dr.Jit cannot run here")
    eye = {"position": (3e5, -2e5, 9e5), "target": (0.0, 0.0, 0.0)}
    lens = {"fov": 1.4e-4} if kind == "pinhole" else {"type": kind, "height": 2.4}
    made = scene([Ball(what="diffuse")], camera={**eye, **lens}, outputs=("Z", "P", "N"))
    wide, narrow = (render(made, field=GridField(grid, "bspline", choose(*e))) for e in (("numpy", 64), engine))
    both = (wide["Z"] > 0) & (narrow["Z"] > 0)
    assert both.mean() > 0.4 and ((wide["Z"] > 0) == (narrow["Z"] > 0)).mean() > 0.99
    assert np.abs(narrow["Z"] / np.where(both, wide["Z"], 1.0) - 1)[both].max() < 1.2e-7
    d = -np.array(eye["position"]) / np.linalg.norm(eye["position"])
    slope = np.abs(wide["N"] @ d)[..., None]
    for name in ("P", "N"):
        assert (np.abs(narrow[name] - wide[name]) * np.maximum(slope, 1e-2) * both).max() < 1e-5, name
    assert np.abs(np.linalg.norm(narrow["P"], axis=-1) - 1)[both[..., 0]].max() < 1e-4  # no digits lost to the distance


def places(view, samples=4):
    """Return the places of all samples in their pixels, (samples, pixels, 2), by the beams themselves."""
    field = ShapeField(Sphere(1.0))
    count = view.size[0] * view.size[1]
    found = []
    for number in range(samples):
        pixel = np.arange(count, dtype=np.int32)
        columns = view.columns(field, np.full(count, number, np.int32), pixel)

        def program(xp, *columns):
            beam = view.start(xp, field, columns).beam
            return dict(zip("xyz", beam.p, strict=True))

        out = field.engine.run(program, columns)
        x, y = out["x"] + view.size[0] / 2, view.size[1] / 2 - out["y"]  # pixels of one world unit
        found.append(np.stack([x - pixel % view.size[0], y - pixel // view.size[0]], axis=-1))
    return np.array(found)


def parallel(size=(16, 8)):
    return OrthographicCamera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), height=float(size[1]), size=size)


def test_samples_lie_in_their_shares():
    """Two by two: everyone in a quarter of its own, evenly; another seed, other places; none, the middles.

    Of 128 numbers the mean is 0.5 to 0.29 / sqrt(128) = 0.026; and no place falls on a share's edge by rounding.
    """
    one, again, other = (places(CameraView(parallel(), 2, seed)) for seed in (1, 1, 2))
    assert np.array_equal(one, again) and np.abs(one - other).max() > 0.1
    corner = np.array([[0, 0], [0.5, 0], [0, 0.5], [0.5, 0.5]])[:, None]
    share = (one - corner) / 0.5
    assert share.min() > -1e-12 and share.max() < 1 + 1e-12
    assert np.abs(share.mean(axis=1) - 0.5).max() < 4 * 0.026 and share.std() == pytest.approx(0.289, abs=0.03)
    assert np.abs(np.corrcoef(share[0].T)[0, 1]) < 0.35 and np.abs(np.corrcoef(share[:2, :, 0])[0, 1]) < 0.35
    middles = places(CameraView(parallel(), 2, None))
    assert middles == pytest.approx(corner + 0.25 + 0 * one, abs=1e-12)


def test_a_pixels_samples_do_not_depend_on_the_others():
    view, field = CameraView(parallel(), 2, 7), ShapeField(Sphere(1.0))
    some = np.array([3, 100, 17], np.int32)
    alone = view.columns(field, np.full(3, 2, np.int32), some)
    whole = view.columns(field, np.full(128, 2, np.int32), np.arange(128, dtype=np.int32))
    assert all(np.array_equal(a, b[some]) for a, b in zip(alone[2:], whole[2:], strict=True))
    mixed = view.columns(field, np.array([2, 1, 2], np.int32), some)
    assert mixed[2][0] == alone[2][0] and mixed[2][1] != alone[2][1]


def test_stratified_pictures(monkeypatch):
    """Deterministic; unchanged by how they are cut into batches; and their error falls like 1 / samples^1.5 or so."""
    field = ShapeField(Sphere(1.0))

    def picture(supersample, seed):
        film = {"supersample": supersample, "seed": seed}
        return render(scene([Ball(what="normals")], film=film, outputs=("rgb", "Z")), field=field)

    first = picture(2, 5)
    assert all(np.array_equal(first[name], picture(2, 5)[name]) for name in first)
    assert np.abs(first["rgb"] - picture(2, 6)["rgb"]).max() > 1e-3
    monkeypatch.setattr(sys.modules["sdfrender.render"], "BATCH", 100)
    assert all(np.array_equal(first[name], picture(2, 5)[name]) for name in first)
    monkeypatch.undo()
    truth = render(scene([Ball(what="normals")], film={"supersample": 24}), field=field)["rgb"]
    errors = [np.sqrt(np.mean((picture(n, 5)["rgb"] - truth) ** 2)) for n in (1, 4)]
    assert errors[1] < errors[0] / 4 and errors[1] < 0.02  # unstratified: 16 samples give a quarter


def test_a_parallel_camera_in_a_file(tmp_path):
    """The same picture as of the camera by hand; pinhole keys are none of its."""
    text = (
        sphere_scene(tmp_path, outputs=("Z",)).read_text().replace("fov = 53.13", "height = 2.0\ntype = 'orthographic'")
    )
    path = tmp_path / "parallel.toml"
    path.write_text(text)
    z = render(path, field=ShapeField(Sphere(0.8)))["Z"][..., 0]
    x, y = np.meshgrid(*2 * [(np.arange(32) + 0.5 - 16) / 16])
    inside = x * x + y * y < 0.64
    assert np.array_equal(z > 0, inside)
    assert z[inside] == pytest.approx(1.9 - np.sqrt(0.64 - x * x - y * y, where=inside, out=0 * x)[inside], rel=1e-13)
