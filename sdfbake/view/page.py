"""The page: a template, its programs and a packed grid in one file.

In: a grid, an image file, a title. Out: one HTML file that asks for nothing else.
"""

import base64
import json
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from PIL import Image, UnidentifiedImageError

from sdfbake.atomic import check_writable, replacing
from sdfbake.complaint import BadInput
from sdfbake.export.result import Progress, silent
from sdfbake.grid import Grid
from sdfbake.view.packing import pack

_FOLDER = Path(__file__).parent / "page"
_SHADERS = ("field", "march", "surface", "picture", "present")
_SCRIPTS = ("blocks", "gpu", "scene", "probe", "orbit", "main")  # each uses what stands before it
_TYPES = {"PNG": "image/png", "JPEG": "image/jpeg"}
MOST_IMAGE = 16 << 20  # bytes


class _Image(NamedTuple):
    """A picture for the page: its type, and base64."""

    type: str
    data: str


@dataclass(frozen=True, slots=True)
class Viewed:
    """What was written.

    Attributes
    ----------
    file
        The page.
    size
        Its bytes.
    bricks
        Of the grid.
    textured
        Whether the grid has texture coordinates.
    """

    file: Path
    size: int
    bricks: int
    textured: bool


def view(
    grid: Grid,
    path: str | Path,
    *,
    texture: str | Path | None = None,
    title: str = "Signed distance grid",
    progress: Progress = silent,
) -> Viewed:
    """Write a page that shows a grid.

    Parameters
    ----------
    grid
        With its texture coordinates, if they are to be seen; see `sdfbake.export.texture.channels`.
    path
        The page, `.html`.
    texture
        A PNG or JPEG file; None for squares with names.
    title
        Of the page.
    progress
        Called with a stage and the share of it that is done, 0 to 1.

    Raises
    ------
    BadInput
        If the grid is too large for a page or has no surface, or the texture is no PNG or JPEG file of at most 16 MB.
    """
    path = Path(path)
    check_writable(path)
    image = None if texture is None else _image(Path(texture))
    progress("packing", 0)
    packed = pack(grid)
    textured = packed.head["offset"] is not None
    if image is not None and not textured:
        raise BadInput(
            "the grid has no texture coordinates to lay a texture on: bake it with some, or leave the texture out"
        )
    progress("writing", 0)
    environment = Environment(loader=FileSystemLoader(_FOLDER), undefined=StrictUndefined, trim_blocks=True)
    page = environment.get_template("page.html").render(
        title=escape(title),
        style=_read("style.css"),
        head=json.dumps(packed.head).replace("<", "\\u003c"),
        arrays=packed.arrays,
        image=image,
        textured=textured,
        shaders={name: _read(f"{name}.glsl") for name in _SHADERS},
        scripts=[_read(f"{name}.js") for name in _SCRIPTS],
    )
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return Viewed(path, path.stat().st_size, len(grid.bricks), textured)


def _read(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8").strip()


def _image(path: Path) -> _Image:
    """Read a picture as it is."""
    try:
        data = path.read_bytes()
        with Image.open(path) as image:
            kind = image.format or "unknown"
    except FileNotFoundError:
        raise BadInput(f"there is no texture {path}: correct the path, or make it first") from None
    except (UnidentifiedImageError, OSError, Image.DecompressionBombError):
        kind = "OpenEXR" if path.suffix.lower() == ".exr" else "unknown"
    if kind not in _TYPES:
        raise BadInput(f"{path} is of the kind {kind}, which a page cannot show: give a PNG or JPEG file")
    if len(data) > MOST_IMAGE:
        raise BadInput(f"{path} has {len(data) >> 20} MB, and a page takes a texture of up to 16: give a smaller one")
    return _Image(_TYPES[kind], base64.b64encode(data).decode("ascii"))
