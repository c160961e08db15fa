"""What the report says about files of footprints that were scored, of any renderer."""

from collections.abc import Sequence

from validate.experiment import Run
from validate.section import Section, Table, number, percent, pick

TITLE = "Scores of any renderer"
ASKED = (
    "Are the footprints that a renderer wrote right? 'python -m validate score' takes position, texture coordinates "
    "and their derivatives per pixel from a file, whoever wrote it, and holds them against exact shapes in closed form "
    "or against the mesh by Embree. Here are the files that were scored; those of this toolkit's own renders go the "
    "same way."
)
COLUMNS = (
    ("position p50", "position_error.p50"),
    ("J error p50", "jacobian_error.p50"),
    ("LoD p50", "lod_error.p50"),
    ("p95", "lod_error.p95"),
    ("interior p50", "interior.lod_error.p50"),
    ("p95", "interior.lod_error.p95"),
)
OCTAVE = 0.9  # of a level: from here on, a median error is a factor of two or a unit, not a rounding


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = pick(runs)
    return Section(
        name="scores",
        title=TITLE,
        asked=ASKED,
        finding=tuple(_sentence(run) for run in found) or ("No file was scored.",),
        tables=(_table(found),),
    )


def _sentence(run: Run) -> str:
    v = run.values
    if "lod_error.p50" not in v:
        return f"{_label(run)}: no pixel is hit in both."
    sentence = (
        f"{_label(run)}: over {v['pixels']:,.0f} pixels the level of detail is off by {number(v['lod_error.p50'])} "
        f"(median) and {number(v['lod_error.p95'])} (95 %); hit or miss differs at {percent(v['missed'])}"
    )
    if v["lod_error.p50"] >= OCTAVE:
        sentence += "; so large a median speaks of other units: derivatives are per pixel, texture coordinates 0 to 1"
    return sentence + "."


def _label(run: Run) -> str:
    return f"{run.setup['file']} against {run.setup['truth']}"


def _table(found: Sequence[Run]) -> Table:
    rows = tuple(
        (
            _label(run),
            f"{run.values['pixels']:,.0f}",
            *(number(run.values.get(key)) for _, key in COLUMNS),
            percent(run.values.get("missed")),
        )
        for run in found
    )
    header = ("File and truth", "pixels", *(title for title, _ in COLUMNS), "missed")
    return Table("Positions in world units, levels of detail in mip levels.", header, rows)
