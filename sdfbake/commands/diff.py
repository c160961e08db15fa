"""The command `diff`: what is different between two grids."""

from pathlib import Path

import click

from sdfbake.commands.show import json_option, print_record
from sdfbake.compare import compare
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid


@click.command()
@click.argument("a", type=Path)
@click.argument("b", type=Path)
@click.option("--tolerance", type=float, default=0.0, show_default=True, help="Voxels; 0 asks for the same bits.")
@json_option
def diff(a: Path, b: Path, tolerance: float, *, as_json: bool) -> int:
    """Compare the grids A and B; exit code 0 if they are the same, 1 if not.

    A tolerance bounds the difference of distances, in voxels, and of texture coordinates, in units of the atlas, where
    both are exact; ids have to agree, and where the numbers come from is told but does not count.
    """
    if not 0 <= tolerance < float("inf"):
        raise BadInput(f"a tolerance of {tolerance} voxels: give a finite number, 0 or more")
    found = compare(Grid.load(a), Grid.load(b))
    same = found.within(tolerance)
    print_record({"same": same, "tolerance": tolerance, **found.record()}, as_json=as_json)
    return 0 if same else 1
