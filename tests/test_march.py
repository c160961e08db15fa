"""The walk: directions that are special, starts from anywhere, planes on faces; and that it does little work."""

from functools import cache

import numpy as np
import pytest
from test_trace import brute_force, dense_values

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.engine import choose
from sdfrender import GridField, march, trace
from sdfrender.kernels import NAMES

SIZE = (11, 19, 18)
OCTANTS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def unit(d):
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def special_rays(rng, count=16):
    """Through nodes along the space and face diagonals, along edges, along faces: in every octant, with 0 and -0."""
    middle = (np.array(SIZE) - 1) / 2
    node = rng.integers(1, np.array(SIZE) - 1, (5, count, 3)).astype(float)
    d = OCTANTS[rng.integers(0, 8, (5, count))].copy()
    rows, axis, other = np.arange(count), rng.integers(0, 3, (5, count)), rng.integers(1, 3, (5, count))
    zero = rng.choice([0.0, -0.0], (5, count))
    d[1, rows, axis[1]] = zero[1]  # a face's diagonal
    for kind in (2, 3):  # along an edge; along a face
        keep = d[kind, rows, axis[kind]]
        d[kind] = zero[kind][:, None]
        d[kind, rows, axis[kind]] = keep
    node[3, rows, (axis[3] + other[3]) % 3] += 0.5
    d[4, rows, axis[4]] *= 1e-5  # nearly along a face
    p, d = node.reshape(-1, 3), unit(d.reshape(-1, 3))
    return p - (np.linalg.norm(p - middle, axis=1) + 16)[:, None] * d, d


def fields():
    """Grids whose surfaces are unlike each other: noise, a wall thinner than a cell, a gyroid."""
    rng = np.random.default_rng(7)
    x, y, z = np.meshgrid(*(np.arange(n, dtype=float) for n in SIZE), indexing="ij")
    along = (0.8 * (x - 5) + 0.5 * (y - 9) + 0.33 * (z - 9)) / np.sqrt(0.8**2 + 0.5**2 + 0.33**2)
    x, y, z = 1.1 * x, 1.1 * y, 1.1 * z
    gyroid = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) + 0.02
    return {"noise": rng.normal(size=SIZE), "wall": np.abs(along - 0.37) - 0.3, "gyroid": gyroid}


@cache
def truth(what, name):
    """Rays and what brute force finds on them, the same for every engine."""
    rng = np.random.default_rng(20180412)
    values = fields()[what].astype(np.float32)
    middle = (np.array(SIZE) - 1) / 2
    o = middle + 20 * unit(rng.normal(size=(50, 3)))
    d = unit(middle + rng.uniform(-0.4, 0.4, (50, 3)) * SIZE - o)
    inside = rng.uniform(1, np.array(SIZE) - 2, (50, 3))
    special, along = special_rays(rng)
    origins = np.concatenate([o, inside, special])
    d = np.concatenate([d, unit(rng.normal(size=(50, 3))), along])
    return values, origins, d, *brute_force(values, name, origins, d, steps=250)


@pytest.mark.parametrize("what", ["noise", "wall", "gyroid"])
@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_missed(what, name, choice):
    """What brute force finds is found, not later, and what is found is a root.

    Positions round as in `test_trace`; in float32 a root that touches within twice the tolerance may be lost, and
    there are few.
    """
    values, origins, d, hit, t = truth(what, name)
    field = GridField(Grid.from_dense(values), name, choice)
    hits = trace(field, origins, d)
    double = choice.engine.precision == 64
    late = hit & ~(hits.t <= t + (1e-6 if double else 2e-2))
    assert np.count_nonzero(late) <= (0 if double else 2), (origins[late], d[late], t[late], hits.t[late])
    assert hit.mean() > 0.15
    p = np.clip(hits.p[hits.hit], 0, np.array(SIZE) - 1)
    # A position rounds to 2 eps of the box, over slopes of up to 10.
    assert np.abs(dense_values(values, name, p)).max() < 2 * field.tolerance + 20 * choice.engine.eps * max(SIZE)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("slope", [(0, 0, 1.0), (0.25, -0.75, 0.5), (1, 1, 0)], ids=["face", "any", "diagonal"])
def test_planes_are_met_where_they_are(slope, name, choice, rng):
    """Every kernel gives a plane back: exact hits from all octants, grazing ones too, whether on faces or not.

    The slopes are sums of powers of two, which single precision stores.

    A position rounds to 11 N u (docs/tracing.md), over the cosine along the ray.
    """
    index = np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in (20, 17, 26)), indexing="ij"), axis=-1)
    middle = np.array([9.0, 8.0, 12.0])
    field = GridField(Grid.from_dense((index - middle) @ slope), name, choice)
    foot = middle + rng.uniform(-4, 4, (800, 3))
    n = unit(np.array(slope, float))
    foot -= ((foot - middle) @ n)[:, None] * n
    foot = np.where(rng.uniform(size=(800, 1)) < 0.3, np.round(foot), foot)
    foot -= ((foot - middle) @ n)[:, None] * n
    tangent = unit(np.cross(n, rng.normal(size=(800, 3))))
    cosine = rng.choice([-1, 1], 800) * 10 ** rng.uniform(-2, 0, 800)
    d = cosine[:, None] * n + np.sqrt(1 - cosine**2)[:, None] * tangent
    far = rng.choice([0.05, 1.0, 30.0], 800)
    hits = trace(field, foot - far[:, None] * d, d)
    assert hits.hit.all()
    assert (np.abs(hits.t - far) * np.abs(cosine)).max() < 11 * 26 * choice.engine.eps


