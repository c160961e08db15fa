"""Samples that are no plain distances: scaled, bent, cut off at a band, rounded to float16, random.

In: an engine. Out: cases, each with grids of its own, of one ball unless said otherwise. What a change of the samples
may do is bounded by the kernel's weights: see `validate.stress.bounds`.
"""

from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np
from jaxtyping import Bool, Float

from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfbake.engine import Choice
from sdfrender import Flag, GridField
from sdfrender.kernels import bspline
from validate.beam import MeshRays, only
from validate.identities import perturbed
from validate.stress.bounds import SAMPLE, amplified
from validate.stress.brute import none_missed
from validate.stress.case import Case, Check, Finding
from validate.stress.mirrored import (
    LEAST,
    SUMS,
    Met,
    Places,
    dense,
    differences,
    finite_check,
    identity_check,
    met,
    mirror_check,
    mirror_course,
    same_checks,
    towards,
)
from validate.suites.misses import PLACE, axis_aligned, through

SEED, COUNT = 1208, 500
SIDE, RADIUS = 34, 10.0
BALL = Sphere(RADIUS, (16.37, 16.6, 16.2))


def ball() -> Float[np.ndarray, "34 34 34"]:
    """Distances from the ball, as they are stored."""
    p = np.moveaxis(np.indices((SIDE,) * 3), 0, -1).reshape(-1, 3).astype(np.float64)
    return BALL.distance(p).reshape((SIDE,) * 3).astype(np.float32).astype(np.float64)


def _rays() -> tuple[Places, MeshRays]:
    """Rays at the ball from all sides, and where they meet it."""
    rng = np.random.default_rng(SEED)
    places = Places.of(BALL, BALL.centre + rng.normal(size=(COUNT, 3)))
    return places, towards(places, rng, 20.0)


