"""A grid asset as a surface for rays.

In: a `Grid`, a kernel, an engine. Out: a `Field`: certified first hits, jets (Galim 2018, eq. 13 to 19), interpolated
texture coordinates (eq. 22, 23). Only what is asked for is prepared: no UV table unless texture coordinates are used.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Integer

from sdfbake.complaint import BadInput
from sdfbake.engine import Array, Choice, Engine, choose
from sdfbake.grid import Grid
from sdfrender.cell import tolerance
from sdfrender.field import Jet, Mapped, Spot
from sdfrender.kernels import Kernel, kernel
from sdfrender.march import SIDE, Found, Tables, base_of, brick_of, cell_of, march, place_in, stencil
from sdfrender.stencils import INCOMPLETE, FloatType, channel_coefficients, mixed_cells, stencils
from sdfrender.vector import Symmetric, Vector

# Which derivative of each axis' weights makes which entry of a jet.
_ORDERS = {
    0: ((0, 0, 0),),
    1: ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    2: ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (1, 0, 1), (0, 1, 1)),
}


class GridField:
    """The zero set of a grid's interpolant.

    Parameters
    ----------
    grid
        The asset.
    kernel
        `bspline`, `catmull-rom` or `linear`, or a `Kernel`.
    engine, precision
        As for `sdfbake.engine.choose`.

    Attributes
    ----------
    tolerance
        Rounding bound of the interpolant along a ray, in the unit of the samples: a graze deeper than twice
        this is never missed (docs/tracing.md).

    Raises
    ------
    BadInput
        For an unknown kernel, engine or precision.

    Examples
    --------
    >>> import numpy as np
    >>> from sdfbake import Grid
    >>> axis = np.linspace(-1.0, 1.0, 24)
    >>> x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    >>> ball = Grid.from_dense(np.sqrt(x**2 + y**2 + z**2) - 0.6, origin=[-1.0] * 3, spacing=axis[1] - axis[0])
    >>> field = GridField(ball, engine="numpy")
    >>> value, gradient, hessian = field.jet(np.array([[0.6, 0.0, 0.0]]))
    >>> bool(abs(value[0]) < 1e-4)
    True
    """

    def __init__(
        self, grid: Grid, kernel: str | Kernel = "bspline", engine: str | Choice = "auto", precision: int | None = None
    ) -> None:
        self.grid = grid
        self.kernel = _kernel(kernel)
        self.choice = choose(engine, precision) if isinstance(engine, str) else engine
        self.engine: Engine = self.choice.engine
        self._tables, self.tolerance = _tables(grid, self.kernel, self.engine)
        self._far = self.engine.table(grid.bricks.far)
        self._charts = _ids(grid.chart, self.engine)
        self._parts = _ids(grid.part, self.engine)
        self._uv: tuple[Array, Array] | None = None
        self._seams: Array | None = None
        middle = (np.array(grid.lattice.shape) - 1) / 2
        self.anchor: Float[np.ndarray, " 3"] = grid.lattice.to_world(middle)
        self._middle = [self.engine.uniform(float(m)) for m in middle]
        self._per_voxel = self.engine.uniform(1.0 / grid.lattice.spacing)
        self._spacing = self.engine.uniform(grid.lattice.spacing)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """World box of the lattice."""
        return self.grid.lattice.bounds

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the grid's parts."""
        return tuple(self.grid.metadata.parts)

    @property
    def is_distance(self) -> bool:
        """Whether the samples are distances, so that a gradient far from unit means an edge."""
        return self.grid.metadata.source != "dense"

    def _to_grid(self, p: Vector) -> Vector:
        x, y, z = (p[a] * self._per_voxel + self._middle[a] for a in range(3))
        return x, y, z

    def _to_local(self, cell: tuple[Array, ...], u: Vector) -> Vector:
        xp = self.engine
        x, y, z = (((xp.real(cell[a]) - self._middle[a]) + u[a]) * self._spacing for a in range(3))
        return x, y, z

    def first_hit(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None) -> Spot:
        """Find first hits; see `Field.first_hit`."""
        along = (d[0] * self._per_voxel, d[1] * self._per_voxel, d[2] * self._per_voxel)
        if start is None:
            found = march(xp, self._tables, self._to_grid(p), along, active)
        else:
            place = Found(*start.locator)
            x, y, z = (xp.real(place.cell[a]) + place.u[a] for a in range(3))
            found = march(xp, self._tables, (x, y, z), along, active, place)
        return Spot(found.hit, found.t, self._to_local(found.cell, found.u), tuple(found))

    def locate(self, xp: Engine, p: Vector, active: Array) -> Spot:
        """Turn positions into places; `hit` is False outside the bricks, where there are bounds only."""
        g = self._to_grid(p)
        cell = cell_of(xp, self._tables, g)
        slot, local = brick_of(xp, self._tables, cell, active)
        kind = xp.gather(self._tables.cells, slot * SIDE**3 + local, active & (slot >= 0))
        known = active & (slot >= 0)
        found = Found(known, xp.full(p[0], 0.0), cell, place_in(xp, g, cell), base_of(xp, self._tables, cell, known))
        return Spot(known & (kind != INCOMPLETE), found.t, p, tuple(found))

    def jet(self, points: Float[np.ndarray, "n 3"], order: int = 2) -> tuple[np.ndarray, ...]:
        """Signed distance and derivatives at points (Galim 2018, eq. 13 to 19).

        Parameters
        ----------
        points
            (n, 3) float64, world frame.
        order
            0 for the value, 1 for the gradient too, 2 for the Hessian too.

        Returns
        -------
        value
            (n,) float64, world units. Where no brick is, the signed lower bound that the grid keeps there.
        gradient, hessian
            (n, 3) and (n, 3, 3), per world unit; 0 where no brick is. Left out above `order`.
        """
        points = np.asarray(points, np.float64).reshape(-1, 3)
        out = self.engine.run(
            lambda xp, *p: self._named_jet(xp, (p[0], p[1], p[2]), order), list((points - self.anchor).T)
        )
        columns = [out[str(i)].astype(np.float64) for i in range(len(out))]
        if order == 0:
            return (columns[0],)
        gradient = np.stack(columns[1:4], axis=-1)
        if order == 1:
            return columns[0], gradient
        xx, yy, zz, xy, xz, yz = columns[4:]
        hessian = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
        return columns[0], gradient, hessian

    def _named_jet(self, xp: Engine, p: Vector, order: int) -> dict[str, Array]:
        everywhere = xp.full(p[0], True)
        spot = self.locate(xp, p, everywhere)
        found = Found(*spot.locator)
        jet = self.jet_at(xp, spot, order)
        x, y, z = (c >> 3 for c in found.cell)
        bound = xp.gather(self._far, (x * self._tables.bricks[1] + y) * self._tables.bricks[2] + z, everywhere)
        derivatives = [xp.where(found.hit, entry, 0.0) for entry in (*(jet.gradient or ()), *(jet.hessian or ()))]
        return {str(i): entry for i, entry in enumerate([xp.where(found.hit, jet.value, bound), *derivatives])}

    def jet_at(self, xp: Engine, spot: Spot, order: int) -> Jet:
        """Signed distance and derivatives at a place; see `Field.jet_at`."""
        found = Found(*spot.locator)
        taps = stencil(xp, self._tables, found.base, found.hit)
        value, *rest = _contract(xp, self.kernel, taps, found.u, order)
        scale = self._per_voxel
        gradient = (rest[0] * scale, rest[1] * scale, rest[2] * scale) if order > 0 else None
        hessian = Symmetric(*(entry * (scale * scale) for entry in rest[3:])) if order > 1 else None
        return Jet(value, gradient, hessian)

    def uv(self, points: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Texture coordinates at points (Galim 2018, eq. 22, 23).

        Parameters
        ----------
        points
            (n, 3) float64, world frame, near the surface.

        Returns
        -------
        uv
            (n, 2) float64.
        gradient
            (n, 2, 3) float64, per world unit.
        chart
            (n,) int64, the chart of the nearest sample.

        Raises
        ------
        BadInput
            If the grid was baked without texture coordinates.
        """

        def program(xp: Engine, *p: Array) -> dict[str, Array]:
            spot = self.locate(xp, (p[0], p[1], p[2]), xp.full(p[0], True))
            mapped = self.uv_at(xp, spot)
            entries = [mapped.u, mapped.v, *mapped.du, *mapped.dv]
            named = {str(i): xp.where(spot.hit, entry, 0.0) for i, entry in enumerate(entries)}
            return {**named, "chart": mapped.chart}

        points = np.asarray(points, np.float64).reshape(-1, 3)
        out = self.engine.run(program, list((points - self.anchor).T))
        columns = np.stack([out[str(i)] for i in range(8)], axis=-1).astype(np.float64)
        return columns[:, :2], columns[:, 2:].reshape(-1, 2, 3), out["chart"].astype(np.int64)

    def uv_at(self, xp: Engine, spot: Spot) -> Mapped:
        """Texture coordinates at a place; see `Field.uv_at`."""
        found = Found(*spot.locator)
        found = found._replace(hit=found.hit & spot.hit)
        parts = []
        for table in self._uv_tables():
            taps = stencil(xp, _with(self._tables, table), found.base, found.hit)
            value, x, y, z = _contract(xp, self.kernel, taps, found.u, 1)
            parts.append((value, (x * self._per_voxel, y * self._per_voxel, z * self._per_voxel)))
        chart, seam = self._chart(xp, found)
        return Mapped(parts[0][0], parts[1][0], parts[0][1], parts[1][1], chart, seam)

    def part_at(self, xp: Engine, spot: Spot) -> Array:
        """Part of the nearest sample; see `Field.part_at`."""
        if self._parts is None:
            return xp.full(spot.t, 0)
        found = Found(*spot.locator)
        return self._sample(xp, self._parts, found, [u >= 0.5 for u in found.u])

    def _chart(self, xp: Engine, found: Found) -> tuple[Array, Array]:
        """Chart of the nearest sample, and whether samples of another chart went into the texture coordinates."""
        if self._charts is None or self._seams is None:
            return xp.full(found.t, 0), xp.full(found.t, False)
        slot, local = brick_of(xp, self._tables, found.cell, found.hit)
        seam = xp.gather(self._seams, slot * SIDE**3 + local, found.hit & (slot >= 0))
        return self._sample(xp, self._charts, found, [u >= 0.5 for u in found.u]), (seam > 0) & found.hit

    def _sample(self, xp: Engine, table: Array, found: Found, upper: Sequence[Array]) -> Array:
        """Look up a per-sample channel at a corner of the cell."""
        x, y, z = (c + xp.integer(up) for c, up in zip(found.cell, upper, strict=True))
        slot, local = brick_of(xp, self._tables, (x, y, z), found.hit)
        return xp.gather(table, slot * SIDE**3 + local, found.hit & (slot >= 0))

    def _uv_tables(self) -> tuple[Array, Array]:
        if self._uv is None:
            if self.grid.uv is None:
                raise BadInput("the grid has no texture coordinates: bake it with --uv-mode grid")
            lattice, bricks = self.grid.lattice, self.grid.bricks
            u, v = (
                self.engine.table(
                    channel_coefficients(self.grid.uv[..., c], bricks, lattice.shape, self.kernel, _kind(self.engine))
                )
                for c in (0, 1)
            )
            self._uv = (u, v)
            if self.grid.chart is not None:
                self._seams = self.engine.table(mixed_cells(self.grid.chart, bricks, lattice.shape, self.kernel))
        return self._uv


def _kernel(wish: str | Kernel) -> Kernel:
    return wish if isinstance(wish, Kernel) else kernel(wish)


def _kind(engine: Engine) -> FloatType:
    return np.float64 if engine.precision == 64 else np.float32


def _ids(channel: Integer[np.ndarray, "k 8 8 8"] | None, engine: Engine) -> Array | None:
    return None if channel is None else engine.table(channel)


def _tables(grid: Grid, kernel: Kernel, engine: Engine) -> tuple[Tables, float]:
    """Prepare what a march looks up, and its rounding bound."""
    shape = grid.lattice.shape
    made = stencils(grid.distance, grid.bricks, shape, kernel, _kind(engine))
    bound = tolerance(engine.eps, kernel, made.largest)
    samples = tuple(engine.uniform(int(n)) for n in shape)
    bricks = tuple(engine.uniform(int(n)) for n in grid.bricks.slot.shape)
    tables = Tables(
        kernel,
        engine.table(grid.bricks.slot),
        engine.table(made.cells),
        engine.table(made.coefficients),
        samples,
        bricks,
        engine.uniform(bound),
    )
    return tables, bound


def _with(tables: Tables, coefficients: Array) -> Tables:
    """Return the same cells with another channel's coefficients."""
    return Tables(tables.kernel, tables.slots, tables.cells, coefficients, tables.samples, tables.bricks, tables.bound)


def _contract(xp: Engine, kernel: Kernel, taps: list[Array], u: Vector, order: int) -> list[Array]:
    """Sum the taps with the weights and their derivatives, one axis after the other (Galim 2018, eq. 10, 14, 18)."""
    n = kernel.taps
    weights = [[_weights(xp, kernel, u[axis], o) for o in range(order + 1)] for axis in range(3)]
    wanted = _ORDERS[order]
    lines = sorted({(y, z) for _, y, z in wanted})
    totals: dict[tuple[int, int, int], Array] = {}
    for i in range(n):
        plane: dict[tuple[int, int], Array] = {}
        for j in range(n):
            row = taps[(i * n + j) * n : (i * n + j + 1) * n]
            along_z = [_sum(xp, row, weights[2][o]) for o in range(order + 1)]
            for y, z in lines:
                _add(xp, plane, (y, z), along_z[z], weights[1][y][j])
        for x, y, z in wanted:
            _add(xp, totals, (x, y, z), plane[y, z], weights[0][x][i])
    return [totals[key] for key in wanted]


def _add(xp: Engine, sums: dict[Any, Array], key: tuple[int, ...], value: Array, weight: Array) -> None:
    """Accumulate into a caller's own dictionary."""
    sums[key] = xp.fma(value, weight, sums[key]) if key in sums else value * weight


def _sum(xp: Engine, values: list[Array], weights: list[Array]) -> Array:
    total = values[0] * weights[0]
    for value, weight in zip(values[1:], weights[1:], strict=True):
        total = xp.fma(value, weight, total)
    return total


def _weights(xp: Engine, kernel: Kernel, u: Array, order: int) -> list[Array]:
    """Evaluate every tap's weight, or a derivative of it, by Horner's rule."""
    values = []
    for row in kernel.derivative(order).tolist():
        value = xp.full(u, float(row[-1]))
        for coefficient in reversed(row[:-1]):
            value = value * u + float(coefficient)
        values.append(value)
    return values
