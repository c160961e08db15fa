"""The command `mesh`: a grid back into a mesh, and how far that is from the mesh it came from."""

from pathlib import Path
from typing import Any

import click

from sdfbake.atomic import check_writable
from sdfbake.commands.show import json_option, print_record, progress
from sdfbake.diagnosis import diagnose
from sdfbake.grid import Grid
from sdfbake.mesh import Mesh


@click.command()
@click.argument("grid", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="A PLY file.")
@click.option("--against", type=Path, help="A mesh to measure the distance to, such as the one that was baked.")
@json_option
def mesh(grid: Path, output: Path, against: Path | None, *, as_json: bool) -> None:
    """Extract the surface of GRID as a mesh, by marching cubes.

    With --against, the greatest distance (Hausdorff), the mean and the root mean square are measured both ways, by
    exact distances of the vertices and of the centres of the faces, cut into pieces with edges of two voxels at most.
    Samples give a lower bound of the greatest distance; the record says how much is missing at most.
    """
    from sdfbake.isosurface import isosurface
    from sdfbake.meshfile import save

    check_writable(output)
    other = None if against is None else _readable(against)
    with progress() as report:
        report("reading", 0)
        loaded = Grid.load(grid, (), levels=False)
        report("marching cubes", 0)
        surface = isosurface(loaded)
        distances: dict[str, Any] = {}
        if other is not None:
            report("distances", 0)
            distances = _distances(surface, other, loaded.lattice.spacing)
        save(surface, output)
    findings = [finding.name for finding in diagnose(surface).findings]
    sizes = {"vertices": len(surface.vertices), "faces": len(surface.faces), "findings": findings}
    print_record({"file": str(output), **sizes, **distances}, as_json=as_json)


def _readable(path: Path) -> Mesh:
    """Load a mesh that distances can be measured to; it may be open."""
    loaded = Mesh.load(path)
    found = diagnose(loaded)
    if found.has("empty") or found.has("non-finite"):
        found.require_bakeable()
    return loaded


def _distances(surface: Mesh, other: Mesh, spacing: float) -> dict[str, Any]:
    """Return the distances in world units and in voxels."""
    from sdfbake.hausdorff import hausdorff

    found = hausdorff(surface, other, 2 * spacing)
    record: dict[str, Any] = {"samples": list(found.samples)}
    for name, value in (("hausdorff", found.max), ("missing_at_most", found.gap)):
        record[name] = {"world": value, "voxels": value / spacing}
    for name, way in (("to_mesh", found.forth), ("from_mesh", found.back)):
        record[name] = way._asdict()
        record[f"{name}_voxels"] = {figure: value / spacing for figure, value in way._asdict().items()}
    return record
