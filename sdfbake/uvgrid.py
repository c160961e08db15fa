"""Texture coordinates of the closest surface point at every sample (Galim 2018, eq. 22).

In: the closest faces. Out: the channel that kernels interpolate, across the cuts between charts too.
"""

import numpy as np
from jaxtyping import Float, Int

from sdfbake import triangle
from sdfbake.band import Target
from sdfbake.bricks import SIDE, sample_index
from sdfbake.engine import Array, Engine

_BRICKS_AT_ONCE = 4096


def closest_uv(
    xp: Engine, target: Target, uv: Float[np.ndarray, "f 3 2"], index: Int[np.ndarray, "k 3"], face: np.ndarray
) -> Float[np.ndarray, "k 8 8 8 2"]:
    """Return the channel, float32; 0 where no face is named.

    Parameters
    ----------
    xp, target
        The engine, and the mesh on it.
    uv
        Texture coordinates of the target's faces, per corner.
    index, face
        Bricks, and the row of the closest face of every sample (k, 8, 8, 8), -1 for none.
    """
    fine = xp.at(64)
    table = fine.table(uv)

    def program(xp: Engine, row: Array, *p: Array) -> dict[str, Array]:
        corner = [xp.gather(target.corners, row * 3 + k, True) for k in range(3)]
        a, b, c = (xp.rows(target.vertices, vertex, True)[:3] for vertex in corner)
        weight = triangle.nearest(xp, (xp.real(p[0]), xp.real(p[1]), xp.real(p[2])), (a, b, c)).barycentric
        values = {}
        for n, name in enumerate("uv"):
            of_corner = [xp.gather(table, row * 6 + (2 * k + n), True) for k in range(3)]
            values[name] = weight[0] * of_corner[0] + weight[1] * of_corner[1] + weight[2] * of_corner[2]
        return values

    channel = np.zeros((len(index), SIDE, SIDE, SIDE, 2), np.float32)
    for start in range(0, len(index), _BRICKS_AT_ONCE):
        part = slice(start, start + _BRICKS_AT_ONCE)
        known = face[part] >= 0
        if known.any():
            found = fine.run(program, [face[part][known], *sample_index(index[part])[known].astype(np.int32).T])
            channel[part][known] = np.stack([found["u"], found["v"]], axis=-1)
    return channel
