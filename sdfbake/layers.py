"""Texture coordinates as layers: near the surface, every chart has a smooth map of its own.

Interpolating across the cut between two charts is wrong; interpolating one chart's map, continued past its border, is
right on both sides. Out: `Layers`, which any renderer can sample without a mesh.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Integer, UInt16

BORDER = 8.0  # voxels: border distances are clamped to this
FULL = 65535  # of 16 bits
NORMAL = 127  # length of a stored normal


@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """One row per brick and (virtual) chart that comes near a cell of the brick with surface in it.

    A sample x holds, where c is the point of the chart closest to it and f the face of c: the texture coordinates of
    c, continued by f's affine map (at a corner by the mean of the maps around it) where c is on the chart's border; the
    signed distance to that border, which is -|c - border| if c is inside, else the length of x - c along f's plane; and
    f's normal. All eight samples of a cell hold a layer if one does because of that cell; where only some do, they do
    because of other cells, and the cell has no such layer.

    At a hit, all are interpolated trilinearly; of the layers of its cell whose mean normal faces the hit's normal, that
    of the least border distance holds the texture coordinates.

    Attributes
    ----------
    brick
        Slot of the brick, ascending, int32; the rows of a brick ascend by chart.
    chart
        Virtual chart, int32: a row of `offset`, `scale` and `of`. A chart that folds over within a cell is cut into
        several by the direction of its normals; one that meets itself along a cut, by halves of its image.
    uv
        16 bits: texture coordinates are offset + scale * uv / 65535 of the row's chart.
    border
        Voxels, float16, clamped to +-8 (so far inside where the chart has no border); infinite at samples where the
        row says nothing.
    normal
        127 times the unit normal, int8; 0 where the row says nothing.
    offset, scale
        Per virtual chart, float64.
    of
        Chart of the atlas of every virtual chart, int32.
    """

    brick: Int[np.ndarray, " m"]
    chart: Int[np.ndarray, " m"]
    uv: UInt16[np.ndarray, "m 8 8 8 2"]
    border: Float[np.ndarray, "m 8 8 8"]
    normal: Integer[np.ndarray, "m 8 8 8 3"]
    offset: Float[np.ndarray, "c 2"]
    scale: Float[np.ndarray, "c 2"]
    of: Int[np.ndarray, " c"]
