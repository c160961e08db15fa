"""Levels of grids chosen by footprint: what that is off by, and what it saves.

In: build/grids/levels-bunny@512.zarr.zip. Out: error runs (pictures by the share of a ray's width that voxels may have,
against the finest level or the exact shape, and against supersampled truths; bytes that are read), and timed runs, of
the same rays many times over, so that small pictures are not all overhead.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from datasets_synthetic import shape
from sdfbake.engine import Choice, choose
from sdfbake.grid import Grid
from sdfrender import GridField
from sdfrender.field import Field
from sdfrender.flags import Flag
from sdfrender.leveled import LeveledField
from sdfrender.levelreach import in_reach
from sdfrender.rays import COLUMNS, Rays
from sdfrender.render import render, shoot
from sdfrender.scene import Scene
from sdfrender.stage import Stage, prepare
from sdfrender.viewing import CameraView, GivenView
from validate.exact import ShapeField
from validate.experiment import Bench, Run, guarded, timed
from validate.flip import flip
from validate.metrics import Seen, image_mse, jacobian_error, lod_error, normal_angle
from validate.timing import measure

RESOLUTION = 512
SAMPLED = (112, 2)  # samples along the torus that is sampled here, and its levels
SIZES = (192, 96, 48)  # pixels along a side: the same view, seen from nearer or farther
SMALL = 32  # pixels along a side of the pictures of exact shapes
SHARES = (0.5, 1.0, 2.0, 4.0)
TRUTH = 5  # samples along either side of a pixel of the truth
RAYS = 1 << 17  # of a timed run
OUTPUTS = ("rgb", "Z", "N", "chart", "duv_dx", "duv_dy", "flags")
BUNNY, TORUS, BOUNCE, FAR = "bunny", "torus", "torus in a mirror", "bunny, 48 pixels"
FINEST, FOOTPRINT = "finest", "footprint"
_FOV, _AWAY = 30.0, 2.6
_PIXEL = 2 * np.tan(np.radians(_FOV) / 2)  # of the height of a picture, at unit distance


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A scene: what it is of, its surfaces level by level, what they are held against, whether rays go on."""

    name: str
    scene: Callable[[int], Scene]
    levels: Sequence[Sequence[GridField]]
    exact: Field | None = None
    direct: bool = True

    def fields(self, size: int, share: float | None) -> list[Field]:
        """Return the surfaces with levels chosen by a share of the width, those in reach; None for the finest."""
        if share is None:
            return [levels[0] for levels in self.levels]
        scene = self.scene(size)
        view = CameraView(scene.camera.camera(scene.film.size), 1, None)
        found: list[Field] = []
        for asset, levels in zip(scene.assets, self.levels, strict=True):
            lattice, most = levels[0].grid.lattice, len(levels) - 1
            chosen = in_reach(view, asset.placed(), lattice, most, direct=self.direct, share=share)
            members = levels[chosen.start : chosen.stop]
            found.append(members[0] if len(members) == 1 else LeveledField(members, share))
        return found


def run(bench: Bench) -> Iterator[Run]:
    """Compare, then time, scene by scene."""
    sizes, shares = (SIZES[-1:], SHARES[1:3]) if bench.quick else (SIZES, SHARES)
    bench.progress("levels by footprint: loading")
    path = bench.grid("levels-bunny", RESOLUTION)
    grid = Grid.load(path, {"distance", "face"})
    torus = _fields(Grid.from_function(shape("torus"), SAMPLED[0], levels=SAMPLED[1]), choose("numpy"))
    view, ring = partial(_scene, grid.lattice.bounds), partial(_scene, shape("torus").bounds)
    bunny = Case(BUNNY, view, [_fields(grid, choose("auto"))])
    for size in sizes:
        bench.progress(f"levels by footprint: {BUNNY}, {size} pixels")
        yield from _swept(bunny, size, shares)
    for case in (
        Case(TORUS, ring, [torus], ShapeField(shape("torus"))),
        Case(BOUNCE, _bounce, [torus, torus], direct=False),
    ):
        bench.progress(f"levels by footprint: {case.name}")
        yield from _swept(case, SMALL, shares, clock=False)
    bench.progress("levels by footprint: what is read")
    for what in (FINEST, FOOTPRINT):
        blank = Run("levels", FAR, {"levels": what}, {"pixels": float(sizes[-1])}, "error")
        load = partial(_loaded, view(sizes[-1]), path, what)
        yield guarded(blank, partial(_read, blank, load))
        clock = replace(blank, kind="timing")
        yield guarded(clock, partial(_clocked, clock, load))


def _fields(grid: Grid, choice: Choice) -> list[GridField]:
    fields = [GridField(level, engine=choice) for level in (grid, *grid.levels)]
    for field in fields:
        field.prepare_uv()
    return fields


def _scene(bounds: np.ndarray, size: int, assets: Sequence[dict[str, Any]] = ()) -> Scene:
    """Look at a box from the front, a little from above."""
    target, extent = bounds.mean(axis=0), float(np.ptp(bounds, axis=0).max())
    eye = target + _AWAY * extent * np.array([0.28, 0.3, 0.91])
    squares = {"type": "diffuse", "texture": "squares"}
    return Scene.model_validate(
        {
            "camera": {"position": eye.tolist(), "target": target.tolist(), "fov": _FOV},
            "film": {"size": [size, size], "outputs": list(OUTPUTS)},
            "trace": {"levels": FOOTPRINT, "bounces": 1},
            "lights": [{"type": "directional", "direction": [-0.3, -0.5, -1.0], "shadows": False}],
            "textures": [{"type": "checker", "name": "squares", "squares": [24, 24]}],
            "background": [0.1, 0.2, 0.3],
            "assets": list(assets) or [{"grid": "none", "materials": [squares]}],
        }
    )


