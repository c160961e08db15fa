"""A fixed battery of checks, each in a second or less: what must hold of the renderer, and so what finds its faults.

In: a `Ground` of grids made before any fault is planted, and a `Subject`, which is the renderer at work on them. Out:
per check one figure, which a healthy renderer keeps within the limit. NumPy, float64.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic import shape
from sdfbake.bake import bake
from sdfbake.grid import Grid
from sdfbake.mesh import Mesh
from sdfrender import Camera, GridField, Rays, trace
from validate.beam import Beam, displace
from validate.closed import ExactReference
from validate.course import Course, Defects, Event, Step, defects, follow
from validate.displaced import richardson
from validate.metrics import fitted_order

INDEX = 1.5
MIRROR, GLASS = (None, None), (INDEX, INDEX)
SIZE = 20  # pixels along a side of the pictures
SLOPE = 0.2  # rays nearer to grazing are not judged: footprints have no bound there
TEXELS = 1024
# A figure that is no number counts as this.
NO_NUMBER = 1e9
BEFORE = (0.3, 0.4, 3.2)  # where the camera on the sphere stands


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """What the checks look at; all of it right.

    Attributes
    ----------
    spheres
        The exact sphere at three resolutions, the coarsest first.
    doubled
        The finest of them with twice the distance: the same surface, a gradient of length 2.
    torus
        The exact torus.
    mesh, layered
        A sphere of triangles with six charts, and its grid with texture coordinates in layers.
    """

    spheres: tuple[Grid, ...]
    doubled: Grid
    torus: Grid
    mesh: Mesh
    layered: Grid

    @staticmethod
    def made() -> "Ground":
        """Sample and bake it."""
        spheres = tuple(Grid.from_function(shape("sphere"), n, uv_mode="none") for n in (20, 28, 40))
        mesh = shape("sphere").mesh(0.15)
        return Ground(
            spheres,
            replace(spheres[-1], distance=2 * spheres[-1].distance),
            Grid.from_function(shape("torus"), 32, uv_mode="none"),
            mesh,
            bake(mesh, 24, uv_mode="layers", engine="numpy"),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """The renderer at work on the ground, as it is now: what several checks look at, made once.

    Attributes
    ----------
    ground
        What it works on.
    spheres, doubled, torus, layered
        The fields of its grids.
    rays
        Of a camera on the torus, from its side, where its tube is behind its tube.
    steps, kept
        By events: the steps of those rays over the torus, and the defects of the identities.
    """

    ground: Ground
    spheres: tuple[GridField, ...]
    doubled: GridField
    torus: GridField
    layered: GridField
    rays: Rays
    steps: dict[tuple[Event, ...], list[Step]]
    kept: dict[tuple[Event, ...], Defects]

    @staticmethod
    def at_work(ground: Ground) -> "Subject":
        """Make the fields and follow the rays."""
        torus, rays = _field(ground.torus), _camera((2.6, 0.2, 0.5))
        return Subject(
            ground,
            tuple(_field(grid) for grid in ground.spheres),
            _field(ground.doubled),
            torus,
            _field(ground.layered),
            rays,
            {events: list(follow(Course(torus, events), rays)) for events in (MIRROR, GLASS)},
            {e: defects(Course(torus, e), rays, np.random.default_rng(7)) for e in (MIRROR, GLASS)},
        )


def _field(grid: Grid) -> GridField:
    return GridField(grid, "bspline", "numpy", 64)


def _camera(place: tuple[float, float, float]) -> Rays:
    return Camera(place, (0.0, 0.0, 0.0), fov=36.0, size=(SIZE, SIZE)).rays()


@dataclass(frozen=True, slots=True)
class Check:
    """One check.

    Attributes
    ----------
    name, compares
        What it is called, and what with what.
    limit
        Greatest figure that passes.
    unit
        Of the figure.
    figure
        From the subject to the figure.
    """

    name: str
    compares: str
    limit: float
    unit: str
    figure: Callable[[Subject], float]


def measured(check: Check, subject: Subject) -> float:
    """The figure of a check, `NO_NUMBER` where it is none or there is nothing to look at."""
    figure = check.figure(subject)
    return min(figure, NO_NUMBER) if np.isfinite(figure) else NO_NUMBER


def _steep(step: Step) -> np.ndarray:
    """Rays that meet a surface, and leave it, away from grazing."""
    sides = [np.abs(np.sum(step.hits.n * d, axis=1)) > SLOPE for d in (step.at.d, step.after.d)]
    return np.asarray(step.hits.hit & sides[0] & sides[1])


def _form(events: tuple[Event, ...], subject: Subject) -> float:
    """Greatest symplectic defect on the torus."""
    kept = subject.kept[events]
    return float(kept.symplectic.max()) if kept.hit[0].any() else np.inf


def _unit(subject: Subject) -> float:
    """Greatest defect of n.n = 1, d.d = 1, d.dd = 0 and n.dp = 0 on the torus, away from grazing."""
    worst = 0.0
    for events, kept in subject.kept.items():
        steep = np.ones(len(subject.rays.p), bool)
        for number, step in enumerate(subject.steps[events]):
            steep &= _steep(step)
            for defect in (kept.direction, kept.surface):
                worst = max(worst, float(defect[number][steep].max(initial=0.0)))
    return worst


def _closed(events: tuple[Event, ...], subject: Subject) -> float:
    """Median error of the beam beyond the sphere's surfaces."""
    return _beam_error(subject.spheres[-1], events)


