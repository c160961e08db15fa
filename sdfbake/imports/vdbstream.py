"""The small parts that OpenVDB files are made of.

In: the bytes of a file. Out: numbers, strings, masks and runs of values from a moving place, every length checked
before anything is allocated. After OpenVDB 10, `io/Compression.h` (file versions 222 to 225).
"""

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from sdfbake.imports.field import corrupt

ZIP, ACTIVE_MASK, BLOSC = 1, 2, 4  # flags of compression
_LONGEST = 1 << 16  # bytes of a name


@dataclass(slots=True)
class Cursor:
    """A place in a file that moves on with every read.

    Attributes
    ----------
    data
        The whole file.
    name
        Of the file, for complaints.
    at
        The next byte.
    """

    data: memoryview
    name: str
    at: int = 0

    def take(self, count: int) -> memoryview:
        """Return the next bytes; BadInput where the file has no more."""
        if not 0 <= count <= len(self.data) - self.at:
            raise corrupt(self.name, f"at byte {self.at} it should go on for {count} bytes more and does not")
        self.at += count
        return self.data[self.at - count : self.at]

    def numbers(self, code: str) -> tuple[Any, ...]:
        """Return little-endian numbers by their codes of `struct`."""
        layout = struct.Struct("<" + code)
        return layout.unpack(self.take(layout.size))

    def number(self, code: str) -> Any:
        """Return one number."""
        return self.numbers(code)[0]

    def text(self) -> str:
        """Return a string with its length before it."""
        length = self.number("I")
        if length > _LONGEST:
            raise corrupt(self.name, f"a name at byte {self.at} would have {length} letters")
        return bytes(self.take(length)).decode("utf-8", "replace")

    def mask(self, count: int) -> Bool[np.ndarray, " count"]:
        """Return that many bits, the least of every byte first."""
        return np.unpackbits(np.frombuffer(self.take(count // 8), np.uint8), bitorder="little").view(bool)

    def metadata(self) -> dict[str, tuple[str, bytes]]:
        """Return types and bytes of a table of named values."""
        table = {}
        for _ in range(self.number("I")):
            name, kind = self.text(), self.text()
            table[name] = (kind, bytes(self.take(self.number("I"))))
        return table


@dataclass(frozen=True, slots=True)
class Coding:
    """How a grid's runs of values are written.

    Attributes
    ----------
    compression
        Sum of `ZIP` or `BLOSC`, and `ACTIVE_MASK`.
    kind
        Type of the tree's values, little-endian.
    stored
        Type in runs: float16 where a grid is saved as half.
    background
        What is not stored.
    """

    compression: int
    kind: np.dtype[Any]
    stored: np.dtype[Any]
    background: float

    def run(self, cursor: Cursor, active: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Read the values of a node whose active ones are marked; the others follow one of seven schemes."""
        scheme = cursor.number("b")
        if not 0 <= scheme <= 6:
            raise corrupt(cursor.name, f"scheme {scheme} of inactive values at byte {cursor.at} does not exist")
        size = self.kind.itemsize
        off, on = (self.background if scheme == 0 else -self.background), self.background
        if scheme in (2, 4, 5):
            off = np.frombuffer(cursor.take(size), self.kind)[0]
        if scheme == 5:
            on = np.frombuffer(cursor.take(size), self.kind)[0]
        chosen = cursor.mask(len(active)) if scheme in (3, 4, 5) else None
        if scheme == 6 or not self.compression & ACTIVE_MASK:
            return self._values(cursor, len(active))
        values = np.full(len(active), off, self.kind) if chosen is None else np.where(chosen, on, off).astype(self.kind)
        values[active] = self._values(cursor, int(np.count_nonzero(active)))
        return values

    def _values(self, cursor: Cursor, count: int) -> Float[np.ndarray, " count"]:
        """Return values in a row."""
        if count == 0 and self.stored != self.kind:  # the writer of halves leaves out even the length
            return np.empty(0, self.kind)
        payload = self._payload(cursor, count * self.stored.itemsize)
        return np.frombuffer(payload, self.stored).astype(self.kind, copy=False)

    def _payload(self, cursor: Cursor, size: int) -> bytes | memoryview:
        """Return that many bytes, unpacked; a length of 0 or less says that they are not packed."""
        if not self.compression & (ZIP | BLOSC):
            return cursor.take(size)
        length = cursor.number("q")
        if length <= 0:
            if -length != size:
                raise corrupt(cursor.name, f"{-length} bytes at byte {cursor.at} should be {size}")
            return cursor.take(size)
        packed = cursor.take(length)
        unpacked = _unzip(packed, size) if self.compression & ZIP else _unblosc(packed, size)
        if unpacked is None:
            raise corrupt(cursor.name, f"the {length} bytes before byte {cursor.at} do not unpack to {size}")
        return unpacked


def _unzip(packed: memoryview, size: int) -> bytes | None:
    """Return what was packed by zlib, None where it is not of that size."""
    try:
        unpacked = zlib.decompressobj().decompress(packed, size + 1)
    except zlib.error:
        return None
    return unpacked if len(unpacked) == size else None


def _unblosc(packed: memoryview, size: int) -> bytes | None:
    """Return what was packed by Blosc, None where its header does not say that size or it does not unpack."""
    from numcodecs import blosc  # takes its time to import, and most imports need none

    if len(packed) < 16:
        return None
    says, _, length = struct.unpack("<3I", packed[4:16])
    if says != size or length != len(packed):
        return None
    if size == 0:  # a node without active values; the decoder takes it for an error
        return b""
    try:
        return bytes(blosc.decompress(bytes(packed)))
    except (RuntimeError, ValueError):
        return None
