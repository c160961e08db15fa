"""Error against run time: the suite on small sizes, and what its section says of made-up runs."""

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfrender import GridField
from validate.beam import only
from validate.closed import ExactReference
from validate.embree import MeshReference
from validate.experiment import Bench, Run, timed
from validate.sections import frontier as written
from validate.suites import frontier
from validate.suites.convergence import sphere_grid
from validate.timing import Timing


def test_all_routes_go_the_same_way():
    """Each route against closed forms; the limits are a few times what its fitted order leaves at this size."""
    problem = frontier.TORUS
    rays = problem.rays(32)
    truth = frontier.bounced(frontier.exact_tracer(ExactReference(shape("torus"))), rays, 1)
    again = frontier.judged(truth, truth)
    assert again["beam.max"] == again["distance.max"] == again["missed"] == 0
    mesh = frontier.bounced(frontier.mesh_tracer(MeshReference(shape("torus").mesh(0.05))), rays, 1)
    found = frontier.judged(mesh, truth)
    # Interpolated normals: first order in the edge, the beam; second order, the distance: 0.05^2 / 8 / 0.3 = 1e-3.
    assert found["beam.p50"] < 0.05 and found["distance.p50"] < 1e-3 and found["missed"] < 0.01
    assert found["pixels"] > 400


def test_the_beam_is_judged_after_the_last_mirror():
    """A wrong curvature is a wrong beam: truth that is a quarter too long is an error of a quarter everywhere."""
    rays = frontier.SPHERE.rays(16)
    truth = frontier.bounced(frontier.exact_tracer(ExactReference(shape("sphere"))), rays, 1)
    beam = truth.beam
    longer = type(beam)(beam.p, beam.d, beam.dp_dx, beam.dp_dy, 1.25 * beam.dd_dx, 1.25 * beam.dd_dy)
    found = frontier.judged(truth._replace(beam=longer), truth)
    assert found["beam.p50"] == pytest.approx(0.25) and found["beam.max"] == pytest.approx(0.25)
    rest = only(beam, np.arange(1, len(beam.p)))
    fewer = truth._replace(which=truth.which[1:], steepness=truth.steepness[1:], beam=rest)
    assert frontier.judged(fewer, truth)["missed"] == pytest.approx(1 / 256)


def test_two_bounces_leave_fewer_rays_than_one():
    rays = frontier.TORUS.rays(24)
    tracer = frontier.exact_tracer(ExactReference(shape("torus")))
    none, one, two = (frontier.bounced(tracer, rays, count) for count in range(3))
    assert len(none.which) == 24 * 24 > len(one.which) > len(two.which) > 0
    assert set(two.which) < set(one.which)
    field = frontier.field_tracer(GridField(sphere_grid(16), engine="numpy"))
    assert len(frontier.bounced(field, frontier.SPHERE.rays(8), 1).which) > 0


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frontier")
    return list(frontier.run(Bench(folder, folder, quick=True)))


def test_every_error_has_its_clock_and_numpy_its_counts(quick):
    assert all(run.ok for run in quick)
    errors = [run for run in quick if run.kind == "error"]
    clocks = {(run.problem, str(run.setup), str(run.knob)) for run in quick if run.kind == "timing"}
    assert {(run.problem, str(run.setup), str(run.knob)) for run in errors} == clocks
    assert {run.problem for run in errors} == {"sphere, one mirror bounce", "torus, two mirror bounces"}
    for run in errors:
        assert ("work.cubes" in run.values) is (run.setup["kernel"] != "mesh")
    # One march per camera ray, and one for each that hit; every hit has a gradient, every mirror a Hessian besides.
    sphere = next(run.values for run in errors if run.knob == {"resolution": 32})
    share = sphere["work.marches"] - 1
    assert sphere["work.hessians"] == pytest.approx(share) and 0.4 < share < 0.6
    assert sphere["work.gradients"] == pytest.approx(2 * share)
    assert sphere["work.channels"] == 0


def test_finer_is_nearer(quick):
    for problem in (frontier.SPHERE, frontier.TORUS):
        runs = [run for run in quick if run.problem == problem.name and run.kind == "error"]
        grids = [run.values["beam.p50"] for run in runs if "resolution" in run.knob]
        meshes = [run.values["beam.p50"] for run in runs if "edge" in run.knob]
        assert len(grids) == len(meshes) == 2 and grids[1] < grids[0] / 2 and meshes[1] < meshes[0]


def made_up(mesh_error=1e-2, work=True):
    """B-spline grids of order 2 in float32 and float64, and meshes of order 1; a grid at 32^3 errs by 1e-3."""
    runs = []

    def add(setup, knob, error, spacing, cost, counts=None):
        values = {"beam.p50": error, "beam.p95": 2 * error, "missed": 0.0, "spacing": spacing} | (counts or {})
        name = "sphere, one mirror bounce"
        runs.append(Run("frontier", name, setup, knob, "error", values))
        runs.append(timed("frontier", name, setup, knob, Timing((cost * 1e-6,) * 3, ()), rays=1))

    for engine, bits, cost in (("numpy", "64", 40.0), ("drjit", "32", 1.0)):
        for n in (16, 32, 64):
            setup = {"kernel": "bspline", "engine": engine, "precision": bits}
            cubes = {name: 0.0 for _, name in written.WORK} | {"work.cubes": n / 4.0}
            cubes |= {"work.slabs": 4.0, "work.polynomials": 1.0}
            counts = cubes if work and engine == "numpy" else None
            add(setup, {"resolution": n}, 1e-3 * (32 / n) ** 2, 2 / n, cost + n / 100, counts)
    for edge in (0.2, 0.1):
        add(frontier.MESH, {"edge": edge}, mesh_error * edge / 0.1, edge, 3.0)
    return runs


def test_the_finding_follows_the_numbers(undrawn):
    found = written.section(made_up())
    text = " ".join(found.finding)
    assert "the finest mesh (edge 0.1) errs by 0.01 for 3 µs per ray" in text
    # 4e-3 at 16^3 is nearer than 0.01; costs are 1 + 0.16 and 40 + 0.16.
    assert (
        "the coarsest grid that is as exact, bspline at 16³, errs by 0.004 for 1.16 µs on drjit, float32, 40.2" in text
    )
    assert "divides the error by 4.0 (bspline), 2.0 (mesh)" in text
    assert "work per ray from 16³ to 64³: 4 to 16 cubes, 4 to 4 slabs, 1 to 1 polynomials" in text
    assert "slabs settle 75 % of the cells at 64³" in text
    finer = " ".join(written.section(made_up(mesh_error=2e-3)).finding)
    assert "as exact, bspline at 32³" in finer
    assert "no grid is as exact" in " ".join(written.section(made_up(mesh_error=1e-9)).finding)


def test_tables_have_every_point_once_and_the_counts(undrawn):
    points, counts = written.section(made_up()).tables
    assert len(points.rows) == 8 and sum("mesh" in row[0] for row in points.rows) == 2
    assert len(counts.rows) == 3 and counts.rows[0][1] == "4"
    assert len(written.section(made_up(work=False)).tables) == 1


def test_what_failed_is_left_out():
    runs = [run for run in made_up() if run.kind == "error"]
    assert written.section(runs).finding == ("No setup has both an error run and a timed run that succeeded.",)
    numpy_only = [run for run in made_up() if run.setup["kernel"] != "mesh" and run.setup["engine"] == "numpy"]
    found = written.section(numpy_only)
    assert "mesh" not in " ".join(found.finding)
    assert [picture.source[:18] for picture in found.pictures] == ["data:image/svg+xml"]
