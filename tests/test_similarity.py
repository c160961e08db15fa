"""Similarities, and surfaces placed by them: covariance of all that a field answers."""

from functools import cache

import numpy as np
import pytest
from charted import with_faces
from scipy.spatial.transform import Rotation

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.complaint import BadInput
from sdfbake.engine import Choice
from sdfbake.engine.numpy import NumpyEngine
from sdfrender import Camera, Field, GridField, Rays, footprint, reflect, trace, transfer
from sdfrender.instance import Instance
from sdfrender.similarity import IDENTITY, Similarity
from validate.exact import ShapeField

EPS = np.finfo(float).eps
NUMPY = NumpyEngine(64)
TURN = Rotation.from_euler("xyz", (40, -75, 110), degrees=True).as_matrix()
MIRROR = TURN @ np.diag([1.0, 1.0, -1.0])
PLACES = {
    "turned": Similarity(1.7, TURN, np.array([0.4, -2.0, 3.0])),
    "mirrored": Similarity(0.6, MIRROR, np.array([-1.0, 0.5, 0.2])),
    "tiny and far": Similarity(1e-4, TURN.T, np.array([100.0, -70.0, 30.0])),
}
each_place = pytest.mark.parametrize("placed", PLACES.values(), ids=PLACES)


def matrix_of(placed, rows=3):
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = placed.scale * placed.rotation, placed.translation
    return whole[:rows]


def test_scaled_then_turned_then_moved():
    placed = Similarity.of_parts(2.0, (0.0, 0.0, 3.0, 90.0), (5.0, 0.0, 1.0))
    assert placed.to_world(np.eye(3)) == pytest.approx(np.array([[5, 2, 1], [3, 0, 1], [5, 0, 3]]), abs=4 * EPS)


@pytest.mark.parametrize("rotate", [(1.0, 2.0, -0.5, 77.0), (0.0, -1e-200, 0.0, -300.0), (1e200, 1e200, 0.0, 1e-7)])
def test_rotations_are_those_of_another_library(rotate):
    axis = np.array(rotate[:3]) / max(np.abs(rotate[:3]))
    other = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.radians(rotate[3])).as_matrix()
    assert Similarity.of_parts(rotate=rotate).rotation == pytest.approx(other, abs=4 * EPS)


@each_place
@pytest.mark.parametrize("rows", [3, 4])
def test_a_matrix_is_taken_apart(placed, rows):
    found = Similarity.of_matrix(matrix_of(placed, rows))
    assert found.scale == pytest.approx(placed.scale, rel=4 * EPS)
    assert found.rotation == pytest.approx(placed.rotation, abs=16 * EPS)  # products of 3x3 rotations, an SVD
    assert found.translation.tolist() == placed.translation.tolist()


@each_place
def test_single_precision_is_mended(placed):
    """Entries rounded to 6e-8 of themselves: the nearest rotation is as near, and orthogonal to the last digit."""
    found = Similarity.of_matrix(matrix_of(placed).astype(np.float32))
    assert np.abs(found.rotation.T @ found.rotation - np.eye(3)).max() < 8 * EPS
    assert np.abs(found.rotation - placed.rotation).max() < 3 * 6e-8
    assert np.linalg.det(found.rotation) == pytest.approx(np.linalg.det(placed.rotation))


def scaled(x, y, z):
    return np.diag([x, y, z, 1.0])[:3]


