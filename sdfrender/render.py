"""The picture of a scene: passes over its pixels, and the ways that light takes at glass.

In: a scene. Out: arrays (h, w, channels) per output. `rgb` is the mean over samples and the sum over ways at glass;
everything else is of one sample, of the path that passes glass wherever it can: `Z`, `P`, `N`, `curvature` and `part`
speak of its first hit, `flags` of all its hits, the rest of its end.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from sdfbake.engine import Array, Engine
from sdfrender.field import Field
from sdfrender.footprint import nonlinear, nonlinearity
from sdfrender.image import CHANNELS
from sdfrender.path import Job, follow
from sdfrender.scene import Scene
from sdfrender.stage import Stage, prepare
from sdfrender.viewing import View

COLOURS = ("R", "G", "B")
BATCH = 2**20  # paths at once at most: some 300 bytes each are alive between two hits
# What is recorded for outputs that are computed from others.
_FROM = {"nonlinearity": ("duv_dx", "duv_dy", "chart")}

Arrays = dict[str, np.ndarray]
Pixels = Int[np.ndarray, " n"]


def render(
    scene: Scene | str | Path,
    *,
    engine: str = "auto",
    precision: int | None = None,
    field: Field | Sequence[Field] | None = None,
    view: View | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, np.ndarray]:
    """Render a scene.

    Parameters
    ----------
    scene
        A scene, or its file.
    engine, precision
        As for `sdfbake.engine.choose`; not used where a field is given.
    field
        Surfaces to take in place of the scene's grids, such as exact shapes, one for each asset.
    view
        Where rays come from, in place of the scene's camera.
    progress
        Called with the steps done and to do.

    Returns
    -------
    dict
        Float arrays (h, w, channels) by output name; see `sdfrender.image.CHANNELS`.

    Raises
    ------
    BadInput
        If an asset, a part, a channel or a texture that the scene needs is missing.
    """
    return shoot(prepare(scene, engine=engine, precision=precision, field=field, view=view), progress)


def shoot(stage: Stage, progress: Callable[[int, int], None] | None = None) -> dict[str, np.ndarray]:
    """Trace all pixels of a prepared scene: one pass per sample, colours averaged.

    What is not a colour comes from the sample in the middle (or next to it), per pixel.
    """
    recorded, coloured = _recorded(stage.plan.outputs), frozenset({"rgb"}) & set(stage.plan.outputs)
    middle, samples = stage.view.middle, stage.view.samples
    width, height = stage.view.size
    count = width * height
    alone = [middle] if recorded - coloured or samples == 1 else []  # of which everything is recorded
    others = [number for number in range(samples) if number not in alone]
    jobs = [job for job in ((recorded, alone), (coloured, others)) if all(job)]
    batch = max(BATCH >> stage.plan.splits, 1)  # of which each may become as many as there are codes
    steps = _Steps(progress, sum(-(-count * len(numbers) // batch) for _, numbers in jobs))
    total, kept = np.zeros((3, count)), {}
    for outputs, numbers in jobs:
        out = _sampled(stage, outputs, _Batches(numbers, count, batch), steps)
        if coloured:
            total += [out.pop(name) / samples for name in COLOURS]
        kept.update(out)
    kept.update(zip(COLOURS, total, strict=True))
    images = {name: _image(kept, name, width, height) for name in recorded}
    if "nonlinearity" in stage.plan.outputs:
        images |= _compared(images)
    return {name: images[name] for name in stage.plan.outputs}


@dataclass(slots=True)
class _Steps:
    """Steps done and to do, told to a listener."""

    listener: Callable[[int, int], None] | None
    total: int
    done: int = 0

    def next(self) -> None:
        """Begin a step."""
        if self.listener is not None:
            self.listener(self.done, self.total)
        self.done += 1


@dataclass(frozen=True, slots=True, eq=False)
class _Lanes:
    """Paths to trace: the sample, its pixel, the code of its ways at glass."""

    sample: Pixels
    pixel: Pixels
    code: Pixels

    def __getitem__(self, which: slice | np.ndarray) -> "_Lanes":
        return _Lanes(self.sample[which], self.pixel[which], self.code[which])


@dataclass(frozen=True, slots=True, eq=False)
class _Batches:
    """Samples of `count` pixels each, by sample, then pixel, `size` at a time."""

    samples: list[int]
    count: int
    size: int

    def __iter__(self) -> Iterator[_Lanes]:
        end = self.count * len(self.samples)
        for begin in range(0, end, self.size):
            number = np.arange(begin, min(begin + self.size, end))
            sample = np.array(self.samples, np.int32)[number // self.count]
            pixel = (number % self.count).astype(np.int32)
            yield _Lanes(sample, pixel, np.zeros(len(pixel), np.int32))


def _recorded(outputs: tuple[str, ...]) -> frozenset[str]:
    """Return the outputs that paths record, those among them that others are computed from."""
    return frozenset(name for output in outputs for name in _FROM.get(output, (output,)))


def _image(kept: Arrays, name: str, width: int, height: int) -> Float[np.ndarray, "h w c"]:
    channels, _ = CHANNELS[name]
    return np.stack([kept[channel].astype(np.float64).reshape(height, width) for channel in channels], axis=-1)


def _compared(images: Arrays) -> Arrays:
    """Return how linear footprints are, and the flags with NONLINEAR."""
    jacobian = np.stack([images["duv_dx"], images["duv_dy"]], axis=-1)
    chart = images["chart"][..., 0].astype(np.int64)
    share = nonlinearity(jacobian, chart >= 0, chart)
    found = {"nonlinearity": share[..., None]}
    if "flags" in images:
        flags = images["flags"].astype(np.int64) | nonlinear(share)[..., None]
        found["flags"] = flags.astype(np.float64)
    return found


def _sampled(stage: Stage, outputs: frozenset[str], batches: _Batches, steps: _Steps) -> Arrays:
    """Trace samples of all pixels, along all ways at glass that the plan follows.

    Colours are summed as they come, so that memory does not grow with the samples; of the rest there is one sample.
    """
    within = stage.within() if stage.bodies is not None else None
    kept: Arrays = {}
    for lanes in batches:
        steps.next()
        for name, values in _branched(stage, outputs, lanes, within).items():
            if name in COLOURS:
                kept[name] = kept.get(name, 0.0) + np.bincount(lanes.pixel, values, batches.count)
            else:
                kept.setdefault(name, np.empty(batches.count, values.dtype))[lanes.pixel] = values
    return kept


def _branched(stage: Stage, outputs: frozenset[str], lanes: _Lanes, within: Pixels | None) -> Arrays:
    """Trace paths, and those that part from them at glass: of a round those that are mirrored at its surface last."""
    out = _traced(stage, outputs, lanes, within)
    if not (stage.plan.splits and "rgb" in outputs):
        return out
    splits, place = out.pop("splits"), np.arange(len(lanes.pixel))
    for level in range(stage.plan.splits):
        parting = splits > level  # the others have no such way
        if not parting.any():
            break
        branches = lanes[parting]
        branches = replace(branches, code=branches.code | np.int32(1 << level))
        part = _traced(stage, frozenset({"rgb"}), branches, within)
        for name in COLOURS:
            np.add.at(out[name], place[parting], part[name])
        lanes = _Lanes(*(np.concatenate(pair) for pair in zip(_parts(lanes), _parts(branches), strict=True)))
        splits, place = np.concatenate([splits, part["splits"]]), np.concatenate([place, place[parting]])
    return out


def _parts(lanes: _Lanes) -> tuple[Pixels, Pixels, Pixels]:
    return lanes.sample, lanes.pixel, lanes.code


def _traced(stage: Stage, outputs: frozenset[str], lanes: _Lanes, within: Pixels | None) -> Arrays:
    """Trace paths."""
    channels = tuple(name for output in sorted(outputs - {"rgb", "flags"}) for name in CHANNELS[output][0])

    def program(xp: Engine, code: Array, inside: Array, *columns: Array) -> dict[str, Array]:
        start = stage.view.start(xp, stage.field, columns)
        return follow(xp, Job(stage, outputs, channels), start, code, None if within is None else inside)

    given = stage.view.columns(stage.field, lanes.sample, lanes.pixel)
    bodies = np.zeros(len(lanes.pixel), np.int32)
    if within is not None:
        bodies += within[lanes.pixel] if len(within) > 1 else within
    return stage.choice.engine.run(program, [lanes.code, bodies, *given])
