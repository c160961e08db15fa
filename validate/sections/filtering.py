"""What the report says about filters by footprint and samples per pixel, at equal time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from validate import plots
from validate.experiment import Run
from validate.plots import Map, Panel, Series
from validate.section import Headline, Picture, Section, Table, number, percent, pick

TITLE = "What ray differentials buy"
ASKED = (
    "Without footprints a texture is filtered by taking more samples per pixel; with them, by one look-up per ray. "
    "Which gets nearer to the truth in the same time? Point sampling and bilinear look-ups of the finest texels know "
    "no footprint; trilinear and anisotropic ones take it from the ray's differentials. Each with 1 to 64 samples per "
    "pixel is held against exact shapes with 128 samples per pixel, whose own error is stated (as FLIP, that between "
    "its halves). FLIP says how visible a difference is when one flips between the pictures (0 to 1); flicker is what "
    "the error changes when the film moves by quarters of a pixel."
)
NOTES = (
    "FLIP is LDR-FLIP of Andersson et al. 2020 by its authors' code, for 67 pixels per degree. Errors are of linear "
    "light, flicker is its standard deviation over eight shifts, less what the truth itself changes.",
    "Timed pictures hold the same number of paths, so fewer pixels where there are more samples; times are medians and "
    "per pixel. Samples between those that were taken are interpolated along straight lines of the logarithms.",
    "A footprint is of the texture: at an edge of the surface it knows nothing of what lies beyond, and only more "
    "samples help. A pixel counts as an edge where a neighbour sees another part, or nothing.",
)
FILTERS = ("point", "bilinear", "trilinear", "anisotropic")
BY_FOOTPRINT = "anisotropic"
ENLARGED, GAP = 2, 4  # screen pixels per pixel of a plate, and between its pictures
SAME = 0.01  # share by which errors may differ and still be called the same
FLIP_LIMITS = (0.01, 1.0)
TINY = 1e-12


class Curve(NamedTuple):
    """One filter over samples per pixel: errors by name, and µs per pixel where the clock ran."""

    samples: np.ndarray
    flip: np.ndarray
    rmse: np.ndarray
    cost: np.ndarray | None


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = {problem: _of(runs, problem) for problem in dict.fromkeys(run.problem for run in pick(runs))}
    curves = {problem: _curves(runs, errors) for problem, errors in found.items()}
    sentences = [sentence for problem in found for sentence in _finding(problem, found[problem], curves[problem])]
    pictures = [picture for problem in found for picture in _pictures(problem, found[problem], curves[problem])]
    return Section(
        name="filtering",
        title=TITLE,
        asked=ASKED,
        finding=tuple(sentences) or ("No picture was compared.",),
        headlines=tuple(line for problem in found for line in _headline(problem, curves[problem])),
        pictures=tuple(pictures),
        tables=tuple(_table(problem, errors, runs) for problem, errors in found.items()),
        notes=NOTES,
    )


Errors = dict[tuple[str, float], Run]


def _of(runs: Sequence[Run], problem: str) -> Errors:
    """Error runs of a scene by filter and samples; the truth's own has the filter "truth"."""
    chosen = [run for run in pick(runs) if run.problem == problem]
    order = ("truth", *FILTERS)
    chosen.sort(key=lambda run: (order.index(run.setup["filter"]), run.knob["samples"]))
    return {(run.setup["filter"], run.knob["samples"]): run for run in chosen}


def _clock(runs: Sequence[Run], problem: str) -> dict[tuple[str, float], float]:
    timings = (run for run in pick(runs, "timing") if run.problem == problem)
    return {(run.setup["filter"], run.knob["samples"]): run.values["us_per_pixel"] for run in timings}


def _curves(runs: Sequence[Run], errors: Errors) -> dict[str, Curve]:
    curves = {}
    for name in FILTERS:
        chosen = [run for (filtering, _), run in errors.items() if filtering == name]
        if not chosen:
            continue
        clock = _clock(runs, chosen[0].problem)
        costs = [clock.get((name, run.knob["samples"])) for run in chosen]
        samples, flip, rmse = (
            np.array(column) for column in zip(*((r.knob["samples"], *_both(r)) for r in chosen), strict=True)
        )
        timed = [cost for cost in costs if cost is not None]
        curves[name] = Curve(samples.astype(float), flip, rmse, np.array(timed) if len(timed) == len(costs) else None)
    return curves


