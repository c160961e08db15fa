"""Surfaces that a lattice resolves badly, and every way to bend: edges, an apex, a saddle, a cylinder; `kinks` besides.

In: an engine. Out: cases, each with a grid of its own. Hits are held against the exact distance at the place of the
hit, curvatures and mirrored differentials against closed forms.
"""

from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np
from jaxtyping import Float

from datasets_synthetic.box import Box
from datasets_synthetic.cone import cone
from datasets_synthetic.cylinder import cylinder
from datasets_synthetic.net import Net
from datasets_synthetic.torus import torus
from datasets_synthetic.turned import Turned, rotation
from sdfbake.engine import Choice
from sdfrender import Flag, GridField, curvature
from sdfrender.kernels import bspline
from validate.beam import MeshRays, only
from validate.stress import kinks
from validate.stress.bounds import kink
from validate.stress.case import Case, Check, Finding
from validate.stress.mirrored import (
    Places,
    bend_limit,
    between,
    finite_check,
    identity_check,
    met,
    mirror_check,
    mirror_course,
    sampled,
    towards,
)

SEED, COUNT = 1208, 500
TURN = rotation((1.0, 2.0, -0.7), 0.6)  # nothing along an axis of the lattice
STEEP = kink(bspline(), np.eye(3)[0])  # the kernel is off by so many voxels at a kink, at most


# ---- edges and corners -----------------------------------------------------------------------------------------------
HALF = np.array([0.7, 0.6, 0.5])
CUBE = Turned(Box(Net.fitted((0.7, 0.6, 0.5))), TURN)
# Voxels. Samples behind a hit are up to 3 sqrt(3) away; inside, the region of a face ends at 45 degrees.
CLEAR = 3 * np.sqrt(3) * np.sqrt(2)
UNSEEN = (
    "the kernel rounds an edge over three voxels to either side, and normals lean over there; the gradient's length "
    "tells it only as far as a quarter to three quarters of a voxel"
)


def _edge_rays(inset: float) -> MeshRays:
    """Rays from all around at places so far inside the cube's edges and corners, and a fifth inside its faces."""
    rng = np.random.default_rng(SEED)
    side, within = rng.choice([-1.0, 1.0], (COUNT, 3)), rng.uniform(-1, 1, (COUNT, 3))
    kind = rng.choice(3, COUNT, p=[0.2, 0.6, 0.2])  # coordinates that are free: none at a corner, one, two
    kind = np.where(np.arange(COUNT) % 5 == 0, 2, np.minimum(kind, 1))
    free = rng.permuted(np.arange(3) < kind[:, None], axis=1)
    target = ((HALF - inset) * np.where(free, within, side)) @ TURN.T
    return between(_around(rng, COUNT), target, rng)


def _around(rng: np.random.Generator, count: int) -> Float[np.ndarray, "n 3"]:
    """Places on a sphere around everything."""
    p = rng.normal(size=(count, 3))
    return np.asarray(2.0 * p / np.linalg.norm(p, axis=1, keepdims=True))


def _edges(choice: Choice) -> Iterator[Check]:
    field = sampled(CUBE, 48, choice)
    h = field.grid.lattice.spacing
    rays, course = _edge_rays(h), mirror_course(field)
    hits = cache(lambda: met(field, rays).hits)

    def off() -> Finding:
        # A ray that is aimed a voxel inside and misses is off by more than that.
        return Finding(np.where(hits().hit, np.abs(CUBE.distance(hits().p)) / h, 2.0), rays)

    def flagged(chosen: Callable[[np.ndarray], np.ndarray], wrong: bool) -> Finding:
        to_faces = np.sort(np.abs(HALF - np.abs(hits().p @ TURN)) / h, axis=1)
        rows = np.flatnonzero(hits().hit & chosen(to_faces[:, 1]))  # of the second nearest face: from the edge
        edge = (hits().flags[rows] & Flag.EDGE) > 0
        return Finding((edge == wrong).astype(np.float64), only(rays, rows))

    def leaning() -> Finding:
        rows = np.flatnonzero(hits().hit & ((hits().flags & Flag.EDGE) == 0))
        slope = np.abs(hits().n[rows] @ TURN).max(axis=1)  # of the face that is most alike
        return Finding(np.arccos(np.minimum(slope, 1.0)), only(rays, rows))

    # An edge turns by 90 degrees, a wall's kink by 180: max(a, b) = (a + b) / 2 + |a - b| / 2 with |a - b| = sqrt(2)
    # |s|, so that the kernel is off by sqrt(1/2) of a kink's; a corner is three edges.
    most = 3 * np.sqrt(0.5) * STEEP
    yield Check("hits off the exact cube, rays aimed a voxel inside its edges", "voxel", most, off, course)
    far = f"EDGE on hits {CLEAR:.1f} voxels or more from every edge"
    yield Check(far, "count", 0.0, partial(flagged, lambda away: away > CLEAR, wrong=True), course)
    # The kernel turns |s| at 1.6 per voxel: at s = 0.25 / sqrt(2) the gradient's part across the edge is 0.28 of 0.71,
    # its length 0.74; EDGE begins at 0.9.
    near = "no EDGE on hits within a quarter of a voxel of an edge"
    yield Check(near, "count", 0.0, partial(flagged, lambda away: away < 0.25, wrong=False), course)
    # EDGE stands for a gradient that is off by 10 % in length; in direction that is 0.1 rad.
    yield Check("normals without EDGE off those of all faces", "rad", 0.1, leaning, course, UNSEEN)
    yield finite_check(field, rays)
    yield identity_check(field, choice, rays, 1.0)


