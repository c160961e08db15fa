"""The footprint of a pixel on a texture (Galim 2018, eq. 23 to 25).

In: a beam on a surface and the texture coordinates there. Out: duv/dx and duv/dy per pixel, the level of detail as
the report has it and as rotation leaves it, the ellipse.
"""

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine
from sdfrender.field import Mapped
from sdfrender.rays import Beam
from sdfrender.vector import Vector, dot

Pair = tuple[Array, Array]
SMALLEST = 1e-18  # texels: what a footprint of no extent is taken for; its square is a float32, its logarithm a number


def derivatives(mapped: Mapped, beam: Beam) -> tuple[Pair, Pair]:
    """Return duv/dx and duv/dy (eq. 23).

    The displacements lie in the tangent plane, so they see only the tangential part of the texture gradient: what
    interpolation makes of it along the normal has no part in the footprint.
    """

    def along(dp: Vector) -> Pair:
        return dot(mapped.du, dp), dot(mapped.dv, dp)

    return along(beam.dp_dx), along(beam.dp_dy)


def level_of_detail(xp: Engine, duv_dx: Pair, duv_dy: Pair, size: tuple[Array, Array]) -> Array:
    """Return log2 of the longer of the two footprint axes in texels (eq. 24, 25), unclamped."""
    return 0.5 * xp.log2(xp.maximum(xp.maximum(_squared(duv_dx, size), _squared(duv_dy, size)), SMALLEST**2))


def invariant_level(xp: Engine, duv_dx: Pair, duv_dy: Pair, size: tuple[Array, Array]) -> Array:
    """Return log2 of the greatest singular value of the footprint: the same however the pixel axes are turned."""
    a, c = _squared(duv_dx, size), _squared(duv_dy, size)
    b = duv_dx[0] * duv_dy[0] * (size[0] * size[0]) + duv_dx[1] * duv_dy[1] * (size[1] * size[1])
    half = 0.5 * (a - c)
    greatest = 0.5 * (a + c) + xp.sqrt(half * half + b * b)
    return 0.5 * xp.log2(xp.maximum(greatest, SMALLEST**2))


def _squared(duv: Pair, size: tuple[Array, Array]) -> Array:
    u, v = duv[0] * size[0], duv[1] * size[1]
    return u * u + v * v


def ellipse(
    duv_dx: Float[np.ndarray, "n 2"], duv_dy: Float[np.ndarray, "n 2"], size: tuple[int, int]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the ellipse that a pixel's unit circle becomes on the texture.

    Parameters
    ----------
    duv_dx, duv_dy
        Derivatives per pixel.
    size
        Width and height of the texture, texels.

    Returns
    -------
    major, minor
        Half axes, texels.
    angle
        Of the major axis against the u axis, radians, in [-pi/2, pi/2].
    """
    jacobian = np.stack([duv_dx, duv_dy], axis=-1) * np.array(size, float)[:, None]
    u, s, _ = np.linalg.svd(jacobian)
    axis = u[:, :, 0] * np.where(u[:, :1, 0] < 0, -1.0, 1.0)
    return s[:, 0], s[:, 1], np.arctan2(axis[:, 1], axis[:, 0])
