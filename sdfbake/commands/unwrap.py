"""The command `unwrap`: texture coordinates for a mesh."""

from pathlib import Path
from typing import Any

import click

from sdfbake.atomic import check_writable
from sdfbake.commands.show import json_option, print_record, progress, repaired
from sdfbake.lattice import Lattice, check_resolution
from sdfbake.mesh import Mesh


@click.command()
@click.argument("mesh", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="A PLY file.")
@click.option("--timeout", type=float, default=300.0, show_default=True, help="Seconds until xatlas is stopped.")
@click.option("--padding", type=int, default=2, show_default=True, help="Texels between charts, at least.")
@click.option("--resolution", type=int, default=1024, show_default=True, help="Texels along the atlas, about.")
@click.option("--for-resolution", type=int, help="Resolution of the grid to bake: charts half a voxel apart.")
@click.option("--again", is_flag=True, help="Unwrap although the mesh has texture coordinates.")
@json_option
def unwrap(mesh: Path, output: Path, *, resolution: int, again: bool, as_json: bool, **options: Any) -> None:
    """Give MESH texture coordinates, and say how good they are."""
    from sdfbake.atlas import quality
    from sdfbake.meshfile import save

    check_writable(output)
    grid = options["for_resolution"]
    if grid is not None:
        check_resolution(grid)
    with progress() as report:
        loaded, done = repaired(Mesh.load(mesh))
        if loaded.uv is None or again:
            from sdfbake.unwrap import unwrap as run_unwrap

            report("unwrapping", 0)
            # An image belongs to the texture coordinates it was painted for.
            loaded = run_unwrap(loaded, resolution=resolution, **options).with_(texture=None)
            done.append("unwrapped")
        report("measuring", 0)
        found = quality(loaded, resolution)
        save(loaded, output)
    figures = found.record()
    if grid is not None:
        figures["gutter_voxels"] = found.gutter_voxels(Lattice.around(loaded.bounds, grid).spacing)
    record = {"file": str(output), "faces": len(loaded.faces), "charts": found.charts, "texture": loaded.texture}
    print_record({**record, "quality": figures, "done": done}, as_json=as_json)
