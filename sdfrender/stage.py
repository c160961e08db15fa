"""A scene made ready: what its plan names, loaded and put on an engine.

In: a scene. Out: a `Stage` that can be traced: the surface, its materials, textures, lights, and the view.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int

from sdfbake.bricks import Bricks
from sdfbake.complaint import BadInput
from sdfbake.engine import Array, Choice, Engine, choose
from sdfbake.gridfile import head, load_counted, nothing_read
from sdfbake.gridreading import Reading, together
from sdfbake.lattice import Lattice
from sdfbake.metadata import Metadata
from sdfrender.assembly import Assembly
from sdfrender.crossing import Bodies
from sdfrender.environment import Environment
from sdfrender.facts import IN_TEXELS, materials_of
from sdfrender.field import Field
from sdfrender.gridfield import GridField
from sdfrender.instance import Instance
from sdfrender.irradiance import irradiance
from sdfrender.kernels import kernel
from sdfrender.leveled import LeveledField
from sdfrender.lighting import Lighting
from sdfrender.materials import CheckerTexture, Diffuse, Glass, ImageTexture, Material, Texture, needs_footprint
from sdfrender.mips import Ground, grounds, levels_of
from sdfrender.omissions import with_levels
from sdfrender.palette import Palette
from sdfrender.picture import read_picture
from sdfrender.plan import make_plan
from sdfrender.planned import Levels, Plan
from sdfrender.pyramid import Texture as Image
from sdfrender.scene import Asset, Scene, load_scene
from sdfrender.sharing import Share, shares
from sdfrender.texture import Checker, Lookup, Sampler
from sdfrender.unseen import Unseen
from sdfrender.viewing import CameraView, View


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A scene ready to be traced.

    Attributes
    ----------
    scene, plan, view
        The scene, what of it is computed, where its rays come from.
    choice
        The engine, and why.
    field, members
        The surface; and those of the scene's assets that it is made of.
    palette
        What its parts are made of.
    samplers
        Textures by name, those that the plan needs.
    around, lighting
        The environment and the lights; None where the plan needs none.
    bodies
        Bodies of glass, where there are several; None elsewhere.
    read
        How much of every grid was read; none where surfaces were given.
    """

    scene: Scene
    plan: Plan
    view: View
    choice: Choice
    field: Field
    members: tuple[Field, ...]
    palette: Palette
    samplers: dict[str, Lookup]
    around: Environment | None
    lighting: Lighting | None
    bodies: Bodies | None
    read: tuple[tuple[str, Reading], ...]

    def graze(self) -> float:
        """Return how deep a graze may be missed at most, world units: the largest of the grids' rounding bounds."""
        grids = [(member, asset.placed().scale) for member, asset in zip(self.members, self.scene.assets, strict=True)]
        inner = [(member.field if isinstance(member, Instance) else member, scale) for member, scale in grids]
        return max(
            (2 * grid.tolerance * scale for grid, scale in inner if isinstance(grid, GridField | LeveledField)),
            default=0.0,
        )

    def within(self) -> Int[np.ndarray, " m"]:
        """Return, as bits, the bodies of glass that rays start in: once for all, or once per ray of the view."""
        origins = self.view.origins()
        bits = np.zeros(len(origins), np.int32)
        glass = [member for member, body in zip(self.members, _bodies(self.scene), strict=True) if body >= 0]
        for number, member in enumerate(glass):
            bits |= _inside(member, origins).astype(np.int32) << number
        return bits