def test_from_anywhere(choice, directions):
    """The ball from its centre, from a cell with surface on either side of it, and along its tangents."""
    r = 0.8
    field = GridField(Grid.from_function(shape("sphere"), 48, uv_mode="none"), "bspline", choice)
    start = {"centre": 0 * directions, "below": 0.999 * r * directions, "above": 1.001 * r * directions}
    out = trace(field, start["centre"] + 1e-9, directions)
    # The B-spline's own error at 48 samples is 4e-5.
    assert np.abs(out.t - r).max() < 1e-4
    assert np.abs(trace(field, start["below"], directions).t - 0.001 * r).max() < 1e-4
    assert np.abs(trace(field, start["above"], -directions).t - 0.001 * r).max() < 1e-4
    assert not trace(field, start["above"], directions).hit.any()
    tangent = unit(np.cross(directions, np.roll(directions, 1, axis=0)))
    assert not trace(field, start["above"] - 2 * tangent, tangent).hit.any()
    chord = trace(field, start["below"] - 2 * tangent, tangent)
    assert np.abs(chord.t - (2 - r * np.sqrt(1 - 0.999**2))).max() < 2e-3  # a value's error over a slope of 0.04


def test_along_the_box(choice):
    """A ray in a face, an edge of the lattice is inside it."""
    x = np.arange(12, dtype=float)[:, None, None] + np.zeros((12, 10, 9))
    field = GridField(Grid.from_dense(x - 7.25), "bspline", choice)
    origins = np.array([[-3.0, y, z] for y in (0, 4.5, 9) for z in (0, 4, 8)])
    ahead = trace(field, origins, np.array([[1.0, 0, -0.0]] * 9))
    back = trace(field, origins + np.array([20.0, 0, 0]), np.array([[-1.0, -0.0, 0]] * 9))
    assert np.abs(ahead.t - 10.25).max() < 1e-5 and np.abs(back.t - 9.75).max() < 1e-5
    outside = origins + np.array([0, 9.001, 0])
    assert not trace(field, outside, np.array([[1.0, 0, 0]] * 9)).hit.any()


@pytest.mark.parametrize("small", [1e-45, 1e-38, 1e-30])
def test_nearly_parallel(small, choice):
    """A component too small to divide by is none; the ray runs in a face of the cells, and ends."""
    z = np.arange(12, dtype=float) + np.zeros((12, 10, 1))
    field = GridField(Grid.from_dense(z - 7.25), "bspline", choice)
    d = np.array([[small, -small, 1.0], [-small, small, 1.0], [small, 1.0, -small]])
    hits = trace(field, np.array([[4.0, 3.0, 2.0], [4.0, 3.0, 0.0], [4.0, 0.0, 5.0]]), d)
    assert np.abs(hits.t[:2] - [5.25, 7.25]).max() < 1e-5 and not hits.hit[2]


@pytest.mark.parametrize(("n", "polynomials", "steps"), [(64, 0.8, 9), (128, 0.8, 10)])
def test_little_work(n, polynomials, steps, monkeypatch):
    """Slabs spare all but one polynomial a hit, cubes all but a few of the n cells that a ray crosses."""
    field = GridField(Grid.from_function(shape("sphere"), n, uv_mode="none"), "bspline", "numpy")
    solved, walked = [], []
    isolate, leave = march.isolate, march.leave_cube
    monkeypatch.setattr(march, "isolate", lambda *args: solved.append(args[-1].sum()) or isolate(*args))
    monkeypatch.setattr(march, "leave_cube", lambda *args: walked.append(len(args[2])) or leave(*args))
    x, y = np.meshgrid(np.linspace(-0.79, 0.79, 64), np.linspace(-0.79, 0.79, 64))
    p = np.stack([x, y, np.full_like(x, 2.0)], axis=-1).reshape(-1, 3)
    hits = trace(field, p, unit(np.array([0.2, 0.1, -1.0]) + 0 * p))
    assert hits.hit.mean() > 0.5
    assert sum(solved) / len(p) < polynomials and sum(walked) / len(p) < steps, (
        sum(solved) / len(p),
        sum(walked) / len(p),
    )


def test_another_size_is_the_same_program(directions):
    """Sizes are no literals: a second grid compiles nothing."""
    dr = pytest.importorskip("drjit")
    engine = choose("auto")
    if engine.engine.name != "drjit":
        pytest.skip("no Dr.Jit here")
    programs = []
    for n in (24, 40):
        field = GridField(Grid.from_function(shape("torus"), n, uv_mode="none"), "bspline", engine)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            trace(field, directions * 3, -directions)
            history = dr.kernel_history([dr.KernelType.JIT])
        programs.append([kernel["hash"] for kernel in history])
    assert programs[0] and programs[0] == programs[1]
