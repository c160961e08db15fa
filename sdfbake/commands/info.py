"""The command `info`: what a grid says of itself."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from sdfbake import bricks
from sdfbake.commands.show import json_option, print_record
from sdfbake.grid import Grid


@click.command()
@click.argument("grid", type=Path)
@json_option
def info(grid: Path, *, as_json: bool) -> None:
    """Describe GRID."""
    print_record(describe(Grid.load(grid), grid), as_json=as_json)


def describe(grid: Grid, path: Path) -> dict[str, Any]:
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
        "uv_modes": list(metadata.uv_modes),
        "edge_over_h": metadata.edge_over_h,
        "tool_version": metadata.tool_version,
    }
