"""What the report says about the bakers: error against run time, memory, files, and the limits that were set."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.peers import limit
from validate.peers.catalogue import OURS, PEERS
from validate.peers.limits import (
    LABELS,
    LAYERED,
    LIMITS,
    NUMPY,
    VDB,
    Point,
    Points,
    figure,
    label_of,
    paired,
    problems,
    ratio,
    sizes,
)
from validate.peers.oracle import NEAR
from validate.plots import Panel, Series
from validate.section import Picture, Section, Table, number, pick

TITLE = "Bakers against each other"
ASKED = (
    "What does a band of signed distances cost, and how wrong is it? Ours and other tools bake the same meshes on the "
    "same lattice in turns, each in a process of its own, so that all of them see the same machine. Loading libraries "
    f"and the mesh is not timed. At up to 20,000 samples within {NEAR:g} voxels of the surface, the same for all "
    "tools, distances are compared with float64 distances, signs with winding numbers, and faces, where a tool names "
    "them, with all that are equally near."
)
# An error of 0 has no place on a logarithmic axis.
LEAST = 1e-9


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    points = paired(runs)
    if not any(point.timing and point.error for point in points.values()):
        return Section("baking", TITLE, ASKED, ("No tool has both a timed run and an error run that succeeded.",))
    figures = limit.figures(LIMITS, points)
    return Section(
        name="baking",
        title=TITLE,
        asked=ASKED,
        finding=(*_against_openvdb(points), *_quicker(points), limit.met(figures)),
        headlines=limit.headlines(figures),
        pictures=(Picture(plots.work_precision(_panels(points)), "Labels are samples per axis, N."),),
        tables=(limit.table(figures), *(_table(points, problem) for problem in problems(points))),
        notes=_notes(runs),
    )


# ---- sentences -------------------------------------------------------------------------------------------------------
def _against_openvdb(points: Points) -> tuple[str, ...]:
    """Ours and OpenVDB at the largest size that both have, mesh by mesh."""
    sentences = []
    for problem in problems(points):
        both = [n for n in sizes(points, problem, OURS) if ratio(points, problem, OURS, n) is not None]
        if not both:
            continue
        n = 512 if 512 in both else both[-1]
        ours, theirs, times, far, near = (
            figure(points, problem, OURS, n, "seconds"),
            figure(points, problem, VDB, n, "seconds"),
            ratio(points, problem, OURS, n),
            figure(points, problem, VDB, n, "error.max"),
            figure(points, problem, OURS, n, "error.max"),
        )
        sentences.append(
            f"On {problem} at {n}³ ours takes {number(ours)} s, {number(times)} times OpenVDB's {number(theirs)} s; "
            f"distances are off by up to {number(near)} voxel, OpenVDB's by up to {number(far)}."
        )
    return tuple(sentences)


def _quicker(points: Points) -> tuple[str, ...]:
    """Where another tool takes less time than ours, a sentence per tool."""
    sentences = []
    for label in dict.fromkeys(label for _, label, _ in points if label not in (OURS, LAYERED, NUMPY)):
        shares = {(p, n): ratio(points, p, label, n, other=OURS) for p, one, n in points if one == label}
        lost = {key: share for key, share in shares.items() if share is not None and share < 1}
        if lost:
            where = ", ".join(f"{problem} at {n}³ ({share:.2f} times ours)" for (problem, n), share in lost.items())
            worst = max(figure(points, problem, label, n, "error.max") or 0.0 for problem, n in lost)
            sentences.append(f"{label} is quicker on {where}, with errors of up to {number(worst)} voxel.")
    return tuple(sentences) or ("No tool is quicker than ours anywhere.",)


# ---- picture and tables ----------------------------------------------------------------------------------------------
def _panels(points: Points) -> list[Panel]:
    present = [label for label in LABELS if any(key[1] == label for key in points)]
    axes = ("greatest error of a distance, voxel", "seconds")
    panels = []
    for problem in problems(points):
        # A tool without points on this mesh keeps its place, and so its colour and marker.
        series = tuple(_series(points, problem, label) for label in present)
        if any(len(one.x) for one in series):
            panels.append(Panel(problem, series, *axes))
    return panels


def _series(points: Points, problem: str, label: str) -> Series:
    both = [points[problem, label, n] for n in sizes(points, problem, label)]
    good = [point for point in both if point.timing and point.error]
    error = np.array([max(point.value("error.max") or 0.0, LEAST) for point in good])
    seconds = np.array([point.value("seconds") for point in good], np.float64)
    return Series(label if good else f"{label}: no run", error, seconds, tuple(f"{p.resolution}" for p in good))


COLUMNS = (
    ("seconds", "seconds"),
    ("first_seconds", "first call"),
    ("peak_mb", "memory, MB"),
    ("error.max", "error, voxel max"),
    ("error.p99", "p99"),
    ("error.p50", "p50"),
    ("wrong_signs", "wrong signs"),
    ("wrong_faces", "wrong faces"),
    ("file_bytes", "file, MB"),
    ("write_seconds", "writing, s"),
)


def _table(points: Points, problem: str) -> Table:
    rows = []
    keys = [key for key in points if key[0] == problem]
    for key in sorted(keys, key=lambda key: (key[2], LABELS.index(key[1]) if key[1] in LABELS else len(LABELS))):
        point = points[key]
        cells = [number(None if value is None else value * scale) for value, scale in _cells(point)]
        if point.timing is None:
            cells[0] = "failed"
        rows.append((f"{key[2]}³, {key[1]}", *cells, number(ratio(points, *key))))
    header = ("Setup", *(title for _, title in COLUMNS), "time over OpenVDB's")
    return Table(f"{problem}: medians of the calls after the first.", header, tuple(rows))


def _cells(point: Point) -> list[tuple[float | None, float]]:
    return [(point.value(name), 1e-6 if name == "file_bytes" else 1.0) for name, _ in COLUMNS]


def _notes(runs: Sequence[Run]) -> tuple[str, ...]:
    """What each tool was asked for, and how often."""
    asked = " ".join(f"{peer.name}: {peer.about}." for peer in PEERS)
    once = {f"{label_of(run.setup)} at {run.knob['resolution']:g}³" for run in pick(runs, "timing")
            if run.values.get("calls") == 1 and "resolution" in run.knob}  # fmt: skip
    single = f" Called once only, where one call took long: {', '.join(sorted(once))}." if once else ""
    how = (
        "Seconds are the median of the calls after the first; memory is the greatest of the whole process, libraries "
        "and mesh included; a file is written once. Asking for the samples that are compared is not timed."
    )
    return (asked, how + single)