REFUSED = {
    "singular": (scaled(1, 1, 0), "singular"),
    "rank 2 by rounding": ([[0.1, 0.2, 0.3, 0], [0.2, 0.4, 0.6, 0], [1, 0, 0, 0]], "singular"),
    "nothing": (np.zeros((3, 4)), "singular"),
    "two scales": (scaled(2, 1, 1), r"2, 1, 1\), and a distance keeps its meaning only under similarity"),
    "hardly two": (scaled(1, 1, 1 + 2e-6), "different factors"),
    "sheared": ([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "shears"),
    "not finite": (scaled(1, np.nan, 1), "not finite"),
    "perspective": (np.vstack([scaled(1, 1, 1), [0, 0, 0.5, 1]]), "last row"),
    "3x3": (np.eye(3), "shape"),
    "ragged": ([[1, 0, 0, 0], [0, 1, 0], [0, 0, 1, 0]], "rows of four"),
}


@pytest.mark.parametrize(("matrix", "said"), REFUSED.values(), ids=REFUSED)
def test_other_matrices_are_refused(matrix, said):
    with pytest.raises(BadInput, match=said):
        Similarity.of_matrix(matrix)
    Similarity.of_matrix(scaled(1, 1, 1 + 2e-7))  # the limit is no nearer than it says


BAD_PARTS = {
    "no scale": ((0.0,), "scale"),
    "negative": ((-1.0,), "positive"),
    "infinite": ((np.inf,), "scale"),
    "no axis": ((1.0, (0.0, 0.0, 0.0, 30.0)), "axis"),
    "no angle": ((1.0, (0.0, 0.0, 1.0, np.nan)), "not finite"),
    "nowhere": ((1.0, (0.0, 0.0, 1.0, 0.0), (0.0, np.inf, 0.0)), "not finite"),
}


@pytest.mark.parametrize(("parts", "said"), BAD_PARTS.values(), ids=BAD_PARTS)
def test_other_parts_are_refused(parts, said):
    with pytest.raises(BadInput, match=said):
        Similarity.of_parts(*parts)
    with pytest.raises(BadInput, match="orthogonal"):
        Similarity(1.0, scaled(1, 1, 2)[:, :3], np.zeros(3))


def test_only_the_identity_is_one():
    assert IDENTITY.is_identity and Similarity.of_parts().is_identity and Similarity.of_matrix(np.eye(4)).is_identity
    for other in (*PLACES.values(), Similarity.of_parts(2.0), Similarity.of_parts(translate=(0.0, 1e-9, 0.0))):
        assert not other.is_identity


@each_place
def test_lengths_are_scaled_and_the_way_back_is_one(placed, directions):
    world = placed.to_world(directions)
    back = placed.to_local(world)
    lost = 8 * EPS * np.abs(placed.translation).max() / placed.scale  # digits that the translation takes
    assert np.abs(back - directions).max() < 16 * EPS + lost
    gaps = np.linalg.norm(np.diff(world, axis=0), axis=1), np.linalg.norm(np.diff(directions, axis=0), axis=1)
    assert np.abs(gaps[0] / placed.scale - gaps[1]).max() < 16 * EPS + 2 * lost


@each_place
def test_the_box_is_that_of_the_corners(placed):
    box = np.array([[-1.0, 0.2, 3.0], [2.0, 0.7, 3.5]])
    corners = placed.to_world(np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3))
    expected = np.stack([corners.min(axis=0), corners.max(axis=0)])
    assert np.abs(placed.bounds(box) - expected).max() < 8 * EPS * np.abs(expected).max()


@cache
def torus(mode, engine=NUMPY):
    """A torus that knows its texture coordinates by interpolation, or by faces, which asks for the normal."""
    exact = shape("torus")
    grid = Grid.from_function(exact, 32)
    return GridField(grid if mode == "grid" else with_faces(grid, exact.mesh(0.25)), "bspline", Choice(engine, "given"))


CAMERA = Camera((0.3, -2.4, 2.1), (0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), fov=38.0, size=(32, 24))


def moved(rays, placed):
    """Rays brought to the world by hand: directions keep their length."""
    turned = {name: getattr(rays, name) @ placed.rotation.T for name in ("d", "dd_dx", "dd_dy")}
    grown = {name: placed.scale * getattr(rays, name) @ placed.rotation.T for name in ("dp_dx", "dp_dy")}
    return Rays(p=placed.to_world(rays.p), flags=rays.flags, **turned, **grown)


def through(field, rays):
    """What is seen at a hit, and what a mirror makes of the rays."""
    hits, at = transfer(field, rays)
    return hits, at, reflect(field, hits, at), footprint(field, hits, at, size=(64, 64))


