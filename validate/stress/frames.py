"""The same scene in other units, far away, with its axes exchanged; and lattices as small as can be.

In: an engine. Out: cases, each with grids of its own. What is asked in two ways may differ by rounding only: places by
11 N u voxels each (docs/tracing.md), N samples along the longest axis.
"""

from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np
from jaxtyping import Float

from datasets_synthetic.sphere import Sphere
from sdfbake.engine import Choice
from sdfrender import GridField
from sdfrender.kernels import bspline
from validate.beam import MeshRays
from validate.bruteforce import Lines, lines
from validate.stress.bounds import SAMPLE, amplified
from validate.stress.brute import none_missed
from validate.stress.case import Case, Check
from validate.stress.mirrored import (
    LEAST,
    SUMS,
    Frame,
    Met,
    Places,
    between,
    dense,
    differences,
    finite_check,
    identity_check,
    met,
    mirror_check,
    same_checks,
    towards,
)
from validate.suites.misses import PLACE, through

SEED, COUNT = 1208, 500
# Nodes at whole numbers, one of them the anchor: zeros stay zeros inside.
SIDE, ORIGIN, RADIUS = 33, np.full(3, -16.0), 9.3
BALL = Sphere(RADIUS, (0.4, -0.3, 0.1))


def ball() -> Float[np.ndarray, "33 33 33"]:
    """Distances from the ball."""
    p = np.moveaxis(np.indices((SIDE,) * 3), 0, -1) + ORIGIN
    return BALL.distance(p.reshape(-1, 3)).reshape((SIDE,) * 3)


def rounding(choice: Choice, side: int = SIDE) -> float:
    """By how many voxels two answers about a place may differ: along rays of a cosine of `LEAST` or more."""
    return 2 * side * PLACE * choice.engine.eps / LEAST


def summing(choice: Choice) -> float:
    """By how much n and a mirrored J may differ, in units of a voxel: sums of gradient and Hessian."""
    return SUMS * choice.engine.eps


def noise(shape: tuple[int, int, int]) -> Float[np.ndarray, "nx ny nz"]:
    """Random numbers, with a bit more outside than inside."""
    return np.random.default_rng(SEED).normal(size=shape) + 0.8


# ---- scale and place -------------------------------------------------------------------------------------------------
FRAMES = {
    "scaled by 2^20": Frame(2.0**20),
    "scaled by 1e6": Frame(1e6),
    "scaled by 1e-6": Frame(1e-6),
    "a sixteenth as large, 1e6 away": Frame(1 / 16, 1e6),
}


def _covariant(choice: Choice) -> Iterator[Check]:
    base = dense(ball(), choice, ORIGIN)
    rng = np.random.default_rng(SEED)
    near = rng.normal(size=(COUNT, 3))
    rays = towards(
        Places.of(BALL, BALL.centre + RADIUS * near / np.linalg.norm(near, axis=1, keepdims=True)), rng, 30.0
    )
    truth = cache(partial(met, base, rays))
    for name, frame in FRAMES.items():
        origin = frame.point(ORIGIN[None])[0]
        field = dense(frame.scale * ball().astype(np.float32).astype(np.float64), choice, origin, frame.scale)
        theirs = frame.beam(rays)
        limits = _covariance_limits(choice, frame)
        yield from same_checks(name, field, theirs, partial(_carried, truth, field, theirs, frame), limits)


