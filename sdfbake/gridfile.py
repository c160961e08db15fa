"""The grid asset on disk: Zarr v3 arrays in one ZIP archive.

In: a `Grid` and a path. Out: a file that appears whole or not at all, with the same bytes for the same grid; and back,
all of it or some channels of some bricks. A reader trusts nothing: shapes, types, codecs and sizes are checked before
an array is decoded, checksums after.
"""

import hashlib
import json
import zipfile
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Int

from sdfbake.atomic import replacing
from sdfbake.bricks import Bricks
from sdfbake.complaint import BadInput
from sdfbake.faces import FaceTable
from sdfbake.grid import CHANNELS, Grid
from sdfbake.gridchunks import Archive, DistrustError, array, checked, encoded, require, some_rows
from sdfbake.gridlayout import CHOICES, KIND, LAYOUT, TABLES, belongs, chunks, file_order
from sdfbake.lattice import Lattice
from sdfbake.layers import Layers
from sdfbake.metadata import FORMAT_VERSION, Metadata

Result = TypeVar("Result")
# Which of the bricks of a file are wanted, in the order of their slots.
Choice = Callable[[Lattice, Bricks], Bool[np.ndarray, " k"]]
_MOST_SAMPLES = 1 << 16  # along an axis: far above what a bake makes, far below where an index overflows
_DATE = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class Reading:
    """How much of a file was read: channels, bricks that were decoded and that there are, bytes and those of the file.

    How many bricks there are is None where nothing but the head was read.
    """

    channels: tuple[str, ...]
    bricks: int
    of_bricks: int | None
    bytes: int
    of_bytes: int


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
    if grid.bricks.left_out is not None:
        raise BadInput(f"only a part of this grid was read, {path} would lack the rest: load it whole to save it")
    with replacing(path) as temporary:
        _write_archive(temporary, _encoded(grid))


def load(path: str | Path, channels: Collection[str] | None = None, bricks: Choice | None = None) -> Grid:
    """Read a grid.

    Parameters
    ----------
    path
        A file written by `save`.
    channels
        Which of `CHOICES` to read; None for all that the file has. Others are None in the result; the distance is
        always read, and the table of faces comes with their ids.
    bricks
        Given the lattice and the bricks of the file, says which of these are wanted. The others are absent in the
        result, and so are their rows of layers; of the file only chunks with wanted ones are read, so that no
        checksum is, but the CRC-32 of every chunk. None for all.

    Raises
    ------
    BadInput
        If there is no such file, or it is no grid, cut short, altered, or of another version.
    """
    return load_counted(path, channels, bricks)[0]


def load_counted(
    path: str | Path, channels: Collection[str] | None = None, bricks: Choice | None = None
) -> tuple[Grid, Reading]:
    """Read a grid as `load` does, and say how much of the file that took."""
    unknown = sorted(set(channels or ()) - {"distance", *CHOICES})
    if unknown:
        raise BadInput(f"a grid has no channel {unknown[0]!r}: choose from {', '.join(CHOICES)}")
    return _trusting(path, lambda file: _read(file, channels, bricks))


def describe(path: str | Path) -> Metadata:
    """Read what a grid file says about itself, and none of its arrays; errors are those of `load`."""
    return head(path)[1]


def head(path: str | Path) -> tuple[Lattice, Metadata]:
    """Read where a grid file's samples lie and what it says about itself, and none of its arrays."""

    def read(file: Path) -> tuple[Lattice, Metadata]:
        with zipfile.ZipFile(file) as archive:
            return _read_head(Archive(archive, file))

    return _trusting(path, read)


def nothing_read(path: str | Path) -> Reading:
    """Say that of a grid file nothing but the head was read."""

    def read(file: Path) -> Reading:
        with zipfile.ZipFile(file) as opened:
            archive = Archive(opened, file)
            _read_head(archive)
            return Reading((), 0, None, sum(archive.read.values()), archive.size)

    return _trusting(path, read)


def _trusting(path: str | Path, read: Callable[[Path], Result]) -> Result:
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
            names = [name for name in LAYOUT if name.startswith(f"{group}.")]
            arrays |= {name: getattr(record, name.partition(".")[2]) for name in names}
    return {name: values for name, values in arrays.items() if values is not None}


