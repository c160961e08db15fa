"""The bricks of a grid as plain arrays, small enough for a GPU.

In: a grid and a precision. Out: `Packed`: arrays, what each means, and what rounding cost. The export `raw` writes them
as they are.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sdfbake.complaint import BadInput
from sdfbake.export.texture import textured
from sdfbake.grid import Grid

_FULL = 65535  # of 16 bits
_BRICKS = 1024  # packed together
_GREATEST = float(np.finfo(np.float16).max)


@dataclass(frozen=True, slots=True, eq=False)
class Packed:
    """Arrays of a grid, little-endian, C order: the last index runs fastest.

    Attributes
    ----------
    arrays
        By name.
    about
        What each is, in a sentence.
    scale
        World units per unit of `distance` and `far`.
    uv_offset, uv_scale
        Texture coordinates are uv_offset + uv_scale * uv; None without them.
    rounding
        Greatest difference between a packed and the stored distance, voxels: of all samples, and of those at corners
        of cells with surface.
    """

    arrays: Mapping[str, np.ndarray]
    about: Mapping[str, str]
    scale: float
    uv_offset: Float[np.ndarray, "2"] | None
    uv_scale: Float[np.ndarray, "2"] | None
    rounding: tuple[float, float]


_ABOUT = {
    "slot": "place of a brick in the arrays per sample, -1 where there is none; indexed by brick [x, y, z]",
    "far": "where there is no brick: signed lower bound of the distance from any point of its cells to the surface",
    "index": "brick [x, y, z] of every place; its first sample is 8 times that",
    "distance": "signed distance, negative inside; per brick, indexed [x, y, z]",
    "uv": "texture coordinates of the closest surface point, times uv_scale plus uv_offset",
    "chart": "chart of that point, -1 where none is known",
    "seam": "1 where the cell that begins at the sample touches several charts: do not interpolate uv in it",
    "part": "part of that point",
}


def packed(grid: Grid, precision: int = 16) -> Packed:
    """Pack a grid.

    Parameters
    ----------
    grid
        Any grid.
    precision
        16: distances in voxels as float16, bounds rounded towards zero, and texture coordinates as 16-bit integers
        over their range. 32: distances in world units and texture coordinates as float32, the stored bits.

    Raises
    ------
    BadInput
        If the precision is neither, or distances are beyond float16.
    """
    if precision not in (16, 32):
        raise BadInput(f"a precision of {precision} bits: give 16 or 32")
    scale = grid.lattice.spacing if precision == 16 else 1.0
    arrays: dict[str, np.ndarray] = {"slot": grid.bricks.slot, "index": grid.bricks.index}
    arrays["distance"], rounding = _distances(grid, precision)
    arrays["far"] = _bounds(grid, precision)
    offset = extent = None
    found = textured(grid)
    if found is not None:
        known = found.chart >= 0
        arrays["uv"], offset, extent = _coordinates(found.uv, known, precision)
        arrays |= {"chart": found.chart, "seam": found.seam.astype(np.uint8)}
    if grid.part is not None:
        arrays["part"] = grid.part
    order = [name for name in _ABOUT if name in arrays]
    little = {name: arrays[name].astype(arrays[name].dtype.newbyteorder("<"), copy=False) for name in order}
    return Packed(little, {name: _ABOUT[name] for name in order}, scale, offset, extent, rounding)


def _distances(grid: Grid, precision: int) -> tuple[np.ndarray, tuple[float, float]]:
    """Return the distances, and what rounding them cost."""
    if precision == 32:
        return grid.distance, (0.0, 0.0)
    rounded, worst = np.empty(grid.distance.shape, np.float16), [0.0, 0.0]
    for some in _pieces(len(rounded)):
        voxels = grid.distance[some] / np.float64(grid.lattice.spacing)
        if np.abs(voxels).max() > _GREATEST:
            raise BadInput("values of this grid are beyond 65504 voxels, which float16 cannot hold: use --precision 32")
        rounded[some] = voxels
        off = np.abs(rounded[some] - voxels)
        near = np.abs(voxels) <= 3**0.5  # a corner of a cell is at most its diagonal from surface in it
        worst = [max(worst[0], float(off.max())), max(worst[1], float(off.max(initial=0, where=near)))]
    return rounded, (worst[0], worst[1])


def _bounds(grid: Grid, precision: int) -> np.ndarray:
    """Return the bounds of absent bricks, in float16 none greater than it was."""
    if precision == 32:
        return grid.bricks.far
    voxels = np.clip(grid.bricks.far / np.float64(grid.lattice.spacing), -_GREATEST, _GREATEST)
    rounded = voxels.astype(np.float16)
    return np.where(np.abs(rounded) > np.abs(voxels), np.nextafter(rounded, np.float16(0)), rounded)


def _coordinates(
    uv: Float[np.ndarray, "k 8 8 8 2"], known: Bool[np.ndarray, "k 8 8 8"], precision: int
) -> tuple[np.ndarray, Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return texture coordinates as they are packed, offset and scale; 0 where none are known."""
    if precision == 32 or not known.any():
        return uv, np.zeros(2), np.ones(2)
    low, high = (np.array([pick(uv[..., axis][known]) for axis in (0, 1)], np.float64) for pick in (np.min, np.max))
    extent = np.maximum(high - low, np.finfo(np.float32).tiny)
    code = np.zeros(uv.shape, np.uint16)
    for some in _pieces(len(code)):
        found = np.rint((uv[some] - low) / extent * _FULL).clip(0, _FULL)
        code[some] = np.where(known[some][..., None], found, 0)
    return code, low, extent / _FULL


def _pieces(count: int) -> Iterator[slice]:
    """Cut rows of that many bricks, so that what is made of them in float64 stays small."""
    return (slice(start, start + _BRICKS) for start in range(0, count, _BRICKS))
