"""All channels of a grid as dense planes, one at a time.

In: a grid, an axis, and for every channel that is wanted something that takes its planes. Out: nothing; a plane is let
go of before the next but one is made. An export needs less memory beside the grid than a slab: one layer of bricks of
all that the file holds.
"""

from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from sdfbake.bricks import SIDE
from sdfbake.closest import Surface
from sdfbake.densify import Cut, plane
from sdfbake.export.result import Progress
from sdfbake.export.texture import coordinates
from sdfbake.grid import Grid
from sdfbake.lattice import BAND
from sdfbake.seams import several

# Numbers per sample and how they are written; what samples hold of which nothing is known.
DENSE: dict[str, tuple[tuple[int, ...], str, float]] = {
    "distance": ((), "<f4", 0),
    "uv": ((2,), "<f4", 0),
    "chart": ((), "<i4", -1),
    "seam": ((), "|u1", 0),
    "uv and seam": ((3,), "<f4", 0),
    "part": ((), "|u1", 0),
}
OF_TEXTURE = ("uv", "chart", "seam")

_SHARES = 4  # in which a plane's texture is looked up, one after the other
_Known = tuple[Float[np.ndarray, "slow fast 2"], Int[np.ndarray, "slow fast"]]  # texture coordinates, charts
Sink = Callable[[np.ndarray], None]  # takes planes (slow, fast, ...) in their order, see `sdfbake.densify.order`


def carried(grid: Grid) -> tuple[str, ...]:
    """Return the channels that a grid fills, in the order of `DENSE`."""
    texture = any(mode is not None for mode in (grid.uv, grid.face, grid.layers))
    return ("distance", *(OF_TEXTURE if texture else ()), *(("part",) if grid.part is not None else ()))


def beyond_the_band(grid: Grid, *, exact: bool) -> tuple[str, ...]:
    """Return a sentence on the samples that are not distances, where there are any."""
    if exact:
        return ()
    if grid.metadata.source == "dense":
        return ("in bricks far from the surface all samples hold one value of the sign, not those that were given",)
    return (
        f"samples more than {BAND} voxels from the surface hold a signed lower bound of the distance; --exact computes "
        "the distance",
    )


def sample_bytes(names: tuple[str, ...]) -> int:
    """Return the bytes that a sample takes in these channels."""
    return sum(int(np.prod(DENSE[name][0], dtype=int)) * np.dtype(DENSE[name][1]).itemsize for name in names)


def slab_bytes(grid: Grid, names: tuple[str, ...], axis: int) -> int:
    """Return the bytes of a slab, one layer of bricks across an axis, in all of these channels."""
    wide = list(grid.lattice.shape)
    wide[axis] = SIDE
    return int(np.prod(wide, dtype=int)) * sample_bytes(names)


def stream(grid: Grid, axis: int, sinks: Mapping[str, Sink], surface: Surface | None, progress: Progress) -> None:
    """Hand out every plane of some channels.

    Parameters
    ----------
    grid
        Any grid.
    axis
        Along which the planes follow each other.
    sinks
        By the channel's name in `DENSE`, among those that the grid fills ("uv and seam" is three of them as one).
    surface
        What to ask for distances beyond the exact band; None for bounds.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    """
    count = grid.lattice.shape[axis]
    texture = _texture(grid, axis) if any("uv" in name or name in OF_TEXTURE for name in sinks) else None
    progress("writing", 0)
    for number in range(count):
        if "distance" in sinks:
            sinks["distance"](plane(grid, number, axis, surface))
        if "part" in sinks and grid.part is not None:
            cut = Cut.of(grid.bricks, number, axis)
            sinks["part"](cut.spread(grid.lattice, cut.taken(grid.part), 0))
        if texture is not None:
            _hand_out(next(texture), sinks)
        progress("writing", (number + 1) / count)


def written(file: BinaryIO) -> Sink:
    """Return a sink that writes samples to a file, the axis slowest."""

    def write(values: np.ndarray) -> None:
        file.write(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).data)

    return write


class _Texture(NamedTuple):
    """A plane of what is known of the texture, and the seams of the cells that follow it."""

    uv: Float[np.ndarray, "slow fast 2"]
    chart: Int[np.ndarray, "slow fast"]
    seam: UInt8[np.ndarray, "slow fast"]


def _texture(grid: Grid, axis: int) -> Iterator[_Texture]:
    """Yield it plane by plane; one is looked up ahead, whose samples are the far corners of this one's cells."""
    found = (_of_plane(grid, number, axis) for number in range(grid.lattice.shape[axis]))
    uv, chart = next(found)
    for next_uv, next_chart in chain(found, [(uv[:0], np.full_like(chart, -1))]):
        yield _Texture(uv, chart, _seam(chart, next_chart))
        uv, chart = next_uv, next_chart


def _seam(
    chart: Int[np.ndarray, "slow fast"], following: Int[np.ndarray, "slow fast"]
) -> UInt8[np.ndarray, "slow fast"]:
    """Say of the cells between two planes whether they touch several charts."""
    corners = np.full((2, *(count + 1 for count in chart.shape)), -1, np.int32)
    corners[0, :-1, :-1], corners[1, :-1, :-1] = chart, following
    seam: UInt8[np.ndarray, "slow fast"] = several(corners)[0].view(np.uint8)
    return seam


def _of_plane(grid: Grid, number: int, axis: int) -> _Known:
    """Return texture coordinates and charts of a plane."""
    cut = Cut.of(grid.bricks, number, axis)
    shape = (len(cut.slots), *(along.stop - along.start for along in cut.part))
    uv, chart = np.empty((*shape, 2), np.float32), np.empty(shape, np.int32)
    for some in np.array_split(np.arange(len(cut.slots)), _SHARES):
        uv[some], chart[some] = coordinates(grid, cut.slots[some], cut.part)
    return cut.spread(grid.lattice, uv, 0), cut.spread(grid.lattice, chart, -1)


def _hand_out(known: _Texture, sinks: Mapping[str, Sink]) -> None:
    """Give a plane to those that asked."""
    for name in OF_TEXTURE:
        if name in sinks:
            sinks[name](getattr(known, name))
    if "uv and seam" in sinks:
        sinks["uv and seam"](np.concatenate([known.uv, known.seam[..., None].astype(np.float32)], axis=-1))
