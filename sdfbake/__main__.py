"""Command line of the baker: check, unwrap, bake, info.

In: mesh and grid files. Out: files, a table or one JSON object on standard output, progress on standard error.
"""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sdfbake import bake as run_bake
from sdfbake import bricks, commandline
from sdfbake.atomic import check_writable
from sdfbake.diagnosis import Diagnosis, diagnose
from sdfbake.grid import Grid
from sdfbake.lattice import check_resolution
from sdfbake.mesh import Mesh

_JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def cli() -> None:
    """Meshes to signed distance grids with texture coordinates."""


@cli.command()
@click.argument("mesh", type=Path)
@_JSON
def check(mesh: Path, *, as_json: bool) -> int:
    """Say what is wrong with MESH; exit code 0 if it can be baked, 2 if not."""
    from sdfbake.repair import crossings

    loaded = Mesh.load(mesh)
    found = diagnose(loaded)
    if not found.refused:
        found = Diagnosis(found.findings + crossings(loaded))
    record = {
        "file": str(mesh),
        "vertices": len(loaded.vertices),
        "faces": len(loaded.faces),
        "parts": list(loaded.part_names),
        "charts": _charts(loaded),
        "uv": loaded.uv is not None,
        **found.record(),
    }
    if as_json:
        commandline.print_json(record)
    else:
        _print_check(record, found)
    found.require_bakeable()
    return 0


@cli.command()
@click.argument("mesh", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="A PLY file.")
@click.option("--timeout", type=float, default=300.0, show_default=True, help="Seconds until xatlas is stopped.")
@click.option("--padding", type=int, default=2, show_default=True, help="Texels between charts.")
@click.option("--resolution", type=int, default=1024, show_default=True, help="Texels along the atlas, about.")
@click.option("--again", is_flag=True, help="Unwrap although the mesh has texture coordinates.")
@_JSON
def unwrap(
    mesh: Path, output: Path, timeout: float, padding: int, resolution: int, *, again: bool, as_json: bool
) -> None:
    """Give MESH texture coordinates."""
    from sdfbake.meshfile import save

    check_writable(output)
    loaded, done = _repaired(Mesh.load(mesh))
    if loaded.uv is None or again:
        from sdfbake.unwrap import unwrap as run_unwrap

        with _progress() as report:
            report("unwrapping", 0)
            loaded = run_unwrap(loaded, timeout=timeout, padding=padding, resolution=resolution)
        done.append("unwrapped")
    save(loaded, output)
    record = {"file": str(output), "faces": len(loaded.faces), "charts": _charts(loaded), "done": done}
    _print(record, as_json=as_json)


@cli.command()
@click.argument("mesh", type=Path)
@click.option("-o", "--output", type=Path, required=True, help="The grid, by custom NAME.zarr.zip.")
@click.option("-n", "--resolution", type=int, required=True, help="Samples along the longest axis, 16 to 8192.")
@click.option("--uv-mode", help="none or grid; by default grid where the mesh has texture coordinates.")
@click.option("--cube", is_flag=True, help="Give every axis the same number of samples.")
@click.option("--sign", default="auto", show_default=True, help="auto, winding or pseudonormal.")
@click.option("--unwrap", "unwrapped", is_flag=True, help="Unwrap a mesh that has no texture coordinates.")
@click.option("--max-memory", type=float, help="Gigabytes allowed; by default what the machine has available.")
@_JSON
def bake(mesh: Path, output: Path, resolution: int, *, unwrapped: bool, as_json: bool, **options: Any) -> None:
    """Bake MESH into a grid."""
    check_resolution(resolution)
    check_writable(output)
    loaded, done = _repaired(Mesh.load(mesh))
    with _progress() as report:
        if unwrapped and loaded.uv is None:
            from sdfbake.unwrap import unwrap as run_unwrap

            report("unwrapping", 0)
            loaded = run_unwrap(loaded)
            done.append("unwrapped")
        grid = run_bake(loaded, resolution, progress=report, **options)
        report("writing", 0)
        grid.save(output)
    _print({**_describe(grid, output), "done": done}, as_json=as_json)


@cli.command()
@click.argument("grid", type=Path)
@_JSON
def info(grid: Path, *, as_json: bool) -> None:
    """Describe GRID."""
    _print(_describe(Grid.load(grid), grid), as_json=as_json)


def _repaired(mesh: Mesh) -> tuple[Mesh, list[str]]:
    """Mend what is harmless; refuse what has no cure at once."""
    from sdfbake.repair import repair

    found = diagnose(mesh)
    if found.has("empty") or found.has("non-finite"):
        found.require_bakeable()
    return repair(mesh, found) if found.repairable else (mesh, [])


def _charts(mesh: Mesh) -> int:
    return 0 if mesh.uv is None else int(mesh.chart.max()) + 1


def _describe(grid: Grid, path: Path) -> dict[str, Any]:
    """Return what `info` says of a grid."""
    from sdfbake.gridfile import stored_bytes

    lattice, metadata = grid.lattice, grid.metadata
    inside = bricks.in_lattice(grid.bricks.index, lattice.shape)
    return {
        "file": str(path),
        "bytes": path.stat().st_size,
        "bytes_per_array": stored_bytes(path),
        "lattice": {"origin": lattice.origin.tolist(), "spacing": lattice.spacing, "shape": list(lattice.shape)},
        "units": metadata.units,
        "bricks": len(grid.bricks),
        "samples": int(np.count_nonzero(inside)),
        "source": metadata.source,
        "sign": metadata.sign.model_dump(),
        "parts": list(metadata.parts),
        "charts": metadata.charts,
        "uv_mode": metadata.uv_mode,
        "edge_over_h": metadata.edge_over_h,
        "tool_version": metadata.tool_version,
    }


def _print(record: dict[str, Any], *, as_json: bool) -> None:
    """Print a record as JSON or as a table."""
    if as_json:
        commandline.print_json(record)
        return
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in record.items():
        table.add_row(name.replace("_", " "), _plain(value))
    Console().print(table)


def _plain(value: Any) -> str:
    """Return a value as a person would write it."""
    if isinstance(value, dict):
        return "\n".join(f"{name} {_plain(entry)}" for name, entry in value.items())
    if isinstance(value, list):
        return ", ".join(map(_plain, value)) or "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "-" if value is None else f"{value:,}" if isinstance(value, int) and value > 9999 else str(value)


def _print_check(record: dict[str, Any], found: Diagnosis) -> None:
    """Print what was found, one line each."""
    print(f"{record['file']}: {record['faces']} faces, {record['charts']} charts, {record['verdict']}")
    for finding in found.findings:
        print(f"  {finding} ({finding.consequence})")


@contextmanager
def _progress() -> Iterator[Any]:
    """Yield a function that shows stages on a terminal, and print warnings as lines when all is done."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    tasks: dict[str, Any] = {}

    def report(stage: str, share: float) -> None:
        if stage not in tasks:
            tasks[stage] = bar.add_task(stage, total=1.0)
        bar.update(tasks[stage], completed=share)

    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", UserWarning)
        with bar:
            yield report
    for message in heard:
        print(f"warning: {message.message}", file=sys.stderr)


if __name__ == "__main__":
    commandline.run(cli, "python -m sdfbake")