def _beam_error(field: GridField, events: tuple[Event, ...]) -> float:
    """||[dd/dx dd/dy] - truth|| / ||truth|| after the events, the median."""
    rays, last = _camera(BEFORE), len(events) - 1
    exact = list(ExactReference(shape("sphere")).steps(rays, events))[last]
    ours = next(islice(follow(Course(field, events), rays), last, None))
    both = np.flatnonzero(_steep(ours)[exact.alive] & exact.hits.hit)
    truth, found = _turning(exact.after)[both], _turning(ours.after)[exact.alive[both]]
    return _median(np.linalg.norm(found - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2)))


def _turning(rays: Beam) -> Float[np.ndarray, "n 3 2"]:
    return np.stack([rays.dd_dx, rays.dd_dy], axis=2)


def _median(values: Float[np.ndarray, " n"]) -> float:
    return float(np.median(values)) if values.size else np.inf


def _order(subject: Subject) -> float:
    """How far the order of convergence of the mirrored beam falls short of 2."""
    spacing = np.array([field.grid.lattice.spacing for field in subject.spheres])
    error = np.array([_beam_error(field, (None,)) for field in subject.spheres])
    return 2.0 - fitted_order(spacing, error)


def _displaced(events: tuple[Event, ...], subject: Subject) -> float:
    """95 % of the differences between the beam and displaced rays through the same field, beyond those' own bar."""
    step = subject.steps[events][0]
    course, middle, steep = Course(subject.torus, events), np.hstack([step.after.p, step.after.d]), _steep(step)

    def outputs(x: float, y: float) -> Float[np.ndarray, "n 6"]:
        moved = next(follow(course, displace(subject.rays, x, y)))
        near = np.hstack([moved.after.p, moved.after.d])
        lost = ~_steep(moved) | (np.abs(near - middle).max(axis=1) > 0.1)  # it met another side
        return np.where(lost[:, None], np.nan, near)

    truth = richardson(outputs, step=0.01)
    after = step.after
    ours = np.hstack([after.dp_dx, after.dd_dx, after.dp_dy, after.dd_dy])
    theirs = np.hstack([truth.d_dx, truth.d_dy])
    bar = np.hstack([truth.error_dx, truth.error_dy])
    good = steep & np.isfinite(bar).all(axis=1)
    excess = np.linalg.norm((ours - theirs)[good], axis=1) - np.linalg.norm(bar[good], axis=1)
    share = np.maximum(excess, 0.0) / np.linalg.norm(theirs[good], axis=1)
    return float(np.percentile(share, 95)) if share.size else np.inf


