"""Exported grids in the programs that they are for: what these read, sample and trace, against ours.

In: nothing of the build but, where they are there, the bunny's grids at 256 and 512. Out: per format, program, specimen
and check an error run, with figure and limit; programs that are not here have one run each that says so.
"""

import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sdfbake.complaint import BadInput
from sdfbake.export import FORMATS, export
from sdfbake.grid import Grid
from validate import browser
from validate.experiment import Bench, Run, guarded
from validate.peers.catalogue import Found, find
from validate.peers.consumers import CONSUMERS, UNTRIED, Consumer
from validate.peers.process import Process
from validate.peers.proof import DIFFER, GRAZES, HITS, Check, judged
from validate.peers.specimens import SPECIMENS, Specimen, specimen
from validate.timing import versions
from validate.viewer import compare

SUITE = "consumers"
RESOLUTION = 64
QUICK = 48
LIMIT = 60.0  # seconds that one request may take
NOT_CHECKED = "not checked"
PAGE, CHROMIUM, PIXELS = "view", "Chromium", (128, 128)
TRACED, LARGE = "vol", 256  # what a limit was set for
WEIGHED = "validate.peers.exporting"
Exporter = Callable[[Path, str, Path], str]
COSTS = {"vdb": 512} | dict.fromkeys(("vti", "vol", "npy", "coefficients"), LARGE)


@dataclass(frozen=True, slots=True)
class Exports:
    """The files of a specimen.

    Attributes
    ----------
    specimen
        What was exported.
    source
        Its grid file.
    files
        By format.
    problems
        What an export that failed said, by format.
    """

    specimen: Specimen
    source: Path
    files: dict[str, Path]
    problems: dict[str, str]


def run(bench: Bench) -> Iterator[Run]:
    """Export every specimen to every format, and ask every program that is here."""
    found = [(consumer, find(consumer.peer)) for consumer in CONSUMERS]
    here = [(consumer, one) for consumer, one in found if one.here]
    chromium = browser.found()
    with TemporaryDirectory(prefix="consumers-") as name, ExitStack() as stack:
        processes = [stack.enter_context(one.start()) for _, one in here]  # together: loading the libraries overlaps
        for process in processes:
            process.hello()
        for number, title in enumerate(SPECIMENS):
            bench.progress(f"exports of the {title}")
            given = specimen(title, QUICK if bench.quick else RESOLUTION)
            made = exported(given, Path(name), commanded if number == 0 else called)
            for (consumer, one), process in zip(here, processes, strict=True):
                bench.progress(f"{one.peer.name} reads {consumer.format}: {title}")
                yield from proven(consumer, one, process, made)
            if chromium is not None:
                bench.progress(f"{CHROMIUM} draws the web page: {title}")
                yield from _drawn(made, chromium)
        if not bench.quick:
            yield from _large(bench, Path(name), here, processes)
    if not bench.quick:
        yield from _costs(bench)
    yield from _absent([(consumer, one) for consumer, one in found if not one.here])
    if chromium is None:
        yield _unchecked(PAGE, CHROMIUM, f"none of {', '.join(browser.NAMES)} is on the path; to have it: install one")


def _large(
    bench: Bench, folder: Path, here: Sequence[tuple[Consumer, Found]], processes: Sequence[Process]
) -> Iterator[Run]:
    """What a limit was set for at a resolution of its own: the build's bunny in Mitsuba."""
    for (consumer, one), process in zip(here, processes, strict=True):
        if consumer.format == TRACED:
            bench.progress(f"{one.peer.name} reads {consumer.format}: bunny, {LARGE}³")
            setup = {"format": consumer.format, "consumer": one.peer.name, "check": "all"}
            blank = Run(SUITE, "bunny", setup, {"resolution": LARGE}, "error")
            try:
                grid = Grid.load(bench.grid("bunny", LARGE))
            except BadInput as error:
                yield replace(blank, status=f"{NOT_CHECKED}: {error}")
                continue
            made = exported(Specimen(f"bunny {LARGE}", grid, grid), folder, commanded, (TRACED,))
            yield from (replace(run, problem="bunny") for run in proven(consumer, one, process, made))


def _costs(bench: Bench) -> Iterator[Run]:
    """Seconds, bytes and memory of exports of the build's bunny, each in a process of its own."""
    for to, resolution in COSTS.items():
        bench.progress(f"cost of {to}: bunny, {resolution}³")
        setup = {"format": to, "check": "cost"}
        blank = Run(SUITE, "bunny", setup, {"resolution": resolution}, "timing")
        yield guarded(blank, partial(_weighed, blank, bench, to, resolution))


def _weighed(blank: Run, bench: Bench, to: str, resolution: int) -> Run:
    source = bench.grid("bunny", resolution).resolve()  # the process that loads it runs elsewhere
    with TemporaryDirectory(prefix="consumers-") as folder, Process(sys.executable, WEIGHED) as process:
        process.hello()
        output = Path(folder) / f"bunny{FORMATS[to].suffix}"
        return replace(blank, values=process.ask("export", LIMIT, source=str(source), to=to, output=str(output)))


