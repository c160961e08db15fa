"""What a scene has, as far as its outputs care.

In: a scene, and the parts of its grids where they are known. Out: `Facts`, and the scene without what no part is made
of.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from sdfbake.complaint import BadInput
from sdfrender.materials import Diffuse, Glass, Material, Mirror, Normals, needs_footprint
from sdfrender.scene import Asset, Scene

IN_TEXELS = frozenset({"lod", "lod_invariant", "ellipse"})
FOOTPRINT_OUTPUTS = IN_TEXELS | {"duv_dx", "duv_dy", "nonlinearity"}
UV_OUTPUTS = FOOTPRINT_OUTPUTS | {"uv", "chart"}
NO_COLOUR = "no colour is asked for"
PATH_OUTPUTS = UV_OUTPUTS | {"rgb", "flags"}  # those that look beyond the first hit


@dataclass(frozen=True, slots=True)
class Facts:
    """What a scene has.

    Attributes
    ----------
    outputs
        What is recorded.
    coloured
        Whether colours are.
    mirrors, glass, normals
        Whether a part is made of them.
    filtered
        Whether a texture whose colour is seen depends on footprints.
    surrounded
        Whether what surrounds the scene does.
    lit
        Whether there are matt parts and something that lights them.
    """

    outputs: frozenset[str]
    coloured: bool
    mirrors: bool
    glass: bool
    normals: bool
    filtered: bool
    surrounded: bool
    lit: bool

    @staticmethod
    def of(scene: Scene) -> "Facts":
        """Look at a scene."""
        coloured = "rgb" in scene.film.outputs
        materials = scene.materials
        used = [scene.texture(name) for name in textures_of(scene)]
        around = scene.environment
        matt = any(isinstance(material, Diffuse) for material in materials)
        return Facts(
            outputs=frozenset(scene.film.outputs),
            coloured=coloured,
            mirrors=any(isinstance(material, Mirror) for material in materials),
            glass=any(isinstance(material, Glass) for material in materials),
            normals=any(isinstance(material, Normals) for material in materials),
            filtered=coloured and any(needs_footprint(texture) for texture in used),
            surrounded=around is not None and around.filter == "anisotropic",
            lit=matt and (bool(scene.lights) or around is not None),
        )

    @property
    def onward(self) -> bool:
        """Whether paths are followed beyond their first hit, where bounces are allowed."""
        return (self.mirrors or self.glass) and bool(self.outputs & PATH_OUTPUTS)


def textures_of(scene: Scene) -> tuple[str, ...]:
    """Return the names of the textures that some material has."""
    named = (m.texture for m in scene.materials if isinstance(m, Diffuse) and m.texture is not None)
    return tuple(sorted(set(named)))


def materials_of(asset: Asset, parts: tuple[str, ...]) -> tuple[Material, ...]:
    """Return the material of every part of an asset.

    Raises
    ------
    BadInput
        If a material is for a part that does not exist, or a part has none.
    """
    given = {material.part: material for material in asset.materials}
    unknown = set(given) - set(parts) - {"*"}
    if unknown:
        raise BadInput(f"{asset.grid} has no part '{min(unknown)}' for a material: its parts are {', '.join(parts)}")
    for part in parts:
        if part not in given and "*" not in given:
            raise BadInput(f"the part '{part}' of {asset.grid} has no material: add one for it, or one for '*'")
    return tuple(given.get(part, given.get("*", asset.materials[0])) for part in parts)


def used(scene: Scene, parts: Sequence[tuple[str, ...] | None]) -> Scene:
    """Return the scene without materials that no part is made of; of grids whose parts are None nothing is known."""
    assets = tuple(
        asset if known is None else asset.model_copy(update={"materials": _once(materials_of(asset, known))})
        for asset, known in zip(scene.assets, parts, strict=True)
    )
    return scene.model_copy(update={"assets": assets})


def _once(materials: tuple[Material, ...]) -> tuple[Material, ...]:
    return tuple(dict.fromkeys(materials))


def by_part(asset: Asset, parts: tuple[str, ...] | None) -> bool:
    """Say whether it matters which part a hit is on."""
    return len(asset.materials) > 1 or (parts is None and asset.materials[0].part != "*")
