"""Run times that can be compared: warm-up, repeats, medians; the machine and the versions they were had on.

In: a function. Out: every sample in seconds, and what it ran on. Error runs and timed runs are separate runs: nothing
else happens inside the clock.
"""

import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

import numpy as np

PACKAGES = (
    "sdf-ray-differentials",
    "numpy",
    "scipy",
    "drjit",
    "embreex",
    "open3d-cpu",
    "open3d",
    "libigl",
    "trimesh",
    "xatlas",
    "zarr",
    "matplotlib",
)


@dataclass(frozen=True, slots=True)
class Timing:
    """All samples of one timed run, in seconds, in the order they were taken; the warm-ups apart."""

    samples: tuple[float, ...]
    warm_up: tuple[float, ...]

    @property
    def median(self) -> float:
        """Middle sample in seconds."""
        return float(np.median(self.samples))


def measure(function: Callable[[], object], repeats: int = 5, warm_up: int = 1) -> Timing:
    """Time `function`: `warm_up` calls first (they compile and fill caches), then `repeats` that count."""
    return measure_in_turns({"": function}, repeats, warm_up)[""]


def measure_in_turns(
    functions: Mapping[str, Callable[[], object]], repeats: int = 5, warm_up: int = 1
) -> dict[str, Timing]:
    """Time functions that shall be compared in turns, so that a machine that slows down does so for all of them."""
    rounds = [{name: _once(function) for name, function in functions.items()} for _ in range(warm_up + repeats)]
    return {
        name: Timing(
            warm_up=tuple(times[name] for times in rounds[:warm_up]),
            samples=tuple(times[name] for times in rounds[warm_up:]),
        )
        for name in functions
    }


def _once(function: Callable[[], object]) -> float:
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


@cache
def machine() -> dict[str, str]:
    """Processor, cores that this process may use, memory, system and Python."""
    return {
        "processor": _processor(),
        "cores": str(_cores()),
        "memory": _memory(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text().splitlines():
            if line.startswith("model name"):
                return " ".join(line.partition(":")[2].split())
    return platform.processor() or platform.machine() or "unknown"


def _memory() -> str:
    listing = Path("/proc/meminfo")
    if not listing.exists():
        return "unknown"
    return f"{int(listing.read_text().split(maxsplit=2)[1]) / 2**20:.0f} GiB"


@cache
def versions() -> dict[str, str]:
    """Versions of the packages that the figures depend on, those that are installed."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
