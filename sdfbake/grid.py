"""The grid asset in memory: bricks of exact distances around a surface, with what else is known there.

In: an exact shape, a dense array, or what a bake computed. Out: a frozen `Grid`.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy.typing import ArrayLike

from sdfbake import bricks as brick
from sdfbake.bricks import SIDE, Bricks
from sdfbake.complaint import BadInput
from sdfbake.dense import needed
from sdfbake.faces import FaceTable
from sdfbake.lattice import BAND, Lattice
from sdfbake.layers import Layers
from sdfbake.mesh import Mesh
from sdfbake.metadata import Metadata
from sdfbake.shape import Charted, Shape

# Channels of a grid: numbers per sample and how they are stored.
CHANNELS: dict[str, tuple[tuple[int, ...], str]] = {
    "distance": ((), "<f4"),
    "uv": ((2,), "<f4"),
    "chart": ((), "<i4"),
    "part": ((), "|u1"),
    "face": ((), "<i4"),
}
KERNELS = ("linear", "catmull-rom", "bspline")  # the columns of a grid's error


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Sparse signed distances with texture coordinates, chart and part of the closest surface point.

    Attributes
    ----------
    lattice
        Where the samples lie.
    bricks
        Which bricks exist, in the order of the channels' first axis.
    distance
        Signed distance, negative inside, float32, world units; exact to its rounding where it is at most `BAND`
        voxels. Samples of a brick beyond the lattice are 0 and never used, in every channel.
    uv
        Texture coordinates of the closest surface point, float32; None where they were not asked for.
    chart, part
        Chart (int32) and part (uint8) of that point; None where there is only one, or it was not asked for. These
        three are 0 at samples more than `REACH` voxels from the surface.
    metadata
        Where all this comes from.
    face
        Row of `surface` that is closest, int32, the lowest of those equally near; -1 at samples more than `REACH`
        voxels from the surface. None where it was not asked for.
    surface
        The faces; there if `face` is.
    layers
        Texture coordinates chart by chart; None where they were not asked for.
    error
        Per brick, for each of `KERNELS`, the greatest difference between the interpolated and the exact distance at
        two places of one in eight cells with surface, voxels, float32; 0 where the brick has none of those. None where
        there is
        nothing to compare with.
    levels
        The same surface on coarser lattices, each of every second node of the one before, with bands of their own
        voxels: values at nodes that levels share are the same, bit for bit.
    """

    lattice: Lattice
    bricks: Bricks
    distance: Float[np.ndarray, "k 8 8 8"]
    uv: Float[np.ndarray, "k 8 8 8 2"] | None
    chart: Integer[np.ndarray, "k 8 8 8"] | None
    part: Integer[np.ndarray, "k 8 8 8"] | None
    metadata: Metadata
    face: Integer[np.ndarray, "k 8 8 8"] | None = None
    surface: FaceTable | None = None
    layers: Layers | None = None
    error: Float[np.ndarray, "k 3"] | None = None
    levels: tuple["Grid", ...] = ()

    def __post_init__(self) -> None:
        if self.bricks.slot.shape != brick.counts(self.lattice.shape):
            raise ValueError(f"a brick table of {self.bricks.slot.shape} for a lattice of {self.lattice.shape}")
        for name, (width, kind) in CHANNELS.items():
            values, shape = getattr(self, name), (len(self.bricks), SIDE, SIDE, SIDE, *width)
            if values is not None and (values.shape != shape or values.dtype != np.dtype(kind)):
                raise ValueError(f"{name} is {values.dtype}{values.shape}, expected {kind}{shape}")
        if (self.face is None) != (self.surface is None):
            raise ValueError("face ids and the table of faces come together")
        lattice = self.lattice
        for level in self.levels:
            lattice = lattice.coarser()
            if not level.lattice.is_same(lattice) or level.levels:
                raise ValueError("a level does not lie on every second node of the one before, or has levels itself")

    @staticmethod
    def from_function(
        shape: Shape,
        resolution: int | None = None,
        *,
        uv_mode: str = "grid",
        lattice: Lattice | None = None,
        cube: bool = False,
        levels: int = 0,
    ) -> "Grid":
        """Sample an exact shape sparsely.

        Parameters
        ----------
        shape
            Exact distance and texture coordinates; 1-Lipschitz. Charts and parts too, where it is `Charted`.
        resolution
            Samples along the longest axis; not used where a lattice is given.
        uv_mode
            "grid" or "none".
        lattice
            Where to sample; by default the shape's bounds and the band.
        cube
            Give every axis the same number of samples.
        levels
            As many coarser ones; a lattice that is given must have room for them (`Lattice.around`).

        Raises
        ------
        BadInput
            For a resolution outside 16..8192, an unknown mode, too many levels, or a shape that answers with NaN or
            infinity.
        """
        if uv_mode not in ("none", "grid"):
            raise BadInput(f"uv_mode {uv_mode!r} is not available for exact shapes: use 'none' or 'grid'")
        if lattice is None:
            if resolution is None:
                raise BadInput("neither a resolution nor a lattice was given: give one, such as resolution=64")
            lattice = Lattice.around(shape.bounds, resolution, cube=cube, levels=levels)
        options: dict[str, str | int | float | bool | None] = {"resolution": max(lattice.shape), "cube": cube}
        if levels:
            options |= {"resolution": resolution, "levels": levels}
        finest = _from_function(shape, lattice, uv_mode, options)
        coarser = []
        for _ in range(levels):
            lattice = lattice.coarser()
            coarser.append(_from_function(shape, lattice, uv_mode, options))
        return replace(finest, levels=tuple(coarser))

    @staticmethod
    def from_dense(
        values: ArrayLike,
        *,
        origin: Sequence[float | int] | np.ndarray = (0.0, 0.0, 0.0),
        spacing: float | int = 1.0,
        band: float | None = None,
    ) -> "Grid":
        """Take anybody's numbers, not necessarily distances.

        Parameters
        ----------
        values
            (nx, ny, nz), indexed [x, y, z], at least 2 along every axis, finite; stored as float32.
        origin, spacing
            World position of values[0, 0, 0], and the distance between neighbours.
        band
            Voxels from the surface within which the values are exact; hits on cells that see others are flagged BAND.
            None claims nothing, and nothing is flagged.

        Returns
        -------
        Grid
            With all bricks that any kernel needs to find every root; equal to `values` there.

        Raises
        ------
        BadInput
            If the array is not three-dimensional, too small, or not finite, or the band is not positive.
        """
        if band is not None and not band > 0:
            raise BadInput(f"a band of {band} voxels is none: give a positive number, or leave it out")
        given = np.asarray(values)
        if given.ndim != 3 or min(given.shape) < 2 or given.dtype.kind not in "fiu":
            raise BadInput(
                f"an array of shape {given.shape} and type {given.dtype} is no grid: give numbers (nx, ny, nz), each "
                "axis at least 2"
            )
        with np.errstate(over="ignore"):  # what float32 cannot hold is refused just below
            dense = given.astype(np.float32)
        if not np.isfinite(dense).all():
            raise BadInput(
                f"{np.count_nonzero(~np.isfinite(dense))} values of the array are NaN, infinite or beyond float32: "
                "replace them by finite numbers"
            )
        lattice = Lattice(np.asarray(origin, np.float64), float(spacing), dense.shape)
        bricks = needed(dense)
        distance = _blank(len(bricks), "distance")
        inside = brick.in_lattice(bricks.index, dense.shape)
        distance[inside] = dense[tuple(brick.sample_index(bricks.index)[inside].T)]
        return Grid(lattice, bricks, distance, None, None, None, Metadata(source="dense", band=band or BAND))

    def save(self, path: str | Path) -> None:
        """Write the grid to a file, whole or not at all; see `sdfbake.gridfile.save`."""
        from sdfbake.gridfile import save  # the file imports Grid, so Grid meets it only here

        save(self, path)

    @staticmethod
    def load(
        path: str | Path,
        channels: Collection[str] | None = None,
        bricks: Callable[[Lattice, Bricks], Bool[np.ndarray, " k"]] | None = None,
        *,
        levels: bool = True,
    ) -> "Grid":
        """Read a grid, or only some of its channels and bricks, without its levels; see `sdfbake.gridfile.load`."""
        from sdfbake.gridfile import load

        return load(path, channels, bricks, levels=levels)

    def to_dense(
        self, exact: Mesh | bool = False, progress: Callable[[str, float], None] | None = None
    ) -> Float[np.ndarray, "nx ny nz"]:
        """Return all samples as one float32 array, bounds or exact beyond the band; see `sdfbake.densify.dense`."""
        from sdfbake.densify import dense  # it imports Grid, so Grid meets it only here

        return dense(self, exact, progress)

    def samples(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
        """Return the samples of the exact band.

        Returns
        -------
        points, distance
            World positions, float64, and stored distances, float32, of all samples of the lattice that lie in a brick
            and at most `BAND` voxels from the surface.
        """
        near = np.abs(self.distance) <= BAND * self.lattice.spacing
        near &= brick.in_lattice(self.bricks.index, self.lattice.shape)
        slot, i, j, k = np.nonzero(near)
        at = self.bricks.index[slot].astype(np.int64) * SIDE + np.stack([i, j, k], axis=-1)
        return self.lattice.to_world(at), self.distance[near]


def _from_function(
    shape: Shape, lattice: Lattice, uv_mode: str, options: dict[str, str | int | float | bool | None]
) -> Grid:
    """Sample an exact shape on one lattice."""
    found = brick.candidates(lattice, shape.distance)
    values = brick.sampled(lattice, found[0], shape.distance, _blank(len(found[0]), "distance"))
    if not np.isfinite(values).all():
        raise BadInput("the shape's distance is NaN or infinite at some samples: it must be finite everywhere")
    bricks, kept = brick.settle(lattice, found, values)
    near = np.abs(values[kept]) <= brick.REACH * lattice.spacing
    channels = _surface_channels(shape, lattice, bricks, near) if uv_mode == "grid" else {}
    part = _part_channel(shape, lattice, bricks, near)
    chart = channels.get("chart")
    metadata = Metadata(
        source="function",
        parts=shape.part_names if isinstance(shape, Charted) else ("surface",),
        charts=0 if uv_mode == "none" else 1 if chart is None else int(chart.max(initial=0)) + 1,
        uv_modes=("grid",) if uv_mode == "grid" else (),
        options=options,
    )
    return Grid(lattice, bricks, values[kept], channels.get("uv"), chart, part, metadata)


def _blank(count: int, channel: str) -> np.ndarray:
    """Return a channel of zeros for that many bricks."""
    width, kind = CHANNELS[channel]
    return np.zeros((count, SIDE, SIDE, SIDE, *width), kind)


def _surface_channels(
    shape: Shape, lattice: Lattice, bricks: Bricks, near: Bool[np.ndarray, "k 8 8 8"]
) -> dict[str, np.ndarray]:
    """Sample texture coordinates and, where there are any, charts, at the samples near the surface."""
    channels = {"uv": brick.sampled(lattice, bricks.index, shape.uv, _blank(len(bricks), "uv"), near)}
    if not np.isfinite(channels["uv"]).all():
        raise BadInput("the shape's uv is NaN or infinite at some samples: it must be finite near the surface")
    if isinstance(shape, Charted):
        channels["chart"] = brick.sampled(lattice, bricks.index, shape.chart, _blank(len(bricks), "chart"), near)
    return channels


def _part_channel(
    shape: Shape, lattice: Lattice, bricks: Bricks, near: Bool[np.ndarray, "k 8 8 8"]
) -> Integer[np.ndarray, "k 8 8 8"] | None:
    """Sample part ids where there are several parts."""
    if not isinstance(shape, Charted) or len(shape.part_names) < 2:
        return None
    if len(shape.part_names) > 256:
        raise BadInput(f"the shape has {len(shape.part_names)} parts: a grid stores at most 256")
    return brick.sampled(lattice, bricks.index, shape.part, _blank(len(bricks), "part"), near)
