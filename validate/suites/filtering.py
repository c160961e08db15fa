"""What ray differentials buy: filters and samples per pixel against a supersampled truth, at equal time.

In: grids sampled from exact shapes, of the build where they are there, and the baked torus. Out: per scene, filter and
samples per pixel an error run, and for two scenes a timed run. Truth: the exact shapes in float64, bilinear look-ups of
the finest texels, two pictures with other places of their samples: the mean is the truth, and half of the difference is
its own remaining error.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from datasets_synthetic import save_texture, shape
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfrender import render
from sdfrender.flags import Flag
from sdfrender.image import srgb_bytes
from sdfrender.materials import Diffuse, ImageTexture, Material, Mirror
from sdfrender.render import shoot
from sdfrender.scene import Asset, Film, Pinhole, Scene, Trace
from sdfrender.stage import Stage, prepare
from sdfrender.viewing import CameraView
from validate.exact import ShapeField
from validate.experiment import Bench, Run, guarded, timed
from validate.flip import flip
from validate.metrics import FLICKER, IMAGE
from validate.shifted import EIGHT, FINE, STILL, ShiftedView, moved, parted
from validate.timing import measure

# Samples per pixel along an axis, by filter.
SAMPLES = {"point": (1, 2, 4, 8), "bilinear": (1, 2, 4, 8), "trilinear": (1, 2, 4), "anisotropic": (1, 2, 4)}
STEADY = 2  # samples along an axis up to which shifts are looked at: eight pictures each
SIZE = 96
HALF = 2  # samples per quarter pixel along an axis, in either half of the truth: 2 x 4 x 16 = 128 per pixel
# Paths of every timed picture, along a side, so that what does not grow with them weighs the same in all: 384 x 384
# pixels of one sample, 48 x 48 of 64.
SIDE = 384


@dataclass(frozen=True, slots=True)
class View:
    """A scene: which shape, on a grid of what resolution, and how its texture coordinates are read.

    Attributes
    ----------
    shape, resolution
        Exact shape, and samples along the longest side of its grid.
    camera, texture, materials
        Where the camera stands, the picture on the surface, and what the parts are made of.
    uv
        "grid" for grids sampled from the shape; "faces" for those baked from its mesh, where charts have seams.
    timed
        Whether the clock runs, too.
    """

    shape: str
    resolution: int
    camera: Pinhole
    texture: str
    materials: tuple[Material, ...]
    uv: Literal["grid", "faces"] = "grid"
    timed: bool = False


def _textured(part: str = "*") -> Diffuse:
    return Diffuse(type="diffuse", part=part, texture="texture")


# No rim of a sheet is seen from nearby: there a grid's texture coordinates are rounded with its edges, and that is
# nothing that a filter can mend.
VIEWS = {
    "text in a mirror sphere": View(
        "mirror",
        64,
        Pinhole(position=(0.0, 0.0, 1.9), target=(0.0, 0.0, 0.0), fov=18.0),
        "page",
        (Mirror(type="mirror", part="sphere", colour=(0.85, 0.9, 0.95)), _textured("sheet")),
        timed=True,
    ),
    "checker at a grazing angle": View(
        "sheet",
        128,
        Pinhole(position=(0.0, -0.95, 0.14), target=(0.0, -0.35, 0.0), up=(0.0, 0.0, 1.0), fov=45.0),
        "checker",
        (_textured(),),
        timed=True,
    ),
    "checkered torus": View(
        "torus",
        128,
        Pinhole(position=(0.0, 2.2, 2.6), target=(0.0, 0.0, 0.0), fov=36.0),
        "checker",
        (_textured(),),
        "faces",
    ),
    "text close up": View(
        "sheet",
        128,
        Pinhole(position=(-0.74, 0.44, 0.35), target=(-0.74, 0.44, 0.0), fov=20.0),
        "page",
        (_textured(),),
    ),
}


def run(bench: Bench) -> Iterator[Run]:
    """Scene by scene: the truth first, then each filter's errors and times."""
    names = [name for name in VIEWS if bench.only in (None, name, VIEWS[name].shape)]
    if not names:
        shapes = ", ".join(sorted({view.shape for view in VIEWS.values()}))
        raise BadInput(f"this suite does not look at '{bench.only}': choose one of {shapes}")
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            bench.progress(f"filters, {name}")
            yield from _compared(bench, Path(folder), name)


def _compared(bench: Bench, folder: Path, name: str) -> Iterator[Run]:
    size = 24 if bench.quick else SIZE
    scene = _scene(bench, folder, VIEWS[name], size)
    truth, record = _truth(bench, scene, VIEWS[name], name)
    yield record
    film = scene.film.model_copy(update={"outputs": ("part", "chart", "flags")})
    edges = _edges(render(scene.model_copy(update={"film": film})))
    for filtering, per_axis in SAMPLES.items():
        stage = prepare(_filtered(scene, filtering))
        for n in per_axis[:1] if bench.quick else per_axis:
            blank = Run("filtering", name, {"filter": filtering}, {"samples": n * n}, "error")
            yield guarded(blank, partial(_judged, bench, blank, stage, n, truth, edges))
            if VIEWS[name].timed:
                timing = replace(blank, kind="timing")
                yield guarded(timing, partial(_clocked, timing, stage, n, 64 if bench.quick else SIDE))