def differences(field, placed, instance):
    """How far an instance is from the inner field with the rays moved by hand, in local units; and how many rays."""
    local = CAMERA.rays()
    hits, at, out, seen = through(field, local)
    other, there, away, looked = through(instance, moved(local, placed))
    both = hits.hit & other.hit & (np.abs(np.sum(hits.n * local.d, axis=1)) > 0.2) & (seen.flags == 0)
    at, out = moved(at, placed), moved(out, placed)

    def off(one, two):
        return np.abs(two[both] - one[both])

    def share(one, two):
        return np.linalg.norm(two[both] - one[both], axis=1) / np.linalg.norm(one[both], axis=1)

    return {
        "t": off(hits.t, other.t / placed.scale),
        "p": off(at.p, there.p) / placed.scale,
        "n": off(hits.n @ placed.rotation.T, other.n),
        "dp": share(at.dp_dx, there.dp_dx),
        "d": off(out.d, away.d),
        "dd": share(out.dd_dy, away.dd_dy),
        "uv": off(seen.uv, looked.uv),
        "duv": share(seen.duv_dx, looked.duv_dx),
        "lod": off(seen.lod, looked.lod),
    }, np.count_nonzero(both)


# In units of how far a place may be off. The tube's curvature is 1 / 0.3; a displacement grows with the normal's change
# over the slope, a mirrored direction by twice that, its derivative with the Hessian's change, some 1e3 eps / spacing.
GROWTH = {"t": 1, "p": 1, "n": 4, "dp": 20, "d": 8, "dd": 60, "uv": 1, "duv": 60, "lod": 90}


SEEN = [("turned", "faces"), ("mirrored", "faces"), ("tiny and far", "grid")]


@pytest.mark.parametrize(("name", "mode"), SEEN, ids=[f"{name}, {mode}" for name, mode in SEEN])
def test_an_instance_is_the_surface_moved(name, mode, choice):
    """Two computations whose places round by 11 N u voxels each (docs/tracing.md), over slopes of 0.2 and more.

    World coordinates of a small thing far away have fewer digits: 4 roundings of its place, in its own units. Beyond an
    edge of the mesh two faces are equally close, and rounding decides: for one ray in twenty at most.
    """
    placed = PLACES[name]
    field = torus(mode, choice.engine)
    found, count = differences(field, placed, Instance(field, placed))
    voxels = 11 * max(field.grid.lattice.shape) * field.engine.eps
    lost = 4 * EPS * np.abs(placed.translation).max() / placed.scale
    place = (voxels * field.grid.lattice.spacing + lost) / 0.2
    assert count > 80 and place < 1e-3
    for what, values in found.items():
        by_face = mode == "faces" and what in ("duv", "lod")
        assert (np.quantile(values, 0.95) if by_face else values.max()) < GROWTH[what] * place, what


def test_a_float32_instance_is_the_float64_one():
    placed = PLACES["turned"]
    rays = moved(CAMERA.rays(), placed)
    fields = [torus("grid", NumpyEngine(bits)) for bits in (64, 32)]
    one, two = (trace(Instance(field, placed), rays.p, rays.d) for field in fields)
    both = one.hit & two.hit & (np.abs(np.sum(one.n * rays.d, axis=1)) > 0.2)
    lattice = fields[0].grid.lattice
    voxels = 11 * max(lattice.shape) * np.finfo(np.float32).eps * placed.scale * lattice.spacing
    assert 0 < np.abs(one.t[both] - two.t[both]).max() < voxels / 0.2 and both.sum() > 200


FAULTS = {
    "turned the wrong way": ("_turn", lambda i: tuple(zip(*i._turn, strict=True)), "n"),
    "gradients of uv not shrunk": ("_shrunk", lambda i: i._turn, "duv"),
    "curvature not shrunk": ("_per_scale", lambda i: 1.0, "dd"),
    "hits not turned back": ("_outward", lambda i: i._inward, "p"),
}


@pytest.mark.parametrize(("name", "wrong", "seen"), FAULTS.values(), ids=FAULTS)
def test_faults_are_seen(name, wrong, seen):
    """What the test above allows is under 1e-9 here."""
    field = torus("faces")
    instance = Instance(field, PLACES["turned"])
    setattr(instance, name, wrong(instance))
    found, _ = differences(field, PLACES["turned"], instance)
    assert np.median(found[seen]) > 1e-2


