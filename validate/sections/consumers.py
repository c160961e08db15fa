"""What the report says about exported grids in the programs that they are for."""

from collections.abc import Sequence
from itertools import groupby

from validate.experiment import Run
from validate.peers import limit
from validate.peers.limit import Limit
from validate.section import Headline, Section, Table, number, pick

TITLE = "Exported grids in other programs"
ASKED = (
    "Does a grid arrive where it is sent? Three grids whose axes cannot be taken for each other, none of them a cube, "
    "are exported to every format, the first of them by the command, loaded by the programs that the format is for, "
    "each in a process of its own, and sampled and traced there. Samples, positions, texture coordinates and hits are "
    "held against ours; hits against our linear kernel on the same grid. A program that is not here was not checked."
)
NOTES = (
    "OpenVDB's surface is made of one vertex per cell, the mean of its crossings; it lies off the interpolant by what "
    "the surface bends within a cell. A spline of coefficients is held against that of distances which are exact "
    "everywhere, and on the ellipsoid against the closed form.",
    "Memory is the most of a process beyond what it had with the grid loaded; a slab is eight samples of the files "
    "thick. Seconds are those of writing; loading the grid comes first.",
)
_WORST = "hits, p99"


def _figure(runs: Sequence[Run], name: str, **setup: str) -> float | None:
    """Greatest of a figure over the runs of a setup; None if there are none."""
    kind = "timing" if setup.get("check") == "cost" else "error"
    found = [run.values[name] for run in pick(runs, kind, **setup) if name in run.values]
    return max(found, default=None)


def _large(runs: Sequence[Run], name: str, format_: str) -> float | None:
    return _figure([run for run in runs if run.knob.get("resolution") == 512], name, format=format_, check="cost")


def _bytes(runs: Sequence[Run]) -> float | None:
    written = _large(runs, "file_bytes", "vdb")
    return None if written is None else written / 1e6


def _slabs(runs: Sequence[Run]) -> float | None:
    """Memory above the grid, in slabs, of the worst of the formats that are written in slabs."""
    costs = [run.values for run in pick(runs, "timing", check="cost")]
    found = [values["above_mb"] / values["slab_mb"] for values in costs if {"above_mb", "slab_mb"} <= values.keys()]
    return max(found, default=None)


def _hits(runs: Sequence[Run]) -> float | None:
    at = [run for run in runs if run.knob.get("resolution") == 256]
    return _figure(at, "figure", consumer="Mitsuba", check=_WORST)


LIMITS = (
    Limit("Hits of Mitsuba's sdfgrid against ours, bunny at 256³, p99", 0.01, "voxel", _hits, headline=True),
    Limit(
        "Samples through OpenVDB, greatest difference",
        0.0,
        "voxel",
        lambda runs: _figure(runs, "figure", consumer="OpenVDB", check="values"),
        headline=True,
    ),
    Limit("Bunny at 512³ to vdb, written in", 3.0, "s", lambda runs: _large(runs, "seconds", "vdb"), headline=True),
    Limit("Bunny at 512³ to vdb with texture coordinates", 60.0, "MB", _bytes),
    Limit("Memory of a dense export above the grid, worst format", 1.0, "slabs", _slabs),
)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    figures = limit.figures(LIMITS, runs)
    return Section(
        name="consumers",
        title=TITLE,
        asked=ASKED,
        finding=(*_finding(runs), limit.met(figures)),
        headlines=(*_headlines(runs), *limit.headlines(figures)),
        tables=(_table(runs), limit.table(figures), _checks(runs), _costs(runs)),
        notes=NOTES,
    )


def _readings(runs: Sequence[Run]) -> list[tuple[tuple[str, str, str, int], list[Run]]]:
    """Return the runs by format, program, specimen and resolution, in their order; those not checked too."""

    def key(run: Run) -> tuple[str, str, str, int]:
        return run.setup["format"], run.setup["consumer"], run.problem, int(run.knob.get("resolution", 0))

    return [(of, list(group)) for of, group in groupby((run for run in runs if "consumer" in run.setup), key)]


def _passed(group: Sequence[Run]) -> bool:
    return all(run.ok and run.values["passed"] == 1 for run in group)


def _unchecked(group: Sequence[Run]) -> bool:
    return any(run.status.startswith("not checked") for run in group)


def _headlines(runs: Sequence[Run]) -> tuple[Headline, ...]:
    checked = [_passed(group) for _, group in _readings(runs) if not _unchecked(group)]
    if not checked:
        return ()
    said = f"{sum(checked)} of {len(checked)}"
    return (Headline("Exported files that other programs read as we do", said, "all", all(checked)),)


