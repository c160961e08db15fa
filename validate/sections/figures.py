"""What the report says about the figures of the source report."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.plots import Map
from validate.section import Headline, Picture, Section, Table, number, pick

# Equal pictures have no error; a ratio of errors still needs a number.
TINY = 1e-12
TITLE = "The figures of Galim 2018"
ASKED = (
    "The report that this toolkit follows shows a sphere coloured by its normals (figure 4) and a mirror sphere that "
    "reflects a page of text behind the camera (figures 5 to 8). They are rendered anew from grids sampled from the "
    "exact shapes, and from grids baked from their meshes, and measured against a reference of the exact shapes with "
    "64 samples per pixel, in linear light."
)
NOTES = (
    "The captions of figures 6 and 7 are swapped against the text in Galim 2018: the text has figure 7 at 64³ and "
    "figure 6 at 512³. The pictures here are labelled by what they show, with the numbers of the text.",
    "'Cubic' is Catmull-Rom with tension 1/2, as in Galim 2018.",
)
SHOWN = {
    "figure-4-linear": "Normals as colour, 16³, linear (figure 4, left)",
    "figure-4-cubic": "Normals as colour, 16³, cubic (figure 4, right)",
    "figure-5": "Mirror, 512³, cubic, without mipmaps (figure 5)",
    "figure-7-linear": "Mirror, 64³, linear, mipmaps (figure 7 of the text)",
    "figure-7-cubic": "Mirror, 64³, cubic, mipmaps (figure 7 of the text)",
    "figure-7-bspline": "Mirror, 64³, B-spline, mipmaps (not in Galim 2018)",
    "figure-6-linear": "Mirror, 512³, linear, mipmaps (figure 6 of the text)",
    "figure-6-cubic": "Mirror, 512³, cubic, mipmaps (figure 6 of the text)",
    "figure-8": "Mirror, 512³, cubic, mipmaps, 2x supersampling (figure 8)",
}
REFERENCES = {
    "figure-4-reference": "Reference of figure 4: exact shape, 64 samples per pixel",
    "reference": "Reference of figures 5 to 8: exact shapes, 64 samples per pixel",
}


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = {(run.problem, run.setup["grid"]): run for run in pick(runs)}
    return Section(
        name="figures",
        title=TITLE,
        asked=ASKED,
        finding=_finding(found) or ("No figure was rendered.",),
        headlines=_headlines(found),
        pictures=(*_pictures(found), *_errors(found)),
        tables=(_table(found),),
        notes=NOTES,
    )


def _pictures(found: dict[tuple[str, str], Run]) -> list[Picture]:
    pictures = []
    for name, title in REFERENCES.items():
        run = found.get((name, "none"))
        if run and run.artefact:
            pictures.append(Picture(plots.picture(_array(run, "image")), title, wide=False))
    for name, title in SHOWN.items():
        for grid in ("exact", "baked"):
            run = found.get((name, grid))
            if run and run.artefact:
                text = f"{title}; {_source(grid)}; MSE {number(run.values['mse'])}, {run.values['psnr']:.1f} dB"
                pictures.append(Picture(plots.picture(_array(run, "image")), text, wide=False))
    return pictures


def _errors(found: dict[tuple[str, str], Run]) -> list[Picture]:
    panels = []
    for name, title in SHOWN.items():
        run = found.get((name, "exact"))
        if run and run.artefact:
            short = title.partition(" (")[0].replace(", mipmaps, 2x supersampling", ", 2x2 samples")
            panels.append(Map(short, _array(run, "error")[::2, ::2].astype(np.float32)))
    if not panels:
        return []
    source = plots.maps(panels, "mean |difference| in linear light", (1e-3, 1.0))
    return [Picture(source, "Difference from the reference, grids sampled from the exact shapes.")]


def _array(run: Run, name: str) -> np.ndarray:
    with np.load(run.artefact, allow_pickle=False) as arrays:
        return np.asarray(arrays[name])


def _source(grid: str) -> str:
    return "grid sampled from the exact shape" if grid == "exact" else "grid baked from the mesh"


def _finding(found: dict[tuple[str, str], Run]) -> tuple[str, ...]:
    def ratio(worse: str, better: str) -> float | None:
        a, b = found.get((worse, "exact")), found.get((better, "exact"))
        return max(a.values["mse"], TINY) / max(b.values["mse"], TINY) if a and b else None

    sentences = []
    for worse, better, what in (
        ("figure-5", "figure-6-cubic", "Mipmapping by footprints at 512³"),
        (
            "figure-7-linear",
            "figure-7-cubic",
            "Cubic instead of linear interpolation at 64³",
        ),
        (
            "figure-6-linear",
            "figure-6-cubic",
            "Cubic instead of linear interpolation at 512³",
        ),
        ("figure-6-cubic", "figure-8", "2x supersampling on top"),
    ):
        factor = ratio(worse, better)
        if factor is not None:
            word = f"divides it by {number(factor)}" if factor >= 1 else f"multiplies it by {number(1 / factor)}"
            sentences.append(f"{what} {word.replace('it', 'the mean square error', 1)}.")
    return tuple(sentences)


def _headlines(found: dict[tuple[str, str], Run]) -> tuple[Headline, ...]:
    lines = []
    for name in ("figure-5", "figure-6-cubic", "figure-8"):
        run = found.get((name, "exact"))
        if run:
            lines.append(Headline(SHOWN[name], f"{run.values['psnr']:.1f} dB", "exact shapes, 64 samples per pixel"))
    return tuple(lines)


def _table(found: dict[tuple[str, str], Run]) -> Table:
    rows = []
    for name, title in SHOWN.items():
        cells = [title]
        for grid in ("exact", "baked"):
            run = found.get((name, grid))
            cells += [number(run.values["mse"]), f"{run.values['psnr']:.1f}"] if run else ["-", "-"]
        rows.append(tuple(cells))
    header = ("Figure", "MSE, exact grid", "PSNR, dB", "MSE, baked grid", "PSNR, dB")
    return Table("Against the reference, linear light.", header, tuple(rows))
