"""Revolutions, ellipsoid, turned and implicit shapes: closed forms by hand, brute force, singular places."""

from collections.abc import Callable

import numpy as np
import pytest

import datasets_synthetic
from datasets_synthetic.bumps import Bumps, bumps
from datasets_synthetic.cone import cone
from datasets_synthetic.ellipsoid import Ellipsoid, ellipsoid
from datasets_synthetic.field import Field, certified
from datasets_synthetic.gyroid import gyroid
from datasets_synthetic.implicit import Implicit
from datasets_synthetic.revolution import Revolution
from datasets_synthetic.sheet import sheet
from datasets_synthetic.terrain import terrain
from datasets_synthetic.turned import Turned, plane, rotation

NEW = ("plane", "wall", "cylinder", "cone", "capsule", "ellipsoid", "gyroid", "bumps", "terrain")
SHAPES = {name: datasets_synthetic.shape(name) for name in NEW}
IMPLICIT = {name: shape for name, shape in SHAPES.items() if isinstance(shape, Implicit)}
each_shape = pytest.mark.parametrize("name", SHAPES)
each_implicit = pytest.mark.parametrize("name", IMPLICIT)
SLANT = np.hypot(0.7, 1.4)


def ask(name: str, what: str, p: list[float]) -> np.ndarray:
    return getattr(SHAPES[name], what)(np.array([p], float))[0]


@pytest.mark.parametrize(
    ("name", "p", "distance"),
    [
        ("cylinder", [0, 0, 0], -0.6),
        ("cylinder", [0.1, 0, 0.6], -0.1),
        ("cylinder", [0, 0.9, 0.2], 0.3),
        ("cylinder", [0, 0.3, -1.2], 0.5),
        ("cylinder", [0, 0.9, 1.1], 0.5),  # past the rim: 3, 4, 5
        ("capsule", [0, 0, 0.3], -0.5),
        ("capsule", [0.8, 0, -0.1], 0.3),
        ("capsule", [0.3, 0, 0.85], 0.0),
        ("capsule", [0, -0.6, -1.25], 0.5),
        ("cone", [0, 0, 1.7], 1.0),  # past the apex
        ("cone", [0.3, 0, 1.1], 0.5),  # still nearest to the apex, 3, 4, 5
        ("cone", [0.2, 0.1, -1.0], 0.3),  # below the base
        ("cone", [1.0, 0, -1.1], 0.5),  # past the rim
        ("cone", [0.35 + 2 / np.sqrt(5), 0, 1 / np.sqrt(5)], 1.0),  # along the normal from half the slant
        ("cone", [0, 0, -0.7 + 0.1], -0.1),
        ("cone", [0, 0, 0.6], -0.1 * 0.7 / SLANT),
        ("ellipsoid", [1.95, 0, 0], 1.0),
        ("ellipsoid", [0, -0.9, 0], 0.2),
        ("ellipsoid", [0, 0, 0.4], -0.1),
        ("ellipsoid", [0, 0, 0], -0.5),
        ("wall", [0.2, 0.3, -0.01], -0.01),
        ("wall", [0.2, 0.3, -0.52], 0.5),
    ],
)
def test_distances_by_hand(name: str, p: list[float], distance: float) -> None:
    np.testing.assert_allclose(ask(name, "distance", p), distance, atol=2e-16 * 4)


