"""Arrays into a grid file, and out of it, whole or some chunks of them.

In: an array, or an archive that nobody vouches for. Out: its chunks, or arrays. Every document, type, codec and size is
compared with what the layout allows before a chunk is decoded; the archive's CRC-32 is checked with every chunk that is
read.
"""

import json
import struct
import zipfile
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int
from numcodecs import blosc

from sdfbake.bricks import counts
from sdfbake.gridlayout import DATA_TYPES, LAYOUT, chunks, counted, is_chunk, is_lent
from sdfbake.lattice import Lattice

# Decoded bytes per byte of file. A table of empty space shrinks a thousandfold at most; more is a bomb.
_MOST_SHRINKAGE = 4096
_MOST_DOCUMENT = 1 << 20


class DistrustError(Exception):
    """Why a file was not believed."""


def require(condition: bool, reason: str) -> None:
    """Raise `DistrustError` unless a condition holds."""
    if not condition:
        raise DistrustError(reason)


class Archive:
    """The entries of a grid file, and how many of its bytes were read.

    Attributes
    ----------
    file
        The open archive.
    size
        Bytes of the file.
    read
        Bytes of the entries that were read, by the name of their array; the empty name is the head's.
    prefix
        What the names of a level's entries begin with.
    """

    def __init__(self, file: zipfile.ZipFile, path: Path) -> None:
        self.file, self.size, self.prefix = file, path.stat().st_size, ""
        self.read: dict[str, int] = {}
        entries = {info.filename: info for info in file.infolist()}
        require(sum(info.file_size for info in entries.values()) <= self.size, "the sizes of its entries")

    def within(self, prefix: str) -> "Archive":
        """Return the entries of a level; what is read of them is counted with the others."""
        found = copy(self)
        found.prefix = prefix
        return found

    def entry(self, name: str, rest: str, most: int | None = None) -> bytes:
        """Read an entry of an array whole, so that its CRC-32 is checked; it has at most so many bytes."""
        prefix = "" if is_lent(name) else self.prefix
        info = self.file.getinfo(prefix + (f"{name}/{rest}" if name else rest))
        plain = info.compress_type == zipfile.ZIP_STORED and (most is None or info.file_size <= most)
        require(plain, "the size of a document" if rest == "zarr.json" else "a chunk's header")
        self.read[name] = self.read.get(name, 0) + info.file_size
        return self.file.read(info)

    def document(self, name: str) -> Any:
        """Return the Zarr document of an array, or of the group for the empty name."""
        return json.loads(self.entry(name, "zarr.json", _MOST_DOCUMENT))


def checked(archive: Archive, names: Collection[str], lattice: Lattice) -> dict[str, tuple[tuple[int, ...], int]]:
    """Return the shapes of arrays, and their rows per chunk, once they are as the layout allows.

    The first array of every length says it for the others.
    """
    lengths: dict[str | int, int] = dict(zip(("bx", "by", "bz"), counts(lattice.shape), strict=True))
    found = {}
    for name in names:
        document, axes = archive.document(name), LAYOUT[name][0]
        claimed = document["shape"]
        require(isinstance(claimed, list) and len(claimed) == len(axes), f"the shape of {name}")
        for axis, length in zip(axes, claimed, strict=True):
            require(type(length) is int and length >= 0, f"the shape of {name}")
            require(length == (lengths.setdefault(axis, length) if isinstance(axis, str) else axis),
                    f"the shape of {name}")  # fmt: skip
        found[name] = (tuple(claimed), _rows(name, tuple(claimed), document))
    claims = counted({name: shape for name, (shape, _) in found.items()})
    require(claims <= _MOST_SHRINKAGE * archive.size, f"it claims to hold {claims} bytes")
    return found


def _rows(name: str, shape: tuple[int, ...], document: Any) -> int:
    """Return the rows of a chunk, after a look at all that a document says of how an array is stored."""
    claimed = document["chunk_grid"]["configuration"]["chunk_shape"]
    codecs = [codec["name"] for codec in document["codecs"]]
    require(document["node_type"] == "array", f"the kind of {name}")
    require(document["data_type"] == DATA_TYPES[LAYOUT[name][1]], f"the type of {name}")
    require(is_chunk(name, shape, claimed), f"the chunks of {name}")
    require(codecs == ["bytes", "blosc"] and not document.get("storage_transformers"), f"the codecs of {name}")
    return int(claimed[0])


def array(archive: Archive, name: str, shape: tuple[int, ...], rows: int) -> np.ndarray:
    """Decode an array whole."""
    chunk = (rows, *chunks(name, shape)[1:])
    out = np.empty(shape, LAYOUT[name][1])
    for at in product(*(range(-(-n // c)) for n, c in zip(shape, chunk, strict=True))):
        block = out[tuple(slice(i * c, (i + 1) * c) for i, c in zip(at, chunk, strict=True))]
        block[...] = _decoded(archive, name, at, chunk)[tuple(slice(0, n) for n in block.shape)]
    return out


def some_rows(
    archive: Archive, name: str, shape: tuple[int, ...], rows: int, wanted: Int[np.ndarray, " n"]
) -> np.ndarray:
    """Decode rows of an array, in the order in which they are named, and of its chunks only those that hold them."""
    out = np.empty((len(wanted), *shape[1:]), LAYOUT[name][1])
    order = np.argsort(wanted, kind="stable")
    number, first = np.unique(wanted[order] // rows, return_index=True)
    ends = np.append(first[1:], len(wanted))[: len(first)]
    for at, start, end in zip(number.tolist(), first.tolist(), ends.tolist(), strict=True):
        block = _decoded(archive, name, (at, *(0 for _ in shape[1:])), (rows, *shape[1:]))
        to = order[start:end]
        out[to] = block[wanted[to] - at * rows]
    return out


def _decoded(archive: Archive, name: str, at: tuple[int, ...], chunk: tuple[int, ...]) -> np.ndarray:
    """Decode a chunk, once its header says its true sizes."""
    kind = np.dtype(LAYOUT[name][1])
    data = archive.entry(name, "/".join(["c", *map(str, at)]))
    require(len(data) >= 16, "a chunk's header")
    decoded, _, stored = struct.unpack("<III", data[4:16])
    require(decoded == prod(chunk) * kind.itemsize and stored == len(data), "the size of a chunk")
    return np.frombuffer(blosc.decompress(data), kind).reshape(chunk)


def encoded(name: str, values: np.ndarray, shape: tuple[int, ...]) -> dict[str, bytes]:
    """Encode an array in chunks as Zarr does, all of one shape, what lies beyond the array 0; by their entries.

    Zarr's own writing goes chunk by chunk through its event loop, which takes longer than to encode small ones.
    """
    kind = np.dtype(LAYOUT[name][1])
    codec = blosc.Blosc(cname="zstd", clevel=5, shuffle=blosc.SHUFFLE)
    places = list(np.ndindex(*(-(-n // c) for n, c in zip(values.shape, shape, strict=True))))

    def chunk(at: tuple[int, ...]) -> bytes:
        found = values[tuple(slice(i * c, (i + 1) * c) for i, c in zip(at, shape, strict=True))]
        whole = np.zeros(shape, kind)
        whole[tuple(slice(n) for n in found.shape)] = found
        return bytes(codec.encode(whole))

    names = ("/".join([name, "c", *map(str, at)]) for at in places)
    with ThreadPoolExecutor() as pool:
        return dict(zip(names, pool.map(chunk, places), strict=True))
