"""Which arrays a grid file has, of which shapes and types, and in which chunks.

In: nothing. Out: the layout that `sdfbake.gridfile` writes, and the most that `sdfbake.gridchunks` believes.
"""

from collections.abc import Collection, Mapping
from math import prod

import numpy as np
from jaxtyping import Int

from sdfbake.bricks import SIDE
from sdfbake.grid import CHANNELS, KERNELS

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
TABLES = ("slot", "far")
# What can be asked for beside the distance.
CHOICES = ("uv", "chart", "part", "face", "layers", "error")
DATA_TYPES = {"<f8": "float64", "<f4": "float32", "<f2": "float16", "<i4": "int32", "<u2": "uint16", "|u1": "uint8",
              "|i1": "int8"}  # fmt: skip
CHUNK_BYTES = 1 << 20
_TABLE_CHUNK = 64
# Bricks, or rows of a layer, in a chunk: few, as one that a picture needs brings the others along; with fewer still,
# the archive's entries and what Blosc saves on long chunks cost more than three hundredths of the file.
_BRICKS_CHUNK = 16


def level_prefix(number: int) -> str:
    """Return what the names of a coarser level's entries begin with; of the finest nothing."""
    return f"level{number}/" if number else ""


def is_lent(name: str) -> bool:
    """Say whether an array is stored once for all levels: the table of faces, which no lattice changes."""
    return name.startswith("surface.")


def chunks(name: str, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the chunk shape of an array.

    It is a block of a table over the lattice, or 16 bricks, or as many rows of another array as make about a megabyte.
    """
    axes, kind = LAYOUT[name]
    if axes[0] == "bx":
        return tuple(min(n, _TABLE_CHUNK) for n in shape)
    rows = _BRICKS_CHUNK if axes[1:2] == (SIDE,) else CHUNK_BYTES // row_bytes(shape, kind)
    return (max(1, min(shape[0], rows)), *shape[1:])


def file_order(index: Int[np.ndarray, "k 3"]) -> Int[np.ndarray, " k"]:
    """Return the order in which bricks are stored: along Morton's curve, so that the bricks of a chunk lie together."""
    code = np.zeros(len(index), np.int64)
    for bit in range(int(index.max(initial=0)).bit_length()):
        for axis in range(3):
            code |= ((index[:, axis].astype(np.int64) >> bit) & 1) << (3 * bit + 2 - axis)
    return np.argsort(code, kind="stable")


def row_bytes(shape: tuple[int, ...], kind: str) -> int:
    """Return the bytes of one row of an array."""
    return prod(shape[1:]) * np.dtype(kind).itemsize


def is_chunk(name: str, shape: tuple[int, ...], claimed: object) -> bool:
    """Say whether an array may have such chunks: those that are written now, or other rows of at most a megabyte."""
    written = chunks(name, shape)
    if LAYOUT[name][0][0] == "bx":
        return claimed == list(written)
    if not (isinstance(claimed, list) and len(claimed) == len(shape) and claimed[1:] == list(shape[1:])):
        return False
    rows = claimed[0]
    return type(rows) is int and rows >= 1 and (rows == 1 or rows * row_bytes(shape, LAYOUT[name][1]) <= CHUNK_BYTES)


def belongs(name: str, channels: Collection[str] | None) -> bool:
    """Say whether an array is read for the sake of some channels; None stands for all of them."""
    if channels is None:
        return True
    needed = {*TABLES, "distance"} | set(channels) | ({"surface"} if "face" in channels else set())
    return name.partition(".")[0] in needed


def counted(shapes: Mapping[str, tuple[int, ...]]) -> int:
    """Return the bytes that arrays of these shapes take."""
    return sum(prod(shape) * np.dtype(LAYOUT[name][1]).itemsize for name, shape in shapes.items())
