"""Which levels of a grid the rays of a camera can choose.

In: a view, where a grid stands, how many levels it has. Out: their numbers: only these are loaded. `sdfrender.leveled`
says how a ray chooses.
"""

import numpy as np

from sdfbake.lattice import Lattice
from sdfrender.camera import Camera
from sdfrender.similarity import Similarity
from sdfrender.viewing import CameraView, View

# Of a ray's width, what the voxels of its level have at most.
SHARE = 1.0
_SLACK = 1e-3  # of a width: more than its rounding in single precision


def in_reach(
    view: View, placed: Similarity, lattice: Lattice, count: int, *, direct: bool, share: float = SHARE
) -> range:
    """Return which of a grid's levels, 0 to `count`, any ray of a picture can choose.

    A pixel of a pinhole camera whose side is s at unit distance from the middle of the picture is s cos^2 wide per
    distance along its ray, across it, where the cosine is that against the view; of an orthographic one s everywhere.

    Parameters
    ----------
    view
        Where rays come from; of rays that are given nothing is known.
    placed, lattice
        Where the grid stands, and its finest lattice.
    count
        How many coarser levels it has.
    direct
        Whether all rays come straight from the view: what mirrors and glass make of footprints is not known before.
    share
        As for `sdfrender.leveled.LeveledField`.
    """
    if count == 0 or not (direct and isinstance(view, CameraView)):
        return range(count + 1)
    camera = view.camera
    pixel = float(np.linalg.norm(camera.frame()[1]))
    side = share * pixel * view.step / placed.scale
    widths = np.array([side, side])
    if isinstance(camera, Camera):
        eye = placed.rotation.T @ (np.array(camera.position) - placed.translation) / placed.scale
        low, high = lattice.bounds
        steepest = 1 + (pixel / 2) ** 2 * float(np.dot(camera.size, camera.size))
        nearest, farthest = np.maximum(low - eye, eye - high).clip(0), np.maximum(high - eye, eye - low)
        widths = side * placed.scale * np.linalg.norm([nearest, farthest], axis=1) * [1 / steepest, 1]
    first, last = np.floor(np.log2(np.maximum(widths * [1 - _SLACK, 1 + _SLACK] / lattice.spacing, 1))).astype(int)
    return range(min(first, count), min(last, count) + 1)
