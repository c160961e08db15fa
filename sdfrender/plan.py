"""What a scene needs, and what is left out.

In: a scene with its outputs, and what its grid says of itself. Out: a frozen `Plan`: per hit of a path the order of
the jet, whether differentials are carried, which channels of the asset are read. The render loop builds only what the
plan names; nothing is switched off inside it.
"""

from dataclasses import asdict, dataclass
from typing import Any

from sdfbake.gridfile import describe
from sdfbake.metadata import MODES
from sdfrender.scene import Diffuse, Mirror, Normals, Scene
from sdfrender.uvmode import AUTO, BY_NORMAL, CHANNELS, choose_mode

FOOTPRINT_OUTPUTS = frozenset({"duv_dx", "duv_dy", "lod"})


@dataclass(frozen=True, slots=True)
class Omission:
    """Something a renderer can do that this picture does not need, and why."""

    what: str
    reason: str


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
    uv
        Whether texture coordinates are looked up.
    uv_mode
        How those are known, see `sdfrender.uvmode`; None where none are looked up.
    parts
        Whether the part of a hit matters.
    channels
        Channels of the asset that are read.
    left_out
        What is not computed, with reasons.
    """

    outputs: tuple[str, ...]
    orders: tuple[int | None, ...]
    differentials: bool
    uv: bool
    uv_mode: str | None
    parts: bool
    channels: tuple[str, ...]
    left_out: tuple[Omission, ...]

    def record(self) -> dict[str, Any]:
        """Return the plan as plain data."""
        return asdict(self)


def make_plan(scene: Scene, stored: tuple[str, ...] | None = None) -> Plan:
    """Derive the plan of a scene.

    Parameters
    ----------
    scene
        The scene.
    stored
        How the surface knows texture coordinates, where it is not the scene's grid. By default the grid's file is
        asked, if any are needed; one that does not exist yet is taken to have whatever is wished for.

    Raises
    ------
    BadInput
        If the grid has no such texture coordinates as the scene needs.
    """
    outputs: set[str] = set(scene.film.outputs)
    materials = scene.assets[0].materials
    coloured = "rgb" in outputs
    mirrors = any(isinstance(material, Mirror) for material in materials)
    used = [scene.texture(m.texture) for m in materials if isinstance(m, Diffuse) and m.texture is not None]
    textured = coloured and bool(used)
    filtered = textured and any(texture.filter == "trilinear" for texture in used)
    differentials = filtered or bool(outputs & (FOOTPRINT_OUTPUTS | {"flags"}))
    uv = textured or bool(outputs & (FOOTPRINT_OUTPUTS | {"uv", "flags"}))
    beyond_first = coloured or bool(outputs & (FOOTPRINT_OUTPUTS | {"uv", "flags"}))
    hits = 1 + (scene.trace.bounces if mirrors and beyond_first else 0)
    parts = len(materials) > 1 or materials[0].part != "*" or "part" in outputs
    mode, others = _uv_mode(scene, stored) if uv else (None, ())
    normals = mode in BY_NORMAL or (coloured and any(isinstance(material, Normals) for material in materials))
    orders = tuple(_order(hit, hits, differentials, normals, outputs) for hit in range(hits))
    channels = ["distance", *(CHANNELS[mode] if mode else ()), *(["part"] if parts else [])]
    unread = tuple(
        Omission(f"texture coordinates as {other}", f"they are read as {mode}, {_why(scene)}") for other in others
    )
    omissions = _omissions(scene, differentials, uv, parts, orders, mirrors)
    return Plan(scene.film.outputs, orders, differentials, uv, mode, parts, tuple(channels), omissions + unread)


def _uv_mode(scene: Scene, stored: tuple[str, ...] | None) -> tuple[str, tuple[str, ...]]:
    """Return the representation that is read, and those of the grid that are not."""
    if stored is not None:
        return choose_mode(stored, AUTO, "the surface"), ()
    asset = scene.assets[0]
    stored = describe(asset.grid).uv_modes if asset.grid.is_file() else MODES
    mode = choose_mode(stored, asset.uv, str(asset.grid))
    return mode, tuple(other for other in MODES if other in stored and other != mode and asset.grid.is_file())


def _why(scene: Scene) -> str:
    return "the most exact that the grid has" if scene.assets[0].uv == AUTO else "as the scene asks"


def _order(hit: int, hits: int, differentials: bool, normals: bool, outputs: set[str]) -> int | None:
    """Order of the jet at a hit: the Hessian only where differentials go on from a mirror."""
    if hit < hits - 1:
        return 2 if differentials else 1
    return 1 if differentials or normals or (hit == 0 and "N" in outputs) else None


def _omissions(
    scene: Scene, differentials: bool, uv: bool, parts: bool, orders: tuple[int | None, ...], mirrors: bool
) -> tuple[Omission, ...]:
    left_out = []
    if not uv:
        left_out.append(Omission("texture coordinates", "no material is textured and no output shows them"))
    if not differentials:
        reason = "nothing is filtered by a footprint" if uv else "there are no texture coordinates to filter"
        left_out.append(Omission("ray differentials", f"{reason} and no output shows one"))
    if 2 not in orders:
        reason = "no differentials go on from a mirror" if mirrors else "there is no mirror"
        left_out.append(Omission("Hessians", reason))
    if all(order is None for order in orders):
        left_out.append(Omission("gradients", "no material and no output depends on a normal"))
    if len(orders) == 1 and scene.trace.bounces:
        reason = "no output looks beyond the first hit" if mirrors else "there is no mirror"
        left_out.append(Omission("bounces", reason))
    if not parts:
        left_out.append(Omission("parts", "one material serves all"))
    return tuple(left_out)
