"""What a picture will read and take, against everything on: known before anything is loaded.

In: a scene and its plan. Out: a `Forecast`: per grid the bricks that rays can reach and the bytes that loading will
read, to the byte; the mip levels that footprints can reach; estimated seconds. Of the grids' files the heads and the
tables of bricks are read, of pictures their sizes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sdfbake.foretelling import Tables
from sdfbake.gridfile import head, nothing_read
from sdfbake.gridreading import together
from sdfbake.lattice import Lattice
from sdfbake.metadata import Metadata
from sdfrender.facts import IN_TEXELS, textures_of, used
from sdfrender.materials import ImageTexture, needs_footprint
from sdfrender.mips import grounds, levels_of
from sdfrender.omissions import tracing, with_levels
from sdfrender.picture import picture_size
from sdfrender.plan import forced_plan
from sdfrender.planned import AssetPlan, Levels, Plan
from sdfrender.scene import Scene
from sdfrender.sharing import Share, shares
from sdfrender.viewing import CameraView, View

_NANO = 1e-9


@dataclass(frozen=True, slots=True)
class GridForecast:
    """What will be read of a grid.

    Attributes
    ----------
    grid
        Its file.
    channels
        Those that are read.
    places, unseen
        How many assets it serves, and how many of these no ray can meet.
    opened
        Whether more than its head is read.
    reachable, bricks, of_bricks
        Bricks that rays can come into, that are read with them, and that there are; None where the file is not there.
    bytes, of_bytes
        Bytes that are read of the file, and its size.
    """

    grid: str
    channels: tuple[str, ...]
    places: int
    unseen: int
    opened: bool
    reachable: int | None
    bricks: int | None
    of_bricks: int | None
    bytes: int
    of_bytes: int


@dataclass(frozen=True, slots=True)
class Seconds:
    """An estimate, by engine."""

    numpy: float
    drjit: float


@dataclass(frozen=True, slots=True)
class Total:
    """All of it: as planned, and with everything on.

    Attributes
    ----------
    bytes, of_bytes
        Of grids and pictures.
    seconds, of_seconds
        Estimates of tracing, see `sdfrender.costs`: for paths that hit at every turn.
    """

    bytes: int
    of_bytes: int
    seconds: Seconds
    of_seconds: Seconds


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a picture will take: its plan, with the mip levels; what of every grid; and in total."""

    plan: Plan
    grids: tuple[GridForecast, ...]
    total: Total

    def record(self) -> dict[str, Any]:
        """Return the plan and its forecast as plain data."""
        return {**self.plan.record(), "grids": [asdict(grid) for grid in self.grids], "total": asdict(self.total)}


def forecast(scene: Scene, plan: Plan, view: View | None = None) -> Forecast:
    """Look at what a plan reaches.

    Parameters
    ----------
    scene, plan
        A scene and its plan. Grids and pictures that do not exist yet count for nothing.
    view
        Where rays come from, in place of the scene's camera.

    Raises
    ------
    BadInput
        If a grid's file is broken.
    """
    scene = scene.plain()
    view = view or CameraView(scene.camera.camera(scene.film.size), scene.film.supersample, scene.film.seed)
    files = dict.fromkeys(asset.grid for asset in plan.assets if Path(asset.grid).is_file())
    heads = {grid: head(grid) for grid in files}
    told = [heads[asset.grid] for asset in plan.assets if asset.grid in heads]
    if len(told) == len(plan.assets):
        found = shares(scene, plan, view, [lattice for lattice, _ in told])
        grids = [_of_grid(share, heads[share.needs.grid]) for share in found]
        plan = with_levels(plan, _levels(scene, plan, view, told))
    else:  # how large the scene is, and so what is in sight, is not known
        grids = [_of_whole(asset, asset.grid in files) for asset in dict.fromkeys(plan.assets)]
    total = _total(scene, plan, view, grids, [heads.get(asset.grid) for asset in plan.assets])
    return Forecast(plan, tuple(grids), total)