@pytest.mark.parametrize(
    ("name", "p", "eigenvalues"),
    [
        ("cylinder", [0.6, 0, 0], [0, 0, 1 / 0.6]),
        ("cylinder", [0, 1.2, 0.3], [0, 0, 1 / 1.2]),
        ("cylinder", [0, 0, 0.9], [0, 0, 0]),
        ("cylinder", [0.9, 0, 1.1], [0, 1 / 0.9 * 0.6, 2]),  # rim: 1 / d across, (n_r = 3 / 5) / r around
        ("capsule", [0, 0, 0.95], [0, 2, 2]),
        ("capsule", [0, 0, 1.45], [0, 1, 1]),
        ("capsule", [0, 0.5, 0.2], [0, 0, 2]),
        ("cone", [0.35, 0, 0], [0, 0, 1.4 / SLANT / 0.35]),
        ("cone", [0, 0, 1.7], [0, 1, 1]),
        ("cone", [0, 0.1, -0.7], [0, 0, 0]),
        ("ellipsoid", [0.95, 0, 0], [0, 0.95 / 0.7**2, 0.95 / 0.5**2]),
        ("ellipsoid", [0, 0.7, 0], [0, 0.7 / 0.95**2, 0.7 / 0.5**2]),
        ("ellipsoid", [0, 0, -0.5], [0, 0.5 / 0.95**2, 0.5 / 0.7**2]),
        ("ellipsoid", [0, 0, 1.5], [0, 1 / (1 + 0.95**2 / 0.5), 1 / (1 + 0.7**2 / 0.5)]),
    ],
)
def test_principal_curvatures_by_hand(name: str, p: list[float], eigenvalues: list[float]) -> None:
    np.testing.assert_allclose(np.linalg.eigvalsh(ask(name, "hessian", p)), eigenvalues, atol=4e-15)


@pytest.mark.parametrize(
    ("name", "o", "d", "t"),
    [
        ("cylinder", [3, 0, 0.2], [-1, 0, 0], 2.4),
        ("cylinder", [0.3, 0.2, 4], [0, 0, -1], 3.3),
        ("cylinder", [0.7, 0, 4], [0, 0, -1], np.inf),  # parallel beside it
        ("cylinder", [0.6, 0, 0], [1, 0, 0], np.inf),  # leaving
        ("cylinder", [-2, 0, 0.8], [1, 0, 0], np.inf),  # above
        ("capsule", [0, 0, 5], [0, 0, -1], 4.05),
        ("capsule", [-4, 0, 0.45], [1, 0, 0], 3.5),
        ("capsule", [0.5 + 1e-9, 0, 5], [0, 0, -1], np.inf),
        ("cone", [0, 0, 5], [0, 0, -1], 4.3),  # down the axis, onto the apex
        ("cone", [0.35, 0, 5], [0, 0, -1], 5.0),
        ("cone", [0.1, 0.2, -4], [0, 0, 1], 3.3),
        ("cone", [-4, 0, 0], [1, 0, 0], 3.65),
        ("cone", [0, 0.1, 5], [0, -0.0, -1], 5 - 0.5),
        ("cone", [-4, 0, 0.75], [1, 0, 0], np.inf),  # over the apex: the upper nappe is no part of it
        ("cone", [2.7 * 0.5, 0, 0.7 - 2.7], [-0.7 / SLANT, 0, 1.4 / SLANT], np.inf),  # up along the slant's line
        ("ellipsoid", [4, 0, 0], [-1, 0, 0], 3.05),
        ("ellipsoid", [0, 0, -4], [0, 0, 1], 3.5),
        ("ellipsoid", [0, 4, 0.6], [0, -1, 0], np.inf),
        ("wall", [0.1, 0.2, 3], [0, 0, -1], 3.0),
        ("wall", [-3, 0.2, -0.01], [1, 0, 0], 2.0),
    ],
)
def test_hits_by_hand(name: str, o: list[float], d: list[float], t: float) -> None:
    found = SHAPES[name].intersect(np.array([o], float), np.array([d], float))
    np.testing.assert_allclose(found, [t], rtol=4e-15)


