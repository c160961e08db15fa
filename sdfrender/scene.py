"""Scenes as TOML.

In: a file. Out: a checked `Scene`; a key that does not exist, a value that cannot be, a material without its texture
is one sentence that names the file and the key. docs/scenes.md describes every key.
"""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Discriminator, Field, FiniteFloat, Tag, ValidationError, model_validator
from pydantic_core import ErrorDetails

from sdfbake.complaint import BadInput
from sdfrender import camera
from sdfrender.kernels import NAMES as KERNELS
from sdfrender.lights import EnvironmentLight, Light
from sdfrender.materials import ConstantTexture, Diffuse, Glass, ImageTexture, Material, Texture
from sdfrender.similarity import IDENTITY, Similarity
from sdfrender.strict import Colour, Strict, Vector3, kind_or

Output = Literal[
    "rgb",
    "Z",
    "P",
    "N",
    "curvature",
    "part",
    "uv",
    "chart",
    "duv_dx",
    "duv_dy",
    "lod",
    "lod_invariant",
    "ellipse",
    "nonlinearity",
    "flags",
]
Levels = Literal["finest", "footprint"]
LEVELS = get_args(Levels)
_TEXTURES, _LIGHTS = ("image", "checker", "constant"), ("point", "directional")
_KINDS = frozenset(("pinhole", "orthographic", "mirror", "glass", "diffuse", "normals", *_TEXTURES, *_LIGHTS))
MOST_PIXELS = 2**28  # 268 million samples per pass: 24 bytes each for the colours alone
LONGEST = 100  # characters of a wrong value that a complaint repeats
THROUGH_MIRRORS, THROUGH_GLASS = 1, 8  # bounces where a scene does not say: a ball of glass is four


class Pinhole(Strict):
    """All rays come from one point; the fields are those of `sdfrender.camera.Camera`."""

    type: Literal["pinhole"] = "pinhole"
    position: Vector3
    target: Vector3
    up: Vector3 = (0.0, 1.0, 0.0)
    fov: float = Field(45.0, gt=0, lt=180)

    def camera(self, size: tuple[int, int]) -> camera.Camera:
        """Return the camera for a picture of that many pixels."""
        return camera.Camera(self.position, self.target, self.up, self.fov, size)


class Orthographic(Strict):
    """All rays are parallel; the fields are those of `sdfrender.camera.OrthographicCamera`."""

    type: Literal["orthographic"]
    position: Vector3
    target: Vector3
    up: Vector3 = (0.0, 1.0, 0.0)
    height: float = Field(gt=0, allow_inf_nan=False)

    def camera(self, size: tuple[int, int]) -> camera.OrthographicCamera:
        """Return the camera for a picture of that many pixels."""
        return camera.OrthographicCamera(self.position, self.target, self.up, self.height, size)


CameraModel = Annotated[
    Annotated[Pinhole, Tag("pinhole")] | Annotated[Orthographic, Tag("orthographic")], Discriminator(kind_or("pinhole"))
]


