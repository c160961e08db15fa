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
# How far a fitted order may lie from theory.
WITHIN = 0.2


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    stored = _sweeps([run for run in runs if "samples" not in run.setup])
    exact = _sweeps([run for run in runs if "samples" in run.setup])
    if not stored and not exact:
        return Section("convergence", TITLE, ASKED, ("No run succeeded, so there is nothing to fit.",))
    # On stored samples the other kernels' curves are the same: their errors never come near the rounding.
    shown = exact | {"bspline, stored": stored["bspline"]} if exact and "bspline" in stored else exact or stored
    return Section(
        name="convergence",
        title=TITLE,
        asked=ASKED,
        finding=(*_methods(exact or stored), *_ends(exact, stored), *_rival(stored)),
        headlines=(*_method_headlines(exact), *_headlines(stored)),
        pictures=(Picture(plots.convergence(_panels(shown)), "Median errors at random points of the exact sphere."),),
        tables=tuple(
            _table(f"Relative error of the shape operator, {samples}.", sweeps)
            for samples, sweeps in (("samples in float64", exact), ("samples as stored, in float32", stored))
            if sweeps
        ),
    )


TITLE = "How fast the interpolated field converges"
ASKED = (
    "A reflected footprint is driven by the surface's curvature, which is a second derivative of the interpolated "
    "distance. The exact sphere is sampled at 16 to 512 samples per axis; value, gradient and shape operator of the "
    "interpolant are compared with the closed form at random points of the surface. Orders are those of the method, "
    "and are fitted on samples in float64; grids store float32, which ends every sweep somewhere."
)


def _sweeps(runs: Sequence[Run]) -> dict[str, list[Run]]:
    return {kernel: found for kernel in KERNELS if (found := pick(runs, kernel=kernel))}


def orders(found: Sequence[Run]) -> tuple[float, ...]:
    """Fitted orders of value, gradient and shape operator over the spacing.

    The fit takes the three finest grids whose error stands above the rounding of the samples: coarser ones are not
    asymptotic, finer ones measure the rounding.
    """
    spacing = np.array([run.values["spacing"] for run in found])
    # The samples that weigh in lie within two voxels and are rounded by half a unit in the last place, eps h / 2 on
    # average; each derivative divides by h once more.
    eps = float(np.finfo(found[0].setup.get("samples", "float32")).eps)
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


def _methods(sweeps: dict[str, list[Run]]) -> tuple[str, ...]:
    """The fitted orders, and whether they are those of theory."""
    sentences = []
    for kernel, found in sweeps.items():
        fitted, theory = orders(found), EXPECTED[kernel]
        off = max(abs(order - right) for order, right in zip(fitted, theory, strict=True))
        said = f"within {WITHIN:g} of" if off <= WITHIN else f"off by up to {off:.2f} from"
        sentences.append(
            f"{kernel}: fitted orders {', '.join(map(_order, fitted))} for value, gradient and shape operator, {said} "
            f"theory's {', '.join(map(str, theory))}."
        )
    return tuple(sentences)


def _order(value: float) -> str:
    return f"{value:.2f}".replace("-0.00", "0.00")


def _method_headlines(sweeps: dict[str, list[Run]]) -> tuple[Headline, ...]:
    if not sweeps:
        return ()
    off = max(
        abs(order - theory)
        for kernel, found in sweeps.items()
        for order, theory in zip(orders(found), EXPECTED[kernel], strict=True)
    )
    what = f"Fitted orders of value, gradient and shape operator ({', '.join(sweeps)}): farthest from theory"
    return (Headline(what, number(off), f"at most {WITHIN:g}", off <= WITHIN),)


def _ends(exact: dict[str, list[Run]], stored: dict[str, list[Run]]) -> tuple[str, ...]:
    """What rounding to float32 costs the B-spline."""
    ours, theirs = ({run.knob["resolution"]: run for run in s.get("bspline", [])} for s in (exact, stored))
    both = sorted(ours.keys() & theirs.keys())
    if not both:
        return ()
    fine, coarse = (found[both[-1]].values["shape_operator.p50"] for found in (ours, theirs))
    return (
        f"At {both[-1]:g}³ the B-spline's shape operator is off by {number(coarse)} on samples stored in float32 and "
        f"by {number(fine)} on float64 ones: {number(coarse / fine)} times as much.",
    )


def _rival(sweeps: dict[str, list[Run]]) -> tuple[str, ...]:
    """The B-spline on a coarse grid against Catmull-Rom on a fine one."""
    at = {kernel: {run.knob["resolution"]: run for run in found} for kernel, found in sweeps.items()}
    spline, rival = at.get("bspline", {}).get(64), at.get("catmull-rom", {}).get(256)
    if not spline or not rival:
        return ()
    ratio = rival.values["shape_operator.p50"] / spline.values["shape_operator.p50"]
    word = f"{ratio:.0f} times smaller" if ratio > 1 else f"{1 / ratio:.1f} times larger"
    return (f"The curvature error of a 64³ B-spline grid is {word} than that of a 256³ Catmull-Rom grid.",)


def _headlines(sweeps: dict[str, list[Run]]) -> tuple[Headline, ...]:
    found = [run for run in sweeps.get("bspline", []) if run.knob["resolution"] == 64]
    what = "Shape operator of the exact sphere at 64³, B-spline: median relative error"
    figures = [run.values["shape_operator.p50"] for run in found]
    return tuple(Headline(what, number(one), f"at most {number(LIMIT)}", one <= LIMIT) for one in figures)


def _table(caption: str, sweeps: dict[str, list[Run]]) -> Table:
    resolutions = sorted({run.knob["resolution"] for found in sweeps.values() for run in found})
    rows = []
    for kernel, found in sweeps.items():
        at = {run.knob["resolution"]: run.values["shape_operator.p50"] for run in found}
        rows.append((kernel, *(number(at.get(n)) for n in resolutions), _order(orders(found)[2])))
    header = ("Shape operator, median error", *(f"{n:g}³" for n in resolutions), "order")
    return Table(caption, header, tuple(rows))
