"""VTK image data: distance, texture coordinates, chart, seam and part as point data.

In: a grid. Out: one .vti file: a head in XML, then the arrays as they lie in memory, x fastest, each after its size.
"""

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from sdfbake.atomic import replacing
from sdfbake.densify import surface_of
from sdfbake.export.result import Exported, Progress
from sdfbake.export.room import check_room
from sdfbake.export.slabs import DENSE, beyond_the_band, carried, sample_bytes, slab_bytes, stream, written
from sdfbake.grid import Grid

_AXIS = 2  # the slowest in VTK's order
_NAMES = {"distance": "sdf"}  # others keep theirs
_KINDS = {"<f4": "Float32", "<i4": "Int32", "|u1": "UInt8"}
_SIZE = 8  # bytes before every array, which hold its size


def write(grid: Grid, path: Path, *, progress: Progress, exact: bool = False) -> Exported:
    """Write a grid as VTK image data.

    Parameters
    ----------
    grid
        Any grid.
    path
        OUT.vti.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    exact
        Whether distances beyond the band are computed from the mesh that the grid carries.

    Raises
    ------
    BadInput
        If it does not fit on the disk, or the grid carries no mesh to be exact with.
    """
    names = carried(grid)
    samples = int(np.prod(grid.lattice.shape, dtype=int))
    check_room(path, samples * sample_bytes(names), slab_bytes(grid, names, _AXIS))
    surface = surface_of(grid, exact)
    sizes = [samples * sample_bytes((name,)) for name in names]
    starts = np.cumsum([0, *(_SIZE + size for size in sizes)])
    head = _head(grid, names, starts[:-1].tolist())
    with replacing(path) as temporary:
        temporary.write_bytes(head)
        with ExitStack() as stack:
            sinks = {}
            for name, start, size in zip(names, starts[:-1].tolist(), sizes, strict=True):
                file = stack.enter_context(temporary.open("r+b"))  # every array has a place of its own to go on at
                file.seek(len(head) + start)
                file.write(size.to_bytes(_SIZE, "little"))
                sinks[name] = written(file)
            stream(grid, _AXIS, sinks, surface, progress)
        with temporary.open("ab") as end:
            end.write(b"\n</AppendedData>\n</VTKFile>\n")
    return Exported((path,), (), beyond_the_band(grid, exact=exact))


def _head(grid: Grid, names: tuple[str, ...], starts: list[int]) -> bytes:
    """Return the XML up to the underscore that the arrays follow."""
    lattice = grid.lattice
    extent = " ".join(f"0 {n - 1}" for n in lattice.shape)
    origin = " ".join(map(repr, lattice.origin.tolist()))
    arrays = "\n".join(
        f'<DataArray type="{_KINDS[DENSE[name][1]]}" Name="{_NAMES.get(name, name)}" '
        f'NumberOfComponents="{np.prod(DENSE[name][0], dtype=int)}" format="appended" offset="{start}"/>'
        for name, start in zip(names, starts, strict=True)
    )
    return f"""<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<ImageData WholeExtent="{extent}" Origin="{origin}" Spacing="{" ".join([repr(lattice.spacing)] * 3)}">
<Piece Extent="{extent}">
<PointData Scalars="sdf"{' TCoords="uv"' if "uv" in names else ""}>
{arrays}
</PointData>
<CellData/>
</Piece>
</ImageData>
<AppendedData encoding="raw">
_""".encode()