class Film(Strict):
    """The picture: its size in pixels, samples per pixel and axis, and what is recorded.

    With a `seed`, every sample lies anywhere in its own share of the pixel; without, in the middle of it.
    """

    size: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] = (512, 512)
    supersample: int = Field(1, ge=1, le=64)
    seed: int | None = Field(None, ge=0)
    outputs: tuple[Output, ...] = Field(("rgb",), min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> "Film":
        if self.size[0] * self.size[1] > MOST_PIXELS:
            raise ValueError(f"{self.size[0]}x{self.size[1]} pixels are more than {MOST_PIXELS}")
        if len(set(self.outputs)) < len(self.outputs):
            raise ValueError("an output is asked for twice in 'outputs'")
        return self


class Trace(Strict):
    """How rays meet the surface.

    The kernel and its tension; how many mirrors and surfaces of glass a path may meet; at how many of the latter, from
    the first on, both ways are followed; whether the finest level of a grid is met, or that which a ray's footprint
    suits, which is an approximation.
    """

    kernel: Literal["linear", "catmull-rom", "bspline"] = "bspline"
    tension: float = Field(0.5, ge=0, le=1)
    bounces: int | None = Field(None, ge=0, le=1024)
    splits: int = Field(2, ge=0, le=6)
    levels: Levels = "finest"


class Asset(Strict):
    """A grid, where it stands, and what its parts are made of.

    `part = "*"` stands for all parts without a material of their own. `uv` says which of the grid's texture coordinates
    are read: "auto" takes the most exact. It is scaled, then turned about an axis, then moved; or all in one matrix.
    """

    grid: Path
    uv: Literal["auto", "faces", "layers", "grid"] = "auto"
    scale: float | None = Field(None, gt=0, allow_inf_nan=False)
    rotate: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    translate: Vector3 | None = None
    matrix: tuple[tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], ...] | None = Field(
        None, min_length=3, max_length=4
    )
    materials: tuple[Material, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _stands_somewhere(self) -> "Asset":
        parts = (self.scale, self.rotate, self.translate)
        if self.matrix is not None and any(part is not None for part in parts):
            raise ValueError("'matrix' says all that 'scale', 'rotate' and 'translate' do: give one or the other")
        try:
            self.placed()
        except BadInput as error:
            raise ValueError(str(error)) from None
        return self

    def placed(self) -> Similarity:
        """Return how the grid stands in the world."""
        if self.matrix is not None:
            return Similarity.of_matrix(np.array(self.matrix))
        if self.scale is None and self.rotate is None and self.translate is None:
            return IDENTITY
        return Similarity.of_parts(
            1.0 if self.scale is None else self.scale,
            (0.0, 0.0, 1.0, 0.0) if self.rotate is None else self.rotate,
            (0.0, 0.0, 0.0) if self.translate is None else self.translate,
        )


class Scene(Strict):
    """Everything that a picture needs."""

    camera: CameraModel
    film: Film = Film()
    trace: Trace = Trace()
    assets: tuple[Asset, ...] = Field(min_length=1, max_length=64)
    textures: tuple[Texture, ...] = ()
    lights: tuple[Light, ...] = Field((), max_length=64)
    environment: EnvironmentLight | None = None
    background: Colour = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _names_match(self) -> "Scene":
        known = [texture.name for texture in self.textures]
        _once(known, "two textures are called '{}'")
        for asset in self.assets:
            _once([material.part for material in asset.materials], "two materials are given to the part '{}'")
            for material in asset.materials:
                if isinstance(material, Diffuse) and material.texture not in (None, *known):
                    raise ValueError(
                        f"there is no texture '{material.texture}' (there are: {', '.join(known) or 'none'})"
                    )
        if self.environment is not None and "background" in self.model_fields_set:
            raise ValueError("an 'environment' takes the place of the 'background': give one of them")
        return self

    @property
    def materials(self) -> tuple[Material, ...]:
        """The materials of all assets."""
        return tuple(material for asset in self.assets for material in asset.materials)

    @property
    def bounces(self) -> int:
        """How many mirrors and surfaces of glass a path may meet."""
        if self.trace.bounces is not None:
            return self.trace.bounces
        return THROUGH_GLASS if any(isinstance(m, Glass) for m in self.materials) else THROUGH_MIRRORS

    def texture(self, name: str) -> Texture:
        """Return a texture by name."""
        return next(texture for texture in self.textures if texture.name == name)

    def plain(self) -> "Scene":
        """Return the scene with textures of one colour multiplied into the colours that they lie on."""
        constant = {texture.name: texture.colour for texture in self.textures if isinstance(texture, ConstantTexture)}

        def bare(material: Material) -> Material:
            if not isinstance(material, Diffuse) or material.texture not in constant:
                return material
            red, green, blue = (a * b for a, b in zip(material.colour, constant[material.texture], strict=True))
            return material.model_copy(update={"colour": (red, green, blue), "texture": None})

        assets = tuple(
            asset.model_copy(update={"materials": tuple(bare(material) for material in asset.materials)})
            for asset in self.assets
        )
        return self.model_copy(update={"assets": assets}) if constant else self

    def with_(
        self,
        *,
        size: tuple[int, int] | None,
        outputs: tuple[str, ...] | None,
        kernel: str | None,
        levels: str | None = None,
    ) -> "Scene":
        """Return the scene with what a command line overrides."""
        data = self.model_dump(exclude_unset=True)
        film, trace = ({**data.get(table, {})} for table in ("film", "trace"))
        if size is not None:
            film["size"] = size
        if outputs is not None:
            film["outputs"] = outputs
        if kernel is not None:
            if kernel not in KERNELS:
                raise BadInput(f"there is no kernel '{kernel}': choose one of {', '.join(KERNELS)}")
            trace["kernel"] = kernel
        if levels is not None:
            trace["levels"] = levels
        return _validated({**data, "film": film, "trace": trace}, "the command line")


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
    return _with_paths_from(path.parent, scene)


def _with_paths_from(folder: Path, scene: Scene) -> Scene:
    assets = tuple(asset.model_copy(update={"grid": folder / asset.grid}) for asset in scene.assets)
    textures = tuple(
        texture.model_copy(update={"image": folder / texture.image}) if isinstance(texture, ImageTexture) else texture
        for texture in scene.textures
    )
    around = scene.environment
    if around is not None:
        around = around.model_copy(update={"image": folder / around.image})
    return scene.model_copy(update={"assets": assets, "textures": textures, "environment": around})


def _once(names: Iterable[str], complaint: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(complaint.format(name))
        seen.add(name)


def _validated(data: object, where: str) -> Scene:
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise BadInput(f"{where} {_said(error.errors()[0])}") from None


def _said(mistake: ErrorDetails) -> str:
    """Return what is wrong, as the end of a sentence about the file."""
    key, kind, given = _key(mistake["loc"]), mistake["type"], mistake["input"]
    if kind == "extra_forbidden":
        return f"has a key '{key}' that does not exist: see docs/scenes.md for those that do"
    if kind == "union_tag_not_found":
        return f"lacks the key '{key}.type': add it, see docs/scenes.md"
    if kind == "union_tag_invalid":
        tag, tags = mistake["ctx"]["tag"], mistake["ctx"]["expected_tags"]
        return f"is wrong at '{key}.type': there is no '{tag}', choose one of {tags}; see docs/scenes.md"
    if kind == "missing":
        whole, _, last = key.rpartition(".")
        if last.isdecimal():
            return f"is wrong at '{whole}': more numbers belong there, given {given!r}; see docs/scenes.md"
        return f"lacks the key '{key}': add it, see docs/scenes.md"
    said, shown = mistake["msg"].removeprefix("Value error, "), repr(given)
    place = f" at '{key}'" if key else ""
    value = f", given {shown}" if not isinstance(given, dict) and len(shown) <= LONGEST else ""
    return f"is wrong{place}: {said}{value}; see docs/scenes.md"


def _key(steps: tuple[str | int, ...]) -> str:
    """Return a key as the file has it: what kind a table is of is no key. Empty for the file as a whole."""
    before = ("", *steps)
    kept = [step for last, step in zip(before, steps, strict=False) if not (step in _KINDS and _has_kinds(last))]
    return ".".join(str(step) for step in kept)


def _has_kinds(step: str | int) -> bool:
    return step == "camera" or isinstance(step, int)