def _scene(bench: Bench, folder: Path, view: View, size: int) -> Scene:
    """The scene with its grid and its texture on disk."""
    image = folder / f"{view.texture}.png"
    if not image.exists():
        save_texture(view.texture, image)
    return Scene(
        camera=view.camera,
        film=Film(size=(size, size)),
        trace=Trace(bounces=1 if view.shape == "mirror" else 0),
        assets=(Asset(grid=_grid(bench, folder, view), uv=view.uv, materials=view.materials),),
        textures=(ImageTexture(name="texture", image=image, filter="bilinear", wrap="repeat"),),
        background=(0.18, 0.2, 0.24),
    )


def _grid(bench: Bench, folder: Path, view: View) -> Path:
    """The grid: of the build, or made here if it is of an exact shape."""
    if view.uv == "faces":
        return bench.grid(view.shape, view.resolution)
    found = bench.exact_grid(view.shape, view.resolution)
    if found is not None:
        return found
    path = folder / f"{view.shape}.zarr.zip"
    if not path.exists():
        Grid.from_function(shape(view.shape), view.resolution).save(path)
    return path


def _filtered(scene: Scene, filtering: str) -> Scene:
    textures = tuple(texture.model_copy(update={"filter": filtering}) for texture in scene.textures)
    return scene.model_copy(update={"textures": textures})


def _truth(bench: Bench, scene: Scene, view: View, name: str) -> tuple[Float[np.ndarray, "hf wf 3"], Run]:
    """Quarter pixels of the exact shape, and how far its two halves differ."""
    width, height = scene.film.size
    samples = 1 if bench.quick else HALF
    stage = prepare(scene, field=ShapeField(shape(view.shape)))
    camera = view.camera.camera((FINE * width, FINE * height))
    halves = [shoot(replace(stage, view=CameraView(camera, samples, seed)))["rgb"] for seed in (1, 2)]
    first, second = (moved(half, (0, 0)) for half in halves)
    whole = (halves[0] + halves[1]) / 2
    steps = np.stack([moved(whole, shift)[:-1, :-1] for shift in EIGHT])
    values = {
        # The mean of two independent halves is off by half as much as they differ.
        "rmse": float(np.sqrt(np.mean((first - second) ** 2)) / 2),
        "flip": float(flip(first, second).mean()),
        "change": float(np.sqrt(steps.var(axis=0).mean())),
    }
    artefact = bench.store(_file(name, "truth"), image=srgb_bytes(moved(whole, (0, 0))))
    blank = Run("filtering", name, {"filter": "truth"}, {"samples": 2 * (FINE * samples) ** 2}, "error")
    return whole, replace(blank, values=values, artefact=artefact)


def _judged(
    bench: Bench, blank: Run, stage: Stage, n: int, fine: Float[np.ndarray, "hf wf 3"], edges: Bool[np.ndarray, "h w"]
) -> Run:
    shifts = EIGHT if n <= STEADY else STILL
    view = ShiftedView(stage.scene.camera.camera(stage.scene.film.size), n, shifts)
    ours = parted(shoot(replace(stage, view=view))["rgb"], shifts)
    truth = moved(fine, (0, 0))
    values = {metric.name: float(metric.function(ours[0], truth)[0]) for metric in IMAGE}
    square = ((ours[0] - truth) ** 2).mean(axis=2)
    values |= {"rmse": float(np.sqrt(values["mse"])), "edges": float(edges.mean())}
    values |= {"edges.share": float(square[edges].sum() / max(square.sum(), 1e-30))}
    values |= {f"{where}.rmse": _root(square[among]) for where, among in (("edges", edges), ("inside", ~edges))}
    if shifts == EIGHT:
        steps = np.stack([moved(fine, shift) for shift in shifts])
        flicker = FLICKER.function(ours[:, :-1, :-1], steps[:, :-1, :-1])
        values["flicker"] = float(np.sqrt(np.mean(flicker**2)))
    error = flip(ours[0], truth).astype(np.float16)
    name = _file(blank.problem, blank.setup["filter"], f"{n * n}")
    return replace(blank, values=values, artefact=bench.store(name, image=srgb_bytes(ours[0]), flip=error))


def _clocked(blank: Run, stage: Stage, n: int, side: int) -> Run:
    """A picture of as many paths as all others; its seconds per pixel are what is compared."""
    size = (max(side // n, 1), max(side // n, 1))
    view = CameraView(stage.scene.camera.camera(size), n, None)
    ready = replace(stage, view=view)
    # One program serves all numbers of samples: the first has compiled it.
    taken = measure(lambda: shoot(ready), repeats=3, warm_up=1 if n == 1 else 0)
    record = timed(blank.suite, blank.problem, blank.setup, blank.knob, taken)
    return replace(record, values=record.values | {"us_per_pixel": taken.median * 1e6 / (size[0] * size[1])})


def _edges(seen: dict[str, np.ndarray]) -> Bool[np.ndarray, "h w"]:
    """Pixels beside which another part, or nothing, is seen: at once or at the end of the path."""
    miss = seen["flags"].astype(np.int64) & int(Flag.MISS)
    kind = np.concatenate([seen["part"], seen["chart"] >= 0, miss], axis=2)
    edges = np.zeros(kind.shape[:2], bool)
    right, below = (kind[:, 1:] != kind[:, :-1]).any(axis=2), (kind[1:] != kind[:-1]).any(axis=2)
    edges[:, 1:] |= right
    edges[:, :-1] |= right
    edges[1:] |= below
    edges[:-1] |= below
    return edges


def _root(square: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(square.mean())) if square.size else 0.0


def _file(*words: str) -> str:
    return "-".join(("filtering", *words)).replace(" ", "-")
