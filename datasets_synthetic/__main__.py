"""Command line of the room: `python -m datasets_synthetic list | make | sample | texture | scenes`.

In: names. Out: mesh files (PLY), grids sampled from exact shapes (Zarr), textures (PNG, EXR), scenes (TOML).
"""

from pathlib import Path
from typing import Any

import click

from datasets_synthetic import real, registry
from datasets_synthetic.scenes import scene, scene_names
from datasets_synthetic.sky import NAME as SKY
from datasets_synthetic.sky import save_sky
from datasets_synthetic.texture import save_texture, textures
from sdfbake.atomic import replacing
from sdfbake.commandline import print_json, run
from sdfbake.complaint import BadInput


@click.group()
def cli() -> None:
    """Shapes with exact distances, their meshes and grids, textures, scenes."""


@cli.command("list")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def list_(*, as_json: bool) -> None:
    """List shapes, real meshes, textures and scenes."""
    if as_json:
        print_json(_catalogue())
        return
    for name, entry in registry.ENTRIES.items():
        click.echo(f"{name:24}{'exact shape and mesh':24}{entry.about}")
    for name, (_, about) in real.FILES.items():
        click.echo(f"{name:24}{'mesh' if _installed(name) else 'mesh, NOT INSTALLED':24}{about}")
    for kind, names in (("texture", (*textures(), SKY)), ("scene", scene_names())):
        for name in names:
            click.echo(f"{name:24}{kind}")


@cli.command()
@click.argument("name")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Mesh file, .ply.")
@click.option("--edge", type=float, help="Length of the edges; about 40,000 faces if left out.")
def make(name: str, output: Path, edge: float | None) -> None:
    """Write the mesh NAME."""
    from sdfbake import meshfile

    meshfile.save(registry.mesh(name, edge), output)


@cli.command()
@click.argument("name")
@click.option("-n", "--resolution", required=True, type=int, help="Samples along the longest axis.")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Grid file, .zarr.zip.")
@click.option("--uv-mode", type=click.Choice(["none", "grid"]), default="grid", show_default=True)
@click.option("--cube", is_flag=True, help="The same number of samples along every axis.")
@click.option("--levels", type=int, default=0, show_default=True, help="Coarser levels to sample too.")
def sample(name: str, resolution: int, output: Path, uv_mode: str, levels: int, *, cube: bool) -> None:
    """Sample the exact shape NAME to a grid, so that no facets speak for the method."""
    from sdfbake.grid import Grid

    Grid.from_function(registry.shape(name), resolution, uv_mode=uv_mode, cube=cube, levels=levels).save(output)


@cli.command()
@click.argument("name")
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="Picture file, .png; .exr for the sky."
)
def texture(name: str, output: Path) -> None:
    """Draw the texture NAME."""
    if name == SKY:
        save_sky(output)
    else:
        save_texture(name, output)


@cli.command()
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder for the .toml files.")
def scenes(output: Path) -> None:
    """Write all scenes; their grids and textures are expected in folders beside theirs."""
    for name in scene_names():
        with replacing(output / f"{name}.toml") as temporary:
            temporary.write_text(scene(name), encoding="utf-8")


def _catalogue() -> dict[str, Any]:
    """Everything there is, as plain data."""
    meshes: list[dict[str, Any]] = []
    for name, entry in registry.ENTRIES.items():
        exact = entry.build()
        meshes.append(
            {
                "name": name,
                "about": entry.about,
                "exact": True,
                "edge": entry.edge,
                "parts": list(exact.part_names),
                "charts": exact.charts,
                "area": exact.area,
                "volume": exact.volume,
            }
        )
    for name, (_, about) in real.FILES.items():
        meshes.append({"name": name, "about": about, "exact": False, "installed": _installed(name)})
    return {"meshes": meshes, "textures": [*textures(), SKY], "scenes": scene_names()}


def _installed(name: str) -> bool:
    try:
        real.path_of(name)
    except BadInput:
        return False
    return True


if __name__ == "__main__":
    run(cli, "python -m datasets_synthetic")
