"""All channels of a grid as dense slabs, one at a time.

In: a grid, an axis, and for every channel that is wanted something that takes its slabs. Out: nothing; a slab is let go
of before the next is made, so that an export needs no more memory than the widest slab beside the grid.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import BinaryIO

import numpy as np
from jaxtyping import Bool

from sdfbake.bricks import SIDE, Bricks
from sdfbake.closest import Surface
from sdfbake.densify import layer, order, slab
from sdfbake.export.result import Progress
from sdfbake.export.texture import textured
from sdfbake.grid import Grid
from sdfbake.lattice import BAND
from sdfbake.layers import Layers

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

Sink = Callable[[np.ndarray], None]  # takes slabs (sx, sy, sz, ...) in their order


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
    """Return the bytes of a slab in all of these channels."""
    wide = [count * SIDE for count in grid.bricks.slot.shape]
    wide[axis] = SIDE
    return int(np.prod(wide, dtype=int)) * sample_bytes(names)


def stream(grid: Grid, axis: int, sinks: Mapping[str, Sink], surface: Surface | None, progress: Progress) -> None:
    """Hand out every slab of some channels.

    Parameters
    ----------
    grid
        Any grid.
    axis
        Along which the slabs follow each other.
    sinks
        By the channel's name in `DENSE`, among those that the grid fills ("uv and seam" is three of them as one).
    surface
        What to ask for distances beyond the exact band; None for bounds.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    """
    count = grid.bricks.slot.shape[axis]
    progress("writing", 0)
    for number in range(count):
        if "distance" in sinks:
            sinks["distance"](slab(grid, number, axis, surface))
        if "part" in sinks and grid.part is not None:
            sinks["part"](layer(grid.bricks, grid.lattice, grid.part, 0, number, axis))
        _stream_texture(grid, number, axis, sinks)
        progress("writing", (number + 1) / count)


def written(file: BinaryIO, axis: int) -> Sink:
    """Return a sink that writes samples to a file, the axis slowest (see `sdfbake.densify.order`)."""

    def write(values: np.ndarray) -> None:
        for plane in values.transpose(*order(axis), *range(3, values.ndim)):
            file.write(np.ascontiguousarray(plane, plane.dtype.newbyteorder("<")).data)

    return write


def _stream_texture(grid: Grid, number: int, axis: int, sinks: Mapping[str, Sink]) -> None:
    """Hand out what is known of the texture in one layer of bricks."""
    if not any("uv" in name or name in OF_TEXTURE for name in sinks):
        return
    at = grid.bricks.index[:, axis]
    some = _with_only(grid, (at == number) | (at == number + 1))
    # Of the next layer only the first samples matter: they are corners of this one's last cells.
    wanted = np.ones(some.distance.shape, bool)
    ahead = some.bricks.index[:, axis] == number + 1
    np.moveaxis(wanted, axis + 1, 1)[ahead, 1:] = False
    found = textured(some, wanted)
    if found is None:
        return
    for name, sink in sinks.items():
        if name in OF_TEXTURE or name == "uv and seam":
            values = getattr(found, name) if name in OF_TEXTURE else _joined(found.uv, found.seam)
            kind, absent = DENSE[name][1:]
            sink(layer(some.bricks, grid.lattice, values.astype(kind, copy=False), absent, number, axis))


def _joined(uv: np.ndarray, seam: np.ndarray) -> np.ndarray:
    """Return u, v and the mask as one channel."""
    return np.concatenate([uv, seam[..., None].astype(np.float32)], axis=-1)


def _with_only(grid: Grid, kept: Bool[np.ndarray, " k"]) -> Grid:
    """Return a grid of some of the bricks, with what `textured` looks at and no more."""
    present = np.zeros(grid.bricks.slot.shape, bool)
    present[tuple(grid.bricks.index[kept].T)] = True
    uv, chart, face = (None if values is None else values[kept] for values in (grid.uv, grid.chart, grid.face))
    surface = grid.surface
    if face is not None and surface is not None:
        named = np.zeros(len(surface.corners) + 1, bool)
        named[face] = True  # -1, for none, is the last
        named[-1] = False
        face = np.where(face < 0, face, np.cumsum(named, dtype=np.int32)[face] - np.int32(1))
        faces = named[:-1]
        surface = replace(surface, corners=surface.corners[faces], uv=surface.uv[faces], chart=surface.chart[faces])
    return replace(
        grid,
        bricks=Bricks.of(present, grid.bricks.far),
        distance=grid.distance[kept],
        uv=uv,
        chart=chart,
        part=None,
        face=face,
        surface=surface,
        layers=None if grid.layers is None else _rows(grid.layers, kept),
        error=None,
    )


def _rows(layers: Layers, kept: Bool[np.ndarray, " k"]) -> Layers:
    """Return the rows of some bricks."""
    place, rows = np.cumsum(kept, dtype=np.int32) - np.int32(1), kept[layers.brick]
    of = {name: getattr(layers, name)[rows] for name in ("chart", "uv", "border", "normal")}
    return replace(layers, brick=place[layers.brick[rows]], **of)
