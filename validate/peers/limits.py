"""The figures of the bakers, paired, and the limits that were set for ours.

In: runs of the suite `baking`. Out: `Points`, and `LIMITS`, which find their figures in them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from validate.experiment import Run
from validate.metrics import fitted_order
from validate.peers.catalogue import OURS, PEERS
from validate.peers.limit import Limit
from validate.peers.oracle import NEAR

LAYERED, NUMPY, VDB = f"{OURS}, faces and layers", f"{OURS}, NumPy", "OpenVDB"
LABELS = (OURS, LAYERED, NUMPY, *(peer.name for peer in PEERS if peer.name != OURS))
# Float32 keeps a distance to half a unit of its 24 binary places; these are at most NEAR voxels.
ROUNDING = NEAR * 2.0**-24


@dataclass(frozen=True, slots=True)
class Point:
    """One tool on one mesh at one resolution; a side that failed or is missing is None."""

    problem: str
    label: str
    resolution: int
    timing: Run | None
    error: Run | None

    def value(self, name: str) -> float | None:
        """A figure of either run."""
        for run in (self.timing, self.error):
            if run is not None and name in run.values:
                return run.values[name]
        return None


# By mesh, label and resolution.
Points = dict[tuple[str, str, int], Point]


def figure(points: Points, problem: str, label: str, resolution: int, name: str) -> float | None:
    """Return a figure, if there is one."""
    point = points.get((problem, label, resolution))
    return None if point is None else point.value(name)


def label_of(setup: dict[str, str]) -> str:
    """Return the name of a setup's curve, one of `LABELS`."""
    if setup.get("tool") != OURS:
        return setup.get("tool", "unknown")
    if "layers" in setup["uv"]:
        return LAYERED
    return NUMPY if setup["engine"] == "numpy" else OURS


def paired(runs: Sequence[Run], label_of: Callable[[dict[str, str]], str] = label_of) -> Points:
    """Pair error and timed runs by their names; a failed tool has a point without figures."""
    found = [run for run in runs if "resolution" in run.knob and "tool" in run.setup]
    sides: dict[tuple[str, str, int], dict[str, Run]] = {}
    for run in found:
        side = sides.setdefault((run.problem, label_of(run.setup), int(run.knob["resolution"])), {})
        if run.ok:
            side[run.kind] = run
    return {key: Point(*key, side.get("timing"), side.get("error")) for key, side in sides.items()}


def problems(points: Points) -> list[str]:
    """Return the meshes, in the order of the runs."""
    return list(dict.fromkeys(problem for problem, _, _ in points))


def sizes(points: Points, problem: str, label: str) -> list[int]:
    """Return the samples per axis that a tool has runs of on a mesh, failed ones too."""
    return sorted(n for p, one, n in points if (p, one) == (problem, label))


def ratio(
    points: Points, problem: str, label: str, resolution: int, name: str = "seconds", other: str = VDB
) -> float | None:
    """Time of one tool over the warm median of another."""
    ours = figure(points, problem, label, resolution, name)
    theirs = figure(points, problem, other, resolution, "seconds")
    return ours / theirs if ours is not None and theirs else None


def growth(points: Points, problem: str) -> float | None:
    """Fitted exponent of our time in the samples per axis, from 128 on; None without three sizes."""
    found = [n for n in sizes(points, problem, OURS) if n >= 128]
    timed = [(n, figure(points, problem, OURS, n, "seconds")) for n in found]
    good = [(n, seconds) for n, seconds in timed if seconds is not None]
    if len(good) < 3:
        return None
    return fitted_order(np.array([n for n, _ in good], np.float64), np.array([seconds for _, seconds in good]))


def _megabytes(points: Points, label: str) -> float | None:
    written = figure(points, "bunny", label, 512, "file_bytes")
    return None if written is None else written / 1e6


def _gigabytes(points: Points) -> float | None:
    peak = figure(points, "bunny", OURS, 512, "peak_mb")
    return None if peak is None else peak / 1e3


def _ours(points: Points, name: str, combine: Callable[[Sequence[float]], float]) -> float | None:
    """Combine a figure of all our error runs."""
    values = [point.value(name) for key, point in points.items() if key[1] in (OURS, LAYERED, NUMPY)]
    found = [value for value in values if value is not None]
    return combine(found) if found else None


LIMITS = (
    Limit("Bunny, 512³, face ids: time over OpenVDB's", 0.6, "x", partial(ratio, problem="bunny", label=OURS,
          resolution=512), headline=True),
    Limit("Bunny, 512³, face ids, first call in a process: time over OpenVDB's warm", 1.2, "x",
          partial(ratio, problem="bunny", label=OURS, resolution=512, name="first_seconds")),
    Limit("Bunny, 512³, face ids and layers: time over OpenVDB's", 3.0, "x",
          partial(ratio, problem="bunny", label=LAYERED, resolution=512)),
    Limit("Bunny, 64³, face ids: time over OpenVDB's", 1.5, "x", partial(ratio, problem="bunny", label=OURS,
          resolution=64)),
    Limit("Bunny with 900k faces, 512³: time over OpenVDB's", 1.0, "x", partial(ratio, problem="bunny-900k", label=OURS,
          resolution=512), headline=True),
    Limit("Bunny, 512³, face ids: greatest memory", 0.8, "GB", _gigabytes),
    Limit("Bunny, 512³, face ids: file", 50.0, "MB", partial(_megabytes, label=OURS)),
    Limit("Bunny, 512³, face ids and layers: file", 120.0, "MB", partial(_megabytes, label=LAYERED)),
    Limit("Bunny: exponent of time in N, 128 to 1024", 2.0, "", partial(growth, problem="bunny")),
    Limit("All meshes and sizes: greatest error of a distance", ROUNDING, "voxel",
          partial(_ours, name="error.max", combine=max), headline=True),
    Limit("All meshes and sizes: wrong signs", 0.0, "", partial(_ours, name="wrong_signs", combine=sum)),
    Limit("All meshes and sizes: wrong faces, ties apart", 0.0, "", partial(_ours, name="wrong_faces", combine=sum)),
)  # fmt: skip
