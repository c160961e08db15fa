"""Mitsuba's grid volumes, version 3.

In: a `.vol` file: "VOL", a version byte, five int32 (type, samples along x, y, z, channels), the box as six float32
(least and greatest corner), samples with x fastest. Out: `Field`, its first and last samples on the faces of the box.
"""

import struct
from math import prod
from pathlib import Path

import numpy as np

from sdfbake.complaint import BadInput
from sdfbake.imports.field import Field, corrupt, require_lattice, require_memory

_HEADER = struct.Struct("<3sB5i6f")
_TYPES = {1: "float32", 2: "float16", 3: "uint8"}


def read(path: Path) -> Field:
    """Read a volume of one float32 channel.

    Raises
    ------
    BadInput
        For another version, type or number of channels, or a size that does not match the header.
    """
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
    if len(head) < _HEADER.size or not head.startswith(b"VOL"):
        raise corrupt(path.name, "it does not begin like a Mitsuba volume")
    _, version, kind, *shape, channels, x0, y0, z0, x1, y1, z1 = _HEADER.unpack(head)
    if version != 3:
        raise BadInput(f"{path.name} is a volume of version {version} and version 3 is read: convert it by Mitsuba")
    if kind != 1 or channels != 1:
        raise BadInput(
            f"{path.name} holds {channels} channels of type {_TYPES.get(kind, kind)} and distances are one float32: "
            "convert it by Mitsuba's VolumeGrid"
        )
    if min(shape) < 2:
        raise corrupt(path.name, f"its header says {' x '.join(map(str, shape))} samples")
    size, expected = path.stat().st_size, _HEADER.size + 4 * prod(shape)
    if size != expected:
        raise corrupt(path.name, f"its header says {expected} bytes and there are {size}")
    require_memory(path.name, tuple(shape))
    low, high = np.array([[x0, y0, z0], [x1, y1, z1]], np.float64)
    spacing = (high - low) / (np.array(shape) - 1)
    require_lattice(path.name, low, spacing)
    samples = np.memmap(path, "<f4", "r", _HEADER.size, tuple(shape[::-1]))
    return Field(samples.T, low, spacing)