def _both(run: Run) -> tuple[float, float]:
    return max(run.values["flip"], TINY), max(run.values["rmse"], TINY)


# ---- sentences -------------------------------------------------------------------------------------------------------
def needed(samples: np.ndarray, errors: np.ndarray, target: float) -> float | None:
    """Samples per pixel with which an error falls to a target: between two, along a line of the logarithms.

    Returns
    -------
    float or None
        The least number that was tried, if that is enough; None if no number that was tried is.
    """
    enough = np.flatnonzero(errors <= target)
    if len(enough) == 0:
        return None
    last = enough[0]
    if last == 0:
        return float(samples[0])
    x, y = np.log(errors[[last, last - 1]]), np.log(samples[[last, last - 1]])
    return float(np.exp(np.interp(np.log(target), x, y)))


def _price(curve: Curve, samples: float) -> float | None:
    """µs per pixel for a number of samples."""
    if curve.cost is None:
        return None
    return float(np.exp(np.interp(np.log(samples), np.log(curve.samples), np.log(curve.cost))))


def _finding(problem: str, errors: Errors, curves: dict[str, Curve]) -> list[str]:
    sentences = []
    if {"bilinear", BY_FOOTPRINT} <= set(curves):
        sentences.append(_bought(problem, curves))
    return [*sentences, *_steadiness(problem, errors), *_limits(problem, errors)]


def _bought(problem: str, curves: dict[str, Curve]) -> str:
    """How many samples, and how much time, one look-up by footprint is worth."""
    ours, bare = curves[BY_FOOTPRINT], curves["bilinear"]
    if abs(ours.rmse[0] / bare.rmse[0] - 1) < SAME:
        return (
            f"{problem}: footprints buy nothing, anisotropic and bilinear look-ups of one sample have the same error "
            f"({number(float(ours.rmse[0]))}, {number(float(bare.rmse[0]))}): no texel is narrower than a pixel."
        )
    words = [f"{name} sampling {_worth(curves[name], ours)}" for name in ("point", "bilinear") if name in curves]
    return (
        f"{problem}: anisotropic filtering of one sample per pixel has a FLIP error of {number(float(ours.flip[0]))}. "
        f"To be as near to the truth, {'; '.join(words)}."
    )


def _worth(bare: Curve, ours: Curve) -> str:
    count = needed(bare.samples, bare.flip, float(ours.flip[0]))
    if count is None:
        return f"needs more than {bare.samples[-1]:g} samples, where its error is {number(float(bare.flip[-1]))}"
    theirs, mine = _price(bare, count), None if ours.cost is None else float(ours.cost[0])
    square = needed(bare.samples, bare.rmse, float(ours.rmse[0]))
    said = f"needs {number(count)} samples"
    if theirs is not None and mine is not None:
        said += f" and {number(theirs / mine)} times the time"
    return said + (
        f" (by root mean square, {number(square)} samples)"
        if square
        else " (by root mean square, more than were taken)"
    )


def _steadiness(problem: str, errors: Errors) -> list[str]:
    said = [
        f"{number(errors[name, 1].values['flicker'])} ({name})"
        for name in FILTERS
        if (name, 1) in errors and "flicker" in errors[name, 1].values
    ]
    truth = next((run for (name, _), run in errors.items() if name == "truth"), None)
    if not said or truth is None:
        return []
    return [
        f"{problem}: moved by parts of a pixel, pictures of one sample flicker by {', '.join(said)}; the truth itself "
        f"changes by {number(truth.values['change'])}."
    ]


def _limits(problem: str, errors: Errors) -> list[str]:
    """What is left where the surface has edges."""
    ours, bare = (errors.get((name, 1)) for name in (BY_FOOTPRINT, "bilinear"))
    if ours is None or bare is None or not ours.values["edges"]:
        return []
    gain, within = (
        bare.values[f"{where}.rmse"] / max(ours.values[f"{where}.rmse"], TINY) for where in ("edges", "inside")
    )
    return [
        f"{problem}: at edges of the surface ({percent(ours.values['edges'])} of the pixels, "
        f"{percent(ours.values['edges.share'])} of the squared error of anisotropic filtering) footprints divide the "
        f"error of one bilinear sample by {number(gain)}, elsewhere by {number(within)}."
    ]


