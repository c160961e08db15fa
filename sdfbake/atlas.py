"""How good an atlas is: seams, stretch, overlaps, gutter.

In: a mesh with texture coordinates. Out: `Quality`. Stretch is that of Sander et al. 2001 (Texture mapping progressive
meshes, section 3); what concerns texels is counted on a raster, row by row, without a loop over faces.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_cdt

from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh
from sdfbake.topology import Topology, twice_areas

SIZE = 1024
# A face without texture area: its altitude is below 1e-12 of its longest edge, thousands of times above rounding.
_FLAT = 1e-12
# Rows of texels treated at once, and those beyond which a texture repeats too often to be counted.
_BLOCK, _MOST = 1 << 20, 1 << 27

_ALL, _HERE, _NEXT = slice(None), slice(None, -1), slice(1, None)
_NEIGHBOURS = (
    ((_HERE, _ALL), (_NEXT, _ALL)),
    ((_ALL, _HERE), (_ALL, _NEXT)),
    ((_HERE, _HERE), (_NEXT, _NEXT)),
    ((_HERE, _NEXT), (_NEXT, _HERE)),
)


@dataclass(frozen=True, slots=True)
class Quality:
    """Figures of an atlas on a texture of size^2 texels; None where there is nothing to measure.

    Attributes
    ----------
    charts, mirrored_charts
        Charts, and those laid out from behind, which is usual and harmless.
    seam_length, seam_ratio
        Length of the edges whose faces disagree on texture coordinates or chart, each edge once, world units; and over
        the square root of the surface area.
    stretch_l2, stretch_linf
        Sander's norms, relative to the mean scale: 1 is a similarity.
    flipped
        Faces turned against the rest of their chart.
    zero_area
        Faces without area in the texture, left out of the stretch.
    overlapping_texels
        Texels whose centres lie in more than one face; a centre on a shared edge belongs to one face.
    utilisation
        Covered texels over those of the rectangle around the texture coordinates.
    density, density_p5, density_p95
        Texels per world unit: mean over the surface, and what 5 % and 95 % of it stay below.
    gutter
        Least number of free texels between two charts, diagonal steps counting as one; 0 where charts overlap. Within
        one texel, the gap between their outlines.
    size
        Texels along either side of the texture, which is the unit square.
    """

    charts: int
    mirrored_charts: int
    seam_length: float
    seam_ratio: float | None
    stretch_l2: float | None
    stretch_linf: float | None
    flipped: int
    zero_area: int
    overlapping_texels: int | None
    utilisation: float | None
    density: float | None
    density_p5: float | None
    density_p95: float | None
    gutter: int | None
    size: int

    @property
    def mip_levels(self) -> int | None:
        """Mip levels without colours of other charts, if the gutter is filled from the nearest chart; None is all.

        A bilinear look-up on level L reads texels of the image up to (3 2^L - 1) / 2 away; half of the gutter is the
        chart's own.
        """
        return None if self.gutter is None else ((self.gutter + 1) // 3).bit_length()

    def gutter_voxels(self, spacing: float) -> float | None:
        """Return the gutter in voxels of a size, at the density that 95 % of the surface stay below."""
        return None if self.gutter is None or not self.density_p95 else self.gutter / (self.density_p95 * spacing)

    def record(self) -> dict[str, Any]:
        """Return the figures as plain values."""
        return {**asdict(self), "mip_levels": self.mip_levels}


def quality(mesh: Mesh, size: int = SIZE) -> Quality:
    """Measure the atlas of a mesh.

    Parameters
    ----------
    mesh
        With texture coordinates. Those outside the unit square repeat the texture.
    size
        Texels along either side of the texture.

    Returns
    -------
    Quality
        Its figures.

    Raises
    ------
    BadInput
        If the mesh has no texture coordinates, or the size is below 1.

    Examples
    --------
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> quality(Mesh(corners, np.array([[0, 1, 2]]), 0.5 * corners[None, :, :2]), 64).stretch_l2
    1.0
    """
    if mesh.uv is None:
        raise BadInput("the mesh has no texture coordinates to judge: unwrap it first")
    if size < 1:
        raise BadInput(f"a texture of {size} texels has nothing to count: give a size of at least 1")
    area = twice_areas(mesh.vertices, mesh.faces) / 2
    in_uv, usable = _uv_areas(mesh.uv)
    _, chart = np.unique(mesh.chart, return_inverse=True)
    turn = np.where(np.bincount(chart, weights=np.where(usable, in_uv, 0.0)) < 0, -1, 1)
    seam = _seam_length(mesh)
    return Quality(
        charts=len(turn),
        mirrored_charts=int((turn < 0).sum()),
        seam_length=seam,
        seam_ratio=float(seam / np.sqrt(area.sum())) if area.any() else None,
        flipped=int((usable & (np.sign(in_uv) != turn[chart])).sum()),
        zero_area=int((~usable).sum()),
        size=size,
        **_stretch(mesh.vertices[mesh.faces[usable]], mesh.uv[usable], area[usable], in_uv[usable]),
        **_density(area[usable], np.abs(in_uv[usable]), size),
        **_on_raster(mesh.uv[usable] * size, chart[usable], size),
    )


def _uv_areas(uv: Float[np.ndarray, "f 3 2"]) -> tuple[Float[np.ndarray, " f"], Bool[np.ndarray, " f"]]:
    """Return the signed area of every face in the texture, and whether it has any."""
    finite = np.isfinite(uv).all(axis=(1, 2))
    sides = np.roll(np.where(finite[:, None, None], uv, 0.0), -1, axis=1)
    sides = sides - np.roll(sides, 1, axis=1)
    doubled = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    return doubled / 2, np.abs(doubled) > _FLAT * (sides**2).sum(axis=-1).max(axis=-1)


def _seam_length(mesh: Mesh) -> float:
    """Return the length of all edges across which texture coordinates or charts jump."""
    topology = Topology.of(mesh.faces)
    assert mesh.uv is not None
    ends = np.stack([mesh.uv, np.roll(mesh.uv, -1, axis=1)], axis=2)  # of side k: corner k, corner k + 1
    ends = np.where(topology.forward[..., None, None], ends, ends[:, :, ::-1]).reshape(-1, 4)
    told = np.column_stack([ends, np.repeat(mesh.chart, 3)])
    edge = topology.edge.reshape(-1)
    first = np.empty(len(topology.edges), np.int64)
    first[edge[::-1]] = np.arange(len(edge))[::-1]  # the first side of every edge is written last
    seam = np.unique(edge[(told != told[first[edge]]).any(axis=1)])
    a, b = np.moveaxis(mesh.vertices[topology.edges[seam]], 1, 0)
    return float(np.linalg.norm(b - a, axis=-1).sum())


def _stretch(
    p: Float[np.ndarray, "f 3 3"],
    uv: Float[np.ndarray, "f 3 2"],
    area: Float[np.ndarray, " f"],
    in_uv: Float[np.ndarray, " f"],
) -> dict[str, Any]:
    """Return Sander's L2 and Linf, over the square root of surface area by texture area."""
    if not area.any():
        return {"stretch_l2": None, "stretch_linf": None}
    s, t = np.moveaxis(uv, -1, 0)
    by_s = np.einsum("fk,fkx->fx", np.roll(t, -1, axis=1) - np.roll(t, 1, axis=1), p) / (2 * in_uv[:, None])
    by_t = np.einsum("fk,fkx->fx", np.roll(s, 1, axis=1) - np.roll(s, -1, axis=1), p) / (2 * in_uv[:, None])
    a, b, c = (by_s**2).sum(axis=-1), (by_s * by_t).sum(axis=-1), (by_t**2).sum(axis=-1)
    greatest = np.sqrt((a + c + np.hypot(a - c, 2 * b)) / 2)
    unit = np.sqrt(area.sum() / np.abs(in_uv).sum())
    l2 = np.sqrt(((a + c) / 2 * area).sum() / area.sum())
    return {"stretch_l2": float(l2 / unit), "stretch_linf": float(greatest.max() / unit)}


