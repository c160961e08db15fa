"""What the report says about footprints and error bars on every exact shape."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.plots import Map
from validate.section import Headline, Picture, Section, Table, number, percent, pick
from validate.sections.footprints import by_region, cropped

TITLE = "Every shape, and error bars"
ASKED = (
    "Are footprints right on every kind of surface, and do they know how wrong they are? Grids are sampled from exact "
    "shapes, whose closed forms are truth, for camera rays and for rays that the shape mirrors onto an environment of "
    "1024 texels around. Every footprint gets an error bar without the truth: its difference from the footprint of a "
    "grid of half the resolution, plus the difference of neighbouring footprints. A last check needs no truth either: "
    "what a displaced ray sees departs from the linear footprint by the square of the displacement, if that is right."
)
NOTES = (
    "Bars are compared in texels per pixel, Frobenius norm; where the two grids see different charts, or one misses, "
    "there is no bar. 'Width' is the median bar over the median error: 1 would be perfect; it is missing where the "
    "median error is none. 'Resolution alone' leaves the neighbours out.",
    "A Taylor slope of 2 is right, of 1 wrong; 3 is a footprint with no second-order term, as in a flat mirror.",
)
KERNELS = {"bspline": "B-spline", "linear": "linear"}
# Below this share of the truth inside its bars, the report says why.
POOR = 0.9
# The error of half the resolution is no greater than this times the error: the method does not converge there.
STUCK = 1.2
LIMITS = (1e-6, 1.0)
COLUMNS = (
    ("J p50", "interior.jacobian_error.p50"),
    ("p95", "interior.jacobian_error.p95"),
    ("LoD p95", "interior.lod_error.p95"),
    ("singular ratio p95", "interior.singular_ratio.p95"),
    ("axis, ° p50", "interior.axis_angle.p50"),
    ("W2 p50", "interior.wasserstein.p50"),
    ("hit, voxel p99", "interior.hit_error.p99"),
    ("normal, ° p99", "interior.normal_angle.p99"),
    ("uv, texel p95", "interior.uv_error.p95"),
    ("Taylor slope", "taylor.slope"),
)
SHARES = (
    ("slope right", "taylor.right"),
    ("chart differs", "chart_mismatch"),
    ("missed", "missed"),
    ("of it off silhouettes", "missed.away"),
)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = pick(runs)
    if not found:
        return Section("shapes", TITLE, ASKED, ("No run succeeded.",))
    problems = list(dict.fromkeys(_problem(run) for run in found))
    tables = []
    for problem in problems:
        chosen = [run for run in found if _problem(run) == problem]
        tables.append(_errors(problem, chosen))
        tables.append(by_region(f"{problem}, by region, all kernels", chosen, label))
    sentences = [_accuracy(found, problem) for problem in problems]
    return Section(
        name="shapes",
        title=TITLE,
        asked=ASKED,
        finding=(*filter(None, sentences), *_covered(found), *_poor(found), *_taylor(found)),
        headlines=_headlines(found),
        pictures=_pictures(found),
        tables=(_bars(found), *tables),
        notes=NOTES,
    )


def _shape(run: Run) -> str:
    return run.problem.split(", ")[0]


def _problem(run: Run) -> str:
    return run.problem.split(", ", 1)[-1]


def label(run: Run) -> str:
    """Name of a row: shape, resolution and kernel."""
    return f"{_shape(run)} {run.knob['resolution']:g}³, {KERNELS[run.setup['kernel']]}"


def _errors(problem: str, found: Sequence[Run]) -> Table:
    rows = tuple(
        (
            label(run),
            *(number(run.values.get(key)) for _, key in COLUMNS),
            *(percent(run.values.get(key)) for _, key in SHARES),
        )
        for run in found
    )
    header = ("Shape and kernel", *(title for title, _ in COLUMNS), *(title for title, _ in SHARES))
    return Table(f"{problem}, in the interior.", header, rows)


def _bars(found: Sequence[Run]) -> Table:
    """Coverage by shape and problem, kernels side by side."""
    keys = (
        ("inside", "bar.covered", percent),
        ("width", "bar.width", number),
        ("inside, resolution alone", "bar.covered.resolution", percent),
        ("width", "bar.width.resolution", number),
        ("no bar", "bar.no_bar", percent),
    )
    header = ["Truth inside the bar"]
    for name in KERNELS.values():
        header += [f"{name}: {keys[0][0]}", *(title for title, _, _ in keys[1:])]
    rows = []
    for problem in dict.fromkeys(run.problem for run in found):
        at = {run.setup["kernel"]: run.values for run in found if run.problem == problem}
        rows.append((problem, *(say(at.get(kernel, {}).get(key)) for kernel in KERNELS for _, key, say in keys)))
    return Table("How often the truth lies inside the error bar, and how wide that is.", tuple(header), tuple(rows))


def _accuracy(found: Sequence[Run], problem: str) -> str:
    """The range of the interior's median errors over the shapes, by kernel."""
    words = []
    for kernel, name in KERNELS.items():
        errors = {
            _shape(run): run.values["interior.jacobian_error.p50"]
            for run in found
            if _problem(run) == problem
            and run.setup["kernel"] == kernel
            and "interior.jacobian_error.p50" in run.values
        }
        if errors:
            best, worst = min(errors, key=lambda s: errors[s]), max(errors, key=lambda s: errors[s])
            words.append(f"{number(errors[best])} ({best}) to {number(errors[worst])} ({worst}) with {name}")
    return f"{problem}: the median footprint error in the interior is {'; '.join(words)}." if words else ""