def prepare(
    scene: Scene | str | Path,
    *,
    engine: str = "auto",
    precision: int | None = None,
    field: Field | Sequence[Field] | None = None,
    view: View | None = None,
) -> Stage:
    """Load what the plan of a scene needs, and nothing else.

    Parameters
    ----------
    scene
        A scene, or its file.
    engine, precision
        As for `sdfbake.engine.choose`; not used where a field is given.
    field
        Surfaces to take in place of the scene's grids, such as exact shapes, one for each asset.
    view
        Where rays come from, in place of the scene's camera.

    Raises
    ------
    BadInput
        If an asset, a part, a channel or a texture that the scene needs is missing.
    """
    scene = (scene if isinstance(scene, Scene) else load_scene(scene)).plain()
    view = view or CameraView(scene.camera.camera(scene.film.size), scene.film.supersample, scene.film.seed)
    plan, choice, members, read, known = _members(scene, field, (engine, precision), view)
    xp = choice.engine
    by_part = [materials_of(asset, member.part_names) for asset, member in zip(scene.assets, members, strict=True)]
    materials = [material for materials in by_part for material in materials]
    names = sorted({m.texture for m in materials if isinstance(m, Diffuse) and m.texture is not None})
    looked_at = set(plan.outputs) & {"rgb", *IN_TEXELS}
    samplers, levels = {}, []
    for name in names if looked_at else ():
        samplers[name], found = _sampler(xp, scene.texture(name), partial(levels_of, scene, plan, view, known))
        levels += found
    plan = with_levels(plan, levels)
    around, lighting = _light(xp, scene, plan)
    return Stage(
        scene=scene,
        plan=plan,
        view=view,
        choice=choice,
        field=members[0] if len(members) == 1 else Assembly(members),
        members=tuple(members),
        palette=Palette.of(xp, materials, list(samplers)),
        samplers=samplers,
        around=around,
        lighting=lighting,
        bodies=_glass(xp, scene, by_part),
        read=read,
    )


Read = tuple[tuple[str, Reading], ...]


def _members(
    scene: Scene, given: Field | Sequence[Field] | None, engine: tuple[str, int | None], view: View
) -> tuple[Plan, Choice, list[Field], Read, Sequence[Ground] | None]:
    """Return the plan, the engine, the surfaces, how much of every grid was read, and what bounds footprints there."""
    if given is not None:
        fields = list(given) if isinstance(given, Sequence) else [given]
        if len(scene.assets) != len(fields):
            raise BadInput(f"the scene has {len(scene.assets)} assets, and {len(fields)} surfaces are given for them")
        plan = make_plan(scene, tuple((field.uv_mode,) if field.uv_mode else () for field in fields))
        for field in fields if plan.uv else ():  # an assembly asks all that have texture coordinates
            field.prepare_uv()
        placed = [_placed(field, asset) for field, asset in zip(fields, scene.assets, strict=True)]
        return plan, Choice(fields[0].engine, "that of the given surface"), placed, (), None
    plan, choice = make_plan(scene), choose(*engine)
    # A missing file is named before another is read.
    heads = {grid: head(grid) for grid in dict.fromkeys(asset.grid for asset in plan.assets)}
    told = [heads[asset.grid] for asset in plan.assets]
    members: dict[int, Field] = {}
    read = []
    for share in shares(scene, plan, view, [lattice for lattice, _ in told]):
        fields, reading = _load(scene, share, heads[share.needs.grid], choice)
        read.append((share.needs.grid, reading))
        members |= zip(share.places, fields, strict=True)
    grids = {place: field.grid for place, field in members.items() if isinstance(field, GridField)}
    known = grounds(scene, plan, view, told, lambda place: grids[place].bricks if place in grids else None)
    placed = [_placed(members[place], asset) for place, asset in enumerate(scene.assets)]
    return plan, choice, placed, tuple(read), known


