"""Every capability of the renderer: needed by a picture, or left out, and why.

In: a scene, its plan, what its grids have to offer. Out: `Capability` records in the order of the data: what is read,
what is done at hits, what makes the light. Bytes are those of arrays and pictures in files that stay unread.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from sdfbake.gridfile import stored_bytes
from sdfbake.metadata import MODES
from sdfrender import costs
from sdfrender.costs import FREE, Cost
from sdfrender.facts import IN_TEXELS, NO_COLOUR, PATH_OUTPUTS, Facts, textures_of
from sdfrender.levelreach import SHARE
from sdfrender.materials import CheckerTexture, ConstantTexture, ImageTexture, Texture, needs_footprint
from sdfrender.offer import Offer
from sdfrender.planned import Capability, Levels, Plan, Saving
from sdfrender.scene import Scene
from sdfrender.uvmode import AUTO, CHANNELS

# Arrays of a file that a channel is made of.
_ARRAYS = {"face": ("face", "surface")}


def survey(scene: Scene, bare: Scene, plan: Plan, offers: Sequence[Offer]) -> tuple[Capability, ...]:
    """Account for every capability.

    Parameters
    ----------
    scene, bare
        The scene, and what of it some part is made of.
    plan
        What is done.
    offers
        What the grids have.
    """
    facts, planned = Facts.of(bare), tracing(bare, plan)
    return (
        *_hits(scene, plan, facts, planned),
        *_glass(scene, plan, facts),
        *_coordinates(scene, plan, offers, planned),
        _parts(plan, planned, offers),
        *_unread(scene, plan),
        _levels(scene, plan, offers),
        *_textures(scene, bare, facts),
        *_materials(scene, bare),
        *_light(scene, plan, facts, planned),
        _samples(scene, facts),
    )


def tracing(scene: Scene, plan: Plan) -> Cost:
    """Return what a path takes that meets something at every turn.

    Parameters
    ----------
    scene
        What of it some part is made of.
    plan
        What is done.
    """
    filters = [_filter(scene.texture(name)) for name in textures_of(scene)]
    coloured = "rgb" in plan.outputs
    dearest = max(filters, key=lambda cost: cost.numpy, default=FREE) if coloured and plan.uv else FREE
    return costs.of_plan(plan, costs.total(*_lights(scene)) if plan.lit else FREE, dearest)


def with_levels(plan: Plan, levels: Sequence[Levels]) -> Plan:
    """Return the plan with the mip levels that footprints can reach, and say them."""
    named = {f"texture '{known.texture}'": known for known in levels}

    def told(row: Capability) -> Capability:
        known = named.get(row.what)
        if known is None or known.reason == NO_COLOUR:
            return row
        if known.first == 0:
            return replace(row, how=f"all mip levels, 0 to {known.last}", reason=known.reason)
        return replace(row, how=f"mip levels {known.first} to {known.last} of 0 to {known.last}", reason=known.reason)

    return replace(plan, levels=tuple(levels), capabilities=tuple(told(row) for row in plan.capabilities))


def _left_out(what: str, reason: str, size: int = 0, saving: Saving | None = None) -> Capability:
    return Capability(what, False, "", reason, size, saving)


def _done(what: str, how: str, reason: str, size: int = 0) -> Capability:
    return Capability(what, True, how, reason, size)


def _hits(scene: Scene, plan: Plan, facts: Facts, planned: Cost) -> Iterator[Capability]:
    """What is found at hits, and how many there are."""
    orders, on = plan.orders, facts.mirrors or facts.glass
    nothing_on = "there is no mirror" + ("" if facts.glass else " and no glass")
    yield _done("first hits", "certified", "every output speaks of them")
    some, all_ = [k + 1 for k, order in enumerate(orders) if order], len(orders)
    if some:
        yield _done("gradients", _at(some, all_), "a normal is seen, bends a ray or carries a footprint")
    else:
        saved = costs.saving(costs.GRADIENT.times(all_), planned)
        yield _left_out("gradients", "no material and no output depends on a normal", saving=saved)
    bent = [k + 1 for k, order in enumerate(orders) if order == 2]
    if bent:
        why = "the output curvature" if bent == [1] and "curvature" in facts.outputs else "differentials go on from it"
        yield _done("Hessians", _at(bent, all_), why)
    else:
        reason = "no differentials go on from a mirror or through glass" if on else nothing_on
        missing = costs.total(*(costs.total(costs.HESSIAN, FREE if order else costs.GRADIENT) for order in orders))
        yield _left_out("Hessians", reason, saving=costs.saving(missing, planned))
    if plan.differentials:
        end = f"to hit {all_}" if plan.footprints or plan.grid_levels else "to what surrounds the scene"
        chosen = ", or a grid's level chosen by one" if plan.grid_levels else ""
        yield _done("ray differentials", end, f"something is filtered by a footprint, or an output shows one{chosen}")
    else:
        what = "nothing is filtered by a footprint" if plan.uv else "there are no texture coordinates to filter"
        saved = costs.saving(costs.DIFFERENTIALS.times(all_), planned)
        yield _left_out("ray differentials", f"{what} and no output shows one", saving=saved)
    if plan.footprints:
        yield _done("footprints", "where paths end", "a texture is filtered by them, or an output speaks of them")
    else:
        yield _left_out("footprints", "no texture and no output asks for them where paths end")
    if len(orders) > 1:
        yield _done("bounces", f"{len(orders) - 1}", "mirrors or glass are looked into")
    elif scene.bounces and on:
        further = costs.total(costs.MARCH, costs.GRADIENT).times(scene.bounces)
        saved = costs.saving(further, planned)
        yield _left_out("bounces", "no output looks beyond the first hit", saving=saved)
    else:
        yield _left_out("bounces", "none are allowed" if on else nothing_on)


def _at(hits: Sequence[int], count: int) -> str:
    return "at every hit" if len(hits) == count else "at hit " + ", ".join(map(str, hits))


def _glass(scene: Scene, plan: Plan, facts: Facts) -> Iterator[Capability]:
    if not facts.glass:
        yield _left_out("refraction", "no material is glass")
    elif len(plan.orders) == 1:
        yield _left_out("refraction", "no bounces" if facts.onward else "no output looks beyond the first hit")
    else:
        yield _done("refraction", "and total reflection", "a material is glass")
    if plan.splits:
        yield _done("both ways at glass", f"{2**plan.splits} paths", f"at the first {plan.splits} surfaces of a path")
    elif facts.glass:
        reason = "no bounces are allowed" if facts.coloured and not scene.bounces else "'splits' is 0"
        yield _left_out("both ways at glass", reason if facts.coloured else NO_COLOUR)


def _coordinates(scene: Scene, plan: Plan, offers: Sequence[Offer], planned: Cost) -> Iterator[Capability]:
    """Texture coordinates, by each representation that some grid has."""
    if not plan.uv:
        had = [mode for offer in offers if offer.bake for mode in offer.uv_modes]
        cheapest = min((costs.UV[mode] for mode in had), key=lambda cost: cost.numpy, default=FREE)
        reason, size = "no material is textured and no output shows them", _size_of_modes(plan, MODES)
        yield _left_out("texture coordinates", reason, size, costs.saving(cheapest, planned))
        return
    read = {asset.uv_mode for asset in plan.assets}
    for mode in MODES:
        size = _size_of_modes(plan, [mode])
        if mode in read:
            users = [asset.grid for asset in plan.assets if asset.uv_mode == mode]
            wished = any(asset.uv != AUTO for asset in scene.assets if str(asset.grid) in users)
            why = "as the scene asks" if wished else "the most exact that the grid has"
            yield _done(f"texture coordinates as {mode}", f"{len(users)} of {len(plan.assets)} assets", why, size)
        elif any(offer.bake and mode in offer.uv_modes for offer in offers):
            yield _left_out(f"texture coordinates as {mode}", _instead(scene, plan, offers, mode), size)


def _instead(scene: Scene, plan: Plan, offers: Sequence[Offer], mode: str) -> str:
    """Say why coordinates are not read as some grid has them."""
    having = [k for k, offer in enumerate(offers) if offer.bake and mode in offer.uv_modes]
    others = sorted({plan.assets[k].uv_mode or "" for k in having} - {""})
    if not others:
        return "no grid that has them needs any"
    asked = any(scene.assets[k].uv != AUTO for k in having)
    return f"they are read as {' and '.join(others)}, {'as the scene asks' if asked else 'the most exact there is'}"


def _parts(plan: Plan, planned: Cost, offers: Sequence[Offer]) -> Capability:
    size = _unread_size(plan, ["part"])
    if plan.parts:
        return _done("parts", "at every hit", "materials differ by part or asset, or an output shows them", size)
    several = len(plan.assets) > 1 or any(offer.parts is None or len(offer.parts) > 1 for offer in offers)
    beyond = bool(set(plan.outputs) & PATH_OUTPUTS)
    reason = "one material serves all" if beyond or not several else "no output depends on the material"
    saved = costs.saving(costs.PART.times(len(plan.orders)), planned) if several else None
    return _left_out("parts", reason, size, saved)


def _unread(scene: Scene, plan: Plan) -> Iterator[Capability]:
    """What is never read of grids: bricks that no ray meets, errors."""
    if all(asset.in_sight for asset in plan.assets):
        reason = "no ray leaves from a first hit: only those that the camera's rays can reach are read"
        yield _left_out("bricks out of sight", reason)
    else:
        yield _done("bricks out of sight", "all are read", "rays that leave a first hit may meet any")
    size = _unread_size(plan, ["error"])
    yield _left_out("error channel", "no picture shows how well a grid interpolates", size)


def _levels(scene: Scene, plan: Plan, offers: Sequence[Offer]) -> Capability:
    """Coarser levels of grids: an approximation, never chosen unasked."""
    if plan.grid_levels:
        how = f"voxels of at most {SHARE:g} of a ray's width"
        return _done("grid levels", how, "APPROXIMATE, as the scene asks: the report shows the bias")
    grids = {asset.grid for asset, offer in zip(plan.assets, offers, strict=True) if offer.bake and offer.levels}
    sizes = [size for grid in grids for name, size in stored_bytes(grid).items() if name.startswith("level")]
    none = scene.trace.levels == "footprint"
    reason = "no grid has any: bake with --levels" if none else "an approximation that the scene does not ask for"
    return _left_out("grid levels", reason, sum(sizes))


def _textures(scene: Scene, bare: Scene, facts: Facts) -> Iterator[Capability]:
    looked_at, users = bool(facts.outputs & {"rgb", *IN_TEXELS}), textures_of(bare)
    for texture in scene.textures:
        name, size = f"texture '{texture.name}'", 0
        if isinstance(texture, ImageTexture):
            size = _file_size(texture.image)
        if isinstance(texture, ConstantTexture):
            yield _done(name, "no look-up", "its colour is multiplied into the material's")
        elif texture.name not in users:
            yield _left_out(name, "no part is made of a material that has it", size)
        elif not looked_at:
            yield _left_out(name, "no output shows it", size)
        elif isinstance(texture, CheckerTexture):
            yield _done(name, "no texels", "it is filtered in closed form")
        elif not facts.coloured:
            yield _done(name, "its size alone", "footprints are asked for in its texels")
        elif needs_footprint(texture):
            yield _done(name, "mip levels", "from the first that a footprint in sight can reach")
        else:
            yield _done(name, "the finest level", f"the filter {texture.filter} reads no other")


def _materials(scene: Scene, bare: Scene) -> Iterator[Capability]:
    for asset, used in zip(scene.assets, bare.assets, strict=True):
        for material in asset.materials:
            if material not in used.materials:
                what = f"{material.type} for '{material.part}' of {asset.grid.name}"
                yield _left_out(what, "every part has a material of its own")


def _light(scene: Scene, plan: Plan, facts: Facts, planned: Cost) -> Iterator[Capability]:
    lights, shadows = _lights(scene)
    if plan.lit:
        count = len(scene.lights)
        yield _done("lights and shadows", f"{count} light{'s' * (count != 1)}", "a matt surface asks them")
    else:
        reason = "no matt surface is lit" if scene.lights or scene.environment else "there are no lights"
        saved = costs.saving(costs.total(lights, shadows), planned) if facts.lit else None
        yield _left_out("lights and shadows", reason if facts.coloured else NO_COLOUR, saving=saved)
    around = scene.environment
    if around is None:
        yield _left_out("environment", "there is none")
    elif facts.coloured:
        yield _done("environment", around.filter, "paths leave the scene")
    else:
        yield _left_out("environment", NO_COLOUR, _file_size(around.image))


def _samples(scene: Scene, facts: Facts) -> Capability:
    count = scene.film.supersample**2
    if count == 1:
        return _left_out("further samples", "one per pixel is asked for")
    if facts.coloured:
        return _done("further samples", f"{count} per pixel", "colours are averaged; all else is of one sample")
    return _left_out("further samples", NO_COLOUR, saving=Saving(count - 1.0, count - 1.0))


def _lights(scene: Scene) -> tuple[Cost, Cost]:
    """Return what lights and what their shadows take at a hit."""
    shadows = sum(light.shadows for light in scene.lights)
    return costs.LIGHT.times(len(scene.lights) + (scene.environment is not None)), costs.SHADOW.times(shadows)


def _filter(texture: Texture) -> Cost:
    return costs.FILTER["checker" if isinstance(texture, CheckerTexture) else getattr(texture, "filter", "point")]


def _size_of_modes(plan: Plan, modes: Iterable[str]) -> int:
    return _unread_size(plan, [channel for mode in modes for channel in CHANNELS[mode]])


def _unread_size(plan: Plan, channels: Iterable[str]) -> int:
    """Return the bytes of channels in the files of grids that no place of theirs reads."""
    arrays = {array: channel for channel in channels for array in _ARRAYS.get(channel, (channel,))}
    read: dict[str, set[str]] = {}
    for asset in plan.assets:
        read.setdefault(asset.grid, set()).update(asset.channels)
    return sum(
        size
        for grid, known in read.items()
        if Path(grid).is_file()
        for name, size in stored_bytes(grid).items()
        if (channel := arrays.get(name.partition(".")[0])) is not None and channel not in known
    )


def _file_size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0
