"""The comparison of representations: points and their truth in closed form, planted errors, a small run of it all."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from datasets_synthetic import shape
from datasets_synthetic.scenes import scene, scene_names
from datasets_synthetic.texture import save_texture
from sdfbake.bake import bake
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.gridfile import stored_bytes
from sdfbake.mesh import Mesh
from sdfbake.meshfile import save
from sdfbake.metadata import MODES
from sdfrender import Flag, Footprint
from validate.experiment import Bench
from validate.suites import representations
from validate.suites.representations import errors, scattered, size_of
from validate.views import TEXELS

COUNT = 20_000


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """A build of one object: a sphere of six charts."""
    folder = tmp_path_factory.mktemp("build")
    for name in ("meshes", "grids", "textures"):
        (folder / name).mkdir()
    mesh = shape("sphere").mesh(0.2)
    save(mesh, folder / "meshes/sphere.ply")
    bake(mesh, 32, uv_mode=MODES, engine="numpy").save(folder / "grids/sphere@32.zarr.zip")
    save_texture("checker", folder / "textures/checker.png")
    return folder


def sphere():
    return shape("sphere").mesh(0.3)


def test_points_are_spread_evenly(rng):
    """Of 20,000 points a share q is met to five standard errors, 5 sqrt(q (1 - q) / n); a weight w of a triangle has
    mean 1/3 and mean square 1/6, with standard deviations of 0.24 and 0.2."""
    small, large = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 1], [3, 0, 1], [0, 1, 1]]
    mesh = Mesh(np.array(small + large, float), np.arange(6).reshape(2, 3), np.zeros((2, 3, 2)))
    places = scattered(mesh, COUNT, rng)
    assert abs((places.face == 1).mean() - 0.75) < 5 * np.sqrt(0.75 * 0.25 / COUNT)
    of_second = np.where(places.face == 1, places.p[:, 0] / 3, places.p[:, 0])
    for weight in (of_second, places.p[:, 1], 1 - of_second - places.p[:, 1]):
        assert weight.min() >= -1e-12
        assert abs(weight.mean() - 1 / 3) < 5 * 0.24 / np.sqrt(COUNT)
        assert abs((weight**2).mean() - 1 / 6) < 5 * 0.2 / np.sqrt(COUNT)


def test_the_truth_is_the_faces_own(rng):
    """Against the affine map of each face by least squares: numbers of order 1 and faces of good shape, so 1e-12."""
    mesh = sphere()
    places = scattered(mesh, 500, rng)
    corners, uv = mesh.vertices[mesh.faces[places.face]], mesh.uv[places.face]
    slope = np.swapaxes(np.linalg.pinv(corners[:, 1:] - corners[:, :1]) @ (uv[:, 1:] - uv[:, :1]), 1, 2)
    expected = uv[:, 0] + np.einsum("ncd,nd->nc", slope, places.p - corners[:, 0])
    assert np.abs(places.truth.uv - expected).max() < 1e-12
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for column, dp in enumerate((places.dp_dx, places.dp_dy)):
        assert np.abs(np.sum(normal * dp, axis=1)).max() < 1e-12
        moved = np.einsum("ncd,nd->nc", slope, dp) * TEXELS
        assert np.abs(places.truth.jacobian[:, :, column] - moved).max() < 1e-12 * TEXELS * 10
    assert np.array_equal(places.truth.chart, mesh.chart[places.face])


def answer(truth, *, shift=0.0, stretch=1.0, strangers=0, seams=0):
    """The truth with errors of known size: texels, a factor, and so many points with another chart or a seam."""
    count = np.arange(len(truth.t))
    jacobian = truth.jacobian * stretch / TEXELS
    flags = np.where(count < seams, Flag.SEAM, 0)
    chart = truth.chart + (count < strangers)
    nothing = np.zeros(len(count))
    uv = truth.uv + shift / TEXELS * np.array([0.6, -0.8])
    return Footprint(uv, jacobian[:, :, 0], jacobian[:, :, 1], nothing, nothing, chart, flags)


def test_planted_errors_are_found(rng):
    truth = scattered(sphere(), 400, rng).truth
    right = errors(answer(truth), truth)
    # Differences of texture coordinates of order 1, in texels.
    assert right["uv.max"] < 1e-12 * TEXELS and right["lod.max"] < 1e-12
    assert right["wrong_chart"] == right["seam"] == right["lod.share>0.5"] == 0
    wrong = errors(answer(truth, shift=3.0, stretch=4.0, strangers=100, seams=40), truth)
    assert wrong["uv.p50"] == pytest.approx(3.0, rel=1e-9)
    assert wrong["lod.p50"] == pytest.approx(2.0, rel=1e-9) and wrong["lod.share>0.5"] == 1
    assert wrong["wrong_chart"] == 0.25 and wrong["seam"] == 0.1 and wrong["points"] == 400


@pytest.mark.parametrize("mode", MODES)
def test_bytes_are_what_the_representation_adds(mode, build, tmp_path):
    """A file with one representation and one with none differ by it alone."""
    grid = Grid.load(build / "grids/sphere@32.zarr.zip")
    bare = replace(grid, uv=None, chart=None, face=None, surface=None, layers=None)
    kept = {"faces": ("face", "surface"), "layers": ("layers",), "grid": ("uv", "chart")}[mode]
    sizes = []
    for name, saved in (("bare", {}), ("one", {channel: getattr(grid, channel) for channel in kept})):
        modes = (mode,) if saved else ()
        metadata = grid.metadata.model_copy(update={"uv_modes": modes})
        replace(bare, metadata=metadata, **saved).save(tmp_path / f"{name}.zarr.zip")
        sizes.append(sum(stored_bytes(tmp_path / f"{name}.zarr.zip").values()))
    assert size_of(build / "grids/sphere@32.zarr.zip", mode) == sizes[1] - sizes[0] > 0


@pytest.fixture(scope="module")
def runs(build, tmp_path_factory):
    """Every run of the suite, on the small sphere."""
    small = {
        "NAMES": ("sphere",),
        "RESOLUTIONS": (32,),
        "POINTS": 4000,
        "SHOWN": "sphere",
        "SHOWN_RESOLUTION": 32,
        "SIZE": 48,
        "CLOCKED": "sphere",
        "CLOCKED_RESOLUTIONS": (32,),
        "CLOCKED_POINTS": 1000,
        "DIRECTIONS": {"sphere": (0.2, 0.3, 1.0)},
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in small.items():
            patch.setattr(representations, name, value)
        bench = Bench(build, tmp_path_factory.mktemp("runs"))
        found = list(representations.run(bench))
        clock = list(representations.run(replace(bench, only="clock")))
        with pytest.raises(BadInput, match="'bunny'.*sphere, clock"):
            list(representations.run(replace(bench, only="bunny")))
    return bench, found, clock


def test_all_representations_are_judged_shown_and_timed(runs):
    bench, found, clock = runs
    assert all(run.ok for run in found + clock), [run.status for run in found + clock]
    kernels = [(mode, "bspline") for mode in MODES] + [("grid", "linear"), ("grid", "catmull-rom")]
    setups = [(run.setup["uv"], run.setup["kernel"]) for run in found if "points" in run.values]
    assert setups == kernels
    timed = [run for run in found if run.kind == "timing"]
    assert [run.setup["uv"] for run in timed] == [run.setup["uv"] for run in clock] == list(MODES)
    assert all(run.values["us_per_ray"] > 0 for run in timed)
    views = [run for run in found if run.artefact]
    assert [run.setup["uv"] for run in views] == list(MODES)
    for run in views:
        with np.load(bench.artefacts / run.artefact) as arrays:
            assert arrays["image"].shape == (48, 48, 3) and np.ptp(arrays["image"]) > 100
            # A ball in a picture that just holds the ball around its box: tan(asin(sin(17.5) / sqrt 3)) / tan(17.5)
            # of half a side, and an outline of a pixel's width at most.
            assert abs(np.isfinite(arrays["lod_error"]).mean() - 0.2456) < np.pi * 27 / 48**2 / 2


def test_faces_are_exact_and_interpolation_is_not(runs):
    """Texture coordinates of order 1 by several sums: 1e-12 of them. A cut every eighth of the sphere's girth, and
    stencils of six samples of 32, spoil much of the surface."""
    _, found, _ = runs
    values = {
        run.setup["uv"]: run.values for run in found if "points" in run.values and run.setup["kernel"] == "bspline"
    }
    assert values["faces"]["uv.max"] < 1e-12 * TEXELS
    assert values["faces"]["wrong_chart"] == values["faces"]["lod.share>0.5"] == values["faces"]["seam"] == 0
    assert values["layers"]["wrong_chart"] < 0.02 and values["layers"]["lod.share>0.5"] < 0.01
    assert values["grid"]["lod.share>0.5"] > 0.1 and values["grid"]["seam"] > 0.1


@pytest.mark.parametrize("name", scene_names())
def test_the_figures_read_texture_coordinates_as_the_source_does(name):
    asset = tomllib.loads(scene(name))["assets"][0]
    assert asset.get("uv", "auto") == ("grid" if "mirror@" in asset["grid"] else "auto")