def _headline(problem: str, curves: dict[str, Curve]) -> list[Headline]:
    if not {"point", BY_FOOTPRINT} <= set(curves):
        return []
    ours, bare = curves[BY_FOOTPRINT], curves["point"]
    count = needed(bare.samples, bare.flip, float(ours.flip[0]))
    mine, theirs = ours.cost, None if count is None else _price(bare, count)
    if count is None or count <= bare.samples[0] or mine is None or theirs is None:
        return []
    what = f"{problem}: point samples per pixel, and time, that one anisotropic look-up by footprint is worth"
    return [Headline(what, f"{number(count)} / {number(theirs / float(mine[0]))} x", "equal FLIP error")]


# ---- pictures and tables ---------------------------------------------------------------------------------------------
def _pictures(problem: str, errors: Errors, curves: dict[str, Curve]) -> list[Picture]:
    shown = [(key, run) for key, run in errors.items() if run.artefact and (key[0] == "truth" or key[1] == 1)]
    if not shown:
        return []
    names = ", ".join("the truth" if name == "truth" else name for (name, _), _ in shown)
    plate = plots.picture(_plate([_array(run, "image") for _, run in shown]))
    pictures = [Picture(plate, f"{problem}, from the left: {names}; one sample per pixel but for the truth.")]
    maps = [
        Map(f"{name}, {number(run.values['flip'])}", _array(run, "flip").astype(np.float32))
        for (name, _), run in shown
        if name != "truth"
    ]
    if maps:
        source = plots.maps(maps, "FLIP", FLIP_LIMITS)
        pictures.append(Picture(source, f"{problem}: how visible the difference from the truth is, with its mean."))
    panels = _panels(problem, curves)
    if panels:
        text = f"{problem}: error against time; labels are samples per pixel."
        pictures.append(Picture(plots.work_precision(panels), text))
    return pictures


def _plate(images: Sequence[UInt8[np.ndarray, "h w 3"]]) -> UInt8[np.ndarray, "h2 w2 3"]:
    """Pictures side by side, enlarged, texels left as they are."""
    large = [image.repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1) for image in images]
    gap = np.full((large[0].shape[0], GAP, 3), 255, np.uint8)
    return np.concatenate([part for image in large for part in (gap, image)][1:], axis=1)


def _panels(problem: str, curves: dict[str, Curve]) -> list[Panel]:
    timed = {name: curve for name, curve in curves.items() if curve.cost is not None}
    if not timed:
        return []
    panels = []
    for key, title in (("flip", "FLIP"), ("rmse", "root mean square error, linear light")):
        series = tuple(
            Series(name, getattr(curve, key), curve.cost, tuple(f"{n:g}" for n in curve.samples))
            for name, curve in timed.items()
            if curve.cost is not None
        )
        panels.append(Panel(problem, series, title, "µs per pixel"))
    return panels


def _table(problem: str, errors: Errors, runs: Sequence[Run]) -> Table:
    clock = _clock(runs, problem)
    names = ("flip", "rmse", "psnr", "flicker", "inside.rmse", "edges.rmse")
    rows = []
    for (name, samples), run in errors.items():
        label = f"{'the truth, its own error' if name == 'truth' else name}, {samples:g}"
        # Where no pixel is at an edge there is no error to speak of.
        cells = [number(run.values.get(key)) for key in names]
        cells[-1] = cells[-1] if run.values.get("edges") else "-"
        rows.append((label, *cells, number(clock.get((name, samples)))))
    header = ("Filter, samples per pixel", "FLIP", "RMSE", "PSNR, dB", "flicker", "RMSE inside", "at edges", "µs/pixel")
    return Table(f"{problem}, {_size(errors)}.", header, tuple(rows))


def _size(errors: Errors) -> str:
    truth = next((run for (name, _), run in errors.items() if name == "truth"), None)
    return "linear light" if truth is None else f"linear light, truth of {truth.knob['samples']:g} samples per pixel"


def _array(run: Run, name: str) -> np.ndarray:
    with np.load(run.artefact, allow_pickle=False) as arrays:
        return np.asarray(arrays[name])
