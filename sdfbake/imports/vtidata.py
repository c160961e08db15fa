"""The arrays of VTK's XML files.

In: the bytes where an array begins, and how the file says it is written: ASCII, base64 or raw; plain or in blocks
packed by zlib, LZ4 or LZMA. Out: numbers, every length checked before it is believed. After "VTK File Formats", XML,
and `vtkXMLDataReader`.
"""

import base64
import binascii
import lzma
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Real

from sdfbake.imports.field import corrupt

TYPES: Mapping[str, str] = MappingProxyType({
    "Float32": "f4", "Float64": "f8", "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4",
    "UInt32": "u4", "Int64": "i8", "UInt64": "u8",
})  # fmt: skip
_ORDERS = {"LittleEndian": "<", "BigEndian": ">"}


@dataclass(frozen=True, slots=True)
class Layout:
    """How a file writes its arrays.

    Attributes
    ----------
    order
        "<" or ">", the order of bytes.
    lengths
        Type of the numbers before an array.
    unpack
        What takes a packed block and the size that it should have; None where nothing is packed.
    """

    order: str
    lengths: np.dtype[Any]
    unpack: Callable[[bytes, int], bytes] | None

    @staticmethod
    def of(attributes: Mapping[str, str], name: str) -> "Layout":
        """Read the attributes of a file's first element; `name` is the file's."""
        order = _ORDERS.get(attributes.get("byte_order", "LittleEndian"))
        lengths = {"UInt32": "u4", "UInt64": "u8"}.get(attributes.get("header_type", "UInt32"))
        packer = attributes.get("compressor", "")
        if order is None or lengths is None or packer not in _UNPACK:
            raise corrupt(name, f"it is written in a way that is not known, {dict(attributes)}")
        return Layout(order, np.dtype(order + lengths), _UNPACK[packer])


@dataclass(slots=True)
class _Run:
    """Bytes that are taken one after the other, out of base64 or as they are."""

    data: memoryview
    encoded: bool
    name: str
    at: int = 0

    def take(self, count: int, *, stay: bool = False) -> bytes:
        """Return the next bytes; in base64 they are a stretch of their own, unless the place is to stay."""
        length = -(-count // 3) * 4 if self.encoded else count
        piece = self.data[self.at : self.at + length] if count >= 0 else self.data[:0]
        if count < 0 or len(piece) < length:
            raise corrupt(self.name, f"an array of {count} bytes reaches beyond its end")
        self.at += 0 if stay else length
        try:
            # In base64 a stretch that goes on is cut at a whole group, and the last bytes of it are not asked for.
            return base64.b64decode(piece, validate=True)[:count] if self.encoded else bytes(piece)
        except binascii.Error:
            raise corrupt(self.name, "an array is no base64") from None

    def numbers(self, kind: np.dtype[Any], count: int, *, stay: bool = False) -> list[int]:
        """Return whole numbers."""
        return [int(n) for n in np.frombuffer(self.take(kind.itemsize * count, stay=stay), kind)]


def decoded(
    data: memoryview, kind: str, count: int, layout: Layout, *, encoded: bool, name: str
) -> Real[np.ndarray, " count"]:
    """Return an array that is written in binary.

    Parameters
    ----------
    data
        From the array's first byte on; more may follow.
    kind
        A key of `TYPES`.
    count
        Numbers that the array must have.
    layout
        How the file is written.
    encoded
        Whether in base64.
    name
        Of the file, for complaints.

    Raises
    ------
    BadInput
        If the lengths in the data do not agree with that, or a block does not unpack.
    """
    run, type_ = _Run(data, encoded, name), np.dtype(layout.order + TYPES[kind])
    size = count * type_.itemsize
    if layout.unpack is None:
        (length,) = run.numbers(layout.lengths, 1, stay=True)
        _agree(length, size, name)
        head = layout.lengths.itemsize
        if not encoded and len(data) >= head + size:  # as it lies in the file, without a copy
            return np.frombuffer(data[head:], type_, count)
        return np.frombuffer(run.take(head + size)[head:], type_)
    return np.frombuffer(_unpacked(run, layout, size), type_)


def written_out(text: str, kind: str, count: int, name: str) -> Real[np.ndarray, " count"]:
    """Return an array that is written in ASCII; parameters as for `decoded`."""
    try:
        values = np.array(text.split(), TYPES[kind])
    except (ValueError, OverflowError):
        raise corrupt(name, "an array holds other things than numbers") from None
    _agree(values.nbytes, count * values.itemsize, name)
    return values


def _unpacked(run: _Run, layout: Layout, size: int) -> bytes:
    """Return the blocks of an array in a row."""
    assert layout.unpack is not None
    (blocks,) = run.numbers(layout.lengths, 1, stay=True)
    if blocks > len(run.data):
        raise corrupt(run.name, f"an array would have {blocks} blocks")
    _, each, last, *lengths = run.numbers(layout.lengths, 3 + blocks)
    sizes = [each] * blocks
    if blocks and last:  # 0 where the last block is as long as the others
        sizes[-1] = last
    _agree(sum(sizes), size, run.name)
    packed = run.take(sum(lengths))
    ends = np.cumsum([0, *lengths]).tolist()
    unpacked = []
    for start, end, length in zip(ends, ends[1:], sizes, strict=False):
        try:
            block = layout.unpack(packed[start:end], length)
        except (zlib.error, lzma.LZMAError, RuntimeError, ValueError, EOFError):
            block = b""
        _agree(len(block), length, run.name)
        unpacked.append(block)
    return b"".join(unpacked)


def _agree(found: int, expected: int, name: str) -> None:
    if found != expected:
        raise corrupt(name, f"an array has {found} bytes where {expected} belong")


def _zlib(block: bytes, size: int) -> bytes:
    return zlib.decompressobj().decompress(block, size + 1)


def _lzma(block: bytes, size: int) -> bytes:
    return lzma.LZMADecompressor().decompress(block, size + 1)


def _lz4(block: bytes, size: int) -> bytes:
    from numcodecs import lz4  # takes its time to import, and most files need none

    return bytes(lz4.decompress(struct.pack("<I", size) + block))  # the size, as this decoder wants it


_UNPACK: Mapping[str, Callable[[bytes, int], bytes] | None] = MappingProxyType({
    "": None, "vtkZLibDataCompressor": _zlib, "vtkLZMADataCompressor": _lzma, "vtkLZ4DataCompressor": _lz4,
})  # fmt: skip
