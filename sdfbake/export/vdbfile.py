"""OpenVDB files, format version 224.

In: named channels and the lattice they lie on. Out: a file that OpenVDB 3.3 and later reads. Compression is of inactive
values only, so that nothing but NumPy is needed; the format is that of openvdb/io/Archive.cc and tree/*.h.
"""

import hashlib
import struct
import uuid
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from sdfbake.atomic import replacing
from sdfbake.export.vdbtree import Channel, Place, Tree
from sdfbake.lattice import Lattice

_MAGIC, _FORMAT, _LIBRARY = 0x56444220, 224, (10, 0)
_ACTIVE_VALUES = 2  # of the flags of compression
_TYPES = {("f", 4): "float", ("f", 5): "vec3s", ("b", 4): "bool"}  # by the kind and the axes of the values
Entry = str | bool | int | Place


@dataclass(frozen=True, slots=True)
class Named:
    """A channel with what a file says about it.

    Attributes
    ----------
    name
        Unique in its file.
    channel
        The values.
    entries
        Metadata: text, truth values, whole numbers (64 bits), or three of them (32 bits).
    """

    name: str
    channel: Channel
    entries: Mapping[str, Entry]


def save(path: Path, lattice: Lattice, grids: Sequence[Named]) -> None:
    """Write channels, whole or not at all; index space is the lattice's.

    Raises
    ------
    BadInput
        If the file cannot be written.
    """
    with ThreadPoolExecutor() as pool:
        bodies = list(pool.map(lambda grid: _body(grid, lattice), grids))
    # What identifies a file is made of its content: the same grid gives the same bytes.
    digest = hashlib.blake2b(digest_size=16)
    for parts in bodies:
        for part in parts:
            digest.update(part)
    head = struct.pack("<qIII?", _MAGIC, _FORMAT, *_LIBRARY, True) + str(uuid.UUID(bytes=digest.digest())).encode()
    head += struct.pack("<II", 0, len(grids))  # no metadata of the file
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(head)
        for grid, (start, topology, buffers) in zip(grids, bodies, strict=True):
            names = _text(grid.name) + _text(f"Tree_{_kind(grid.channel)}_5_4_3") + _text("")
            at = file.tell() + len(names) + 24
            blocks = at + len(start) + len(topology)
            file.write(names + struct.pack("<qqq", at, blocks, blocks + len(buffers)))
            file.writelines((start, topology, buffers))


def _body(grid: Named, lattice: Lattice) -> tuple[bytes, bytes, bytes]:
    """Return metadata and transform, topology, and values of a grid."""
    made = Tree.of(grid.channel)
    # What readers that do not look at the tree want to know.
    facts: dict[str, Entry] = {"name": grid.name, "file_voxel_count": made.voxels}
    if made.box is not None:
        facts |= {"file_bbox_min": made.box[0], "file_bbox_max": made.box[1]}
    start = struct.pack("<I", _ACTIVE_VALUES) + _metadata({**facts, **grid.entries}) + _transform(lattice)
    return start, made.topology, made.buffers


def _kind(channel: Channel) -> str:
    """Return the format's name of a channel's type."""
    return _TYPES[channel.values.dtype.kind, channel.values.ndim]


def _text(text: str) -> bytes:
    """Return a string with its length."""
    return struct.pack("<I", len(text.encode())) + text.encode()


def _metadata(entries: Mapping[str, Entry]) -> bytes:
    """Return a table of entries, each with its type and size, by name."""
    coded = struct.pack("<I", len(entries))
    for name in sorted(entries):
        kind, value = _entry(entries[name])
        coded += _text(name) + _text(kind) + struct.pack("<I", len(value)) + value
    return coded


def _entry(value: Entry) -> tuple[str, bytes]:
    """Return the type and the bytes of an entry."""
    if isinstance(value, str):
        return "string", value.encode()
    if isinstance(value, bool):
        return "bool", struct.pack("<?", value)
    if isinstance(value, int):
        return "int64", struct.pack("<q", value)
    return "vec3i", struct.pack("<3i", *value)


def _transform(lattice: Lattice) -> bytes:
    """Return the map from index to world: origin + spacing * index, and what readers would else compute of it."""
    h = lattice.spacing
    rows = [lattice.origin.tolist(), *([number] * 3 for number in (h, h, 1 / h, 1 / h**2, 1 / (2 * h)))]
    return _text("UniformScaleTranslateMap") + b"".join(struct.pack("<3d", *row) for row in rows)
