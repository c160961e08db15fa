"""The picture of a scene: the bounce loop.

In: a scene. Out: arrays (h, w, channels) per output. A path goes from the camera from mirror to mirror to the first
surface that is none; `rgb`, `uv`, `duv_dx`, `duv_dy`, `lod` and `flags` speak of its end, `Z`, `P`, `N` and `part` of
its first hit. A path that still looks into a mirror after the last bounce is black.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sdfbake.complaint import BadInput
from sdfbake.engine import Array, Engine, choose
from sdfbake.grid import Grid
from sdfrender import optics
from sdfrender.camera import Camera
from sdfrender.field import Field, Jet, Mapped, Spot
from sdfrender.flags import Flag
from sdfrender.footprint import derivatives, level_of_detail
from sdfrender.gridfield import GridField
from sdfrender.image import CHANNELS
from sdfrender.kernels import kernel
from sdfrender.plan import Plan, make_plan
from sdfrender.rays import Beam
from sdfrender.scene import Diffuse, Material, Mirror, Scene, load_scene
from sdfrender.texture import Sampler, Texture
from sdfrender.trace import hit_flags, mirrored, transferred
from sdfrender.uvmode import BY_NORMAL
from sdfrender.vector import Vector, select, zero


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A scene ready to be traced.

    Attributes
    ----------
    scene, plan, field
        The scene, what of it is computed, the surface.
    materials
        Material per part id.
    samplers
        Textures by name, those that the plan needs.
    """

    scene: Scene
    plan: Plan
    field: Field
    materials: tuple[Material, ...]
    samplers: dict[str, Sampler]


def render(
    scene: Scene | str | Path,
    *,
    engine: str = "auto",
    precision: int | None = None,
    field: Field | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, np.ndarray]:
    """Render a scene.

    Parameters
    ----------
    scene
        A scene, or its file.
    engine, precision
        As for `sdfbake.engine.choose`; not used where a field is given.
    field
        A surface to take in place of the scene's grid, such as an exact shape.
    progress
        Called with the passes done and to do.

    Returns
    -------
    dict
        Float arrays (h, w, channels) by output name; see `sdfrender.image.CHANNELS`.

    Raises
    ------
    BadInput
        If an asset, a part, a channel or a texture that the scene needs is missing.
    """
    return shoot(prepare(scene, engine=engine, precision=precision, field=field), progress)


def prepare(
    scene: Scene | str | Path, *, engine: str = "auto", precision: int | None = None, field: Field | None = None
) -> Stage:
    """Load what the plan of a scene needs, and nothing else; see `render`."""
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    if field is None:
        plan = make_plan(scene)
        field = _load_field(scene, plan, engine, precision)
    else:
        plan = make_plan(scene, (field.uv_mode,) if field.uv_mode else ())
    materials = _by_part(scene, field.part_names)
    names = {m.texture for m in materials if isinstance(m, Diffuse) and m.texture} if plan.uv else set()
    samplers = {}
    for name in sorted(names):
        model = scene.texture(name)
        samplers[name] = Sampler(field.engine, Texture.load(model.image), model.filter, model.wrap)
    return Stage(scene, plan, field, materials, samplers)


def shoot(stage: Stage, progress: Callable[[int, int], None] | None = None) -> dict[str, np.ndarray]:
    """Trace all pixels of a prepared scene: one pass per sub-pixel, colours averaged.

    What is not a colour comes from the sub-pixel in the middle (or next to it), per pixel.
    """
    film = stage.scene.film
    width, height = film.size
    camera = stage.scene.camera.camera(film.size)
    index = np.arange(width * height, dtype=np.int32)
    per_axis = film.supersample
    total: np.ndarray | None = None
    kept: dict[str, np.ndarray] = {}
    for number in range(per_axis**2):
        j, i = divmod(number, per_axis)
        middle = i == j == per_axis // 2
        outputs: tuple[str, ...] = film.outputs if middle else tuple(name for name in film.outputs if name == "rgb")
        if progress is not None:
            progress(number, per_axis**2)
        if not outputs:
            continue
        offset = ((i + 0.5) / per_axis, (j + 0.5) / per_axis)
        out = stage.field.engine.run(_program(stage, camera, outputs, offset), [index])
        arrays = {name: _image(out, name, width, height) for name in outputs}
        if "rgb" in arrays:
            rgb = arrays.pop("rgb") / per_axis**2
            total = rgb if total is None else total + rgb
        kept.update(arrays)
    return {name: kept[name] if name != "rgb" else np.asarray(total) for name in film.outputs}


def _image(out: dict[str, np.ndarray], name: str, width: int, height: int) -> np.ndarray:
    channels, _ = CHANNELS[name]
    return np.stack([out[channel].astype(np.float64).reshape(height, width) for channel in channels], axis=-1)


