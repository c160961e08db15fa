"""The bricks of a grid as one file of plain arrays and one that describes it, for engines and WebGPU.

In: a grid. Out: OUT.bin, the arrays of `sdfbake.export.packing` one after the other, each at a multiple of 256 bytes,
as WebGPU wants the bindings of its buffers; OUT.json, which says of each its type, shape, place and meaning.
"""

import json
from pathlib import Path
from typing import Any

from sdfbake.atomic import replacing_all
from sdfbake.bricks import SIDE
from sdfbake.export.npy import description
from sdfbake.export.packing import Packed, packed
from sdfbake.export.result import Exported, Progress
from sdfbake.export.room import check_room
from sdfbake.export.slabs import carried, sample_bytes
from sdfbake.grid import Grid

VERSION = 1
ALIGNED = 256  # bytes
_WORK = 32  # bytes per sample while arrays are packed: these, and the texture's while it is looked up


def write(grid: Grid, path: Path, *, progress: Progress, precision: int = 16) -> Exported:
    """Write the bricks of a grid.

    Parameters
    ----------
    grid
        Any grid.
    path
        OUT.json.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    precision
        Bits of distances and texture coordinates, 16 or 32; see `packed`.

    Raises
    ------
    BadInput
        If it does not fit in memory or on the disk, or not in this precision.
    """
    samples = grid.distance.size
    check_room(path, samples * sample_bytes(carried(grid)) + 8 * grid.bricks.slot.size, samples * _WORK)
    progress("packing", 0)
    made = packed(grid, precision)
    progress("packing", 1)
    data = path.with_suffix(".bin")
    with replacing_all([path, data]) as (described, binary):
        with binary.open("wb") as file:
            for values, place in zip(made.arrays.values(), places(made), strict=True):
                file.write(bytes(place - file.tell()))
                file.write(values.tobytes())
            file.write(bytes(-file.tell() % ALIGNED))
        described.write_text(json.dumps(_document(grid, made, data.name), indent=2) + "\n")
    notes = () if precision == 32 else (f"rounding moved distances by at most {made.rounding[0]:.2g} voxels",)
    return Exported((path, data), (), notes)


def places(made: Packed) -> list[int]:
    """Return where each array begins, bytes."""
    starts, end = [], 0
    for values in made.arrays.values():
        starts.append(-(-end // ALIGNED) * ALIGNED)
        end = starts[-1] + values.nbytes
    return starts


def _document(grid: Grid, made: Packed, data: str) -> dict[str, Any]:
    """Return the description of all arrays."""
    arrays = [
        {
            "name": name,
            "dtype": values.dtype.name,
            "shape": list(values.shape),
            "offset": place,
            "bytes": values.nbytes,
            "about": made.about[name],
        }
        for (name, values), place in zip(made.arrays.items(), places(made), strict=True)
    ]
    every, surface = made.rounding
    texture = {}
    if made.uv_offset is not None and made.uv_scale is not None:
        texture = {"uv_offset": made.uv_offset.tolist(), "uv_scale": made.uv_scale.tolist()}
    return {
        "kind": "sdf bricks",
        "version": VERSION,
        "data": data,
        "byte_order": "little",
        "order": "C: the last index runs fastest; x, y, z in this order",
        "brick": SIDE,
        "distance_unit": "voxel" if made.arrays["distance"].itemsize == 2 else "world",
        "distance_scale": made.scale,
        **texture,
        "greatest_rounding_error_in_voxels": every,
        "greatest_rounding_error_near_the_surface_in_voxels": surface,
        **description(grid, exact=False),
        "arrays": arrays,
    }