def _density(area: Float[np.ndarray, " f"], in_uv: Float[np.ndarray, " f"], size: int) -> dict[str, Any]:
    """Return texels per world unit: mean, 5th and 95th percentile over the surface."""
    solid = area > 0
    if not solid.any():
        return dict.fromkeys(("density", "density_p5", "density_p95"))
    texels, weight = size * np.sqrt(in_uv[solid] / area[solid]), area[solid]
    low, high = np.quantile(texels, [0.05, 0.95], weights=weight, method="inverted_cdf").tolist()
    return {"density": float(np.average(texels, weights=weight)), "density_p5": low, "density_p95": high}


def _on_raster(corners: Float[np.ndarray, "f 3 2"], chart: Int[np.ndarray, " f"], size: int) -> dict[str, Any]:
    """Return what is counted in texels."""
    covered = cover(corners, chart, size)
    if covered is None:
        return dict.fromkeys(("overlapping_texels", "utilisation", "gutter"))
    flat = corners.reshape(-1, 2)
    span = np.ceil(flat.max(axis=0) - 0.5) - np.ceil(flat.min(axis=0) - 0.5)
    texels = np.minimum(span, size).prod()
    return {
        "overlapping_texels": int((covered.faces > 1).sum()),
        "utilisation": float((covered.faces > 0).sum() / texels) if texels else None,
        "gutter": gutter(covered),
    }