@each_shape
def test_no_hit_before_the_first_by_brute_force(name: str, rng: np.random.Generator) -> None:
    """Signs of the distance along rays at 200 places: an earlier hit of more than a step would show."""
    shape = SHAPES[name]
    o = rng.normal(size=(60, 3))
    o *= 2.5 / np.linalg.norm(o, axis=1, keepdims=True)
    d = rng.uniform(-0.7, 0.7, (60, 3)) - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    t, places = shape.intersect(o, d), np.linspace(0, 4, 201)[1:]
    inside = shape.distance((o[:, None] + places[:, None] * d[:, None]).reshape(-1, 3)).reshape(60, 200) < -1e-14
    first = np.where(inside.any(axis=1), places[inside.argmax(axis=1)], np.inf)
    assert np.all(t <= first)
    seen = np.isfinite(first)
    assert 0.2 < seen.mean() < 1
    # A chord shorter than the step may hide between the places; where it does not, both agree within a step.
    agree = np.abs(t[seen] - first[seen]) <= 0.02
    assert agree.mean() > 0.8 if name != "wall" else agree.mean() > 0.5


@each_shape
def test_origins_on_the_surface(name: str, rng: np.random.Generator) -> None:
    """Leaving rays do not hit their own start; mirrored rays come back to it."""
    shape, mesh = SHAPES[name], datasets_synthetic.mesh(name, 0.15)
    middle = mesh.vertices[mesh.faces].mean(axis=1)[::3]
    q, n = middle - shape.distance(middle)[:, None] * shape.normal(middle), shape.normal(middle)
    d = n + 0.5 * rng.normal(size=n.shape)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    leaving = np.sum(d * n, axis=1) > 0.05
    t = shape.intersect(q[leaving], d[leaving])
    # Where the surface bends towards the ray it may come back: at least 2 sin / k away.
    assert np.all(t > 0.1 * 0.05 / 36.5)
    back = shape.intersect(q + 1e-3 * n, -n)
    np.testing.assert_allclose(back, 1e-3, atol=1e-14)


def test_closest_point_of_the_ellipsoid_against_all_of_it(rng: np.random.Generator) -> None:
    shape = ellipsoid()
    # On the planes of symmetry and all but on them, at the ends of the focal ellipse, on the axes, and far away.
    p = np.concatenate([rng.uniform(-1, 1, (300, 3)), rng.normal(size=(30, 3)) * 1e-9, rng.uniform(-30, 30, (30, 3))])
    flat = p[:300:3] * np.array([1.0, 1.0, 0.0]) + np.array([0, 0, 1.0]) * rng.choice(
        [0, 1e-300, -1e-20, 1e-12], (100, 1)
    )
    p = np.concatenate([p, flat, flat[:, [2, 0, 1]], np.eye(3), -np.eye(3), np.zeros((1, 3))])
    d, n = shape.distance(p), shape.normal(p)
    foot = p - d[:, None] * n
    # The foot is on the surface, and p on its normal: rounding of |p| < 52 relative to the smallest axis.
    scale = 1 + np.abs(p).max(axis=1)
    np.testing.assert_array_less(np.abs(np.sum((foot / shape.half) ** 2, axis=1) - 1), 2e-14 * scale)
    gradient = foot / np.asarray(shape.half) ** 2
    np.testing.assert_allclose(np.cross(gradient, n), 0, atol=1e-13 * scale.max())
    cloud = datasets_synthetic.mesh("ellipsoid").vertices
    brute = np.array([np.linalg.norm(cloud - point, axis=1).min() for point in p])
    # A vertex is within 0.015 of the foot: |p - v|^2 <= d^2 + 0.015^2 (1 + |d| k), k = 3.8.
    excess = brute**2 - d**2
    assert excess.min() > -1e-12
    assert np.all(excess <= 0.015**2 * (1 + 3.8 * np.abs(d)))


def test_the_ellipsoids_area_against_a_near_sphere() -> None:
    # Knud Thomsen's formula errs by less than 1.061 %; for all but a sphere the closed form is 4 pi r^2.
    a, b, c = ellipsoid().half
    thomsen = 4 * np.pi * (((a * b) ** 1.6075 + (a * c) ** 1.6075 + (b * c) ** 1.6075) / 3) ** (1 / 1.6075)
    assert ellipsoid().area == pytest.approx(thomsen, rel=0.0107)
    assert Ellipsoid((1 + 1e-4, 1.0, 1 - 1e-4)).area == pytest.approx(4 * np.pi, rel=1e-6)


