"""The figures of Galim 2018, each against a reference of 64 samples per pixel of the exact shapes.

In: build/renders/*.exr. Out: one error run per picture, in linear light, with the picture itself.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sdfbake.complaint import BadInput
from sdfrender.image import read_exr, srgb_bytes
from validate.experiment import Bench, Run, guarded
from validate.metrics import IMAGE

FIGURES = ("4-linear", "4-cubic", "5", "7-linear", "7-cubic", "7-bspline", "6-linear", "6-cubic", "8")
GRIDS = {"exact": "", "baked": "-baked"}


def run(bench: Bench) -> Iterator[Run]:
    """Every figure on the grid sampled from the exact shapes, and on the baked one."""
    for reference in ("figure-4-reference", "reference"):
        pixels = _read(bench.render(reference))
        artefact = bench.store(f"figures-{reference}", image=srgb_bytes(pixels))
        yield Run("figures", reference, {"grid": "none"}, {}, "error", artefact=artefact)
    for name in FIGURES:
        bench.progress(f"figure {name} against its reference")
        truth = _read(bench.render("figure-4-reference" if name.startswith("4") else "reference"))
        for grid, suffix in GRIDS.items():
            path = bench.render(f"figure-{name}{suffix}")
            blank = Run("figures", f"figure-{name}", {"grid": grid}, {}, "error")
            yield guarded(blank, partial(_compared, bench, blank, path, truth))


def _compared(bench: Bench, blank: Run, path: Path, truth: Float[np.ndarray, "h w 3"]) -> Run:
    ours = _read(path)
    if ours.shape != truth.shape:
        raise BadInput(f"{path} is {ours.shape[:2]} pixels and its reference {truth.shape[:2]}: render both anew")
    values = {metric.name: float(metric.function(ours, truth)[0]) for metric in IMAGE}
    error = np.abs(ours - truth).mean(axis=2).astype(np.float16)
    artefact = bench.store(f"figures-{path.stem}", image=srgb_bytes(ours), error=error)
    return replace(blank, values=values, artefact=artefact)


def _read(path: Path) -> Float[np.ndarray, "h w 3"]:
    """Read the colours of an EXR, linear light."""
    try:
        rgb: Float[np.ndarray, "h w 3"] = read_exr(path)["rgb"].astype(np.float64)
    except (RuntimeError, ValueError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"{path} is not a picture with channels R, G and B ({reason}): render it anew") from None
    return rgb
