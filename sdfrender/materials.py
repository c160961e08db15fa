"""What surfaces are made of, as a scene says it: materials by part, textures by name.

In: tables of a scene's file. Out: checked records; `sdfrender.palette` puts them on an engine.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from sdfrender.strict import Colour, Strict, kind_or


class Mirror(Strict):
    """A perfect mirror; `colour` is the share of light that it reflects."""

    type: Literal["mirror"]
    part: str = "*"
    colour: Colour = (1.0, 1.0, 1.0)


class Glass(Strict):
    """A clear solid with a smooth surface; `colour` is the share of light that passes each time."""

    type: Literal["glass"]
    part: str = "*"
    index: float = Field(1.5, gt=0, le=10, allow_inf_nan=False)
    colour: Colour = (1.0, 1.0, 1.0)


class Diffuse(Strict):
    """A matt surface: its colour times its texture is the share of light that it sends back."""

    type: Literal["diffuse"]
    part: str = "*"
    colour: Colour = (1.0, 1.0, 1.0)
    texture: str | None = None


class Normals(Strict):
    """The outward normal as a colour: (n + 1) / 2, whatever the light."""

    type: Literal["normals"]
    part: str = "*"


Material = Annotated[Mirror | Glass | Diffuse | Normals, Field(discriminator="type")]


class ImageTexture(Strict):
    """An image and how it is looked up."""

    type: Literal["image"] = "image"
    name: str
    image: Path
    filter: Literal["point", "bilinear", "trilinear", "anisotropic"] = "trilinear"
    wrap: Literal["clamp", "repeat", "mirror"] = "clamp"
    anisotropy: float = Field(16.0, ge=1, le=64)


class CheckerTexture(Strict):
    """Squares of two colours, filtered in closed form; `squares` fit between 0 and 1 along u and v."""

    type: Literal["checker"]
    name: str
    colours: tuple[Colour, Colour] = ((0.05, 0.05, 0.05), (0.9, 0.9, 0.9))
    squares: tuple[Annotated[int, Field(ge=1, le=2**20)], Annotated[int, Field(ge=1, le=2**20)]] = (16, 16)


class ConstantTexture(Strict):
    """One colour."""

    type: Literal["constant"]
    name: str
    colour: Colour


Texture = Annotated[
    Annotated[ImageTexture, Tag("image")]
    | Annotated[CheckerTexture, Tag("checker")]
    | Annotated[ConstantTexture, Tag("constant")],
    Discriminator(kind_or("image")),
]


def needs_footprint(texture: Texture) -> bool:
    """Say whether a texture's colour depends on the pixel's footprint."""
    if isinstance(texture, ImageTexture):
        return texture.filter in ("trilinear", "anisotropic")
    return isinstance(texture, CheckerTexture)
