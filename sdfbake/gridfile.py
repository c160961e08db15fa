"""The grid asset on disk: Zarr v3 arrays in one ZIP archive.

In: a `Grid` and a path. Out: a file that appears whole or not at all, with the same bytes for the same grid; and back,
all of it, or one level, or some channels of some bricks. A reader trusts nothing: see `sdfbake.gridreading`.
"""

import zipfile
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sdfbake.atomic import replacing
from sdfbake.bricks import Bricks
from sdfbake.complaint import BadInput
from sdfbake.grid import CHANNELS, Grid
from sdfbake.gridchunks import Archive, DistrustError, encoded, require
from sdfbake.gridlayout import CHOICES, KIND, LAYOUT, chunks, file_order, is_lent, level_prefix
from sdfbake.gridreading import Choice, Head, Reading, checksum, group_of, read_head, read_level
from sdfbake.lattice import Lattice
from sdfbake.metadata import Metadata

Result = TypeVar("Result")
_DATE = (1980, 1, 1, 0, 0, 0)


def save(grid: Grid, path: str | Path) -> None:
    """Write a grid.

    Parameters
    ----------
    grid
        What to write.
    path
        The file, by custom `NAME.zarr.zip`. An old file is replaced once the new one is whole.

    Raises
    ------
    BadInput
        If the file cannot be written, or the grid was read in part.
    """
    if any(level.bricks.left_out is not None for level in (grid, *grid.levels)):
        raise BadInput(f"only a part of this grid was read, {path} would lack the rest: load it whole to save it")
    with replacing(path) as temporary:
        _write_archive(temporary, _encoded(grid))


def load(
    path: str | Path, channels: Collection[str] | None = None, bricks: Choice | None = None, *, levels: bool = True
) -> Grid:
    """Read a grid.

    Parameters
    ----------
    path
        A file written by `save`.
    channels
        Which of `CHOICES` to read; None for all that the file has. Others are None in the result; the distance is
        always read, and the table of faces comes with their ids.
    bricks
        Given the lattice and the bricks of the file, or of a level of it, says which of these are wanted. The others
        are absent in the result, and so are their rows of layers; of the file only chunks with wanted ones are read,
        so that no checksum is, but the CRC-32 of every chunk. None for all.
    levels
        Whether coarser levels are read too.

    Raises
    ------
    BadInput
        If there is no such file, or it is no grid, cut short, altered, or of another version.
    """

    def read(archive: Archive) -> Grid:
        head = read_head(archive)
        finest, _ = read_level(archive, head, channels, bricks)
        numbers = range(1, head.levels + 1) if levels else ()
        found = [_level(archive, head, number) for number in numbers]
        coarser = [read_level(*level, channels, bricks, lent=finest.surface)[0] for level in found]
        return replace(finest, levels=tuple(replace(level, surface=finest.surface) for level in coarser))

    return opened(path, _known(channels, read))


def load_counted(
    path: str | Path, channels: Collection[str] | None = None, bricks: Choice | None = None, level: int = 0
) -> tuple[Grid, Reading]:
    """Read one level of a grid as `load` does, the finest by default, and say how much of the file that took."""

    def read(archive: Archive) -> tuple[Grid, Reading]:
        head = read_head(archive)
        require(level <= head.levels, f"it has no level {level}")
        grid, reading = read_level(*_level(archive, head, level), channels, bricks)
        return grid, replace(reading, levels=(level,))

    return opened(path, _known(channels, read))


def describe(path: str | Path) -> Metadata:
    """Read what a grid file says about itself, and none of its arrays; errors are those of `load`."""
    return head(path)[1]


def head(path: str | Path) -> tuple[Lattice, Metadata]:
    """Read where a grid file's samples lie and what it says about itself, and none of its arrays."""
    return whole_head(path)[:2]


def whole_head(path: str | Path) -> Head:
    """Read the same, and how many coarser levels the file has."""
    return opened(path, read_head)


def nothing_read(path: str | Path) -> Reading:
    """Say that of a grid file nothing but the head was read."""

    def read(archive: Archive) -> Reading:
        read_head(archive)
        return Reading((), 0, None, sum(archive.read.values()), archive.size)

    return opened(path, read)


def _known(channels: Collection[str] | None, read: Callable[[Archive], Result]) -> Callable[[Archive], Result]:
    """Return a reader, unless it is asked for channels that do not exist."""
    unknown = sorted(set(channels or ()) - {"distance", *CHOICES})
    if unknown:
        raise BadInput(f"a grid has no channel {unknown[0]!r}: choose from {', '.join(CHOICES)}")
    return read


def _level(archive: Archive, head: Head, number: int) -> tuple[Archive, Head]:
    """Return the entries of a level and what it says of itself, which must go with what the file says."""
    if number == 0:
        return archive, head
    found = archive.within(level_prefix(number))
    own, lattice = read_head(found), head.lattice
    for _ in range(number):
        lattice = lattice.coarser()
    require(own.lattice.is_same(lattice), f"the lattice of level {number}")
    require(set(own.metadata.checksums) == set(head.metadata.checksums), f"the arrays of level {number}")
    return found, own


