"""The grid asset on disk: Zarr v3 arrays in one ZIP archive.

In: a `Grid` and a path. Out: a file that appears whole or not at all, with the same bytes for the same grid; and back.
A reader trusts nothing: shapes, types, codecs and sizes are checked before any array is decoded, checksums after.
"""

import hashlib
import json
import struct
import zipfile
from collections.abc import Callable, Collection, Mapping
from math import prod
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import zarr
from zarr.codecs import BloscCodec
from zarr.storage import MemoryStore, ZipStore

from sdfbake.atomic import replacing
from sdfbake.bricks import SIDE, Bricks, counts
from sdfbake.complaint import BadInput
from sdfbake.faces import FaceTable
from sdfbake.grid import CHANNELS, KERNELS, Grid
from sdfbake.lattice import Lattice
from sdfbake.layers import Layers
from sdfbake.metadata import FORMAT_VERSION, Metadata

Result = TypeVar("Result")
KIND = "sdf-ray-differentials grid"
# Every array that a file may have: its axes (a letter is a length that several arrays share) and how it is stored.
_BRICK = ("k", SIDE, SIDE, SIDE)
_ROW = ("m", SIDE, SIDE, SIDE)
LAYOUT: dict[str, tuple[tuple[str | int, ...], str]] = {
    "slot": (("bx", "by", "bz"), "<i4"),
    "far": (("bx", "by", "bz"), "<f4"),
    **{name: ((*_BRICK, *width), kind) for name, (width, kind) in CHANNELS.items()},
    "error": (("k", len(KERNELS)), "<f4"),
    "surface.vertices": (("v", 3), "<f8"),
    "surface.corners": (("f", 3), "<i4"),
    "surface.uv": (("f", 3, 2), "<f8"),
    "surface.chart": (("f",), "<i4"),
    "layers.brick": (("m",), "<i4"),
    "layers.chart": (("m",), "<i4"),
    "layers.uv": ((*_ROW, 2), "<u2"),
    "layers.border": (_ROW, "<f2"),
    "layers.normal": ((*_ROW, 3), "|i1"),
    "layers.offset": (("c", 2), "<f8"),
    "layers.scale": (("c", 2), "<f8"),
    "layers.of": (("c",), "<i4"),
}
# What can be asked for beside the distance.
CHOICES = ("uv", "chart", "part", "face", "layers", "error")
_DATA_TYPES = {"<f8": "float64", "<f4": "float32", "<f2": "float16", "<i4": "int32", "<u2": "uint16", "|u1": "uint8",
               "|i1": "int8"}  # fmt: skip
_CHUNK_BYTES = 1 << 20
_TABLE_CHUNK = 64
_MOST_SAMPLES = 1 << 16  # along an axis: far above what a bake makes, far below where an index overflows
# Decoded bytes per byte of file. A table of empty space shrinks a thousandfold at most; more is a bomb.
_MOST_SHRINKAGE = 4096
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
        If the file cannot be written.
    """
    with replacing(path) as temporary:
        _write_archive(temporary, _encoded(grid))


def load(path: str | Path, channels: Collection[str] | None = None) -> Grid:
    """Read a grid.

    Parameters
    ----------
    path
        A file written by `save`.
    channels
        Which of `CHOICES` to read; None for all that the file has. Others are None in the result; the distance is
        always read, and the table of faces comes with their ids.

    Raises
    ------
    BadInput
        If there is no such file, or it is no grid, cut short, altered, or of another version.
    """
    unknown = sorted(set(channels or ()) - {"distance", *CHOICES})
    if unknown:
        raise BadInput(f"a grid has no channel {unknown[0]!r}: choose from {', '.join(CHOICES)}")
    return _trusting(path, lambda file: _read(file, channels))


def describe(path: str | Path) -> Metadata:
    """Read what a grid file says about itself, and none of its arrays; errors are those of `load`."""

    def head(file: Path) -> Metadata:
        with zipfile.ZipFile(file) as archive:
            return _read_head(archive)[1]

    return _trusting(path, head)


def _trusting(path: str | Path, read: Callable[[Path], Result]) -> Result:
    """Read a file, and say in one sentence what is wrong with it."""
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"there is no grid file {path}: bake one with 'python -m sdfbake bake'")
    try:
        return read(path)
    except PermissionError:
        raise BadInput(f"the grid file {path} may not be read: check its permissions") from None
    except (_DistrustError, *_BROKEN) as error:
        reason = f" ({error})" if isinstance(error, _DistrustError) else ""
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


class _DistrustError(Exception):
    """Why a file was not believed."""


# What zipfile, json, zarr, numcodecs and pydantic raise on broken bytes (pydantic's error is a ValueError).
_BROKEN = (zipfile.BadZipFile, OSError, EOFError, ValueError, KeyError, TypeError, RuntimeError, MemoryError,
           NotImplementedError, OverflowError, BadInput)  # fmt: skip


def _require(condition: bool, reason: str) -> None:
    if not condition:
        raise _DistrustError(reason)


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
    arrays = _arrays(grid)
    metadata = grid.metadata.model_copy(update={"checksums": {name: _checksum(a) for name, a in arrays.items()}})
    entries: dict[str, Any] = {}
    group = zarr.create_group(MemoryStore(entries), zarr_format=3, attributes={
        "kind": KIND,
        "origin": grid.lattice.origin.tolist(),
        "spacing": grid.lattice.spacing,
        "shape": list(grid.lattice.shape),
        "metadata": metadata.model_dump(mode="json"),
    })  # fmt: skip
    for name, values in arrays.items():
        kind = LAYOUT[name][1]
        array = group.create_array(
            name,
            shape=values.shape,
            chunks=_chunks(name, values.shape),
            dtype=np.dtype(kind),
            compressors=BloscCodec(cname="zstd", clevel=5, shuffle="shuffle", typesize=np.dtype(kind).itemsize),
            filters=None,
            fill_value=0,
            config={"write_empty_chunks": True},
        )
        array[...] = values
    return {name: buffer.to_bytes() for name, buffer in entries.items()}


def _checksum(values: np.ndarray) -> str:
    """Return the SHA-256 of an array's little-endian bytes in C order."""
    return hashlib.sha256(values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes()).hexdigest()


