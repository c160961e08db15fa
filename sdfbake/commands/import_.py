"""The command `import`: a grid out of a file that others made."""

import sys
from pathlib import Path
from typing import Any

import click

from sdfbake.atomic import check_writable
from sdfbake.commands.info import describe
from sdfbake.commands.show import json_option, print_record
from sdfbake.complaint import BadInput
from sdfbake.imports import Said, import_grid


@click.command("import")
@click.argument("file", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="The grid, by custom NAME.zarr.zip.")
@click.option("--grid", help="Which grid of a .vdb or array of a .vti file; by default sdf, or the first that fits.")
@click.option("--spacing", type=float, help="Between the samples of a .npy file; by default 1.")
@click.option("--origin", help="X,Y,Z of the first sample of a .npy file; by default 0,0,0.")
@click.option("--band", type=float, help="Voxels from the surface within which the values are exact.")
@click.option("--scale", type=float, default=1.0, show_default=True, help="What makes the values distances.")
@click.option("--flip", is_flag=True, help="Inside is positive in FILE.")
@json_option
def import_(file: Path, output: Path, origin: str | None, *, as_json: bool, **said: Any) -> None:
    """Import the signed distances of FILE: .vdb, .vti, .vol or .npy."""
    check_writable(output)
    found = import_grid(file, Said(origin=None if origin is None else _three(origin), **said))
    found.grid.save(output)
    for note in found.notes:
        print(f"warning: {note}", file=sys.stderr)
    steep = found.steepness
    print_record(
        {
            **describe(found.grid, output),
            "band": found.grid.metadata.band,
            "gradient": {"median": steep.median, "off_share": steep.off, "cells": steep.cells}
            if as_json
            else str(steep),
            "resampled": found.resampled,
            "notes": list(found.notes),
        },
        as_json=as_json,
    )


def _three(text: str) -> tuple[float, float, float]:
    """Return three numbers with commas between them."""
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise BadInput(f"--origin {text} is no position: give X,Y,Z, such as 0,0,0.5") from None
    return x, y, z
