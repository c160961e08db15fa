"""Our own exports on the scales: seconds and memory, in a process that does nothing else.

In: a grid file, a format, an output. Out: seconds to load and to write, bytes, memory above that of the loaded grid,
and that of a slab, eight samples thick, of what is written in slabs.
"""

import time
from pathlib import Path

from sdfbake.bricks import SIDE
from sdfbake.export import FORMATS
from sdfbake.export.result import silent
from sdfbake.export.texture import channels
from sdfbake.grid import Grid
from sdfbake.gridfile import describe
from sdfbake.metadata import tool_version
from validate.peers.worker import answer

DENSE = ("vti", "vol", "npy", "coefficients")  # what is written slab by slab
_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_PEAK = "5"  # what resets the greatest memory so far


class _Session:
    """Exports, one at a time."""

    def export(self, source: str, to: str, output: str) -> dict[str, float]:
        """Load what the command would load, and write it."""
        write = FORMATS[to].write  # its program is loaded now: what that takes is no part of the export's
        begin = time.perf_counter()
        wanted = channels(describe(source).uv_modes) if FORMATS[to].textured else ()
        grid = Grid.load(source, ("part", *wanted))
        loaded = time.perf_counter()
        before = _resident()
        done = write(grid, Path(output), progress=silent)
        seconds = time.perf_counter() - loaded
        found = {"seconds": seconds, "load_seconds": loaded - begin, "file_bytes": float(done.size)}
        if to in DENSE:
            found["slab_mb"] = done.size / 1e6 * SIDE / max(grid.lattice.shape)
        return found if before is None else found | {"above_mb": (_peak() - before) / 1e6}


def _resident() -> float | None:
    """Return the bytes in use, and begin to watch for the most; None where the system does not tell."""
    try:
        _RESET.write_text(_PEAK)
        return _entry("VmRSS")
    except OSError:
        return None


def _peak() -> float:
    return _entry("VmHWM")


def _entry(name: str) -> float:
    lines = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines())
    return float(lines[name].split()[0]) * 1024


if __name__ == "__main__":
    answer(lambda: (tool_version(), _Session()))
