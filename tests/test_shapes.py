"""Exact shapes against meshes, differences, closed forms and identities."""

import json
from collections.abc import Callable
from pathlib import Path

import igl
import numpy as np
import pytest

import datasets_synthetic
from datasets_synthetic import __main__ as commands
from datasets_synthetic import real
from datasets_synthetic.box import Box
from datasets_synthetic.knot import knot
from datasets_synthetic.net import FACES, Net
from datasets_synthetic.sheet import sheet
from datasets_synthetic.sphere import Sphere
from datasets_synthetic.torus import torus
from datasets_synthetic.tube import Tube
from datasets_synthetic.union import Union
from sdfbake.commandline import run
from sdfbake.complaint import BadInput

SHAPES = {name: datasets_synthetic.shape(name) for name in datasets_synthetic.exact_names()}
#: Greatest curvature of each surface: 1 / r, or 1 / (reach - r) on the inner side of a tube.
CURVATURE = {"sphere": 1.25, "torus": 3.4, "box": 0.0, "sheet": 0.0, "knot": 8.4, "mirror": 1.25}
CURVATURE |= {"plane": 0.0, "wall": 0.0, "cylinder": 1 / 0.6, "cone": 20.0, "capsule": 2.0, "ellipsoid": 0.95 / 0.5**2}
APEX = np.array([0.0, 0.0, 0.7])  # of the cone; no other shape's surface is there
CURVATURE |= {"gyroid": 36.5, "bumps": 7.7, "terrain": 17.9}  # measured on 20,000 to 70,000 samples
#: Surfaces with saddles: chords and facets are on either side of them.
SADDLES = {"gyroid", "bumps", "terrain"}
#: Facets cut from a lattice: cuts between charts run through them, and volumes cancel where facets cut off saddles.
CUT = {"gyroid"}
each_shape = pytest.mark.parametrize("name", SHAPES)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20181)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def around(name: str, rng: np.random.Generator, count: int, widen: float = 1.6) -> np.ndarray:
    """Points inside and outside, `count` of them in a box `widen` times the shape's."""
    low, high = SHAPES[name].bounds
    return (low + high) / 2 + widen / 2 * (high - low) * rng.uniform(-1, 1, (count, 3))


def on_surface(name: str, rng: np.random.Generator, count: int) -> np.ndarray:
    """Points on random facets of a mesh, dropped to the surface: none exactly on an edge of a box."""
    mesh = datasets_synthetic.mesh(name, 0.1)
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces), size=count)]]
    p = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(3), size=count), corners)
    shape = SHAPES[name]
    return p - shape.distance(p)[:, None] * shape.normal(p)


def differences(
    f: Callable[[np.ndarray], np.ndarray], p: np.ndarray, v: np.ndarray, limit: float = 1e-4
) -> tuple[np.ndarray, np.ndarray]:
    """Richardson-extrapolated derivative of f along v, and where its two steps agree within `limit`.

    Where f is smooth they differ by the h^2 term; with h / length scale <= 1e-2 an h^4 term below 1e-4 of that is left.
    Rounding: 1e-15 / 2e-4 = 5e-12. Where the second derivative of f jumps (over the edge of a face), both steps and
    their extrapolation err by at most twice what the steps differ by. At a cut or crease they differ by far more.
    """
    h = 2e-4
    coarse = (f(p + h * v) - f(p - h * v)) / (2 * h)
    fine = (f(p + h / 2 * v) - f(p - h / 2 * v)) / h
    error = np.abs(fine - coarse).reshape(len(p), -1).max(axis=1)
    return (4 * fine - coarse) / 3, error < limit


