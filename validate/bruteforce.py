"""First roots along rays by brute force: sampled, bracketed, bisected; as an array program, so that many rays are few.

In: a dense grid of samples, spacing 1, origin 0, and rays in it. Out: where the interpolant first changes sign. Shares
with the tracer the kernel's weights and the engine, nothing else: no bricks, slabs, skips, nets or ray polynomials.
Samples alone miss double roots: where three in a row dip, the least value between them is sought by golden section.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from sdfbake.engine import Array, Engine
from sdfrender.kernels import Kernel

PAD = 3  # samples beyond the lattice: what the widest stencil and the prefilter touch
PER_CELL = 4  # samples per voxel of way
GOLDEN, SHORTEST = 0.3819660112501051, 4e-8  # a dip's place to 4e-8 voxel is its depth to 1e-15
SCAN, DIP, BISECT, HIT, OUT = 1, 2, 3, 4, 0

Vector = tuple[Array, Array, Array]


class Interpolant:
    """The interpolant of dense samples.

    Parameters
    ----------
    values
        (nx, ny, nz) samples.
    kernel
        How they are interpolated; beyond the lattice they continue linearly.
    engine
        In float64, for brute force.
    """

    def __init__(self, values: Float[np.ndarray, "nx ny nz"], kernel: Kernel, engine: Engine) -> None:
        self.kernel, self.engine = kernel, engine
        padded = values.astype(np.float64)
        for axis in range(3):
            padded = _filtered(_continued(padded, axis), axis, kernel)
        self._table = engine.table(padded)
        self._last = [engine.uniform(float(n - 1)) for n in values.shape]
        self._size = [engine.uniform(n) for n in padded.shape]

    def value(self, xp: Engine, p: Vector) -> Array:
        """Evaluate at places, which are brought into the lattice."""
        n, base, weights = self.kernel.taps, None, []
        for a in range(3):
            inside = xp.minimum(xp.maximum(p[a], 0.0), self._last[a])
            cell = xp.minimum(xp.floor(inside), self._last[a] - 1.0)
            weights.append(_weights(xp, self.kernel, inside - cell))
            index = xp.integer(cell) + (PAD + self.kernel.first)
            base = index if base is None else base * self._size[a] + index
        total, everybody = xp.full(p[0], 0.0), xp.full(p[0], True)
        for i in range(n):
            for j in range(n):
                row = base + (i * self._size[1] + j) * self._size[2]
                pair = weights[0][i] * weights[1][j]
                for k in range(n):
                    total = xp.fma(xp.gather(self._table, row + k, everybody), pair * weights[2][k], total)
        return total

    def at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Evaluate at points of the lattice's box."""
        found = self.engine.run(lambda xp, *p: {"f": self.value(xp, (p[0], p[1], p[2]))}, list(points.T))
        return found["f"].astype(np.float64)


def _continued(values: np.ndarray, axis: int) -> np.ndarray:
    """Continue linearly beyond both ends of an axis."""
    for _ in range(PAD):
        first, second, last, before = (values.take([i], axis) for i in (0, 1, -1, -2))
        values = np.concatenate([2 * first - second, values, 2 * last - before], axis=axis)
    return values


def _filtered(values: np.ndarray, axis: int, kernel: Kernel) -> np.ndarray:
    """Turn samples into coefficients; the outermost, which no stencil touches, stay."""
    low, middle, high = (values.take(range(o, values.shape[axis] - 2 + o), axis) for o in range(3))
    inner = kernel.prefilter[0] * low + kernel.prefilter[1] * middle + kernel.prefilter[2] * high
    return np.concatenate([values.take([0], axis), inner, values.take([-1], axis)], axis=axis)


def _weights(xp: Engine, kernel: Kernel, u: Array) -> list[Array]:
    powers = [u]
    while len(powers) < kernel.degree:
        powers.append(powers[-1] * u)
    rows = kernel.weights.tolist()
    return [sum((c * u_k for c, u_k in zip(row[1:], powers, strict=True)), xp.full(u, row[0])) for row in rows]


class _Search(NamedTuple):
    """State of a ray; values are positive on the side where it starts.

    Attributes
    ----------
    mode, k
        What it is at, and the number of the sample that comes next.
    a, fa, b, fb
        The last two samples.
    c, fc
        The sample after them, while the dip of the three is looked into.
    low, high
        Bracket of the dip, or of the root.
    x, fx
        Least value so far of a dip.
    """

    mode: Array
    k: Array
    a: Array
    fa: Array
    b: Array
    fb: Array
    c: Array
    fc: Array
    low: Array
    high: Array
    x: Array
    fx: Array


