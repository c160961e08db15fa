"""What the report says about footprints through several bounces."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.metrics import fitted_order
from validate.plots import Panel, Series
from validate.section import Headline, Picture, Section, Table, number, percent, pick

SPHERE = "sphere, mirrored beam"
EXACT, TRUTH = "exact shape", "displaced rays"
NAMES = {"bspline": "B-spline", "catmull-rom": "Catmull-Rom", "linear": "linear"}
IDENTITIES = ("symplectic", "direction", "surface")
# What the mirrored sphere must reach at 64 samples per axis with the B-spline, p50 and p95.
P50, P95 = 1e-3, 1e-2
IDENTITY = 1e-12
TITLE = "Footprints through bounces"
ASKED = (
    "How does the error of a footprint grow as mirrors and glass hand the ray on? Grids are sampled from exact shapes; "
    "truth is closed-form ray differentials over the shape itself, which share no code with the renderer. A footprint "
    "is the pair of derivatives of the place on the surface per pixel, J = [dp/dx dp/dy], and its error the Frobenius "
    "norm of the difference relative to that of the truth; no texture's layout has a part in it. Everything in float64."
)
SPREAD = (
    "A pixel's error after several bounces has two causes: curvature, which turns the beam and has an error of the "
    "second order with a B-spline, and places, which the ray reaches by another way than the true one."
)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = pick(runs)
    ways = {name: [run for run in found if run.problem == name] for name in dict.fromkeys(run.problem for run in found)}
    sphere = ways.pop(SPHERE, [])
    if not (ways or sphere):
        return Section("bounces", TITLE, ASKED, ("No run succeeded, so there is nothing to compare.",))
    panels = [panel for name, of in ways.items() if (panel := _panel(name, of))]
    rows = [panels[i : i + 3] for i in range(0, len(panels), 3)]
    pictures = tuple(
        Picture(plots.convergence(row), CAPTION if i == 0 else "The same of the other ways.")
        for i, row in enumerate(rows)
    )
    tables = (_mirrored(sphere), *(_table(name, of) for name, of in ways.items()), _trust(ways))
    return Section(
        name="bounces",
        title=TITLE,
        asked=ASKED,
        finding=(*_sphere(sphere), *(s for name, of in ways.items() for s in _growth(name, of)), *_trusted(ways)),
        headlines=_headlines(sphere),
        pictures=pictures,
        tables=tuple(table for table in tables if table.rows),
        notes=(SPREAD, *_left_out(ways)),
    )


CAPTION = "Median error of the footprint over the spacing of the samples, B-spline, after 0 to 3 bounces."


def _grids(found: Sequence[Run], kernel: str | None = None) -> list[Run]:
    """Runs on grids that have something to compare."""
    chosen = [run for run in found if "resolution" in run.knob and "jacobian.p50" in run.values]
    return [run for run in chosen if kernel in (None, run.setup["kernel"])]


def _series(found: Sequence[Run]) -> dict[int, list[Run]]:
    """B-spline runs by bounces, the coarsest grid first."""
    runs = _grids(found, "bspline")
    bounces = sorted({int(run.knob["bounces"]) for run in runs})
    return {
        k: sorted((run for run in runs if run.knob["bounces"] == k), key=lambda r: r.knob["resolution"])
        for k in bounces
    }


def _points(found: Sequence[Run]) -> tuple[np.ndarray, np.ndarray]:
    """Spacing and median error."""
    return (
        np.array([run.values["spacing"] for run in found]),
        np.array([run.values["jacobian.p50"] for run in found]),
    )


def _panel(name: str, found: Sequence[Run]) -> Panel | None:
    series = tuple(
        Series(
            f"{k} {'bounce' if k == 1 else 'bounces'}: order {fitted_order(*_points(of)):.1f}",
            *_points(of),
            tuple(f"{run.knob['resolution']:g}" for run in of),
        )
        for k, of in _series(found).items()
    )
    return Panel(name, series, "spacing of the samples, units", "median error of J") if series else None


def _sphere(found: Sequence[Run]) -> tuple[str, ...]:
    by = {run.setup["kernel"]: run for run in found if run.knob["resolution"] == _coarsest(found)}
    if "bspline" not in by:
        return ()
    run = by["bspline"]
    p50, p95 = (run.values[f"environment.{key}"] for key in ("p50", "p95"))
    verdict = "both within" if p50 <= P50 and p95 <= P95 else "not within"
    rivals = " and ".join(
        f"{number(by[kernel].values['environment.p50'])} with {NAMES[kernel]}"
        for kernel in ("catmull-rom", "linear")
        if kernel in by
    )
    return (
        f"A camera on the exact sphere at {run.knob['resolution']:g}³: the mirrored beam's footprint on a distant "
        f"environment is off by {number(p50)} (median) and {number(p95)} (95 %) with the B-spline, {verdict} the "
        f"limits of {number(P50)} and {number(P95)}" + (f"; the median is {rivals}" if rivals else "") + ".",
    )


def _coarsest(found: Sequence[Run]) -> float:
    return min((run.knob["resolution"] for run in found), default=0)


def _growth(name: str, found: Sequence[Run]) -> tuple[str, ...]:
    """One sentence on how error grows along a way, at the coarsest resolution."""
    series = _series(found)
    if len(series) < 2:
        return ()
    error = {k: of[0].values["jacobian.p50"] for k, of in series.items()}
    last = max(error)
    sentence = (
        f"{name}: at {series[0][0].knob['resolution']:g}³ the median error is "
        f"{', '.join(number(error[k]) for k in sorted(error))} after {', '.join(str(k) for k in sorted(error))} bounces"
    )
    if last > 1 and error[1] > 0:
        sentence += f", times {number((error[last] / error[1]) ** (1 / (last - 1)))} per bounce from the first on"
    fine = series[last][-1]
    return (
        f"{sentence}; at {fine.knob['resolution']:g}³ it is {number(fine.values['jacobian.p50'])} after {last}, "
        f"order {fitted_order(*_points(series[last])):.1f}.",
    )


def _trusted(ways: dict[str, list[Run]]) -> tuple[str, ...]:
    """How far truth itself can be trusted, and what the identities say."""
    sentences = []
    displaced = [run for of in ways.values() for run in of if run.setup["kernel"] == TRUTH and "bar.p95" in run.values]
    if displaced:
        difference, bar = (max(run.values[f"{key}.p95"] for run in displaced) for key in ("difference", "bar"))
        sentences.append(
            f"The closed forms themselves differ from displaced rays by {number(difference)} at the most (95 % of the "
            f"rays, the worst of all ways and bounces), where those claim to be good to {number(bar)}."
        )
    exact = [run for of in ways.values() for run in of if run.setup["kernel"] == EXACT and "jacobian.p95" in run.values]
    if exact:
        worst = max(run.values["jacobian.p95"] for run in exact)
        sentences.append(
            f"With the exact shape in the grid's place the renderer's own optics are off by {number(worst)}."
        )
    kept = [run for of in ways.values() for run in of if "symplectic.max" in run.values]
    if kept:
        worst = max(run.values[f"{name}.max"] for run in kept for name in IDENTITIES)
        sentences.append(
            f"The identities hold to {number(worst)} at every bounce of every way, kernel and resolution "
            f"({'within' if worst <= IDENTITY else 'beyond'} {number(IDENTITY)}; four perturbations per ray)."
        )
    return tuple(sentences)


def _headlines(sphere: Sequence[Run]) -> tuple[Headline, ...]:
    return tuple(
        Headline(
            "Exact sphere at 64³, B-spline: error of the reflected footprint's Jacobian more than 5 px from the "
            "silhouette, p50 / p95",
            " / ".join(number(run.values[f"environment.{key}"]) for key in ("p50", "p95")),
            f"at most {number(P50)} / {number(P95)}",
            run.values["environment.p50"] <= P50 and run.values["environment.p95"] <= P95,
        )
        for run in sphere
        if run.setup["kernel"] == "bspline" and run.knob["resolution"] == 64 and "environment.p50" in run.values
    )


def _mirrored(sphere: Sequence[Run]) -> Table:
    rows = tuple(
        (
            f"{NAMES[run.setup['kernel']]}, {run.knob['resolution']:g}³",
            *(number(run.values[f"{on}.{key}"]) for on in ("environment", "wall") for key in ("p50", "p95", "p99")),
            f"{run.values['pixels']:g}",
            percent(run.values["left_out"]),
        )
        for run in sphere
        if "environment.p50" in run.values
    )
    header = ("Mirrored sphere", "environment p50", "p95", "p99", "wall p50", "p95", "p99", "pixels", "left out")
    return Table("The mirrored beam on a distant environment, and on a wall of radius 4 around.", header, rows)


def _table(name: str, found: Sequence[Run]) -> Table:
    """Errors by setup and bounces."""
    bounces = sorted({run.knob["bounces"] for run in found})
    chosen = [run for run in found if "jacobian.p50" in run.values]
    order = sorted(
        {(run.knob.get("resolution", 0), run.setup["kernel"]) for run in chosen}, key=lambda key: (key[0], key[1])
    )
    rows = []
    for resolution, kernel in order:
        by = {
            run.knob["bounces"]: run.values
            for run in chosen
            if (run.knob.get("resolution", 0), run.setup["kernel"]) == (resolution, kernel)
        }
        label = f"{NAMES[kernel]}, {resolution:g}³" if resolution else kernel
        cells = (number(by[k][f"jacobian.{key}"]) if k in by else "-" for key in ("p50", "p95") for k in bounces)
        missed = max(by[k]["missed"] for k in by)
        pixels = " ".join(f"{by[k]['pixels']:g}" for k in bounces if k in by)
        rows.append((label, *cells, percent(missed), pixels))
    header = (
        "Field",
        *(f"p50, {k:g}" for k in bounces),
        *(f"p95, {k:g}" for k in bounces),
        "missed, most",
        "rays",
    )
    return Table(f"{name}: error of J after so many bounces.", header, tuple(rows))


def _trust(ways: dict[str, list[Run]]) -> Table:
    rows = []
    for name, found in ways.items():
        kept = {
            int(run.knob["bounces"]): max(
                other.values[f"{identity}.max"]
                for other in found
                if other.knob["bounces"] == run.knob["bounces"] and "symplectic.max" in other.values
                for identity in IDENTITIES
            )
            for run in found
            if "symplectic.max" in run.values
        }
        for run in found:
            if run.setup["kernel"] == TRUTH and "bar.p95" in run.values:
                k = int(run.knob["bounces"])
                cells = (run.values[f"{what}.{key}"] for what in ("difference", "bar") for key in ("p50", "p95"))
                rows.append((f"{name}, {k}", *(number(cell) for cell in cells), number(kept.get(k))))
    header = ("Way, bounces", "truth - displaced p50", "p95", "their bar p50", "p95", "identities, greatest")
    return Table("How far the truth can be trusted, and the greatest defect of an identity.", header, tuple(rows))


def _left_out(ways: dict[str, list[Run]]) -> tuple[str, ...]:
    worst = {
        name: max(run.values["left_out"] for run in _grids(found)) for name, found in ways.items() if _grids(found)
    }
    if not worst:
        return ()
    slope = next(run.values["slope"] for found in ways.values() for run in _grids(found))
    shares = ", ".join(f"{percent(share)} ({name})" for name, share in worst.items())
    return (
        f"Rays that meet or leave a surface with |d.n| below {number(slope)} at any bounce are left out, as footprints "
        f"have no bound towards grazing: after three bounces at most {shares}. The page has edges, where no "
        "interpolant has the curvature of the truth: they stay in, and decide the 95 % of its way.",
    )
