"""B-spline coefficients: for readers whose cubic sampling is the plain B-spline's, without a prefilter.

In: a grid. Out: OUT.npy, float32 (nx, ny, nz), and OUT.npy.json. A reader that weights 4^3 coefficients by the cubic
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
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8
from scipy.linalg.lapack import dpttrf, dpttrs

from sdfbake.atomic import replacing_all
from sdfbake.bricks import SIDE
from sdfbake.closest import Surface
from sdfbake.densify import planes, surface_of
from sdfbake.export.npy import described_by, description, write_head
from sdfbake.export.result import Exported, Progress
from sdfbake.export.room import check_room
from sdfbake.export.slabs import slab_bytes
from sdfbake.grid import Grid
from sdfbake.lattice import BAND

_LOCAL = np.array([-1, 4, 30], np.float32) / 36  # W up to its middle
_HALO = 2  # of W
_STRIPS = 32  # of a plane: temporaries are of one of them
_Strip = tuple[int, slice, Float[np.ndarray, "n nz"]]  # the plane, the rows in it, and what they hold
_READING = (
    "sample with the uniform cubic B-spline and no prefilter, at index coordinates (p - origin) / spacing; textures "
    "have their centres at (index + 1/2) / n, and take the array's last axis for x"
)


class _Plane(NamedTuple):
    """Samples, and which of them are exact: eight along z in a byte, since five planes are kept."""

    samples: Float[np.ndarray, "ny nz"]
    exact: UInt8[np.ndarray, "ny bytes"]


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
    check_room(path, 4 * nx * ny * nz, slab_bytes(grid, ("distance",), 0))
    surface = surface_of(grid, exact)
    described = described_by(path)
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


def _filter(file: BinaryIO, grid: Grid, strips: Iterator[_Strip], progress: Progress) -> None:
    """Solve for the coefficients and write them: along x forth; then along x back, in place, and along y and z.

    B is symmetric and has three diagonals, B = L D L^T with l below L's diagonal of ones: forth,
    y[k] = g[k] - l[k] y[k - 1]; back, c[k] = y[k] / d[k] - l[k + 1] c[k + 1].
    """
    nx, ny, nz = grid.lattice.shape
    start, size = file.tell(), 4 * ny * nz
    below, pivot = _factors(nx)
    forth = np.zeros((ny, nz), "<f4")
    for k, rows, values in strips:
        forth[rows] = values - below[k] * forth[rows]
        file.write(forth[rows].data)
    del forth
    progress("filtering back", 0)
    carried, work = np.zeros((ny, nz)), np.empty((ny, nz))
    for k in reversed(range(nx)):
        file.seek(start + k * size)
        np.divide(np.frombuffer(file.read(size), "<f4").reshape(ny, nz), pivot[k], out=work)
        carried *= -below[k + 1]
        carried += work
        work[:] = carried
        _solve(work)
        file.seek(start + k * size)
        file.write(work.astype("<f4").data)
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


def _solve(values: Float[np.ndarray, "n m"]) -> None:
    """Solve B c = g along both axes, in place; SciPy's own filter is off at the ends of axes of some five samples."""
    for axis, count in enumerate(values.shape):
        pivot, below, _ = dpttrf(_diagonal(count), np.full(count - 1, 1 / 6))
        # LAPACK wants columns, each in one piece: rows of the transposed plane are, columns of it are copied.
        for some in _pieces(values.shape[1 - axis]):
            at = (slice(None), some) if axis == 0 else (some, slice(None))
            columns = np.asfortranarray(values[at] if axis == 0 else values[at].T)
            solved = dpttrs(pivot, below, columns, overwrite_b=True)[0]
            values[at] = solved if axis == 0 else solved.T


