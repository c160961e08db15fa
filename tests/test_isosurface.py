"""Meshes out of grids against the shapes the grids were sampled from, and the distance between two meshes."""

import json

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from test_bake_commands import run

from sdfbake import BadInput, Grid, Mesh, bake
from sdfbake.diagnosis import diagnose
from sdfbake.hausdorff import _centres, _samples, hausdorff
from sdfbake.isosurface import _OFF, isosurface
from sdfbake.meshfile import save
from sdfbake.topology import Topology, signed_volume

RADIUS = 0.8


def depth(h, r=RADIUS):
    """Return how far the isosurface of a ball of radius r may be from it, everywhere inwards.

    Along a lattice edge the distance d is convex with 0 <= d'' <= 1 / (r - h), so that linear interpolation is above it
    by at most e = h^2 / (8 (r - h)): vertices lie 0 to e deep. A point sum w_i v_i of a triangle has |p|^2 =
    sum w_i |v_i|^2 - sum_{i<j} w_i w_j |v_i - v_j|^2, where the weights' products sum to 1/3 at most and edges within a
    cell are sqrt(3) h at most: |p|^2 >= (r - e)^2 - h^2.
    """
    e = h**2 / (8 * (r - h))
    return e, r - np.sqrt((r - e) ** 2 - h**2)


@pytest.mark.parametrize("resolution", [16, 40, 77])
def test_sphere(sphere, resolution):
    grid = Grid.from_function(sphere, resolution, uv_mode="none")
    h = grid.lattice.spacing
    made = isosurface(grid)
    assert diagnose(made).findings == ()
    e, deepest = depth(h)
    slack = RADIUS * 2.0**-23 + _OFF * h  # float32 distances; vertices kept off samples
    below = RADIUS - np.linalg.norm(made.vertices, axis=1)
    assert below.min() >= -slack and below.max() <= e + slack
    volume = signed_volume(made.vertices, made.faces)
    ball = 4 / 3 * np.pi * np.array([RADIUS - deepest, RADIUS]) ** 3
    assert ball[0] - slack <= volume <= ball[1] + 4 * np.pi * slack


def test_vertices_converge_with_order_two(sphere):
    worst = []
    for resolution in (32, 64, 128):
        grid = Grid.from_function(sphere, resolution, uv_mode="none")
        worst.append((grid.lattice.spacing, (RADIUS - np.linalg.norm(isosurface(grid).vertices, axis=1)).mean()))
    h, error = np.log(np.array(worst)).T
    assert np.polyfit(h, error, 1)[0] == pytest.approx(2, abs=0.1)  # next order: 1 % of h / r = 0.1 and less


def test_a_hole_is_looked_at_from_inside():
    def shell(p):
        r = np.linalg.norm(p, axis=-1)
        return np.maximum(r - 1, 0.4 - r)

    x = np.linspace(-1.3, 1.3, 40)
    grid = Grid.from_dense(
        shell(np.stack(np.meshgrid(x, x, x, indexing="ij"), -1)), origin=x[[0] * 3], spacing=x[1] - x[0]
    )
    made = isosurface(grid)
    assert diagnose(made).findings == ()
    # Volume of the shell less what `depth` allows at either radius (the hole's vertices are off outwards).
    h = grid.lattice.spacing
    lost = 4 * np.pi * (depth(h, 1)[1] + 0.16 * depth(h, 0.4)[1])
    assert signed_volume(made.vertices, made.faces) == pytest.approx(4 / 3 * np.pi * (1 - 0.4**3), abs=lost)


def test_sparse_is_the_same_as_dense(sphere):
    grid = Grid.from_function(sphere, 33, uv_mode="none")
    values = grid.to_dense().astype(np.float64)
    nx, ny, nz = values.shape
    at = np.moveaxis(np.indices(values.shape), 0, -1).transpose(2, 1, 0, 3).reshape(-1, 3).astype(np.float64)
    there, faces, _ = igl.marching_cubes(values.transpose(2, 1, 0).reshape(-1), at, nx, ny, nz, 0.0)
    made = isosurface(grid)
    ours, theirs = (v[np.lexsort(v.T.round(7))] for v in (grid.lattice.to_grid(made.vertices), there))
    assert len(made.faces) == len(faces)
    np.testing.assert_allclose(ours, theirs, atol=2 * _OFF)


def closed(values):
    """Return noise in a box of positive numbers, so that its surface does not leave the lattice."""
    return np.pad(values, 1, constant_values=1.0)


@pytest.mark.parametrize("digits", [3, 0], ids=["noise", "many zeros"])
def test_no_cracks_in_noise(rng, digits):
    values = closed(rng.normal(size=(15, 18, 21)).round(digits))
    made = isosurface(Grid.from_dense(values))
    topology = Topology.of(made.faces)
    assert (topology.faces_per_edge == 2).all() and len(topology.flipped_edges) == 0
    assert not diagnose(made).has("degenerate")


def test_surface_that_leaves_the_lattice_is_open():
    x = np.linspace(0, 1, 20)
    made = isosurface(Grid.from_dense(np.broadcast_to(x - 0.5, (20, 20, 20)), spacing=x[1]))
    assert diagnose(made).has("open")
    # Float32 of the samples; the plane is met exactly.
    np.testing.assert_allclose(made.vertices[:, 2], 0.5, atol=2e-7)
    p = made.vertices[made.faces]
    assert (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2] > 0).all()  # to where the values grow


