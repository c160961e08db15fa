"""An experiment's outcome: problem x setup x knob, one JSON line each.

In: what a suite measured. Out: `Run` records, written all at once and read back whole. Failed runs are records too.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from sdfbake.atomic import replacing
from sdfbake.complaint import BadInput
from validate.timing import Timing, machine, versions

Kind = Literal["error", "timing"]


def _command() -> str:
    """The command line of this process, as it can be typed again."""
    program = Path(sys.argv[0]).name
    return " ".join(["python -m validate" if program == "__main__.py" else program, *sys.argv[1:]])


@cache
def _commit() -> str:
    """Commit of the source tree, with "+changes" where files differ from it; "unknown" outside a repository."""
    here = Path(__file__).parent
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--abbrev=12", "--dirty=+changes"],
            cwd=here,
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return found.stdout.strip() or "unknown"


@dataclass(frozen=True, slots=True)
class Run:
    """One measurement.

    Attributes
    ----------
    suite
        Name of the experiment.
    problem
        What was looked at: "sphere", "bunny, primary rays".
    setup
        How: kernel, engine, precision, peer.
    knob
        The number that is swept, by name: {"resolution": 64}.
    kind
        "error" or "timing": never both in one run.
    values
        What was found, by name; finite numbers.
    samples
        The raw samples behind the values, by name (seconds of each repeat).
    status
        "ok", or the sentence that says why the run failed.
    artefact
        File with the raw arrays (error maps), relative to the JSON lines; empty where there is none.
    """

    suite: str
    problem: str
    setup: dict[str, str]
    knob: dict[str, float | int]
    kind: Kind
    values: dict[str, float] = field(default_factory=dict)
    samples: dict[str, list[float]] = field(default_factory=dict)
    status: str = "ok"
    artefact: str = ""
    machine: dict[str, str] = field(default_factory=machine)
    versions: dict[str, str] = field(default_factory=versions)
    command: str = field(default_factory=_command)
    commit: str = field(default_factory=_commit)

    @property
    def ok(self) -> bool:
        """True where the run did not fail."""
        return self.status == "ok"


@dataclass(frozen=True, slots=True)
class Bench:
    """What a suite is given: where the products of the build lie, and where its raw arrays go.

    Attributes
    ----------
    build
        Folder with `meshes`, `grids` and `renders`.
    artefacts
        Folder of the JSON lines.
    progress
        Told in one line what comes next.
    only
        Name of the one object to look at, for suites that look at several; None for all.
    quick
        Small sizes only, for suites that have large ones.
    """

    build: Path
    artefacts: Path
    progress: Callable[[str], None] = lambda _: None
    only: str | None = None
    quick: bool = False

    def mesh(self, name: str) -> Path:
        """Path of a mesh of the build."""
        return self._needed(self.build / "meshes" / f"{name}.ply")

    def grid(self, name: str, resolution: int) -> Path:
        """Path of a grid of the build."""
        return self._needed(self.build / "grids" / f"{name}@{resolution}.zarr.zip")

    def exact_grid(self, name: str, resolution: int) -> Path | None:
        """Path of a grid of the build that was sampled from an exact shape, if it has one."""
        path = self.build / "grids" / f"exact-{name}@{resolution}.zarr.zip"
        return path if path.exists() else None

    def render(self, name: str) -> Path:
        """Path of a render of the build."""
        return self._needed(self.build / "renders" / f"{name}.exr")

    def _needed(self, path: Path) -> Path:
        if not path.exists():
            raise BadInput(
                f"{path} does not exist and this suite needs it: run 'make report', or name its --build folder"
            )
        return path

    def store(self, name: str, **arrays: np.ndarray) -> str:
        """Write raw arrays beside the JSON lines; returns the name to put into `Run.artefact`."""
        with replacing(self.artefacts / f"{name}.npz") as path, path.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
        return f"{name}.npz"


def timed(
    suite: str, problem: str, setup: dict[str, str], knob: dict[str, float | int], timing: Timing, rays: int = 0
) -> Run:
    """Make the record of a timed run; `rays` adds microseconds per ray."""
    values = {"seconds": timing.median, "first_seconds": timing.warm_up[0] if timing.warm_up else timing.median}
    if rays:
        values["us_per_ray"] = timing.median * 1e6 / rays
    samples = {"seconds": list(timing.samples), "warm_up": list(timing.warm_up)}
    return Run(suite, problem, setup, knob, "timing", values, samples)


def guarded(blank: Run, measure: Callable[[], Run]) -> Run:
    """Run `measure`; if it fails, return `blank` with the reason as its status, so that the report shows it."""
    try:
        return measure()
    except (BadInput, ArithmeticError, ValueError, RuntimeError, MemoryError) as error:
        name = "" if isinstance(error, BadInput) else f"{type(error).__name__}: "
        reason = " ".join(f"{name}{error}".split())
        return Run(blank.suite, blank.problem, blank.setup, blank.knob, blank.kind, status=f"failed: {reason}")


def write_runs(path: str | Path, runs: Iterable[Run]) -> None:
    """Write runs as JSON lines, all or nothing.

    Raises
    ------
    ValueError
        If a value is not finite.
    """
    lines = [json.dumps(asdict(run), sort_keys=True, allow_nan=False) + "\n" for run in runs]
    with replacing(path) as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")


def read_runs(paths: Sequence[str | Path]) -> list[Run]:
    """Read runs from JSON lines, in order; `artefact` becomes a path that can be opened.

    Raises
    ------
    BadInput
        If a file is missing or a line is not a run.
    """
    return [run for path in paths for run in _read(Path(path))]


def _read(path: Path) -> Iterator[Run]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(
            f"cannot read the runs {path} ({error}): name a file written by 'python -m validate run'"
        ) from None
    for number, line in enumerate(lines, start=1):
        try:
            record = json.loads(line)
            record["artefact"] = str(path.parent / record["artefact"]) if record["artefact"] else ""
            yield Run(**record)
        except (json.JSONDecodeError, TypeError, KeyError):
            raise BadInput(
                f"{path}, line {number} is not a run: write the file again with 'python -m validate run'"
            ) from None