def _program(
    stage: Stage, camera: Camera, outputs: tuple[str, ...], offset: tuple[float, float]
) -> Callable[..., dict[str, Array]]:
    """Return the program that follows the paths of pixel numbers."""
    width = camera.size[0]
    step = 1.0 / stage.scene.film.supersample

    def program(xp: Engine, index: Array) -> dict[str, Array]:
        columns = xp.uniform(width)
        row = index // columns
        x = xp.real(index - row * columns) + xp.uniform(offset[0])
        y = xp.real(row) + xp.uniform(offset[1])
        beam = camera.beam(xp, x, y, stage.field.anchor, step)
        return _follow(xp, stage, beam, outputs, 1.0 / step)

    return program


def _follow(xp: Engine, stage: Stage, beam: Beam, outputs: tuple[str, ...], per_pixel: float) -> dict[str, Array]:
    """Follow paths through all their hits."""
    plan, field = stage.plan, stage.field
    active, spot = xp.full(beam.p[0], True), None
    rgb, weight = zero(xp, beam.p[0]), tuple(xp.full(beam.p[0], 1.0) for _ in range(3))
    out: dict[str, Array] = {}
    flags = xp.full(beam.p[0], 0)
    for hit, order in enumerate(plan.orders):
        spot = field.first_hit(xp, beam.p, beam.d, active, spot)
        jet = Jet(xp.full(spot.t, 0.0)) if order is None else field.jet_at(xp, spot, order)
        part = xp.where(spot.hit, field.part_at(xp, spot) if plan.parts else xp.full(spot.t, 0), -1)
        if "flags" in outputs:
            flags = xp.where(active, flags | hit_flags(xp, field, spot, jet, beam, spot.t), flags)
        if plan.differentials:
            beam = transferred(xp, beam, jet, spot, xp.full(spot.t, 0.0))
        if hit == 0:
            out |= _first_hit(xp, stage, spot, jet, part, outputs)
        looking = _is_mirror(xp, stage, part)
        ends = active & ~looking
        n = optics.normal(xp, jet) if plan.uv_mode in BY_NORMAL else None
        mapped = field.uv_at(xp, spot._replace(hit=spot.hit & ends), n) if plan.uv else None
        shown = _shaded(xp, stage, beam, spot, jet, part, mapped)
        rgb = _accumulated(xp, rgb, weight, shown, ends)
        if mapped is not None:
            _end(xp, stage, out, (outputs, per_pixel), ends & spot.hit, mapped, beam, part)
            flags = flags | xp.integer(ends & mapped.seam) * int(Flag.SEAM)
        active = active & looking
        if hit + 1 < len(plan.orders):
            weight = _tinted(xp, stage, part, active, weight)
            beam = _onward(xp, plan, beam, spot, jet, active)
    named = {"R": rgb[0], "G": rgb[1], "B": rgb[2], "flags": flags}
    return {**{k: v for k, v in named.items() if k in _wanted(outputs)}, **out}


def _onward(xp: Engine, plan: Plan, beam: Beam, spot: Spot, jet: Jet, active: Array) -> Beam:
    """Leave a mirror."""
    if plan.differentials:
        return mirrored(xp, beam, jet, active)
    d = select(xp, active, optics.reflected(beam.d, optics.normal(xp, jet)), beam.d)
    return beam._replace(p=spot.p, d=d)


def _first_hit(
    xp: Engine, stage: Stage, spot: Spot, jet: Jet, part: Array, outputs: tuple[str, ...]
) -> dict[str, Array]:
    """Return the outputs that speak of the first hit."""
    out: dict[str, Array] = {}
    nothing = zero(xp, spot.t)
    if "Z" in outputs:
        out["Z"] = xp.where(spot.hit, spot.t, 0.0)
    if "part" in outputs:
        out["part"] = part
    if "P" in outputs:
        world = [p + xp.uniform(float(a)) for p, a in zip(spot.p, stage.field.anchor, strict=True)]
        out |= _named("P", select(xp, spot.hit, (world[0], world[1], world[2]), nothing))
    if "N" in outputs:
        out |= _named("N", select(xp, spot.hit, optics.normal(xp, jet), nothing))
    return out


def _end(
    xp: Engine,
    stage: Stage,
    out: dict[str, Array],
    wanted: tuple[tuple[str, ...], float],
    ends: Array,
    mapped: Mapped,
    beam: Beam,
    part: Array,
) -> None:
    """Add the outputs that speak of a path's end to the caller's own dictionary, for the paths that end here."""
    outputs, per_pixel = wanted
    values: dict[str, Array] = {}
    if "uv" in outputs:
        values |= {"uv.U": mapped.u, "uv.V": mapped.v}
    if {"duv_dx", "duv_dy", "lod"} & set(outputs):
        dx, dy = derivatives(mapped, beam)
        for name, duv in (("duv_dx", dx), ("duv_dy", dy)):
            values |= {f"{name}.U": duv[0] * per_pixel, f"{name}.V": duv[1] * per_pixel} if name in outputs else {}
        if "lod" in outputs:
            whole = [(duv[0] * per_pixel, duv[1] * per_pixel) for duv in (dx, dy)]
            values["lod"] = level_of_detail(xp, whole[0], whole[1], _texels(xp, stage, part))
    for name, value in values.items():
        out[name] = xp.where(ends, value, out.get(name, xp.full(beam.p[0], 0.0)))