def opened(path: str | Path, read: Callable[[Archive], Result]) -> Result:
    """Read the entries of a file, and say in one sentence what is wrong with it."""

    def inside(found: Path) -> Result:
        with zipfile.ZipFile(found) as file:
            return read(Archive(file, found))

    return trusting(path, inside)


def trusting(path: str | Path, read: Callable[[Path], Result]) -> Result:
    """Read a file, and say in one sentence what is wrong with it."""
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"there is no grid file {path}: bake one with 'python -m sdfbake bake'")
    try:
        return read(path)
    except PermissionError:
        raise BadInput(f"the grid file {path} may not be read: check its permissions") from None
    except (DistrustError, *_BROKEN) as error:
        reason = f" ({error})" if isinstance(error, DistrustError) else ""
        raise BadInput(f"{path} is not a grid file, or is cut short or altered{reason}: bake it again") from None


def stored_bytes(path: str | Path) -> dict[str, int]:
    """Return the bytes on disk of every array of a grid file."""
    sizes: dict[str, int] = {}
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            name, _, rest = entry.filename.partition("/")
            if rest:
                sizes[name] = sizes.get(name, 0) + entry.compress_size
    return sizes


# What zipfile, json, zarr, numcodecs and pydantic raise on broken bytes (pydantic's error is a ValueError).
_BROKEN = (zipfile.BadZipFile, OSError, EOFError, ValueError, KeyError, TypeError, RuntimeError, MemoryError,
           NotImplementedError, OverflowError, BadInput)  # fmt: skip


def _arrays(grid: Grid) -> dict[str, np.ndarray]:
    """Return all arrays of a grid by their names in the file."""
    arrays = {"slot": grid.bricks.slot, "far": grid.bricks.far, **{name: getattr(grid, name) for name in CHANNELS}}
    arrays["error"] = grid.error
    for group, record in (("surface", grid.surface), ("layers", grid.layers)):
        if record is not None:
            arrays |= group_of(group, record)
    return {name: values for name, values in arrays.items() if values is not None}


def _encoded(grid: Grid) -> dict[str, bytes]:
    """Return the entries of the archive: Zarr's documents and chunks, those of levels in groups of their own."""
    entries = _of_level(grid, lent=False)
    for number, level in enumerate(grid.levels, 1):
        own = _of_level(level, lent=True)
        entries |= {level_prefix(number) + name: values for name, values in own.items()}
    return entries


def _of_level(grid: Grid, *, lent: bool) -> dict[str, bytes]:
    """Return the entries of one level; where it is `lent` the table of faces that the finest has, without that."""
    import zarr  # here, so that a grid is read without it
    from zarr.codecs import BloscCodec
    from zarr.storage import MemoryStore

    arrays = _arrays(grid)  # checksums are of these, whatever the order of bricks in the file
    metadata = grid.metadata.model_copy(update={"checksums": {name: checksum(a) for name, a in arrays.items()}})
    arrays = {name: values for name, values in arrays.items() if not (lent and is_lent(name))}
    entries: dict[str, Any] = {}
    group = zarr.create_group(MemoryStore(entries), zarr_format=3, attributes={
        "kind": KIND,
        "origin": grid.lattice.origin.tolist(),
        "spacing": grid.lattice.spacing,
        "shape": list(grid.lattice.shape),
        **({"levels": len(grid.levels)} if grid.levels else {}),
        "metadata": metadata.model_dump(mode="json"),
    })  # fmt: skip
    chunked: dict[str, bytes] = {}
    for name, values in _in_file_order(arrays, grid.bricks).items():
        kind = LAYOUT[name][1]
        group.create_array(
            name,
            shape=values.shape,
            chunks=chunks(name, values.shape),
            dtype=np.dtype(kind),
            compressors=BloscCodec(cname="zstd", clevel=5, shuffle="shuffle", typesize=np.dtype(kind).itemsize),
            filters=None,
            fill_value=0,
        )
        chunked |= encoded(name, values, chunks(name, values.shape))
    return {name: buffer.to_bytes() for name, buffer in entries.items()} | chunked


def _in_file_order(arrays: Mapping[str, np.ndarray], bricks: Bricks) -> dict[str, np.ndarray]:
    """Return the arrays of a grid as a file has them."""
    order = file_order(bricks.index)
    slot, place = bricks.slot.copy(), np.argsort(order).astype(np.int32)
    slot[tuple(bricks.index.T)] = place
    rows = np.argsort(place[arrays["layers.brick"]], kind="stable") if "layers.brick" in arrays else order
    orders = {"k": order, "m": rows}
    stored = {
        name: values[orders[str(LAYOUT[name][0][0])]] if LAYOUT[name][0][0] in orders else values
        for name, values in arrays.items()
    }
    named = {"layers.brick": place[stored["layers.brick"]]} if "layers.brick" in stored else {}
    return {**stored, "slot": slot, **named}


def _write_archive(path: Path, entries: Mapping[str, bytes]) -> None:
    """Write entries sorted, uncompressed (the chunks are already) and without a clock."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(entries):
            info = zipfile.ZipInfo(name, _DATE)
            info.create_system, info.external_attr = 3, 0o644 << 16
            archive.writestr(info, entries[name])