def _doubled(subject: Subject) -> float:
    """Greatest difference that twice the distance makes to the mirrored beam, relative."""
    rays = _camera(BEFORE)
    once, twice = (next(follow(Course(field, (None,)), rays)) for field in (subject.spheres[-1], subject.doubled))
    both = _steep(once) & _steep(twice)
    plain, other = _turning(once.after)[both], _turning(twice.after)[both]
    share = np.linalg.norm(other - plain, axis=(1, 2)) / np.linalg.norm(plain, axis=(1, 2))
    return float(share.max()) if share.size else np.inf


def _hits(subject: Subject) -> float:
    """95 % of the distances between a hit and the sphere along the normal, voxels."""
    field, rays = subject.spheres[-1], _camera(BEFORE)
    hits = trace(field, rays.p, rays.d)
    distance = np.abs(shape("sphere").distance(hits.p[hits.hit])) / field.grid.lattice.spacing
    return float(np.percentile(distance, 95)) if distance.size else np.inf


def _mapped(subject: Subject) -> tuple[Float[np.ndarray, " n"], np.ndarray]:
    """Distance to the faces' own texture coordinates at points of the mesh, texels; and where the chart differs."""
    mesh, rng = subject.ground.mesh, np.random.default_rng(8)
    assert mesh.uv is not None
    face: Int[np.ndarray, " n"] = rng.integers(len(mesh.faces), size=800)
    weight = rng.dirichlet(np.ones(3), 800)
    points = np.einsum("nk,nkc->nc", weight, mesh.vertices[mesh.faces[face]])
    uv, _, chart = subject.layered.uv(points)
    error = np.linalg.norm(uv - np.einsum("nk,nkc->nc", weight, mesh.uv[face]), axis=1)
    return error * TEXELS, chart != mesh.chart[face]


def _texels(subject: Subject) -> float:
    """95 % of the errors of texture coordinates."""
    return float(np.percentile(_mapped(subject)[0], 95))


def _charts(subject: Subject) -> float:
    """Share of points of another chart."""
    return float(_mapped(subject)[1].mean())


# Limits of identities and of what must not change at all: a dozen roundings of 1e-16 per step, times what footprints
# grow by down to a slope of 0.2. Limits against truths: some three times what the healthy renderer is off by on these
# coarse grids, and what it is off by follows from the kernel's order, not from a mistake.
CHECKS = (
    Check("form at mirrors", "symplectic form before and after mirrors", 1e-12, "relative", partial(_form, MIRROR)),
    Check("form at glass", "symplectic form before and after glass", 1e-12, "relative", partial(_form, GLASS)),
    Check("unit and tangent", "n.n = d.d = 1, d.dd = n.dp = 0", 1e-12, "relative", _unit),
    Check("closed-form mirror", "mirrored beam, sphere, closed form", 1e-3, "relative, p50", partial(_closed, (None,))),
    Check("closed-form glass", "beam through a ball, closed form", 1e-3, "relative, p50", partial(_closed, GLASS)),
    Check("displaced at mirrors", "mirrored beam, displaced rays", 1e-6, "relative, p95", partial(_displaced, MIRROR)),
    Check("displaced at glass", "refracted beam, displaced rays", 1e-6, "relative, p95", partial(_displaced, GLASS)),
    Check("order", "order of convergence of the mirrored beam, 2", 0.5, "below 2", _order),
    Check("twice the distance", "mirrored beam, samples doubled", 1e-10, "relative", _doubled),
    Check("hit", "hits, exact sphere", 1e-2, "voxel, p95", _hits),
    Check("uv", "layers, faces of the mesh", 4.0, "texel, p95", _texels),
    Check("chart", "layers, faces of the mesh", 1e-2, "share", _charts),
)
