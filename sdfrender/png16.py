"""PNG of 16 bits per channel with colour or alpha, which Pillow reads as 8 bits.

In: a file. Out: its values as uint16, or None for any other file. ISO/IEC 15948; the rows' filters are undone along
diagonals, on which no value needs another.
"""

import zlib
from pathlib import Path

import numpy as np
from jaxtyping import UInt8, UInt16

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MOST_PIXELS = 2**27  # 1 GB of RGBA
_CHANNELS = {2: 3, 4: 2, 6: 4}  # by colour type: RGB, grey and alpha, RGBA; plain grey Pillow reads well


def read_deep_png(path: str | Path) -> UInt16[np.ndarray, "h w c"] | None:
    """Read a 16-bit PNG with more than one channel.

    Raises
    ------
    ValueError
        If the file is cut, interlaced, or larger than `MOST_PIXELS`.
    """
    with Path(path).open("rb") as file:
        head = file.read(33)
        if len(head) < 33 or head[:8] != SIGNATURE or head[24] != 16 or head[25] not in _CHANNELS:
            return None
        rest = file.read()
    width, height = (int.from_bytes(head[at : at + 4], "big") for at in (16, 20))
    if head[28] != 0:
        raise ValueError("16-bit colour that is interlaced: save it without")
    if not 0 < width * height <= MOST_PIXELS:
        raise ValueError(f"{width}x{height} pixels")
    channels = _CHANNELS[head[25]]
    expected = height * (1 + 2 * channels * width)
    try:
        raw = np.frombuffer(zlib.decompressobj().decompress(_chunks(rest, b"IDAT"), expected + 1), np.uint8)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    if len(raw) != expected:
        raise ValueError("image data of the wrong length")
    rows = raw.reshape(height, -1)
    values = _unfiltered(rows[:, 0], rows[:, 1:].reshape(height, width, 2 * channels))
    return values.view(">u2").astype(np.uint16)


def _chunks(data: bytes, kind: bytes) -> bytes:
    """Join the chunks of a kind."""
    found, at = [], 0
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == kind:
            found.append(data[at + 8 : at + 8 + length])
        at += 12 + length
    return b"".join(found)


def _unfiltered(kind: UInt8[np.ndarray, " h"], filtered: UInt8[np.ndarray, "h w b"]) -> UInt8[np.ndarray, "h w b"]:
    """Add what each row's filter predicts from the values to the left, above, and above on the left."""
    if kind.max(initial=0) > 4:
        raise ValueError("an unknown row filter")
    height, width, depth = filtered.shape
    out = np.zeros((height + 1, width + 1, depth), np.uint8)
    for diagonal in range(height + width - 1):
        y = np.arange(max(0, diagonal - width + 1), min(height, diagonal + 1))
        x = diagonal - y
        left, up, corner = (out[y + a, x + b].astype(np.int32) for a, b in ((1, 0), (0, 1), (0, 0)))
        guesses = (np.zeros_like(left), left, up, (left + up) // 2, _paeth(left, up, corner))
        guess = np.choose(kind[y][:, None], guesses)
        out[y + 1, x + 1] = (filtered[y, x] + guess).astype(np.uint8)
    return np.ascontiguousarray(out[1:, 1:])


def _paeth(left: np.ndarray, up: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Return whichever of three is nearest to left + up - corner; the first of those that are equally near."""
    by_left, by_up, by_corner = np.abs(up - corner), np.abs(left - corner), np.abs(left + up - 2 * corner)
    near = np.where((by_left <= by_up) & (by_left <= by_corner), left, np.where(by_up <= by_corner, up, corner))
    return np.asarray(near)
