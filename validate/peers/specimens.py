"""The grids that other programs are given, and what is true of them: no axis of theirs can be taken for another.

In: a name and a resolution. Out: `Specimen`: a grid that is exported, what its readers are asked, and our answers:
samples, the linear interpolant, first hits.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import permutations, product
from math import sqrt
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Shaped

from datasets_synthetic import real
from datasets_synthetic.box import Box
from datasets_synthetic.ellipsoid import ellipsoid
from datasets_synthetic.net import Net
from datasets_synthetic.sphere import Sphere
from datasets_synthetic.turned import Turned
from datasets_synthetic.union import Union
from sdfbake.bake import bake
from sdfbake.bricks import in_lattice, sample_index
from sdfbake.densify import dense
from sdfbake.grid import Grid
from sdfbake.lattice import BAND, Lattice
from sdfrender import GridField, trace
from validate.peers.reading.question import Question

SAMPLES, RAYS, POINTS = 1 << 18, 4096, 4096
NEAR = 3.0  # voxels: what the narrowest band of a format reaches


@dataclass(frozen=True, eq=False)
class Specimen:
    """A grid and what is true of it.

    Attributes
    ----------
    name
        As the report writes it.
    grid
        What is exported.
    channels
        A grid on the same lattice that has the texture coordinates of every sample as a channel; where the exported
        one names faces only, they are found in another way.
    exact
        Distance by a closed form; None where there is none.
    """

    name: str
    grid: Grid
    channels: Grid
    exact: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, " n"]] | None = None

    @cached_property
    def values(self) -> Float[np.ndarray, "nx ny nz"]:
        """All samples, world units, float32; bounds where no brick is."""
        return dense(self.grid)

    @cached_property
    def known(self) -> Shaped[np.ndarray, "nx ny nz"]:
        """Which samples are exact distances."""
        near = np.abs(self.grid.distance) <= BAND * self.grid.lattice.spacing
        return spread(self.grid, near, False)

    @cached_property
    def crossed(self) -> Shaped[np.ndarray, "nx ny nz"]:
        """Which cells, by their first sample, have corners inside and outside, all within a cell's diagonal.

        Others are where the cover of an open mesh's hole is, which no face is near to.
        """
        some, whole = _corners(self.values < 0)
        _, near = _corners(np.abs(self.values) <= sqrt(3) * self.grid.lattice.spacing)
        crossed: np.ndarray = some & ~whole & near
        return crossed

    @cached_property
    def linear(self) -> GridField:
        """The field of the linear kernel."""
        return GridField(self.grid, "linear", precision=64)

    @cached_property
    def everywhere(self) -> Float[np.ndarray, "nx ny nz"]:
        """All samples, exact distances in every place."""
        if self.exact is None:
            return dense(self.grid, exact=True)
        index = np.stack(np.unravel_index(np.arange(self.values.size), self.values.shape), axis=-1)
        distance: np.ndarray = self.exact(self.grid.lattice.to_world(index)).reshape(self.values.shape)
        return distance

    @cached_property
    def question(self) -> Question:
        """What readers are asked: samples, those at the surface first, all of a small grid; points and rays there."""
        rng = np.random.default_rng(20180412)
        lattice = self.grid.lattice
        chosen = rng.permutation(self.values.size)
        close = np.abs(self.values.reshape(-1)[chosen]) < lattice.spacing
        chosen = chosen[np.argsort(~close, kind="stable")][:SAMPLES]
        index = np.stack(np.unravel_index(chosen, self.values.shape), axis=-1)
        near = index[: np.count_nonzero(close)]
        points = near[rng.integers(len(near), size=POINTS)] + rng.uniform(-0.5, 0.5, (POINTS, 3))
        points = points.clip(0, np.array(lattice.shape) - 1)
        low, high = lattice.bounds
        from_ = rng.normal(size=(RAYS, 3))
        p = (low + high) / 2 + np.linalg.norm(high - low) * from_ / np.linalg.norm(from_, axis=1, keepdims=True)
        d = lattice.to_world(near[rng.integers(len(near), size=RAYS)]) - p
        return Question(
            index, lattice.to_world(index), lattice.to_world(points), p, d / np.linalg.norm(d, axis=1, keepdims=True)
        )

    @cached_property
    def t(self) -> Float[np.ndarray, " r"]:
        """Our first hits of the rays."""
        return trace(self.linear, self.question.p, self.question.d).t

    @cached_property
    def margin(self) -> float:
        """Voxels by which the best of the 47 wrong orders and directions of the axes would be off, at its worst point.

        Points of the largest cube about the lattice's middle; each wrong order takes them to others of its points.
        """
        lattice = self.grid.lattice
        low, high = lattice.bounds
        rng = np.random.default_rng(47)
        about = rng.uniform(-0.5, 0.5, (POINTS, 3)) * (high - low).min()
        turns = [
            np.eye(3)[list(order)] * sign for order in permutations(range(3)) for sign in product((1, -1), repeat=3)
        ]
        asked = np.concatenate([(low + high) / 2 + about @ turn.T for turn in turns])
        (value,) = self.linear.jet(asked, 0)
        value = value.reshape(len(turns), -1)
        off = np.abs(value[1:] - value[:1]).max(axis=1) / lattice.spacing
        return float(off.min())


def _corners(mask: Shaped[np.ndarray, "nx ny nz"]) -> tuple[np.ndarray, np.ndarray]:
    """Say of every cell, by its first sample, whether any and whether all of its corners are in a mask."""
    wide, shape = np.pad(mask, (0, 1), mode="edge"), tuple(map(slice, mask.shape))
    corners = [wide[i:, j:, k:][shape] for i, j, k in product((0, 1), repeat=3)]
    return np.any(corners, axis=0), np.all(corners, axis=0)


def spread(grid: Grid, channel: Shaped[np.ndarray, "k 8 8 8 *c"], fill: float) -> Shaped[np.ndarray, "nx ny nz *c"]:
    """Return a channel as a dense array, with `fill` where no brick is."""
    array = np.full((*grid.lattice.shape, *channel.shape[4:]), fill, channel.dtype)
    inside = in_lattice(grid.bricks.index, grid.lattice.shape)
    array[tuple(sample_index(grid.bricks.index)[inside].T)] = channel[inside]
    return array


@cache
def specimen(name: str, resolution: int) -> Specimen:
    """Make the specimen of that name, of `SPECIMENS`; kept."""
    return SPECIMENS[name](name, resolution)


def _askew(name: str, resolution: int) -> Specimen:
    """A turned ellipsoid off the middle of its lattice, sampled from the shape itself."""
    turn, _ = np.linalg.qr(np.array([[3.0, 1.0, 0.5], [-1.0, 2.0, 1.0], [0.4, -1.5, 2.5]]))
    shape = Turned(ellipsoid(), turn * np.linalg.det(turn))
    around = Lattice.around(shape.bounds, resolution - 6)
    nx, ny, nz = around.shape
    lattice = Lattice(around.to_world(np.array([-6.0, -1.0, 0.0])), around.spacing, (nx + 6, ny + 4, nz + 3))
    grid = Grid.from_function(shape, lattice=lattice)
    return Specimen(name, grid, grid, shape.distance)


def _parts(name: str, resolution: int) -> Specimen:
    """A box of three different edges and a sphere at one of its corners, baked from their mesh: charts and parts."""
    shape = Union((Box(Net.fitted((0.8, 0.6, 0.45))), Sphere(0.2, (0.9, 0.5, 0.75))), ("box", "sphere"))
    mesh = shape.mesh(0.1)
    return Specimen(name, bake(mesh, resolution, uv_mode="faces"), bake(mesh, resolution, uv_mode="grid"))


def _bunny(name: str, resolution: int) -> Specimen:
    """The scanned bunny of 9,999 faces, open beneath, with the texture coordinates that its file has."""
    mesh = real.load("bunny_textured")
    grid = bake(mesh, resolution, uv_mode="faces,grid", open="winding")
    return Specimen(name, grid, grid)


SPECIMENS: Mapping[str, Callable[[str, int], Specimen]] = MappingProxyType({
    "ellipsoid, turned": _askew,
    "box and sphere": _parts,
    "bunny": _bunny,
})  # fmt: skip