class Lines(NamedTuple):
    """Rays for brute force.

    Attributes
    ----------
    p, d
        (n, 3): origins and unit directions, voxels.
    near, far
        (n,): where the box begins and ends on them.
    leaving
        (n,): -1 or 1, the side that rays go to which start on the surface; 0 for all others.
    """

    p: Float[np.ndarray, "n 3"]
    d: Float[np.ndarray, "n 3"]
    near: Float[np.ndarray, " n"]
    far: Float[np.ndarray, " n"]
    leaving: Float[np.ndarray, " n"]

    def where(self, chosen: np.ndarray | slice) -> "Lines":
        """Some of the rays."""
        return Lines(*(values[chosen] for values in self))

    def at(self, t: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Points on the rays."""
        return np.asarray(self.p + t[:, None] * self.d)


def lines(shape: tuple[int, ...], p: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Lines:
    """Clip rays to the lattice's box; those that pass it by have far = near."""
    top = np.array(shape) - 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = (0 - p) / d, (top - p) / d
    near = np.nanmax(np.minimum(low, high), axis=1).clip(0)
    far = np.nanmin(np.maximum(low, high), axis=1)
    return Lines(p, d, near, np.maximum(near, far), np.zeros(len(p)))


def first_roots(field: Interpolant, rays: Lines) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Find first sign changes.

    Returns
    -------
    hit
        Whether there is one.
    t
        Where; infinite for a miss.
    """
    steps = field.engine.uniform(int(np.ceil(PER_CELL * (rays.far - rays.near).max())) + 1)

    def program(xp: Engine, *c: Array) -> dict[str, Array]:
        p, d, near, far, leaving = c[:3], c[3:6], c[6], c[7], c[8]

        def value(t: Array, ray: tuple[Vector, Vector]) -> Array:
            (x, y, z), (dx, dy, dz) = ray
            return field.value(xp, (xp.fma(t, dx, x), xp.fma(t, dy, y), xp.fma(t, dz, z)))

        begin = value(near, (p, d))
        side = xp.where(leaving == 0, xp.where(begin < 0, xp.full(near, -1.0), 1.0), leaving)
        residue = xp.where(leaving == 0, 0.0, begin)
        fixed = ((p, d), near, (far - near) / xp.real(steps), side, residue)
        first, zero = side * (begin - residue), xp.full(near, 0.0)
        mode = xp.integer(far > near) * SCAN
        state = _Search(mode, xp.full(near, 1), near, first, near, first, *([zero] * 6))

        def step(state: _Search, fixed: tuple[Array, ...]) -> _Search:
            ray, near, width, side, residue = fixed
            t = _next(xp, state, near, width)
            return _advanced(xp, state, t, side * (value(t, ray) - residue), steps)

        end = xp.while_loop(lambda s: (s.mode == SCAN) | (s.mode == DIP) | (s.mode == BISECT), step, state, fixed)
        return {"hit": xp.integer(end.mode == HIT), "t": end.high}

    found = field.engine.run(program, [*rays.p.T, *rays.d.T, rays.near, rays.far, rays.leaving])
    hit = found["hit"] > 0
    return hit, np.where(hit, found["t"].astype(np.float64), np.inf)


def _next(xp: Engine, s: _Search, near: Array, width: Array) -> Array:
    """Return where the ray looks next: the next sample, in the larger part of a dip, in the middle of a root."""
    right, left = s.high - s.x, s.x - s.low
    probe = xp.where(right > left, s.x + GOLDEN * right, s.x - GOLDEN * left)
    sample = xp.fma(xp.real(s.k), width, near)
    return xp.where(s.mode == SCAN, sample, xp.where(s.mode == DIP, probe, 0.5 * (s.low + s.high)))


def _advanced(xp: Engine, s: _Search, t: Array, f: Array, steps: Array) -> _Search:
    """Take a value in."""
    scan, dip, bisect = s.mode == SCAN, s.mode == DIP, s.mode == BISECT
    crossed = f < 0
    # A parabola's least value lies under its middle sample by at most an eighth of this.
    dips = scan & ~crossed & (s.k >= 2) & (s.fb <= s.fa) & (s.fb <= f) & (s.fb < s.fa + f - 2.0 * s.fb)
    found = (scan | dip) & crossed
    better, right = f < s.fx, t > s.x
    # In a dip the better of two inner places becomes its middle; in a bracket of a root the sign decides.
    up = dip & (better == right) | bisect & ~crossed
    edge = xp.where(dip & better, s.x, t)
    low = xp.where(up, edge, s.low)
    high = xp.where((dip | bisect) & ~up, edge, s.high)
    low = xp.where(found & scan, s.b, xp.where(found & dip, s.low, xp.where(dips, s.a, low)))
    high = xp.where(found, t, xp.where(dips, t, high))
    x, fx = xp.where(dips, s.b, xp.where(dip & better, t, s.x)), xp.where(dips, s.fb, xp.where(dip & better, f, s.fx))
    # A dip is over where it is no longer than its own place is known; a root, where there is no float in between.
    over = dip & ~crossed & (high - low < SHORTEST)
    middle = 0.5 * (low + high)
    isolated = bisect & ((middle <= low) | (middle >= high))
    passed = scan & ~crossed & ~dips
    shifted = passed | over
    last, value = xp.where(over, s.c, t), xp.where(over, s.fc, f)
    onward = xp.where(s.k >= steps, xp.full(s.k, OUT), SCAN)
    mode = xp.where(shifted, onward, xp.where(dips, DIP, xp.where(found, BISECT, xp.where(isolated, HIT, s.mode))))
    return _Search(
        mode,
        xp.where(shifted, s.k + 1, s.k),
        xp.where(shifted, s.b, s.a),
        xp.where(shifted, s.fb, s.fa),
        xp.where(shifted, last, s.b),
        xp.where(shifted, value, s.fb),
        xp.where(dips, t, s.c),
        xp.where(dips, f, s.fc),
        low,
        high,
        x,
        fx,
    )