def _carried(truth: Callable[[], Met], field: GridField, rays: MeshRays, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    return differences(met(field, rays), truth(), 1.0, frame)


def _covariance_limits(choice: Choice, frame: Frame) -> tuple[float, float]:
    """Nothing for powers of two; else samples round anew, and places far away."""
    exact = np.log2(frame.scale) % 1 == 0
    sample = 0.0 if exact else SAMPLE
    value, slope, bend = (amplified(bspline(), order, lambda away: sample * away) for order in range(3))
    # Origin, start and hit are rounded to float64 where they are, in three coordinates: voxels.
    far = 3 * np.sqrt(3) * abs(frame.move) * 2.0**-53 / frame.scale
    engine = 0.0 if exact and not frame.move else 1.0
    places = (value + far) / LEAST + engine * rounding(choice)
    normal = np.sqrt(3) * slope + far / RADIUS
    return places, normal * (1 / LEAST + 8) + 6 * bend + engine * summing(choice)


# ---- tiny, odd and long lattices -------------------------------------------------------------------------------------
SIZES = ((2, 2, 2), (3, 3, 3), (5, 5, 5), (2, 3, 5), (5, 2, 3))
TILT = np.array([0.8, 0.5, 0.33]) / np.linalg.norm([0.8, 0.5, 0.33])


def _tiny(choice: Choice) -> Iterator[Check]:
    for size in SIZES:
        middle = (np.array(size) - 1) / 2
        field = dense((np.moveaxis(np.indices(size), 0, -1) - middle) @ TILT, choice)
        rng = np.random.default_rng(SEED)
        p = 0.4 * middle * rng.uniform(-1, 1, (COUNT // 2, 3))
        places = Places.flat(middle + p - (p @ TILT)[:, None] * TILT, TILT)
        rays = towards(places, rng, 8.0)
        name = " x ".join(str(n) for n in size)
        yield mirror_check(field, places, rays, 1.0, _flat(choice, 3.0), f"{name}: ")
        yield finite_check(field, rays, f"{name}: ")
        if len(set(size)) > 1:
            yield none_missed(f"{name}, noise: wrong by brute force", noise(size), bspline(), choice, anywhere, 300)


def anywhere(rng: np.random.Generator, count: int, shape: tuple[int, ...], _: GridField) -> Lines:
    """From outside and inside to anywhere in the box."""
    top = np.array(shape) - 1.0
    p = top / 2 + np.linalg.norm(top) * rng.normal(size=(count, 3))
    p[::3] = rng.uniform(0, top, p[::3].shape)
    d = rng.uniform(0, top, (count, 3)) - p
    return lines(shape, p, d / np.linalg.norm(d, axis=1, keepdims=True))


def _flat(choice: Choice, largest: float) -> float:
    """Of a mirrored J at a plane whose samples are so large: the differences of their rounding, and the engine's.

    Samples beyond the border are continued from two, by up to two steps: five times their rounding. A gradient's three
    components turn the normal, which enters J over the cosine and squared; a Hessian's entries bend it, twice.
    """
    _, slope, bend = (amplified(bspline(), order, np.ones_like) for order in range(3))
    return 5 * largest * (SAMPLE + choice.engine.eps) * (6 * bend + 4 * slope / LEAST**2)


LONG = (5, 64, 17)


def waves() -> Float[np.ndarray, "5 64 17"]:
    """A rippled surface across the long axis."""
    x, y, z = np.indices(LONG)
    return np.asarray(y - 31.3 + 1.5 * np.sin(0.4 * z) * np.cos(0.5 * x))


def _long(choice: Choice) -> Iterator[Check]:
    base = dense(waves(), choice)
    rng = np.random.default_rng(SEED)
    start, target = (rng.uniform(0.5, np.array(LONG) - 1.5, (COUNT, 3)) for _ in range(2))
    start[:, 1], target[:, 1] = rng.choice([8.0, 56.0], COUNT), 31.3
    rays = between(start, target, rng)
    truth = cache(partial(met, base, rays))
    for axes in ((1, 0, 2), (0, 2, 1), (1, 2, 0)):
        frame = Frame(axes=axes)
        field, theirs = dense(waves().transpose(axes), choice), frame.beam(rays)
        name = f"axes {' '.join('xyz'[a] for a in axes)}"
        limits = (rounding(choice, 64), summing(choice))
        yield from same_checks(name, field, theirs, partial(_carried, truth, field, theirs, frame), limits)
    yield none_missed("5 x 64 x 17, noise: wrong by brute force", noise(LONG), bspline(), choice, through, COUNT)
    yield finite_check(base, rays)
    yield identity_check(base, choice, rays, 4.0)


CASES = (
    Case(
        "scale-and-offset",
        "Scaled by 1e-6 to 1e6, 1e6 away",
        "No tolerance has a unit: scaled scenes give scaled hits and J, to the last bit for powers of two, and else to "
        "what the samples round; far from the origin, to what float64 leaves of the coordinates.",
        _covariant,
    ),
    Case(
        "tiny-lattices",
        "Lattices of 2, 3 and 5 samples",
        "Every stencil leaves such a lattice and is continued linearly: a plane stays a plane, with its J in closed "
        "form, and no root of random samples is missed.",
        _tiny,
    ),
    Case(
        "long-lattice",
        "A lattice of 5 x 64 x 17",
        "Axes are alike: with axes exchanged the same rays have the same hits and J but for rounding; and no root of "
        "random samples is missed.",
        _long,
    ),
)
