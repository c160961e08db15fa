"""What mirrored rays see of an environment so far away that only their direction counts.

In: rays after a mirror and the true directions. Out: `Seen`. Footprints on an environment of 1024 texels around need
no second surface, so that every shape can be mirrored in, convex or not: they show what curvature does to a footprint.
"""

import numpy as np
from jaxtyping import Bool, Float

from validate.beam import Beam
from validate.metrics import Seen
from validate.views import TEXELS


def frames(d: Float[np.ndarray, "n 3"], forward: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "n 2 3"]:
    """Two directions across each ray, which turn with it as little as can be.

    The rotation that takes -`forward` to d is singular where d = `forward`: where a camera that looks forward sees a
    silhouette.
    """
    helper = np.eye(3)[np.argmin(np.abs(forward))]
    first = np.cross(forward, helper)
    first = first / np.linalg.norm(first)
    base = np.stack([first, np.cross(forward, first)])
    cosine = np.maximum(1.0 - d @ forward, 1e-12)
    return np.asarray(base - (d @ base.T / cosine[:, None])[:, :, None] * (d - forward)[:, None, :])


def on_environment(
    hit: Bool[np.ndarray, " n"],
    t: Float[np.ndarray, " n"],
    n: Float[np.ndarray, "n 3"],
    rays: Beam,
    frame: Float[np.ndarray, "n 2 3"],
    voxel: float = 1.0,
) -> Seen:
    """Describe mirrored rays as seen on the environment.

    Parameters
    ----------
    hit, t, n
        Where the mirror was hit, how far away, and its normal.
    rays
        After the mirror.
    frame
        Directions across the true rays: texture coordinates are counted from where these point, to first order.
    voxel
        Spacing of the grid under test.
    """
    around = 1.0 / (2.0 * np.pi)
    uv = np.einsum("nij,nj->ni", frame, rays.d) * around
    turning = np.stack([np.einsum("nij,nj->ni", frame, dd) for dd in (rays.dd_dx, rays.dd_dy)], axis=2)
    jacobian = np.where(hit[:, None, None], turning * around * TEXELS, 0.0)
    return Seen(t, n, np.where(hit[:, None], uv, 0.0), jacobian, np.zeros(len(t), np.int64), voxel, float(TEXELS))