def _encoded(grid: Grid) -> dict[str, bytes]:
    """Return the entries of the archive: Zarr's documents and chunks."""
    import zarr  # here, so that a grid is read without it
    from zarr.codecs import BloscCodec
    from zarr.storage import MemoryStore

    arrays = _arrays(grid)  # checksums are of these, whatever the order of bricks in the file
    metadata = grid.metadata.model_copy(update={"checksums": {name: _checksum(a) for name, a in arrays.items()}})
    entries: dict[str, Any] = {}
    group = zarr.create_group(MemoryStore(entries), zarr_format=3, attributes={
        "kind": KIND,
        "origin": grid.lattice.origin.tolist(),
        "spacing": grid.lattice.spacing,
        "shape": list(grid.lattice.shape),
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


def _checksum(values: np.ndarray) -> str:
    """Return the SHA-256 of an array's little-endian bytes in C order."""
    return hashlib.sha256(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).data).hexdigest()


def _write_archive(path: Path, entries: Mapping[str, bytes]) -> None:
    """Write entries sorted, uncompressed (the chunks are already) and without a clock."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(entries):
            info = zipfile.ZipInfo(name, _DATE)
            info.create_system, info.external_attr = 3, 0o644 << 16
            archive.writestr(info, entries[name])


def _read(path: Path, channels: Collection[str] | None, wanted: Choice | None) -> tuple[Grid, Reading]:
    """Check the file's claims, then decode what is wanted."""
    with zipfile.ZipFile(path) as file:
        archive = Archive(file, path)
        lattice, metadata = _read_head(archive)
        names = _names(metadata)
        shapes = checked(archive, names, lattice)
        names = [name for name in names if belongs(name, channels)]
        slot, far = (array(archive, name, *shapes[name]) for name in TABLES)
        bricks = Bricks.of(slot >= 0, far)
        place = slot[tuple(bricks.index.T)]
        every = len(bricks) == shapes["distance"][0][0] and np.array_equal(np.sort(place), np.arange(len(bricks)))
        require(every and bool((slot >= -1).all()), "its table of bricks")
        kept = np.ones(len(bricks), bool) if wanted is None else wanted(lattice, bricks)
        arrays = {"slot": bricks.slot, "far": far, **_of_bricks(archive, names, shapes, place, kept)}
    for name in names if kept.all() else TABLES:
        require(_checksum(arrays[name]) == metadata.checksums[name], f"the checksum of {name}")
    _check_values(metadata, arrays)
    given = {name.partition(".")[0] for name in names}
    read = Reading(
        channels=tuple(channel for channel in ("distance", *CHOICES) if channel in given),
        bricks=_in_chunks(place[kept], len(place), shapes["distance"][1]),
        of_bricks=len(kept),
        bytes=sum(archive.read.values()),
        of_bytes=archive.size,
    )
    return _assembled(lattice, metadata, bricks if kept.all() else _with_only(bricks, kept), arrays), read


def _names(metadata: Metadata) -> list[str]:
    """Return the arrays that a file says it has, in the order of the layout."""
    names = [name for name in LAYOUT if name in metadata.checksums]
    require(set(names) == set(metadata.checksums) >= {*TABLES, "distance"}, "its list of arrays")
    for group in ("surface", "layers"):
        require(len({n in names for n in LAYOUT if n.startswith(f"{group}.")}) == 1, f"its arrays of {group}")
    require(("face" in names) == ("surface.corners" in names), "its arrays of faces")
    return names


def _of_bricks(
    archive: Archive,
    names: Collection[str],
    shapes: Mapping[str, tuple[tuple[int, ...], int]],
    place: Int[np.ndarray, " k"],
    kept: Bool[np.ndarray, " k"],
) -> dict[str, np.ndarray]:
    """Decode what arrays, but the tables of bricks, say of some bricks, in the order of these."""
    arrays, rows = {}, {"k": place[kept]}
    if "layers.brick" in names:
        stored = array(archive, "layers.brick", *shapes["layers.brick"])
        require(bool(((stored >= 0) & (stored < len(place))).all()), "the ids of layers.brick")
        require(bool((np.diff(stored) >= 0).all()), "the order of its layers")
        slot = np.full(len(place), -1, np.int32)
        slot[place[kept]] = np.arange(np.count_nonzero(kept), dtype=np.int32)
        brick = slot[stored]
        chosen = np.flatnonzero(brick >= 0)
        rows["m"] = chosen[np.argsort(brick[chosen], kind="stable")]
        arrays["layers.brick"] = brick[rows["m"]]
    for name in names:
        axis = str(LAYOUT[name][0][0])
        if name in TABLES or name in arrays:
            continue
        some = axis in rows
        arrays[name] = (
            some_rows(archive, name, *shapes[name], rows[axis]) if some else array(archive, name, *shapes[name])
        )
    return arrays


def _with_only(bricks: Bricks, kept: Bool[np.ndarray, " k"]) -> Bricks:
    """Return the table of some bricks; of the others nothing is known, so that their bound is 0."""
    present = np.zeros(bricks.slot.shape, bool)
    present[tuple(bricks.index[kept].T)] = True
    return replace(Bricks.of(present, bricks.far), left_out=(bricks.slot >= 0) & ~present)


def _in_chunks(place: Int[np.ndarray, " n"], count: int, rows: int) -> int:
    """Return how many of the bricks of a file lie in chunks of so many with one of some."""
    number = np.unique(place // rows)
    return int((np.minimum((number + 1) * rows, count) - number * rows).sum())


def _read_head(archive: Archive) -> tuple[Lattice, Metadata]:
    """Return what the group's attributes say."""
    head = archive.document("")["attributes"]
    require(head["kind"] == KIND, "its kind")
    version = head["metadata"]["format_version"]
    require(version == FORMAT_VERSION, f"format version {version}, this tool reads {FORMAT_VERSION}")
    shape = head["shape"]
    whole = len(shape) == 3 and all(isinstance(n, int) and 2 <= n <= _MOST_SAMPLES for n in shape)
    require(whole, "the shape of its lattice")
    return Lattice(
        np.array(head["origin"], np.float64), float(head["spacing"]), (shape[0], shape[1], shape[2])
    ), Metadata.model_validate_json(json.dumps(head["metadata"]))


def _assembled(lattice: Lattice, metadata: Metadata, bricks: Bricks, arrays: Mapping[str, np.ndarray]) -> Grid:
    """Build the grid."""
    records = {name: _record(kind, name, arrays) for name, kind in (("surface", FaceTable), ("layers", Layers))}
    channels = {name: arrays.get(name) for name in ("uv", "chart", "part")}
    return Grid(
        lattice,
        bricks,
        arrays["distance"],
        **channels,
        metadata=metadata,
        face=arrays.get("face"),
        surface=records["surface"],
        layers=records["layers"],
        error=arrays.get("error"),
    )


def _record(kind: Any, group: str, arrays: Mapping[str, np.ndarray]) -> Any:
    """Build a record of several arrays, or None where they were not read."""
    named = {name.partition(".")[2]: values for name, values in arrays.items() if name.startswith(f"{group}.")}
    return kind(**named) if named else None


def _check_values(metadata: Metadata, arrays: Mapping[str, np.ndarray]) -> None:
    """Look at the values that readers use as they are: numbers that must be finite, and indices."""
    for name in ("far", "distance", "uv", "error", "surface.vertices", "surface.uv", "layers.offset", "layers.scale"):
        require(name not in arrays or bool(np.isfinite(arrays[name]).all()), f"{name} is not finite")
    nobody = np.zeros(0, np.int32)
    charts = max(metadata.charts, 1)
    limits = {
        "part": (0, max(len(metadata.parts), 1)),
        "chart": (0, charts),
        "face": (-1, len(arrays.get("surface.corners", nobody))),
        "surface.corners": (0, len(arrays.get("surface.vertices", nobody))),
        "surface.chart": (0, charts),
        "layers.brick": (0, len(arrays["distance"])),
        "layers.chart": (0, len(arrays.get("layers.of", nobody))),
        "layers.of": (0, charts),
    }
    for name, (least, end) in limits.items():
        values = arrays.get(name, nobody)
        within = values.size == 0 or bool(values.min() >= least and values.max() < end)
        require(within, f"the ids of {name}")