def _bounce(size: int) -> Scene:
    """Look into a ring that is a mirror, at another one beside the camera."""
    turned = {"grid": "none", "rotate": [0, 1, 0, 40], "materials": [{"type": "mirror"}]}
    seen = {"grid": "none", "translate": [-1.5, 0.5, 4.5], "materials": [{"type": "diffuse", "texture": "squares"}]}
    return _scene(shape("torus").bounds, size, [turned, seen])


def _swept(case: Case, size: int, shares: Sequence[float], *, clock: bool = True) -> Iterator[Run]:
    """Compare and time all shares, the finest level first."""
    scene = case.scene(size)
    best = [case.exact] if case.exact is not None else case.fields(size, None)
    film = scene.film.model_copy(update={"supersample": TRUTH, "outputs": ("rgb",)})
    truth = render(scene.model_copy(update={"film": film}), field=best)["rgb"]
    reference = render(scene, field=best)
    for share in (None, *shares):
        setup = {"levels": FINEST if share is None else FOOTPRINT}
        blank = Run("levels", case.name, setup, {"pixels": float(size), "share": share or 0.0}, "error")
        fields = case.fields(size, share)
        yield guarded(blank, partial(_compared, blank, scene, fields, reference, truth))
        if clock:
            yield guarded(replace(blank, kind="timing"), partial(_timed, blank, scene, fields))


def _compared(
    blank: Run, scene: Scene, fields: Sequence[Field], reference: dict[str, np.ndarray], truth: np.ndarray
) -> Run:
    found = render(scene, field=list(fields))
    ours, theirs = _seen(found), _seen(reference)
    both = ours.hit & theirs.hit
    # Beside a seam, interpolated texture coordinates mean nothing on any level.
    seam = ((found["flags"].astype(int) | reference["flags"].astype(int)) & Flag.SEAM > 0).ravel()
    ended = both & (ours.chart >= 0) & (theirs.chart >= 0) & ~seam
    measured = {
        "hit": np.abs(ours.t[both] - theirs.t[both]) / (_PIXEL / scene.film.size[1] * theirs.t[both]),
        "normal": normal_angle(ours.at(both), theirs.at(both)),
        "jacobian": jacobian_error(ours.at(ended), theirs.at(ended)),
        "lod": lod_error(ours.at(ended), theirs.at(ended)),
    }
    values = {"missed": float((ours.hit != theirs.hit).sum() / max(theirs.hit.sum(), 1)), "hits": float(both.sum())}
    for name, errors in measured.items():
        if errors.size:
            values |= {f"{name}.p50": float(np.median(errors)), f"{name}.p95": float(np.percentile(errors, 95))}
    values["mse"] = float(image_mse(found["rgb"], truth).mean())
    values["flip"] = float(flip(found["rgb"], truth).mean())
    members = fields[0].members if isinstance(fields[0], LeveledField) else (fields[0],)
    voxels = [member.grid.lattice.spacing for member in members if isinstance(member, GridField)]
    pixel = _PIXEL / scene.film.size[1] * float(np.median(theirs.t[both]))
    return replace(blank, values=values | {"finest_px": min(voxels) / pixel, "coarsest_px": max(voxels) / pixel})


def _seen(found: dict[str, np.ndarray]) -> Seen:
    """Return what a picture says of its rays, a row each."""
    z = found["Z"].ravel()
    return Seen(
        t=np.where(z > 0, z, np.inf),
        n=found["N"].reshape(-1, 3),
        uv=np.zeros((z.size, 2)),
        jacobian=np.stack([found["duv_dx"].reshape(-1, 2), found["duv_dy"].reshape(-1, 2)], axis=2),
        chart=found["chart"].ravel().astype(np.int64),
    )


def _timed(blank: Run, scene: Scene, fields: Sequence[Field]) -> Run:
    """Time hits and normals of the picture's rays, over and over."""
    asset = scene.assets[0].model_copy(update={"materials": _NORMALS.assets[0].materials})
    film = scene.film.model_copy(update={"outputs": ("rgb",)})
    rays = scene.camera.camera(scene.film.size).rays()
    times = max(RAYS // len(rays), 1)
    many = Rays(*(np.tile(getattr(rays, name), (times, 1)) for name in COLUMNS))
    view = GivenView(many, (scene.film.size[0], scene.film.size[1] * times))
    stage = prepare(scene.model_copy(update={"film": film, "assets": (asset,)}), field=list(fields), view=view)
    setup = {**blank.setup, "engine": stage.choice.engine.name}
    return timed(blank.suite, blank.problem, setup, blank.knob, measure(partial(shoot, stage), repeats=3), len(many))


_NORMALS = _scene(np.array([[0.0] * 3, [1.0] * 3]), 1, [{"grid": "none", "materials": [{"type": "normals"}]}])


def _loaded(scene: Scene, grid: Path, levels: str) -> Stage:
    """Load what the scene needs of a grid's file."""
    asset = scene.assets[0].model_copy(update={"grid": grid})
    trace = scene.trace.model_copy(update={"levels": levels})
    return prepare(scene.model_copy(update={"assets": (asset,), "trace": trace}))


def _read(blank: Run, load: Callable[[], Stage]) -> Run:
    (_, read), *_ = load().read
    counted = {"bytes": read.bytes, "of_bytes": read.of_bytes, "bricks": read.bricks, "first": min(read.levels)}
    return replace(blank, values={name: float(value) for name, value in counted.items()})


def _clocked(blank: Run, load: Callable[[], Stage]) -> Run:
    return timed(blank.suite, blank.problem, blank.setup, blank.knob, measure(load, repeats=1, warm_up=0))
