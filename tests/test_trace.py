"""First hits: none missed, none late, none false; against closed forms and against brute force."""

import numpy as np
import pytest

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.lattice import Lattice
from sdfrender import Camera, GridField, trace
from sdfrender.kernels import NAMES


def interpolant(values: np.ndarray, name: str):
    """The interpolant by an independent route: all samples, padded linearly, SciPy-free separable sums."""
    from sdfrender.kernels import kernel

    k = kernel(name)
    padded = values.astype(float)
    for axis in range(3):
        for _ in range(3):
            first, second = padded.take([0], axis), padded.take([1], axis)
            last, previous = padded.take([-1], axis), padded.take([-2], axis)
            padded = np.concatenate([2 * first - second, padded, 2 * last - previous], axis=axis)
        if k.filtered:
            low, middle, high = (padded.take(range(o, padded.shape[axis] - 2 + o), axis) for o in range(3))
            inner = k.prefilter[0] * low + k.prefilter[1] * middle + k.prefilter[2] * high
            padded = np.concatenate([inner.take([0], axis), inner, inner.take([-1], axis)], axis=axis)
    taps = np.arange(k.taps) + k.first + 3

    def at(points: np.ndarray) -> np.ndarray:
        cell = np.clip(np.floor(points).astype(int), 0, np.array(values.shape) - 2)
        weights = (points - cell)[..., None] ** np.arange(k.degree + 1) @ k.weights.T
        x, y, z = (cell[:, a, None] + taps for a in range(3))
        sums = padded[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]]
        for axis in (2, 1, 0):
            sums = (sums * weights[:, axis].reshape(-1, *[1] * axis, k.taps)).sum(axis=-1)
        return sums

    return at


def dense_values(values: np.ndarray, name: str, points: np.ndarray) -> np.ndarray:
    return interpolant(values, name)(points)


def brute_force(values, name, origins, d, steps=800):
    """First sign change along dense samples of the rays inside the lattice, then bisection: (hit, t)."""
    top = np.array(values.shape) - 1
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (0 - origins) / d, (top - origins) / d
    near = np.nanmax(np.minimum(a, b), axis=1).clip(0)
    far = np.nanmin(np.maximum(a, b), axis=1)
    inside = near < far
    near, far = np.where(inside, near, 0), np.where(inside, far, 0)
    value_at = interpolant(values, name)
    at = lambda t: value_at(np.clip(origins + t[:, None] * d, 0, top))  # noqa: E731
    previous, hit, low, high = at(near), np.zeros(len(d), bool), near.copy(), near.copy()
    for step in range(1, steps + 1):
        t = near + (far - near) * step / steps
        value = at(t)
        change = ~hit & (value * previous < 0)
        low, high = np.where(change, near + (far - near) * (step - 1) / steps, low), np.where(change, t, high)
        hit |= change
        previous = value
    before = at(low)
    for _ in range(45):
        middle = (low + high) / 2
        same = at(middle) * before > 0
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return hit & inside, high


