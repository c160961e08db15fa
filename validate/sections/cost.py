"""What the report says about what exactness costs a bake."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.frontier import pareto
from validate.plots import Panel, Series
from validate.section import Picture, Section, Table, number, percent, pick

TITLE = "What exactness costs a bake"
ASKED = (
    "What do more samples, and other ways to hold texture coordinates, cost in seconds and in bytes? Meshes are baked "
    "at rising resolutions, without texture coordinates and with them as faces, layers or grid. Errors are distances, "
    "interpolated (B-spline) against exact ones (libigl, float64) at 20,000 random points within a voxel of the mesh, "
    "in units of its longest side; and levels of detail of camera rays, against the mesh by Embree. Errors and times "
    "come from separate runs, and the black line joins what nothing else beats."
)
NOTES = (
    "Bytes are those of the file that holds one way of texture coordinates alone; 'faces' carries the mesh, whatever "
    "the resolution. Per sample they are over all samples of the bricks that are stored. A bake of less than 0.8 s is "
    "timed three times and the median taken, a longer one once; files are not written inside the clock.",
    "The asset knows the greatest error of every brick, at two places of one in eight cells; over bricks that is more "
    "than the error at a random point.",
)
MODES = ("none", "faces", "layers", "grid")
TITLES = {"none": "none", "faces": "faces", "layers": "layers", "grid": "grid (Galim 2018)"}
DISTANCE, LEVEL = "distance.bspline.p50", "lod.p50"

Pair = tuple[Run, Run]


class Axis(NamedTuple):
    """A cost: what it is called in a sentence and beside a diagram, and where it is."""

    words: str
    title: str
    of: Callable[[Run, Run], float]


AXES = (
    Axis("seconds", "seconds to bake", lambda error, timing: timing.values["seconds"]),
    Axis("bytes", "megabytes in the file", lambda error, timing: error.values["bytes"] / 1e6),
)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    problems = {problem: _pairs(runs, problem) for problem in dict.fromkeys(run.problem for run in runs)}
    problems = {problem: pairs for problem, pairs in problems.items() if pairs}
    finding: list[str] = []
    pictures: list[Picture] = []
    for problem, pairs in problems.items():
        for sentences in (_doublings, _facets, _fronts, _finest, _own):
            finding += sentences(problem, pairs)
        pictures += _pictures(problem, pairs)
    return Section(
        name="cost",
        title=TITLE,
        asked=ASKED,
        finding=tuple(finding) or ("No setup has both an error run and a timed run that succeeded.",),
        pictures=tuple(pictures),
        tables=tuple(_table(problem, pairs) for problem, pairs in problems.items()),
        notes=NOTES,
    )


def _pairs(runs: Sequence[Run], problem: str) -> list[Pair]:
    """Error and timed runs of a mesh, by mode and resolution."""
    times = {(run.setup["uv"], run.knob["resolution"]): run for run in pick(runs, "timing") if run.problem == problem}
    pairs = []
    for run in pick(runs):
        timing = times.get((run.setup["uv"], run.knob["resolution"]))
        if run.problem == problem and timing is not None:
            pairs.append((run, timing))
    return sorted(pairs, key=lambda pair: (MODES.index(pair[0].setup["uv"]), pair[0].knob["resolution"]))


def _sweep(pairs: Sequence[Pair], mode: str, error: str) -> list[Pair]:
    return [pair for pair in pairs if pair[0].setup["uv"] == mode and error in pair[0].values]


def _pictures(problem: str, pairs: Sequence[Pair]) -> list[Picture]:
    pictures = []
    wanted = ((DISTANCE, "median error of the distance, longest sides"), (LEVEL, "median error of the level of detail"))
    for error, title in wanted:
        sweeps = [(mode, sweep) for mode in MODES if (sweep := _sweep(pairs, mode, error))]
        if not sweeps:
            continue
        panels = []
        for axis in AXES:
            series = tuple(_series(TITLES[mode], sweep, error, axis) for mode, sweep in sweeps)
            panels.append(Panel(f"{problem.capitalize()}: {axis.words}", series, title, axis.title))
        text = f"{problem.capitalize()}: {title}, against what it costs; labels are samples along the longest axis."
        pictures.append(Picture(plots.work_precision(panels), text))
    return pictures


def _series(name: str, sweep: Sequence[Pair], error: str, axis: Axis) -> Series:
    """One curve; a logarithmic axis has no zero."""
    x = np.array([max(run.values[error], 1e-12) for run, _ in sweep])
    y = np.array([axis.of(*pair) for pair in sweep])
    return Series(name, x, y, tuple(f"{run.knob['resolution']:g}" for run, _ in sweep))


def _doublings(problem: str, pairs: Sequence[Pair]) -> list[str]:
    """What each doubling buys and costs, without texture coordinates: geometric means over the sweep."""
    sweep = _sweep(pairs, "none", DISTANCE)
    if len(sweep) < 2:
        return []
    first, last = sweep[0], sweep[-1]
    doublings = np.log2(last[0].knob["resolution"] / first[0].knob["resolution"])

    def each(a: float, b: float) -> str:
        return number(float((b / a) ** (1 / doublings)))

    p50, p99 = (
        each(last[0].values[name], first[0].values[name]) for name in (DISTANCE, DISTANCE.replace("p50", "p99"))
    )
    seconds, size = (each(axis.of(*first), axis.of(*last)) for axis in AXES)
    return [
        f"{problem.capitalize()}: from {first[0].knob['resolution']:g}³ to {last[0].knob['resolution']:g}³ each "
        f"doubling divides the error of the distance by {p50} (median) and {p99} (99 %), takes {seconds} times the "
        f"seconds and {size} times the bytes."
    ]


def _facets(problem: str, pairs: Sequence[Pair]) -> list[str]:
    """Where a kernel of lower order is no worse: the distance of a mesh has an edge at every edge."""
    sweep = [run for run, _ in _sweep(pairs, "none", DISTANCE)]
    straight = [run for run in sweep if run.values["distance.linear.p50"] <= 1.2 * run.values[DISTANCE]]
    if not straight:
        return []
    run = straight[0]
    return [
        f"{problem.capitalize()}: at {run.knob['resolution']:g}³, where edges are {number(run.values['edge_over_h'])} "
        f"voxels long, linear interpolation errs by {number(run.values['distance.linear.p50'])}, the B-spline by "
        f"{number(run.values[DISTANCE])}: facets decide, not the kernel."
    ]


def _fronts(problem: str, pairs: Sequence[Pair]) -> list[str]:
    """Which modes are on the front of the level of detail."""
    held = [pair for pair in pairs if LEVEL in pair[0].values]
    if len({pair[0].setup["uv"] for pair in held}) < 2:
        return []
    sentences = []
    for axis in AXES:
        cost = np.array([axis.of(*pair) for pair in held])
        front = pareto(np.array([pair[0].values[LEVEL] for pair in held]), cost)
        modes = [held[i][0].setup["uv"] for i in front]
        shares = ", ".join(f"{modes.count(mode)} {mode}" for mode in dict.fromkeys(modes))
        absent = [mode for mode in MODES[1:] if mode not in modes and _sweep(held, mode, LEVEL)]
        beaten = f"; {' and '.join(absent)} never" if absent else ""
        sentences.append(
            f"{problem.capitalize()}, level of detail against {axis.words}: on the front are {shares}{beaten}."
        )
    return sentences


def _finest(problem: str, pairs: Sequence[Pair]) -> list[str]:
    """The modes beside each other at the finest resolution."""
    held = [pair for pair in pairs if LEVEL in pair[0].values]
    if not held:
        return []
    finest = max(pair[0].knob["resolution"] for pair in held)
    words = "; ".join(
        f"as {run.setup['uv']} {number(run.values[LEVEL])} (median) and {number(run.values['lod.p95'])} (95 %), off by "
        f"more than a half in {percent(run.values['lod.share>0.5'])} of the pixels, for "
        f"{number(timing.values['seconds'])} s and {number(run.values['bytes'] / 1e6)} MB"
        for run, timing in held
        if run.knob["resolution"] == finest
    )
    return [f"{problem.capitalize()} at {finest:g}³, error of the level of detail: {words}."]


def _own(problem: str, pairs: Sequence[Pair]) -> list[str]:
    """What the asset says of its own error, against the independent check."""
    said = [run for run, _ in _sweep(pairs, "none", "asset.bspline.p50")]
    if not said:
        return []
    finest = max(said, key=lambda run: run.knob["resolution"])
    own, found = (finest.values[f"{name}.bspline.p50"] for name in ("asset", "distance"))
    worst, most = finest.values["asset.bspline.max"], finest.values["distance.bspline.max"]
    return [
        f"{problem.capitalize()} at {finest.knob['resolution']:g}³: of its distances the asset itself says "
        f"{number(own)} (median over bricks) and at most {number(worst)}; the independent check at random points finds "
        f"{number(found)} and at most {number(most)}."
    ]


def _table(problem: str, pairs: Sequence[Pair]) -> Table:
    columns = (DISTANCE, "distance.bspline.p99", "distance.linear.p50", LEVEL, "lod.p95")
    rows = tuple(
        (
            f"{run.setup['uv']}, {run.knob['resolution']:g}³",
            *(number(run.values.get(name)) for name in columns),
            percent(run.values.get("lod.share>0.5")),
            number(timing.values["seconds"]),
            number(run.values["bytes"] / 1e6),
            number(run.values["bytes_per_sample"]),
            number(run.values["samples"] / 1e6),
        )
        for run, timing in pairs
    )
    errors = ("distance p50", "p99", "linear p50", "LoD p50", "p95", "> 0.5")
    header = ("Texture coordinates", *errors, "s", "MB", "bytes per sample", "million samples")
    return Table(f"{problem.capitalize()}: errors and costs of a bake.", header, rows)
