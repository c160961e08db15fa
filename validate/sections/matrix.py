"""What the report says about kernels, resolutions, engines and precisions."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.metrics import fitted_order
from validate.plots import Panel, Series
from validate.section import Headline, Picture, Section, Table, number, percent, pick

TITLE = "Kernel, resolution, engine, precision"
ASKED = (
    "What does a footprint behind a curved mirror depend on? A mirror sphere shows a page, as in Galim 2018; the "
    "sphere is sampled at 32 to 128 samples per axis and read by every kernel, on both engines and in both precisions. "
    "The exact scene is truth, in closed form; pixels within 5 of the silhouette are left out."
)
KERNELS = ("linear", "catmull-rom", "bspline")
ENGINES = {("numpy", "64"): "NumPy float64", ("drjit", "64"): "Dr.Jit float64", ("drjit", "32"): "Dr.Jit float32"}
P50, P95 = "away.jacobian_error.p50", "away.jacobian_error.p95"
# What a 64^3 B-spline grid must reach, on every engine: p50, p95.
AT_MOST = (1e-3, 1e-2)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = [run for run in pick(runs) if P50 in run.values]
    if not found:
        return Section("matrix", TITLE, ASKED, ("No run succeeded.",))
    return Section(
        name="matrix",
        title=TITLE,
        asked=ASKED,
        finding=(*_kernels(found), *_limit(found), *_agreement(found)),
        headlines=_headlines(found),
        pictures=(Picture(plots.convergence(_panels(found)), "Median error of the footprint's Jacobian."),),
        tables=(_table(found),),
    )


def _engine(run: Run) -> tuple[str, str]:
    return run.setup["engine"], run.setup["precision"]


def _sweep(found: Sequence[Run], kernel: str, engine: tuple[str, str]) -> list[Run]:
    return [run for run in found if run.setup["kernel"] == kernel and _engine(run) == engine]


def _order(sweep: Sequence[Run]) -> float:
    spacing, errors = (np.array([run.values[key] for run in sweep]) for key in ("spacing", P50))
    return fitted_order(spacing, errors)


def _panels(found: Sequence[Run]) -> list[Panel]:
    panels = []
    for engine, name in ENGINES.items():
        sweeps = {kernel: sweep for kernel in KERNELS if (sweep := _sweep(found, kernel, engine))}
        series = tuple(
            Series(
                f"{kernel}: order {_order(sweep):.2f}",
                np.array([run.values["spacing"] for run in sweep]),
                np.array([run.values[P50] for run in sweep]),
                tuple(f"{run.knob['resolution']:g}" for run in sweep),
            )
            for kernel, sweep in sweeps.items()
        )
        if series:
            panels.append(Panel(name, series, "spacing of the samples, units", "median |J - J*| / |J*|"))
    return panels


def _kernels(found: Sequence[Run]) -> tuple[str, ...]:
    """What the kernel makes of it, on the first engine that ran."""
    engine = next(engine for engine in ENGINES if any(_engine(run) == engine for run in found))
    words = []
    for kernel in KERNELS:
        sweep = _sweep(found, kernel, engine)
        if sweep:
            ends = f"{number(sweep[0].values[P50])} at {sweep[0].knob['resolution']:g}³"
            if len(sweep) > 1:
                last = sweep[-1]
                ends += f" to {number(last.values[P50])} at {last.knob['resolution']:g}³, order {_order(sweep):.2f}"
            words.append(f"{kernel} {ends}")
    return (f"{ENGINES[engine]}, median error of the footprint: {'; '.join(words)}.",)


def _at_64(found: Sequence[Run]) -> list[Run]:
    return [run for run in found if run.setup["kernel"] == "bspline" and run.knob["resolution"] == 64]


def _worst(found: Sequence[Run]) -> tuple[float, float]:
    return max(run.values[P50] for run in found), max(run.values[P95] for run in found)


def _limit(found: Sequence[Run]) -> tuple[str, ...]:
    chosen = _at_64(found)
    if not chosen:
        return ()
    p50, p95 = _worst(chosen)
    word = "met" if p50 <= AT_MOST[0] and p95 <= AT_MOST[1] else "NOT met"
    return (
        f"The limits for a 64³ B-spline grid, {number(AT_MOST[0])} (median) and {number(AT_MOST[1])} (95 %), are "
        f"{word} on {len(chosen)} engines and precisions: at most {number(p50)} and {number(p95)}.",
    )


def _agreement(found: Sequence[Run]) -> tuple[str, ...]:
    """What engine and precision change, kernel and resolution being the same."""
    sentences = []
    for one, other in ((("numpy", "64"), ("drjit", "64")), (("drjit", "64"), ("drjit", "32"))):
        changes = [
            (abs(twin.values[P50] / mine.values[P50] - 1.0), mine)
            for mine in found
            if _engine(mine) == one and mine.values[P50] > 0
            for twin in found
            if _engine(twin) == other and twin.setup["kernel"] == mine.setup["kernel"] and twin.knob == mine.knob
        ]
        if changes:
            change, run = max(changes, key=lambda pair: pair[0])
            sentences.append(
                f"From {ENGINES[one]} to {ENGINES[other]} the median error changes by at most {percent(change)} "
                f"({run.setup['kernel']}, {run.knob['resolution']:g}³)."
            )
    return tuple(sentences)


def _headlines(found: Sequence[Run]) -> tuple[Headline, ...]:
    chosen = _at_64(found)
    if not chosen:
        return ()
    what = "Reflected footprint, exact sphere at 64³, B-spline: Jacobian error off the silhouette, p50 / p95"
    limit = f"closed form; at most {number(AT_MOST[0])} / {number(AT_MOST[1])}"
    worst = _worst(chosen)
    met = all(figure <= most for figure, most in zip(worst, AT_MOST, strict=True))
    return (Headline(what, " / ".join(map(number, worst)), limit, met),)


def _table(found: Sequence[Run]) -> Table:
    rows = []
    for kernel in KERNELS:
        for n in sorted({run.knob["resolution"] for run in found}):
            row = [f"{kernel}, {n:g}³"]
            for engine in ENGINES:
                values = next((r.values for r in _sweep(found, kernel, engine) if r.knob["resolution"] == n), {})
                row += [number(values.get(key)) for key in (P50, P95, "away.lod_error.p95")]
            rows.append(tuple(row))
    header = ["J error off the silhouette"]
    for name in ENGINES.values():
        header += [f"{name}: p50", "p95", "LoD p95"]
    return Table("Footprints on the page, by kernel and resolution.", tuple(header), tuple(rows))
