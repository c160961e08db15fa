"""Bakers against each other: ours, OpenVDB, trueform and Open3D, same meshes, same lattice, same minute.

In: build/meshes/{bunny,bunny-900k,box-12}.ply. Out: per mesh, resolution and tool a timed run (every call, the first
apart; greatest memory; file) and an error run against the float64 oracle at samples that all tools are asked for.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from sdfbake.complaint import BadInput
from sdfbake.engine import choose
from sdfbake.lattice import Lattice
from sdfbake.mesh import Mesh
from validate.experiment import Bench, Run, guarded
from validate.peers.catalogue import OURS, PEERS, Found, find
from validate.peers.oracle import Oracle, Truth
from validate.peers.process import Process
from validate.timing import Timing, versions

# What ours is asked for on each mesh; the 900k faces have no texture coordinates.
MESHES = {"bunny": ("faces", "faces,layers"), "bunny-900k": ("none",), "box-12": ("faces",)}
SIZES = (64, 128, 256, 512, 1024)
QUICK = (64, 128)
ROUNDS = 4  # calls of every tool, the first apart
PATIENCE = 8.0  # seconds of calls after which a tool has no further turn at this mesh and size
LIMIT = 60.0  # seconds that one call may be expected to take
LARGEST_FILE = 512  # samples per axis up to which the result is written to a file, once
NUMPY_LARGEST = 128  # what the engine without a compiler is asked for, on the mesh that has all modes
SAMPLES = 20_000
SUITE = "baking"


@dataclass(frozen=True, slots=True)
class Entry:
    """A tool with its options, one curve of the report."""

    found: Found
    setup: dict[str, str]
    largest: int = max(SIZES)

    @property
    def name(self) -> str:
        """Tool and options in words."""
        return ", ".join(self.setup.values())


@dataclass(slots=True)
class _Turns:
    """What came of an entry's turns so far."""

    entry: Entry
    process: Process | None = None
    seconds: list[float] = field(default_factory=list)
    peak: list[float] = field(default_factory=list)
    base: float = 0.0
    written: dict[str, float] = field(default_factory=dict)
    failure: str = ""

    def ask(self, do: str, **request: object) -> dict[str, Any]:
        """Ask the process; a failure is kept, and nothing is asked after it."""
        if self.failure or self.process is None:
            return {}
        try:
            return self.process.ask(do, 3 * LIMIT, **request)
        except RuntimeError as error:
            self.failure = f"failed: {do}: {error}"
            return {}


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """One mesh at one resolution: what every tool is given, and what is true."""

    problem: str
    resolution: int
    lattice: Lattice
    truth: Truth
    folder: Path

    def job(self, options: dict[str, str]) -> dict[str, Any]:
        """The request that loads it."""
        a = self.lattice
        paths = {"mesh": str(self.folder / "mesh.npz")}
        return {**paths, "origin": a.origin.tolist(), "spacing": a.spacing, "shape": a.shape, "options": options}

    @property
    def band(self) -> Path:
        """Samples of our band, for the tool that has to be told."""
        return self.folder / "band.npy"


def run(bench: Bench) -> Iterator[Run]:
    """Race all tools that are here; the others have one failed run each."""
    problems = [problem for problem in MESHES if bench.only in (None, problem)]
    for problem in problems:  # all of them, before minutes go into the first
        if not _file(bench, problem).exists():
            raise BadInput(f"{_file(bench, problem)} does not exist and this suite needs it: run 'make bench-bake'")
    found = [find(peer) for peer in PEERS]
    for one in found:
        if not one.here:
            status = f"failed: it cannot run here ({one.problem}); to have it: {one.peer.install}"
            yield Run(SUITE, "every mesh", {"tool": one.peer.name}, {}, "timing", status=status)
    for problem in problems:
        yield from _mesh(bench, problem, [one for one in found if one.here])


def _file(bench: Bench, problem: str) -> Path:
    return bench.build / "meshes" / f"{problem}.ply"


def entries(found: Sequence[Found], modes: Sequence[str]) -> list[Entry]:
    """Ours with each of some modes of texture coordinates, with several on NumPy too; and every other tool."""
    entries = []
    for one in found:
        if one.peer.name != OURS:
            entries.append(Entry(one, {"tool": one.peer.name}))
            continue
        engine = "drjit" if choose().engine.name == "drjit" else "numpy"
        entries += [Entry(one, {"tool": OURS, "uv": mode, "engine": engine}) for mode in modes]
        if engine != "numpy" and len(modes) > 1:
            entries.append(Entry(one, {"tool": OURS, "uv": modes[0], "engine": "numpy"}, NUMPY_LARGEST))
    return entries


def _mesh(bench: Bench, problem: str, found: Sequence[Found]) -> Iterator[Run]:
    mesh = Mesh.load(_file(bench, problem))
    oracle = Oracle.of(mesh)
    seen: dict[str, tuple[int, float]] = {}  # the latest size of every entry, and the seconds of its first call
    with TemporaryDirectory(prefix="baking-") as folder:
        arrays: dict[str, Any] = {"vertices": mesh.vertices, "faces": mesh.faces}
        if mesh.uv is not None:
            arrays |= {"uv": mesh.uv, "chart": mesh.chart}
        np.savez(Path(folder, "mesh.npz"), **arrays)
        for n in QUICK if bench.quick else SIZES:
            lattice = Lattice.around(mesh.bounds, n)
            course = _Course(problem, n, lattice, oracle.chosen(lattice, SAMPLES, seed=n), Path(folder))
            asked = [entry for entry in entries(found, MESHES[problem]) if n <= entry.largest]
            yield from race(bench, course, asked, seen)