# ---- an apex ---------------------------------------------------------------------------------------------------------
RIM, HEIGHT = 0.6, 1.2
CONE = Turned(cone(RIM, HEIGHT), TURN)


def _apex_rays(h: float) -> MeshRays:
    """Rays from above at places on the axis of the cone, a voxel inside the flank or up to four voxels below that."""
    rng = np.random.default_rng(SEED)
    up = TURN[:, 2]
    sine = RIM / np.hypot(RIM, HEIGHT)  # of half the angle at the apex
    deep = (1 / sine + 4 * rng.uniform(size=(COUNT, 1))) * h
    start = _around(rng, COUNT)
    return between(start * np.where(start @ up < 0, -1.0, 1.0)[:, None], (HEIGHT / 2 - deep) * up, rng)


def _flank() -> Places:
    """Places of the cone where its radius is 0.4 to 0.65 of the rim's: clear of both ends."""
    turn, fall = np.random.default_rng(SEED).uniform([[0.0], [0.4]], [[2 * np.pi], [0.65]], (2, COUNT))
    p = np.stack([RIM * fall * np.cos(turn), RIM * fall * np.sin(turn), HEIGHT * (0.5 - fall)], axis=1)
    return Places.of(CONE, p @ TURN.T)


def _apex(choice: Choice) -> Iterator[Check]:
    field = sampled(CONE, 48, choice)
    h = field.grid.lattice.spacing
    rays = _apex_rays(h)

    def off() -> Finding:
        hits = met(field, rays).hits
        return Finding(np.where(hits.hit, np.abs(CONE.distance(hits.p)) / h, 2.0), rays)

    # The distance from a point is twice the mean of |p . n| over all n, that from an axis pi / 2 of it: so is what the
    # kernel is off by.
    name = "hits off the exact cone, rays aimed a voxel inside its apex"
    yield Check(name, "voxel", 2 * STEEP, off, mirror_course(field))
    yield finite_check(field, rays)
    yield from _bent(choice, field, _flank(), 0.4 * RIM, 1.0)


# ---- every way to bend -----------------------------------------------------------------------------------------------
MAJOR, MINOR, RADIUS = 0.7, 0.3, 0.6


def _bent(choice: Choice, field: GridField, places: Places, r: float, length: float) -> Iterator[Check]:
    """Curvatures and a mirrored J against closed forms, at places of least radius r; rays come from so far."""
    rays, limit = (
        towards(places, np.random.default_rng(SEED), length),
        bend_limit(choice, field.grid.lattice.spacing, r),
    )

    def curvatures() -> Finding:
        tangent = np.linalg.svd(places.n[:, None])[2][:, 1:]
        truth = np.linalg.eigvalsh(tangent @ places.operator @ tangent.transpose(0, 2, 1))
        return Finding(r * np.abs(np.stack(curvature(field, places.p), axis=1) - truth).max(axis=1), rays)

    # Without a mirror, half of it.
    yield Check("principal curvatures, of the greatest", "relative", limit / 2, curvatures, mirror_course(field))
    yield mirror_check(field, places, rays, r, limit)
    yield identity_check(field, choice, rays, length)


def _saddle(choice: Choice) -> Iterator[Check]:
    """Within 60 degrees of the torus' inner equator; chords of its hole, 0.4, are 0.24 or more at a cosine of 0.3."""
    u, v = np.random.default_rng(SEED).uniform(-1, 1, (2, COUNT)) * [[np.pi], [np.pi / 3]]
    reach = MAJOR - MINOR * np.cos(v)
    p = np.stack([reach * np.cos(u), reach * np.sin(u), MINOR * np.sin(v)], axis=1)
    solid = torus(MAJOR, MINOR)
    yield from _bent(choice, sampled(solid, 64, choice), Places.of(solid, p), MINOR, 0.2)


def _cylinder(choice: Choice) -> Iterator[Check]:
    solid = Turned(cylinder(RADIUS, 1.4), TURN)
    u, z = np.random.default_rng(SEED).uniform(-1, 1, (2, COUNT)) * [[np.pi], [0.4]]
    p = np.stack([RADIUS * np.cos(u), RADIUS * np.sin(u), z], axis=1) @ TURN.T
    yield from _bent(choice, sampled(solid, 48, choice), Places.of(solid, p), RADIUS, 1.0)


CASES = (
    *kinks.CASES,
    Case(
        "cube-edges",
        "Edges and corners of a cube",
        "The kernel rounds edges by less than a voxel, the flag EDGE is set on them and nowhere beyond its stencil's "
        "reach, and as the interpolant is smooth even there, differentials are finite and the identities hold.",
        _edges,
    ),
    Case(
        "cone-apex",
        "Apex of a cone, and its flank",
        "At the apex, where curvature is infinite, hits are within a voxel and every number is finite; on the flank, "
        "with one curvature 0 and the other growing towards the apex, a mirrored J is as good as a cubic kernel "
        "allows, (h / r)^2.",
        _apex,
    ),
    Case(
        "torus-saddle",
        "Saddle of a torus",
        "Where curvatures have opposite signs, both of them and a mirrored J agree with the closed form to (h / r)^2, "
        "as they do on a ball.",
        _saddle,
    ),
    Case(
        "cylinder",
        "Cylinder: one curvature is zero",
        "One curvature is 0 and must come out as 0, the other is 1 / r: a mirrored J agrees with the closed form to "
        "(h / r)^2.",
        _cylinder,
    ),
)
