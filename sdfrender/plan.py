"""What a scene needs, and what is left out.

In: a scene with its outputs, and what its grids say of themselves. Out: a frozen `Plan`: per hit of a path the order of
the jet, whether differentials are carried, which channels of which asset are read. The render loop builds only what the
plan names; nothing is switched off inside it.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from sdfbake.gridfile import describe
from sdfbake.metadata import MODES
from sdfrender.materials import Diffuse, Glass, Mirror, Normals, needs_footprint
from sdfrender.scene import Asset, Scene
from sdfrender.uvmode import AUTO, BY_NORMAL, CHANNELS, choose_mode

FUSED = 2  # hits: the last of a longer path is treated like those before, so that one program serves them all
IN_TEXELS = frozenset({"lod", "lod_invariant", "ellipse"})
FOOTPRINT_OUTPUTS = IN_TEXELS | {"duv_dx", "duv_dy", "nonlinearity"}
UV_OUTPUTS = FOOTPRINT_OUTPUTS | {"uv", "chart"}
PATH_OUTPUTS = UV_OUTPUTS | {"rgb", "flags"}  # those that look beyond the first hit


@dataclass(frozen=True, slots=True)
class Omission:
    """Something a renderer can do that this picture does not need, and why."""

    what: str
    reason: str


@dataclass(frozen=True, slots=True)
class AssetPlan:
    """What is read of an asset: its file, its channels, and how it knows texture coordinates (None: not asked)."""

    grid: str
    channels: tuple[str, ...]
    uv_mode: str | None


@dataclass(frozen=True, slots=True)
class Plan:
    """What is computed.

    Attributes
    ----------
    outputs
        What is recorded.
    orders
        For the first, second, ... hit of a path the order of the jet: None for no jet at all, 1 for the gradient, 2
        for the Hessian too. As many hits as entries are followed.
    differentials
        Whether ray differentials are carried.
    footprints
        Whether they are brought to surfaces where paths end; if not, only what surrounds the scene asks for them.
    uv
        Whether texture coordinates are looked up.
    parts
        Whether the part of a hit matters.
    splits
        At how many surfaces of glass both ways are followed; 0 where none is.
    lit
        Whether matt surfaces ask lights.
    assets
        What is read of each asset of the scene.
    left_out
        What is not computed, with reasons.
    """

    outputs: tuple[str, ...]
    orders: tuple[int | None, ...]
    differentials: bool
    footprints: bool
    uv: bool
    parts: bool
    splits: int
    lit: bool
    assets: tuple[AssetPlan, ...]
    left_out: tuple[Omission, ...]

    def record(self) -> dict[str, Any]:
        """Return the plan as plain data."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class _Facts:
    """What a scene has, as far as its outputs care."""

    coloured: bool
    mirrors: bool
    glass: bool
    textured: bool
    filtered: bool
    surrounded: bool
    lit: bool


def make_plan(scene: Scene, stored: Sequence[tuple[str, ...]] | None = None) -> Plan:
    """Derive the plan of a scene.

    Parameters
    ----------
    scene
        The scene.
    stored
        How the surfaces know texture coordinates, one for each asset, where they are not the scene's grids. By default
        the grids' files are asked, if any are needed; one that does not exist yet is taken to have whatever is wished
        for.

    Raises
    ------
    BadInput
        If a grid has no such texture coordinates as the scene needs.
    """
    scene = scene.plain()
    facts = _facts(scene)
    outputs: set[str] = set(scene.film.outputs)
    parts = "part" in outputs or any(_by_part(asset) for asset in scene.assets) or len(scene.assets) > 1
    given: Sequence[tuple[str, ...] | None] = stored or [None] * len(scene.assets)
    reads = [_asset_plan(scene, asset, facts, has) for asset, has in zip(scene.assets, given, strict=True)]
    assets = tuple(read for read, _ in reads)
    uv = any(asset.uv_mode is not None for asset in assets)
    footprints = facts.filtered or bool(outputs & (FOOTPRINT_OUTPUTS | {"flags"}))
    by_normal = any(asset.uv_mode in BY_NORMAL for asset in assets)
    shown = facts.coloured and (facts.lit or any(isinstance(material, Normals) for material in scene.materials))
    hits = 1 + (scene.bounces if (facts.mirrors or facts.glass) and outputs & PATH_OUTPUTS else 0)
    differentials = footprints or (facts.surrounded and facts.coloured)
    orders = tuple(
        max(2 if differentials else 1, _first(hit, outputs))
        if hit < hits - 1 or hits > FUSED
        else max(int(footprints or by_normal or shown), _first(hit, outputs)) or None
        for hit in range(hits)
    )
    plan = Plan(
        outputs=scene.film.outputs,
        orders=orders,
        differentials=differentials,
        footprints=footprints,
        uv=uv,
        parts=parts,
        splits=min(scene.trace.splits, hits - 1) if facts.glass and facts.coloured else 0,
        lit=facts.lit and facts.coloured,
        assets=assets,
        left_out=(),
    )
    unread = tuple(dict.fromkeys(omission for _, omissions in reads for omission in omissions))
    return _with_omissions(plan, scene, facts, unread)