def _of_grid(share: Share, told: tuple[Lattice, Metadata]) -> GridForecast:
    """Say what is read of a grid, as `sdfrender.stage` will read it."""
    needs, met = share.needs, share.met(told[0])
    unseen, tables = len(met) - sum(met), [Tables.of(needs.grid, level) for level in share.levels]
    if not any(met):
        nothing, count = nothing_read(needs.grid), sum(len(each.bricks) for each in tables)
        return GridForecast(needs.grid, (), len(met), unseen, False, 0, 0, count, nothing.bytes, nothing.of_bytes)
    whole = share.is_whole(told[1])
    read = together(
        [each.foretell(needs.channels, None if whole else share.wanted(each.bricks, each.level)) for each in tables]
    )
    return GridForecast(
        grid=needs.grid,
        channels=read.channels,
        places=len(met),
        unseen=unseen,
        opened=True,
        reachable=sum(int(share.reachable(each.bricks, each.level).sum()) for each in tables),
        bricks=read.bricks,
        of_bricks=read.of_bricks,
        bytes=read.bytes,
        of_bytes=read.of_bytes,
    )


def _of_whole(asset: AssetPlan, exists: bool) -> GridForecast:
    """Say what is read at most of a grid, beside others that do not exist yet; or that it does not."""
    if not exists:
        return GridForecast(asset.grid, (), 1, 0, False, None, None, None, 0, 0)
    read = Tables.of(asset.grid).foretell(asset.channels)
    count = read.of_bricks
    return GridForecast(asset.grid, read.channels, 1, 0, True, count, count, count, read.bytes, read.of_bytes)


def _levels(
    scene: Scene,
    plan: Plan,
    view: View,
    told: Sequence[tuple[Lattice, Metadata]],
) -> list[Levels]:
    """Return the mip levels that footprints can reach, of pictures that exist."""
    if not plan.uv or not set(plan.outputs) & {"rgb", *IN_TEXELS}:
        return []
    known = grounds(scene, plan, view, told, lambda place: Tables.of(plan.assets[place].grid).bricks)
    images = (texture for texture in scene.textures if isinstance(texture, ImageTexture))
    return [
        levels_of(scene, plan, view, known, image, picture_size(image.image))
        for image in images
        if image.name in textures_of(scene) and needs_footprint(image) and image.image.is_file()
    ]


def _total(
    scene: Scene,
    plan: Plan,
    view: View,
    grids: Sequence[GridForecast],
    heads: Sequence[tuple[Lattice, Metadata] | None],
) -> Total:
    """Add up files, and pixels times what a path takes."""
    bare = used(scene, [known and known[1].parts for known in heads])
    everything = forced_plan(bare, plan, [known[1].uv_modes if known else () for known in heads])
    pictures = [texture.image for texture in scene.textures if isinstance(texture, ImageTexture)]
    pictures += [scene.environment.image] if scene.environment else []
    there = sum({grid.grid: grid.of_bytes for grid in grids}.values()) + _size(pictures)
    read = sum(grid.bytes for grid in grids) + _size(_looked_at(bare, plan))
    return Total(read, there, *(_seconds(bare, each, view) for each in (plan, everything)))


def _looked_at(bare: Scene, plan: Plan) -> list[Path]:
    """Return the pictures that are read."""
    outputs = set(plan.outputs)
    textures = [bare.texture(name) for name in textures_of(bare)] if outputs & {"rgb", *IN_TEXELS} else []
    around = [bare.environment.image] if bare.environment and "rgb" in outputs else []
    return [texture.image for texture in textures if isinstance(texture, ImageTexture)] + around


def _size(paths: Iterable[Path]) -> int:
    return sum(path.stat().st_size for path in dict.fromkeys(paths) if path.is_file())


def _seconds(bare: Scene, plan: Plan, view: View) -> Seconds:
    """Return what tracing takes, if every path hits something at every turn and parts wherever it may."""
    width, height = view.size
    paths = width * height * (view.samples if "rgb" in plan.outputs else 1) * 2**plan.splits
    cost = tracing(bare, plan)
    return Seconds(numpy=_NANO * cost.numpy * paths, drjit=_NANO * cost.drjit * paths)