def limits_of(choice: Choice, off: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
    """By how much two answers about a ray may differ: places in voxels, and n and a mirrored J, relative.

    Parameters
    ----------
    choice
        The engine: places round by 11 N u voxels (docs/tracing.md), so they do twice, and sums.
    off
        From a sample's distance from the surface, voxels, to what it is off by.
    """
    value, slope, bend = (amplified(bspline(), order, off) for order in range(3))
    # Over the cosine, along the ray.
    place = (2 * SIDE * PLACE * choice.engine.eps + value) / LEAST
    # A normal off by e, the gradient's three components, moves dp by e |dp| / cosine and turns the mirrored dd by up to
    # four times each of dd and dn; the Hessian's three entries and the mixed ones bend dd by twice theirs times dp.
    normal = np.sqrt(3) * slope
    return place, SUMS * choice.engine.eps + normal * (1 / LEAST + 8) + 6 * bend


def nothing(away: np.ndarray) -> np.ndarray:
    """No sample is off."""
    return 0.0 * away


# ---- scaled ----------------------------------------------------------------------------------------------------------
SCALES = (2.0**-10, 1e-3, 1e3)


def _scaled(choice: Choice) -> Iterator[Check]:
    base, (_, rays) = dense(ball(), choice), _rays()
    truth = cache(partial(met, base, rays))
    for scale in SCALES:
        field = dense(scale * ball(), choice)
        # A power of two changes no digit; other factors round the samples anew.
        exact = np.log2(scale) % 1 == 0
        limits = (0.0, 0.0) if exact else limits_of(choice, lambda away: SAMPLE * away)
        name = f"samples times 2^{np.log2(scale):.0f}" if exact else f"samples times {scale:g}"
        yield from same_checks(name, field, rays, partial(_against, truth, field, rays), limits)
        if not exact:
            yield identity_check(field, choice, rays, RADIUS, f"{name}: ")


def _against(truth: Callable[[], Met], field: GridField, rays: MeshRays) -> tuple[np.ndarray, np.ndarray]:
    return differences(met(field, rays), truth(), 1.0)


# ---- scaled from place to place --------------------------------------------------------------------------------------
WAVE = 2 * np.pi / 32  # per voxel


def _bent_scale(choice: Choice) -> Iterator[Check]:
    x = np.arange(SIDE)[:, None, None]
    field = dense(ball() * (1 + 0.5 * np.sin(WAVE * x)), choice)
    places, rays = _rays()

    def off() -> Finding:
        hits = met(field, rays).hits
        return Finding(np.where(hits.hit, np.abs(BALL.distance(hits.p)), 1.0), rays)

    # Fourth derivative of d (1 + s / 2) along x where d = 0: 2 d1 s3 + 3 d2 s2 + 2 d3 s1 + d4 (1 + s / 2), numbers for
    # orders; along y and z the last term alone. d1 <= 1, d2 <= 1 / r, d3 <= 2 / r^2, d4 <= 3 / r^3; s has a factor k
    # for each.
    r, k = RADIUS, WAVE
    across = 4.5 / r**3
    along = 2 * k**3 + 3 * k**2 / r + 4 * k / r**2 + across
    place, rest = limits_of(choice, lambda away: 1.5 * SAMPLE * away)
    # The value is off by 35/1152 of them, a second derivative by 1/12; both count twice where the gradient is 1/2, and
    # so do roundings.
    fourth = 2 * (along + 2 * across)
    yield Check("hits off the exact ball", "voxel", 35 / 1152 * fourth + 2 * place, off, mirror_course(field))
    yield mirror_check(field, places, rays, r, r * (2 * fourth / 12 + 2 * rest))
    yield finite_check(field, rays)
    yield identity_check(field, choice, rays, r)


# ---- cut off at a band -----------------------------------------------------------------------------------------------
BANDS = (3.0, 4.4)


def _cut(choice: Choice) -> Iterator[Check]:
    base, (_, rays) = dense(ball(), choice), _rays()
    truth = cache(partial(met, base, rays))
    for band in BANDS:
        values = np.clip(ball(), -band, band)
        field = GridField(Grid.from_dense(values, band=band), "bspline", choice)
        name, course = f"band of {band} voxels", mirror_course(field)
        flags = partial(_flags, field, rays, values, band)
        yield Check(f"{name}: BAND otherwise than the samples behind the hit say", "count", 0.0, flags, course)
        # Samples are off by what is cut off: on the way to the surface they change by no more than they are away.
        limits = limits_of(choice, partial(_beyond, band))
        pair = partial(_against, truth, field, rays)
        yield from same_checks(f"{name}, against all samples", field, rays, pair, limits)
        yield finite_check(field, rays, f"{name}: ")
    # With the narrow band all hits have the flag, with the wide one most have not.
    clear = partial(_clear, truth, field, rays)
    yield Check(f"{name}: all that has no BAND, against all samples", "relative", 0.0, clear, course)
    yield identity_check(field, choice, rays, RADIUS)


def _beyond(band: float, away: np.ndarray) -> np.ndarray:
    return np.maximum(away - band, 0.0)


def _flags(field: GridField, rays: MeshRays, values: np.ndarray, band: float) -> Finding:
    hits = met(field, rays).hits
    seen, sure = cut_off(values, band, hits.p)
    said = (hits.flags & Flag.BAND) > 0
    return Finding((said != seen)[sure].astype(np.float64), only(rays, sure))


def _clear(truth: Callable[[], Met], field: GridField, rays: MeshRays) -> Finding:
    """Hits without the flag know nothing of what was cut off."""
    place, rest = _against(truth, field, rays)
    rows = np.flatnonzero((met(field, rays).hits.flags & Flag.BAND) == 0)
    return Finding(np.maximum(place, rest)[rows], only(rays, rows))


def cut_off(
    values: Float[np.ndarray, "34 34 34"], band: float, p: Float[np.ndarray, "n 3"]
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Whether a sample behind the cell of each place (-2 to 3 along every axis) is cut off; and whether the cell is
    sure, the place not on one of its faces.
    """
    low = np.floor(p).astype(np.int64)
    cut = np.zeros(len(p), bool)
    for step in np.ndindex(6, 6, 6):
        x, y, z = (low + np.array(step) - 2).T
        cut |= np.abs(values[x, y, z]) >= band
    return cut, np.abs(p - np.rint(p)).min(axis=1) > 1e-3


# ---- float16 ---------------------------------------------------------------------------------------------------------
HALF = 2.0**-11


def _half(choice: Choice) -> Iterator[Check]:
    base, (_, rays) = dense(ball(), choice), _rays()
    field = dense(ball().astype(np.float16), choice)
    truth = cache(partial(met, base, rays))
    yield from same_checks(
        "float16 against float32",
        field,
        rays,
        partial(_against, truth, field, rays),
        limits_of(choice, lambda away: HALF * away),
    )
    yield finite_check(field, rays)
    yield identity_check(field, choice, rays, RADIUS)


# ---- random numbers --------------------------------------------------------------------------------------------------
def noise() -> Float[np.ndarray, "23 19 26"]:
    """Random numbers of no distance, with some room between."""
    return np.random.default_rng(SEED).normal(size=(23, 19, 26)) + 1.2


def _random(choice: Choice) -> Iterator[Check]:
    yield none_missed("wrong by brute force", noise(), bspline(), choice, through, 6 * COUNT)
    yield none_missed("along axes: wrong by brute force", noise(), bspline(), choice, axis_aligned, COUNT)
    field = dense(noise(), choice)
    lines = through(np.random.default_rng(SEED), COUNT // 2, noise().shape, field)
    rays = perturbed(lines.p, lines.d, np.random.default_rng(SEED))[0]
    yield finite_check(field, rays)
    yield identity_check(field, choice, rays, 1.0)


CASES = (
    Case(
        "gradient-scaled",
        "Samples scaled by 1e-3 to 1e3",
        "Any multiple of a distance has the same zero set: hits, normals and mirrored J are the same, as the normal's "
        "differential is divided by the gradient's length (Galim 2018, eq. 20); to the last bit for powers of two.",
        _scaled,
    ),
    Case(
        "gradient-varying",
        "Samples scaled by 0.5 to 1.5 from place to place",
        "A positive factor that varies keeps the zero set too, but not the distance: hits and mirrored J agree with "
        "the exact ball as far as the kernel follows the product's fourth derivatives.",
        _bent_scale,
    ),
    Case(
        "truncated-band",
        "Samples cut off at a band",
        "BAND says of each hit whether a sample behind it is cut off. Where none is, nothing differs from all samples; "
        "elsewhere hits, normals and J differ by no more than the kernel's small weights so far out make of it.",
        _cut,
    ),
    Case(
        "float16-samples",
        "Samples in float16",
        "Samples off by 2^-11 of themselves move hits, turn normals and bend the surface by no more than that, times "
        "what the kernel's weights and their derivatives amplify: near the surface distances are small, and so are "
        "their errors.",
        _half,
    ),
    Case(
        "random-noise",
        "Random numbers for samples",
        "No distance at all: the first root is found whatever the samples are, and none that brute force finds is "
        "missed, late or made up; differentials are finite and keep the identities.",
        _random,
    ),
)