def _load(scene: Scene, share: Share, told: tuple[Lattice, Metadata], choice: Choice) -> tuple[list[Field], Reading]:
    """Load a grid for all its places: one field, and where nothing of it is in sight, none."""
    (lattice, metadata), needs = told, share.needs
    met = share.met(lattice)
    unseen = Unseen(lattice, metadata, choice.engine, needs.uv_mode)
    if not any(met):
        return [unseen for _ in met], nothing_read(needs.grid)
    fields, readings = [], []
    for level in share.levels:
        wanted = None if share.is_whole(metadata) else partial(_wanted, share, level)
        grid, reading = load_counted(needs.grid, set(needs.channels), wanted, level)
        fields.append(GridField(grid, kernel(scene.trace.kernel, scene.trace.tension), choice, uv_mode=needs.uv_mode))
        readings.append(reading)
    field = fields[0] if len(fields) == 1 else LeveledField(fields)
    if needs.uv_mode is not None:
        field.prepare_uv()
    return [field if here else unseen for here in met], together(readings)


def _wanted(share: Share, level: int, _: Lattice, bricks: Bricks) -> Bool[np.ndarray, " k"]:
    return share.wanted(bricks, level)


def _placed(field: Field, asset: Asset) -> Field:
    placed = asset.placed()
    return field if placed.is_identity else Instance(field, placed)


def _sampler(
    xp: Engine, texture: Texture, levels: Callable[[ImageTexture, tuple[int, int]], Levels]
) -> tuple[Lookup, list[Levels]]:
    """Return a texture, and which of its levels it keeps, if it has some and they matter."""
    if isinstance(texture, CheckerTexture):
        return Checker(texture.colours, texture.squares), []
    assert isinstance(texture, ImageTexture)  # those of one colour are in the materials by now
    image = Image.load(texture.image)
    known = [levels(texture, image.size)] if needs_footprint(texture) else []
    first = known[0].first if known else 0
    return Sampler(xp, image, texture.filter, texture.wrap, texture.anisotropy, first=first), known


def _light(xp: Engine, scene: Scene, plan: Plan) -> tuple[Environment | None, Lighting | None]:
    if "rgb" not in plan.outputs:
        return None, None
    around = scene.environment
    if around is None:
        return None, Lighting(scene.lights, None, 1.0) if plan.lit else None
    image = read_picture(around.image)
    try:
        seen = Environment(xp, image, around.filter)
    except BadInput as error:
        raise BadInput(f"{around.image}: {error}") from None
    if not plan.lit:
        return seen, None
    return seen, Lighting(scene.lights, Environment(xp, irradiance(image), "bilinear"), around.intensity)


def _bodies(scene: Scene) -> list[int]:
    """Number the assets that are of glass, -1 for the others."""
    numbers, count = [], 0
    for asset in scene.assets:
        glass = any(isinstance(material, Glass) for material in asset.materials)
        numbers.append(count if glass else -1)
        count += int(glass)
    return numbers


def _glass(xp: Engine, scene: Scene, by_part: Sequence[Sequence[Material]]) -> Bodies | None:
    """Return the bodies of glass where there are several."""
    numbers = _bodies(scene)
    if max(numbers) < 1:
        return None
    if max(numbers) >= 31:
        raise BadInput(f"the scene has {max(numbers) + 1} assets of glass: a path tells 31 apart, use fewer")
    indices = []
    for number, asset in zip(numbers, scene.assets, strict=True):
        found = {material.index for material in asset.materials if isinstance(material, Glass)}
        if len(found) > 1:
            said = " and ".join(f"{index:g}" for index in sorted(found))
            raise BadInput(f"{asset.grid} is of glass of index {said}: among several bodies of glass each needs one")
        if number >= 0:
            indices.append(found.pop())
    of_part = [
        number if isinstance(material, Glass) else -1
        for number, materials in zip(numbers, by_part, strict=True)
        for material in materials
    ]
    return Bodies.of(xp, of_part, indices)


def _inside(field: Field, points: np.ndarray) -> np.ndarray:
    """Return which points are inside a field's surface."""

    def program(xp: Engine, *p: Array) -> dict[str, Array]:
        return {"inside": xp.integer(field.inside(xp, (p[0], p[1], p[2]), xp.full(p[0], True)))}

    return np.asarray(field.engine.run(program, list((points - field.anchor).T))["inside"] > 0)
