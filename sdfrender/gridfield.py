"""A grid asset as a surface for rays.

In: a `Grid`, a kernel, an engine. Out: a `Field`: certified first hits, jets (Galim 2018, eq. 13 to 19), texture
coordinates by `facemap`, `layermap` or `gridmap`. Only what is asked for is prepared: none of them unless it is used.
"""

from threading import Lock

import numpy as np
from jaxtyping import Float, Integer

from sdfbake.engine import Array, Choice, Engine, choose
from sdfbake.grid import Grid
from sdfbake.lattice import BAND
from sdfrender.facemap import FaceMap
from sdfrender.field import Jet, Mapped, Spot, Spread
from sdfrender.gridmap import GridMap
from sdfrender.interpolation import contract
from sdfrender.kernels import Kernel, kernel
from sdfrender.layermap import LayerMap
from sdfrender.march import Leaving, march, meets
from sdfrender.mixed import mixed_cells
from sdfrender.optics import normal
from sdfrender.preparation import prepare
from sdfrender.tables import (
    SHIFT,
    Found,
    base_of,
    brick_of,
    cell_of,
    is_complete,
    place_in,
    sample,
    stencil,
)
from sdfrender.uvmode import AUTO, BY_NORMAL, choose_mode, stored_in
from sdfrender.vector import Symmetric, Vector


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
    uv_mode
        Which texture coordinates to read, one of `sdfbake.metadata.MODES`; None for the most exact that the grid has.

    Attributes
    ----------
    uv_mode
        Which are read; None if the grid has none.
    tolerance
        Rounding bound of the interpolant along a ray, in the unit of the samples: a graze deeper than twice
        this is never missed (docs/tracing.md).

    Raises
    ------
    BadInput
        For an unknown kernel, engine or precision, or texture coordinates that the grid does not have.

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
        self,
        grid: Grid,
        kernel: str | Kernel = "bspline",
        engine: str | Choice = "auto",
        precision: int | None = None,
        uv_mode: str | None = None,
    ) -> None:
        self.grid = grid
        stored = stored_in(grid)
        self.uv_mode = choose_mode(stored, uv_mode or AUTO, "the grid") if stored or uv_mode else None
        self.kernel = _kernel(kernel)
        self.choice = choose(engine, precision) if isinstance(engine, str) else engine
        self.engine: Engine = self.choice.engine
        self._tables, self.tolerance = prepare(grid, self.kernel, self.engine)
        self._far = self.engine.table(grid.bricks.far)
        self._parts = _ids(grid.part, self.engine)
        self._beyond = _beyond(grid, self.kernel, self.engine)
        self._prepared: GridMap | FaceMap | LayerMap | None = None
        self._preparing = Lock()
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

    def first_hit(
        self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None, spread: Spread | None = None
    ) -> Spot:
        """Find first hits; see `Field.first_hit`."""
        found = march(xp, self._tables, *self._rays(xp, p, d, active, start))
        return Spot(found.hit, found.t, self._to_local(found.cell, found.u), tuple(found))

    def occluded(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None, limit: Array) -> Array:
        """Say which rays meet anything; see `Field.occluded`."""
        return meets(xp, self._tables, *self._rays(xp, p, d, active, start), limit)

    def _rays(
        self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None
    ) -> tuple[Vector, Vector, Array, Leaving | None]:
        """Return what a march asks for, in grid coordinates."""
        at, along = self._to_grid(p), (d[0] * self._per_voxel, d[1] * self._per_voxel, d[2] * self._per_voxel)
        if start is None:
            return at, along, active, None
        place = Found(*start.locator)
        x, y, z = (xp.where(start.hit, xp.real(place.cell[a]) + place.u[a], at[a]) for a in range(3))
        return (x, y, z), along, active, Leaving(start.hit, place.cell)

    def inside(self, xp: Engine, p: Vector, active: Array) -> Array:
        """Say which positions are inside: by the interpolant; where no brick is, by the bound; none off the lattice."""
        spot = self.locate(xp, p, active)
        for x, count in zip(self._to_grid(p), self._tables.samples, strict=True):
            active = active & (x >= 0) & (x <= xp.real(count - 1))
        return active & (self._value(xp, spot, self.jet_at(xp, spot, 0)) < 0)

    def _value(self, xp: Engine, spot: Spot, jet: Jet) -> Array:
        """Return the signed distance, or the signed lower bound where no brick is."""
        found = Found(*spot.locator)
        x, y, z = (c >> SHIFT for c in found.cell)
        number = (x * self._tables.bricks[1] + y) * self._tables.bricks[2] + z
        return xp.where(found.hit, jet.value, xp.gather(self._far, number, ~found.hit))

    def locate(self, xp: Engine, p: Vector, active: Array) -> Spot:
        """Turn positions into places; `hit` is False outside the bricks, where there are bounds only."""
        g = self._to_grid(p)
        cell = cell_of(xp, self._tables, g)
        slot, local = brick_of(xp, self._tables, cell, active)
        known = active & (slot >= 0)
        complete = is_complete(xp, self._tables, slot, local, known)
        found = Found(known, xp.full(p[0], 0.0), cell, place_in(xp, g, cell), base_of(xp, self._tables, cell, known))
        return Spot(known & complete, found.t, p, tuple(found))

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
        derivatives = [xp.where(found.hit, entry, 0.0) for entry in (*(jet.gradient or ()), *(jet.hessian or ()))]
        return {str(i): entry for i, entry in enumerate([self._value(xp, spot, jet), *derivatives])}

    def jet_at(self, xp: Engine, spot: Spot, order: int) -> Jet:
        """Signed distance and derivatives at a place; see `Field.jet_at`."""
        found = Found(*spot.locator)
        taps = stencil(xp, self._tables, found.base, found.hit)
        value, *rest = contract(xp, self.kernel, taps, found.u, order)
        scale = self._per_voxel
        gradient = (rest[0] * scale, rest[1] * scale, rest[2] * scale) if order > 0 else None
        hessian = Symmetric(*(entry * (scale * scale) for entry in rest[3:])) if order > 1 else None
        return Jet(value, gradient, hessian)

    def uv(self, points: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Texture coordinates at points, by the field's `uv_mode`.

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
            (n,) int64. All three are 0 where no brick is.

        Raises
        ------
        BadInput
            If the grid was baked without texture coordinates.
        """

        def program(xp: Engine, *p: Array) -> dict[str, Array]:
            spot = self.locate(xp, (p[0], p[1], p[2]), xp.full(p[0], True))
            n = normal(xp, self.jet_at(xp, spot, 1)) if self.uv_mode in BY_NORMAL else None
            mapped = self.uv_at(xp, spot, n)
            entries = [mapped.u, mapped.v, *mapped.du, *mapped.dv]
            named = {str(i): xp.where(spot.hit, entry, 0.0) for i, entry in enumerate(entries)}
            return {**named, "chart": mapped.chart}

        points = np.asarray(points, np.float64).reshape(-1, 3)
        out = self.engine.run(program, list((points - self.anchor).T))
        columns = np.stack([out[str(i)] for i in range(8)], axis=-1).astype(np.float64)
        return columns[:, :2], columns[:, 2:].reshape(-1, 2, 3), out["chart"].astype(np.int64)

    def prepare_uv(self) -> None:
        """Prepare the texture coordinates, if there are any; see `Field.prepare_uv`."""
        if self.uv_mode is not None:
            self._map()

    def uv_at(self, xp: Engine, spot: Spot, n: Vector | None) -> Mapped:
        """Texture coordinates at a place; see `Field.uv_at`."""
        found = Found(*spot.locator)
        return self._map().uv_at(xp, found._replace(hit=found.hit & spot.hit), spot.p, n)

    def part_at(self, xp: Engine, spot: Spot) -> Array:
        """Part of the nearest sample; see `Field.part_at`."""
        if self._parts is None:
            return xp.full(spot.t, 0)
        found = Found(*spot.locator)
        return sample(xp, self._tables, self._parts, found.nearest(xp), found.hit)

    def beyond_band(self, xp: Engine, spot: Spot) -> Array:
        """Say whether a sample behind the cell of a place lies beyond the band that the grid claims."""
        if self._beyond is None:
            return xp.full(spot.t, False)
        found = Found(*spot.locator)
        return sample(xp, self._tables, self._beyond, found.cell, found.hit) > 0

    def _map(self) -> GridMap | FaceMap | LayerMap:
        """Prepare the texture coordinates, once, whichever thread comes first."""
        with self._preparing:
            if self._prepared is None:
                mode = self.uv_mode or choose_mode((), AUTO, "the grid")
                grid, tables, engine = self.grid, self._tables, self.engine
                if mode == "faces":
                    self._prepared = FaceMap.of(grid, tables, engine, self._per_voxel)
                elif mode == "layers":
                    self._prepared = LayerMap.of(grid, tables, engine, self._per_voxel)
                else:
                    self._prepared = GridMap.of(grid, tables, engine, self._per_voxel)
            return self._prepared


def _kernel(wish: str | Kernel) -> Kernel:
    return wish if isinstance(wish, Kernel) else kernel(wish)


def _beyond(grid: Grid, kernel: Kernel, engine: Engine) -> Array | None:
    """Say of every cell whether samples behind it are beyond the band; None where no cell with surface has such."""
    if grid.metadata.band >= BAND:
        return None
    limit = np.float32(grid.metadata.band * grid.lattice.spacing * (1 - 1e-6))
    # Numbered like a chessboard, so that a cell differs that sees nothing but such samples.
    board = 1 + np.indices(grid.distance.shape[1:]).sum(axis=0) % 2
    far = np.where(np.abs(grid.distance) >= limit, board, 0).astype(np.int32)
    return engine.table(mixed_cells(far, grid.bricks, grid.lattice.shape, kernel))


def _ids(channel: Integer[np.ndarray, "k 8 8 8"] | None, engine: Engine) -> Array | None:
    return None if channel is None else engine.table(channel)
