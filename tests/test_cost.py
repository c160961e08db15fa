"""What exactness costs a bake: the suite on a small mesh, and what its section says of made-up runs."""

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfbake import bake
from sdfbake.complaint import BadInput
from sdfbake.meshfile import save
from sdfbake.metadata import MODES
from validate.experiment import Bench, Run, timed
from validate.sections import cost as written
from validate.suites import cost
from validate.timing import Timing

N = 64


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """A build with a coarse torus and its grid in all modes."""
    folder = tmp_path_factory.mktemp("build")
    mesh = shape("torus").mesh(0.15)
    (folder / "meshes").mkdir()
    save(mesh, folder / "meshes" / "torus.ply")
    (folder / "grids").mkdir()
    bake(mesh, N, uv_mode=MODES).save(folder / "grids" / f"torus@{N}.zarr.zip")
    return folder


@pytest.fixture(scope="module")
def quick(build):
    return list(cost.run(Bench(build, build, quick=True)))


def test_every_mode_has_an_error_and_a_clock(quick):
    assert all(run.ok for run in quick)
    assert [(run.kind, run.setup["uv"]) for run in quick] == [
        (kind, mode) for mode in ("none", "faces") for kind in ("error", "timing")
    ]
    none, faces = (run.values for run in quick if run.kind == "error")
    assert "lod.p50" in faces and "lod.p50" not in none
    assert none["distance.bspline.p50"] == faces["distance.bspline.p50"] > 0


def test_errors_of_distances_are_those_of_the_facets(quick):
    """Of order an interpolation's of a distance with edges: less than a voxel's, more than a thousandth of it.

    What the asset says is the greatest over two places of some cells of a brick, so that the median over bricks is
    above that over points, and the greatest of all points, near all cells, at most some times what it says.
    """
    values = quick[0].values
    voxel = 1.0 / (N - 1)
    assert 1e-3 * voxel < values["distance.bspline.p99"] < values["distance.bspline.max"] < voxel
    assert values["asset.bspline.p50"] > values["distance.bspline.p50"]
    assert values["distance.bspline.max"] < 5 * values["asset.bspline.max"]


def test_distances_of_a_shifted_mesh_are_wrong_by_the_shift(build):
    """A truth that lies a hundredth of its size elsewhere is an error of that order; halved by slopes at random."""
    grid = cost.Grid.load(build / "grids" / f"torus@{N}.zarr.zip")
    mesh = cost.Mesh.load(build / "meshes" / "torus.ply")
    right = cost.distances(grid, cost.Subject("torus", mesh))
    moved = mesh.vertices + np.array([0.01 * cost.Subject("torus", mesh).size, 0.0, 0.0])
    wrong = cost.distances(grid, cost.Subject("torus", cost.Mesh(moved, mesh.faces, mesh.uv, mesh.chart)))
    assert right["distance.linear.p50"] < 1e-3
    assert 2e-3 < wrong["distance.bspline.p50"] < 1e-2


@pytest.mark.parametrize("mode", ["none", *MODES])
def test_bytes_are_those_of_a_file_with_that_mode_alone(mode, build, tmp_path):
    """But for what the file says about itself: metadata and directory, a few kilobytes."""
    mesh = cost.Mesh.load(build / "meshes" / "torus.ply")
    bake(mesh, N, uv_mode=mode).save(tmp_path / "alone.zarr.zip")
    alone = (tmp_path / "alone.zarr.zip").stat().st_size
    taken = cost.bytes_of(build / "grids" / f"torus@{N}.zarr.zip", mode)
    assert alone - 2e4 < taken <= alone


def test_unknown_objects_are_refused(build):
    with pytest.raises(BadInput, match="'cow'"):
        list(cost.run(Bench(build, build, only="cow")))


def made_up():
    """Each doubling: a quarter of the error, twice the seconds, four times the bytes; grids ten times as wrong."""
    runs = []
    for mode, factor, seconds, size in (
        ("none", None, 0.1, 1e5),
        ("faces", 1.0, 0.1, 1e6),
        ("layers", 1.5, 0.3, 2e5),
        ("grid", 10.0, 0.2, 3e5),
    ):
        for step, n in enumerate((64, 128, 256)):
            fine = 4.0**-step
            values = {f"{name}.{key}": 1e-4 * fine for name in ("asset.bspline",) for key in ("p50", "max")}
            values |= {f"distance.bspline.{key}": 5e-5 * fine for key in ("p50", "p99", "max")}
            values |= {"distance.linear.p50": 3e-4 * fine * fine, "edge_over_h": 0.5 * 2**step}
            values |= {"bytes": size * 4.0**step, "bytes_per_sample": 2.0, "samples": 1e6}
            if factor is not None:
                values |= {"lod.p50": 0.1 * factor * fine, "lod.p95": factor * fine, "lod.share>0.5": 0.01 * factor}
            setup, knob = {"uv": mode}, {"resolution": n}
            runs.append(Run("cost", "bunny", setup, knob, "error", values))
            runs.append(timed("cost", "bunny", setup, knob, Timing((seconds * 2**step,), ())))
    return runs


def test_the_finding_follows_the_numbers(undrawn):
    found = written.section(made_up())
    text = " ".join(found.finding)
    assert "each doubling divides the error of the distance by 4 (median) and 4 (99 %)" in text
    assert "takes 2 times the seconds and 4 times the bytes" in text
    assert "against seconds: on the front are 3 faces; layers and grid never" in text
    # Layers at 128^3 (0.0375 for 0.8 MB) beat faces at 64^3 (0.1 for 1 MB), at 256^3 those at 128^3; not the finest.
    assert "against bytes: on the front are 3 layers, 1 faces; grid never" in text
    assert "as faces 0.00625 (median) and 0.0625 (95 %)" in text and "for 0.4 s and 16 MB" in text
    assert "the asset itself says 6.3e-6 (median over bricks)" in text
    # Sixteenths against quarters: 1.9e-5 and 1.2e-6 of linear against 1.2e-5 and 3.1e-6 of the B-spline.
    assert "at 256³, where edges are 2 voxels long, linear interpolation errs by 1.2e-6" in text
    assert [len(table.rows) for table in found.tables] == [12]


def test_what_has_no_clock_is_left_out():
    errors = [run for run in made_up() if run.kind == "error"]
    assert written.section(errors).finding == ("No setup has both an error run and a timed run that succeeded.",)
    drawn = written.section([run for run in made_up() if run.setup["uv"] in ("none", "faces")])
    assert len(drawn.pictures) == 2 and "on the front" not in " ".join(drawn.finding)
