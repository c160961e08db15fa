"""What of a grid goes into the page: compact arrays, deflated.

In: a grid. Out: `Packed`: float16 distances in voxels and, at the samples around surface, texture coordinates in 16
bits over their range and charts; per cell and per brick how far the next surface is at least; a head that says what the
numbers mean. Bytes of 16-bit numbers are parted into low and high ones, which deflate better alone.
"""

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake.bricks import SIDE
from sdfbake.complaint import BadInput
from sdfbake.export.texture import textured
from sdfbake.grid import Grid
from sdfbake.view.cells import brick_gaps, gaps

MOST_BRICKS = 30_000  # a page of some 30 MB; on the graphics card 300 MB, and 160 more when kernels are changed
FULL = 65535  # of 16 bits
PRESENT = 1 << 24  # in the table of bricks: the rest is a slot; without, a gap
_REACH = 2.0  # voxels: the corners of cells with surface are at most sqrt 3 from it
# Numbers that are no distances are brought to this magnitude: float16 has its full precision for a millionth of it.
_LARGEST = 1024.0


@dataclass(frozen=True, slots=True)
class Packed:
    """A grid for the page.

    Attributes
    ----------
    head
        JSON: `origin`, `spacing` (world), `shape` (samples), `table` (bricks by axis), `bricks`, `centre` and
        `radius` of the surface (world), `offset` and `scale` of the texture coordinates and the greatest `jump` of them
        in a cell (None without), `charts`, `units`.
    arrays
        Deflated (zlib) and in base64, by name; C order, [x, y, z]. `table`: int32 per brick of the lattice, `PRESENT`
        plus the slot, or the gap. `gap`: uint8 per cell of the bricks. `distance`: float16, voxels. `uv`: uint16, all
        u, then all v. `chart`: uint16, the chart plus one, 0 for none. Of uint16, all low bytes, then all high ones.
    """

    head: dict[str, Any]
    arrays: dict[str, str]

    @property
    def size(self) -> int:
        """Characters of all arrays."""
        return sum(map(len, self.arrays.values()))


def pack(grid: Grid) -> Packed:
    """Pack a grid.

    Raises
    ------
    BadInput
        If it has too many bricks for a page, or no surface.
    """
    count = len(grid.bricks)
    if count > MOST_BRICKS:
        raise BadInput(
            f"the grid has {count} bricks of 8^3 samples, and a page can hold {MOST_BRICKS}: bake it at a resolution "
            f"of {int(max(grid.lattice.shape) * (MOST_BRICKS / count) ** 0.5)} or less"
        )
    distance = _voxels(grid)
    gap = gaps(grid.bricks, distance.astype(np.float32), grid.lattice.shape)
    if gap.all():
        raise BadInput("the grid has no surface: there is nothing to view")
    centre, radius = _ball(grid, gap == 0)
    table = np.where(grid.bricks.slot >= 0, grid.bricks.slot + PRESENT, brick_gaps(grid.bricks)).astype("<i4")
    arrays = {
        "table": _deflated(table.view(np.uint8)),
        "gap": _deflated(gap),
        "distance": _parted(distance.view("<u2")),
    }
    mapped = _texture(grid)
    lattice = grid.lattice
    head = {
        "origin": lattice.origin.tolist(),
        "spacing": lattice.spacing,
        "shape": list(lattice.shape),
        "table": list(grid.bricks.slot.shape),
        "bricks": count,
        "centre": centre.tolist(),
        "radius": radius,
        "offset": None,
        "scale": None,
        "jump": None,
        "charts": grid.metadata.charts,
        "units": grid.metadata.units,
    }
    if mapped is None:
        return Packed(head, arrays)
    return Packed(head | mapped[0], arrays | mapped[1])


def _voxels(grid: Grid) -> np.ndarray:
    """Return the samples as float16: distances in voxels; numbers that are none brought into its range."""
    unit = grid.lattice.spacing
    if grid.metadata.source == "dense":
        largest = float(np.abs(grid.distance).max(initial=0))
        unit = largest / _LARGEST if largest > 0 else 1.0
    return (grid.distance / unit).astype("<f2")


def _ball(grid: Grid, some: Bool[np.ndarray, "k 8 8 8"]) -> tuple[Float[np.ndarray, "3"], float]:
    """Return the middle of the cells with surface, and how far they reach from it, world."""
    slot, *inner = np.nonzero(some)
    corner = grid.lattice.to_world(grid.bricks.index[slot] * SIDE + np.stack(inner, axis=-1))
    centre = (corner.min(axis=0) + corner.max(axis=0) + grid.lattice.spacing) / 2
    return centre, float(np.linalg.norm(corner + grid.lattice.spacing / 2 - centre, axis=1).max())


def _texture(grid: Grid) -> tuple[dict[str, Any], dict[str, str]] | None:
    """Return what the head says of the texture coordinates, and their arrays; None where there are none."""
    near = np.abs(grid.distance) <= np.float32(_REACH * grid.lattice.spacing)
    found = textured(grid, near)
    if found is None:
        return None
    known = near & (found.chart >= 0)
    if int(found.chart.max(initial=0)) >= FULL:
        raise BadInput(f"the atlas has {found.chart.max() + 1} charts, and a page tells {FULL} apart: unwrap it anew")
    offset, scale = _range(found.uv, known)
    code = np.where(known[..., None], np.rint((found.uv - offset) / scale * FULL), 0).astype("<u2")
    chart = np.where(known, found.chart + 1, 0).astype("<u2")
    planes = np.stack([code[..., 0], code[..., 1]])
    return (
        {"offset": offset.tolist(), "scale": scale.tolist(), "jump": _jump((found.uv - offset) / scale, chart)},
        {"uv": _parted(planes), "chart": _parted(chart)},
    )


def _range(
    uv: Float[np.ndarray, "k 8 8 8 2"], known: Bool[np.ndarray, "k 8 8 8"]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return the least texture coordinates and their extent, 1 where there is none."""
    values = uv[known].astype(np.float64) if known.any() else np.zeros((1, 2))
    low, high = values.min(axis=0), values.max(axis=0)
    return low, np.where(high > low, high - low, 1.0)


def _jump(place: Float[np.ndarray, "k 8 8 8 2"], chart: Int[np.ndarray, "k 8 8 8"]) -> float:
    """Return how far coordinates may change within a cell, of their range: more, and a chart meets itself along a cut.

    Steps between neighbouring samples of a chart are as large as its map is stretched; few of them cross cuts. Four of
    the largest but for a twentieth is more than a cell's diagonal.
    """
    steps = []
    for axis in (1, 2, 3):
        before, after = np.moveaxis(chart, axis, 0)[:-1], np.moveaxis(chart, axis, 0)[1:]
        moved = np.abs(np.diff(np.moveaxis(place, axis, 0), axis=0)).max(axis=-1)
        steps.append(moved[(before == after) & (before > 0)])
    several = np.concatenate(steps)
    return float(4 * np.quantile(several, 0.95)) if len(several) else 1.0


def _parted(numbers: Int[np.ndarray, "*n"]) -> str:
    """Deflate 16-bit numbers: all low bytes, then all high ones."""
    pairs = np.ascontiguousarray(numbers).reshape(-1, 1).view(np.uint8)
    return _deflated(np.ascontiguousarray(pairs.T))


def _deflated(values: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(values).tobytes(), 6)).decode("ascii")
