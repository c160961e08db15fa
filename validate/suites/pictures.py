"""Scenes with glass, mirrors, lights and an environment: grids against exact shapes, light by light.

In: build/renders/{glass,environment,lights}.exr and their scenes. Out: one run per picture; where its shapes are exact,
an error run of a small picture whose paths are traced again on the closed forms, in float64.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from datasets_synthetic import shape
from sdfrender import load_scene, render
from sdfrender.image import read_exr, srgb_bytes
from validate.exact import ShapeField
from validate.experiment import Bench, Run, guarded

SCENES = ("glass", "environment", "lights")
# Grids that are sampled from shapes, and these.
EXACT = {"exact-sphere@64.zarr.zip": "sphere", "exact-sheet@128.zarr.zip": "sheet", "exact-torus@64.zarr.zip": "torus"}
WIDTH = 160  # pixels of the picture that is compared
NOTED = 0.02  # a difference that an eye sees beside another, linear light


def run(bench: Bench) -> Iterator[Run]:
    """Show every scene, and hold it against the exact shapes where there are such."""
    for name in SCENES:
        bench.progress(f"the scene {name}")
        blank = Run("pictures", name, {"truth": "exact shapes"}, {}, "error")
        yield guarded(blank, partial(_seen, bench, blank, name))


def _seen(bench: Bench, blank: Run, name: str) -> Run:
    shown = srgb_bytes(read_exr(bench.render(name))["rgb"].astype(np.float64))
    scene = load_scene(bench.build / "scenes" / f"{name}.toml")
    fields = [EXACT.get(asset.grid.name) for asset in scene.assets]
    if not all(fields):
        return replace(blank, setup={"truth": "none"}, artefact=bench.store(f"pictures-{name}", image=shown))
    width, height = scene.film.size
    film = scene.film.model_copy(
        update={"size": (WIDTH, WIDTH * height // width), "supersample": 1, "outputs": ("rgb", "flags")}
    )
    small = scene.model_copy(update={"film": film})
    ours = render(small, engine="auto")
    truth = render(small, field=[ShapeField(shape(name)) for name in fields if name])
    error = np.abs(ours["rgb"] - truth["rgb"]).mean(axis=2)
    values = {
        "mean": float(error.mean()),
        "p99": float(np.quantile(error, 0.99)),
        "noted": float((error > NOTED).mean()),
        "flags": float((ours["flags"] != truth["flags"]).mean()),
        "pixels": float(error.size),
    }
    return replace(blank, values=values, artefact=bench.store(f"pictures-{name}", image=shown, error=error))
