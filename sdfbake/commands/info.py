"""The command `info`: what a grid says of itself."""

from pathlib import Path
from typing import Any

import click
import numpy as np
from jaxtyping import Float

from sdfbake import bricks
from sdfbake.commands.show import json_option, print_record
from sdfbake.grid import KERNELS, Grid
from sdfbake.seams import seam_cells


@click.command()
@click.argument("grid", type=Path)
@json_option
def info(grid: Path, *, as_json: bool) -> None:
    """Describe GRID."""
    print_record(describe(Grid.load(grid), grid), as_json=as_json)


def describe(grid: Grid, path: Path) -> dict[str, Any]:
    """Return what `info` says of a grid."""
    from sdfbake.gridfile import stored_bytes

    lattice, metadata, stored = grid.lattice, grid.metadata, stored_bytes(path)
    near = np.abs(grid.distance) <= lattice.spacing * 3**0.5
    seams = seam_cells(grid)[near] if metadata.uv_modes and metadata.uv_modes != ("layers",) else None
    inside = bricks.in_lattice(grid.bricks.index, lattice.shape)
    return {
        "file": str(path),
        "bytes": path.stat().st_size,
        "bytes_per_array": stored,
        "lattice": {"origin": lattice.origin.tolist(), "spacing": lattice.spacing, "shape": list(lattice.shape)},
        "units": metadata.units,
        "bricks": len(grid.bricks),
        "samples": int(np.count_nonzero(inside)),
        "levels": [
            {
                "spacing": level.lattice.spacing,
                "shape": list(level.lattice.shape),
                "bricks": len(level.bricks),
                "bytes": stored[f"level{number}"],
            }
            for number, level in enumerate(grid.levels, 1)
        ],
        "source": metadata.source,
        "sign": metadata.sign.model_dump(),
        "parts": list(metadata.parts),
        "charts": metadata.charts,
        "uv_modes": list(metadata.uv_modes),
        "seam_share": None if seams is None else float(seams.mean()),
        "layers_overflow": metadata.overflow if "layers" in metadata.uv_modes else None,
        "texture": metadata.texture,
        "edge_over_h": metadata.edge_over_h,
        "interpolation_error": None if grid.error is None else _errors(grid.error),
        "options": metadata.options,
        "tool_version": metadata.tool_version,
    }


def _errors(error: Float[np.ndarray, "k 3"]) -> dict[str, dict[str, float]]:
    """Return, voxels, the median and the greatest error of each kernel over the bricks with surface."""
    some = error[error.any(axis=1)]
    columns = {name: some[:, column] for column, name in enumerate(KERNELS)}
    return {
        name: {"median": float(np.median(values)), "max": float(values.max())}
        for name, values in columns.items()
        if len(values)
    }
