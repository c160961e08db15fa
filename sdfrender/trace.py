"""Rays in, hits and footprints out, as NumPy arrays: the renderer's parts one by one.

`trace` finds hits, `transfer` moves rays with their differentials to them, `reflect` sends them on (`glass.refract` as
well), `footprint` looks at the texture coordinates there. All take any `Field`, a grid's or an exact shape's.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sdfbake.engine import Array, Engine
from sdfrender import optics
from sdfrender.field import Field, Jet, Spot
from sdfrender.flags import Flag
from sdfrender.footprint import derivatives, invariant_level, level_of_detail
from sdfrender.rays import Beam, Rays, beam, components, rays, vectors
from sdfrender.vector import Vector, select, zero


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Where rays met a surface.

    Attributes
    ----------
    t
        Ray parameter, units of the direction's length; infinite for a miss.
    p, n
        Position and outward unit normal, world frame; 0 for a miss.
    flags
        Bits of `Flag`.
    part
        Part of the surface; -1 for a miss.
    """

    t: Float[np.ndarray, " n"]
    p: Float[np.ndarray, "n 3"]
    n: Float[np.ndarray, "n 3"]
    flags: Int[np.ndarray, " n"]
    part: Int[np.ndarray, " n"]

    @property
    def hit(self) -> np.ndarray:
        """Mask of the rays that met something."""
        met: np.ndarray = np.isfinite(self.t)
        return met


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """Footprints on a texture; 0 for a miss.

    Attributes
    ----------
    uv, duv_dx, duv_dy
        Texture coordinates and their derivatives per pixel.
    lod, lod_invariant
        log2 of the longer footprint axis in texels (Galim 2018, eq. 25), and of its greatest singular value.
    chart
        Chart of the texture atlas.
    flags
        Those of the hit and of the way to it, and SEAM.
    """

    uv: Float[np.ndarray, "n 2"]
    duv_dx: Float[np.ndarray, "n 2"]
    duv_dy: Float[np.ndarray, "n 2"]
    lod: Float[np.ndarray, " n"]
    lod_invariant: Float[np.ndarray, " n"]
    chart: Int[np.ndarray, " n"]
    flags: Int[np.ndarray, " n"]


def trace(
    field: Field, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"], *, on_surface: bool = False
) -> Hits:
    """Find where rays first meet a surface.

    Parameters
    ----------
    field
        The surface.
    origins, directions
        (n, 3) float64, world frame; directions of any length but 0.
    on_surface
        The origins lie on the surface, as hits do: that place is not met again.

    Returns
    -------
    Hits
        Certified first hits.

    Raises
    ------
    ValueError
        If the arrays do not match, are not finite, or hold a direction of no length.
    """
    origins, directions = _checked(origins, directions)
    ahead = approach(field, origins, directions, on_surface=on_surface)

    def program(xp: Engine, *c: Array) -> dict[str, Array]:
        p, d = (c[0], c[1], c[2]), (c[3], c[4], c[5])
        spot = _meet(xp, field, p, d, on_surface)
        jet = field.jet_at(xp, spot, 1)
        return {**_hit_columns(xp, field, spot, jet), "flags": _miss(xp, spot)}

    start = origins + ahead[:, None] * directions
    out = field.engine.run(program, [*(start - field.anchor).T, *directions.T])
    return _hits(out, field, ahead)


