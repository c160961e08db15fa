"""The command `bake`: a mesh into a grid."""

from pathlib import Path
from typing import Any

import click

from sdfbake import bake as run_bake
from sdfbake.atomic import check_writable
from sdfbake.commands.info import describe
from sdfbake.commands.show import json_option, print_record, progress, repaired
from sdfbake.lattice import check_resolution
from sdfbake.mesh import Mesh
from sdfbake.thin import thin_in


@click.command()
@click.argument("mesh", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="The grid, by custom NAME.zarr.zip.")
@click.option("-n", "--resolution", type=int, required=True, help="Samples along the longest axis, 16 to 8192.")
@click.option(
    "--uv-mode", help="none, or some of faces,layers,grid; by default faces where the mesh has texture coordinates."
)
@click.option("--cube", is_flag=True, help="Give every axis the same number of samples.")
@click.option("--sign", default="auto", show_default=True, help="auto, winding or pseudonormal.")
@click.option("--open", help="For meshes with holes: winding, or shell:THICKNESS in the mesh's units.")
@click.option("--smooth", default="none", show_default=True, help="none, or ls3: the surface that the mesh stands for.")
@click.option("--engine", default="auto", show_default=True, help="auto, numpy or drjit.")
@click.option("--unwrap", "unwrapped", is_flag=True, help="Unwrap a mesh that has no texture coordinates.")
@click.option("--max-memory", type=float, help="Gigabytes allowed; by default what the machine has available.")
@json_option
def bake(mesh: Path, output: Path, resolution: int, *, unwrapped: bool, as_json: bool, **options: Any) -> None:
    """Bake MESH into a grid."""
    check_resolution(resolution)
    check_writable(output)
    with progress() as report:
        loaded, done = repaired(Mesh.load(mesh))
        if unwrapped and loaded.uv is None:
            from sdfbake.unwrap import unwrap as run_unwrap

            report("unwrapping", 0)
            loaded = run_unwrap(loaded, for_resolution=resolution)
            done.append("unwrapped")
        grid = run_bake(loaded, resolution, progress=report, **options)
        report("writing", 0)
        grid.save(output)
    record = describe(grid, output)
    if options["open"] is None:
        record["thin"] = [str(finding) for finding in thin_in(loaded, grid.lattice)]
    print_record({**record, "done": done}, as_json=as_json)