class Cover(NamedTuple):
    """What lies on every texel: how many faces, and their chart (-1 none, -2 several)."""

    faces: Int[np.ndarray, "n n"]
    chart: Int[np.ndarray, "n n"]


def cover(corners: Float[np.ndarray, "f 3 2"], chart: Int[np.ndarray, " f"], size: int) -> Cover | None:
    """Count the faces on every texel's centre, row (v) first; the texture repeats.

    Every face adds a run of texels to each of its rows: +1 where it begins, -1 where it ends, summed along the row in
    the end. A centre on an edge shared by two faces is in one of them.

    Parameters
    ----------
    corners
        Corners of the faces, in texels.
    chart
        Their charts.
    size
        Texels along either side.

    Returns
    -------
    Cover or None
        None if there is no face, or too many repetitions to count.
    """
    heights = np.ptp(corners[..., 1], axis=1)
    if len(corners) == 0 or np.abs(corners).max() > 2.0**40 or heights.sum() > _MOST:
        return None
    # Runs of (1, chart, chart^2): their sums tell how many charts there are, and which if there is one.
    weight = np.stack([np.ones_like(chart), chart, chart * chart]).astype(np.int64)
    change, whole = np.zeros((3, size * size), np.int64), np.zeros((3, size), np.int64)
    for face, row, start, stop in _runs(corners):
        line = row % size
        for k in range(3):
            np.add.at(change[k], line * size + start % size, weight[k, face])
            np.add.at(change[k], line * size + stop % size, -weight[k, face])
            np.add.at(whole[k], line, weight[k, face] * (stop // size - start // size))
    count, first, second = np.cumsum(change.reshape(3, size, size), axis=2) + whole[:, :, None]
    single = count * second == first * first
    return Cover(count, np.where(count == 0, -1, np.where(single, first // np.maximum(count, 1), -2)))


def _runs(corners: Float[np.ndarray, "f 3 2"]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield, in blocks, the runs of texels whose centres lie in faces: face, row, first column, column behind."""
    # Lowest corner first: so both faces of an edge cut it into rows with the same arithmetic.
    order = np.lexsort((corners[..., 0], corners[..., 1]), axis=1)
    low, middle, high = np.moveaxis(np.take_along_axis(corners, order[..., None], axis=1), 1, 0)
    first = np.ceil(low[:, 1] - 0.5).astype(np.int64)
    rows = np.ceil(high[:, 1] - 0.5).astype(np.int64) - first
    ends = np.cumsum(rows)
    cuts = np.searchsorted(ends, np.arange(_BLOCK, ends[-1], _BLOCK))
    for block in np.split(np.arange(len(corners)), cuts):
        face = np.repeat(block, rows[block])
        above = np.cumsum(rows[block]) - rows[block]
        row = np.arange(len(face)) + np.repeat(first[block] - above, rows[block])
        y = row + 0.5
        upper = (y >= middle[face, 1])[:, None]
        one = _crossing(low[face], high[face], y)
        other = _crossing(np.where(upper, middle[face], low[face]), np.where(upper, high[face], middle[face]), y)
        start, stop = np.ceil(np.minimum(one, other) - 0.5), np.ceil(np.maximum(one, other) - 0.5)
        yield face, row, start.astype(np.int64), stop.astype(np.int64)


def _crossing(p: Float[np.ndarray, "n 2"], q: Float[np.ndarray, "n 2"], y: Float[np.ndarray, " n"]) -> np.ndarray:
    """Return x where the edge from p up to q, which is not level, meets the line y."""
    x: np.ndarray = p[:, 0] + (q[:, 0] - p[:, 0]) * ((y - p[:, 1]) / (q[:, 1] - p[:, 1]))
    return x


def gutter(covered: Cover) -> int | None:
    """Return the least number of free texels between two charts, diagonal steps counting as one; None for one chart.

    Halfway between the two closest texels of different charts, neighbouring texels are nearest to different charts, and
    their distances to them add up to the gap; nowhere else do they add up to less.
    """
    if (covered.chart == -2).any():
        return 0
    taken = covered.chart[covered.chart >= 0]
    if len(taken) == 0 or (taken == taken[0]).all():
        return None
    distance, (i, j) = distance_transform_cdt(covered.chart < 0, metric="chessboard", return_indices=True)
    nearest, least = covered.chart[i, j], np.inf
    for a, b in _NEIGHBOURS:
        gap = (distance[a] + distance[b])[nearest[a] != nearest[b]]
        least = min(least, gap.min(initial=covered.chart.size))
    return int(least)
