"""What the report says about error against run time."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.frontier import pareto
from validate.metrics import fitted_order
from validate.plots import Panel, Series
from validate.section import Picture, Section, Table, number, pick

TITLE = "Error against run time"
ASKED = (
    "What does an error cost? A camera looks at the exact sphere, and every ray is traced, mirrored with its "
    "differentials, and traced on. On x the median error of the reflected beam (its footprint on a distant "
    "environment), on y microseconds per ray; points of one curve are 16 to 256 samples per axis. Errors and times "
    "come from separate runs, and the black line joins what nothing else beats."
)

Pair = tuple[Run, Run]


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    sweeps = _sweeps(runs)
    if not sweeps:
        return Section("frontier", TITLE, ASKED, ("No setup has both an error run and a timed run that succeeded.",))
    engines = sorted({engine for _, engine in sweeps})
    panels = [_panel(engine, {k: v for k, v in sweeps.items() if k[1] == engine}) for engine in engines]
    return Section(
        name="frontier",
        title=TITLE,
        asked=ASKED,
        finding=_finding(sweeps),
        pictures=(Picture(plots.work_precision(panels), "Work-precision diagrams; labels are samples per axis."),),
        tables=(_table(sweeps),),
    )


def _sweeps(runs: Sequence[Run]) -> dict[tuple[str, str], list[Pair]]:
    """Error and timed run of each (kernel, engine), by resolution."""
    times = {(r.setup["kernel"], r.setup["engine"], r.knob["resolution"]): r for r in pick(runs, "timing")}
    sweeps: dict[tuple[str, str], list[Pair]] = {}
    for run in pick(runs):
        kernel, engine = run.setup["kernel"], run.setup["engine"]
        timing = times.get((kernel, engine, run.knob["resolution"]))
        if timing and "beam.p50" in run.values:
            sweeps.setdefault((kernel, engine), []).append((run, timing))
    return sweeps


def _panel(engine: str, sweeps: dict[tuple[str, str], list[Pair]]) -> Panel:
    series = []
    for (kernel, _), pairs in sorted(sweeps.items()):
        resolution, error, cost = _points(pairs)
        order = fitted_order(np.array([run.values["spacing"] for run, _ in pairs]), error)
        labels = tuple(f"{n:g}" for n in resolution)
        series.append(Series(f"{kernel}: order {order:.1f}", error, cost, labels))
    return Panel(engine, tuple(series), "median error of the reflected beam", "µs per ray")


def _points(pairs: Sequence[Pair]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    resolution = np.array([run.knob["resolution"] for run, _ in pairs])
    error = np.array([run.values["beam.p50"] for run, _ in pairs])
    return resolution, error, np.array([timing.values["us_per_ray"] for _, timing in pairs])


def _finding(sweeps: dict[tuple[str, str], list[Pair]]) -> tuple[str, ...]:
    sentences = []
    for engine in sorted({engine for _, engine in sweeps}):
        points = [(key[0], *pair) for key, pairs in sweeps.items() if key[1] == engine for pair in pairs]
        error = np.array([run.values["beam.p50"] for _, run, _ in points])
        cost = np.array([timing.values["us_per_ray"] for _, _, timing in points])
        front = [points[i] for i in pareto(error, cost)]
        kernels = [kernel for kernel, _, _ in front]
        shares = ", ".join(f"{kernels.count(kernel)} {kernel}" for kernel in dict.fromkeys(kernels))
        best = front[-1]
        sentences.append(
            f"On {engine}, the front holds {len(front)} of {len(points)} setups ({shares}); its most exact end, "
            f"{best[0]} at {best[1].knob['resolution']:g}³, has an error of {number(error.min())} for "
            f"{number(best[2].values['us_per_ray'])} µs per ray."
        )
    return tuple(sentences)


def _table(sweeps: dict[tuple[str, str], list[Pair]]) -> Table:
    rows = []
    for (kernel, engine), pairs in sorted(sweeps.items(), key=lambda item: item[0][::-1]):
        for run, timing in pairs:
            cells = (run.values["beam.p50"], run.values["beam.p95"], run.values["missed"], timing.values["us_per_ray"])
            rows.append((f"{engine}, {kernel}, {run.knob['resolution']:g}³", *(number(cell) for cell in cells)))
    header = ("Setup", "beam error p50", "p95", "hit or miss differs", "µs per ray")
    return Table("Every point of the diagrams; times are medians.", header, tuple(rows))