def _chunks(name: str, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the chunk shape of an array: a block of a table over the lattice, else rows that make about a megabyte."""
    axes, kind = LAYOUT[name]
    if axes[0] == "bx":
        return tuple(min(n, _TABLE_CHUNK) for n in shape)
    row = prod(shape[1:]) * np.dtype(kind).itemsize
    return (max(1, min(shape[0], _CHUNK_BYTES // row)), *shape[1:])


def _write_archive(path: Path, entries: Mapping[str, bytes]) -> None:
    """Write entries sorted, uncompressed (the chunks are already) and without a clock."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(entries):
            info = zipfile.ZipInfo(name, _DATE)
            info.create_system, info.external_attr = 3, 0o644 << 16
            archive.writestr(info, entries[name])


def _read(path: Path, channels: Collection[str] | None) -> Grid:
    """Check the file's claims, then decode what is wanted."""
    with zipfile.ZipFile(path) as archive:
        lattice, metadata = _read_head(archive)
        names = [name for name in LAYOUT if name in metadata.checksums]
        _require(set(names) == set(metadata.checksums) >= {"slot", "far", "distance"}, "its list of arrays")
        for group in ("surface", "layers"):
            _require(len({n in names for n in LAYOUT if n.startswith(f"{group}.")}) == 1, f"its arrays of {group}")
        _require(("face" in names) == ("surface.corners" in names), "its arrays of faces")
        _check_sizes(archive, path, _shapes(archive, names, lattice))
    wanted = [name for name in names if channels is None or _belongs(name, channels)]
    store = ZipStore(path, mode="r")
    try:
        group = zarr.open_group(store, mode="r", zarr_format=3)
        arrays = {name: np.asarray(group[name][...]) for name in wanted}
    finally:
        store.close()
    for name, values in arrays.items():
        _require(_checksum(values) == metadata.checksums[name], f"the checksum of {name}")
    return _assembled(lattice, metadata, arrays)


def _belongs(name: str, channels: Collection[str]) -> bool:
    """Say whether an array is read for the sake of some channels."""
    needed = {"slot", "far", "distance"} | set(channels) | ({"surface"} if "face" in channels else set())
    return name.partition(".")[0] in needed


def _shapes(archive: zipfile.ZipFile, names: Collection[str], lattice: Lattice) -> dict[str, tuple[int, ...]]:
    """Return the shapes that the arrays must have, once the first array of every length has said it."""
    lengths: dict[str | int, int] = dict(zip(("bx", "by", "bz"), counts(lattice.shape), strict=True))
    shapes = {}
    for name in names:
        axes = LAYOUT[name][0]
        claimed = _document(archive, name)["shape"]
        _require(len(claimed) == len(axes), f"the shape of {name}")
        for axis, length in zip(axes, claimed, strict=True):
            _require(isinstance(length, int) and length >= 0, f"the shape of {name}")
            expected = lengths.setdefault(axis, length) if isinstance(axis, str) else axis
            _require(length == expected, f"the shape of {name}")
        shapes[name] = tuple(claimed)
    return shapes


def _document(archive: zipfile.ZipFile, name: str) -> Any:
    """Return the Zarr document of an array, or of the group for the empty name."""
    info = archive.getinfo(f"{name}/zarr.json" if name else "zarr.json")
    _require(info.compress_type == zipfile.ZIP_STORED and info.file_size <= 1 << 20, "the size of a document")
    return json.loads(archive.read(info))


def _read_head(archive: zipfile.ZipFile) -> tuple[Lattice, Metadata]:
    """Return what the group's attributes say."""
    head = _document(archive, "")["attributes"]
    _require(head["kind"] == KIND, "its kind")
    version = head["metadata"]["format_version"]
    _require(version == FORMAT_VERSION, f"format version {version}, this tool reads {FORMAT_VERSION}")
    shape = head["shape"]
    whole = len(shape) == 3 and all(isinstance(n, int) and 2 <= n <= _MOST_SAMPLES for n in shape)
    _require(whole, "the shape of its lattice")
    return Lattice(
        np.array(head["origin"], np.float64), float(head["spacing"]), (shape[0], shape[1], shape[2])
    ), Metadata.model_validate_json(json.dumps(head["metadata"]))


def _check_sizes(archive: zipfile.ZipFile, path: Path, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse arrays that are not as `save` writes them, before anything is decoded or allocated."""
    actual = path.stat().st_size
    entries = {info.filename: info for info in archive.infolist()}
    _require(sum(info.file_size for info in entries.values()) <= actual, "the sizes of its entries")
    kinds = {name: LAYOUT[name][1] for name in shapes}
    claimed = sum(prod(shape) * np.dtype(kinds[name]).itemsize for name, shape in shapes.items())
    _require(claimed <= _MOST_SHRINKAGE * actual, f"it claims to hold {claimed} bytes")
    for name, shape in shapes.items():
        document, chunk = _document(archive, name), _chunks(name, shape)
        codecs = [codec["name"] for codec in document["codecs"]]
        _require(document["node_type"] == "array" and document["shape"] == list(shape), f"the shape of {name}")
        _require(document["data_type"] == _DATA_TYPES[kinds[name]], f"the type of {name}")
        _require(document["chunk_grid"]["configuration"]["chunk_shape"] == list(chunk), f"the chunks of {name}")
        _require(codecs == ["bytes", "blosc"] and not document.get("storage_transformers"), f"the codecs of {name}")
        bytes_per_chunk = prod(chunk) * np.dtype(kinds[name]).itemsize
        for at in np.ndindex(*(-(-n // c) for n, c in zip(shape, chunk, strict=True))):
            _check_chunk(archive, entries["/".join([name, "c", *map(str, at)])], bytes_per_chunk)


def _check_chunk(archive: zipfile.ZipFile, info: zipfile.ZipInfo, expected: int) -> None:
    """Compare what a Blosc chunk's header says with its true sizes."""
    with archive.open(info) as stream:
        header = stream.read(16)
    _require(info.compress_type == zipfile.ZIP_STORED and len(header) == 16, "a chunk's header")
    decoded, _, stored = struct.unpack("<III", header[4:])
    _require(decoded == expected and stored == info.file_size, "the size of a chunk")


def _assembled(lattice: Lattice, metadata: Metadata, arrays: Mapping[str, np.ndarray]) -> Grid:
    """Build the grid after a last look at the values that others rely on."""
    slot, far = arrays["slot"], arrays["far"]
    bricks = Bricks.of(slot >= 0, far)
    same = np.array_equal(bricks.slot, slot) and len(bricks) == len(arrays["distance"])
    _require(same, "its table of bricks")
    _check_values(metadata, arrays)
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
        _require(name not in arrays or bool(np.isfinite(arrays[name]).all()), f"{name} is not finite")
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
        _require(within, f"the ids of {name}")
    rows = arrays.get("layers.brick", nobody)
    _require(bool((np.diff(rows) >= 0).all()), "the order of its layers")