def _drawn(made: Exports, chromium: str) -> list[Run]:
    """Draw a specimen in its web page, and compare with the renderer's picture."""
    setup = {"format": PAGE, "consumer": CHROMIUM}
    blank = partial(_blank, made.specimen, setup, {})
    found: dict[str, float] = {}

    def draw() -> Run:
        found.update(compare(made.source, chromium, size=PIXELS))
        return blank("all")

    whole = guarded(blank("all"), draw)
    if not whole.ok:
        return [whole]
    hits = int(found["hits"])
    checks = (
        Check("hits, p99", found["t_p99"], HITS, "voxel", hits),
        Check("hit or miss", found["missed_share"], GRAZES, f"of all {DIFFER}", hits),
        Check("complaints and requests", found["complaints"] + found["requests"], 0, "in all", 1),
    )
    return [blank(check.what, check.unit, _figures(check, made) | found) for check in checks]


def _absent(missing: Iterable[tuple[Consumer, Found]]) -> Iterator[Run]:
    """Say what was not checked, and how it could be."""
    for consumer, one in missing:
        yield _unchecked(consumer.format, one.peer.name, f"{one.problem}; to have it: {one.peer.install}")
    for format_, name, why in UNTRIED:
        yield _unchecked(format_, name, why)


def _unchecked(format_: str, name: str, why: str) -> Run:
    setup = {"format": format_, "consumer": name, "check": NOT_CHECKED}
    return Run(SUITE, "every specimen", setup, {}, "error", status=f"{NOT_CHECKED}: {why}")


def exported(given: Specimen, folder: Path, export: Exporter, formats: Iterable[str] = FORMATS) -> Exports:
    """Save a specimen and export it to formats."""
    stem = given.name.replace(", ", "-").replace(" ", "-")
    source = folder / f"{stem}.zarr.zip"
    given.grid.save(source)
    files = {name: folder / stem / name / f"{stem}{FORMATS[name].suffix}" for name in formats}
    for path in files.values():
        path.parent.mkdir(parents=True)
    with ThreadPoolExecutor(2) as pool:
        said = dict(zip(files, pool.map(partial(export, source), files, files.values()), strict=True))
    return Exports(given, source, files, {name: problem for name, problem in said.items() if problem})


def called(source: Path, to: str, output: Path) -> str:
    """Export by the function; return what it complains about, nothing if it does not."""
    try:
        export(Grid.load(source), output, to)
    except BadInput as error:
        return f"export to {to}: {error}"
    return ""


def commanded(source: Path, to: str, output: Path) -> str:
    """Export by the command, as a user would; as `called`."""
    command = [sys.executable, "-m", "sdfbake", "export", str(source), "--to", to, "-o", str(output)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else f"export to {to}: {(done.stderr.strip().splitlines() or ['no word'])[-1]}"


def proven(consumer: Consumer, found: Found, process: Process, made: Exports) -> list[Run]:
    """Let a program read a file; one run per check, or one that failed."""
    setup = {"format": consumer.format, "consumer": found.peer.name}
    blank = partial(_blank, made.specimen, setup, {found.peer.name: found.version})
    checks: list[Check] = []

    def ask() -> Run:
        checks.extend(_asked(consumer.format, process, made))
        return blank("all")

    whole = guarded(blank("all"), ask)
    return [blank(check.what, check.unit, _figures(check, made)) for check in checks] if whole.ok else [whole]


def _blank(
    given: Specimen,
    setup: dict[str, str],
    used: dict[str, str],
    check: str,
    unit: str = "",
    values: dict[str, float] | None = None,
) -> Run:
    """Return the record of a check."""
    knob: dict[str, float | int] = {"resolution": max(given.grid.lattice.shape)}
    setup = setup | {"check": check, "unit": unit}
    return Run(SUITE, given.name, setup, knob, "error", values or {}, versions=versions() | used)


def _figures(check: Check, made: Exports) -> dict[str, float]:
    passed = float(check.passed)
    values = {"figure": check.figure, "limit": check.limit, "count": float(check.count), "passed": passed}
    return values | {"margin": made.specimen.margin}


def _asked(format_: str, process: Process, made: Exports) -> Sequence[Check]:
    """Ask a process about a file."""
    if format_ in made.problems:
        raise ValueError(made.problems[format_])
    path = made.files[format_]
    question, answer = path.with_name("question.npz"), path.with_name("answer.npz")
    np.savez(question, **made.specimen.question._asdict())
    words = process.ask("look", LIMIT, path=str(path), question=str(question), output=str(answer))["words"]
    with np.load(answer) as archive:
        return judged(made.specimen, dict(archive), words)
