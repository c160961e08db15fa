"""Misses, late hits and false hits of the certified tracer, against brute force in float64.

In: nothing of the build; grids, some of them no distances at all, and rays that are hard on a tracer. Out: an error run
per problem, kernel, engine and precision. Where the two disagree, the value of the interpolant and finer samples
decide: brute force misses double roots itself.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from sdfbake.engine import Choice, choose
from sdfbake.grid import Grid
from sdfrender import GridField, trace
from sdfrender.kernels import NAMES, Kernel, kernel
from validate.bruteforce import Interpolant, Lines, first_roots, lines
from validate.experiment import Bench, Run, guarded

SUITE = "misses"
RAYS, FEW, QUICK_RAYS = 20_000, 1_000, 1_000  # on Dr.Jit, on NumPy, and for tests
AT_ONCE = 4_096  # disagreements that are looked into together
# Of a place in voxels, from the docs: 11 N u, N samples along the longest axis, u half the precision's eps.
PLACE = 11.0
# Where finer samples lie on a stretch that begins at a root: bulges of every length are seen.
SCALES = np.concatenate([np.linspace(0, 1, 65)[1:-1], 0.5 ** np.linspace(6, 40, 103)])

Tracer = Callable[[Lines], Float[np.ndarray, " n"]]


class Problem(NamedTuple):
    """A surface, and how rays are sent at it."""

    values: Float[np.ndarray, "nx ny nz"]
    rays: Callable[[np.random.Generator, int, tuple[int, ...], GridField], Lines]


# ---- surfaces --------------------------------------------------------------------------------------------------------
BALL, SLAB = (48, 48, 48), (26, 33, 30)


def _places(shape: tuple[int, ...]) -> Float[np.ndarray, "nx ny nz 3"]:
    return np.moveaxis(np.indices(shape), 0, -1).astype(np.float64)


def ball() -> Float[np.ndarray, "nx ny nz"]:
    """A distance."""
    return np.asarray(np.linalg.norm(_places(BALL) - [23.3, 24.1, 22.9], axis=-1) - 15.3)


def thin_wall() -> Float[np.ndarray, "nx ny nz"]:
    """A wall of 0.6 voxel across no axis."""
    normal = np.array([0.8, 0.5, 0.33]) / np.linalg.norm([0.8, 0.5, 0.33])
    return np.asarray(np.abs((_places(SLAB) - [12.7, 16.1, 14.8]) @ normal) - 0.3)


def noise() -> Float[np.ndarray, "nx ny nz"]:
    """Random numbers, with so little surface that most rays have a way to go."""
    return np.random.default_rng(7).normal(size=SLAB) + 1.7


def gyroid() -> Float[np.ndarray, "nx ny nz"]:
    """Six periods of a gyroid's sheet: tunnels, saddles, no plane."""
    x, y, z = np.moveaxis(1.1 * _places(SLAB), -1, 0)
    return np.asarray(np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) + 0.6)


# ---- rays ------------------------------------------------------------------------------------------------------------
def _unit(d: np.ndarray) -> np.ndarray:
    return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))


def through(rng: np.random.Generator, count: int, shape: tuple[int, ...], _: GridField) -> Lines:
    """From outside towards the inner four fifths; a third from inside, anywhere to."""
    top = np.array(shape) - 1.0
    p = top / 2 + np.linalg.norm(top) * _unit(rng.normal(size=(count, 3)))
    d = top / 2 + rng.uniform(-0.4, 0.4, (count, 3)) * top - p
    inner = count // 3
    p[:inner], d[:inner] = rng.uniform(1, top - 1, (inner, 3)), rng.normal(size=(inner, 3))
    return lines(shape, p, _unit(d))


def grazing(rng: np.random.Generator, count: int, shape: tuple[int, ...], field: GridField) -> Lines:
    """Tangents of the interpolant's own surface, moved in or out by 1e-9 to 1e-2 voxel."""
    hits = trace(field, *through(rng, 3 * count, shape, field)[:2])
    chosen = np.flatnonzero(hits.hit)[:count]
    n = hits.n[chosen]
    tangent = _unit(np.cross(n, rng.normal(size=n.shape)))
    depth = rng.choice([-1.0, 1.0], (len(n), 1)) * 10 ** rng.uniform(-9, -2, (len(n), 1))
    return lines(shape, hits.p[chosen] + depth * n - 60 * tangent, tangent)


