"""Rendering against Mitsuba's `sdfgrid`: the same rays on the same samples of a sphere, in turns.

In: nothing of the build. Out: per job (first hits; a mirror; everything), setup and resolution a timed run (every
round's seconds) and an error run against the closed form; and per job and setup what a first frame takes in a fresh
process.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float

from datasets_synthetic.sphere import Sphere
from sdfbake.engine import choose
from sdfbake.grid import Grid
from sdfbake.lattice import Lattice
from sdfrender.kernels import NAMES
from validate.experiment import Bench, Run, guarded
from validate.metrics import summary
from validate.peers.catalogue import OURS, RENDERERS, Found, find
from validate.peers.frames import EVERYTHING, JOBS, View
from validate.peers.process import Process
from validate.timing import Timing, versions

SUITE = "rendering"
SPHERE = Sphere(0.8)
HALF, EYE, SLOPE = 2.0, (0.0, 0.0, 1.7), 0.6  # of the box's edge; the camera; half the picture at unit distance
SIZES, PIXELS = (64, 128, 256, 512), 512
QUICK, QUICK_PIXELS = (64,), 64
COLD = (64, 128)  # samples per axis of the first grid in a fresh process, and of the next
ROUNDS = 8  # frames of every job, the first apart
NUMPY_ROUNDS, NUMPY_SIZES = 2, (64, 256, 512)  # the engine without a compiler takes seconds a frame
LIMIT = 120.0  # seconds that one request may take


@dataclass(frozen=True, slots=True)
class Entry:
    """A renderer with its options, one curve of the report."""

    found: Found
    setup: dict[str, str]

    @property
    def name(self) -> str:
        """Tool and options in words."""
        return ", ".join(self.setup.values())

    @property
    def compiles(self) -> bool:
        """Whether its first frame is compiled."""
        return self.setup.get("engine") != "numpy"

    @property
    def jobs(self) -> tuple[str, ...]:
        """What it can be asked for: footprints and texture coordinates only we have."""
        return tuple(job for job in JOBS if job != EVERYTHING or self.setup["tool"] == OURS)

    @property
    def options(self) -> dict[str, str]:
        """The setup without the tool."""
        return {name: value for name, value in self.setup.items() if name != "tool"}


@dataclass(frozen=True, slots=True)
class _Course:
    """The sphere at one resolution: the samples that every tool is given, and how they are looked at."""

    resolution: int
    folder: Path
    pixels: int

    @property
    def lattice(self) -> Lattice:
        """Cube of samples; the camera stands in it."""
        return Lattice(np.full(3, -HALF), 2 * HALF / (self.resolution - 1), (self.resolution,) * 3)

    @property
    def samples(self) -> str:
        """Path of the samples without suffix: .npy dense [x, y, z], .zarr.zip sparse."""
        return str(self.folder / f"sphere@{self.resolution}")

    def write(self) -> None:
        """Sample the sphere, once for all tools."""
        lattice = self.lattice
        Grid.from_function(SPHERE, lattice=lattice).save(f"{self.samples}.zarr.zip")
        dense = np.empty(lattice.shape, np.float32)
        for i, plane in enumerate(dense):
            index = np.argwhere(np.ones((1, *plane.shape), bool)) + np.array([i, 0, 0])
            plane[...] = SPHERE.distance(lattice.to_world(index)).reshape(plane.shape)
        np.save(f"{self.samples}.npy", dense)

    def job(self, entry: Entry) -> dict[str, Any]:
        """The request that loads it."""
        view = View((-HALF,) * 3, self.lattice.spacing, EYE, SLOPE, self.pixels)
        return {"samples": self.samples, "view": view, "options": entry.options}


@dataclass(slots=True)
class _Turns:
    """What came of an entry's turns at one resolution so far."""

    entry: Entry
    process: Process | None = None
    prepare: float = 0.0
    seconds: dict[str, list[float]] = field(default_factory=dict)
    seen: dict[str, Path] = field(default_factory=dict)
    failure: str = ""

    def ask(self, do: str, **request: object) -> dict[str, Any]:
        """Ask the process; a failure is kept, and nothing is asked after it."""
        if self.failure or self.process is None:
            return {}
        try:
            return self.process.ask(do, LIMIT, **request)
        except RuntimeError as error:
            self.failure = f"failed: {do}: {error}"
            return {}

    def load(self, course: _Course) -> None:
        """Wait for the process and give it the samples."""
        try:
            if self.process is not None:
                self.process.hello()
        except RuntimeError as error:
            self.failure = f"failed: start: {error}"
        self.prepare = self.ask("load", **course.job(self.entry)).get("seconds", 0.0)

    def turn(self, number: int, folder: Path) -> None:
        """Trace a frame of every job; the last one's hits are written to the folder, apart from the clock."""
        rounds = ROUNDS if self.entry.compiles else NUMPY_ROUNDS
        if number >= rounds:
            return
        for job in self.entry.jobs:
            answer = self.ask("frame", job=job)
            if answer:
                self.seconds.setdefault(job, []).append(answer["seconds"])
            if number == rounds - 1:
                self.seen[job] = folder / f"{self.entry.name}, {job}.npz"
                self.ask("look", output=str(self.seen[job]))


