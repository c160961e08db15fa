"""What the report says about levels of grids that are chosen by footprint."""

from collections.abc import Sequence

import numpy as np

from sdfrender.levelreach import SHARE
from validate import plots
from validate.experiment import Run
from validate.plots import Panel, Series
from validate.section import Headline, Picture, Section, Table, number, percent, pick
from validate.suites.levels import BOUNCE, BUNNY, FAR, FINEST, FOOTPRINT, TORUS

TITLE = "Levels of the grid by footprint"
ASKED = (
    "Galim 2018 leaves levels of detail of the voxel grid itself to future work. Here a ray may meet the coarsest "
    "level whose voxels are at most a share of its footprint's width. What is that off by, and what does it save? The "
    "share is swept, for a view from nearer and farther (fewer pixels), for an exact shape and for one in a mirror."
)
NOTES = (
    "Off unless a scene asks for it, and the only approximation beside a resolution chosen by itself. Differences are "
    "from the finest level, of the torus from its closed form; places beside a seam are left out of those of J and of "
    "the level of detail. Normals of the bunny differ by what coarser voxels round off its facets.",
    "Levels are those that rays of the picture can choose: no other is loaded. Where rays go on from mirrors or "
    "through glass, all are. Timed are hits and normals.",
)
TINY = 1e-7  # of a pixel: where a difference of 0 is drawn
HEADER = (
    "Picture", "share", "voxels, px", "hit, px", "95 %", "normal, °", "J",
    "LoD", "hit or missed", "MSE", "FLIP", "µs per ray",
)  # fmt: skip


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    order = (BUNNY, TORUS, BOUNCE)
    errors = [run for run in pick(runs) if run.problem != FAR]
    errors.sort(key=lambda run: (order.index(run.problem), -run.knob["pixels"], run.knob["share"]))
    clock = {_key(run): run.values["us_per_ray"] for run in pick(runs, "timing") if run.problem != FAR}
    rows = tuple(_row(run, clock) for run in errors)
    about = (
        "By the share of a ray's width that voxels may have; J is relative, MSE and FLIP are from supersampled truths."
    )
    tables = (Table(about, HEADER, rows),) if rows else ()
    return Section(
        name="levels",
        title=TITLE,
        asked=ASKED,
        finding=(*_bias(errors), *_saved(runs, clock)) or ("No run succeeded.",),
        headlines=_headlines(errors, runs),
        pictures=_pictures(errors, clock),
        tables=(*tables, *_read(runs)),
        notes=NOTES,
    )


Key = tuple[str, float, float]


def _key(run: Run) -> Key:
    """Name a picture and the share; 0 for the finest level."""
    return run.problem, run.knob["pixels"], run.knob["share"]


def _row(run: Run, clock: dict[Key, float]) -> tuple[str, ...]:
    values, share = run.values, run.knob["share"]
    finest, coarsest = (number(values[name]) for name in ("finest_px", "coarsest_px"))
    return (
        f"{run.problem}, {run.knob['pixels']:.0f} pixels",
        f"{share:g}" if share else FINEST,
        finest if finest == coarsest else f"{finest} to {coarsest}",
        *(number(values.get(name)) for name in ("hit.p50", "hit.p95", "normal.p50", "jacobian.p50", "lod.p50")),
        percent(values["missed"]),
        *(number(values[name]) for name in ("mse", "flip")),
        number(clock.get(_key(run))),
    )


def _chosen(errors: Sequence[Run], problem: str) -> list[Run]:
    """Runs with the share that is taken by default."""
    return [run for run in errors if run.problem == problem and run.knob["share"] == SHARE]