@each_shape
def test_distance_is_that_to_a_fine_mesh(name: str, rng: np.random.Generator) -> None:
    shape, p = SHAPES[name], around(name, rng, 1500)
    mesh = datasets_synthetic.mesh(name)
    longest = np.linalg.norm(mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)], axis=2).max()
    squared = igl.point_mesh_squared_distance(p, mesh.vertices, mesh.faces)[0]
    # The distance, interpolated linearly (0) on a facet inside a ball of radius longest / sqrt(3), errs by half its
    # second derivative times that radius squared; 1.2 for the curvature of the offset surfaces in between.
    bound = 1.2 * CURVATURE[name] * longest**2 / 6 + 1e-12
    distance = shape.distance(p)
    np.testing.assert_allclose(np.abs(distance), np.sqrt(squared), rtol=0, atol=bound)
    winding = igl.fast_winding_number(mesh.vertices, mesh.faces, p)
    clear = np.abs(distance) > 2 * bound
    assert clear.mean() > 0.9
    assert np.array_equal(winding[clear] > 0.5, distance[clear] < 0)
    assert 50 < np.count_nonzero(distance < 0) < 1450


@each_shape
def test_normal_is_the_unit_gradient(name: str, rng: np.random.Generator) -> None:
    shape, p = SHAPES[name], around(name, rng, 600)
    n = shape.normal(p)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-14)
    columns = [differences(shape.distance, p, np.broadcast_to(axis, p.shape), 1e-6) for axis in np.eye(3)]
    smooth = np.all([good for _, good in columns], axis=0)
    gradient = np.stack([column for column, _ in columns], axis=1)
    # Steps of 2e-4 across the medial axis: of a wall 0.02 thick, at least 2e-4 / 0.01 of the points inside.
    assert smooth.mean() > 0.96
    np.testing.assert_allclose(gradient[smooth], n[smooth], atol=2e-6)
    np.testing.assert_allclose(np.linalg.norm(gradient[smooth], axis=1), 1, atol=4e-6)


@each_shape
def test_hessian_is_the_derivative_of_the_normal(name: str, rng: np.random.Generator) -> None:
    shape = SHAPES[name]
    p = np.concatenate([around(name, rng, 400), on_surface(name, rng, 400)])
    hessian = shape.hessian(p)
    np.testing.assert_allclose(hessian, np.swapaxes(hessian, 1, 2), atol=0)
    # Curvatures reach 1e3 close to the curve of a tube; the zero is relative to them.
    size = 1 + np.abs(hessian).max(axis=(1, 2))
    assert np.abs(np.einsum("nij,nj->ni", hessian, shape.normal(p))).max(axis=1) / size == pytest.approx(0, abs=1e-12)
    columns = [differences(shape.normal, p, np.broadcast_to(axis, p.shape)) for axis in np.eye(3)]
    smooth = np.all([good for _, good in columns], axis=0)
    assert smooth.mean() > 0.9
    numeric = np.stack([column for column, _ in columns], axis=2)
    np.testing.assert_allclose(numeric[smooth], hessian[smooth], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "p", "eigenvalues"),
    [
        ("sphere", [0, 0, 0.8], [0, 1.25, 1.25]),
        ("sphere", [0, 0, 1.6], [0, 0.625, 0.625]),
        ("torus", [1, 0, 0], [0, 1, 1 / 0.3]),
        ("torus", [0.4, 0, 0], [-2.5, 0, 1 / 0.3]),
        ("torus", [0, 0.7, 0.3], [0, 0, 1 / 0.3]),
        ("box", [0, 0, 0.6], [0, 0, 0]),
        ("box", [0, 0.7, 0.6], [0, 0, 1 / np.hypot(0.1, 0.1)]),
        ("box", [0.9, 0.7, 0.6], [0, 1 / np.sqrt(0.03), 1 / np.sqrt(0.03)]),
    ],
)
def test_principal_curvatures_in_closed_form(name: str, p: list[float], eigenvalues: list[float]) -> None:
    found = np.linalg.eigvalsh(SHAPES[name].hessian(np.array([p], float)))[0]
    np.testing.assert_allclose(found, eigenvalues, atol=1e-12)


@each_shape
def test_uv_gradient_along_the_surface(name: str, rng: np.random.Generator) -> None:
    shape, q = SHAPES[name], on_surface(name, rng, 600)
    n, gradient = shape.normal(q), shape.uv_gradient(q)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", gradient, n), 0, atol=1e-13)
    first = unit(np.cross(n, unit(rng.normal(size=q.shape))))
    for tangent in (first, np.cross(n, first)):
        # The foot of q + h v is q + h v to first order for a tangent v, so the foot needs no derivative of its own.
        numeric, smooth = differences(shape.uv, q, tangent)
        assert smooth.mean() > 0.95
        np.testing.assert_allclose(numeric[smooth], np.einsum("nij,nj->ni", gradient, tangent)[smooth], atol=1e-6)


