"""Scenes as TOML.

In: a file. Out: a checked `Scene`; a key that does not exist, a value that cannot be, a material without its texture
is one sentence that names the file and the key. docs/scenes.md describes every key.
"""

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from sdfbake.complaint import BadInput
from sdfrender import camera
from sdfrender.kernels import NAMES as KERNELS

Vector3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Colour = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Output = Literal["rgb", "Z", "P", "N", "uv", "duv_dx", "duv_dy", "lod", "flags", "part"]
MOST_PIXELS = 2**28  # 268 million samples per pass: 24 bytes each for the colours alone


class _Strict(BaseModel):
    """Unknown keys are errors, and nothing changes after it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class CameraModel(_Strict):
    """Where the picture is taken from; the fields are those of `sdfrender.camera.Camera`."""

    type: Literal["pinhole"] = "pinhole"
    position: Vector3
    target: Vector3
    up: Vector3 = (0.0, 1.0, 0.0)
    fov: float = Field(45.0, gt=0, lt=180)

    def camera(self, size: tuple[int, int]) -> camera.Camera:
        """Return the camera for a picture of that many pixels."""
        return camera.Camera(self.position, self.target, self.up, self.fov, size)


class Film(_Strict):
    """The picture: its size in pixels, samples per pixel and axis, and what is recorded."""

    size: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] = (512, 512)
    supersample: int = Field(1, ge=1, le=64)
    outputs: tuple[Output, ...] = Field(("rgb",), min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> "Film":
        if self.size[0] * self.size[1] > MOST_PIXELS:
            raise ValueError(f"{self.size[0]}x{self.size[1]} pixels are more than {MOST_PIXELS}")
        if len(set(self.outputs)) < len(self.outputs):
            raise ValueError("an output is asked for twice in 'outputs'")
        return self


class Trace(_Strict):
    """How rays meet the surface: the kernel, its tension, how many mirrors a path may meet."""

    kernel: Literal["linear", "catmull-rom", "bspline"] = "bspline"
    tension: float = Field(0.5, ge=0, le=1)
    bounces: int = Field(1, ge=0, le=64)


class TextureModel(_Strict):
    """An image and how it is looked up."""

    name: str
    image: Path
    filter: Literal["point", "bilinear", "trilinear"] = "trilinear"
    wrap: Literal["clamp", "repeat"] = "clamp"


class Mirror(_Strict):
    """A perfect mirror; `colour` is the share of light that it reflects."""

    type: Literal["mirror"]
    part: str = "*"
    colour: Colour = (1.0, 1.0, 1.0)


class Diffuse(_Strict):
    """A matt surface under uniform white light: its colour, times its texture."""

    type: Literal["diffuse"]
    part: str = "*"
    colour: Colour = (1.0, 1.0, 1.0)
    texture: str | None = None


class Normals(_Strict):
    """The outward normal as a colour: (n + 1) / 2."""

    type: Literal["normals"]
    part: str = "*"


Material = Annotated[Mirror | Diffuse | Normals, Field(discriminator="type")]


class Asset(_Strict):
    """A grid and what its parts are made of; `part = "*"` stands for all parts without a material of their own.

    `uv` says which of the grid's texture coordinates are read: "auto" takes the most exact.
    """

    grid: Path
    uv: Literal["auto", "faces", "layers", "grid"] = "auto"
    materials: tuple[Material, ...] = Field(min_length=1)


class Scene(_Strict):
    """Everything that a picture needs."""

    camera: CameraModel
    film: Film = Film()
    trace: Trace = Trace()
    assets: tuple[Asset, ...] = Field(min_length=1, max_length=1)
    textures: tuple[TextureModel, ...] = ()
    background: Colour = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _names_match(self) -> "Scene":
        known = [texture.name for texture in self.textures]
        for name in known:
            if known.count(name) > 1:
                raise ValueError(f"two textures are called '{name}'")
        for asset in self.assets:
            parts = [material.part for material in asset.materials]
            for part in parts:
                if parts.count(part) > 1:
                    raise ValueError(f"two materials are given to the part '{part}'")
            for material in asset.materials:
                if isinstance(material, Diffuse) and material.texture not in (None, *known):
                    raise ValueError(
                        f"there is no texture '{material.texture}' (there are: {', '.join(known) or 'none'})"
                    )
        return self

    def texture(self, name: str) -> TextureModel:
        """Return a texture by name."""
        return next(texture for texture in self.textures if texture.name == name)

    def with_(self, *, size: tuple[int, int] | None, outputs: tuple[str, ...] | None, kernel: str | None) -> "Scene":
        """Return the scene with what a command line overrides."""
        data = self.model_dump()
        if size is not None:
            data["film"]["size"] = size
        if outputs is not None:
            data["film"]["outputs"] = outputs
        if kernel is not None:
            if kernel not in KERNELS:
                raise BadInput(f"there is no kernel '{kernel}': choose one of {', '.join(KERNELS)}")
            data["trace"]["kernel"] = kernel
        return _validated(data, "the command line")


def load_scene(path: str | Path) -> Scene:
    """Read a scene; paths in it are relative to its folder.

    Raises
    ------
    BadInput
        If there is no such file, it is no TOML, or something in it cannot be.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BadInput(f"there is no scene {path}: correct the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"the scene {path} cannot be read ({error}): give a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"the scene {path} is not TOML ({error}): correct it there") from None
    scene = _validated(data, f"the scene {path}")
    folder = path.parent
    assets = tuple(asset.model_copy(update={"grid": folder / asset.grid}) for asset in scene.assets)
    textures = tuple(texture.model_copy(update={"image": folder / texture.image}) for texture in scene.textures)
    return scene.model_copy(update={"assets": assets, "textures": textures})


def _validated(data: object, where: str) -> Scene:
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(step) for step in first["loc"]) or "as a whole"
        if first["type"] == "extra_forbidden":
            raise BadInput(
                f"{where} has a key '{key}' that does not exist: see docs/scenes.md for those that do"
            ) from None
        if first["type"] == "missing":
            raise BadInput(f"{where} lacks the key '{key}': add it, see docs/scenes.md") from None
        said = first["msg"].removeprefix("Value error, ")
        given = f", given {first['input']!r}" if not isinstance(first["input"], dict) else ""
        raise BadInput(f"{where} is wrong at '{key}': {said}{given}; see docs/scenes.md") from None