def _pieces(count: int) -> Iterator[slice]:
    """Cut so many rows into strips."""
    step = -(-count // _STRIPS)
    return (slice(start, min(start + step, count)) for start in range(0, count, step))


def _values(grid: Grid, surface: Surface | None, progress: Progress) -> Iterator[_Strip]:
    """Yield, strip by strip, what the spline is to take at the nodes: the samples, or W^3 of them."""
    nx, ny, _ = grid.lattice.shape
    found = _planes(grid, surface, progress)
    halo = 0 if grid.metadata.source == "dense" else _HALO
    held: dict[int, _Plane] = {}
    for k in range(nx):
        around = range(k - halo, k + halo + 1)
        held = {i: plane for i, plane in held.items() if i in around}
        for i in range(max(held, default=k - 1) + 1, min(around.stop, nx)):
            held[i] = next(found)
        inner = around.start >= 0 and around.stop <= nx
        some = [held[i] for i in _mirrored(around, nx).tolist()]
        for rows in _pieces(ny):
            yield k, rows, _settled(some, rows, inner=inner) if halo else held[k].samples[rows]
        del some  # which holds the plane that is let go of next


def _planes(grid: Grid, surface: Surface | None, progress: Progress) -> Iterator[_Plane]:
    """Yield the samples plane by plane along x, and which of them are exact."""
    limit = np.float32(np.inf if surface is not None else BAND * grid.lattice.spacing)
    for number, plane in enumerate(planes(grid, surface, progress)):
        exact = (plane <= limit) & (plane >= -limit)
        if surface is None:
            present = grid.bricks.slot[number // SIDE] >= 0
            exact &= present.repeat(SIDE, 0).repeat(SIDE, 1)[: plane.shape[0], : plane.shape[1]]
        yield _Plane(plane, np.packbits(exact, axis=1))
        del plane, exact


def _settled(around: list[_Plane], rows: slice, *, inner: bool) -> Float[np.ndarray, "n nz"]:
    """Return what the spline is to take on some rows of the middle one of five planes; inner ones are not mirrored."""
    ny, nz = around[0].samples.shape
    first, end = rows.start - _HALO, rows.stop + _HALO
    at = slice(first, end) if first >= 0 and end <= ny else _mirrored(range(first, end), ny)
    smoothed = _weighted(_rows(_weighted([plane.samples[at] for plane in around])))
    wide = smoothed[:, _mirrored(range(-_HALO, nz + _HALO), nz)]
    smoothed = _weighted(_rows(wide.T)).T
    known = np.unpackbits(_all([plane.exact[at] for plane in around]), axis=1, count=nz).view(bool)
    if not inner or nz <= 2 * _HALO or not known.any():
        return smoothed
    known[: max(-first, 0)] = False
    known[len(known) - max(end - ny, 0) :] = False
    within, middle = _all(_rows(_all(_rows(known)).T)).T, slice(_HALO, nz - _HALO)
    np.copyto(smoothed[:, middle], around[_HALO].samples[rows, middle], where=within)
    return smoothed


def _mirrored(numbers: range, count: int) -> Int[np.ndarray, " n"]:
    """Return which samples of an axis these are, the ends being mirrored with the edge repeated."""
    at = np.arange(numbers.start, numbers.stop)
    return np.where(at < 0, -1 - at, np.where(at < count, at, 2 * count - 1 - at))


def _rows(values: Shaped[np.ndarray, "n m"]) -> list[Shaped[np.ndarray, "n-4 m"]]:
    """Return the five rows around every one but the two at either end."""
    rest = len(values) - 2 * _HALO
    return [values[step : step + rest] for step in range(2 * _HALO + 1)]


def _weighted(five: list[Float[np.ndarray, "n m"]]) -> Float[np.ndarray, "n m"]:
    """Return their sum, weighted by W, which is symmetric."""
    total: Float[np.ndarray, "n m"] = five[0] + five[4]
    inner = five[1] + five[3]
    total *= _LOCAL[0]
    inner *= _LOCAL[1]
    total += inner
    np.multiply(five[2], _LOCAL[2], out=inner)
    total += inner
    return total


def _all(five: list[Shaped[np.ndarray, "n m"]]) -> Shaped[np.ndarray, "n m"]:
    """Say where all of them are true, by truth values or by bits."""
    both: Shaped[np.ndarray, "n m"] = five[0] & five[1]
    for other in five[2:]:
        both &= other
    return both
