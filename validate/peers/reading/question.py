"""What a reader's process is asked for: open an exported file, say what stands where, sample it, trace it.

In: a `Reader`. Out: the answers of `worker.answer`: arrays, in world units, and words, of what the file says itself.
"""

import json
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from validate.peers.worker import answer

Arrays = dict[str, np.ndarray]
Words = dict[str, str]


class Question(NamedTuple):
    """What every reader is asked about; each answers what it can.

    Attributes
    ----------
    samples
        Lattice indices (n, 3), along [x, y, z]: `value` (n,) and `position` (n, 3) are asked for, and of formats that
        have them `uv`, `chart`, `part`, `seam`.
    places
        Where these lie, world (n, 3): for readers that know positions only.
    points
        World positions (m, 3) between samples: `between` (m,), the reader's own interpolation.
    p, d
        Rays (r, 3), world, of unit direction: `t` (r,), infinite for misses.
    """

    samples: np.ndarray
    places: np.ndarray
    points: np.ndarray
    p: np.ndarray
    d: np.ndarray


class Reader(NamedTuple):
    """What a reader's file offers.

    Attributes
    ----------
    version
        Of the program.
    read
        Opens the exported file.
    look
        Answers the question. Among the arrays may be `index`, samples of the reader's own choice, and `surface` (s, 3),
        points of the zero set that it finds itself.
    """

    version: str
    read: "Callable[[str], Any]"
    look: "Callable[[Any, Question], tuple[Arrays, Words]]"


def serve(make: "Callable[[], Reader]") -> None:
    """Answer as a reader."""

    def start() -> "tuple[str, object]":
        reader = make()
        return reader.version, _Session(reader)

    answer(start)


class _Session:
    """A reader."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def look(self, path: str, question: str, output: str) -> "dict[str, Words]":
        """Open a file and answer the question in `question`.npz with arrays in `output`.npz, and words."""
        with np.load(question) as archive:
            asked = Question(*(archive[name] for name in Question._fields))
        arrays, words = self._reader.look(self._reader.read(path), asked)
        named: dict[str, Any] = dict(arrays)
        np.savez(output, **named)
        return {"words": words}


def linear(values: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Interpolate linearly at places (m, 3) in samples' coordinates: eight corners and their weights, in float64."""
    cell = np.clip(np.floor(place).astype(np.int64), 0, np.array(values.shape) - 2)
    inside = place - cell
    found = np.zeros(len(place))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, inside, 1 - inside), axis=1)
        found += weight * values[tuple((cell + corner).T)].astype(np.float64)
    return found


def described(path: str) -> "dict[str, Any]":
    """Read the JSON description beside a file."""
    with open(path, encoding="utf-8") as file:  # noqa: PTH123 - a reader's few lines, as its user would write them
        loaded: dict[str, Any] = json.load(file)
    return loaded
