"""The command `check`: what is wrong with a mesh."""

from pathlib import Path
from typing import Any

import click

from sdfbake import commandline
from sdfbake.commands.show import chart_count, json_option, progress
from sdfbake.diagnosis import Diagnosis, diagnose
from sdfbake.lattice import Lattice
from sdfbake.mesh import Mesh
from sdfbake.thin import thin_in


@click.command()
@click.argument("mesh", type=Path)
@click.option("-n", "--resolution", type=int, help="Also look for what is too thin for a grid of that resolution.")
@json_option
def check(mesh: Path, resolution: int | None, *, as_json: bool) -> int:
    """Say what is wrong with MESH; exit code 0 if it can be baked, 2 if not."""
    from sdfbake.repair import crossings

    with progress():
        loaded = Mesh.load(mesh)
    found = diagnose(loaded)
    if not found.refused:
        thin = () if resolution is None else thin_in(loaded, Lattice.around(loaded.bounds, resolution))
        found = Diagnosis(found.findings + crossings(loaded) + thin)
    record = {
        "file": str(mesh),
        "vertices": len(loaded.vertices),
        "faces": len(loaded.faces),
        "parts": list(loaded.part_names),
        "charts": chart_count(loaded),
        "uv": loaded.uv is not None,
        "texture": loaded.texture,
        **found.record(),
    }
    if as_json:
        commandline.print_json(record)
    else:
        _print_check(record, found)
    found.require_bakeable()
    return 0


def _print_check(record: dict[str, Any], found: Diagnosis) -> None:
    """Print what was found, one line each."""
    print(f"{record['file']}: {record['faces']} faces, {record['charts']} charts, {record['verdict']}")
    for finding in found.findings:
        print(f"  {finding} ({finding.consequence})")
