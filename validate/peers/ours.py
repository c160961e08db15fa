"""Our own baker as one of the tools.

In: a job. Out: a `Grid`, by all that `sdfbake.bake` does: checks of the mesh, signs, far field, error estimate.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sdfbake import Grid, Mesh, bake
from sdfbake.bricks import SIDE, in_lattice
from sdfbake.engine import choose
from sdfbake.lattice import BAND
from sdfbake.metadata import tool_version
from validate.peers.worker import Job, Tool, serve


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    """Arguments of a bake."""

    mesh: Mesh
    resolution: int
    uv_mode: str
    engine: str


def _prepare(job: Job) -> _Prepared:
    import igl  # noqa: F401  # what a bake would import is imported before the clock starts

    choose(job.options["engine"], 32)
    a = job.arrays
    mesh = Mesh(a["vertices"], a["faces"], a["uv"], a["chart"]) if "uv" in a else Mesh(a["vertices"], a["faces"])
    return _Prepared(mesh, max(job.shape), job.options["uv"], job.options["engine"])


def _bake(given: _Prepared) -> Grid:
    return bake(given.mesh, given.resolution, uv_mode=given.uv_mode, engine=given.engine)


def _look(job: Job, grid: Grid, index: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    if grid.lattice.shape != job.shape or grid.lattice.spacing != job.spacing:
        raise ValueError("the grid lies on another lattice than the one that was asked for")
    brick, (i, j, k) = index // SIDE, (index % SIDE).T
    slot = grid.bricks.slot[tuple(brick.T)]
    if (slot < 0).any():
        raise ValueError(f"{np.count_nonzero(slot < 0)} samples near the surface are in no brick")
    return grid.distance[slot, i, j, k], None if grid.face is None else grid.face[slot, i, j, k]


def _save(grid: Grid, path: Path) -> Path:
    path = path.with_suffix(".zarr.zip")
    grid.save(path)
    return path


def _band(grid: Grid) -> np.ndarray:
    """Indices of the exact band's samples, as `Grid.samples` has their positions."""
    near = np.abs(grid.distance) <= BAND * grid.lattice.spacing
    near &= in_lattice(grid.bricks.index, grid.lattice.shape)
    slot, i, j, k = np.nonzero(near)
    index: np.ndarray = grid.bricks.index[slot] * SIDE + np.stack([i, j, k], axis=-1).astype(np.int32)
    return index


if __name__ == "__main__":
    serve(lambda: Tool(tool_version(), _prepare, _bake, _look, _save, _band))
