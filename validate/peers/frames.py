"""What a renderer's process is asked for: take a grid, trace a frame, show what was hit.

In: a `Renderer`. Out: the answers of `worker.answer`. Inside the clock are preparing the field from samples in memory,
and frames up to arrays that are computed and lie where the renderer left them; reading files, and copying to NumPy, are
not.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from validate.peers.worker import answer

# First hits; a mirrored ray from there; and all that a filtered picture of a mirror takes.
PRIMARY, MIRROR, EVERYTHING = JOBS = ("primary", "mirror", "everything")


class View(NamedTuple):
    """What is looked at.

    Attributes
    ----------
    origin, spacing
        World position of sample [0, 0, 0] of the cube of samples, and the distance between neighbours.
    eye
        Position of the pinhole camera; it looks along -z, y is up.
    slope
        Half the picture's height at unit distance.
    pixels
        Along a side of the square picture.
    """

    origin: "tuple[float, float, float]"
    spacing: float
    eye: "tuple[float, float, float]"
    slope: float
    pixels: int


class Renderer(NamedTuple):
    """What a renderer's file offers.

    Attributes
    ----------
    version
        Of the tool.
    read
        Reads the samples from a path without suffix; not timed.
    prepare
        Turns samples into what frames are traced in.
    frame
        Traces a frame of a job; what it returns is computed, not only described.
    look
        Returns what a frame found as arrays of NumPy: `t`, infinite for misses, and for the mirror `t2`; not timed.
    """

    version: str
    read: "Callable[[str], Any]"
    prepare: "Callable[[Any, View, Mapping[str, str]], Any]"
    frame: "Callable[[Any, str], Any]"
    look: "Callable[[Any], dict[str, np.ndarray]]"


def serve(make: "Callable[[], Renderer]") -> None:
    """Answer as a renderer."""

    def start() -> "tuple[str, object]":
        renderer = make()
        return renderer.version, _Session(renderer)

    answer(start)


class _Session:
    """A renderer with its present field and latest frame."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._state: Any = None
        self._result: Any = None

    def load(self, samples: str, view: "list[Any]", options: "dict[str, str]") -> "dict[str, float]":
        """Prepare a field; answer with the seconds."""
        self._state = self._result = None  # two fields at once would be in nobody's use
        given = self._renderer.read(samples)
        origin, spacing, eye, slope, pixels = view
        at = View((origin[0], origin[1], origin[2]), spacing, (eye[0], eye[1], eye[2]), slope, pixels)
        begin = time.perf_counter()
        self._state = self._renderer.prepare(given, at, options)
        return {"seconds": time.perf_counter() - begin}

    def frame(self, job: str) -> "dict[str, float]":
        """Trace one frame; answer with the seconds."""
        self._result = None
        begin = time.perf_counter()
        self._result = self._renderer.frame(self._state, job)
        return {"seconds": time.perf_counter() - begin}

    def look(self, output: str) -> "dict[str, list[str]]":
        """Write what the latest frame found."""
        found = self._renderer.look(self._result)
        arrays: dict[str, Any] = {name: np.asarray(values, np.float64) for name, values in found.items()}
        np.savez(output, **arrays)
        return {"arrays": sorted(arrays)}
