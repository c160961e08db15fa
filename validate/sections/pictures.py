"""What the report says about scenes with glass, mirrors, lights and an environment."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.plots import Map
from validate.section import Headline, Picture, Section, Table, number, percent, pick

TITLE = "Glass, mirrors, lights"
ASKED = (
    "Several grids in one scene, with glass (both ways at the first two surfaces of a path), mirrors, hard shadows by "
    "certified any-hit, and an environment that is filtered by each ray's own differential. Where the shapes are exact "
    "ones, the same paths are traced on their closed forms in float64, and small pictures compared light by light."
)
SHOWN = {
    "glass": "A ball of glass, a mirror and a checkered ball on a page, grids of 64",
    "environment": "A mirror torus in a sky, orthographic, grid of 64",
    "lights": "The bunny at 512, a lamp and a sun",
}


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = {run.problem: run for run in pick(runs)}
    compared = [run for run in found.values() if "mean" in run.values]
    return Section(
        name="pictures",
        title=TITLE,
        asked=ASKED,
        finding=tuple(_sentence(run) for run in compared) or ("No scene was rendered.",),
        headlines=tuple(
            Headline(SHOWN[run.problem], f"{number(run.values['mean'])} mean difference", "exact shapes, linear light")
            for run in compared
        ),
        pictures=(*_pictures(found), *_errors(compared)),
        tables=(_table(compared),),
    )


def _sentence(run: Run) -> str:
    v = run.values
    return (
        f"{SHOWN[run.problem]}: the mean difference from the exact shapes is {number(v['mean'])}, and "
        f"{percent(v['noted'])} of the pixels differ by more than 0.02."
    )


def _pictures(found: dict[str, Run]) -> list[Picture]:
    return [
        Picture(plots.picture(_array(found[name], "image")), title, wide=False)
        for name, title in SHOWN.items()
        if name in found and found[name].artefact
    ]


def _errors(compared: Sequence[Run]) -> list[Picture]:
    panels = [Map(run.problem, _array(run, "error").astype(np.float32)) for run in compared if run.artefact]
    if not panels:
        return []
    source = plots.maps(panels, "mean |difference| in linear light", (1e-4, 1.0))
    return [Picture(source, "Difference from the exact shapes, one sample per pixel.")]


def _table(compared: Sequence[Run]) -> Table:
    rows = tuple(
        (
            SHOWN[run.problem],
            number(run.values["mean"]),
            number(run.values["p99"]),
            percent(run.values["noted"]),
            percent(run.values["flags"]),
        )
        for run in compared
    )
    header = ("Scene", "mean", "99 %", "pixels off by > 0.02", "pixels with other flags")
    return Table("Difference from the exact shapes, linear light.", header, rows)


def _array(run: Run, name: str) -> np.ndarray:
    with np.load(run.artefact, allow_pickle=False) as arrays:
        return np.asarray(arrays[name])