@each_shape
def test_answers_about_the_surface_are_those_of_the_foot(name: str, rng: np.random.Generator) -> None:
    shape, p = SHAPES[name], around(name, rng, 800)
    foot = p - shape.distance(p)[:, None] * shape.normal(p)
    np.testing.assert_allclose(shape.distance(foot), 0, atol=4e-15)
    # Past a box's edge the foot lies on two faces; rounding then picks either.
    alike = shape.chart(foot) == shape.chart(p)
    assert alike.mean() > 0.5
    alike &= np.linalg.norm(foot - APEX, axis=1) > 1e-9  # around a cone's apex the texture has no one direction
    np.testing.assert_allclose(shape.uv(foot)[alike], shape.uv(p)[alike], atol=1e-12)
    np.testing.assert_allclose(shape.uv_gradient(foot)[alike], shape.uv_gradient(p)[alike], atol=1e-10)
    assert np.array_equal(shape.part(foot), shape.part(p))


@each_shape
def test_first_hits(name: str, rng: np.random.Generator) -> None:
    shape = SHAPES[name]
    o = 4 * unit(rng.normal(size=(800, 3)))
    d = unit(around(name, rng, 800, 1.2) - o)
    outside = shape.distance(o) > 0
    o, d = o[outside], d[outside]
    t = shape.intersect(o, d)
    hit = np.isfinite(t)
    assert 0.2 < hit.mean() < 0.99
    p = o[hit] + t[hit, None] * d[hit]
    # Rounding of t and p at a distance of 6: 6 * 2.2e-16, a few times.
    np.testing.assert_allclose(shape.distance(p), 0, atol=8e-15)
    assert np.all(np.sum(shape.normal(p) * d[hit], axis=1) < 1e-7)
    share = (np.arange(150) + 0.5) / 150
    if name in SADDLES:  # whose distance is an iteration: every tenth ray
        o, d, t, hit = o[::10], d[::10], t[::10], hit[::10]
    along = np.where(hit, t, 8.0)[:, None] * share
    before = shape.distance((o[:, None] + along[..., None] * d[:, None]).reshape(-1, 3))
    assert before.min() > -1e-14


@pytest.mark.parametrize("name", ["sphere", "torus", "knot"])
def test_a_grazing_ray_hits_a_billionth_below_the_surface(name: str, rng: np.random.Generator) -> None:
    shape, q = SHAPES[name], on_surface(name, rng, 200)
    n = shape.normal(q)
    tangent = np.linalg.eigh(shape.hessian(q))[1][:, :, 2]  # the most convex direction: the solid's inside is short
    start = q - 3 * tangent
    clear = shape.distance(start) > 0
    t = shape.intersect((start - 1e-9 * n)[clear], tangent[clear])
    # Half a chord at depth 1e-9 is at most sqrt(2e-9 / 1.25) = 4e-5, and an earlier strand may come first.
    assert np.all(t < 3)
    assert np.count_nonzero(t > 3 - 5e-5) > 0.3 * len(t)


def test_a_ray_beside_the_outermost_circle_misses() -> None:
    o, d = np.array([[1 + 1e-9, 0, -2.0], [1 - 1e-9, 0, -2.0]]), np.array([[0, 0, 1.0]] * 2)
    t = SHAPES["torus"].intersect(o, d)
    # x = 0.7 + sqrt(0.09 - z^2): at depth s the chord starts at z = -sqrt(0.6 s - s^2).
    np.testing.assert_allclose(t, [np.inf, 2 - np.sqrt(0.6e-9)], atol=1e-11)


