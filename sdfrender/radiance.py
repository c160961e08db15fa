"""What a hit shows, and what a picture records of it.

In: hits with their surface. Out: the light that a path's end sends back, its texture coordinates, and the recorded
channels of first hits and of ends; see `sdfrender.image.CHANNELS`.
"""

from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender import optics, palette
from sdfrender.field import Field, Jet, Mapped, Spot
from sdfrender.footprint import axes, derivatives, invariant_level, level_of_detail
from sdfrender.palette import Surface
from sdfrender.rays import Beam
from sdfrender.stage import Stage
from sdfrender.texels import Pair
from sdfrender.vector import Vector, dot, scale, select, zero


class Shown(NamedTuple):
    """What a path's end shows: light, texture coordinates, the surface, whether a look-up was clamped; or nothing."""

    light: tuple[Array, ...]
    mapped: Mapped | None
    surface: Surface
    clamped: Array | None


def shown(xp: Engine, stage: Stage, spot: Spot, n: Vector | None, surface: Surface, beam: Beam, ends: Array) -> Shown:
    """Return what the ends of paths show."""
    mapped = stage.field.uv_at(xp, spot._replace(hit=ends), n) if stage.plan.uv else None
    if "rgb" not in stage.plan.outputs:
        return Shown((), mapped, surface, None)
    light, clamped = surface.colour, None
    if stage.samplers and mapped is not None:
        light, clamped = _textured(xp, stage, light, mapped, surface, beam, ends)
    matt = stage.palette.made_of(xp, surface, palette.DIFFUSE, ends)
    if stage.lighting is not None and n is not None:
        facing = xp.where(dot(beam.d, n) > 0, xp.full(n[0], -1.0), 1.0)
        arriving = stage.lighting.at(xp, stage.field, spot, scale(n, facing), matt)
        light = tuple(a * b for a, b in zip(light, arriving, strict=True))
    if palette.NORMALS in stage.palette.kinds and n is not None:
        there = stage.palette.made_of(xp, surface, palette.NORMALS, ends)
        light = tuple(xp.where(there, 0.5 * c + 0.5, before) for c, before in zip(n, light, strict=True))
    return Shown(light, mapped, surface, clamped)


def _textured(
    xp: Engine, stage: Stage, colour: Vector, mapped: Mapped, surface: Surface, beam: Beam, ends: Array
) -> tuple[tuple[Array, ...], Array]:
    """Multiply colours by those of textures; also return where a look-up was clamped."""
    clamped, light = xp.full(ends, False), tuple(colour)
    for number, sampler in enumerate(stage.samplers.values()):
        here = ends & (surface.texture == number)
        steps = derivatives(mapped, beam) if sampler.needs_footprint else None
        look = sampler.look_up(xp, mapped.u, mapped.v, steps, here)
        light = tuple(xp.where(here, c * t, c) for c, t in zip(light, look.colour, strict=True))
        clamped = clamped | here & (look.below | look.above | look.capped)
    return light, clamped


def first_hit(
    xp: Engine, outputs: frozenset[str], field: Field, spot: Spot, jet: Jet, part: Array, begin: Array
) -> dict[str, Array]:
    """Return the channels that speak of first hits."""
    out: dict[str, Array] = {}
    nothing = zero(xp, spot.t)
    if "Z" in outputs:
        out["Z"] = xp.where(spot.hit, spot.t + begin, 0.0)
    if "part" in outputs:
        out["part"] = xp.real(part)
    if "P" in outputs:
        world = [p + xp.uniform(float(a)) for p, a in zip(spot.p, field.anchor, strict=True)]
        out |= _named("P", "XYZ", select(xp, spot.hit, (world[0], world[1], world[2]), nothing))
    if "N" in outputs:
        out |= _named("N", "XYZ", select(xp, spot.hit, optics.normal(xp, jet), nothing))
    if "curvature" in outputs:
        out |= _named("curvature", ("min", "max"), optics.curvatures(xp, jet))
    return out


def ending(xp: Engine, outputs: frozenset[str], stage: Stage, end: Shown, beam: Beam) -> dict[str, Array]:
    """Return the channels that speak of the ends of paths."""
    mapped = end.mapped
    assert mapped is not None
    out: dict[str, Array] = {}
    if "uv" in outputs:
        out |= _named("uv", "UV", (mapped.u, mapped.v))
    if "chart" in outputs:
        out["chart"] = xp.real(mapped.chart)
    if not stage.plan.footprints:
        return out
    dx, dy = (_per_pixel(duv, stage.view.step) for duv in derivatives(mapped, beam))
    out |= _named("duv_dx", "UV", dx) if "duv_dx" in outputs else {}
    out |= _named("duv_dy", "UV", dy) if "duv_dy" in outputs else {}
    texels = _texels(xp, stage, end.surface)
    if "lod" in outputs:
        out["lod"] = level_of_detail(xp, dx, dy, texels)
    if "lod_invariant" in outputs:
        out["lod_invariant"] = invariant_level(xp, dx, dy, texels)
    if "ellipse" in outputs:
        out |= _named("ellipse", ("major", "minor", "angle"), axes(xp, dx, dy, texels))
    return out


def _per_pixel(duv: Pair, step: float) -> Pair:
    return duv[0] * (1.0 / step), duv[1] * (1.0 / step)


def _texels(xp: Engine, stage: Stage, surface: Surface) -> tuple[Array, Array]:
    """Return width and height of each hit's texture, 1 where there is none."""
    width, height = xp.full(surface.kind, 1.0), xp.full(surface.kind, 1.0)
    for number, sampler in enumerate(stage.samplers.values()):
        here = surface.texture == number
        width = xp.where(here, xp.uniform(float(sampler.size[0])), width)
        height = xp.where(here, xp.uniform(float(sampler.size[1])), height)
    return width, height


def _named(name: str, parts: str | tuple[str, ...], values: tuple[Array, ...]) -> dict[str, Array]:
    return {f"{name}.{part}": value for part, value in zip(parts, values, strict=True)}