def run(bench: Bench) -> Iterator[Run]:
    """Race all renderers that are here; the others have one failed run each."""
    found = [find(peer) for peer in RENDERERS]
    for one in found:
        if not one.here:
            status = f"failed: it cannot run here ({one.problem}); to have it: {one.peer.install}"
            yield Run(SUITE, "every job", {"tool": one.peer.name}, {}, "timing", status=status)
    asked = entries([one for one in found if one.here], quick=bench.quick)
    pixels = QUICK_PIXELS if bench.quick else PIXELS
    with TemporaryDirectory(prefix="rendering-") as name:
        folder = Path(name)
        yield from _starts(bench, [_Course(n, folder, pixels) for n in COLD], asked)
        for n in QUICK if bench.quick else SIZES:
            yield from race(bench, _Course(n, folder, pixels), asked)


def entries(found: Sequence[Found], *, quick: bool = False) -> list[Entry]:
    """Ours with each engine, precision and kernel (quickly: one precision and kernel each), and every other tool."""
    engines = ("numpy", "drjit") if choose().engine.name == "drjit" else ("numpy",)
    listed = []
    for one in found:
        if one.peer.name != OURS:
            listed.append(Entry(one, {"tool": one.peer.name}))
            continue
        for engine in engines:
            ways = [(bits, kernel) for bits in ("32", "64") for kernel in NAMES]
            if quick:
                ways = [("64" if engine == "numpy" else "32", "bspline")]
            listed += [
                Entry(one, {"tool": OURS, "engine": engine, "precision": bits, "kernel": kernel})
                for bits, kernel in ways
            ]
    return listed


# ---- warm ------------------------------------------------------------------------------------------------------------
def race(bench: Bench, course: _Course, asked: Sequence[Entry]) -> Iterator[Run]:
    """Give every renderer its turns, round after round, then look at what it saw."""
    course.write()
    taken = [one for one in asked if one.compiles or bench.quick or course.resolution in NUMPY_SIZES]
    all_ = [_Turns(entry) for entry in taken]
    with ExitStack() as stack:
        for turns in all_:  # started together: loading the libraries overlaps
            turns.process = stack.enter_context(turns.entry.found.start(_home(course.folder)))
        for turns in all_:
            bench.progress(f"rendering, {course.resolution}³: {turns.entry.name}")
            turns.load(course)
        for number in range(ROUNDS):
            bench.progress(f"rendering, {course.resolution}³: round {number + 1} of {ROUNDS}")
            for turns in all_:
                turns.turn(number, course.folder)
        for turns in all_:
            yield from _runs(course, turns)


def _home(folder: Path) -> dict[str, str]:
    """Where Dr.Jit keeps its compiled programs: apart from the user's."""
    home = folder / "home"
    home.mkdir(exist_ok=True)
    return {"HOME": str(home)}


def _runs(course: _Course, turns: _Turns) -> Iterator[Run]:
    """The timed run and the error run of every job."""
    used = versions() | {turns.entry.found.peer.name: turns.entry.found.version}
    truth = seen(course.pixels)
    for job in turns.entry.jobs:
        blank = partial(Run, SUITE, job, turns.entry.setup, {"resolution": course.resolution}, versions=used)
        if turns.failure:
            yield blank("timing", status=turns.failure)
            continue
        seconds = turns.seconds[job]
        timing = Timing(tuple(seconds[1:]), tuple(seconds[:1]))
        values = {"seconds": timing.median, "first_seconds": seconds[0], "prepare_seconds": turns.prepare}
        values["us_per_ray"] = timing.median * 1e6 / course.pixels**2
        yield blank("timing", values=values, samples={"seconds": seconds[1:], "warm_up": seconds[:1]})
        yield guarded(blank("error"), partial(_judged, blank, course, turns.seen[job], truth))


