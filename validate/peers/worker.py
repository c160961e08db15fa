"""The loop inside a tool's process: requests on standard input, answers on standard output, a JSON object a line.

In: a `Tool` that bakes, or another session (`validate.peers.frames`). Out: nothing; it ends with its input. Of a baker
only `Tool.bake` is inside the clock: starting Python, importing and turning the mesh into the arrays that a tool wants
are not.
"""

import json
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np


class Job(NamedTuple):
    """What is to be baked.

    Attributes
    ----------
    arrays
        The mesh: `vertices` (v, 3) float64, `faces` (f, 3) int64, and where it has them `uv` and `chart`.
    origin, spacing, shape
        The lattice that all tools share.
    options
        Of this tool alone.
    """

    arrays: "dict[str, np.ndarray]"
    origin: np.ndarray
    spacing: float
    shape: "tuple[int, int, int]"
    options: "dict[str, str]"

    def in_voxels(self) -> np.ndarray:
        """Return the vertices in grid coordinates, float32: small numbers, of which float32 loses least."""
        return np.ascontiguousarray((self.arrays["vertices"] - self.origin) / self.spacing, np.float32)


class Tool(NamedTuple):
    """What a tool's file offers.

    Attributes
    ----------
    version
        Of the tool.
    prepare
        Turns a job into what the tool wants; not timed.
    bake
        The work; what it returns is asked for samples afterwards.
    look
        Returns the distances (n,), world units, and the closest faces (n,) or None, at lattice indices (n, 3).
    save
        Writes a result to a file without suffix in its name; None for tools without a file format for it.
    band
        Returns the indices of all samples of the band; None for tools whose band nobody asks for.
    """

    version: str
    prepare: "Callable[[Job], Any]"
    bake: "Callable[[Any], Any]"
    look: "Callable[[Job, Any, np.ndarray], tuple[np.ndarray, np.ndarray | None]]"
    save: "Callable[[Any, Path], Path] | None" = None
    band: "Callable[[Any], np.ndarray] | None" = None


def serve(make: "Callable[[], Tool]") -> None:
    """Answer as a baker."""

    def start() -> "tuple[str, object]":
        tool = make()
        return tool.version, _Session(tool)

    answer(start)


def answer(start: "Callable[[], tuple[str, object]]") -> None:
    """Say hello with the version, then call a session's methods until the input ends; what one raises is its answer.

    Parameters
    ----------
    start
        Returns the version and the session; each of its methods takes a request and returns a dictionary.
    """
    answers = _own_output()
    try:
        version, session = start()
    except Exception as error:  # whatever keeps a tool from loading is news, not a crash
        _say(answers, {"error": _sentence(error)})
        return
    _say(answers, {"version": version})
    for line in sys.stdin:
        request = json.loads(line)
        try:
            _say(answers, getattr(session, request.pop("do"))(**request))
        except Exception as error:  # the next request may succeed
            _say(answers, {"error": _sentence(error)})


class _Session:
    """A tool with its present job and latest result."""

    def __init__(self, tool: Tool) -> None:
        self._tool = tool
        self._result: Any = None

    def load(
        self, mesh: str, origin: "list[float]", spacing: float, shape: "list[int]", options: "dict[str, str]"
    ) -> "dict[str, float]":
        """Take a job; answer with the memory before the first bake."""
        with np.load(mesh) as archive:
            arrays = {name: archive[name] for name in archive.files}
        self._job = Job(arrays, np.array(origin), spacing, (shape[0], shape[1], shape[2]), options)
        self._prepared = self._tool.prepare(self._job)
        return {"base_mb": _peak()}

    def bake(self) -> "dict[str, float]":
        """Do the work once; answer with its seconds and the greatest memory so far."""
        self._result = None  # two results at once would be in nobody's use
        begin = time.perf_counter()
        self._result = self._tool.bake(self._prepared)
        seconds = time.perf_counter() - begin
        return {"seconds": seconds, "peak_mb": _peak()}

    def look(self, index: str, output: str) -> "dict[str, bool]":
        """Write the distances at lattice indices, and the faces where the tool names them."""
        distance, face = self._tool.look(self._job, self._result, np.load(index))
        arrays: dict[str, Any] = {"distance": np.asarray(distance, np.float64)}
        if face is not None:
            arrays["face"] = np.asarray(face, np.int64)
        np.savez(output, **arrays)
        return {"faces": face is not None}

    def band(self, output: str) -> "dict[str, int]":
        """Write the indices of the band's samples."""
        if self._tool.band is None:
            raise ValueError("this tool's band cannot be asked for")
        index = self._tool.band(self._result)
        np.save(output, index)
        return {"samples": len(index)}

    def save(self, path: str) -> "dict[str, float]":
        """Write the result to a file once; empty for tools that cannot."""
        if self._tool.save is None:
            return {}
        begin = time.perf_counter()
        written = self._tool.save(self._result, Path(path))
        return {"write_seconds": time.perf_counter() - begin, "file_bytes": float(written.stat().st_size)}


def _own_output() -> TextIO:
    """Keep standard output for the answers; what libraries print goes to standard error."""
    own = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return own


def _say(answers: TextIO, record: "dict[str, Any]") -> None:
    answers.write(json.dumps(record) + "\n")
    answers.flush()


def _peak() -> float:
    """Greatest memory of this process so far, in 10^6 bytes.

    Linux passes getrusage's figure on from the process that started this one, so that it is asked elsewhere there.
    """
    try:
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    except OSError:  # no Linux
        pass
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e6 / 1024)


def _sentence(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
