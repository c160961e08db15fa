"""Mitsuba 3: a volume for its shape `sdfgrid`, one with texture coordinates, and a scene that shows both.

In: a grid. Out: OUT.vol, distances at the corners of cells; OUT.uv.vol, where the grid has texture coordinates: u, v
and the seam mask at the centres of cells, as `gridvolume` has them; OUT.xml. Both volumes are cubes, x fastest:
`sdfgrid` fits any lattice into the unit cube, and does not count on a `to_world` that scales axes differently.
"""

import struct
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float

from sdfbake.atomic import replacing_all
from sdfbake.closest import Surface
from sdfbake.densify import plane, surface_of
from sdfbake.export.mitsuba import numbers, scene, shape_to_world, volume_to_world
from sdfbake.export.result import Exported, Progress
from sdfbake.export.room import check_room
from sdfbake.export.slabs import Sink, beyond_the_band, carried, sample_bytes, slab_bytes, stream
from sdfbake.grid import Grid
from sdfbake.lattice import Lattice

_AXIS = 2  # the slowest in the file
_VERSION, _FLOAT32 = 3, 1  # what Mitsuba 3 reads
_CUT = "the surface leaves the lattice where it is padded to a cube: the shape is closed there, within a voxel"


def write(grid: Grid, path: Path, *, progress: Progress, exact: bool = False) -> Exported:
    """Write a grid for Mitsuba.

    Parameters
    ----------
    grid
        Any grid.
    path
        OUT.vol.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    exact
        Whether distances beyond the band are computed from the mesh that the grid carries.

    Raises
    ------
    BadInput
        If it does not fit on the disk, or the grid carries no mesh to be exact with.
    """
    n, textured = max(grid.lattice.shape), "uv" in carried(grid)
    names = ("distance", "uv and seam") if textured else ("distance",)
    check_room(path, n**3 * sample_bytes(names), slab_bytes(grid, names, _AXIS))
    surface = surface_of(grid, exact)
    files = [path, *([path.with_suffix(".uv.vol")] if textured else []), path.with_suffix(".xml")]
    with replacing_all(files) as (*volumes, shown):
        _write_volumes(grid, names, volumes, surface, progress)
        shown.write_text(scene(grid.lattice, path.name, files[1].name if textured else None))
    dropped = []
    if textured:
        dropped.append("the numbers of charts: only u, v, and whether a cell touches several charts")
    if grid.part is not None:
        dropped.append("the ids of parts: a shape of Mitsuba has one material")
    return Exported(tuple(files), tuple(dropped), _notes(grid, exact=exact, textured=textured))


def _write_volumes(
    grid: Grid, names: Sequence[str], paths: Sequence[Path], surface: Surface | None, progress: Progress
) -> None:
    """Write the cubes of distances and of texture coordinates."""
    lattice, nz = grid.lattice, grid.lattice.shape[_AXIS]
    # The planes that follow the lattice continue its last one.
    last = plane(grid, nz - 1, _AXIS, surface) if nz < max(lattice.shape) else None
    with ExitStack() as stack:
        files = [stack.enter_context(path.open("wb")) for path in paths]
        made = (_distances, _coordinates)
        sinks = {name: sink(file, lattice) for name, sink, file in zip(names, made, files, strict=False)}
        stream(grid, _AXIS, sinks, surface, progress)
        if last is not None:
            _close(files, lattice, last)


def _notes(grid: Grid, *, exact: bool, textured: bool) -> tuple[str, ...]:
    """Return what a reader has to know."""
    notes = [f"to_world of the shape, row by row: {numbers(shape_to_world(grid.lattice))}"]
    if textured:
        notes.append(f"to_world of the texture coordinates, row by row: {numbers(volume_to_world(grid.lattice))}")
    return (*notes, *beyond_the_band(grid, exact=exact), *((_CUT,) if _cut(grid) else ()))


def _cut(grid: Grid) -> bool:
    """Say whether a sample where padding begins is inside."""
    shape = grid.lattice.shape
    ends = [(axis, count - 1) for axis, count in enumerate(shape) if count < max(shape)]
    return any(bool((plane(grid, number, axis) < 0).any()) for axis, number in ends)


def _head(file: BinaryIO, lattice: Lattice, channels: int, to_world: Float[np.ndarray, "4 4"]) -> None:
    """Write what stands before the samples; the box is for people: Mitsuba's shape does not look at it."""
    n = max(lattice.shape)
    box = (to_world @ np.array([[0.0, 1], [0, 1], [0, 1], [1, 1]]))[:3].T.reshape(-1)
    file.write(struct.pack("<3sB5i6f", b"VOL", _VERSION, _FLOAT32, n, n, n, channels, *box))


def _distances(file: BinaryIO, lattice: Lattice) -> Sink:
    """Return a sink for distances that writes planes of the cube."""
    _head(file, lattice, 1, shape_to_world(lattice))

    return lambda values: _put(file, _padded(values, lattice, 0))


def _coordinates(file: BinaryIO, lattice: Lattice) -> Sink:
    """Return a sink for u, v and seam; they are 0 where nothing is known."""
    n = max(lattice.shape)
    _head(file, lattice, 3, volume_to_world(lattice))

    wide = np.zeros((n, n, 3), "<f4")

    def write(values: np.ndarray) -> None:
        wide[: values.shape[0], : values.shape[1]] = values
        _put(file, wide)

    return write


def _close(files: Sequence[BinaryIO], lattice: Lattice, last: Float[np.ndarray, "ny nx"]) -> None:
    """Write the planes of the cube that follow the last one of the lattice."""
    n, nz = max(lattice.shape), lattice.shape[_AXIS]
    for step in range(1, n - nz + 1):
        _put(files[0], _padded(last, lattice, step))
    for file in files[1:]:
        file.truncate(file.tell() + 12 * n * n * (n - nz))  # zeros


def _put(file: BinaryIO, values: Float[np.ndarray, "..."]) -> None:
    """Write numbers as they lie in memory."""
    file.write(np.ascontiguousarray(values, "<f4").data)


def _padded(values: Float[np.ndarray, "ny nx"], lattice: Lattice, above: int) -> Float[np.ndarray, "n n"]:
    """Return a plane of the cube, indexed [y, x], so many samples above that plane of the lattice.

    A sample q outside of the lattice whose nearest one in it is b is at least (|b's bound|^2 + |q - b|^2)^(1/2) from a
    surface that lies inside, since a box is convex. It is outside of the shape.
    """
    n, (ny, nx) = max(lattice.shape), values.shape
    wide = np.pad(values, ((0, n - ny), (0, n - nx)), mode="edge")
    y, x = (np.maximum(np.arange(n) - (count - 1), 0.0) for count in (ny, nx))
    strips = [np.s_[ny:, :], np.s_[:ny, nx:]] if above == 0 else [np.s_[:, :]]
    for rows, columns in strips:
        steps = y[rows, None] ** 2 + x[columns] ** 2 + above**2
        steps *= lattice.spacing**2
        steps += np.square(np.maximum(wide[rows, columns], 0), dtype=np.float64)
        # Rounded down, as a bound has to be.
        wide[rows, columns] = np.sqrt(steps, out=steps) * (1 - 1e-7)
    return wide