def transfer(field: Field, rays_: Rays, *, on_surface: bool = False) -> tuple[Hits, Rays]:
    """Move rays and their differentials to the first hit (Galim 2018, table 1).

    Parameters
    ----------
    field, on_surface
        As for `trace`.
    rays_
        Rays with differentials; directions of unit length.

    Returns
    -------
    hits
        With flags HORIZON, CAUSTIC, BAND and EDGE.
    rays
        At the hits, with the hits' flags added to their own; rays that miss stay as they are.
    """
    _checked(rays_.p, rays_.d)
    ahead = approach(field, rays_.p, rays_.d, on_surface=on_surface)

    def program(xp: Engine, *c: Array) -> dict[str, Array]:
        incoming, begin = beam(c[:18]), c[18]
        spot = _meet(xp, field, incoming.p, incoming.d, on_surface)
        jet = field.jet_at(xp, spot, 1)
        moved = transferred(xp, incoming, jet, spot, begin)
        flags = hit_flags(xp, field, spot, jet, incoming, spot.t + begin)
        return {**components(moved), **_hit_columns(xp, field, spot, jet), "flags": flags}

    columns = rays_.columns()
    columns[:3] = (rays_.p + ahead[:, None] * rays_.d - field.anchor).T
    out = field.engine.run(program, [*columns, ahead])
    hits, moved = _hits(out, field, ahead), rays(out)
    p = np.where(hits.hit[:, None], moved.p + field.anchor, rays_.p)
    flags = rays_.flags | hits.flags & ~Flag.MISS
    return hits, Rays(p, moved.d, moved.dp_dx, moved.dp_dy, moved.dd_dx, moved.dd_dy, flags)


def reflect(field: Field, hits: Hits, rays_: Rays) -> Rays:
    """Mirror rays that `transfer` brought to a surface; rays that missed stay as they are."""

    def program(xp: Engine, *c: Array) -> dict[str, Array]:
        incoming, hit = beam(c[:18]), c[18] > 0
        jet = field.jet_at(xp, field.locate(xp, incoming.p, hit), 2)
        return components(mirrored(xp, incoming, jet, hit))

    columns = rays_.columns()
    columns[:3] = (rays_.p - field.anchor).T
    out = rays(field.engine.run(program, [*columns, hits.hit.astype(np.int32)]))
    return Rays(rays_.p, out.d, out.dp_dx, out.dp_dy, out.dd_dx, out.dd_dy, rays_.flags)


def footprint(field: Field, hits: Hits, rays_: Rays, *, size: tuple[int, int] = (1, 1)) -> Footprint:
    """Project rays that `transfer` brought to a surface onto its texture.

    Parameters
    ----------
    field, hits, rays_
        What was traced, and what `transfer` returned.
    size
        Width and height of the texture, texels: only the levels of detail depend on it.
    """
    field.prepare_uv()

    def program(xp: Engine, *c: Array) -> dict[str, Array]:
        incoming, hit, n = beam(c[:18]), c[18] > 0, (c[19], c[20], c[21])
        mapped = field.uv_at(xp, field.locate(xp, incoming.p, hit), n)
        (ux, vx), (uy, vy) = derivatives(mapped, incoming)
        texels = (xp.uniform(float(size[0])), xp.uniform(float(size[1])))
        lod = level_of_detail(xp, (ux, vx), (uy, vy), texels)
        invariant = invariant_level(xp, (ux, vx), (uy, vy), texels)
        numbers = {"u": mapped.u, "v": mapped.v, "ux": ux, "vx": vx, "uy": uy, "vy": vy, "lod": lod, "inv": invariant}
        kept = {name: xp.where(hit, value, 0.0) for name, value in numbers.items()}
        return {**kept, "chart": mapped.chart, "seam": xp.integer(mapped.seam & hit)}

    columns = rays_.columns()
    columns[:3] = (rays_.p - field.anchor).T
    out = field.engine.run(program, [*columns, hits.hit.astype(np.int32), *hits.n.T])
    uv, dx, dy = (np.stack([out[a], out[b]], -1).astype(float) for a, b in (("u", "v"), ("ux", "vx"), ("uy", "vy")))
    flags = hits.flags | rays_.flags | np.where(out["seam"] > 0, Flag.SEAM, 0)
    chart = np.where(hits.hit, out["chart"], -1)
    return Footprint(uv, dx, dy, out["lod"].astype(float), out["inv"].astype(float), chart, flags)


def transferred(xp: Engine, incoming: Beam, jet: Jet, spot: Spot, begin: Array) -> Beam:
    """Within a program: the beam at the hit, unchanged where there is none; `begin` is the way already gone."""
    moved = optics.transfer(xp, incoming, jet, spot.p, spot.t + begin)
    return Beam(*(select(xp, spot.hit, new, old) for new, old in zip(moved, incoming, strict=True)))


