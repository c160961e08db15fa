"""What reading a grid file would take, without doing it.

In: a file, and which channels and bricks are wanted. Out: the `Reading` that `sdfbake.gridfile.load_counted` would
return, and the file's bricks. Of the file its head and its tables are read.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int

from sdfbake.bricks import Bricks
from sdfbake.gridchunks import Archive, array, checked, require
from sdfbake.gridfile import opened
from sdfbake.gridlayout import CHOICES, LAYOUT, TABLES, belongs, is_lent, level_prefix
from sdfbake.gridreading import Reading, read_head

_OWNER = "layers.brick"  # which brick a row of layers is of


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """What a grid file says of its bricks.

    Attributes
    ----------
    bricks
        Those that it has.
    place
        Where each is in the file.
    owner
        The place of the brick that each row of layers is of; empty without layers.
    shapes
        Of every array its shape, and the rows of a chunk.
    sizes
        Bytes of every entry of the file.
    whole
        Bytes of the file.
    level
        Which level of the file this is, the finest being 0.
    """

    bricks: Bricks
    place: Int[np.ndarray, " k"]
    owner: Int[np.ndarray, " m"]
    shapes: Mapping[str, tuple[tuple[int, ...], int]]
    sizes: Mapping[str, int]
    whole: int
    level: int = 0

    @staticmethod
    def of(path: str | Path, level: int = 0) -> "Tables":
        """Read the tables of a level of a file.

        Raises
        ------
        BadInput
            If there is no such file, or its head or its tables are broken.
        """
        return opened(path, partial(_read, level))

    def foretell(self, channels: Collection[str], kept: Bool[np.ndarray, " k"] | None = None) -> Reading:
        """Say how much of the file would be read.

        Parameters
        ----------
        channels
            As for `sdfbake.gridfile.load_counted`.
        kept
            Which of the bricks are wanted; None for all.
        """
        kept = np.ones(len(self.place), bool) if kept is None else kept
        names = [name for name in self.shapes if belongs(name, channels)]
        wanted = np.zeros(len(self.place), bool)
        wanted[self.place[kept]] = True
        rows = {"k": np.flatnonzero(wanted), "m": np.flatnonzero(wanted[self.owner])}
        # Of a level its head is read, after that of the file.
        documents = [*dict.fromkeys(("zarr.json", self._entry("", "zarr.json"))),
                     *(self._entry(name, "zarr.json") for name in self.shapes)]  # fmt: skip
        given = {name.partition(".")[0] for name in names}
        return Reading(
            channels=tuple(channel for channel in ("distance", *CHOICES) if channel in given),
            bricks=self._in_chunks("distance", rows["k"]),
            of_bricks=len(kept),
            bytes=sum(self.sizes[entry] for entry in documents) + sum(self._chunks(name, rows) for name in names),
            of_bytes=self.whole,
            levels=(self.level,),
        )

    def _entry(self, name: str, rest: str) -> str:
        prefix = "" if is_lent(name) else level_prefix(self.level)
        return prefix + (f"{name}/{rest}" if name else rest)

    def _chunks(self, name: str, rows: Mapping[str, np.ndarray]) -> int:
        """Return the bytes of the chunks of an array that hold some rows, or of all where it is read whole."""
        prefix, axis = self._entry(name, "c/"), str(LAYOUT[name][0][0])
        if axis not in rows or name == _OWNER:
            return sum(size for entry, size in self.sizes.items() if entry.startswith(prefix))
        shape, count = self.shapes[name]
        beyond = "/0" * (len(shape) - 1)
        return sum(self.sizes[f"{prefix}{chunk}{beyond}"] for chunk in np.unique(rows[axis] // count).tolist())

    def _in_chunks(self, name: str, rows: Int[np.ndarray, " n"]) -> int:
        """Return how many rows lie in the chunks that hold some."""
        (length, *_), count = self.shapes[name]
        number = np.unique(rows // count)
        return int((np.minimum((number + 1) * count, length) - number * count).sum())


def _read(level: int, archive: Archive) -> Tables:
    read_head(archive)
    archive = archive.within(level_prefix(level))
    lattice, metadata, *_ = read_head(archive)
    shapes = checked(archive, [name for name in LAYOUT if name in metadata.checksums], lattice)
    slot, far = (array(archive, name, *shapes[name]) for name in TABLES)
    bricks = Bricks.of(slot >= 0, far)
    place = slot[tuple(bricks.index.T)]
    every = len(bricks) == shapes["distance"][0][0] and np.array_equal(np.sort(place), np.arange(len(bricks)))
    require(every, "its table of bricks")
    owner = array(archive, _OWNER, *shapes[_OWNER]) if _OWNER in shapes else np.zeros(0, np.int32)
    require(bool(((owner >= 0) & (owner < len(place))).all()), "the ids of layers.brick")
    sizes = {info.filename: info.file_size for info in archive.file.infolist()}
    return Tables(bricks, place, owner, shapes, sizes, archive.size, level)