def _bias(errors: Sequence[Run]) -> tuple[str, ...]:
    """Say what the default is off by, from the worst of its pictures."""
    sentences = []
    for problem, against in ((BUNNY, "the finest level"), (TORUS, "the exact shape"), (BOUNCE, "the finest level")):
        found = _chosen(errors, problem)
        if found:
            worst = {
                name: max(run.values.get(name, 0.0) for run in found) for name in ("hit.p50", "hit.p95", "lod.p50")
            }
            sentences.append(
                f"With voxels of at most {SHARE:g} of a footprint's width ({problem}), half of the hits lie within "
                f"{number(worst['hit.p50'])} pixels of {against}, 95 % within {number(worst['hit.p95'])}; half of the "
                f"levels of detail are off by {number(worst['lod.p50'])} or less."
            )
    finest = {run.knob["pixels"]: run for run in errors if run.problem == BUNNY and not run.knob["share"]}
    pairs = [(run, finest[run.knob["pixels"]]) for run in _chosen(errors, BUNNY) if run.knob["pixels"] in finest]
    worse = [ours.values["flip"] / max(theirs.values["flip"], TINY) - 1 for ours, theirs in pairs]
    if worse:
        more = max(worse, key=abs)
        word = "more" if more > 0 else "less"
        sentences.append(
            f"Held against supersampled truths, its FLIP errors differ by {percent(abs(more))} at most, {word} than "
            "with the finest."
        )
    return tuple(sentences)


def _saved(runs: Sequence[Run], clock: dict[Key, float]) -> tuple[str, ...]:
    """Say what is saved."""
    sentences = []
    ratios = [
        time / clock[problem, pixels, 0.0]
        for (problem, pixels, share), time in clock.items()
        if share == SHARE and (problem, pixels, 0.0) in clock
    ]
    if ratios:
        least, most = number(min(ratios), 2), number(max(ratios), 2)
        sentences.append(f"Tracing takes {least} to {most} times as long as on the finest level.")
    read = _of_file(runs)
    if len(read) == 2:
        ours, theirs = read[FOOTPRINT].values, read[FINEST].values
        sentences.append(
            f"What is saved is reading and memory: {FAR}, takes {percent(ours['bricks'] / theirs['bricks'])} of the "
            f"bricks and {percent(ours['bytes'] / theirs['bytes'])} of the bytes."
        )
    return tuple(sentences)


def _of_file(runs: Sequence[Run], kind: str = "error") -> dict[str, Run]:
    return {run.setup["levels"]: run for run in pick(runs, kind) if run.problem == FAR}


def _read(runs: Sequence[Run]) -> tuple[Table, ...]:
    read, clock = _of_file(runs), _of_file(runs, "timing")
    rows = tuple(
        (
            FAR,
            name,
            f"{run.values['bricks']:,.0f}",
            f"{run.values['bytes'] / 1e6:.1f}",
            number(clock[name].values["seconds"] if name in clock else None),
        )
        for name, run in read.items()
    )
    header = ("Picture", "levels", "bricks read", "MB read", "seconds to load")
    return (Table("What is read of a file.", header, rows, prose=(1,)),) if rows else ()


def _headlines(errors: Sequence[Run], runs: Sequence[Run]) -> tuple[Headline, ...]:
    lines = []
    found = _chosen(errors, BUNNY)
    if found:
        worst = max(run.values["hit.p95"] for run in found)
        what = "Grid levels by footprint: 95 % of the hits are off by, pixels"
        lines.append(Headline(what, number(worst), "the finest level"))
    read = _of_file(runs)
    if len(read) == 2:
        share = read[FOOTPRINT].values["bytes"] / read[FINEST].values["bytes"]
        lines.append(Headline("Grid levels by footprint: share of the bytes read from far", number(share), FINEST))
    return tuple(lines)


def _pictures(errors: Sequence[Run], clock: dict[Key, float]) -> tuple[Picture, ...]:
    """Error over time, by the share, a curve for every size."""
    series = []
    for pixels in sorted({run.knob["pixels"] for run in errors if run.problem == BUNNY}, reverse=True):
        chosen = [run for run in errors if run.problem == BUNNY and run.knob["pixels"] == pixels and _key(run) in clock]
        if chosen:
            x = np.array([max(run.values["hit.p95"], TINY) for run in chosen])
            y = np.array([clock[_key(run)] for run in chosen])
            labels = tuple(f"{run.knob['share']:g}" if run.knob["share"] else FINEST for run in chosen)
            series.append(Series(f"{pixels:.0f} pixels", x, y, labels))
    if not series:
        return ()
    panel = Panel(BUNNY, tuple(series), "hits, 95 %: pixels off the finest level", "µs per ray")
    caption = f"Error against time over the share; the finest level itself is drawn at {TINY:g} pixels."
    return (Picture(plots.work_precision([panel]), caption),)
