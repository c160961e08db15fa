"""The command `unwrap`: texture coordinates for a mesh."""

from pathlib import Path

import click

from sdfbake.atomic import check_writable
from sdfbake.commands.show import chart_count, json_option, print_record, progress, repaired
from sdfbake.mesh import Mesh


@click.command()
@click.argument("mesh", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="A PLY file.")
@click.option("--timeout", type=float, default=300.0, show_default=True, help="Seconds until xatlas is stopped.")
@click.option("--padding", type=int, default=2, show_default=True, help="Texels between charts.")
@click.option("--resolution", type=int, default=1024, show_default=True, help="Texels along the atlas, about.")
@click.option("--again", is_flag=True, help="Unwrap although the mesh has texture coordinates.")
@json_option
def unwrap(
    mesh: Path, output: Path, timeout: float, padding: int, resolution: int, *, again: bool, as_json: bool
) -> None:
    """Give MESH texture coordinates."""
    from sdfbake.meshfile import save

    check_writable(output)
    loaded, done = repaired(Mesh.load(mesh))
    if loaded.uv is None or again:
        from sdfbake.unwrap import unwrap as run_unwrap

        with progress() as report:
            report("unwrapping", 0)
            loaded = run_unwrap(loaded, timeout=timeout, padding=padding, resolution=resolution)
        done.append("unwrapped")
    save(loaded, output)
    record = {"file": str(output), "faces": len(loaded.faces), "charts": chart_count(loaded), "done": done}
    print_record(record, as_json=as_json)
