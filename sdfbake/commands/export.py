"""The command `export`: a grid as another program reads it."""

from pathlib import Path
from typing import Any

import click

from sdfbake.commands.show import json_option, print_record, progress
from sdfbake.export import FORMATS, export, format_of
from sdfbake.export.texture import channels
from sdfbake.grid import Grid
from sdfbake.gridfile import whole_head

_ABOUT = "; ".join(f"{entry.name}: {entry.about}" for entry in FORMATS.values())


@click.command("export")
@click.argument("file", type=Path)
@click.option("--to", required=True, metavar="|".join(FORMATS), help=f"{_ABOUT}.")
@click.option("-o", "--output", type=Path, required=True, help="File to write; its suffix is the format's.")
@click.option("--precision", type=click.Choice(["16", "32"]), help="Bits of a number; raw only.")
@click.option("--exact", is_flag=True, help="Exact distances far from the surface, too; dense formats only; slow.")
@json_option
def export_(file: Path, to: str, output: Path, precision: str | None, *, exact: bool, as_json: bool) -> None:
    """Write the grid FILE in a format that another program reads."""
    options: dict[str, Any] = {} if precision is None else {"precision": int(precision)}
    options |= {"exact": True} if exact else {}
    chosen = format_of(to, output, options)
    head = whole_head(file)
    wanted = (*(("part", *channels(head.metadata.uv_modes)) if chosen.textured else ()), *(("face",) if exact else ()))
    with progress() as report:
        report("load", 0)
        grid = Grid.load(file, wanted, levels=False)
        report("load", 1)
        done = export(grid, output, to, progress=report, **options)
    record = {
        "format": to,
        "files": [str(path) for path in done.files],
        "bytes": done.size,
        "dropped": [*done.dropped, *(("coarser levels: the finest is written",) if head.levels else ())],
        "notes": list(done.notes),
    }
    print_record(record, as_json=as_json)