def _finding(runs: Sequence[Run]) -> tuple[str, ...]:
    groups = _readings(runs)
    checked = [(of, group) for of, group in groups if not _unchecked(group)]
    wrong = [f"{of[0]} in {of[1]} ({of[2]})" for of, group in checked if not _passed(group)]
    absent = dict.fromkeys(f"{of[1]} ({of[0]})" for of, group in groups if _unchecked(group))
    programs = len({of[:2] for of, _ in checked})
    tail = f"; not {', '.join(wrong)}" if wrong else ""
    head = f"Of {len(checked)} files read by {programs} pairs of format and program, {len(checked) - len(wrong)} agree"
    sentences = [f"{head}{tail}." if checked else "No program that reads exported grids was here."]
    margin = min((run.values["margin"] for run in pick(runs) if "margin" in run.values), default=None)
    if margin is not None:
        sentences.append(
            f"Any other order or direction of the axes would be off by at least {number(margin)} voxels somewhere; the "
            f"greatest error of a hit is {number(_figure(runs, 'figure', check=_WORST))} voxel at the 99th percentile."
        )
    drawn = [run.values for run in pick(runs) if "colour_mean" in run.values]
    if drawn:
        mean, most = (max(values[name] for values in drawn) for name in ("colour_mean", "colour_max"))
        sentences.append(
            "Where both hit, pictures of the web page in Chromium differ from the renderer's by at most "
            f"{number(mean)} of 255 on average, and by {number(most)} at a pixel: seams, and float16."
        )
    if absent:
        sentences.append(f"Not checked: {', '.join(absent)}.")
    return tuple(sentences)


def _table(runs: Sequence[Run]) -> Table:
    """One row per file and program: the worst of its figures in voxels, against its limit."""
    rows = []
    for (format_, consumer, problem, resolution), group in _readings(runs):
        what = f"{format_}, {consumer}"
        if not all(run.ok for run in group):
            why = "not checked" if _unchecked(group) else "failed"
            rows.append((what, problem, "-", "-", "-", why))
            continue
        worst = _worst(group)
        named = ", ".join(run.setup["check"] for run in group)
        at = f"{problem}, {resolution}³"
        off = [run.setup["check"] for run in group if run.values["passed"] != 1]
        result = f"no: {', '.join(off)}" if off else "agrees"
        rows.append((what, at, named, _said(worst), number(worst.values["limit"]), result))
    header = ("Format, program", "grid", "what was compared", "error nearest to its limit, voxel", "limit", "result")
    return Table("What every program reads, against ours.", header, tuple(rows), prose=(2, 1, 3, 5))


def _said(run: Run) -> str:
    return f"{number(run.values['figure'])} ({run.setup['check']})"


def _worst(group: Sequence[Run]) -> Run:
    """Return the comparison in voxels that is nearest to its limit."""

    def share(run: Run) -> float:
        figure, most = run.values["figure"], run.values["limit"]
        return figure / most if most else float("inf") if figure else 0.0

    return max([run for run in group if run.setup["unit"] == "voxel"] or group, key=share)


def _checks(runs: Sequence[Run]) -> Table:
    rows = tuple(
        (
            f"{run.setup['format']}, {run.setup['consumer']}",
            f"{run.problem}, {run.knob['resolution']}³",
            run.setup["check"],
            f"{number(run.values['figure'])} {run.setup['unit']}".strip(),
            number(run.values["limit"]),
            number(run.values["count"]),
        )
        for run in runs
        if run.ok and "consumer" in run.setup
    )
    header = ("Format, program", "grid", "compared", "greatest error", "limit", "numbers compared")
    return Table("All comparisons.", header, rows, prose=(1, 2))


def _costs(runs: Sequence[Run]) -> Table:
    rows = tuple(
        (
            f"{run.setup['format']}, {run.knob['resolution']}³",
            *(number(run.values.get(name)) for name in ("load_seconds", "seconds")),
            number(run.values["file_bytes"] / 1e6),
            *(number(run.values.get(name)) for name in ("above_mb", "slab_mb")),
        )
        for run in pick(runs, "timing", check="cost")
    )
    header = ("Format", "loading, s", "writing, s", "files, MB", "memory above the grid, MB", "a slab, MB")
    return Table("Exports of the bunny with its texture coordinates.", header, rows)
