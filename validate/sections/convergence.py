"""What the report says about convergence."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.metrics import fitted_order
from validate.plots import Panel, Series
from validate.section import Headline, Picture, Section, Table, number, pick

QUANTITIES = (
    ("value", "Value", "median |f| at the surface, units"),
    ("gradient", "Gradient", "median error of the gradient"),
    ("shape_operator", "Shape operator", "median relative error"),
)
KERNELS = ("linear", "catmull-rom", "bspline")
EXPECTED = {"linear": (2, 1, 0), "catmull-rom": (3, 2, 1), "bspline": (4, 3, 2)}
# Median error of the shape operator that the B-spline must reach at 64^3.
LIMIT = 5e-4


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    sweeps = {kernel: found for kernel in KERNELS if (found := pick(runs, kernel=kernel))}
    if not sweeps:
        return Section("convergence", TITLE, ASKED, ("No run succeeded, so there is nothing to fit.",))
    return Section(
        name="convergence",
        title=TITLE,
        asked=ASKED,
        finding=_finding(sweeps),
        headlines=_headlines(sweeps),
        pictures=(Picture(plots.convergence(_panels(sweeps)), "Median errors at 20,000 points of the exact sphere."),),
        tables=(_table(sweeps),),
    )


TITLE = "How fast the interpolated field converges"
ASKED = (
    "A reflected footprint is driven by the surface's curvature, which is a second derivative of the interpolated "
    "distance. The exact sphere is sampled at 16 to 256 samples per axis; value, gradient and shape operator of the "
    "interpolant are compared with the closed form at random points of the surface."
)


def orders(found: Sequence[Run]) -> tuple[float, ...]:
    """Fitted orders of value, gradient and shape operator over the spacing.

    The fit takes the three finest grids whose error stands above the rounding of float32 samples: coarser ones are not
    asymptotic, finer ones measure the rounding.
    """
    spacing = np.array([run.values["spacing"] for run in found])
    # The samples that weigh in lie within two voxels and are rounded by half a unit in the last place, eps h / 2 on
    # average; each derivative divides by h once more.
    eps = float(np.finfo(np.float32).eps)
    fitted = []
    for power, (name, _, _) in enumerate(QUANTITIES):
        errors = np.array([run.values[f"{name}.p50"] for run in found])
        above = np.flatnonzero(errors > eps / 2 * spacing ** (1 - power))[-3:]
        fitted.append(fitted_order(spacing[above], errors[above]))
    return tuple(fitted)


def _panels(sweeps: dict[str, list[Run]]) -> list[Panel]:
    fits = {kernel: orders(found) for kernel, found in sweeps.items()}
    return [
        Panel(
            title,
            tuple(
                Series(
                    f"{kernel}: order {fits[kernel][index]:.2f}",
                    np.array([run.values["spacing"] for run in found]),
                    np.array([run.values[f"{name}.p50"] for run in found]),
                    tuple(f"{run.knob['resolution']:g}" for run in found),
                )
                for kernel, found in sweeps.items()
            ),
            "spacing of the samples, units",
            label,
        )
        for index, (name, title, label) in enumerate(QUANTITIES)
    ]


def _finding(sweeps: dict[str, list[Run]]) -> tuple[str, ...]:
    sentences = []
    for kernel, found in sweeps.items():
        fitted = orders(found)
        expected = ", ".join(str(order) for order in EXPECTED[kernel])
        quicker = [
            title.lower()
            for (_, title, _), order, theory in zip(QUANTITIES, fitted, EXPECTED[kernel], strict=True)
            if order > theory + 0.2
        ]
        tail = f"; of the {' and the '.join(quicker)} the leading term has not taken over yet" if quicker else ""
        sentences.append(
            f"{kernel}: fitted orders {', '.join(f'{order:.2f}' for order in fitted)} for value, gradient and shape "
            f"operator, where theory says {expected}{tail}."
        )
    at = {kernel: {run.knob["resolution"]: run for run in found} for kernel, found in sweeps.items()}
    spline, rival = at.get("bspline", {}).get(64), at.get("catmull-rom", {}).get(256)
    if spline and rival:
        ratio = rival.values["shape_operator.p50"] / spline.values["shape_operator.p50"]
        word = f"{ratio:.0f} times smaller" if ratio > 1 else f"{1 / ratio:.1f} times larger"
        sentences.append(f"The curvature error of a 64³ B-spline grid is {word} than that of a 256³ Catmull-Rom grid.")
    return tuple(sentences)


def _headlines(sweeps: dict[str, list[Run]]) -> tuple[Headline, ...]:
    found = [run for run in sweeps.get("bspline", []) if run.knob["resolution"] == 64]
    what = "Shape operator of the exact sphere at 64³, B-spline: median relative error"
    return tuple(Headline(what, number(run.values["shape_operator.p50"]), f"at most {number(LIMIT)}") for run in found)


def _table(sweeps: dict[str, list[Run]]) -> Table:
    resolutions = sorted({run.knob["resolution"] for found in sweeps.values() for run in found})
    rows = []
    for kernel, found in sweeps.items():
        at = {run.knob["resolution"]: run.values["shape_operator.p50"] for run in found}
        rows.append((kernel, *(number(at.get(n)) for n in resolutions), f"{orders(found)[2]:.2f}"))
    header = ("Shape operator, median error", *(f"{n:g}³" for n in resolutions), "order")
    return Table("Relative error of the shape operator.", header, tuple(rows))