def test_turning_a_shape_turns_its_answers(rng: np.random.Generator) -> None:
    R, own = rotation((1.0, 2.0, -2.0), 1.1), SHAPES["cone"]
    turned, q = Turned(own, R), rng.uniform(-1.2, 1.2, (200, 3))
    p = q @ R.T
    # R R^T errs by 4e-16, which moves points by as much and turns the cone's Hessian, up to 1e3 near the apex.
    np.testing.assert_allclose(turned.distance(p), own.distance(q), atol=4e-15)
    np.testing.assert_allclose(turned.normal(p), own.normal(q) @ R.T, atol=1e-13)
    np.testing.assert_allclose(turned.hessian(p), R @ own.hessian(q) @ R.T, atol=1e-11)
    low, high = turned.bounds
    assert np.all(turned.mesh(0.1).vertices > low) and np.all(turned.mesh(0.1).vertices < high)


def test_no_axis_lies_in_the_plane_and_its_front_is_the_texture() -> None:
    shape = plane()
    front = shape.rotation @ np.array([[-1, 1, 0], [-1, 1, 0], [0, 0, 0.0]])[:, :2]
    n = shape.rotation[:, 2]
    assert np.all(np.abs(n) > np.sin(np.radians(15)))
    np.testing.assert_allclose(shape.distance(front.T), 0, atol=1e-15)
    np.testing.assert_allclose(shape.uv(front.T + 1e-12 * (n - front.T)), [[0, 0], [1, 1]], atol=1e-11)