def random_rays(rng, size, count):
    """Rays from outside through the lattice, a third of them along axes, some through nodes."""
    middle = (np.array(size) - 1) / 2
    origins = rng.normal(size=(count, 3))
    origins = middle + origins / np.linalg.norm(origins, axis=1, keepdims=True) * np.linalg.norm(size)
    d = middle + rng.uniform(-0.4, 0.4, (count, 3)) * size - origins
    axis = rng.integers(0, 3, count // 3)
    rows = np.arange(count // 3)
    d[rows] = 0.0
    d[rows, axis] = rng.choice([-1.0, 1.0], count // 3)
    origins[rows] = np.round(rng.uniform(0.5, np.array(size) - 1.5, (count // 3, 3)) * 2) / 2
    origins[rows, axis] = np.where(d[rows, axis] > 0, -3.0, np.array(size)[axis] + 2.0)
    return origins, d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("name", NAMES)
def test_noise_hides_no_surface(name, choice, rng):
    """Random numbers are no distance at all: whatever brute force finds must be found, not later.

    Hits that brute force does not have are double roots between its samples: they are settled by |f| at the hit.
    """
    size = (13, 17, 10)
    values = rng.normal(size=size).astype(np.float32)
    origins, d = random_rays(rng, size, 600)
    field = GridField(Grid.from_dense(values), name, choice)
    hits = trace(field, origins, d)
    hit, t = brute_force(values, name, origins, d)
    # Float64: positions along a ray of length 60 round to 1e-14 cells; a root is that over its slope. Float32 loses
    # grazing roots within 64 eps of the largest sample, here depth 3e-5, which moves a double root by its square root.
    reach = 1e-6 if choice.engine.precision == 64 else 2e-2
    late = hit & ~(hits.t <= t + reach)
    limit = 0 if choice.engine.precision == 64 else 3
    assert np.count_nonzero(late) <= limit, (origins[late], d[late], t[late], hits.t[late])
    assert 0.2 < hit.mean() <= 1
    value = dense_values(values, name, np.clip(hits.p[hits.hit], 0, np.array(size) - 1))
    assert np.abs(value).max() < max(field.tolerance, 1e-11)  # the test's own sums round, too


@pytest.mark.parametrize("name", ["catmull-rom", "bspline"])
@pytest.mark.parametrize("n", [64])
def test_no_wrong_pixel_of_the_sphere(n, name, choice):
    """Every pixel of a 160x160 picture agrees with the closed form, silhouette included."""
    exact = shape("sphere")
    lattice = Lattice(np.full(3, -2.0), 4 / (n - 1), (n, n, n))
    field = GridField(Grid.from_function(exact, lattice=lattice, uv_mode="none"), name, choice)
    rays = Camera((0.0, 0.0, 1.7), (0.0, 0.0, 0.0), fov=61.0, size=(160, 160)).rays()
    truth, hits = exact.intersect(rays.p, rays.d), trace(field, rays.p, rays.d)
    assert np.array_equal(np.isfinite(truth), hits.hit)
    both = hits.hit
    # Value error of the kernels at this spacing over the slope; a silhouette's slope is small, so the median.
    assert np.median(np.abs(truth[both] - hits.t[both])) < 2e-4 * lattice.spacing


def test_the_surface_is_left_without_meeting_it_again(choice, directions, rng):
    """Rays that leave a ball outward meet nothing; those that go inward meet the far side: chord 2 r cos."""
    exact = shape("sphere")
    field = GridField(Grid.from_function(exact, 48, uv_mode="none"), "bspline", choice)
    start = trace(field, directions * 3, -directions)
    assert start.hit.all()
    out = rng.normal(size=start.n.shape)
    cosine = np.einsum("ni,ni->n", out, start.n)
    out *= np.sign(cosine)[:, None] / np.linalg.norm(out, axis=1, keepdims=True)
    assert not trace(field, start.p, out, on_surface=True).hit.any()
    inward = trace(field, start.p, -out, on_surface=True)
    chord = 2 * 0.8 * np.abs(np.einsum("ni,ni->n", out, start.n))
    clear = chord > 1e-3  # shorter ones end within float32's grazing tolerance
    assert inward.hit[clear].all()
    assert np.abs(inward.t - chord)[clear].max() < 2e-4


def test_far_origins_lose_nothing(choice, directions):
    """A million units away float32 alone would be off by 0.06: origins are brought to the box in float64 first."""
    field = GridField(Grid.from_function(shape("sphere"), 32, uv_mode="none"), "bspline", choice)
    near, far = trace(field, directions * 2, -directions), trace(field, directions * 1e6, -directions)
    assert far.hit.all()
    # 1e6 rounds to 1e-10; float32 positions within the box of 2 to 3e-7.
    assert np.abs(near.p - far.p).max() < (1e-9 if choice.engine.precision == 64 else 2e-6)


def test_what_misses_says_so(choice):
    field = GridField(Grid.from_function(shape("sphere"), 24, uv_mode="none"), "bspline", choice)
    origins = np.array([[3.0, 0, 0], [3.0, 0, 0], [0.0, 5.0, 0.0]])
    d = np.array([[1.0, 0, 0], [0, -0.0, 1.0], [-0.0, 1.0, -0.0]])
    hits = trace(field, origins, d)
    assert np.isinf(hits.t).all() and (hits.flags == 1).all() and (hits.part == -1).all()
    assert np.isfinite(hits.p).all() and np.isfinite(hits.n).all()


@pytest.mark.parametrize("size", [(2, 2, 2), (2, 3, 5), (5, 2, 3)])
@pytest.mark.parametrize("name", NAMES)
def test_tiny_lattices(size, name, choice):
    """A plane on any lattice, however small, is that plane: all kernels continue linearly past the border."""
    x = np.arange(size[0], dtype=float)[:, None, None] + np.zeros(size)
    field = GridField(Grid.from_dense(x - 0.25), name, choice)
    origins = np.array([[-4.0, 0.3, 0.6], [9.0, 0.5, 0.5]])
    hits = trace(field, origins, np.array([[1.0, 0, 0], [-1.0, 0, 0]]))
    assert np.abs(hits.p[:, 0] - 0.25).max() < 4 * choice.engine.eps
    assert np.abs(hits.n - [1, 0, 0]).max() < 16 * choice.engine.eps


@pytest.mark.parametrize("bad", ["nan", "zero"])
def test_bad_rays(bad):
    field = GridField(Grid.from_function(shape("sphere"), 24, uv_mode="none"), engine="numpy")
    p, d = np.zeros((2, 3)), np.ones((2, 3))
    if bad == "nan":
        p[0, 0] = np.nan
    else:
        d[1] = 0
    with pytest.raises(ValueError, match="finite|length"):
        trace(field, p, d)


def test_no_rays(choice):
    field = GridField(Grid.from_function(shape("sphere"), 24, uv_mode="none"), "bspline", choice)
    assert trace(field, np.zeros((0, 3)), np.zeros((0, 3))).t.shape == (0,)