def _covered(found: Sequence[Run]) -> tuple[str, ...]:
    """What the bars hold and what they cost, where the method converges."""
    sentences = []
    for kernel, name in KERNELS.items():
        chosen = [run for run in found if run.setup["kernel"] == kernel and "bar.covered" in run.values]
        if chosen:
            least = min(chosen, key=lambda run: run.values["bar.covered"])
            alone = [run.values["bar.covered.resolution"] for run in chosen]
            widths = [run.values["bar.width"] for run in chosen if "bar.width" in run.values]
            lean = [run.values["bar.width.resolution"] for run in chosen if "bar.width.resolution" in run.values]
            wide = f", at {_middle(widths)} times the error" if widths else ""
            tight = f", at {_middle(lean)} times" if lean else ""
            sentences.append(
                f"{name}: the truth lies inside the bar in at least {percent(least.values['bar.covered'])} of the "
                f"pixels ({least.problem}){wide}; inside the difference of resolutions alone in {percent(min(alone))} "
                f"to {percent(max(alone))}{tight} (medians over the shapes)."
            )
    return tuple(sentences)


def _middle(values: Sequence[float]) -> str:
    return number(float(np.median(values)), 2)


def _poor(found: Sequence[Run]) -> tuple[str, ...]:
    """Where the bars fail, and why."""
    poor = [run for run in found if run.values.get("bar.covered", 1.0) < POOR]
    if not poor:
        return (f"No shape and kernel has less than {percent(POOR)} of its truth inside the bars.", *_without(found))
    stuck = [run for run in poor if _gain(run) < STUCK]
    rest = [run for run in poor if run not in stuck]
    sentences = []
    if stuck:
        gains = [_gain(run) for run in stuck]
        sentences.append(
            f"Bars fail (below {percent(POOR)}) for {_named(stuck)}: there the error of half the resolution is "
            f"{number(min(gains))} to {number(max(gains))} times the error, so the method does not converge, and two "
            "grids that are wrong alike tell nothing."
        )
    if rest:
        sentences.append(
            f"Bars fail (below {percent(POOR)}) for {_named(rest)}, although the error shrinks with the resolution, or "
            "no pixel is interior."
        )
    return (*sentences, *_without(found))


def _without(found: Sequence[Run]) -> tuple[str, ...]:
    """Where most pixels have no bar."""
    bare = sorted({_shape(run) for run in found if run.values.get("bar.no_bar", 0.0) > 0.5})
    if not bare:
        return ()
    return (f"Most pixels have no bar on the {', '.join(bare)}: half the resolution misses it, or sees another chart.",)


def _gain(run: Run) -> float:
    """Error at half the resolution over the error, in the interior: of medians or of 95 %, whichever gains less.

    A few wild pixels of a coarse grid do not make a method converge; nor do flat faces, without any error, hide that it
    does not. Infinite where there is no error, or no interior.
    """
    pairs = [(run.values.get(f"coarse.{p}"), run.values.get(f"interior.jacobian_error.{p}")) for p in ("p50", "p95")]
    return min((coarse / fine for coarse, fine in pairs if coarse is not None and fine), default=float("inf"))


def _named(runs: Sequence[Run]) -> str:
    names: dict[str, list[str]] = {}
    for run in runs:
        names.setdefault(f"{KERNELS[run.setup['kernel']]}, {_problem(run)}", []).append(
            f"{_shape(run)} {percent(run.values['bar.covered'])}"
        )
    return "; ".join(f"{setup} ({', '.join(shapes)})" for setup, shapes in names.items())


def _taylor(found: Sequence[Run]) -> tuple[str, ...]:
    sloped = [run for run in found if "taylor.slope" in run.values]
    if not sloped:
        return ()
    least = min(sloped, key=lambda run: run.values["taylor.slope"])
    right = min(run.values["taylor.right"] for run in sloped)
    slopes = [run.values["taylor.slope"] for run in sloped]
    word = "every" if min(slopes) > 1.5 else "NOT every"
    return (
        f"The remainder's slope over the displacement is {number(min(slopes))} ({label(least)}) to "
        f"{number(max(slopes))}, and above 1.5 in at least {percent(right)} of the pixels: {word} footprint is the "
        "derivative of what is traced.",
    )


def _headlines(found: Sequence[Run]) -> tuple[Headline, ...]:
    chosen = [run for run in found if run.setup["kernel"] == "bspline" and "bar.covered" in run.values]
    if not chosen:
        return ()
    shapes = len({_shape(run) for run in chosen})
    what = f"Truth inside the footprint's error bar, B-spline, {shapes} shapes: least share of pixels"
    least = percent(min(run.values["bar.covered"] for run in chosen))
    return (Headline(what, least, "closed forms"),)


def _pictures(found: Sequence[Run]) -> tuple[Picture, ...]:
    panels, names = [], []
    for run in found:
        if run.artefact:
            names.append(run.problem)
            with np.load(run.artefact, allow_pickle=False) as arrays:
                error, resolution, neighbours = (arrays[name] for name in ("error", "resolution", "neighbours"))
            kernel = KERNELS[run.setup["kernel"]]
            panels.append(Map(f"{kernel}: error", error))
            panels.append(Map(f"{kernel}: bar, resolution alone", resolution))
            panels.append(Map(f"{kernel}: whole bar", resolution + neighbours))
    if not panels:
        return ()
    seen = np.any([np.isfinite(panel.values) for panel in panels], axis=0)
    panels = [Map(panel.title, cropped(panel.values, seen)) for panel in panels]
    text = f"{names[0]}: what footprints are off by, and what their bars say, relative to the true footprint."
    return (Picture(plots.maps(panels, "share of |J*|", LIMITS, 3), text),)