def test_impossible_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="orthogonal"):
        Turned(sheet(), 2 * np.eye(3))
    with pytest.raises(ValueError, match="right-handed"):
        Turned(sheet(), np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(ValueError, match="fall from x to z"):
        Ellipsoid((0.5, 0.7, 0.9))
    with pytest.raises(ValueError, match="reach its middle"):
        Bumps(0.5, 0.5, (1.0, 1.0, 1.0))


def directional(f: Callable[[np.ndarray], np.ndarray], p: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Richardson's derivative of f, which takes columns, along v: h^4 f''''' / 480 with h = 2e-3 and k = 8."""
    h = 2e-3
    coarse, fine = (f(p + s * v) - f(p - s * v) for s in (h, h / 2))
    return (8 * fine - coarse) / (6 * h)


@each_implicit
def test_fields_derivatives(name: str, rng: np.random.Generator) -> None:
    field = IMPLICIT[name].field
    p = IMPLICIT[name].samples.point[:: len(IMPLICIT[name].samples.point) // 300].T * rng.uniform(0.8, 1.3)
    jet = field.jet(p)
    bound = 2e-7 if name == "bumps" else 4e-5  # rounding e: fifth derivatives of F are of the size 10 / e^4
    for k, axis in enumerate(np.eye(3)):
        v = axis[:, None]
        np.testing.assert_allclose(directional(lambda x: field.jet(x).value, p, v), jet.gradient[k], atol=bound)
        rows = jet.hessian[[[0, 5, 4], [5, 1, 3], [4, 3, 2]][k]]
        np.testing.assert_allclose(directional(lambda x: field.jet(x).gradient, p, v), rows, atol=bound * 20)
    d = rng.normal(size=p.shape)
    d /= np.linalg.norm(d, axis=0)
    probe = field.probe(p, d)
    np.testing.assert_allclose(probe.value, jet.value, atol=1e-15)
    np.testing.assert_allclose(probe.slope, np.sum(jet.gradient * d, axis=0), atol=1e-14)


def bounded(field: Field, p: np.ndarray, d: np.ndarray) -> bool:
    """Whether F keeps its sign along the whole of every certified step, at 60 places."""
    probe = field.probe(p, d)
    share = np.linspace(0, 1, 61)[1:-1]
    sign = [np.sign(field.jet(p + s * np.minimum(probe.free, 10) * d).value) for s in share]
    return bool(np.all(np.array(sign) == np.sign(probe.value)))


@each_implicit
def test_certified_steps_cross_nothing(name: str, rng: np.random.Generator) -> None:
    shape = IMPLICIT[name]
    p = rng.uniform(-1.2, 1.2, (3, 4000))
    d = rng.normal(size=p.shape)
    d /= np.linalg.norm(d, axis=0)
    assert bounded(shape.field, p, d)
    size = np.linalg.norm(shape.field.jet(p[:, np.linalg.norm(p, axis=0) > 0.5]).gradient, axis=0)
    assert size.max() <= shape.field.steepest * (1 + 1e-12)


def test_a_step_to_a_root_of_the_bound_itself() -> None:
    # f = 1 - s - s^2: K = 2, root (sqrt(5) - 1) / 2; a line's is its own; leaving with K = 0 never ends.
    found = certified(np.array([1.0, 2.0, 2.0, -2.0]), np.array([-1.0, -0.5, 0.5, 0.5]), np.array([2.0, 0, 0, 0]))
    np.testing.assert_allclose(found, [(np.sqrt(5) - 1) / 2, 4.0, np.inf, 4.0], rtol=1e-15)


@each_implicit
def test_distance_of_implicit_shapes_against_dense_samples(name: str, rng: np.random.Generator) -> None:
    from scipy.spatial import cKDTree

    shape = IMPLICIT[name]
    mesh = shape.mesh(0.03)
    longest = np.linalg.norm(mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)], axis=2).max()
    p = rng.uniform(-1.1, 1.1, (1500, 3))
    brute, _ = cKDTree(mesh.vertices).query(p)
    d = shape.distance(p)
    # A sample is within h = longest / sqrt(3) of the foot: |p - s|^2 <= d^2 + h^2 (1 + |d| k), k = 36.5 at most. Not
    # less than d^2, but for the bound that `closest` states next to the medial axis.
    excess = brute**2 - d**2
    assert np.all(excess <= longest**2 / 3 * (1 + 36.5 * np.abs(d)))
    assert np.mean(excess > -1e-12) > 0.999
    assert excess.min() > -(shape.samples.spacing**2) * (1 + 8)


@each_implicit
def test_feet_satisfy_the_closest_point_conditions(name: str, rng: np.random.Generator) -> None:
    shape = IMPLICIT[name]
    p = shape.samples.point[::50] + rng.uniform(-1, 1) * shape.samples.alone * shape.samples.normal[::50]
    d, n = shape.distance(p), shape.normal(p)
    foot = p - d[:, None] * n
    # Within the reach the foot is where p came from.
    np.testing.assert_allclose(foot, shape.samples.point[::50], atol=1e-13)
    np.testing.assert_allclose(shape.field.jet(foot.T).value, 0, atol=4e-15)


@each_implicit
def test_area_and_volume_by_counting(name: str, rng: np.random.Generator) -> None:
    """A second route without feet or facets: counting, and the coarea formula with a bump of vanishing second moment.

    The bump's mean of the areas of the levels |F| < e is that of F = 0 but for the fourth order in e.
    """
    shape, step, e = IMPLICIT[name], 0.02, 0.05
    axes = [np.arange(a - 0.1, b + 0.1, step) for a, b in zip(*shape.bounds, strict=True)]
    p = np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1)
    p = p + step * rng.uniform(-0.5, 0.5, p.shape)  # or a whole side of the terrain passes nodes at once
    value, _, _ = shape.field.probe(p, np.broadcast_to([[1.0], [0.0], [0.0]], p.shape))
    # 20,000 to 30,000 cells on the surface err by up to 0.3 of a cell each, independently: 50 cells of over 100,000.
    assert np.count_nonzero(value < 0) * step**3 == pytest.approx(shape.volume, rel=2e-3)
    near = np.abs(value) < e
    x = value[near] / e
    size = np.linalg.norm(shape.field.jet(p[:, near]).gradient, axis=0)
    # Integrals over [-1, 1] of (1 - x^2)^3, times x^2, times x^4; a + b x^2 makes the first 1 and the second 0.
    a, b = np.linalg.solve([[32 / 35, 32 / 315], [32 / 315, 32 / 1155]], [1.0, 0.0])
    area = float(np.sum(size * (1 - x * x) ** 3 * (a + b * x * x))) * step**3 / e
    assert area == pytest.approx(shape.area, rel=4e-3)


def test_star_shaped_volumes_by_gauss() -> None:
    """r^3 / 3 over the sphere: Gauss-Legendre in z, trapezoids around, both to rounding for an entire function."""
    z, weight = np.polynomial.legendre.leggauss(60)
    angle = np.arange(120) * 2 * np.pi / 120
    ring = np.sqrt(1 - z * z)[:, None]
    u = np.stack([ring * np.cos(angle), ring * np.sin(angle), np.broadcast_to(z[:, None], (60, 120))], axis=-1)
    shape = bumps()
    assert isinstance(shape.field, Bumps)
    r = np.linalg.norm(shape.field.surface(u.reshape(-1, 3)), axis=1).reshape(60, 120)
    exact = float(np.sum(weight[:, None] * r**3) / 3 * 2 * np.pi / 120)
    assert shape.volume == pytest.approx(exact, rel=1e-6)


@each_implicit
def test_implicit_bounds_hold_the_solid_tightly(name: str) -> None:
    shape = IMPLICIT[name]
    vertices = shape.triangulate(0.03)[0]
    assert np.all(vertices >= shape.bounds[0]) and np.all(vertices <= shape.bounds[1])
    assert np.abs(np.stack([vertices.min(axis=0), vertices.max(axis=0)]) - shape.bounds).max() < 2e-3


def test_the_middle_sees_all_of_terrain_and_bumps() -> None:
    for shape in (bumps(), terrain()):
        along = np.sum(shape.samples.normal * shape.samples.point, axis=1)
        assert along.min() > 0.2


def test_the_gyroid_shell_has_no_edges_and_many_holes() -> None:
    mesh = gyroid().mesh(0.05)
    edges = np.unique(np.sort(np.stack([mesh.faces, np.roll(mesh.faces, 1, axis=1)], axis=2).reshape(-1, 2)), axis=0)
    euler = len(mesh.vertices) - len(edges) + len(mesh.faces)
    assert euler < -4 and euler % 2 == 0
    turn = gyroid().samples.alone
    assert turn > 0.8 / 40  # no radius of curvature under 1 / 40


def test_poles_and_apex_have_texture_gradients_of_full_rank() -> None:
    for name, p in (("capsule", [0, 0, 0.95]), ("cylinder", [0, 0, -0.7]), ("cone", [0, 0, 0.7])):
        gradient = ask(name, "uv_gradient", p)
        assert np.isfinite(gradient).all()
        assert np.linalg.svd(gradient)[1].min() > 0.1
    assert isinstance(cone(), Revolution)


@each_shape
def test_texture_is_not_mirrored(name: str) -> None:
    shape, mesh = SHAPES[name], datasets_synthetic.mesh(name, 0.15)
    q = mesh.vertices[mesh.faces].mean(axis=1)
    gradient, n = shape.uv_gradient(q), shape.normal(q - shape.distance(q)[:, None] * shape.normal(q))
    assert np.all(np.sum(np.cross(gradient[:, 0], gradient[:, 1]) * n, axis=1) > 0)
