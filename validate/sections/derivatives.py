"""What the report says about automatic differentiation beside the kernels' closed-form derivatives."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.plots import Panel, Series
from validate.section import Headline, Picture, Section, Table, number, pick

TITLE = "Derivatives: closed form against automatic differentiation"
ASKED = (
    "Galim 2018 differentiates the sampled distance automatically; here gradient and Hessian come from the kernels' "
    "differentiated weights. Are the two the same, and what does each cost? Dr.Jit differentiates the very program "
    "that the tracer runs: the value for a gradient, and the closed-form gradient for a Hessian, as it differentiates "
    "once. Differences are per point, relative to the root mean square length of gradient or Hessian."
)
# Either way adds up 64 products a few dozen times in float64: at most some hundred units of 2e-16 beside each other, of
# samples that are five voxels at most while a Hessian divides by a voxel's square, which is another digit.
LIMIT = 1e-12
NOTES = (
    "Points within a thousandth of a voxel of a face between cells are left out: there the program cuts a place to its "
    "cell, and differentiation sees the cut.",
)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    errors, times = pick(runs), pick(runs, "timing")
    if not errors:
        return Section("derivatives", TITLE, ASKED, ("No run succeeded, so the two ways were not compared.",))
    pairs = _pairs(errors, times)
    pictures = (Picture(plots.work_precision(_panels(pairs)), CAPTION),) if pairs else ()
    return Section(
        name="derivatives",
        title=TITLE,
        asked=ASKED,
        finding=_finding(errors, pairs),
        headlines=_headlines(errors),
        pictures=pictures,
        tables=tuple(table for table in (_agreement(errors), _costs(pairs)) if table.rows),
        notes=NOTES,
    )


CAPTION = "Error of the Hessian against NumPy in float64, and time for value, gradient and Hessian; labels are kernels."
Pairs = dict[tuple[str, str, str], tuple[Run, Run]]


def _pairs(errors: Sequence[Run], times: Sequence[Run]) -> Pairs:
    """Error and timed run by kernel, precision and way, where there are both."""
    timed = {(run.problem, *_key(run)): run for run in times}
    found = {_key(run): (run, timed[run.problem, *_key(run)]) for run in errors if (run.problem, *_key(run)) in timed}
    return dict(sorted(found.items()))


def _key(run: Run) -> tuple[str, str, str]:
    return run.setup["kernel"], run.setup["precision"], run.setup["way"]


def _panels(pairs: Pairs) -> list[Panel]:
    panels = []
    for precision in sorted({key[1] for key in pairs}):
        series = []
        for way in sorted({key[2] for key in pairs}, reverse=True):
            points = [(key[0], *pair) for key, pair in pairs.items() if key[1:] == (precision, way)]
            error = np.array([max(run.values["hessian.p50"], TINIEST) for _, run, _ in points])
            cost = np.array([timing.values["us_per_ray"] for _, _, timing in points])
            series.append(Series(way, error, cost, tuple(kernel for kernel, _, _ in points)))
        panels.append(Panel(f"float{precision}", tuple(series), "median error of the Hessian", "µs per point"))
    return panels


TINIEST = 1e-18  # an error of 0 has no place on a logarithmic axis


def _automatic(errors: Sequence[Run]) -> list[Run]:
    return [run for run in errors if "ways.hessian.max" in run.values]


def _greatest(runs: Sequence[Run]) -> float:
    return max(run.values[f"ways.{name}.max"] for run in runs for name in ("gradient", "hessian"))


def _finding(errors: Sequence[Run], pairs: Pairs) -> tuple[str, ...]:
    sentences = []
    for precision in ("64", "32"):
        found = [run for run in _automatic(errors) if run.setup["precision"] == precision]
        if found:
            worst = max(found, key=lambda run: _greatest([run]))
            tail = ""
            if precision == "64":
                tail = f", {'within' if _greatest(found) <= LIMIT else 'beyond'} the limit of {number(LIMIT)}"
            sentences.append(
                f"In float{precision} the two ways differ by {number(_greatest(found))} at the most, over "
                f"{len(found)} pairs of field and kernel ({worst.setup['kernel']} on {worst.problem}){tail}."
            )
    ratios = {
        (kernel, precision): pair[1].values["seconds"] / pairs[kernel, precision, "closed form"][1].values["seconds"]
        for (kernel, precision, way), pair in pairs.items()
        if way == "automatic" and (kernel, precision, "closed form") in pairs
    }
    if ratios:
        low, high = min(ratios.values()), max(ratios.values())
        sentences.append(
            f"Differentiating automatically takes {number(low)} to {number(high)} times as long as the closed form, "
            f"over {len(ratios)} pairs of kernel and precision."
        )
    return tuple(sentences)


def _headlines(errors: Sequence[Run]) -> tuple[Headline, ...]:
    found = [run for run in _automatic(errors) if run.setup["precision"] == "64"]
    if not found:
        return ()
    what = "Closed-form gradient and Hessian against automatic differentiation, all kernels, float64: greatest"
    return (Headline(what, number(_greatest(found)), f"at most {number(LIMIT)}", _greatest(found) <= LIMIT),)


def _agreement(errors: Sequence[Run]) -> Table:
    rows = tuple(
        (
            f"{run.problem}, {run.setup['kernel']}, float{run.setup['precision']}",
            *(number(run.values[f"ways.{name}.{key}"]) for name in ("gradient", "hessian") for key in ("p50", "max")),
        )
        for run in _automatic(errors)
    )
    header = ("Field, kernel", "gradient p50", "max", "Hessian p50", "max")
    return Table("Difference of the two ways, relative.", header, rows)


def _costs(pairs: Pairs) -> Table:
    rows = tuple(
        (
            f"{kernel}, float{precision}, {way}",
            *(number(error.values[f"{name}.p50"]) for name in ("gradient", "hessian")),
            number(timing.values["us_per_ray"]),
            number(timing.values["seconds"]),
        )
        for (kernel, precision, way), (error, timing) in pairs.items()
    )
    header = ("Kernel, way", "gradient error p50", "Hessian error p50", "µs per point", "s")
    return Table("Error against NumPy in float64, and time; medians.", header, rows)
