"""Paths through a scene: from the camera to mirrors and through glass, to the first surface that is neither.

In: where rays begin. Out: what a picture records of them, array by array. A path that still looks into a mirror or
through glass after the last hit is black.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender import optics, palette
from sdfrender.crossing import decide, entering
from sdfrender.field import Jet, Spot
from sdfrender.flags import Flag
from sdfrender.palette import Surface
from sdfrender.planned import FUSED
from sdfrender.radiance import Shown, ending, first_hit, shown
from sdfrender.rays import Beam
from sdfrender.stage import Stage
from sdfrender.trace import hit_flags, transferred
from sdfrender.vector import Vector, select
from sdfrender.viewing import Start
from sdfrender.widths import spreading

NOTHING: Any = ()  # in place of what a path does not carry


class Path(NamedTuple):
    """Where a path is, and what it has seen.

    What the plan leaves out is an empty tuple.

    Attributes
    ----------
    active
        Mask: it goes on.
    beam
        The ray to go on with, derivatives only where the plan carries them.
    begin
        How far ahead of the place that the derivatives are of the beam's position is.
    weight, light
        Share of what comes that reaches the camera, and what has reached it; linear, per channel.
    flags
        Of all hits so far.
    within
        Bodies of glass that the path is in, as bits.
    code, splits
        Which ways to go at glass, see `sdfrender.crossing`; at how many of its surfaces both were open.
    seen
        What else is recorded, channel by channel.
    """

    active: Array
    beam: Beam
    begin: Array
    weight: tuple[Array, ...]
    light: tuple[Array, ...]
    flags: tuple[Array, ...]
    within: tuple[Array, ...]
    code: tuple[Array, ...]
    splits: tuple[Array, ...]
    seen: tuple[Array, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """What is to be found out of paths.

    Attributes
    ----------
    stage
        The scene.
    outputs
        What is recorded.
    channels
        Names of what is recorded beside light and flags.
    """

    stage: Stage
    outputs: frozenset[str]
    channels: tuple[str, ...]


def follow(xp: Engine, job: Job, start: Start, code: Array, within: Array | None) -> dict[str, Array]:
    """Follow paths through all their hits.

    Parameters
    ----------
    xp
        The engine.
    job
        What is recorded.
    start
        Beams and how far they were brought.
    code
        Which ways they go at glass.
    within
        Bodies of glass that they start in; None where there are not several.
    """
    field, orders = job.stage.field, job.stage.plan.orders
    path, place = _begun(xp, job, start, code, within), None
    if len(orders) <= FUSED:
        for number in range(len(orders)):
            path, place = _hit(xp, job, number, number == len(orders) - 1, (path, place))
    else:
        place = field.locate(xp, path.beam.p, xp.full(path.active, False))
        for number in range(len(orders)):
            path, place = xp.apart(path.active, partial(_hit, xp, job, number, False), (path, place))
    names = (("R", "G", "B"), path.light), (("flags",), path.flags), (("splits",), path.splits)
    named = {name: value for keys, values in names if values for name, value in zip(keys, values, strict=True)}
    return {**named, **dict(zip(job.channels, path.seen, strict=True))}


def _hit(xp: Engine, job: Job, number: int, last: bool, state: tuple[Path, Spot | None]) -> tuple[Path, Spot]:
    """Follow paths to their next hit, or out of the scene."""
    path, place = state
    beam, spread = path.beam, spreading(path.beam, path.begin) if job.stage.plan.grid_levels else None
    spot = job.stage.field.first_hit(xp, beam.p, beam.d, path.active, place, spread)
    path = xp.among(path.active & ~spot.hit, partial(_escaped, xp, job), path)
    return xp.among(spot.hit, partial(_met, xp, job, number, last), (path, spot))


def _begun(xp: Engine, job: Job, start: Start, code: Array, within: Array | None) -> Path:
    plan, like = job.stage.plan, start.beam.p[0]
    coloured = "rgb" in job.outputs
    blank = {"part": -1.0, "chart": -1.0}
    return Path(
        active=xp.full(like, True),
        beam=start.beam if plan.differentials else _bare(start.beam.p, start.beam.d),
        begin=start.begin,
        weight=tuple(xp.full(like, 1.0) for _ in range(3)) if coloured else NOTHING,
        light=tuple(xp.full(like, 0.0) for _ in range(3)) if coloured else NOTHING,
        flags=(xp.full(like, 0),) if "flags" in job.outputs else NOTHING,
        within=NOTHING if within is None else (xp.full(like, 0) + within,),
        code=(code,) if plan.splits and coloured else NOTHING,
        splits=(xp.full(like, 0),) if plan.splits and coloured else NOTHING,
        seen=tuple(xp.full(like, blank.get(name, 0.0)) for name in job.channels),
    )


def _bare(p: Vector, d: Vector) -> Beam:
    """Return a beam without derivatives."""
    return Beam(p, d, NOTHING, NOTHING, NOTHING, NOTHING)


def _escaped(xp: Engine, job: Job, path: Path) -> Path:
    """Let paths end at what surrounds the scene."""
    path = path._replace(active=xp.full(path.active, False))
    clamped = None
    if path.light:
        stage, beam = job.stage, path.beam
        if stage.around is None:
            light = tuple(w * xp.uniform(c) for w, c in zip(path.weight, stage.scene.background, strict=True))
        else:
            around = stage.scene.environment
            assert around is not None
            steps = (beam.dd_dx, beam.dd_dy) if stage.around.needs_footprint else None
            look = stage.around.look_up(xp, beam.d, steps, xp.full(path.active, True))
            strength = xp.uniform(around.intensity)
            light = tuple(w * (c * strength) for w, c in zip(path.weight, look.colour, strict=True))
            clamped = look.below | look.above | look.capped
        path = path._replace(light=light)
    return (
        _flagged(xp, path, Flag.MISS, None)
        if clamped is None
        else _flagged(xp, _flagged(xp, path, Flag.MISS, None), Flag.CLAMPED, clamped)
    )


def _flagged(xp: Engine, path: Path, flag: Flag, mask: Array | None) -> Path:
    """Set a flag, where flags are recorded."""
    if not path.flags:
        return path
    bits = int(flag) if mask is None else xp.integer(mask) * int(flag)
    return path._replace(flags=(path.flags[0] | bits,))


def _met(xp: Engine, job: Job, number: int, last: bool, state: tuple[Path, Spot]) -> tuple[Path, Spot]:
    """Let paths meet a surface: end there, or go on from it."""
    path, spot = state
    stage, plan = job.stage, job.stage.plan
    order = plan.orders[number]
    jet = Jet(xp.full(spot.t, 0.0)) if order is None else stage.field.jet_at(xp, spot, order)
    n = optics.normal(xp, jet) if order is not None else None
    part = stage.field.part_at(xp, spot) if plan.parts else xp.full(spot.t, 0)
    surface = stage.palette.look_up(xp, part, spot.hit)
    if path.flags:
        said = hit_flags(xp, stage.field, spot, jet, path.beam, spot.t + path.begin)
        path = path._replace(flags=(path.flags[0] | said,))
    seen = dict(zip(job.channels, path.seen, strict=True))
    if number == 0:
        seen |= first_hit(xp, job.outputs, stage.field, spot, jet, part, path.begin)
    beam = path.beam
    if plan.footprints or (plan.differentials and not last):
        beam = transferred(xp, beam, jet, spot, path.begin)
    mirror, glass = (stage.palette.made_of(xp, surface, kind, spot.hit) for kind in (palette.MIRROR, palette.GLASS))
    ends = spot.hit & ~(mirror | glass)
    path = path._replace(beam=beam, begin=xp.full(path.begin, 0.0), active=mirror | glass)
    path = _ended(xp, job, path, seen, shown(xp, stage, spot, n, surface, beam, ends), ends)
    if last:
        return path._replace(active=xp.full(path.active, False)), spot
    assert n is not None
    path = _onward(xp, job, path, spot, jet, n, (surface, part, mirror, glass))
    return path, spot._replace(hit=path.active)


def _ended(xp: Engine, job: Job, path: Path, seen: dict[str, Array], end: Shown, ends: Array) -> Path:
    """Record what paths end on."""
    if path.light:
        light = tuple(
            xp.where(ends, w * c, before) for w, c, before in zip(path.weight, end.light, path.light, strict=True)
        )
        path = path._replace(light=light)
    if end.mapped is not None:
        path = _flagged(xp, path, Flag.SEAM, ends & end.mapped.seam)
        values = ending(xp, job.outputs, job.stage, end, path.beam)
        seen |= {name: xp.where(ends, value, seen[name]) for name, value in values.items()}
    if end.clamped is not None:
        path = _flagged(xp, path, Flag.CLAMPED, ends & end.clamped)
    return path._replace(seen=tuple(seen[name] for name in job.channels))


def _onward(
    xp: Engine, job: Job, path: Path, spot: Spot, jet: Jet, n: Vector, what: tuple[Surface, Array, Array, Array]
) -> Path:
    """Leave a mirror, or a surface of glass by one of its ways."""
    surface, part, mirror, glass = what
    tint, eta, through = mirror, None, None
    if palette.GLASS in job.stage.palette.kinds:
        path, eta, through, tint = _crossed(xp, job, path, n, (surface, part, glass))
        tint = mirror | tint
    if path.weight:
        weight = tuple(xp.where(tint, w * c, w) for w, c in zip(path.weight, surface.colour, strict=True))
        path = path._replace(weight=weight)
    return path._replace(beam=_bent(xp, job, path.beam, (spot, jet, n), (eta, through)))


def _crossed(
    xp: Engine, job: Job, path: Path, n: Vector, what: tuple[Surface, Array, Array]
) -> tuple[Path, Array, Array, Array]:
    """Decide the ways at glass; also return eta, which paths pass, and which of them are tinted."""
    surface, part, glass = what
    d, bodies = path.beam.d, job.stage.bodies
    inward = entering(d, n)
    if bodies is None:
        eta, beyond, there = xp.where(inward, 1.0 / surface.index, surface.index), NOTHING, glass
    else:
        eta, after, there = bodies.cross(xp, part, inward, path.within[0], glass)
        beyond = (after,)
    if not path.weight:
        total = glass & optics.passage(xp, d, n, eta).total
        mirrored = total
    else:
        code, splits = (path.code[0], path.splits[0]) if path.splits else (xp.full(part, 0), xp.full(part, 0))
        way = decide(xp, d, n, eta, glass, code, splits, job.stage.plan.splits)
        path = path._replace(weight=tuple(w * way.share for w in path.weight))
        if path.splits:
            path = path._replace(splits=(splits + xp.integer(way.split),))
        total, mirrored = way.total, way.mirrored
    through = glass & ~mirrored
    if bodies is not None:
        path = path._replace(within=(xp.where(through, beyond[0], path.within[0]),))
    return _flagged(xp, path, Flag.TIR, total), eta, through, through & there


def _bent(
    xp: Engine, job: Job, beam: Beam, place: tuple[Spot, Jet, Vector], glass: tuple[Array | None, Array | None]
) -> Beam:
    """Return the beams that go on: through glass where `through`, mirrored elsewhere."""
    (spot, jet, n), (eta, through) = place, glass
    if not job.stage.plan.differentials:
        d = optics.reflected(beam.d, n)
        if through is not None:
            d = select(xp, through, optics.refracted(xp, beam.d, n, eta)[0], d)
        return _bare(spot.p, d)
    dn_dx, dn_dy = (optics.normal_differential(xp, jet, n, dp) for dp in (beam.dp_dx, beam.dp_dy))
    back = optics.reflect(beam, n, dn_dx, dn_dy)
    if through is None:
        return back
    on, _ = optics.refract(xp, beam, n, dn_dx, dn_dy, eta)
    return Beam(*(select(xp, through, a, b) for a, b in zip(on, back, strict=True)))