def mirrored(xp: Engine, incoming: Beam, jet: Jet, hit: Array) -> Beam:
    """Within a program: the beam after the mirror, unchanged where there is none."""
    n = optics.normal(xp, jet)
    dn_dx = optics.normal_differential(xp, jet, n, incoming.dp_dx)
    dn_dy = optics.normal_differential(xp, jet, n, incoming.dp_dy)
    outgoing = optics.reflect(incoming, n, dn_dx, dn_dy)
    return Beam(*(select(xp, hit, new, old) for new, old in zip(outgoing, incoming, strict=True)))


def hit_flags(xp: Engine, field: Field, spot: Spot, jet: Jet, incoming: Beam, t: Array) -> Array:
    """Within a program: the flags that need no texture coordinates."""
    said = [
        (Flag.HORIZON, optics.crosses_horizon(xp, incoming, jet)),
        (Flag.CAUSTIC, optics.passes_caustic(xp, incoming, t)),
        (Flag.BAND, field.beyond_band(xp, spot)),
    ]
    if field.is_distance:
        said.append((Flag.EDGE, optics.is_edge(xp, jet)))
    flags = _miss(xp, spot)
    for flag, mask in said:
        flags = flags | xp.integer(mask & spot.hit) * int(flag)
    return flags


def _meet(xp: Engine, field: Field, p: Vector, d: Vector, on_surface: bool) -> Spot:
    everybody = xp.full(p[0], True)
    start = field.locate(xp, p, everybody) if on_surface else None
    return field.first_hit(xp, p, d, everybody, start)


def _miss(xp: Engine, spot: Spot) -> Array:
    return xp.integer(~spot.hit) * int(Flag.MISS)


def _hit_columns(xp: Engine, field: Field, spot: Spot, jet: Jet) -> dict[str, Array]:
    n = select(xp, spot.hit, optics.normal(xp, jet), zero(xp, spot.t))
    p = select(xp, spot.hit, spot.p, zero(xp, spot.t))
    columns = {f"at{a}": p[a] for a in range(3)} | {f"n{a}": n[a] for a in range(3)}
    part = xp.where(spot.hit, field.part_at(xp, spot), -1)
    return {**columns, "t": spot.t, "hit": xp.integer(spot.hit), "part": part}


def _hits(out: dict[str, np.ndarray], field: Field, ahead: np.ndarray) -> Hits:
    hit = out["hit"] > 0
    t = np.where(hit, out["t"].astype(np.float64) + ahead, np.inf)
    p = np.where(hit[:, None], vectors(out, "at") + field.anchor, 0.0)
    return Hits(t, p, vectors(out, "n"), out["flags"].astype(np.int32), out["part"].astype(np.int32))


def _checked(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    origins, directions = np.asarray(origins, np.float64), np.asarray(directions, np.float64)
    if origins.ndim != 2 or origins.shape[1:] != (3,) or directions.shape != origins.shape:
        raise ValueError(f"origins {origins.shape} and directions {directions.shape}: expected (n, 3) twice")
    if not (np.isfinite(origins).all() and np.isfinite(directions).all()):
        raise ValueError("origins and directions must be finite")
    if not (directions != 0).any(axis=-1).all():
        raise ValueError("every direction needs a length")
    return origins, directions


def approach(field: Field, p: np.ndarray, d: np.ndarray, *, on_surface: bool = False) -> Float[np.ndarray, " n"]:
    """Return how far a ray from outside may go in float64 before the field's box begins.

    Positions then have the box's size, whatever the distance they came from: float32 loses nothing to it.
    """
    if on_surface:
        return np.zeros(len(p))
    with np.errstate(all="ignore"):  # a ray along a face divides 0 by 0, a tiny component overflows: no bounds
        crossing = (field.bounds[:, None, :] - p) / d
    first = np.nan_to_num(crossing.min(axis=0), nan=0.0, posinf=0.0, neginf=0.0).max(axis=-1)
    # Stop a rounding error short of the box, so that the march enters it from outside.
    slack = 1e-9 * np.linalg.norm(np.diff(field.bounds, axis=0)) / np.linalg.norm(d, axis=-1)
    ahead: Float[np.ndarray, " n"] = np.maximum(first - slack, 0.0)
    return ahead
