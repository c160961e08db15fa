"""What the report says about its own truths."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.metrics import fitted_order
from validate.plots import Panel, Series
from validate.section import Picture, Section, Table, number, pick
from validate.suites.truths import STEP

TITLE = "How far the truths can be trusted"
ASKED = (
    "No truth is exact. Closed forms are held against displaced rays, which know nothing of derivatives: their own "
    "error bar is the last correction of Richardson's extrapolation. So is the mesh with interpolated normals, within "
    "single faces. Texture coordinates of the closest face, found by trying them all, are held against those of the "
    "face that Embree names. Differences and bars are relative to the footprint; those of texture coordinates in "
    "texels of 1024."
)
NOTES = (
    "What the mesh is truth of: positions, texture coordinates and primary footprints of what was baked from it. "
    "For reflected and refracted footprints the exact shape is truth. Automatic differentiation, brute force and "
    "pictures of many samples have sections of their own.",
)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = pick(runs)
    return Section(
        name="truths",
        title=TITLE,
        asked=ASKED,
        finding=_finding(found) or ("No run succeeded.",),
        pictures=_picture(found),
        tables=(_table(found),),
        notes=NOTES,
    )


def _sweep(found: Sequence[Run]) -> dict[str, list[Run]]:
    """Runs of the problems that were made with several steps, by falling step."""
    chosen: dict[str, list[Run]] = {}
    for run in sorted(found, key=lambda run: -run.knob.get("step", 0.0)):
        if run.setup["truth"] == "closed forms":
            chosen.setdefault(run.problem, []).append(run)
    return {problem: runs for problem, runs in chosen.items() if len(runs) > 1}


def _at_step(found: Sequence[Run]) -> list[Run]:
    return [run for run in found if run.knob.get("step", STEP) == STEP]


def _finding(found: Sequence[Run]) -> tuple[str, ...]:
    sentences = []
    for truth in dict.fromkeys(run.setup["truth"] for run in found):
        mine = [run for run in _at_step(found) if run.setup["truth"] == truth]
        if not mine:
            continue
        worst = max(mine, key=lambda run: run.values["difference.p95"])
        bar = max(run.values["bar.p95"] for run in mine)
        sentences.append(
            f"{truth[0].upper()}{truth[1:]} and {worst.setup['against']} differ by at most "
            f"{number(worst.values['difference.p95'])} (95 %, {worst.problem}); the greatest bar is {number(bar)}."
        )
    for problem, runs in _sweep(found).items():
        step, error = (np.array(values) for values in zip(*(_point(run) for run in runs), strict=True))
        sentences.append(f"{problem}: differences of displaced rays shrink with order {_order(step, error):.1f}.")
    return tuple(sentences)


def _point(run: Run) -> tuple[float, float]:
    return float(run.knob["step"]), run.values["difference.p50"]


def _order(step: np.ndarray, error: np.ndarray) -> float:
    """Order over the steps before rounding takes over: down to the least error."""
    falling = int(np.argmin(error))
    return fitted_order(step[: max(falling, 2)], error[: max(falling, 2)])


def _picture(found: Sequence[Run]) -> tuple[Picture, ...]:
    panels = []
    for problem, runs in _sweep(found).items():
        step = np.array([run.knob["step"] for run in runs], float)
        series = tuple(
            Series(title, step, np.array([run.values[key] for run in runs]))
            for title, key in (("difference, median", "difference.p50"), ("bar, median", "bar.p50"))
        )
        panels.append(Panel(problem, series, "step, pixels", "relative to the footprint"))
    if not panels:
        return ()
    caption = (
        "Displaced rays against closed forms, and the bar that they give themselves; left of the kink is rounding."
    )
    return (Picture(plots.convergence(panels), caption),)


def _table(found: Sequence[Run]) -> Table:
    keys = ("difference.p50", "difference.p95", "difference.max", "bar.p50", "bar.p95")
    rows = tuple(
        (
            run.problem,
            run.setup["truth"],
            run.setup["against"],
            f"{run.values['difference.count']:,.0f}",
            *(number(run.values[key]) for key in keys),
        )
        for run in _at_step(found)
    )
    header = ("Problem", "Truth", "Held against", "places", "difference p50", "p95", "max", "its bar p50", "p95")
    return Table("Truths against each other.", header, rows, prose=(1, 2))