def test_no_surface():
    with pytest.raises(BadInput, match="no surface"):
        isosurface(Grid.from_dense(np.ones((9, 9, 9))))


def box(side, at=(0.0, 0.0, 0.0)):
    made = trimesh.creation.box((side, side, side))
    return Mesh(np.asarray(made.vertices) + at, made.faces)


def test_hausdorff_of_nested_cubes():
    found = hausdorff(box(2.0), box(1.0), 0.02)
    # From the large cube: the corner is sqrt(3)/2 away; d^2 = 1/4 + u^2 + v^2 with u = max(|x| - 1/2, 0), whose mean
    # square is 1/24. From the small cube every point is 1/2 away.
    assert found.forth.max == pytest.approx(np.sqrt(3) / 2, rel=1e-14) and found.max == found.forth.max
    # Midpoint rule on pieces of size 0.02: error of order 0.02^2.
    assert found.forth.rms == pytest.approx(np.sqrt(1 / 3), abs=4e-4)
    assert found.back == pytest.approx((0.5, 0.5, 0.5), rel=1e-12)
    assert 0 < found.gap <= 0.02


def test_hausdorff_of_a_shifted_cube():
    found = hausdorff(box(1.0), box(1.0, (0.1, 0.0, 0.0)), 0.05)
    assert found.forth.max == pytest.approx(0.1, rel=1e-12) and found.back.max == pytest.approx(0.1, rel=1e-12)


def test_hausdorff_sees_what_vertices_do_not():
    # The corners of a tetrahedron lie on the cube; the middles of its faces are far from it.
    cube = box(2.0)
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    inner = Mesh(corners, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))
    found = hausdorff(inner, cube, 0.1)
    # The middle of a face is at (1, 1, -1)/3 times one: 2/3 from the nearest wall, and no point of it is farther.
    assert 2 / 3 - found.gap <= found.forth.max <= 2 / 3 + 1e-12


def test_samples_stand_for_the_area():
    mesh = box(1.0)
    mesh = mesh.with_(vertices=mesh.vertices * [1, 2, 5])
    samples = _samples(mesh, 0.3)
    assert samples.area.sum() == pytest.approx(2 * (2 + 5 + 10), rel=1e-13)
    # The largest pieces are those of the halves of the face of 1 x 2, whose diagonal is cut into 8.
    assert samples.area.max() == pytest.approx(1 / 8**2, rel=1e-13)
    # No point of the mesh is farther from a sample than the gap.
    p = np.random.default_rng(1).uniform(-0.5, 0.5, (2000, 3)) * [1, 2, 5]
    p[:, 0] = 0.5
    apart = cKDTree(samples.p).query(p)[0]
    assert 0.1 * samples.gap < apart.max() <= samples.gap <= 0.2


def test_pieces_of_a_triangle_cover_it_evenly():
    for n in (1, 2, 5):
        w = _centres(n)
        assert len(w) == n * n
        np.testing.assert_allclose(w.sum(axis=1), 1, atol=1e-15)
        np.testing.assert_allclose(w.mean(axis=0), 1 / 3, atol=1e-15)
        # The second moment of n^2 equal pieces' centres: E[w^2] = 1/6 less a piece's own variance, (1/18) / n^2.
        np.testing.assert_allclose((w**2).mean(axis=0), 1 / 6 - 1 / 18 / n**2, atol=1e-15)


def test_command(tmp_path):
    shape = trimesh.creation.icosphere(3)
    ball = Mesh(np.asarray(shape.vertices), shape.faces, units="mm")
    save(ball, tmp_path / "ball.ply")
    bake(ball, 40).save(tmp_path / "ball.zarr.zip")
    call = ("mesh", tmp_path / "ball.zarr.zip", "-o", tmp_path / "out" / "iso.ply")
    ended = run(*call, "--json")
    record = json.loads(ended.stdout)
    made = Mesh.load(tmp_path / "out" / "iso.ply")
    assert ended.stderr == "" and "hausdorff" not in record
    assert record["faces"] == len(made.faces) and record["findings"] == [] and made.units == "mm"
    record = json.loads(run(*call, "--json", "--against", tmp_path / "ball.ply").stdout)
    h = Grid.load(tmp_path / "ball.zarr.zip").lattice.spacing
    # Between facets the surface is as in `depth`; edges and corners of convex solids add the cell's own size, no more.
    assert 0 < record["hausdorff"]["voxels"] < 0.5
    assert record["hausdorff"]["world"] == pytest.approx(record["hausdorff"]["voxels"] * h)
    for way in ("to_mesh", "from_mesh"):
        found = record[way]
        assert found["mean"] < found["rms"] < found["max"] <= record["hausdorff"]["world"]
        assert record[f"{way}_voxels"] == pytest.approx({name: value / h for name, value in found.items()})
    assert "missing at most" in run(*call, "--against", tmp_path / "ball.ply").stdout


def test_command_refuses_a_broken_mesh(tmp_path, sphere):
    Grid.from_function(sphere, 16).save(tmp_path / "a.zarr.zip")
    call = ("mesh", tmp_path / "a.zarr.zip", "-o", tmp_path / "a.ply", "--against")
    save(Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, np.nan, 0]]), np.array([[0, 1, 2]])), tmp_path / "b.ply")
    assert "non-finite" in run(*call, tmp_path / "b.ply", code=2).stderr
    assert "no mesh file" in run(*call, tmp_path / "c.ply", code=2).stderr
    assert not (tmp_path / "a.ply").exists()
