"""What the report says about the second opinion on baked grids."""

from collections.abc import Sequence

from validate.experiment import Run
from validate.section import Headline, Section, Table, number, pick

TITLE = "A second opinion on distance and sign"
ASKED = (
    "Are the baked samples right? Open3D, which shares no code with the baker, is asked for the signed distance at "
    "up to 100,000 samples of each grid's exact band. It works in float32, so it is the less exact of the two."
)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = pick(runs)
    wrong, asked = (sum(run.values[name] for run in found) for name in ("wrong_sign", "samples"))
    worst = max((run.values["distance.max"] for run in found), default=0.0)
    finding = (
        f"Of {asked:,.0f} samples, {wrong:,.0f} have another sign; distances differ by at most {number(worst)} voxel."
    )
    rows = tuple(
        (
            f"{run.problem}, {run.knob['resolution']:g}³",
            f"{run.values['samples']:,.0f}",
            f"{run.values['wrong_sign']:,.0f}",
            *(number(run.values[f"distance.{name}"]) for name in ("p50", "p99", "max")),
        )
        for run in found
    )
    header = ("Grid", "samples", "signs that differ", "distance, voxel p50", "p99", "max")
    headline = Headline("Baked grids: samples whose sign Open3D disputes", f"{wrong:,.0f} of {asked:,.0f}", "Open3D")
    return Section(
        name="opinion",
        title=TITLE,
        asked=ASKED,
        finding=(finding,) if found else ("No run succeeded.",),
        headlines=(headline,) if found else (),
        tables=(Table("Baked grids against Open3D.", header, rows),) if found else (),
    )