def axis_aligned(rng: np.random.Generator, count: int, shape: tuple[int, ...], _: GridField) -> Lines:
    """Along axes and faces' diagonals, with 0 and -0, through nodes, along edges and faces, from outside and inside."""
    p = rng.uniform(0.5, np.array(shape) - 1.5, (count, 3))
    p = np.where(rng.uniform(size=p.shape) < 0.8, np.round(2 * p) / 2, p)
    d = rng.choice([-1.0, 1.0], (count, 3))
    zeros = rng.choice([0.0, -0.0], (count, 3))
    kept = rng.integers(0, 3, count)
    lone = (np.arange(3) == kept[:, None]) | (rng.uniform(size=(count, 1)) < 0.25) & (
        np.arange(3) == (kept[:, None] + 1) % 3
    )
    d = _unit(np.where(lone, d, zeros))
    outside = rng.uniform(size=(count, 1)) < 0.7
    return lines(shape, np.where(outside, p - 64 * d, p), d)  # 64 voxels, exact in floats


def bounced(rng: np.random.Generator, count: int, shape: tuple[int, ...], field: GridField) -> Lines:
    """Mirrored at their first hits, from where the tracer says these are."""
    first = through(rng, count, shape, field)
    hits = trace(field, first.p, first.d)
    p, n, d = hits.p[hits.hit], hits.n[hits.hit], first.d[hits.hit]
    cosine = np.sum(d * n, axis=1)
    rays = lines(shape, p, _unit(d - 2 * cosine[:, None] * n))
    # Rays that come from outside leave to the outside.
    return rays._replace(near=np.zeros(len(p)), leaving=np.where(cosine < 0, 1.0, -1.0))


PROBLEMS = {
    "sphere": Problem(ball(), through),
    "wall of 0.6 voxel": Problem(thin_wall(), through),
    "noise": Problem(noise(), through),
    "gyroid": Problem(gyroid(), through),
    "sphere, grazing": Problem(ball(), grazing),
    "noise, along axes": Problem(noise(), axis_aligned),
    "gyroid, after a mirror": Problem(gyroid(), bounced),
}


# ---- the suite -------------------------------------------------------------------------------------------------------
def run(bench: Bench) -> Iterator[Run]:
    """Compare, problem by problem and kernel by kernel."""
    for name, problem in PROBLEMS.items():
        for of in NAMES:
            bench.progress(f"misses: {name}, {of}")
            for choice, count in setups(quick=bench.quick):
                engine = choice.engine
                setup = {"engine": engine.name, "precision": str(engine.precision), "kernel": of}
                blank = Run(SUITE, name, setup, {"rays": count}, "error")
                yield guarded(blank, partial(_compared, blank, problem, kernel(of), choice, count))


def setups(*, quick: bool = False) -> list[tuple[Choice, int]]:
    """Engines and how many rays each is given; the first one does the brute force as well."""
    if choose().engine.name == "numpy":
        return [(choose("numpy", 64), QUICK_RAYS if quick else FEW)]
    if quick:
        return [(choose("drjit", bits), QUICK_RAYS) for bits in (64, 32)]
    return [(choose("drjit", 64), RAYS), (choose("drjit", 32), RAYS), (choose("numpy", 64), FEW)]


def _compared(blank: Run, problem: Problem, of: Kernel, choice: Choice, count: int) -> Run:
    values = problem.values.astype(np.float32)
    field = GridField(Grid.from_dense(values), of, choice)
    rays = problem.rays(np.random.default_rng(20180412), count, values.shape, field)
    tolerance = tolerances(field)

    def tracer(rays: Lines) -> Float[np.ndarray, " n"]:
        found = trace(field, rays.p, rays.d, on_surface=problem.rays is bounced)
        return found.t

    brute = setups()[0][0].engine
    figures = compare(Interpolant(values.astype(np.float64), of, brute), rays, tracer, tolerance)
    return replace(blank, values=figures)


class Tolerances(NamedTuple):
    """What the tracer promises: of a value, twice its rounding bound; of a place, 11 N u voxels."""

    value: float
    place: float


def tolerances(field: GridField) -> Tolerances:
    """Return a field's."""
    place = PLACE * max(field.grid.lattice.shape) * field.engine.eps / 2
    return Tolerances(2 * field.tolerance, place)


