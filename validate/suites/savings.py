"""What a scene leaves out, and what that saves: each planned, and with everything on, same rays.

In: build/grids/bunny@512.zarr.zip. Out: error runs (whether pictures are the same to the last bit, bytes and bricks
read and predicted, the share of the time that the plan predicts, and counts of work as proof that what is left out is
not done), and timed runs of both, engine by engine.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from sdfbake.gridfile import load_counted
from sdfrender import GridField
from sdfrender.forecast import forecast
from sdfrender.reach import Sight, frusta
from sdfrender.render import shoot
from sdfrender.scene import Scene
from sdfrender.similarity import IDENTITY
from sdfrender.stage import Stage, prepare
from validate.counters import Counters
from validate.experiment import Bench, Run, guarded, timed
from validate.timing import Timing, measure_in_turns

RESOLUTION = 64  # of the grid that is traced for the clock: both engines prepare it at once
LARGE = 512  # of the grid of which parts are read
SIZES = {"numpy": 256, "drjit": 512}  # of the picture; with fewer pixels, NumPy times its own calls
KINDS = ("planned", "everything")
FEW = 48  # pixels along a side where bits and work are compared
EVERYTHING = ("rgb", "Z", "P", "N", "curvature", "uv", "chart", "duv_dx", "duv_dy", "lod", "lod_invariant", "flags")
# Work that only what is left out takes.
IDLE = ("hessians", "channels")


@dataclass(frozen=True, slots=True)
class Case:
    """A scene: its outputs, where it is seen from, and of which grid."""

    outputs: tuple[str, ...]
    resolution: int
    away: float
    fov: float
    clocks: tuple[str, ...]  # the engines that it is timed on


FLAT, TENTH = "flat colours", "a tenth in sight"
CASES = {
    FLAT: Case(("rgb",), RESOLUTION, 2.6, 26.0, ("numpy", "drjit")),
    "distances alone": Case(("Z",), RESOLUTION, 2.6, 26.0, ("drjit",)),
    "normals": Case(("N", "Z"), RESOLUTION, 2.6, 26.0, ("drjit",)),
    TENTH: Case(("rgb",), LARGE, 2.6, 15.0, ()),
}


def run(bench: Bench) -> Iterator[Run]:
    """Compare, then time."""
    for name, case in CASES.items():
        bench.progress(f"what is saved: {name}")
        path = bench.grid("bunny", case.resolution)
        blank = Run("savings", name, {"engine": "numpy"}, {"resolution": case.resolution}, "error")
        yield guarded(blank, partial(_compared, blank, case, path))
        for engine, size in ((engine, SIZES[engine]) for engine in case.clocks if engine in SIZES):
            timings = cache(partial(_timings, case, path, engine, size))  # of both, had when the first is asked for
            for kind in KINDS:
                clock = replace(blank, kind="timing", setup={"engine": engine, "what": kind})
                yield guarded(clock, partial(_timed, clock, timings, size))


def scene(case: Case, grid: Path, size: int) -> Scene:
    """Look at the grid, along z, with a matt material in flat light."""
    low, high = load_counted(grid, {"distance"}, lambda _, bricks: np.zeros(len(bricks), bool))[0].lattice.bounds
    target = (low + high) / 2 + (high - low) * np.array([0.05, 0.1, 0.0])
    eye = target + np.array([0.0, 0.0, case.away * float((high - low).max()) / 2])
    return Scene.model_validate(
        {
            "camera": {"position": eye.tolist(), "target": target.tolist(), "fov": case.fov},
            "film": {"size": [size, size], "outputs": list(case.outputs)},
            "lights": [{"type": "directional", "direction": [0.3, -0.5, -1.0], "shadows": False}],
            "background": [0.1, 0.2, 0.3],
            "assets": [{"grid": grid, "materials": [{"type": "diffuse"}]}],
        }
    )


def in_sight(stage: Stage, grid: Path) -> float:
    """Return the share of a grid's bricks that some ray of the picture can come into."""
    whole = load_counted(grid, {"distance"})[0]
    sight = Sight.of(frusta(stage.view) or (), IDENTITY, whole.lattice, 0.0)
    return float(replace(sight, margin=0.0).meets(whole.bricks).mean())


def everything(made: Scene, stage: Stage) -> Stage:
    """Return the stage of the whole grid, with all outputs and all derivatives."""
    film = made.film.model_copy(update={"outputs": tuple(dict.fromkeys((*made.film.outputs, *EVERYTHING)))})
    grid, _ = load_counted(made.assets[0].grid)
    field = GridField(grid, engine=stage.choice)
    full = prepare(made.model_copy(update={"film": film}), field=field)
    orders = (2,) * len(full.plan.orders)
    return replace(full, plan=replace(full.plan, orders=orders, differentials=True, footprints=True, parts=True))


def _compared(blank: Run, case: Case, grid: Path) -> Run:
    made = scene(case, grid, FEW)
    stage = prepare(made, engine="numpy")
    (_, read), whole = stage.read[0], load_counted(grid)[1]
    values = {
        "bytes": float(read.bytes),
        "of_bytes": float(whole.bytes),
        "bricks": float(read.bricks),
        "of_bricks": float(whole.bricks),
        "in_sight": float(in_sight(stage, grid)),
        "left_out": float(len(stage.plan.left_out)),
        **_predicted(made, stage),
    }
    if case.clocks:  # a large grid takes its time on NumPy: there the part alone is loaded
        full = everything(made, stage)
        ours, theirs = shoot(stage), shoot(full)
        values["differing"] = float(sum(np.count_nonzero(ours[name] != theirs[name]) for name in ours))
        values |= {f"full.{name}": value for name, value in _work(full).items()}
    values |= {f"planned.{name}": value for name, value in _work(stage).items()}
    return replace(blank, values=values)


def _predicted(made: Scene, stage: Stage) -> dict[str, float]:
    """Return what the plan says before anything is loaded: bytes, bricks, and the shares of the tracing time."""
    found = forecast(made, stage.plan, stage.view)
    (grid,), total = found.grids, found.total
    engines = ("numpy", "drjit")
    shares = {engine: getattr(total.seconds, engine) / getattr(total.of_seconds, engine) for engine in engines}
    return {"said.bytes": float(grid.bytes), "said.bricks": float(grid.bricks or 0)} | {
        f"said.{engine}": share for engine, share in shares.items()
    }


def _work(stage: Stage) -> dict[str, float]:
    """Count what tracing takes per ray."""
    counters = Counters(stage.choice.engine.precision)
    field = counters.watch(stage.field)
    shoot(replace(stage, field=field, choice=replace(stage.choice, engine=field.engine)))
    return {name: count / FEW**2 for name, count in asdict(counters.work).items()}


def _timings(case: Case, grid: Path, engine: str, size: int) -> dict[str, Timing]:
    """Time both, in turns."""
    made = scene(case, grid, size)
    planned = prepare(made, engine=engine)
    stages = dict(zip(KINDS, (planned, everything(made, planned)), strict=True))
    return measure_in_turns({kind: partial(shoot, stage) for kind, stage in stages.items()}, repeats=3)


def _timed(blank: Run, timings: Callable[[], dict[str, Timing]], size: int) -> Run:
    return timed(blank.suite, blank.problem, blank.setup, blank.knob, timings()[blank.setup["what"]], rays=size**2)
