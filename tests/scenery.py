"""Small scenes on disk for the tests of plans, pictures and commands: grids, a texture, TOML."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datasets_synthetic import shape
from sdfbake import Grid
from sdfbake.commandline import run
from sdfrender.__main__ import cli

CAMERA = "[camera]\nposition = [0.0, 0.0, 1.9]\ntarget = [0.0, 0.0, 0.0]\nfov = 53.13\n"
TEXTURE = '[[textures]]\nname = "page"\nimage = "page.png"\nfilter = "{filter}"\n'
MIRROR = """[[assets]]
grid = "mirror.zarr.zip"
materials = [
    {{ type = "mirror", part = "sphere", colour = {tint} }},
    {{ type = "diffuse", part = "sheet", texture = "page" }},
]
"""
SPHERE = '[[assets]]\ngrid = "sphere.zarr.zip"\nmaterials = [{{ type = {material} }}]\n'


def furnish(folder: Path, resolution: int = 32, *, mirror: bool = True) -> Path:
    """Put grids of the sphere and of the mirror's scene, and a texture of squares, into a folder."""
    Grid.from_function(shape("sphere"), resolution).save(folder / "sphere.zarr.zip")
    Grid.from_function(shape("sphere"), resolution, uv_mode="none").save(folder / "bare.zarr.zip")
    if mirror:
        Grid.from_function(shape("mirror"), 56).save(folder / "mirror.zarr.zip")
    row, column = np.mgrid[0:64, 0:64]
    squares = np.where((row // 8 + column // 8) % 2, 230, 20).astype(np.uint8)
    Image.fromarray(np.stack([squares, row.astype(np.uint8) * 3, 255 - squares], axis=-1)).save(folder / "page.png")
    return folder


def mirror_scene(
    folder: Path,
    *,
    size: tuple[int, int] = (32, 32),
    outputs: tuple[str, ...] = ("rgb",),
    filtering: str = "trilinear",
    bounces: int = 1,
    supersample: int = 1,
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
    background: tuple[float, float, float] = (0.1, 0.2, 0.3),
) -> Path:
    """Write the scene of a mirror sphere and a textured sheet behind the camera."""
    text = f"background = {list(background)}\n{CAMERA}[film]\nsize = {list(size)}\nsupersample = {supersample}\n"
    text += f"outputs = {list(outputs)}\n[trace]\nbounces = {bounces}\n"
    return _write(folder / "mirror.toml", text + TEXTURE.format(filter=filtering) + MIRROR.format(tint=list(tint)))


def sphere_scene(
    folder: Path,
    material: str = '"normals"',
    *,
    size: tuple[int, int] = (32, 32),
    outputs: tuple[str, ...] = ("rgb",),
    filtering: str = "trilinear",
    supersample: int = 1,
) -> Path:
    """Write the scene of a single sphere; `material` is a TOML type with what follows it."""
    text = f"{CAMERA}[film]\nsize = {list(size)}\nsupersample = {supersample}\noutputs = {list(outputs)}\n"
    textures = TEXTURE.format(filter=filtering) if "texture" in material else ""
    return _write(folder / "sphere.toml", text + textures + SPHERE.format(material=material))


def _write(path: Path, text: str) -> Path:
    path.write_text(text.replace("'", '"'), encoding="utf-8")
    return path


def sdfrender_caller(monkeypatch, capsys):
    """Return what runs the renderer's command line in this process: exit code, standard output, standard error."""

    def called(*arguments):
        monkeypatch.setattr(sys, "argv", ["sdfrender", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            run(cli, "python -m sdfrender")
        said = capsys.readouterr()
        return left.value.code, said.out, said.err

    return called