def compare(field: Interpolant, rays: Lines, tracer: Tracer, tolerance: Tolerances) -> dict[str, float]:
    """Hold a tracer against brute force.

    Parameters
    ----------
    field
        The interpolant.
    rays
        What is traced.
    tracer
        Returns ray parameters, infinite for misses.
    tolerance
        What it promises.

    Returns
    -------
    dict
        `missed`, `late` and `false` hits beyond the tolerance; `within`, the disagreements that it allows; `depth`, the
        greatest share of the tolerance that a disagreement reaches; `double_roots` that only the tracer found.
    """
    hit, truth = first_roots(field, rays)
    t = tracer(rays)
    # A displaced double root moves by about the square root of the displacement.
    slack = tolerance.place**0.5
    passed = hit & ~(t <= truth + slack)
    early = np.isfinite(t) & ~(truth <= t + slack)
    missed = settled(passed, lambda rows: _depth(field, rays.where(rows), truth[rows], t[rows], tolerance))
    false = settled(early, lambda rows: _height(field, rays.where(rows), t[rows], truth[rows], tolerance))
    lost = passed & ~np.isfinite(t)
    shares = np.concatenate([missed[passed], false[early]])
    return {
        "rays": float(len(t)),
        "hits": float(hit.sum()),
        "missed": float((lost & (missed > 1)).sum()),
        "late": float((passed & ~lost & (missed > 1)).sum()),
        "false": float((early & (false > 1)).sum()),
        "within": float(((passed & (missed <= 1)) | (early & (false > 0) & (false <= 1))).sum()),
        "depth": float(shares.max(initial=0.0)),
        "double_roots": float((early & (false == 0)).sum()),
    }


def settled(
    asked: Bool[np.ndarray, " n"], share: Callable[[np.ndarray], Float[np.ndarray, " m"]]
) -> Float[np.ndarray, " n"]:
    """Look into disagreements, so many at once: the share of the tolerance that each reaches; 0 for the rest."""
    shares = np.zeros(len(asked))
    rows = np.flatnonzero(asked)
    for begin in range(0, len(rows), AT_ONCE):
        part = rows[begin : begin + AT_ONCE]
        shares[part] = share(part)
    return shares


def _depth(
    field: Interpolant, rays: Lines, root: np.ndarray, t: np.ndarray, tolerance: Tolerances
) -> Float[np.ndarray, " n"]:
    """How far the interpolant is beyond 0 on a stretch that a tracer took for free, in tolerances.

    Where the box begins within the tolerance of the surface, a ray may begin on either side.
    """
    last = np.minimum(t, rays.far)
    places = root[:, None] + (last - root)[:, None] * SCALES
    values = _sided(field, rays, places)
    worst = np.argmin(values, axis=1)
    rows = np.arange(len(worst))
    beyond = np.maximum(-values[rows, worst], 0.0) / _allowed(field, rays, places[rows, worst], tolerance)
    begin = np.abs(field.at(rays.at(rays.near))) / _allowed(field, rays, rays.near, tolerance)
    return np.asarray(np.where((rays.leaving == 0) & (begin <= 1), np.minimum(begin, beyond), beyond))


def _height(
    field: Interpolant, rays: Lines, t: np.ndarray, root: np.ndarray, tolerance: Tolerances
) -> Float[np.ndarray, " n"]:
    """How far the interpolant is from 0 at a hit, in tolerances; 0 where finer samples show that it changes sign."""
    near, far = np.maximum(t - 1, rays.near), np.minimum(np.minimum(t + 1, rays.far), root)
    places = np.concatenate([t[:, None] + side[:, None] * SCALES for side in (near - t, far - t)], axis=1)
    changes = (_sided(field, rays, places) < 0).any(axis=1)
    allowed = _allowed(field, rays, t, tolerance)
    return np.where(changes, 0.0, np.abs(field.at(rays.at(t))) / allowed)


def _sided(field: Interpolant, rays: Lines, places: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n m"]:
    """Values at places along rays, positive on the side where these start."""
    begin = field.at(rays.at(rays.near))
    side = np.where(rays.leaving == 0, np.where(begin < 0, -1.0, 1.0), rays.leaving)
    residue = np.where(rays.leaving == 0, 0.0, begin)
    points = rays.p[:, None] + places[:, :, None] * rays.d[:, None]
    found = field.at(points.reshape(-1, 3)).reshape(places.shape)
    return np.asarray(side[:, None] * (found - residue[:, None]))


def _allowed(field: Interpolant, rays: Lines, t: np.ndarray, tolerance: Tolerances) -> Float[np.ndarray, " n"]:
    """What the tolerances allow a value at a place to be: its rounding, the slope times the place's, the residue."""
    p, step = rays.at(t), 1e-4
    here = field.at(p)
    slopes = [np.maximum(*(np.abs(field.at(p + way * axis) - here) for way in (-1, 1))) for axis in step * np.eye(3)]
    slope = np.linalg.norm(slopes, axis=0) / step
    residue = np.where(rays.leaving == 0, 0.0, np.abs(field.at(rays.at(rays.near))))
    # The reference's own sums are of float64, and so is its tolerance.
    return np.asarray(tolerance.value + slope * tolerance.place + residue)