def test_a_normal_that_is_not_turned_is_seen(monkeypatch):
    field = torus("faces")
    monkeypatch.setattr("sdfrender.instance._transposed", lambda matrix, n: n)
    found, _ = differences(field, PLACES["mirrored"], Instance(field, PLACES["mirrored"]))
    assert np.median(found["duv"]) > 1e-2


def jets(field, points, order=2):
    """Value, gradient, Hessian at world points."""

    def program(xp, *p):
        jet = field.jet_at(xp, field.locate(xp, p, xp.full(p[0], True)), order)
        return {str(i): entry for i, entry in enumerate((jet.value, *(jet.gradient or ()), *(jet.hessian or ())))}

    out = field.engine.run(program, list((points - field.anchor).T))
    columns = [out[str(i)] for i in range(len(out))]
    hessian = np.array([[columns[i] for i in row] for row in ((4, 7, 8), (7, 5, 9), (8, 9, 6))]) if order > 1 else None
    return columns[0], np.stack(columns[1:4], axis=-1), None if hessian is None else np.moveaxis(hessian, -1, 0)


def slope(function, points, step):
    """Central differences, twice, extrapolated: what is left is of the order of step^4."""

    def central(h):
        return np.stack([(function(points + h * e) - function(points - h * e)) / (2 * h) for e in np.eye(3)], axis=-1)

    return (4 * central(step / 2) - central(step)) / 3


@pytest.mark.parametrize("name", ["turned", "mirrored"])
def test_jets_are_the_derivatives_of_the_distance(name, directions):
    """Steps of 1e-3: the fifth derivative is some 24 / 0.2^4, a rounding 1e-15 over the step."""
    placed, exact = PLACES[name], shape("torus")
    inner = ShapeField(exact)
    feet = directions[:200] * [1.1, 1.1, 0.4]
    points = placed.to_world(feet - 0.9 * exact.distance(feet)[:, None] * exact.normal(feet))

    def distance(world):
        return placed.scale * exact.distance(placed.to_local(world))

    value, gradient, hessian = jets(Instance(inner, placed), points)
    assert np.abs(value - distance(points)).max() < 16 * EPS
    assert np.abs(gradient - slope(distance, points, 1e-3)).max() < 1e-8
    by_gradient = slope(lambda p: jets(Instance(inner, placed), p, 1)[1], points, 1e-3)
    assert np.abs(hessian - by_gradient).max() < 1e-7 < 1 < np.abs(hessian).max()


def test_inside_and_blocked(choice, rng):
    """The closed form says what is inside, the first hit what blocks: nothing before it, all behind it."""
    placed = PLACES["mirrored"]
    field = Instance(torus("grid", choice.engine), placed)
    assert isinstance(field, Field) and field.part_names == ("torus",) and field.uv_mode == "grid"
    local = rng.uniform(-1.2, 1.2, (4000, 3)) * [1, 1, 0.5]
    distance = shape("torus").distance(local)
    rays = moved(CAMERA.rays(), placed)
    hits = trace(field, rays.p, rays.d)
    before = hits.p - 0.2 * placed.scale * rays.d

    def within(xp, *p):
        return {"inside": xp.integer(field.inside(xp, p, xp.full(p[0], True)))}

    def blocked(xp, *c):
        every = xp.full(c[0], True)
        return {str(i): xp.integer(field.occluded(xp, c[:3], c[3:6], every, None, c[6 + i])) for i in (0, 1)}

    clear = np.abs(distance) > 1e-2  # the interpolant's own error is under 1e-3
    found = field.engine.run(within, list((placed.to_world(local) - field.anchor).T))["inside"] > 0
    assert np.array_equal(found[clear], distance[clear] < 0) and 0.1 < found.mean() < 0.9
    limits = [np.full(len(before), 0.2 * placed.scale * factor) for factor in (0.99, 1.01)]
    out = field.engine.run(blocked, [*(before - field.anchor).T, *rays.d.T, *limits])
    outside = hits.hit & (shape("torus").distance(placed.to_local(before)) > 0.02)
    assert outside.sum() > 150 and not out["0"][outside].any() and out["1"][outside].all()
