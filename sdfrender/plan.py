"""What a scene needs, and what is left out.

In: a scene with its outputs, and what its grids say of themselves. Out: a frozen `Plan`: per hit of a path the order of
the jet, whether differentials are carried, which channels of which asset are read. The render loop builds only what the
plan names; nothing is switched off inside it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

from sdfbake.complaint import BadInput
from sdfrender.facts import FOOTPRINT_OUTPUTS, PATH_OUTPUTS, UV_OUTPUTS, Facts, by_part, used
from sdfrender.materials import Diffuse, Glass, Mirror
from sdfrender.offer import Offer
from sdfrender.omissions import survey
from sdfrender.planned import FUSED, AssetPlan, Plan
from sdfrender.scene import Asset, Output, Scene
from sdfrender.uvmode import AUTO, BY_NORMAL, CHANNELS, choose_mode


def make_plan(scene: Scene, stored: Sequence[tuple[str, ...]] | None = None, *, unbaked: bool = False) -> Plan:
    """Derive the plan of a scene.

    Parameters
    ----------
    scene
        The scene.
    stored
        How the surfaces know texture coordinates, one for each asset, where they are not the scene's grids. By default
        the heads of the grids' files are asked; one that does not exist yet is taken to have whatever is wished for.
    unbaked
        Ask no file: take all grids for such.

    Raises
    ------
    BadInput
        If a grid does not have what the scene needs: texture coordinates, parts, a band as wide as its kernel reads.
    """
    scene = scene.plain()
    if stored is not None:
        offers = [Offer(modes) for modes in stored]
    else:
        grids = [] if unbaked else dict.fromkeys(asset.grid for asset in scene.assets)
        asked = {grid: Offer.of(grid) for grid in grids}
        offers = [asked.get(asset.grid, Offer()) for asset in scene.assets]
    bare = used(scene, [offer.parts for offer in offers])
    facts = Facts.of(bare)
    _require_derivatives(scene, facts)
    reads = tuple(_asset_plan(bare, place, facts, offer, stored is None) for place, offer in enumerate(offers))
    for asset, read, offer in zip(bare.assets, reads, offers, strict=True):
        if "part" in read.channels:
            offer.require_parts(asset)
        if "flags" not in facts.outputs:  # these say at which hits it matters
            offer.require_band(asset, scene.trace.kernel)
    plan = _planned(bare, facts, reads, offers)
    return replace(plan, capabilities=survey(scene, bare, plan, offers))


def _planned(scene: Scene, facts: Facts, assets: tuple[AssetPlan, ...], offers: Sequence[Offer]) -> Plan:
    outputs = facts.outputs
    divided = any(by_part(asset, offer.parts) for asset, offer in zip(scene.assets, offers, strict=True))
    footprints = facts.filtered or bool(outputs & (FOOTPRINT_OUTPUTS | {"flags"}))
    by_normal = any(asset.uv_mode in BY_NORMAL for asset in assets)
    shown = facts.coloured and (facts.lit or facts.normals)
    hits = 1 + (scene.bounces if facts.onward else 0)
    choosing = any(asset.levels for asset in assets)
    differentials = footprints or choosing or (facts.surrounded and facts.coloured)
    orders = tuple(
        max(2 if differentials else 1, _first(hit, outputs))
        if hit < hits - 1 or hits > FUSED
        else max(int(footprints or by_normal or shown), _first(hit, outputs)) or None
        for hit in range(hits)
    )
    return Plan(
        outputs=scene.film.outputs,
        orders=orders,
        differentials=differentials,
        footprints=footprints,
        uv=any(asset.uv_mode is not None for asset in assets),
        parts="part" in outputs or (bool(outputs & PATH_OUTPUTS) and (divided or len(assets) > 1)),
        splits=min(scene.trace.splits, hits - 1) if facts.glass and facts.coloured else 0,
        lit=facts.lit and facts.coloured,
        assets=assets,
    )


def forced_plan(scene: Scene, plan: Plan, modes: Sequence[Sequence[str]]) -> Plan:
    """Return the plan of the same picture with everything on: what a renderer would do that knows no plans.

    All outputs, Hessians at every hit that mirrors and glass allow, differentials and footprints, parts, lights,
    colours; texture coordinates by the representation of the plan, or the most exact that there is.

    Parameters
    ----------
    scene, plan
        The scene and its plan.
    modes
        How the grid of every asset knows texture coordinates.
    """
    facts = Facts.of(scene)
    hits = 1 + (scene.bounces if facts.mirrors or facts.glass else 0)
    assets = tuple(
        replace(asset, uv_mode=asset.uv_mode or next(iter(known), None), in_sight=False)
        for asset, known in zip(plan.assets, modes, strict=True)
    )
    return Plan(
        outputs=get_args(Output),
        orders=(2,) * hits,
        differentials=True,
        footprints=True,
        uv=any(asset.uv_mode for asset in assets),
        parts=True,
        splits=min(scene.trace.splits, hits - 1) if facts.glass else 0,
        lit=facts.lit,
        assets=assets,
    )


def _goes_on(scene: Scene, facts: Facts) -> bool:
    """Say whether rays leave from first hits: to the next surface, or to a light that something may hide."""
    shadows = facts.lit and facts.coloured and any(light.shadows for light in scene.lights)
    return shadows or (facts.onward and scene.bounces > 0)


def _first(hit: int, outputs: frozenset[str]) -> int:
    """Order of the jet that the outputs of the first hit ask for."""
    if hit > 0:
        return 0
    return 2 if "curvature" in outputs else int("N" in outputs)


def _require_derivatives(scene: Scene, facts: Facts) -> None:
    """Complain if an output needs derivatives that the kernel does not have."""
    if "curvature" in facts.outputs and scene.trace.kernel == "linear":
        grids = ", ".join(dict.fromkeys(asset.grid.name for asset in scene.assets))
        raise BadInput(
            f"the output curvature needs second derivatives, and {grids} interpolated by the kernel linear has none: "
            "use bspline or catmull-rom (any grid serves them: no bake is needed)"
        )


def _asset_plan(scene: Scene, place: int, facts: Facts, offer: Offer, of_file: bool) -> AssetPlan:
    """Return what is read of an asset."""
    asset, outputs = scene.assets[place], facts.outputs
    mode: str | None = None
    if uv_required(asset, facts) or (ends_on(asset) and "flags" in outputs and offer.uv_modes):
        source = str(asset.grid) if of_file else "the surface"
        mode = choose_mode(offer.uv_modes, asset.uv if of_file else AUTO, source, offer.bake)
    told = "part" in outputs or (bool(outputs & PATH_OUTPUTS) and by_part(asset, offer.parts))
    channels = ("distance", *(CHANNELS[mode] if mode else ()), *(["part"] if told else []))
    levels = offer.levels if scene.trace.levels == "footprint" else 0
    return AssetPlan(str(asset.grid), channels, mode, in_sight=not _goes_on(scene, facts), levels=levels)


def uv_required(asset: Asset, facts: Facts) -> bool:
    """Say whether a picture cannot be made without an asset's texture coordinates."""
    textured = facts.coloured and any(isinstance(m, Diffuse) and m.texture is not None for m in asset.materials)
    return textured or (ends_on(asset) and bool(facts.outputs & UV_OUTPUTS))


def ends_on(asset: Asset) -> bool:
    """Say whether paths end on an asset."""
    return any(not isinstance(material, Mirror | Glass) for material in asset.materials)
