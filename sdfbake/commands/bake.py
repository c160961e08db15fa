"""The command `bake`: a mesh into a grid."""

from pathlib import Path
from typing import Any

import click

from sdfbake import bake as run_bake
from sdfbake.atomic import check_writable
from sdfbake.commands.info import describe
from sdfbake.commands.show import json_option, print_record, progress, repaired
from sdfbake.complaint import BadInput
from sdfbake.lattice import BAND, check_resolution
from sdfbake.mesh import Mesh
from sdfbake.needs import GridNeeds, load_needs
from sdfbake.options import OPTIONAL
from sdfbake.thin import thin_in

AUTO = "auto"


@click.command()
@click.argument("mesh", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="The grid, by custom NAME.zarr.zip.")
@click.option(
    "-n", "--resolution", required=True, help="Samples along the longest axis, 16 to 8192; auto with --needs."
)
@click.option("--needs", type=Path, help="What a scene needs, from 'sdfrender plan --needs': only that is baked.")
@click.option(
    "--uv-mode", help="none, or some of faces,layers,grid; by default faces where the mesh has texture coordinates."
)
@click.option("--cube", is_flag=True, help="Give every axis the same number of samples.")
@click.option("--sign", default="auto", show_default=True, help="auto, winding or pseudonormal.")
@click.option("--open", help="For meshes with holes: winding, or shell:THICKNESS in the mesh's units.")
@click.option("--smooth", default="none", show_default=True, help="none, or ls3: the surface that the mesh stands for.")
@click.option("--levels", type=int, default=0, show_default=True, help="Coarser levels to bake too, each half as fine.")
@click.option("--engine", default="auto", show_default=True, help="auto, numpy or drjit.")
@click.option("--unwrap", "unwrapped", is_flag=True, help="Unwrap a mesh that has no texture coordinates.")
@click.option("--max-memory", type=float, help="Gigabytes allowed; by default what the machine has available.")
@json_option
def bake(
    mesh: Path,
    output: Path,
    resolution: str,
    needs: Path | None,
    *,
    uv_mode: str | None,
    unwrapped: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Bake MESH into a grid."""
    wanted = None if needs is None else _needed(needs, output, uv_mode)
    if resolution == AUTO and wanted is None:
        raise BadInput("-n auto follows a scene's pixels: give --needs FILE from 'sdfrender plan SCENE --needs FILE'")
    fixed = None if resolution == AUTO else check_resolution(_whole(resolution))
    check_writable(output)
    with progress() as report:
        loaded, done = repaired(Mesh.load(mesh))
        why = None
        if fixed is None:
            from sdfbake.resolving import resolution_for

            assert wanted is not None
            fixed, why = resolution_for(loaded, wanted)
        if unwrapped and loaded.uv is None:
            from sdfbake.unwrap import unwrap as run_unwrap

            report("unwrapping", 0)
            loaded = run_unwrap(loaded, for_resolution=fixed)
            done.append("unwrapped")
        if wanted is not None:
            uv_mode = _uv_mode(wanted, loaded)
            options["without"] = OPTIONAL - ({"part"} if wanted.parts else set())
        grid = run_bake(loaded, fixed, uv_mode=uv_mode, progress=report, **options)
        report("writing", 0)
        grid.save(output)
    record = describe(grid, output)
    if why is not None:
        record["resolution"] = f"{fixed}: {why}"
    if options["open"] is None:
        record["thin"] = [str(finding) for finding in thin_in(loaded, grid.lattice)]
    print_record({**record, "done": done}, as_json=as_json)


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise BadInput(f"-n {text} is no number of samples: give a whole number, or auto with --needs") from None


def _needed(needs: Path, output: Path, uv_mode: str | None) -> GridNeeds:
    """Read what is needed of the grid."""
    if uv_mode is not None:
        raise BadInput("--needs says which texture coordinates are baked, and so does --uv-mode: leave one of them out")
    wanted = load_needs(needs).of(output)
    if wanted.band > BAND:
        raise BadInput(f"{wanted.grid} needs a band of {wanted.band:g} voxels and a bake is exact within {BAND:g}")
    return wanted


def _uv_mode(wanted: GridNeeds, mesh: Mesh) -> str:
    """Return the representations of texture coordinates to bake; what is not required takes a mesh as it is."""
    if mesh.uv is None and not wanted.uv_required:
        return "none"
    return ",".join(wanted.uv_modes) or "none"
