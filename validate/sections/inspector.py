"""What the report shows of single footprints: an inspector of pixels, and ellipses on the texture."""

import base64
import json
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from validate import plots
from validate.experiment import Run
from validate.metrics import lod
from validate.plots import Ellipses
from validate.section import Inspector, Picture, Section, Table, number, pick

TITLE = "Footprints on the texture"
ASKED = (
    "What does a footprint look like? Pointing at a pixel of a picture shows where its ray meets the texture, and the "
    "ellipse that the pixel becomes there: by the grid, by ray differentials over the mesh as renderers have them "
    "(interpolated normals), and, where the shape is known in closed form, the truth. The lines in an ellipse are half "
    "a pixel step to the right and down. Arrow keys move by one pixel."
)
PICTURES = {
    "bunny": "The bunny, baked at 512³; primary rays.",
    "torus": "The torus, baked at 512³; primary rays.",
    "mirror": "The mirror sphere of Galim 2018, whose rays end on the page behind the camera; exact grid at 512³.",
}
# Colours of Okabe and Ito's palette, as in the plots; the truth is drawn last, dashed.
ROUTES = {
    "grid": ("signed distance grid", "#d55e00", ()),
    "mesh": ("mesh, by Embree", "#0072b2", ()),
    "exact": ("exact shape", "#111111", (5, 4)),
}
EVERY = 13  # of how many pixels along an axis one has its ellipses drawn on the texture
MAGNIFIED = 6.0


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = {run.problem: run for run in pick(runs)}
    shown = {name: _arrays(found[name]) for name in PICTURES if name in found}
    return Section(
        name="inspector",
        title=TITLE,
        asked=ASKED,
        finding=tuple(_sentence(found[name]) for name in shown) or ("No run succeeded.",),
        inspectors=tuple(_inspector(name, arrays) for name, arrays in shown.items()),
        pictures=tuple(_ellipses(name, arrays) for name, arrays in shown.items()),
        tables=(_table(found),) if found else (),
    )


def _arrays(run: Run) -> dict[str, np.ndarray]:
    with np.load(run.artefact, allow_pickle=False) as arrays:
        return dict(arrays)


def _sentence(run: Run) -> str:
    truth = run.setup["truth"]
    routes = [name for name in ROUTES if f"{name}.lod.p50" in run.values]
    words = " and ".join(
        f"the {ROUTES[name][0]} is off by {number(run.values[f'{name}.lod.p50'])} mip levels in the median and by "
        f"{number(run.values[f'{name}.lod.p95'])} at 95 %"
        for name in routes
    )
    what = PICTURES[run.problem].split(";")[0]
    return f"{what}: against the {truth}, {words}, over all {run.values['pixels']:,.0f} pixels."


def _routes(arrays: Mapping[str, np.ndarray]) -> list[str]:
    return [name for name in ROUTES if f"{name}_uv" in arrays]


def _inspector(name: str, arrays: dict[str, np.ndarray]) -> Inspector:
    hit = arrays["hit"]
    size = arrays["image"].shape[1]
    routes = [
        {
            "colour": ROUTES[route][1],
            "dash": ROUTES[route][2],
            "uv": _text(arrays[f"{route}_uv"].astype("<f4")),
            "jacobian": _text(arrays[f"{route}_jacobian"].astype("<f4")),
            "chart": _text(arrays[f"{route}_chart"].astype("<i4")),
        }
        for route in _routes(arrays)
    ]
    data = {
        "picture": plots.picture(arrays["image"]),
        "texture": plots.picture(arrays["texture"]),
        "size": size,
        "texels": arrays["texture"].shape[0],
        "hit": _text(hit.astype(np.uint8)),
        "start": _start(hit, size),
        "routes": routes,
    }
    legend = tuple((ROUTES[route][0], ROUTES[route][1]) for route in _routes(arrays))
    return Inspector(name, PICTURES[name], legend, json.dumps(data, sort_keys=True).replace("<", "\\u003c"))


def _start(hit: Bool[np.ndarray, " n"], size: int) -> list[int]:
    """The pixel that is shown first: of those hit one a little above the middle."""
    y, x = np.divmod(np.flatnonzero(hit), size)
    if len(x) == 0:
        return [0, 0]
    nearest = int(np.argmin((x - np.median(x)) ** 2 + (y - np.quantile(y, 0.35)) ** 2))
    return [int(x[nearest]), int(y[nearest])]


def _text(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _ellipses(name: str, arrays: dict[str, np.ndarray]) -> Picture:
    """Footprints of some pixels on the texture, one panel per route."""
    size = arrays["image"].shape[1]
    chosen = _sparse(arrays["hit"], size)
    panels = [
        Ellipses(
            f"{ROUTES[route][0]}",
            arrays["texture"],
            _on_texture(arrays[f"{route}_uv"][chosen]),
            arrays[f"{route}_jacobian"][chosen].reshape(-1, 2, 2),
            ROUTES[route][1],
        )
        for route in _routes(arrays)
    ]
    levels = lod(panels[0].jacobian.astype(np.float64))
    caption = (
        f"{PICTURES[name]} Footprints of every {EVERY}th pixel along both axes on the texture, {MAGNIFIED:g} times "
        f"their size; levels of detail from {levels.min():.1f} to {levels.max():.1f}."
    )
    return Picture(plots.ellipses(panels, MAGNIFIED), caption)


def _sparse(hit: Bool[np.ndarray, " n"], size: int) -> Int[np.ndarray, " m"]:
    """Among the pixels that are hit, those on every so many rows and columns."""
    y, x = np.divmod(np.flatnonzero(hit), size)
    return np.flatnonzero((x % EVERY == EVERY // 2) & (y % EVERY == EVERY // 2))


def _on_texture(uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    return np.asarray(uv - np.floor(uv), np.float32)


def _table(found: Mapping[str, Run]) -> Table:
    rows = []
    for name, run in found.items():
        for route in ROUTES:
            if f"{route}.lod.p50" in run.values:
                keys = [f"{route}.{metric}.{key}" for metric in ("jacobian", "lod") for key in ("p50", "p95", "p99")]
                rows.append((f"{name}: {ROUTES[route][0]}", *(number(run.values[key]) for key in keys)))
    header = ("Picture and route", "J error p50", "p95", "p99", "LoD error p50", "p95", "p99")
    return Table("Against the truth, over all pixels that every route hits.", header, tuple(rows))
