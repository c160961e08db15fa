"""The way of rays over a field, step by step: what happens at each surface, and what every step must keep.

In: a field, rays, and what each surface on the way does. Out: `Step` records, for checks and for printing; the defects
of the identities at each of them.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sdfrender import Field, Hits, Rays, leaving, reflect, refract, transfer
from sdfrender.rays import COLUMNS
from validate.beam import Beam
from validate.identities import direction_defect, perturbed, surface_defect, symplectic_defect

# What a surface does: an index is that of a clear solid in air, None is a mirror.
Event = float | None


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A field and what happens at the surfaces that a ray meets one after another; at the last it ends.

    Attributes
    ----------
    field
        The surface.
    events
        Of the first surfaces: None for a mirror, or the refractive index of a clear solid in air.
    on_surface
        Whether rays start on the surface, and so do not meet that place again.
    """

    field: Field
    events: tuple[Event, ...] = ()
    on_surface: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One segment and the surface at its end.

    Attributes
    ----------
    hits
        What was met; misses stay where they are from then on.
    before, at, after
        Rays where the segment begins, at its end, and beyond the surface (the same as `at` for the last).
    index, beyond
        (n,) index of the medium on the segment, and beyond the surface.
    """

    hits: Hits
    before: Rays
    at: Rays
    after: Rays
    index: Float[np.ndarray, " n"]
    beyond: Float[np.ndarray, " n"]


def follow(course: Course, rays: Beam) -> Iterator[Step]:
    """Trace rays along a course, one `Step` per surface."""
    before = as_rays(rays)
    for number, event in enumerate((*course.events, None)):
        hits, at = transfer(course.field, before, on_surface=course.on_surface or number > 0)
        inside = leaving(hits, at)
        last = number == len(course.events)
        index = np.ones(len(at.p)) if event is None or last else np.where(inside, event, 1.0)
        after, beyond = (at, index) if last else _beyond(course.field, hits, at, event, index)
        yield Step(hits, before, at, after, index, beyond)
        before = after


def _beyond(
    field: Field, hits: Hits, at: Rays, event: Event, index: Float[np.ndarray, " n"]
) -> tuple[Rays, Float[np.ndarray, " n"]]:
    """Rays beyond a surface, and the index of the medium there."""
    if event is None:
        return reflect(field, hits, at), index
    across = np.where(leaving(hits, at), 1.0, event)
    after = refract(field, hits, at, eta=index / across)
    side_before, side_after = (np.sum(hits.n * d, axis=1) for d in (at.d, after.d))
    turned = side_before * side_after < 0  # totally reflected
    return after, np.where(hits.hit & ~turned, across, index)


@dataclass(frozen=True, slots=True, eq=False)
class Defects:
    """Defects of the identities along a course, the greatest per ray and step; 0 where a ray has missed.

    Attributes
    ----------
    symplectic, direction, surface
        (steps, n), see `validate.identities`.
    hit
        (steps, n): rays that have met a surface in every step up to this.
    """

    symplectic: Float[np.ndarray, "k n"]
    direction: Float[np.ndarray, "k n"]
    surface: Float[np.ndarray, "k n"]
    hit: Bool[np.ndarray, "k n"]

    @property
    def greatest(self) -> Float[np.ndarray, " n"]:
        """Of all identities and steps, per ray."""
        return np.asarray(np.maximum.reduce([self.symplectic, self.direction, self.surface]).max(axis=0))


def defects(course: Course, rays: Beam, rng: np.random.Generator, length: float = 1.0) -> Defects:
    """Follow rays with four independent perturbations each in place of their own, and measure what must be kept.

    Parameters
    ----------
    course, rays
        The way, and rays of which positions and directions are taken.
    rng, length
        As for `validate.identities.perturbed`.
    """
    count = len(rays.p)
    symplectic, direction, surface, hit = [], [], [], []
    alive = np.ones(count, bool)
    # Both bundles in one array: calls of few rays cost what they cost, however few.
    for step in follow(course, _joined(*perturbed(rays.p, rays.d, rng, length))):
        before, at, after = (_halves(bundle, count) for bundle in (step.before, step.at, step.after))
        index, beyond, n = step.index[:count], step.beyond[:count], step.hits.n[:count]
        alive = alive & step.hits.hit[:count]
        segment = symplectic_defect(before, at, index, index, length)
        turn = symplectic_defect(at, after, index, beyond, length)
        symplectic.append(np.where(alive, np.maximum(segment, turn), 0.0))
        direction.append(np.where(alive, np.maximum(*map(direction_defect, after)), 0.0))
        surface.append(np.where(alive, np.maximum(*(surface_defect(n, bundle) for bundle in at)), 0.0))
        hit.append(alive)
    return Defects(np.array(symplectic), np.array(direction), np.array(surface), np.array(hit))


def _joined(first: Beam, second: Beam) -> Rays:
    return Rays(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in COLUMNS))


def _halves(rays: Rays, count: int) -> tuple[Rays, Rays]:
    return rays.where(np.arange(count)), rays.where(np.arange(count, 2 * count))


def as_rays(beam: Beam) -> Rays:
    """The renderer's own record of rays."""
    return Rays(beam.p, beam.d, beam.dp_dx, beam.dp_dy, beam.dd_dx, beam.dd_dy)
