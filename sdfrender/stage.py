"""A scene made ready: what its plan names, loaded and put on an engine.

In: a scene. Out: a `Stage` that can be traced: the surface, its materials, textures, lights, and the view.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from sdfbake.complaint import BadInput
from sdfbake.engine import Array, Choice, Engine, choose
from sdfbake.gridfile import Reading, head, load_counted, nothing_read
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
from sdfrender.lighting import Lighting
from sdfrender.materials import CheckerTexture, Diffuse, Glass, ImageTexture, Material, Texture
from sdfrender.palette import Palette
from sdfrender.picture import read_picture
from sdfrender.plan import make_plan
from sdfrender.planned import AssetPlan, Plan
from sdfrender.pyramid import Texture as Image
from sdfrender.reach import Sight, frusta, needed
from sdfrender.scene import Asset, Scene, load_scene
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
        return max((2 * grid.tolerance * scale for grid, scale in inner if isinstance(grid, GridField)), default=0.0)

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
    plan, choice, members, read = _members(scene, field, (engine, precision), view)
    xp = choice.engine
    by_part = [materials_of(asset, member.part_names) for asset, member in zip(scene.assets, members, strict=True)]
    materials = [material for materials in by_part for material in materials]
    names = sorted({m.texture for m in materials if isinstance(m, Diffuse) and m.texture is not None})
    looked_at = set(plan.outputs) & {"rgb", *IN_TEXELS}
    samplers = {name: _sampler(xp, scene.texture(name)) for name in names} if looked_at else {}
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
) -> tuple[Plan, Choice, list[Field], Read]:
    if given is not None:
        fields = list(given) if isinstance(given, Sequence) else [given]
        if len(scene.assets) != len(fields):
            raise BadInput(f"the scene has {len(scene.assets)} assets, and {len(fields)} surfaces are given for them")
        plan = make_plan(scene, tuple((field.uv_mode,) if field.uv_mode else () for field in fields))
        for field in fields if plan.uv else ():  # an assembly asks all that have texture coordinates
            field.prepare_uv()
        placed = [_placed(field, asset) for field, asset in zip(fields, scene.assets, strict=True)]
        return plan, Choice(fields[0].engine, "that of the given surface"), placed, ()
    plan, choice = make_plan(scene), choose(*engine)
    # A missing file is named before another is read.
    heads = {grid: head(grid) for grid in dict.fromkeys(asset.grid for asset in plan.assets)}
    # One field serves all places of a grid, if what is read for one of them is enough for the others.
    serving = [
        max((other for other in plan.assets if _serves(other, least)), key=lambda other: len(other.channels))
        for least in plan.assets
    ]
    sights = _sights(scene, plan, view, [heads[asset.grid][0] for asset in plan.assets])
    members: list[Field | None] = [None] * len(serving)
    read = []
    for needs in dict.fromkeys(serving):
        places = [place for place, other in enumerate(serving) if other == needs]
        found, reading = _load(scene, needs, heads[needs.grid], choice, [sights[place] for place in places])
        read.append((needs.grid, reading))
        for place, field in zip(places, found, strict=True):
            members[place] = _placed(field, scene.assets[place])
    return plan, choice, [member for member in members if member is not None], tuple(read)


def _serves(other: AssetPlan, needs: AssetPlan) -> bool:
    enough = set(needs.channels) <= set(other.channels) and needs.uv_mode in (None, other.uv_mode)
    return other.grid == needs.grid and enough


def _sights(scene: Scene, plan: Plan, view: View, lattices: Sequence[Lattice]) -> list[Sight | None]:
    """Return what is seen of the grid of every asset; None for all of it."""
    around = frusta(view) if all(asset.in_sight for asset in plan.assets) else None
    if around is None:
        return [None] * len(plan.assets)
    placed = [asset.placed() for asset in scene.assets]
    boxes = np.stack([place.bounds(lattice.bounds) for place, lattice in zip(placed, lattices, strict=True)])
    size = float(np.linalg.norm(boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)))
    return [Sight.of(around, place, lattice, size) for place, lattice in zip(placed, lattices, strict=True)]


def _load(
    scene: Scene, needs: AssetPlan, told: tuple[Lattice, Metadata], choice: Choice, sights: Sequence[Sight | None]
) -> tuple[list[Field], Reading]:
    """Load a grid for all its places: one field, and where nothing of it is in sight, none."""
    seen = [sight for sight in sights if sight is not None]
    lattice, metadata = told
    met = [sight is None or sight.meets_lattice(lattice) for sight in sights]
    unseen = Unseen(lattice, metadata, choice.engine, needs.uv_mode)
    if not any(met):
        return [unseen for _ in sights], nothing_read(needs.grid)
    whole = len(seen) < len(sights) or metadata.source == "dense"  # of distances alone is known what others may be
    wanted = None if whole else lambda _, bricks: needed(seen, bricks)
    grid, reading = load_counted(needs.grid, set(needs.channels), wanted)
    field = GridField(grid, kernel(scene.trace.kernel, scene.trace.tension), choice, uv_mode=needs.uv_mode)
    if needs.uv_mode is not None:
        field.prepare_uv()
    return [field if here else unseen for here in met], reading


def _placed(field: Field, asset: Asset) -> Field:
    placed = asset.placed()
    return field if placed.is_identity else Instance(field, placed)


def _sampler(xp: Engine, texture: Texture) -> Lookup:
    if isinstance(texture, CheckerTexture):
        return Checker(texture.colours, texture.squares)
    assert isinstance(texture, ImageTexture)  # those of one colour are in the materials by now
    return Sampler(xp, Image.load(texture.image), texture.filter, texture.wrap, texture.anisotropy)


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
