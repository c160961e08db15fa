"""What the report says about footprints, grid against mesh and against closed forms."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Shaped

from validate import plots
from validate.experiment import Run
from validate.plots import Map
from validate.regions import CLASSES, TITLES
from validate.section import Headline, Picture, Section, Table, number, percent, pick

TITLE = "Footprints: the grid against the mesh"
ASKED = (
    "Is the footprint that a ray carries to the texture the right one? Primary rays are compared with ray "
    "differentials over the mesh itself (Embree names the face, everything else is computed anew in float64). For "
    "rays that a curved mirror has turned, the exact shape is truth, in closed form, and meshes with facets or with "
    "interpolated normals are contenders like the grids. Footprints are in texels of a 1024 x 1024 texture per pixel."
)
NOTES = (
    "Baked grids are read in two ways: as 'faces', texture coordinates are those of the closest face on either side "
    "of a cut of the atlas; as 'grid', they are interpolated as Galim 2018 does it, across the cuts too, and pixels "
    "whose stencil crosses a cut (SEAM) are wrong by construction. Grids sampled from exact shapes know 'grid' only. "
    "The tables give all pixels; those inside charts and off seams, which are fewer and easier as 'grid'; and pixels "
    "by region: within 5 pixels of the silhouette, else at a seam, else at an edge (2 pixels, or flagged), else in the "
    "interior.",
    "A mesh with interpolated normals is not an optical surface; it stands here for what renderers do today.",
)
COLUMNS = (
    ("hit, voxel p50", "hit_error.p50"),
    ("p99", "hit_error.p99"),
    ("normal, ° p50", "normal_angle.p50"),
    ("J error p50", "jacobian_error.p50"),
    ("LoD mean", "lod_error.mean"),
    ("p50", "lod_error.p50"),
    ("p95", "lod_error.p95"),
    ("p99", "lod_error.p99"),
)
SHARES = (
    ("> 0.5", "lod_error.share>0.5"),
    ("> 1", "lod_error.share>1"),
    ("chart differs", "chart_mismatch"),
    ("SEAM", "seam"),
    ("missed", "missed"),
    ("of it off silhouettes", "missed.away"),
)
INSIDE = (
    ("J error p50", "inside.jacobian_error.p50"),
    ("p95", "inside.jacobian_error.p95"),
    ("LoD mean", "inside.lod_error.mean"),
    ("p50", "inside.lod_error.p50"),
    ("p95", "inside.lod_error.p95"),
    ("p99", "inside.lod_error.p99"),
    ("singular ratio p95", "inside.singular_ratio.p95"),
    ("axis, ° p50", "inside.axis_angle.p50"),
    ("W2 p50", "inside.wasserstein.p50"),
    ("uv, texel p95", "inside.uv_error.p95"),
)
# Errors below a hundredth of a mip level cannot be seen; four levels is as wrong as it gets.
LIMITS = (0.01, 4.0)
# Level-of-detail error that the default reading of the finest grid must reach on a scanned mesh: p50, p95.
ASKED_OF, AT_MOST = "bunny, primary rays", (0.02, 0.2)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    problems = {problem: _ordered([run for run in runs if run.problem == problem]) for problem in _problems(runs)}
    problems = {problem: found for problem, found in problems.items() if found}
    pictures, tables = [], []
    for problem, found in problems.items():
        pictures.extend(_maps(problem, found))
        tables.append(_table(f"{problem}, all pixels", found, COLUMNS, SHARES))
        tables.append(_table(f"{problem}, inside charts", found, INSIDE, ()))
        tables.append(by_region(f"{problem}, by region", found, label))
    finding = tuple(_finding(problem, found) for problem, found in problems.items())
    return Section(
        name="footprints",
        title=TITLE,
        asked=ASKED,
        finding=finding or ("No run succeeded.",),
        headlines=_headlines(problems),
        pictures=tuple(pictures),
        tables=tuple(tables),
        notes=NOTES,
    )


def _problems(runs: Sequence[Run]) -> list[str]:
    """Primary rays first."""
    return sorted(dict.fromkeys(run.problem for run in runs), key=lambda problem: "primary" not in problem)


def _ordered(runs: Sequence[Run]) -> list[Run]:
    """Meshes, then grids by resolution, those of exact shapes first."""
    routes = ("mesh, facets", "mesh, interpolated normals", "exact grid", "baked grid")
    return sorted(
        pick(runs), key=lambda run: (run.knob.get("resolution", 0.0), routes.index(run.setup["route"]), label(run))
    )


def label(run: Run) -> str:
    """Name of a setup: route, which texture coordinates are read, kernel, resolution."""
    resolution = f"{run.knob['resolution']:g}³" if "resolution" in run.knob else ""
    read = f"uv as {run.setup['uv']}" if "uv" in run.setup else ""
    return ", ".join(word for word in (run.setup["route"], read, run.setup.get("kernel", ""), resolution) if word)


def _table(
    caption: str, found: Sequence[Run], columns: Sequence[tuple[str, str]], shares: Sequence[tuple[str, str]]
) -> Table:
    rows = tuple(
        (
            label(run),
            *(number(run.values.get(key)) for _, key in columns),
            *(percent(run.values.get(key)) for _, key in shares),
        )
        for run in found
    )
    return Table(caption, ("Route", *(title for title, _ in columns), *(title for title, _ in shares)), rows)


def by_region(caption: str, found: Sequence[Run], name: Callable[[Run], str]) -> Table:
    """Share and errors of the pixels near silhouettes, seams and edges, and in the interior."""
    keys = (("J p50", "jacobian_error.p50"), ("J p95", "jacobian_error.p95"), ("LoD p95", "lod_error.p95"))
    header = ["Route"]
    for region in CLASSES:
        header += [TITLES[region], *(title for title, _ in keys)]
    rows = []
    for run in found:
        row = [name(run)]
        for region in CLASSES:
            row.append(percent(run.values.get(f"{region}.share")))
            row += [number(run.values.get(f"{region}.{key}")) for _, key in keys]
        rows.append(tuple(row))
    return Table(caption, tuple(header), tuple(rows))


def _maps(problem: str, found: Sequence[Run]) -> list[Picture]:
    panels = []
    for run in found:
        if run.artefact:
            with np.load(run.artefact, allow_pickle=False) as arrays:
                panels.append(Map(label(run).replace(", ", "\n", 1), arrays["lod_error"].astype(np.float32)))
    if not panels:
        return []
    seen = np.any([np.isfinite(panel.values) for panel in panels], axis=0)
    panels = [Map(panel.title, cropped(panel.values, seen)) for panel in panels]
    text = f"{problem}: error of the level of detail per pixel; pale where there is nothing to compare."
    columns = 4 if len(panels) % 4 == 0 or len(panels) < 4 else 5
    return [Picture(plots.maps(panels, "|LoD - LoD*|, mip levels", LIMITS, columns), text)]


def cropped(values: Shaped[np.ndarray, "h w ..."], seen: Bool[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h2 w2 ..."]:
    """The rows and columns of an image or a map where something is seen, and a few around them."""
    rows, columns = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return values
    return values[max(rows[0] - 4, 0) : rows[-1] + 5, max(columns[0] - 4, 0) : columns[-1] + 5]


def _finding(problem: str, found: Sequence[Run]) -> str:
    complete = [run for run in found if "inside.lod_error.p50" in run.values]
    if not complete:
        return f"{problem}: no route has a pixel to compare."
    best = min(complete, key=lambda run: run.values["inside.lod_error.p50"])
    sentence = (
        f"{problem}: nearest to the truth inside charts is {label(best)}, with a level-of-detail error of "
        f"{number(best.values['inside.lod_error.p50'])} (median) and {number(best.values['inside.lod_error.p95'])} "
        f"(95 %)"
    )
    grids = [run for run in complete if "grid" in run.setup["route"]]
    if grids:
        worst = max(grids, key=lambda run: run.values["lod_error.share>0.5"])
        share = percent(worst.values["lod_error.share>0.5"])
        sentence += f"; the worst grid, {label(worst)}, is off by more than half a level in {share} of all pixels"
    # Behind a curved mirror the facets of a baked grid decide, however its texture coordinates are read.
    costs = _costs(grids) if "primary" in problem else []
    return ". ".join([sentence, *costs, *_regions(found), *_limit(problem, found)]) + "."


def _regions(found: Sequence[Run]) -> list[str]:
    """Where the errors of the finest grid lie."""
    sentences = []
    for run in filter(_finest, found):
        errors = {region: run.values.get(f"{region}.jacobian_error.p50") for region in CLASSES}
        words = [f"{number(error)} {TITLES[region]}" for region, error in errors.items() if error is not None]
        if words:
            sentences.append(f"The median footprint error of {label(run)} is {', '.join(words)}")
    return sentences


def _limit(problem: str, found: Sequence[Run]) -> list[str]:
    """Whether the finest baked grid, read as is the default, keeps the limits."""
    if problem != ASKED_OF:
        return []
    sentences = []
    for run in found:
        if _finest(run) and run.setup["route"] == "baked grid":
            p50, p95 = _levels(run)
            kept = "met" if p50 <= AT_MOST[0] and p95 <= AT_MOST[1] else "NOT met"
            sentences.append(
                f"The limits at 512³, {AT_MOST[0]:g} (median) and {AT_MOST[1]:g} (95 %), are {kept}: {number(p50)} and "
                f"{number(p95)}"
            )
    return sentences


def _finest(run: Run) -> bool:
    """Whether a run is of the default kernel and reading on the finest grid, with pixels to compare."""
    fine = run.setup.get("kernel") == "bspline" and run.knob.get("resolution") == 512
    default = run.setup["route"] != "baked grid" or run.setup["uv"] == "faces"
    return fine and default and "inside.lod_error.p50" in run.values


def _levels(run: Run) -> tuple[float, float]:
    return run.values["inside.lod_error.p50"], run.values["inside.lod_error.p95"]


def _costs(grids: Sequence[Run]) -> list[str]:
    """What reading the same baked grid as Galim 2018 does costs, by resolution."""
    share = {
        (run.knob["resolution"], run.setup["uv"]): run.values["lod_error.share>0.5"]
        for run in grids
        if run.setup["route"] == "baked grid" and run.setup["kernel"] == "bspline"
    }
    pairs = [
        (n, share[n, "faces"], share[n, "grid"])
        for n in sorted({n for n, _ in share})
        if {(n, "faces"), (n, "grid")} <= set(share)
    ]
    if not pairs:
        return []
    words = " and ".join(f"{percent(faces)} against {percent(grid)} at {n:g}³" for n, faces, grid in pairs)
    return [
        f"Read by faces instead of interpolated, baked texture coordinates are off by as much in {words} (B-spline)"
    ]


def _headlines(problems: dict[str, list[Run]]) -> tuple[Headline, ...]:
    lines = []
    for problem, found in problems.items():
        for run in filter(_finest, found):
            truth, met = "the mesh by Embree" if "primary" in problem else "the exact shape, closed form", None
            if problem == ASKED_OF:
                truth += f"; at most {AT_MOST[0]:g} / {AT_MOST[1]:g}"
                met = all(figure <= most for figure, most in zip(_levels(run), AT_MOST, strict=True))
            what = (
                f"{problem}, {run.setup['route']} 512³, uv as {run.setup['uv']}, B-spline: level-of-detail error "
                "inside charts, p50 / p95"
            )
            lines.append(Headline(what, " / ".join(map(number, _levels(run))), truth, met))
    return tuple(lines)