@pytest.mark.parametrize(
    ("name", "o", "d", "t"),
    [
        ("sphere", [0, 0, 3], [0, 0, -1], 2.2),
        ("sphere", [0, 0, 0.8], [0, 0, 1], np.inf),
        ("sphere", [0, 0, 0.8], [0.6, 0, 0.8], np.inf),
        ("torus", [0.4, 0, 0], [-1, 0, 0], 0.8),
        ("torus", [1, 0, 0], [1, 0, 0], np.inf),
        ("torus", [0, 0, 5], [0, 0, -1], np.inf),
        ("torus", [0.7, 0, 1e3], [0, 0, -1], 1e3 - 0.3),
        ("box", [0, 0, 3], [0, 0, -1], 2.5),
        ("box", [0.9, 0, 3], [0, 0, -1], np.inf),
        ("box", [0, 0, 0.5], [0, 0.6, 0.8], np.inf),
        ("mirror", [0, 0, 1.9], [0, 0, -1], 1.1),
        ("mirror", [0, 0, 0.8], [0, 0, 1], 1.2),
        ("mirror", [0, 0, 5], [0, 0, -1], 2.5),
    ],
)
def test_hits_in_closed_form(name: str, o: list[float], d: list[float], t: float) -> None:
    found = SHAPES[name].intersect(np.array([o], float), np.array([d], float))
    np.testing.assert_allclose(found, [t], rtol=4e-15)


