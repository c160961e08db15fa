"""What the report says about the three representations of texture coordinates."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.plots import Map, Panel, Series
from validate.section import Headline, Picture, Section, Table, number, percent, pick
from validate.sections.footprints import LIMITS, cropped

TITLE = "Texture coordinates: faces, layers, grid"
ASKED = (
    "An atlas is cut into charts, and between samples of two charts there is nothing to interpolate. A grid can hold "
    "texture coordinates in three ways: as 'faces' every sample names its closest face; as 'layers' it has those of "
    "every chart nearby, continued past the chart's border; as 'grid' (Galim 2018, eq. 22) those of the closest point, "
    "interpolated across the cuts. All three are asked at 40,000 random points of the mesh, with random tangent "
    "vectors for pixels; the mesh itself says in closed form what is right."
)
NOTES = (
    "Texture coordinates are in texels of a 1024 x 1024 texture. A chart is wrong if it is not that of the face on "
    "which the point lies; 'grid' has the chart of the nearest sample. Points are on the mesh, in float64 on NumPy.",
    "Bytes are those of a file that belong to the representation alone: for 'faces' face ids and the mesh, whose share "
    "does not grow with the resolution. Times are medians of GridField.uv with the default engine: to find the cell, "
    "its normal where it is needed, texture coordinates and gradients.",
)
MODES = ("faces", "layers", "grid")
TITLES = {"faces": "faces", "layers": "layers", "grid": "grid (Galim 2018)"}
QUANTITIES = (("wrong_chart", "wrong chart"), ("lod.share>0.5", "level of detail off by > 0.5"))
# What the bunny at this resolution must reach: shares of the wrong chart, and of levels of detail off by over a half.
GOAL_OF, GOAL_AT = "bunny", 256
GOALS = {"faces": (1e-4, 1e-4), "layers": (5e-3, 1e-3)}
KERNEL = "bspline"


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    views = [run for run in pick(runs) if "points" not in run.values]
    found = sorted((run for run in pick(runs) if "points" in run.values), key=_order)
    times = {_key(run): run.values["us_per_ray"] for run in pick(runs, "timing")}
    return Section(
        name="representations",
        title=TITLE,
        asked=ASKED,
        finding=(*_goals(found), *_against_interpolated(found), *_costs(found, times)) or ("No run succeeded.",),
        headlines=_headlines(found),
        pictures=(*_views(views), *_plots(found)),
        tables=(_table(found, times),) if found else (),
        notes=NOTES,
    )


def _order(run: Run) -> tuple[str, float, int, bool, str]:
    kernel = run.setup["kernel"]
    return run.problem, run.knob["resolution"], MODES.index(run.setup["uv"]), kernel != KERNEL, kernel


def _key(run: Run) -> tuple[str, float, str, str]:
    return run.problem, run.knob["resolution"], run.setup["uv"], run.setup["kernel"]


def _by_mode(found: Sequence[Run], problem: str, resolution: float) -> dict[str, Run]:
    """Of one grid, under the kernel that is the default."""
    chosen = [run for run in found if run.problem == problem and run.knob["resolution"] == resolution]
    return {run.setup["uv"]: run for run in chosen if run.setup["kernel"] == KERNEL}


def _goals(found: Sequence[Run]) -> tuple[str, ...]:
    at = _by_mode(found, GOAL_OF, GOAL_AT)
    sentences = []
    for mode, (charts, levels) in GOALS.items():
        if mode in at:
            wrong, off = (at[mode].values[name] for name, _ in QUANTITIES)
            word = "within" if wrong <= charts and off <= levels else "NOT within"
            sentences.append(
                f"The {GOAL_OF} at {GOAL_AT}³ as {mode}: the wrong chart at {percent(wrong)} of the points and a level "
                f"of detail off by more than a half at {percent(off)}; {word} the {percent(charts)} and "
                f"{percent(levels)} asked for."
            )
    return tuple(sentences)


def _against_interpolated(found: Sequence[Run]) -> tuple[str, ...]:
    """How far the interpolated coordinates are behind, from the coarsest to the finest grid."""
    sentences = []
    for problem in dict.fromkeys(run.problem for run in found):
        resolutions = sorted({run.knob["resolution"] for run in found if run.problem == problem})
        grids = [(n, _by_mode(found, problem, n)) for n in (resolutions[0], resolutions[-1])]
        if all(len(at) == len(MODES) for _, at in grids):
            words = " and ".join(
                f"{_off(at['grid'])} of the points at {n:g}³ "
                f"({_off(at['layers'])} as layers, {_off(at['faces'])} as faces)"
                for n, at in dict(grids).items()
            )
            sentences.append(
                f"Interpolated across cuts as Galim 2018 does it, the level of detail of the {problem} is off by more "
                f"than a half at {words}."
            )
    coarse = [run for run in found if run.setup["uv"] == "layers"]
    if coarse:
        worst = max(coarse, key=lambda run: run.values["wrong_chart"])
        sentences.append(
            f"Layers are worst on the {worst.problem} at {worst.knob['resolution']:g}³, with the wrong chart at "
            f"{percent(worst.values['wrong_chart'])} of the points: there a coarse grid shows the chart across the "
            "cut, continued."
        )
    return tuple(sentences)


def _off(run: Run) -> str:
    return percent(run.values["lod.share>0.5"])


def _costs(found: Sequence[Run], times: dict[tuple[str, float, str, str], float]) -> tuple[str, ...]:
    """What the exact representation costs against the interpolated one."""
    at = _by_mode(found, GOAL_OF, GOAL_AT)
    clocked = {mode: times.get((GOAL_OF, GOAL_AT, mode, KERNEL)) for mode in MODES}
    sentences = []
    if len(at) == len(MODES):
        sizes = ", ".join(f"{number(at[mode].values['bytes'] / 1e6)} MB as {mode}" for mode in MODES)
        sentences.append(f"On disk they take {sizes} ({GOAL_OF} at {GOAL_AT}³).")
    if all(clocked.values()):
        words = ", ".join(f"{number(clocked[mode])} µs as {mode}" for mode in MODES)
        sentences.append(f"A look-up takes {words} there.")
    return tuple(sentences)


def _headlines(found: Sequence[Run]) -> tuple[Headline, ...]:
    at = _by_mode(found, GOAL_OF, GOAL_AT)
    lines = []
    for mode, goals in GOALS.items():
        if mode in at:
            figures = " / ".join(percent(at[mode].values[name]) for name, _ in QUANTITIES)
            limits = " / ".join(percent(goal) for goal in goals)
            what = f"Texture coordinates as {mode}, {GOAL_OF} at {GOAL_AT}³: wrong chart / level of detail off by > 0.5"
            met = all(at[mode].values[name] <= goal for (name, _), goal in zip(QUANTITIES, goals, strict=True))
            lines.append(Headline(what, figures, f"at most {limits}", met))
    return tuple(lines)


def _views(views: Sequence[Run]) -> list[Picture]:
    """Interpolated ones first: pictures side by side, and under them where the level of detail is wrong."""
    ordered = sorted((run for run in views if run.artefact), key=lambda run: -MODES.index(run.setup["uv"]))
    if not ordered:
        return []
    arrays = []
    for run in ordered:
        with np.load(run.artefact, allow_pickle=False) as stored:
            arrays.append((stored["image"], stored["lod_error"].astype(np.float32)))
    seen = np.any([np.isfinite(error) for _, error in arrays], axis=0)
    pictures, panels = [], []
    for run, (image, error) in zip(ordered, arrays, strict=True):
        title = f"{TITLES[run.setup['uv']]}, {run.knob['resolution']:g}³"
        name = run.problem.partition(",")[0].capitalize()
        text = f"{name}, {title}; level of detail off by > 0.5 in {_off(run)} of the pixels"
        pictures.append(Picture(plots.picture(cropped(image, seen)), text, wide=False))
        panels.append(Map(title, cropped(error, seen)))
    source = plots.maps(panels, "|LoD - LoD*|, mip levels", LIMITS)
    text = (
        "Error of the level of detail in the same view; the mesh by Embree is truth, so that the moved outline counts."
    )
    return [*pictures, Picture(source, text)]


def _plots(found: Sequence[Run]) -> list[Picture]:
    panels = []
    wanted = [
        (GOAL_OF, QUANTITIES[0]),
        *((name, QUANTITIES[1]) for name in dict.fromkeys(run.problem for run in found)),
    ]
    for problem, (name, title) in wanted:
        here = [run for run in found if run.problem == problem and run.setup["kernel"] == KERNEL]
        if any(run.values[name] > 0 for run in here):
            series = tuple(line for mode in MODES if (line := _series(here, mode, name)))
            panels.append(Panel(f"{problem.capitalize()}: {title}", series, "samples along the longest axis", "share"))
    if not panels:
        return []
    text = "Shares of the points against the resolution, B-spline. None at all is drawn as half a point."
    return [Picture(plots.convergence(panels), text)]


def _series(runs: Sequence[Run], mode: str, name: str) -> Series | None:
    """One curve; a logarithmic axis has no zero, and half a point is below what can be found."""
    chosen = [run for run in runs if run.setup["uv"] == mode]
    if not chosen:
        return None
    share = np.array([max(run.values[name], 0.5 / run.values["points"]) for run in chosen])
    resolution = np.array([float(run.knob["resolution"]) for run in chosen])
    return Series(TITLES[mode], resolution, share, tuple(f"{n:g}³" for n in resolution))


def _table(found: Sequence[Run], times: dict[tuple[str, float, str, str], float]) -> Table:
    rows = tuple(
        (
            f"{run.problem}, {run.knob['resolution']:g}³, {run.setup['uv']}, {run.setup['kernel']}",
            *(number(run.values[f"uv.{key}"]) for key in ("p50", "p95", "p99")),
            percent(run.values["wrong_chart"]),
            number(run.values["lod.p95"]),
            percent(run.values["lod.share>0.5"]),
            percent(run.values["seam"]),
            number(run.values["bytes"] / 1e6),
            number(times.get(_key(run))),
        )
        for run in found
    )
    header = ("Grid", "uv, texel p50", "p95", "p99", "wrong chart", "LoD p95", "> 0.5", "SEAM", "MB", "µs per look-up")
    return Table("Texture coordinates at random points of the surface.", header, rows)
