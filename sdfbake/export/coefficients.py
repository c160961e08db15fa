"""B-spline coefficients: for readers whose cubic sampling is the plain B-spline's, without a prefilter.

In: a grid. Out: OUT.npy, float32 (nx, ny, nz), and OUT.json. A reader that weights 4^3 coefficients by the cubic
B-spline returns the samples themselves at the nodes, and the distance between them to fourth order: Dr.Jit's
`eval_cubic`, the bicubic trick of GPUs, SciPy's `map_coordinates(..., order=3, prefilter=False)`.

The coefficients c solve B c = g, with B the sampled B-spline (1, 4, 1) / 6 along every axis (Unser, Aldroubi and Eden
1993). Beyond either end, c is mirrored at the outer face of the last sample, c[-1] = c[0]: what readers see that clamp,
and those that mirror as textures do (SciPy's "reflect").

The inverse of B has no end: of a kink m voxels away, some 0.3 (2 - sqrt(3))^m voxels come back, and where samples turn
from distances into bounds, and at the border, there are kinks. Around 5 voxels away they cost 5e-5 to 2e-4 voxels at
the surface, whatever the resolution: the end of fourth order at some 40 samples. So g is the samples themselves where
all samples up to two away along every axis are exact, as they are at all corners of cells with surface, and W of them
along every axis elsewhere, W = (-1, 4, 30, 4, -1) / 36. W = B Q, where Q = (-1, 8, -1) / 6 is the local prefilter of
fourth order, so B^-1 W = Q: nothing of what lies there comes back farther than one sample. The step from the one to the
other is itself of fourth order.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.linalg import solveh_banded

from sdfbake.atomic import replacing_all
from sdfbake.bricks import SIDE
from sdfbake.closest import Surface
from sdfbake.densify import slabs, surface_of
from sdfbake.export.npy import description, write_head
from sdfbake.export.result import Exported, Progress
from sdfbake.export.room import check_room
from sdfbake.export.slabs import slab_bytes
from sdfbake.grid import Grid
from sdfbake.lattice import BAND

_LOCAL = np.array([-1, 4, 30, 4, -1]) / 36  # W
_HALO = 2  # of W
_PLANES = 40  # of float32: what is in memory beside a slab, with room to spare
_Plane = tuple[Float[np.ndarray, "ny nz"], Bool[np.ndarray, "ny nz"]]  # samples, and which are exact
_READING = (
    "sample with the uniform cubic B-spline and no prefilter, at index coordinates (p - origin) / spacing; textures "
    "have their centres at (index + 1/2) / n, and take the array's last axis for x"
)


def write(grid: Grid, path: Path, *, progress: Progress, exact: bool = False) -> Exported:
    """Write the coefficients of a grid's distances, indexed [x, y, z].

    Parameters
    ----------
    grid
        Any grid. Samples of one that was made of anybody's numbers count as exact, all of them.
    path
        OUT.npy.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    exact
        Whether distances beyond the band are computed from the mesh that the grid carries.

    Raises
    ------
    BadInput
        If it does not fit on the disk, or the grid carries no mesh to be exact with.
    """
    nx, ny, nz = shape = grid.lattice.shape
    check_room(path, 4 * nx * ny * nz, slab_bytes(grid, ("distance",), 0) + 4 * _PLANES * ny * nz)
    surface = surface_of(grid, exact)
    described = path.with_suffix(".json")
    with replacing_all([path, described]) as (array, record):
        with array.open("w+b") as file:
            write_head(file, shape, "<f4")
            _filter(file, grid, _values(grid, surface, progress), progress)
        record.write_text(json.dumps({"coefficients": path.name, **_description(grid, exact=exact)}, indent=2) + "\n")
    more = grid.metadata.charts > 0 or len(grid.metadata.parts) > 1
    dropped = ("texture coordinates, charts and parts",) if more else ()
    return Exported((path, described), dropped, (_READING,))


def _description(grid: Grid, *, exact: bool) -> dict[str, object]:
    """Return what a reader has to know."""
    everywhere = grid.metadata.source == "dense"
    return {
        **description(grid, exact=exact),
        "basis": "uniform cubic B-spline, weights (1, 4, 1) / 6 at nodes",
        "boundary": "c[-1] = c[0], c[n] = c[n - 1]: clamp, or mirror with the edge repeated",
        "interpolates": "every sample" if everywhere else "every sample whose neighbours up to two away are exact",
        "reading": _READING,
    }


def _filter(file: BinaryIO, grid: Grid, planes: Iterator[Float[np.ndarray, "ny nz"]], progress: Progress) -> None:
    """Solve for the coefficients and write them: along y and z plane by plane, along x forth, then back in place.

    B is symmetric and has three diagonals, B = L D L^T with l below L's diagonal of ones: forth,
    y[k] = g[k] - l[k] y[k - 1]; back, c[k] = y[k] / d[k] - l[k + 1] c[k + 1].
    """
    nx, ny, nz = grid.lattice.shape
    start, size = file.tell(), 4 * ny * nz
    below, pivot = _factors(nx)
    carried = np.zeros((ny, nz))
    for k, plane in enumerate(planes):
        carried = _solved(_solved(plane).T).T - below[k] * carried
        file.write(np.ascontiguousarray(carried, "<f4").data)
    progress("filtering back", 0)
    carried = np.zeros((ny, nz))
    for k in reversed(range(nx)):
        file.seek(start + k * size)
        plane = np.frombuffer(file.read(size), "<f4").reshape(ny, nz)
        carried = plane / pivot[k] - below[k + 1] * carried
        file.seek(start + k * size)
        file.write(carried.astype("<f4").data)
        progress("filtering back", (nx - k) / nx)


def _factors(count: int) -> tuple[Float[np.ndarray, " ends"], Float[np.ndarray, " n"]]:
    """Return l, 0 before the first and after the last, and d; in the middle they are 2 - sqrt(3) and 1 / (6 l)."""
    below, pivot = np.zeros(count + 1), _diagonal(count)
    for k in range(1, count):
        below[k] = 1 / 6 / pivot[k - 1]
        pivot[k] -= below[k] / 6
    return below, pivot


def _diagonal(count: int) -> Float[np.ndarray, " n"]:
    """Return the diagonal of B along an axis: 4 / 6, and at the ends the sample beyond, which is the same, too."""
    diagonal = np.full(count, 4 / 6)
    diagonal[[0, -1]] += 1 / 6
    return diagonal


def _solved(values: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n m"]:
    """Solve B c = g along the first axis; SciPy's own filter is off at the ends of axes of some five samples."""
    bands = np.stack([np.full(len(values), 1 / 6), _diagonal(len(values))])
    solved: Float[np.ndarray, "n m"] = solveh_banded(bands, values, check_finite=False)
    return solved


