"""What the report says about baked meshes against the meshes themselves."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.plots import Map
from validate.section import Picture, Section, Table, number, percent, pick
from validate.sections.footprints import LIMITS, by_region, cropped

TITLE = "Every mesh: the baked grid against Embree"
ASKED = (
    "How far is the footprint on a baked grid from the one on the mesh it was baked from? Camera rays on the meshes of "
    "all exact shapes, with the shapes' own texture coordinates, on a cow with an atlas and on a textured bunny with "
    "its own; ray differentials over the mesh, by Embree and recomputed in float64, are truth."
)
KERNELS = {"bspline": "B-spline", "linear": "linear"}
COLUMNS = (
    ("hit, voxel p50", "inside.hit_error.p50"),
    ("normal, ° p50", "inside.normal_angle.p50"),
    ("J p50", "inside.jacobian_error.p50"),
    ("p95", "inside.jacobian_error.p95"),
    ("LoD p50", "inside.lod_error.p50"),
    ("p95", "inside.lod_error.p95"),
    ("p99", "inside.lod_error.p99"),
    ("singular ratio p95", "inside.singular_ratio.p95"),
    ("axis, ° p50", "inside.axis_angle.p50"),
    ("W2 p50", "inside.wasserstein.p50"),
    ("uv, texel p95", "inside.uv_error.p95"),
)
SHARES = (
    ("LoD > 0.5", "inside.lod_error.share>0.5"),
    ("chart differs", "chart_mismatch"),
    ("missed", "missed"),
    ("of it off silhouettes", "missed.away"),
)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = pick(runs)
    if not found:
        return Section("meshes", TITLE, ASKED, ("No run succeeded.",))
    return Section(
        name="meshes",
        title=TITLE,
        asked=ASKED,
        finding=tuple(_finding(found, kernel) for kernel in KERNELS if _of(found, kernel)) or ("Nothing to compare.",),
        pictures=_pictures(found),
        tables=(_table(found), by_region("By region, all kernels.", found, label)),
        notes=(
            "Texture coordinates are read by faces. The first table is of pixels whose chart is the mesh's: what lies "
            "on another chart is counted, not averaged.",
        ),
    )


def label(run: Run) -> str:
    """Name of a row: mesh, resolution and kernel."""
    return f"{run.problem.replace('_', ' ')} {run.knob['resolution']:g}³, {KERNELS[run.setup['kernel']]}"


def _of(found: Sequence[Run], kernel: str) -> list[Run]:
    return [run for run in found if run.setup["kernel"] == kernel and "inside.lod_error.p95" in run.values]


def _finding(found: Sequence[Run], kernel: str) -> str:
    chosen = _of(found, kernel)
    worst = max(chosen, key=lambda run: run.values["inside.lod_error.p95"])
    charts = max(chosen, key=lambda run: run.values["chart_mismatch"])
    away = max(chosen, key=lambda run: run.values["missed.away"])
    lost = (
        f"off silhouettes {percent(away.values['missed.away'])} are missed on {label(away)}"
        if away.values["missed.away"]
        else "off silhouettes nothing is missed on any"
    )
    return (
        f"{KERNELS[kernel]}: of {len(chosen)} meshes the farthest from Embree is {label(worst)}, with a "
        f"level-of-detail error of {number(worst.values['inside.lod_error.p50'])} (median) and "
        f"{number(worst.values['inside.lod_error.p95'])} (95 %) where the charts agree; they differ in at most "
        f"{percent(charts.values['chart_mismatch'])} of the pixels ({label(charts)}); {lost}."
    )


def _table(found: Sequence[Run]) -> Table:
    rows = tuple(
        (
            label(run),
            *(number(run.values.get(key)) for _, key in COLUMNS),
            *(percent(run.values.get(key)) for _, key in SHARES),
        )
        for run in found
    )
    header = ("Mesh and kernel", *(title for title, _ in COLUMNS), *(title for title, _ in SHARES))
    return Table("Where the charts agree.", header, rows)


def _pictures(found: Sequence[Run]) -> tuple[Picture, ...]:
    panels = []
    for run in found:
        if run.artefact:
            with np.load(run.artefact, allow_pickle=False) as arrays:
                panels.append(Map(label(run), arrays["lod_error"].astype(np.float32)))
    if not panels:
        return ()
    seen = np.any([np.isfinite(panel.values) for panel in panels], axis=0)
    panels = [Map(panel.title, cropped(panel.values, seen)) for panel in panels]
    text = "Error of the level of detail per pixel; pale where there is nothing to compare."
    return (Picture(plots.maps(panels, "|LoD - LoD*|, mip levels", LIMITS), text),)
