"""The resolution that a picture can resolve.

In: a mesh, and the cameras that look at it. Out: how many samples make a voxel half as wide as a pixel where the mesh
comes nearest to a camera. A pixel of a pinhole camera covers radians_per_pixel * z of a plane across the view at depth
z; the least z of a face within the field of view lies at a corner of what the view cuts out of it: a vertex, a point
of an edge on a side of the view, or a point where one of the view's four edges pierces the face.
"""

from collections.abc import Sequence
from itertools import product
from math import ceil

import numpy as np
from jaxtyping import Bool, Float

from sdfbake.complaint import BadInput
from sdfbake.lattice import BAND
from sdfbake.mesh import Mesh
from sdfbake.needs import Camera, GridNeeds, Orthographic, Pinhole

COARSEST, FINEST = 32, 1024  # below, stencils of one wall meet the other; above, somebody should have asked for it
SHARE = 0.5  # of a pixel: a voxel is no wider
_SLACK = 1e-12  # of a coordinate, so that a point on a side of the view is in it


def resolution_for(mesh: Mesh, needs: GridNeeds) -> tuple[int, str]:
    """Choose a resolution.

    Parameters
    ----------
    mesh
        What will be baked.
    needs
        Who looks at it.

    Returns
    -------
    tuple
        Samples along the longest axis, `COARSEST` to `FINEST`; and a sentence that says why.

    Raises
    ------
    BadInput
        If no camera sees the mesh, so that no pixel bounds anything.
    """
    pixel, where = _finest_pixel(mesh, needs.cameras)
    if not np.isfinite(pixel):
        raise BadInput(f"no camera of the needs sees the mesh of {needs.grid} directly: choose a resolution with -n")
    extent = float(np.ptp(mesh.bounds, axis=0).max())
    # At a depth of 0 a pixel covers nothing: no number of samples would do.
    wished = ceil(min(extent / (SHARE * pixel), 1e9) + 2 * BAND) + 1 if pixel > 0 else 10**9
    n = min(max(wished, COARSEST), FINEST)
    why = f"voxels of half a pixel, which is {pixel:.3g} {mesh.units} wide {where}"
    if n != wished:
        asked = f"{wished:,}" if wished < 10**9 else "more than can be had"
        why += f"; that asks for {asked} samples, and {COARSEST} to {FINEST} are chosen by themselves: -n has the rest"
    if not needs.primary_only:
        why += "; mirrors and glass were not looked into"
    return n, why


def _finest_pixel(mesh: Mesh, cameras: Sequence[Camera]) -> tuple[float, str]:
    """Return the least side of a pixel on the mesh, the mesh's units, and where that is; infinity if none sees it."""
    found = [(np.inf, "nowhere")]
    for camera in cameras:
        if isinstance(camera, Orthographic):
            found.append((camera.units_per_pixel, "everywhere"))
            continue
        depth = nearest_depth(mesh, camera)
        found.append((depth * camera.radians_per_pixel, f"at the nearest surface in view, {depth:.3g} away"))
    return min(found)


def nearest_depth(mesh: Mesh, camera: Pinhole) -> float:
    """Return the least depth along the view of what a camera sees of a mesh, infinity where it sees nothing.

    What hides behind a nearer face is farther away, so that hiding changes nothing.
    """
    across = np.array([camera.right, camera.down]) / np.array(camera.tangents)[:, None]
    to_view = np.stack([*across, np.array(camera.view)])  # (x, y, z) with |x| <= z and |y| <= z in view
    p = np.moveaxis(((mesh.vertices - camera.position) @ to_view.T)[mesh.faces], 1, 0)
    least = _least(p.reshape(-1, 3))
    for axis, side in product((0, 1), (-1.0, 1.0)):
        for k in range(3):
            least = min(least, _least(_crossed(p[k], p[(k + 1) % 3], axis, side)))
    for x, y in product((-1.0, 1.0), repeat=2):
        least = min(least, _pierced(p, np.array([x, y, 1.0])))
    return least


def _least(p: Float[np.ndarray, "n 3"]) -> float:
    """Return the least depth of points in view."""
    return float(p[:, 2].min(where=_in_view(p), initial=np.inf))


def _in_view(p: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    x, y, z = np.abs(p).T
    seen: Bool[np.ndarray, " n"] = (p[:, 2] >= 0) & (np.maximum(x, y) <= z + _SLACK * (x + y + z))
    return seen


def _crossed(a: Float[np.ndarray, "f 3"], b: Float[np.ndarray, "f 3"], axis: int, side: float) -> np.ndarray:
    """Return where edges cross a side of the view, those that do."""
    before, after = (side * end[:, axis] - end[:, 2] for end in (a, b))
    some = (before < 0) != (after < 0)
    share = (before[some] / (before[some] - after[some]))[:, None]
    points: np.ndarray = a[some] + share * (b[some] - a[some])
    return points


def _pierced(p: Float[np.ndarray, "3 f 3"], edge: Float[np.ndarray, " 3"]) -> float:
    """Return the least depth at which an edge of the view (depth 1 at its tip) pierces a face."""
    volumes = np.stack([np.cross(p[k], p[(k + 1) % 3]) @ edge for k in range(3)])
    total = volumes.sum(axis=0)
    inside = ((volumes >= 0).all(axis=0) | (volumes <= 0).all(axis=0)) & (total != 0)
    a, b, c = p[:, inside]
    depth = (np.cross(b - a, c - a) * a).sum(axis=1) / total[inside]  # the three add up to normal . edge
    return float(depth.min(where=depth >= 0, initial=np.inf))