def _values(grid: Grid, surface: Surface | None, progress: Progress) -> Iterator[Float[np.ndarray, "ny nz"]]:
    """Yield, plane by plane along x, what the spline is to take at the nodes: the samples, or W^3 of them."""
    nx = grid.lattice.shape[0]
    planes = _planes(grid, surface, progress)
    if grid.metadata.source == "dense":
        yield from (plane.astype(np.float64) for plane, _ in planes)
        return
    held: dict[int, _Plane] = {}
    for k in range(nx):
        around = range(k - _HALO, k + _HALO + 1)
        held = {i: plane for i, plane in held.items() if i in around}
        held |= {i: next(planes) for i in around if i < nx and i > max(held, default=-1) and i >= 0}
        inner = around.start >= 0 and around.stop <= nx
        yield _settled([held[-1 - i if i < 0 else 2 * nx - 1 - i if i >= nx else i] for i in around], inner)


def _planes(grid: Grid, surface: Surface | None, progress: Progress) -> Iterator[_Plane]:
    """Yield the samples plane by plane along x, and which of them are exact."""
    limit = np.inf if surface is not None else BAND * grid.lattice.spacing
    for number, slab in enumerate(slabs(grid, surface, progress)):
        absent = (grid.bricks.slot[number] < 0).repeat(SIDE, 0).repeat(SIDE, 1)[: slab.shape[1], : slab.shape[2]]
        for plane in slab:
            # A copy: none of the planes that are kept keeps the slab.
            yield plane.copy(), (np.abs(plane) <= limit) & (~absent | (surface is not None))
        del slab, plane


def _settled(around: list[_Plane], inner: bool) -> Float[np.ndarray, "ny nz"]:
    """Return what the spline is to take on the middle one of five planes; inner ones are not mirrored."""
    smoothed = sum(weight * plane for weight, (plane, _) in zip(_LOCAL, around, strict=True))
    known = np.logical_and.reduce([exact for _, exact in around]) & inner
    for axis in (0, 1):
        smoothed = ndimage.correlate1d(smoothed, _LOCAL, axis, mode="reflect")
        known = ndimage.minimum_filter1d(known, 2 * _HALO + 1, axis, mode="constant", cval=0)
    return np.where(known, around[_HALO][0], smoothed)
