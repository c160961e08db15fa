"""The command `view`: a grid as a web page."""

from pathlib import Path

import click

from sdfbake.atomic import check_writable
from sdfbake.commands.show import json_option, print_record, progress
from sdfbake.grid import Grid


@click.command()
@click.argument("grid", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="The page, an HTML file.")
@click.option("--texture", type=Path, help="A PNG or JPEG file to lay on it; squares with names without.")
@click.option("--title", help="Of the page; the grid's file name without.")
@json_option
def view(grid: Path, output: Path, texture: Path | None, title: str | None, *, as_json: bool) -> None:
    """Write GRID as one web page that traces rays over it, with a texture.

    The page needs no network: open it in any browser with WebGL2. Samples are stored as float16.
    """
    from sdfbake.export.texture import channels
    from sdfbake.gridfile import describe
    from sdfbake.view import view as write

    check_writable(output)
    with progress() as report:
        report("reading", 0)
        loaded = Grid.load(grid, channels(describe(grid).uv_modes), levels=False)
        named = grid.name.removesuffix(".zip").removesuffix(".zarr")
        done = write(loaded, output, texture=texture, title=title or named, progress=report)
    record = {"file": str(done.file), "bytes": done.size, "bricks": done.bricks, "textured": done.textured}
    print_record(record, as_json=as_json)
