"""One level of a grid file: what it says of itself, and its arrays, whole or in part.

In: an archive that nobody vouches for. Out: a `Grid` without levels, or a complaint. Shapes, types, codecs and sizes
are checked before an array is decoded (`sdfbake.gridchunks`), checksums and the values themselves after.
"""

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from sdfbake.bricks import Bricks
from sdfbake.faces import FaceTable
from sdfbake.grid import Grid
from sdfbake.gridchunks import Archive, array, checked, require, some_rows
from sdfbake.gridlayout import CHOICES, KIND, LAYOUT, TABLES, belongs
from sdfbake.lattice import Lattice
from sdfbake.layers import Layers
from sdfbake.metadata import FORMAT_VERSION, Metadata

# Which of the bricks of a file are wanted, in the order of their slots.
Choice = Callable[[Lattice, Bricks], Bool[np.ndarray, " k"]]
_MOST_SAMPLES = 1 << 16  # along an axis: far above what a bake makes, far below where an index overflows
_MOST_LEVELS = 15  # of such an axis


@dataclass(frozen=True, slots=True)
class Reading:
    """How much of a file was read: channels, bricks that were decoded and that there are, bytes and those of the file.

    How many bricks there are is None where nothing but the head was read. The numbers of the levels that were read
    come with them, 0 for the finest.
    """

    channels: tuple[str, ...]
    bricks: int
    of_bricks: int | None
    bytes: int
    of_bytes: int
    levels: tuple[int, ...] = (0,)


def together(readings: Sequence[Reading]) -> Reading:
    """Add up what was read of several levels of one file."""
    return replace(
        readings[0],
        bricks=sum(reading.bricks for reading in readings),
        of_bricks=sum(reading.of_bricks or 0 for reading in readings),
        bytes=sum(reading.bytes for reading in readings),
        levels=tuple(level for reading in readings for level in reading.levels),
    )


class Head(NamedTuple):
    """What a file, or one level of it, says of itself; `levels` is the number of coarser ones that follow."""

    lattice: Lattice
    metadata: Metadata
    levels: int


def read_head(archive: Archive) -> Head:
    """Return what the group's attributes say."""
    head = archive.document("")["attributes"]
    require(head["kind"] == KIND, "its kind")
    version = head["metadata"]["format_version"]
    require(version == FORMAT_VERSION, f"format version {version}, this tool reads {FORMAT_VERSION}")
    shape, levels = head["shape"], head.get("levels", 0)
    whole = len(shape) == 3 and all(isinstance(n, int) and 2 <= n <= _MOST_SAMPLES for n in shape)
    require(whole, "the shape of its lattice")
    require(type(levels) is int and 0 <= levels <= _MOST_LEVELS, "the number of its levels")
    lattice = Lattice(np.array(head["origin"], np.float64), float(head["spacing"]), (shape[0], shape[1], shape[2]))
    return Head(lattice, Metadata.model_validate_json(json.dumps(head["metadata"])), levels)


def read_level(
    archive: Archive,
    head: Head,
    channels: Collection[str] | None,
    wanted: Choice | None,
    lent: FaceTable | None = None,
) -> tuple[Grid, Reading]:
    """Check a level's claims, then decode what is wanted; the table of faces is not read again where it is lent."""
    lattice, metadata, _ = head
    names = _names(metadata)
    shapes = checked(archive, names, lattice)
    names = [name for name in names if belongs(name, channels)]
    slot, far = (array(archive, name, *shapes[name]) for name in TABLES)
    bricks = Bricks.of(slot >= 0, far)
    place = slot[tuple(bricks.index.T)]
    every = len(bricks) == shapes["distance"][0][0] and np.array_equal(np.sort(place), np.arange(len(bricks)))
    require(every and bool((slot >= -1).all()), "its table of bricks")
    kept = np.ones(len(bricks), bool) if wanted is None else wanted(lattice, bricks)
    known = {"slot": bricks.slot, "far": far, **({} if lent is None else group_of("surface", lent))}
    arrays = known | _of_bricks(archive, [name for name in names if name not in known], shapes, place, kept)
    for name in names if kept.all() else TABLES:
        require(checksum(arrays[name]) == metadata.checksums[name], f"the checksum of {name}")
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


def group_of(group: str, record: FaceTable | Layers) -> dict[str, np.ndarray]:
    """Return the arrays of a record by their names in a file."""
    names = [name for name in LAYOUT if name.startswith(f"{group}.")]
    return {name: getattr(record, name.partition(".")[2]) for name in names}


def checksum(values: np.ndarray) -> str:
    """Return the SHA-256 of an array's little-endian bytes in C order."""
    return hashlib.sha256(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).data).hexdigest()


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
        if name in arrays:
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


def _assembled(lattice: Lattice, metadata: Metadata, bricks: Bricks, arrays: Mapping[str, np.ndarray]) -> Grid:
    """Build the grid."""
    records = {name: _record(kind, name, arrays) for name, kind in (("surface", FaceTable), ("layers", Layers))}
    return Grid(
        lattice,
        bricks,
        arrays["distance"],
        arrays.get("uv"),
        arrays.get("chart"),
        arrays.get("part"),
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