def seen(pixels: int) -> Float[np.ndarray, " n"]:
    """Return the ray parameters at which the camera's rays meet the sphere, row by row; infinite for a miss."""
    x, y = np.meshgrid(*[(np.arange(pixels) + 0.5) * (2 * SLOPE / pixels) - SLOPE] * 2)
    d = np.stack([x, -y, np.full_like(x, -1.0)], axis=-1).reshape(-1, 3)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return SPHERE.intersect(np.broadcast_to(EYE, d.shape), d)


def _judged(blank: partial[Run], course: _Course, path: Path, truth: Float[np.ndarray, " n"]) -> Run:
    with np.load(path) as archive:
        return blank("error", values=judge(dict(archive), truth, course.lattice.spacing))


def judge(found: dict[str, np.ndarray], truth: Float[np.ndarray, " n"], spacing: float) -> dict[str, float]:
    """Compare with the closed form.

    Parameters
    ----------
    found
        `t` of the first hits, infinite for misses; `t2` of the mirrored rays; whatever else must be finite.
    truth
        `t` of the sphere.
    spacing
        World units in a voxel.

    Returns
    -------
    dict
        `wrong_pixels`, of them `missed_pixels`; |t - t*| where both hit, voxels; `met_again`: mirrored rays that meet
        the sphere again, which a convex mirror leaves none.

    Raises
    ------
    ValueError
        If there are not as many rays, or what was found is not finite.
    """
    t = found["t"]
    if t.shape != truth.shape:
        raise ValueError(f"{len(t)} rays were traced, not {len(truth)}")
    for name, array in found.items():
        if name not in ("t", "t2") and not np.isfinite(array).all():
            raise ValueError(f"{np.count_nonzero(~np.isfinite(array))} values of {name} are not finite")
    hit, exact = np.isfinite(t), np.isfinite(truth)
    values = {"rays": float(len(t)), "wrong_pixels": float(np.sum(hit != exact))}
    values["missed_pixels"] = float(np.sum(exact & ~hit))
    both = hit & exact
    values |= {f"t.{key}": one for key, one in summary(np.abs(t[both] - truth[both]) / spacing).items()}
    values["t.p50_world"] = values["t.p50"] * spacing
    if "t2" in found:
        values["met_again"] = float(np.isfinite(found["t2"]).sum())
    return values


# ---- cold ------------------------------------------------------------------------------------------------------------
def _starts(bench: Bench, courses: Sequence[_Course], asked: Sequence[Entry]) -> Iterator[Run]:
    """First frames in fresh processes, with an empty and with a filled cache of compiled programs."""
    for course in courses:
        course.write()
    for entry in (one for one in asked if one.compiles):
        bench.progress(f"rendering, cold start: {entry.name}")
        for job in entry.jobs:
            used = versions() | {entry.found.peer.name: entry.found.version}
            blank = partial(Run, SUITE, f"cold start, {job}", entry.setup, {"resolution": COLD[0]}, versions=used)
            yield guarded(blank("timing"), partial(_started, blank, courses, entry, job))


def _started(blank: partial[Run], courses: Sequence[_Course], entry: Entry, job: str) -> Run:
    """One cold process, which then is given a grid of another size; and one that finds the programs on the disk."""
    with TemporaryDirectory(prefix="home-") as name:
        home = {"HOME": name}
        with entry.found.start(home) as process:
            process.hello()
            cold = _first(process, courses[0], entry, job)
            compiled = _programs(Path(name))
            again = _first(process, courses[1], entry, job)
            more = _programs(Path(name)) - compiled
            warm = _first(process, courses[0], entry, job)
        with entry.found.start(home) as process:
            process.hello()
            disk = _first(process, courses[0], entry, job)
    values = {"cold_seconds": sum(cold), "disk_seconds": sum(disk), "warm_seconds": sum(warm)}
    values |= {"cold_frame": cold[1], "disk_frame": disk[1], "warm_frame": warm[1], "again_frame": again[1]}
    return blank("timing", values=values | {"programs": float(compiled), "programs_again": float(more)})


def _first(process: Process, course: _Course, entry: Entry, job: str) -> tuple[float, float]:
    """Seconds to prepare the field, and of the frame after it."""
    prepare = process.ask("load", LIMIT, **course.job(entry))["seconds"]
    return prepare, process.ask("frame", LIMIT, job=job)["seconds"]


def _programs(home: Path) -> int:
    """Compiled programs on the disk."""
    return len(list((home / ".drjit").glob("*.bin")))