def _texels(xp: Engine, stage: Stage, part: Array) -> tuple[Array, Array]:
    """Return width and height of each hit's texture, 1 where there is none."""
    width, height = xp.full(part, 1.0), xp.full(part, 1.0)
    for number, material in enumerate(stage.materials):
        if isinstance(material, Diffuse) and material.texture in stage.samplers:
            w, h = stage.samplers[material.texture].size
            width = xp.where(part == number, xp.uniform(float(w)), width)
            height = xp.where(part == number, xp.uniform(float(h)), height)
    return width, height


def _shaded(
    xp: Engine, stage: Stage, beam: Beam, spot: Spot, jet: Jet, part: Array, mapped: Mapped | None
) -> Vector | None:
    """Return the colour of what a path ends on; None where no colour is wanted."""
    if "rgb" not in stage.plan.outputs:
        return None
    background = [xp.uniform(c) for c in stage.scene.background]
    nothing = xp.full(spot.t, 0.0)
    colour: Vector = (nothing + background[0], nothing + background[1], nothing + background[2])
    for number, material in enumerate(stage.materials):
        if isinstance(material, Mirror):
            continue
        here = spot.hit & (part == number)
        if isinstance(material, Diffuse):
            shown = _diffuse(xp, stage, material, beam, mapped, here)
        else:
            n = optics.normal(xp, jet)
            shown = (0.5 * n[0] + 0.5, 0.5 * n[1] + 0.5, 0.5 * n[2] + 0.5)
        colour = select(xp, here, shown, colour)
    return colour


def _diffuse(xp: Engine, stage: Stage, material: Diffuse, beam: Beam, mapped: Mapped | None, here: Array) -> Vector:
    tint = [xp.uniform(c) for c in material.colour]
    if material.texture is None or mapped is None:
        white = xp.full(beam.p[0], 1.0)
        return white * tint[0], white * tint[1], white * tint[2]
    sampler = stage.samplers[material.texture]
    lod = None
    if sampler.needs_footprint:
        size = (xp.uniform(float(sampler.size[0])), xp.uniform(float(sampler.size[1])))
        lod = level_of_detail(xp, *derivatives(mapped, beam), size)
    r, g, b = sampler.colour(xp, mapped.u, mapped.v, lod, here)
    return r * tint[0], g * tint[1], b * tint[2]


def _accumulated(xp: Engine, rgb: Vector, weight: Vector, shown: Vector | None, ends: Array) -> Vector:
    if shown is None:
        return rgb
    return select(xp, ends, (weight[0] * shown[0], weight[1] * shown[1], weight[2] * shown[2]), rgb)


def _tinted(xp: Engine, stage: Stage, part: Array, active: Array, weight: tuple[Array, ...]) -> tuple[Array, ...]:
    for number, material in enumerate(stage.materials):
        if isinstance(material, Mirror) and material.colour != (1.0, 1.0, 1.0):
            here = active & (part == number)
            weight = tuple(xp.where(here, w * xp.uniform(c), w) for w, c in zip(weight, material.colour, strict=True))
    return weight


def _is_mirror(xp: Engine, stage: Stage, part: Array) -> Array:
    mirror = xp.full(part, False)
    for number, material in enumerate(stage.materials):
        if isinstance(material, Mirror):
            mirror = mirror | (part == number)
    return mirror


def _named(name: str, vector: Vector) -> dict[str, Array]:
    return {f"{name}.{axis}": value for axis, value in zip("XYZ", vector, strict=True)}


def _wanted(outputs: tuple[str, ...]) -> set[str]:
    return {channel for name in outputs for channel in CHANNELS[name][0]}


def _load_field(scene: Scene, plan: Plan, engine: str, precision: int | None) -> GridField:
    choice = choose(engine, precision)
    grid = Grid.load(scene.assets[0].grid, channels=set(plan.channels))
    return GridField(grid, kernel(scene.trace.kernel, scene.trace.tension), choice, uv_mode=plan.uv_mode)


def _by_part(scene: Scene, parts: tuple[str, ...]) -> tuple[Material, ...]:
    """Return the material of every part of the asset."""
    asset = scene.assets[0]
    given = {material.part: material for material in asset.materials}
    unknown = set(given) - set(parts) - {"*"}
    if unknown:
        raise BadInput(f"{asset.grid} has no part '{min(unknown)}' for a material: its parts are {', '.join(parts)}")
    for part in parts:
        if part not in given and "*" not in given:
            raise BadInput(f"the part '{part}' of {asset.grid} has no material: add one for it, or one for '*'")
    return tuple(given.get(part, given.get("*", asset.materials[0])) for part in parts)
