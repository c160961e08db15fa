"""Exact texture coordinates by face: against closed forms, libigl, and differences; its own error told apart."""

import igl
import numpy as np
import pytest

from datasets_synthetic import shape
from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh
from validate.exactuv import ROUNDING, ExactUv, foot


@pytest.fixture(scope="module")
def box():
    return shape("box").mesh(0.17)


@pytest.fixture(scope="module")
def torus():
    return shape("torus").mesh(0.12)


def around(mesh, rng, count=300, off=0.1):
    """Points about the surface."""
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces), size=count)]]
    weights = rng.dirichlet(np.ones(3), count)
    return np.einsum("nk,nkd->nd", weights, corners) + off * rng.normal(size=(count, 3))


def test_a_box_in_closed_form(box, rng):
    """The texture of a box is affine on each of its charts: the mesh's is the shape's at every foot."""
    exact = shape("box")
    p = around(box, rng)
    truth = ExactUv(box).at(p)
    assert np.abs(truth.distance - np.abs(exact.distance(p))).max() < 1e-15  # two float64 units of a size below 2
    read = ExactUv(box).readings(p)
    other = read.chart != truth.chart[read.point]
    same = ~np.isin(np.arange(len(p)), read.point[other])  # where charts meet, each of them is right
    assert same.mean() > 0.6
    assert (np.linalg.norm(truth.uv - exact.uv(p), axis=1)[same] <= truth.error[same]).all()
    assert np.array_equal(truth.chart[same], exact.chart(p)[same])
    assert np.abs(truth.gradient - exact.uv_gradient(p))[same].max() < 1e-13


def test_distances_are_those_of_libigl(torus, rng):
    p = around(torus, rng, 500, 0.3)
    exact = ExactUv(torus)
    square, _, point = igl.point_mesh_squared_distance(p, torus.vertices, torus.faces)
    truth = exact.at(p)
    # Both feet are good to the rounding that the reference claims.
    assert np.abs(truth.distance - np.sqrt(square)).max() < exact.rounding
    ours = np.einsum("nk,nkd->nd", truth.barycentric, torus.vertices[torus.faces[truth.face]])
    assert np.abs(ours - point).max() < exact.rounding
    assert np.allclose(truth.barycentric.sum(axis=1), 1, rtol=0, atol=4 * ROUNDING) and truth.barycentric.min() >= 0


def test_the_gradient_is_a_difference(torus, rng):
    """Within a face the map is affine: a difference over any step is the gradient times it, but for rounding."""
    exact = ExactUv(torus)
    centre = exact.facets.corners.mean(axis=1)[::7]
    step = 1e-3 * rng.normal(size=centre.shape)
    first, second = exact.at(centre - step), exact.at(centre + step)
    assert np.array_equal(first.face, second.face)
    change = np.einsum("nkd,nd->nk", first.gradient, 2 * step)
    assert np.abs(second.uv - first.uv - change).max() < 1e-14


def test_of_equally_near_faces_the_lowest_speaks_and_the_error_says_so(box):
    """In the middle of an edge where the atlas is cut, both readings are within no slack at all."""
    exact = ExactUv(box)
    read = exact.readings(np.array([[0.8, 0.6, 0.02]]))
    truth = exact.at(np.array([[0.8, 0.6, 0.02]]))
    assert len(set(read.chart)) == 2 and truth.face[0] == read.face.min()
    apart = np.linalg.norm(read.uv - truth.uv, axis=1).max()
    assert apart > 0.01 and truth.error[0] >= apart
    assert read.least(np.linalg.norm(read.uv - read.uv[-1], axis=1))[0] == 0  # who says the other is right too


def test_slack_reads_what_is_a_little_farther(box):
    exact = ExactUv(box)
    p = np.array([[0.8, 0.59, 0.02]])  # 0.01 from the edge
    assert set(exact.readings(p).chart) == {1}
    assert set(exact.readings(p, 0.011).chart) == {1, 3} and set(exact.readings(p, 0.009).chart) == {1}


def test_a_sliver_confesses(rng):
    """A face 1e-9 high: its weights are good to 1e-16 / 1e-9 of the texture that it holds, and that is what is said."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-9, 0]])
    exact = ExactUv(Mesh(vertices, np.array([[0, 1, 2]]), rng.uniform(size=(1, 3, 2))))
    error = exact.at(np.array([[0.3, 0.0, 0.2]])).error[0]
    assert 1e-8 < error < 1e-5
    vertices[2] = vertices[1]
    flat = ExactUv(Mesh(vertices, np.array([[0, 1, 2]]), rng.uniform(size=(1, 3, 2))))
    truth = flat.at(np.array([[0.3, 0.0, 0.2]]))
    assert truth.distance[0] == pytest.approx(0.2, rel=1e-15) and truth.error[0] > 0.01 and not truth.gradient.any()


def test_feet_against_a_fine_scan(rng):
    """No point of a fine raster of the triangle is closer, and one is nearly as close."""
    corners, p = rng.normal(size=(40, 3, 3)), rng.normal(size=(40, 3))
    i, j = np.meshgrid(np.arange(201), np.arange(201), indexing="ij")
    inside = i + j <= 200
    weights = np.stack([i, j, 200 - i - j], axis=-1)[inside] / 200
    scanned = np.linalg.norm(np.einsum("wk,nkd->nwd", weights, corners) - p[:, None], axis=2).min(axis=1)
    distance, _ = foot(p, corners)
    assert (distance <= scanned + 1e-15).all()
    assert np.abs(distance - scanned).max() < 8 / 200  # a raster's step times the longest edges of these triangles


def test_it_is_asked_for_a_texture_only_where_there_is_one():
    with pytest.raises(BadInput, match="has none: unwrap it"):
        ExactUv(Mesh(np.eye(3), np.array([[0, 1, 2]])))