def _facts(scene: Scene) -> _Facts:
    coloured = "rgb" in scene.film.outputs
    materials = scene.materials
    used = [scene.texture(m.texture) for m in materials if isinstance(m, Diffuse) and m.texture is not None]
    around = scene.environment
    matt = any(isinstance(material, Diffuse) for material in materials)
    return _Facts(
        coloured=coloured,
        mirrors=any(isinstance(material, Mirror) for material in materials),
        glass=any(isinstance(material, Glass) for material in materials),
        textured=coloured and bool(used),
        filtered=coloured and any(needs_footprint(texture) for texture in used),
        surrounded=around is not None and around.filter == "anisotropic",
        lit=matt and (bool(scene.lights) or around is not None),
    )


def _first(hit: int, outputs: set[str]) -> int:
    """Order of the jet that the outputs of the first hit ask for."""
    if hit > 0:
        return 0
    return 2 if "curvature" in outputs else int("N" in outputs)


def _by_part(asset: Asset) -> bool:
    return len(asset.materials) > 1 or asset.materials[0].part != "*"


def _asset_plan(
    scene: Scene, asset: Asset, facts: _Facts, stored: tuple[str, ...] | None
) -> tuple[AssetPlan, tuple[Omission, ...]]:
    """Return what is read of an asset, and which of its texture coordinates are not."""
    outputs: set[str] = set(scene.film.outputs)
    ends = any(not isinstance(material, Mirror | Glass) for material in asset.materials)
    textured = facts.coloured and any(isinstance(m, Diffuse) and m.texture is not None for m in asset.materials)
    needed = textured or (ends and bool(outputs & UV_OUTPUTS))
    mode: str | None = None
    others: tuple[str, ...] = ()
    if needed or (ends and "flags" in outputs and _stored(asset, stored)):
        mode = choose_mode(_stored(asset, stored), asset.uv if stored is None else AUTO, _source(asset, stored))
        others = tuple(m for m in MODES if m != mode and asset.grid.is_file() and m in _stored(asset, stored))
    parts = "part" in outputs or _by_part(asset)
    channels = ("distance", *(CHANNELS[mode] if mode else ()), *(["part"] if parts else []))
    why = "the most exact that the grid has" if asset.uv == AUTO else "as the scene asks"
    unread = tuple(Omission(f"texture coordinates as {other}", f"they are read as {mode}, {why}") for other in others)
    return AssetPlan(str(asset.grid), channels, mode), unread


def _stored(asset: Asset, stored: tuple[str, ...] | None) -> tuple[str, ...]:
    """Return the representations of texture coordinates that there are."""
    if stored is not None:
        return stored
    return tuple(describe(asset.grid).uv_modes) if asset.grid.is_file() else MODES


def _source(asset: Asset, stored: tuple[str, ...] | None) -> str:
    return str(asset.grid) if stored is None else "the surface"


def _with_omissions(plan: Plan, scene: Scene, facts: _Facts, unread: tuple[Omission, ...]) -> Plan:
    left_out = []
    onward = facts.mirrors or facts.glass
    nothing_on = "there is no mirror" + ("" if facts.glass else " and no glass")
    if not plan.uv:
        left_out.append(Omission("texture coordinates", "no material is textured and no output shows them"))
    if not plan.differentials:
        reason = "nothing is filtered by a footprint" if plan.uv else "there are no texture coordinates to filter"
        left_out.append(Omission("ray differentials", f"{reason} and no output shows one"))
    if 2 not in plan.orders:
        reason = "no differentials go on from a mirror or through glass" if onward else nothing_on
        left_out.append(Omission("Hessians", reason))
    if all(order is None for order in plan.orders):
        left_out.append(Omission("gradients", "no material and no output depends on a normal"))
    if len(plan.orders) == 1 and scene.bounces:
        reason = "no output looks beyond the first hit" if onward else nothing_on
        left_out.append(Omission("bounces", reason))
    if not facts.glass:
        left_out.append(Omission("refraction", "no material is glass"))
    elif not plan.splits and scene.trace.splits:
        reason = "no colour is asked for" if not facts.coloured else "no bounces are allowed"
        left_out.append(Omission("both ways at glass", reason))
    if not plan.lit:
        reason = "no matt surface is lit" if scene.lights or scene.environment else "there are no lights"
        left_out.append(Omission("lights and shadows", reason if facts.coloured else "no colour is asked for"))
    if not plan.parts:
        left_out.append(Omission("parts", "one material serves all"))
    return replace(plan, left_out=(*left_out, *unread))
