"""The footprint of a pixel on a texture (Galim 2018, eq. 23 to 25).

In: a beam on a surface and the texture coordinates there. Out: duv/dx and duv/dy per pixel, the level of detail as
the report has it and as rotation leaves it, the ellipse, and how far the footprint is from linear.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake.engine import Array, Engine
from sdfrender.field import Mapped
from sdfrender.flags import Flag
from sdfrender.latlong import angle
from sdfrender.rays import Beam
from sdfrender.vector import Vector, dot

Pair = tuple[Array, Array]
# J changes by half of this within its own pixel. Where that is 1 - 1/sqrt(2), a level of detail may be off by 1/2.
NONLINEAR_LIMIT = 2.0 - 2.0**0.5
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


def axes(xp: Engine, duv_dx: Pair, duv_dy: Pair, size: tuple[Array, Array]) -> tuple[Array, Array, Array]:
    """Return the ellipse that a pixel's unit circle becomes: see `ellipse`, of which this is the form for programs.

    The half axes are the singular values of J in texels, the lesser as |det J| over the greater; twice the angle is
    that of (S_uu - S_vv, 2 S_uv), S = J J^T.
    """
    ux, vx, uy, vy = duv_dx[0] * size[0], duv_dx[1] * size[1], duv_dy[0] * size[0], duv_dy[1] * size[1]
    uu, vv, uv = ux * ux + uy * uy, vx * vx + vy * vy, ux * vx + uy * vy
    half = 0.5 * (uu - vv)
    major = xp.sqrt(0.5 * (uu + vv) + xp.sqrt(half * half + uv * uv))
    minor = xp.abs(ux * vy - uy * vx) / xp.where(major > 0, major, 1.0)
    return major, minor, 0.5 * angle(xp, 2.0 * uv, uu - vv)


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


def nonlinearity(
    jacobian: Float[np.ndarray, "h w 2 2"], hit: Bool[np.ndarray, "h w"], chart: Int[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Return how much a picture's footprints differ from their neighbours', as a share of their own size.

    A linear footprint is the same in the next pixel. |J' - J| / |J| (Frobenius norms), the greatest over the four
    neighbours; those on another chart, or on nothing, cannot be compared.

    Parameters
    ----------
    jacobian
        (h, w, 2, 2): J = [duv/dx duv/dy] per pixel, in one unit all over.
    hit, chart
        (h, w): where there is a footprint, and on which chart.

    Returns
    -------
    share
        (h, w) float64; 0 where there is nothing to compare with.
    """
    size = np.linalg.norm(jacobian, axis=(2, 3))
    difference = np.zeros(hit.shape)
    for axis in (0, 1):
        low, high = _halves(axis, 0), _halves(axis, 1)
        step = np.linalg.norm(jacobian[high] - jacobian[low], axis=(2, 3))
        step = np.where(hit[low] & hit[high] & (chart[low] == chart[high]), step, 0.0)
        for half in (low, high):
            difference[half] = np.maximum(difference[half], step)
    return np.asarray(difference / np.maximum(size, SMALLEST))


def nonlinear(share: Float[np.ndarray, "h w"], limit: float = NONLINEAR_LIMIT) -> Int[np.ndarray, "h w"]:
    """Return the flag NONLINEAR where `nonlinearity` is above a share, 0 elsewhere."""
    return np.where(share > limit, int(Flag.NONLINEAR), 0)


def _halves(axis: int, first: int) -> tuple[slice, slice]:
    """Slice off the last (or the first) row or column."""
    cut = slice(first, None if first else -1)
    return (cut, slice(None)) if axis == 0 else (slice(None), cut)