def race(bench: Bench, course: _Course, asked: Sequence[Entry], seen: dict[str, tuple[int, float]]) -> Iterator[Run]:
    """Give every tool its turns, round after round, then look at the results; `seen` is brought up to date."""
    np.save(course.folder / "index.npy", course.truth.index)
    course.band.unlink(missing_ok=True)
    all_ = [_Turns(entry, failure=_too_long(entry, course.resolution, seen)) for entry in asked]
    _scout(bench, course, all_)
    with ExitStack() as stack:
        for turns in all_:  # started together: loading the libraries overlaps
            if not turns.failure:
                turns.process = stack.enter_context(turns.entry.found.start())
        for turns in all_:
            _load(turns, course)
        for number in range(ROUNDS):
            for turns in all_:
                _turn(bench, course, turns, number)
        for turns in all_:
            if turns.seconds:
                seen[turns.entry.name] = course.resolution, turns.seconds[0]
            yield from _runs(bench, course, turns)


def _too_long(entry: Entry, resolution: int, seen: dict[str, tuple[int, float]]) -> str:
    """Say that an entry is left out, from what it took at the size before."""
    if entry.name not in seen:
        return ""
    size, seconds = seen[entry.name]
    expected = seconds * (resolution / size) ** entry.found.peer.growth
    if expected <= LIMIT:
        return ""
    return f"failed: left out, it would take about {expected:.0f} s a call ({seconds:.1f} s at {size}³), over {LIMIT:g}"


def _scout(bench: Bench, course: _Course, all_: Sequence[_Turns]) -> None:
    """Bake once apart from the clock, for the samples that Open3D is told."""
    ours = next((t.entry for t in all_ if t.entry.setup["tool"] == OURS and not t.failure), None)
    if ours is None or not any(t.entry.setup["tool"] == "Open3D" for t in all_):
        return
    bench.progress(f"baking {course.problem}, {course.resolution}³: the band")
    with ours.found.start() as process:
        scout = _Turns(ours, process)
        _load(scout, course)
        scout.ask("bake")
        scout.ask("band", output=str(course.band))


def _load(turns: _Turns, course: _Course) -> None:
    options = {name: value for name, value in turns.entry.setup.items() if name != "tool"}
    if turns.entry.setup["tool"] == "Open3D":
        if not course.band.exists():
            turns.failure = turns.failure or "failed: our band, whose samples it is to be told, could not be baked"
        options["points"] = str(course.band)
    try:
        if turns.process is not None:
            turns.process.hello()
    except RuntimeError as error:
        turns.failure = f"failed: start: {error}"
    turns.base = turns.ask("load", **course.job(options)).get("base_mb", 0.0)


def _turn(bench: Bench, course: _Course, turns: _Turns, number: int) -> None:
    if turns.failure or sum(turns.seconds) > PATIENCE:
        return
    if number == 0:
        bench.progress(f"baking {course.problem}, {course.resolution}³: {turns.entry.name}")
    answer = turns.ask("bake")
    if answer:
        turns.seconds.append(answer["seconds"])
        turns.peak.append(answer["peak_mb"])


def _runs(bench: Bench, course: _Course, turns: _Turns) -> Iterator[Run]:
    """The timed run and the error run of an entry."""
    used = versions() | {turns.entry.found.peer.name: turns.entry.found.version}
    blank = partial(Run, SUITE, course.problem, turns.entry.setup, {"resolution": course.resolution}, versions=used)
    error = guarded(blank("error"), partial(_judged, blank, course, turns))
    if course.resolution <= LARGEST_FILE:
        turns.written = turns.ask("save", path=str(course.folder / "result"))
    if turns.failure:
        yield blank("timing", status=turns.failure)
    else:
        yield _timed(blank, course, turns)
        yield error


def _judged(blank: partial[Run], course: _Course, turns: _Turns) -> Run:
    answer = course.folder / "answer.npz"
    turns.ask("look", index=str(course.folder / "index.npy"), output=str(answer))
    if turns.failure:
        return blank("error", status=turns.failure)
    with np.load(answer) as archive:
        face = archive["face"] if "face" in archive.files else None
        return blank("error", values=course.truth.judge(archive["distance"], face))


def _timed(blank: partial[Run], course: _Course, turns: _Turns) -> Run:
    # With a single call, that one stands for the median too; the samples tell.
    timing = Timing(tuple(turns.seconds[1:]) or tuple(turns.seconds), tuple(turns.seconds[:1]))
    values = {"seconds": timing.median, "first_seconds": timing.warm_up[0], "calls": float(len(turns.seconds))}
    values |= {"peak_mb": max(turns.peak), "base_mb": turns.base, **turns.written}
    values["faces"] = float(len(course.truth.oracle.mesh.faces))
    samples = {"seconds": turns.seconds[1:], "warm_up": turns.seconds[:1], "peak_mb": turns.peak}
    return blank("timing", values=values, samples=samples)