def assert_closed(faces: np.ndarray) -> None:
    """Raise unless every edge is walked once in each direction."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    assert len(np.unique(edges, axis=0)) == len(edges), "an edge is walked twice in one direction"
    forward, backward = np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0)
    assert np.array_equal(forward, backward), "an edge has one face only"


def measures(name: str, edge: float) -> tuple[float, float]:
    """Area and signed volume of the mesh."""
    mesh = datasets_synthetic.mesh(name, edge)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2), float(np.sum(np.cross(a, b) * c) / 6)


@each_shape
def test_mesh_is_closed_on_the_surface_and_even(name: str) -> None:
    shape, edge = SHAPES[name], 0.05
    mesh = datasets_synthetic.mesh(name, edge)
    assert_closed(mesh.faces)
    assert len(np.unique(mesh.faces)) == len(mesh.vertices) == len(np.unique(mesh.vertices, axis=0))
    np.testing.assert_allclose(shape.distance(mesh.vertices), 0, atol=1e-15)
    lengths = np.linalg.norm(mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)], axis=2)
    # Grid edges are at most `edge` on average and the diagonal sqrt(2) of it; the outer rim of a tube is up to twice
    # as long as its middle.
    assert 0.6 * edge < np.median(lengths) < 1.3 * edge
    assert lengths.max() < 2.5 * edge
    assert mesh.part_names == shape.part_names
    assert np.array_equal(np.unique(mesh.chart), np.arange(shape.charts))
    np.testing.assert_allclose(mesh.bounds, shape.bounds, atol=0.02)


@each_shape
def test_area_and_volume_converge_to_the_closed_forms(name: str) -> None:
    exact = np.array([SHAPES[name].area, SHAPES[name].volume])
    coarse, fine = (np.array(measures(name, edge)) - exact for edge in (0.08, 0.02))
    if CURVATURE[name] == 0:
        np.testing.assert_allclose([coarse, fine], 0, atol=1e-12)
        return
    # Second order in the edge: a quarter of the edge leaves a sixteenth of the error. Counts round up, by at most one
    # part in 11 of the coarsest ring (0.88 / 0.08 edges), which changes its square by up to 20 %.
    assert name in SADDLES or (np.all(coarse < 0) and np.all(fine < 0))
    np.testing.assert_allclose((coarse / fine)[: 1 if name in CUT else 2], 16, rtol=0.3)
    assert np.all(np.abs(fine) < 0.01 * exact)


@each_shape
def test_corner_uv_and_charts_are_the_shapes_own(name: str) -> None:
    shape, mesh = SHAPES[name], datasets_synthetic.mesh(name, 0.06)
    assert mesh.uv is not None
    corners = mesh.vertices[mesh.faces]
    middle = corners.mean(axis=1)
    assert np.array_equal(shape.chart(middle), mesh.chart)
    assert np.array_equal(shape.part(middle), mesh.part)
    own = (shape.chart(corners.reshape(-1, 3)).reshape(-1, 3) == mesh.chart[:, None]).ravel()
    inside = (
        np.all((np.abs(mesh.uv.reshape(-1, 2) % 0.5 - 0.25) < 0.2499) | (not isinstance(shape, Tube)), axis=1) & own
    )
    assert inside.mean() > 0.8
    uv = mesh.uv.reshape(-1, 2)
    np.testing.assert_allclose(shape.uv(corners.reshape(-1, 3))[inside], uv[inside], atol=1e-13)
    # Every corner, cuts included, seen from a millionth of the way to the middle: 1e-6 * 0.1 * |gradient| (< 3).
    pulled = corners + 1e-6 * (middle[:, None] - corners)
    pulled = pulled.reshape(-1, 3)
    kept = (shape.chart(pulled) == np.repeat(mesh.chart, 3)) | (name not in CUT)
    assert kept.mean() > 0.85
    np.testing.assert_allclose(shape.uv(pulled)[kept], uv[kept], atol=3e-7)


@each_shape
def test_uv_is_continuous_within_a_chart(name: str) -> None:
    """A chart never touches itself across a cut: two faces that share an edge but not its uv are of two charts."""
    mesh = datasets_synthetic.mesh(name, 0.08)
    assert mesh.uv is not None
    start, end = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    uv = np.concatenate([mesh.uv, np.roll(mesh.uv, -1, axis=1)], axis=2).reshape(-1, 4)
    forward, backward = np.lexsort((end, start)), np.lexsort((start, end))
    gap = np.abs(uv[forward] - uv[backward][:, [2, 3, 0, 1]]).max(axis=1)
    chart = np.repeat(mesh.chart, 3)
    same = chart[forward] == chart[backward]
    assert gap[same].max() < 1e-15
    assert gap[~same].max() > 0.1, "there are cuts, and this test sees them"


def test_the_closed_check_can_fail() -> None:
    faces = datasets_synthetic.mesh("box", 0.5).faces
    assert_closed(faces)
    with pytest.raises(AssertionError, match="one face only"):
        assert_closed(faces[1:])
    with pytest.raises(AssertionError, match="twice"):
        assert_closed(np.concatenate([faces[:1, ::-1], faces[1:]]))


NET = Net((0.8, 0.6, 0.5), (1.0, 1.0), (0.0, 0.0))


def test_net_is_an_isometry_that_mirrors_no_face() -> None:
    gradient = NET.gradient(np.arange(6))
    np.testing.assert_array_equal(gradient @ gradient.transpose(0, 2, 1), np.broadcast_to(np.eye(2), (6, 2, 2)))
    outward = np.cross(gradient[:, 0], gradient[:, 1])
    expected = [[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]]
    np.testing.assert_array_equal(outward, expected)


@pytest.mark.parametrize(
    ("face", "q", "uv"),
    [
        ("front", [0.3, -0.2, 0.5], [0.3, -0.2]),
        ("right", [0.8, -0.2, 0.1], [0.8 + 0.4, -0.2]),
        ("left", [-0.8, -0.2, 0.1], [-0.8 - 0.4, -0.2]),
        ("top", [0.3, 0.6, 0.1], [0.3, 0.6 + 0.4]),
        ("bottom", [0.3, -0.6, 0.1], [0.3, -0.6 - 0.4]),
        ("back", [0.3, -0.2, -0.5], [0.8 + 1.0 + 0.5, -0.2]),
    ],
)
def test_net_by_hand(face: str, q: list[float], uv: list[float]) -> None:
    box = Box(NET)
    point = np.array([q])
    assert box.chart(point)[0] == FACES.index(face)
    np.testing.assert_allclose(box.uv(point)[0], uv, atol=1e-15)


@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (0, 3), (0, 4), (1, 5)])
def test_net_is_continuous_over_the_edges_of_the_cross(pair: tuple[int, int], rng: np.random.Generator) -> None:
    normals = np.cross(NET.gradient(np.array(pair))[:, 0], NET.gradient(np.array(pair))[:, 1])
    edge = rng.uniform(-1, 1, (20, 3)) * NET.half
    edge = np.where(normals.sum(axis=0) != 0, normals.sum(axis=0) * NET.half, edge)
    first, second = (NET.uv(np.full(20, face), edge) for face in pair)
    np.testing.assert_allclose(first, second, atol=1e-15)


@pytest.mark.parametrize("facing", ["+z", "-z"])
def test_text_on_the_sheet_reads_from_outside_its_front(facing: str) -> None:
    paper = sheet((2.0, 3.0), 0.4, (0.5, 0.25, 2.0), facing)
    toward = 1.0 if facing == "+z" else -1.0
    eye_right = np.array([toward, 0, 0])  # right hand of an eye in front of the sheet, y up
    middle = np.array([0.5, 0.25, 2.0])
    corners = np.stack([middle - eye_right + [0, -1.5, 0], middle + eye_right + [0, 1.5, 0], middle])
    inward = corners + 1e-12 * (middle - corners)
    np.testing.assert_allclose(paper.uv(inward), [[0, 0], [1, 1], [0.5, 0.5]], atol=1e-11)
    np.testing.assert_allclose(paper.normal(middle[None]), [[0, 0, toward]])
    np.testing.assert_allclose(paper.bounds[:, 2], sorted([2.0, 2.0 - 0.4 * toward]), atol=1e-15)
    behind = paper.uv((middle - [0, 0, 0.4 * toward])[None])[0]
    np.testing.assert_allclose(behind, [0.5 + 0.5 + 0.2 + 0.5, 0.5], atol=1e-15)


def test_the_mirror_scene_stands_as_described() -> None:
    scene = SHAPES["mirror"]
    assert scene.part_names == ("sphere", "sheet") and scene.charts == 12
    p = np.array([[0, 0, 0.9], [0, 0, 1.9], [-1.4 + 1e-9, 0, 2.0], [1.4 - 1e-9, 0, 2.0]])
    assert scene.part(p).tolist() == [0, 1, 1, 1]
    assert scene.chart(p).tolist() == [0, 6, 6, 6]
    # Seen from the sphere, which looks to +z with y up, the right hand is -x: there u is 1.
    np.testing.assert_allclose(scene.uv(p)[2:, 0], [1, 0], atol=1e-9)
    np.testing.assert_allclose(scene.bounds, [[-1.4, -1.4, -0.8], [1.4, 1.4, 2.5]], atol=1e-15)


def test_closest_point_of_the_knot_against_all_of_it(rng: np.random.Generator) -> None:
    shape = knot()
    c = shape.curve.jet(np.linspace(0, 2 * np.pi, 20000, endpoint=False))[0]
    # Near the core of the torus two strands are almost equally far: the nearest sample may be on the wrong one.
    azimuth = rng.uniform(0, 2 * np.pi, 300)
    core = 0.6 * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1) + rng.normal(0, 1e-4, (300, 3))
    p = np.concatenate([core, rng.uniform(-1.2, 1.2, (300, 3)), rng.uniform(-20, 20, (50, 3)), np.zeros((1, 3))])
    brute = np.array([np.linalg.norm(c - point, axis=1).min() for point in p]) - shape.radius
    # A sample is at most 1e-5 * pi * 1.95 = 6.1e-5 along the curve from the closest point: distance grows by at most
    # that squared over twice the distance, times |f''| / |c'|^2 (< 100 within 20 units of the curve).
    excess = brute - shape.distance(p)
    assert excess.min() > -1e-14
    assert excess.max() < 1e-6
    assert np.median(excess) < 1e-7


def test_reach_bounds_the_curvature_of_distance(rng: np.random.Generator) -> None:
    shape = knot()
    p = rng.uniform(-1, 1, (4000, 3)) * shape.bounds[1]
    length = shape.distance(p) + shape.radius
    near = length < 0.98 * shape.curve.reach
    least = np.linalg.eigvalsh(shape.hessian(p[near]))[:, 0]
    assert np.count_nonzero(near) > 500
    assert np.all(least >= -1 / (shape.curve.reach - length[near]) - 1e-12)


def test_singular_places_are_finite() -> None:
    zero = np.zeros((1, 3))
    with np.errstate(all="raise"):
        for name, shape in SHAPES.items():
            p = np.concatenate([zero, shape.bounds, [[0.7, 0, 0]]])
            for answer in (shape.distance, shape.normal, shape.hessian, shape.uv, shape.uv_gradient):
                assert np.isfinite(answer(p)).all(), (name, answer)
    np.testing.assert_array_equal(Sphere(1.0).hessian(zero), np.zeros((1, 3, 3)))


def test_a_box_edge_answers_with_the_lowest_face() -> None:
    edge = np.array([[0.8, 0.0, 0.5]])
    np.testing.assert_array_equal(SHAPES["box"].normal(edge), [[0, 0, 1]])
    assert SHAPES["box"].chart(edge)[0] == 0
    np.testing.assert_array_equal(SHAPES["box"].hessian(edge), np.zeros((1, 3, 3)))


def test_impossible_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="meets itself"):
        torus(0.3, 0.4)
    with pytest.raises(ValueError, match="meets itself"):
        knot(radius=0.3)
    with pytest.raises(ValueError, match="right-handed"):
        Box(NET, frame=np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(ValueError, match="signed permutation"):
        Box(NET, frame=np.eye(3) * 0.5)
    with pytest.raises(ValueError, match="part names"):
        Union((Sphere(1.0),), ("a", "b"))


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda: datasets_synthetic.shape("teapot"), "choose one of sphere"),
        (lambda: datasets_synthetic.shape("bunny"), "without an exact shape"),
        (lambda: datasets_synthetic.mesh("sphere", 0.0), "not positive"),
        (lambda: datasets_synthetic.mesh("sphere", float("nan")), "not positive"),
        (lambda: datasets_synthetic.mesh("sphere", 1e-6), "more than 20,000,000 faces"),
        (lambda: datasets_synthetic.mesh("bunny", 0.1), "leave out the edge"),
    ],
)
def test_bad_names_and_edges(ask: Callable[[], object], sentence: str) -> None:
    with pytest.raises(BadInput, match=sentence):
        ask()


def test_default_meshes_have_20_to_60_thousand_faces() -> None:
    for name in datasets_synthetic.exact_names():
        assert 20_000 <= len(datasets_synthetic.mesh(name).faces) <= 60_000, name


def test_real_meshes_come_from_the_installed_wheel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bunny = datasets_synthetic.mesh("bunny")
    assert len(bunny.faces) == 56172
    assert_closed(bunny.faces)
    textured = datasets_synthetic.mesh("bunny_textured")
    assert len(textured.faces) == 9999 and textured.uv is not None
    monkeypatch.setattr(real, "find_spec", lambda name: None)
    with pytest.raises(BadInput, match="make setup"):
        real.path_of("bunny")

    class Spec:
        submodule_search_locations = (str(tmp_path),)

    monkeypatch.setattr(real, "find_spec", lambda name: Spec())
    with pytest.raises(BadInput, match="lacks"):
        real.path_of("cow")


def command(*words: str) -> int:
    with pytest.raises(SystemExit) as leaving, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["datasets_synthetic", *words])
        run(commands.cli, "python -m datasets_synthetic")
    assert isinstance(leaving.value.code, int)
    return leaving.value.code


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("list", "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert {entry["name"] for entry in record["meshes"]} == set(datasets_synthetic.names())
    assert command("make", "torus", "-o", str(tmp_path / "torus.ply"), "--edge", "0.1") == 0
    assert (tmp_path / "torus.ply").stat().st_size > 1000
    assert command("make", "teapot", "-o", str(tmp_path / "teapot.ply")) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and "teapot" in said.err
    assert not (tmp_path / "teapot.ply").exists()


def test_sampled_grid_holds_the_exact_distances(tmp_path: Path) -> None:
    from sdfbake.grid import Grid

    path = tmp_path / "mirror.zarr.zip"
    assert command("sample", "mirror", "-n", "32", "-o", str(path), "--cube") == 0
    grid = Grid.load(path)
    assert len(set(grid.lattice.shape)) == 1 and grid.metadata.parts == ("sphere", "sheet")
    points, distance = grid.samples()
    # Float32 of a float64 value: half a unit in the last of 24 places.
    np.testing.assert_allclose(distance, SHAPES["mirror"].distance(points), rtol=2.0**-24, atol=1e-30)
