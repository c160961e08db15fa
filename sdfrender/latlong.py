"""Directions on a latitude-longitude picture, and how fast they move there.

In: unit directions with their derivatives, world frame. Out: u = 1/2 + atan2(x, -z) / (2 pi), v = 1/2 + latitude / pi.
The picture is what an eye in the middle sees: y is up, -z in the picture's middle, x a quarter to the right of it.
"""

from math import pi
from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.texels import Pair
from sdfrender.vector import Vector

POLE = 1e-12  # from the axis: there a direction has no longitude, and -z's is as good as any
STEEPEST = 1e12  # turns per pixel: their squares in texels are still float32


class Turn(NamedTuple):
    """A footprint on the picture: duv_dx, duv_dy; and whether it was cut to one turn."""

    duv_dx: Pair
    duv_dy: Pair
    cut: Array


def place(xp: Engine, d: Vector) -> Pair:
    """Return u and v, both in [0, 1]."""
    x, y, z = d
    u = xp.fma(angle(xp, x, -z), 0.5 / pi, 0.5)
    return u, xp.fma(angle(xp, y, xp.sqrt(x * x + z * z)), 1.0 / pi, 0.5)


def footprint(xp: Engine, d: Vector, dd_dx: Vector, dd_dy: Vector) -> Turn:
    """Return the derivatives of `place`, exactly.

    With r^2 = x^2 + z^2: dlongitude = (x dz - z dx) / r^2, dlatitude = (r dy - y dr) / (r^2 + y^2), dr = (x dx + z dz)
    / r. Towards a pole the former grows without bound; no pixel is wider than a turn, so both derivatives of u are
    divided by the greater one if that is above 1.
    """
    x, y, z = d
    r = xp.sqrt(x * x + z * z)
    off = r > POLE
    inverse = 1.0 / xp.where(off, r, POLE)
    cx, cz = xp.where(off, x * inverse, 0.0), xp.where(off, z * inverse, -1.0)
    scale = 1.0 / xp.maximum(r * r + y * y, POLE)

    def derivative(dd: Vector) -> Pair:
        du = (cx * dd[2] - cz * dd[0]) * inverse * (0.5 / pi)
        dv = (r * dd[1] - y * (cx * dd[0] + cz * dd[2])) * scale * (1.0 / pi)
        return xp.minimum(xp.maximum(du, -STEEPEST), STEEPEST), xp.minimum(xp.maximum(dv, -STEEPEST), STEEPEST)

    (ux, vx), (uy, vy) = derivative(dd_dx), derivative(dd_dy)
    greatest = xp.maximum(xp.abs(ux), xp.abs(uy))
    share = 1.0 / xp.maximum(greatest, 1.0)
    return Turn((ux * share, vx), (uy * share, vy), greatest > 1.0)


def angle(xp: Engine, y: Array, x: Array) -> Array:
    """Return atan2(y, x), to a few roundings; 0 where both are 0.

    The ratio of the lesser to the greater is an angle up to pi / 4; halved twice, it is small enough for the series up
    to the 21st power, whose rest is 2e-17 of it.
    """
    across, along = xp.abs(y), xp.abs(x)
    greatest = xp.maximum(across, along)
    z = xp.minimum(across, along) / xp.where(greatest > 0, greatest, 1.0)
    for _ in range(2):
        z = z / (1.0 + xp.sqrt(xp.fma(z, z, 1.0)))
    squared = z * z
    series = xp.full(z, 1.0 / 21.0)
    for power in range(19, 0, -2):
        series = xp.fma(series, -squared, 1.0 / power)
    turned = 4.0 * z * series
    turned = xp.where(across > along, 0.5 * pi - turned, turned)
    turned = xp.where(x < 0, pi - turned, turned)
    return xp.where(y < 0, -turned, turned)
