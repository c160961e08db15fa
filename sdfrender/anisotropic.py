"""The elliptical weighted average of a pyramid (Greene and Heckbert 1986).

In: texture coordinates and a footprint. Out: the colour under a Gaussian whose covariance is that of the footprint,
J J^T / 4 with J = [duv_dx duv_dy] in texels: half a pixel of standard deviation, what a trilinear look-up has at whole
levels (a box and a tent of one texel, 1/12 + 1/6). docs/textures.md derives the numbers.
"""

from math import exp
from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.texels import Colour, Look, Pair, Size, Texels

CUT = 5.0  # the Gaussian exp(-q / 2) ends at q / 2 = CUT, where it is lowered to 0
EDGE = exp(-CUT)
#: Variance per axis of exp(-q / 2) - EDGE over the disk, in units of the whole Gaussian's: 0.912.
KEPT = (1.0 - (1.0 + CUT + 0.5 * CUT**2) * EDGE) / (1.0 - (1.0 + CUT) * EDGE)
BOX = 1.0 / 12.0  # variance that a texel has already, being a mean over its area
FINEST = 0.5  # least variance of the minor axis in texels of the level that is read, and a quarter of the greatest
MOST_TEXELS = 1e9  # per pixel: the square of a variance of that is still a float32


class Pyramid(NamedTuple):
    """Which of the texels' levels are a pyramid: the number of the finest, and of the last.

    Above the finest by `kept` or more are those whose texels are there.
    """

    first: Array
    last: Array
    kept: Array | int = 0


class Moments(NamedTuple):
    """Covariance of a footprint: of its major axis, of its minor axis; and the unit vector along the major one."""

    major: Array
    minor: Array
    axis: Pair


class Reach(NamedTuple):
    """Where the ellipse's texels are: in columns, or in rows where it is higher than wide (`swapped`).

    `s, t` is the centre, texels along and across the columns; `first` the first column, `columns` their number,
    `count` the most texels in one; `slant` and `half` the slope of the columns' middles and the greatest half length;
    `a, b` the inverse variances along s, and along t from the middle.
    """

    swapped: Array
    s: Array
    t: Array
    first: Array
    columns: Array
    count: Array
    slant: Array
    half: Array
    a: Array
    b: Array


class _Sums(NamedTuple):
    """What a loop over texels carries: columns left, the texel in the column, sums of weights and of colours."""

    left: Array
    row: Array
    weight: tuple[Array, ...]
    colour: tuple[tuple[Array, ...], ...]


def elliptical(
    xp: Engine,
    texels: Texels,
    pyramid: Pyramid,
    uv: Pair,
    footprint: tuple[Pair, Pair],
    active: Array,
    *,
    most: float,
    linear: bool,
) -> Look:
    """Look up the mean over an ellipse.

    Where its major axis is two texels of the finest level or longer it is the ellipse's, where it is one or shorter the
    bilinear look-up, and a share of both between. The level is the one in which the minor axis has from sqrt(2) to
    2 sqrt(2) texels: finer than a trilinear look-up's, since the Gaussian has to suppress what the box lets pass.

    Parameters
    ----------
    xp, texels, pyramid
        What is read.
    uv, footprint
        Texture coordinates; duv_dx and duv_dy per pixel.
    active
        Who asks.
    most
        Greatest ratio of the axes: beyond it the minor one is widened.
    linear
        Whether linear functions come back exactly, see `average`.
    """
    finest = texels.size(xp, pyramid.first, active)
    found = moments(xp, *footprint, xp.real(finest.width), xp.real(finest.height))
    longest = 1.0 + 0.5 * xp.log2(xp.maximum(found.major, 1e-30))
    share = xp.minimum(xp.maximum(longest, 0.0), 1.0)
    widened = found.major * (1.0 / most**2)
    detail = 0.5 * xp.log2(xp.maximum(xp.maximum(found.minor, widened) * (1.0 / FINEST), 1e-30))
    top, least = xp.real(pyramid.last - pyramid.first), xp.real(pyramid.kept)
    level = pyramid.first + xp.integer(xp.minimum(xp.maximum(detail, least), top))
    wide, sharp = active & (share > 0), active & (share < 1)
    size = texels.size(xp, level, wide)
    mean = average(xp, texels, size, reach(xp, texels, uv, footprint, size, most), wide, linear=linear)
    plain = texels.bilinear(xp, *uv, pyramid.first + pyramid.kept, sharp)
    colour = tuple(xp.where(share < 1, xp.fma(share, a - b, b), a) for a, b in zip(mean, plain, strict=True))
    return Look(colour, active & (longest < 0), wide & (detail >= top + 1.0), wide & (found.minor < widened))


def moments(xp: Engine, duv_dx: Pair, duv_dy: Pair, width: Array, height: Array) -> Moments:
    """Return the covariance of a footprint in texels, x to the right, y down.

    The minor axis comes from the Jacobian's determinant: the difference of two large variances would have no digits.
    """

    def texels(value: Array, count: Array) -> Array:
        return xp.minimum(xp.maximum(0.5 * value * count, -MOST_TEXELS), MOST_TEXELS)

    a, c = texels(duv_dx[0], width), texels(duv_dy[0], width)
    b, d = texels(-duv_dx[1], height), texels(-duv_dy[1], height)
    xx, yy, xy = a * a + c * c, b * b + d * d, a * b + c * d
    half = 0.5 * (xx - yy)
    root = xp.sqrt(half * half + xy * xy)
    major = 0.5 * (xx + yy) + root
    area = a * d - b * c
    minor = xp.where(major > 0, area / xp.where(major > 0, major, 1.0) * area, 0.0)
    x, y = xp.where(half > 0, root + half, xy), xp.where(half > 0, xy, root - half)
    length = xp.sqrt(x * x + y * y)
    known = length > 0
    inverse = 1.0 / xp.where(known, length, 1.0)
    return Moments(major, minor, (xp.where(known, x * inverse, 1.0), y * inverse))


def reach(xp: Engine, texels: Texels, uv: Pair, footprint: tuple[Pair, Pair], size: Size, most: float) -> Reach:
    """Return what of a level the ellipse covers; its axes are bounded here, so the number of texels is."""
    found = moments(xp, *footprint, xp.real(size.width), xp.real(size.height))
    highest = 4.0 * FINEST
    minor = xp.minimum(xp.maximum(found.minor, found.major * (1.0 / most**2)), highest)
    major = xp.minimum(found.major, highest * most**2)
    minor, major = (xp.maximum(value - BOX, FINEST - BOX) * (1.0 / KEPT) for value in (minor, major))
    major = xp.maximum(major, minor)
    ex, ey = found.axis
    more = major - minor
    xx, yy, xy = xp.fma(more, ex * ex, minor), xp.fma(more, ey * ey, minor), more * (ex * ey)
    x, y = texels.place(xp, *uv, size)
    swapped = yy > xx
    ss = xp.where(swapped, yy, xx)
    inverse = 1.0 / ss
    across = major * minor * inverse
    s, t = xp.where(swapped, y, x), xp.where(swapped, x, y)
    along, half = xp.sqrt(2.0 * CUT * ss), xp.sqrt(2.0 * CUT * across)
    first = xp.integer(-xp.floor(along - s))
    columns = xp.integer(xp.floor(s + along)) - first + 1
    count = xp.integer(xp.floor(2.0 * half)) + 1
    return Reach(swapped, s, t, first, columns, count, xy * inverse, half, inverse, 1.0 / across)


def average(xp: Engine, texels: Texels, size: Size, reach: Reach, active: Array, *, linear: bool) -> Colour:
    """Return the weighted mean over the ellipse's texels.

    Parameters
    ----------
    xp, texels, size, reach, active
        What is read, and who asks; 0 for the others.
    linear
        Whether linear functions come back exactly: the weights w become w (1 + c . d), d from the centre, with the c
        that makes the weights' mean the centre.
    """

    def add(sums: _Sums, constants: tuple[Reach, Size]) -> _Sums:
        reach, size = constants
        column = reach.first + sums.left - 1
        ds = xp.real(column) - reach.s
        middle = xp.fma(reach.slant, ds, reach.t)
        row = xp.integer(-xp.floor(reach.half - middle)) + sums.row
        dt = xp.real(row) - middle
        q = 0.5 * xp.fma(ds * ds, reach.a, dt * dt * reach.b)
        inside = q < CUT
        w = xp.where(inside, gaussian(xp, q) - EDGE, 0.0)
        x, y = xp.where(reach.swapped, row, column), xp.where(reach.swapped, column, row)
        basis: tuple[Array, ...] = (w, w * ds, w * dt) if linear else (w,)
        weight = (*basis, w * ds * ds, w * ds * dt, w * dt * dt) if linear else basis
        colour = tuple(
            _added(xp, totals, basis, value)
            for totals, value in zip(sums.colour, texels.texel(xp, x, y, size, inside), strict=True)
        )
        last = sums.row + 1 >= reach.count
        left, row = xp.where(last, sums.left - 1, sums.left), xp.where(last, 0, sums.row + 1)
        return _Sums(left, row, tuple(a + b for a, b in zip(sums.weight, weight, strict=True)), colour)

    terms = 3 if linear else 1
    weight = tuple(xp.full(reach.s, 0.0) for _ in range(6 if linear else 1))
    colour = tuple(tuple(xp.full(reach.s, 0.0) for _ in range(terms)) for _ in range(texels.channels))
    start = _Sums(xp.where(active, reach.columns, 0), xp.full(reach.columns, 0), weight, colour)
    return _mean(xp, xp.while_loop(lambda sums: sums.left > 0, add, start, (reach, size)))


def _added(xp: Engine, totals: tuple[Array, ...], basis: tuple[Array, ...], value: Array) -> tuple[Array, ...]:
    return tuple(xp.fma(part, value, total) for total, part in zip(totals, basis, strict=True))


def _mean(xp: Engine, sums: _Sums) -> Colour:
    """Divide by the weights, corrected where their moments are known: c = -M2^-1 M1."""
    total, *rest = sums.weight
    if not rest:
        inverse = 1.0 / xp.where(total > 0, total, 1.0)
        return tuple(value[0] * inverse for value in sums.colour)
    s, t, ss, st, tt = rest
    area = ss * tt - st * st
    inverse = 1.0 / xp.where(area > 0, area, 1.0)
    cs, ct = (st * t - tt * s) * inverse, (st * s - ss * t) * inverse
    corrected = total + cs * s + ct * t
    inverse = 1.0 / xp.where(corrected > 0, corrected, 1.0)
    return tuple((value[0] + cs * value[1] + ct * value[2]) * inverse for value in sums.colour)


def gaussian(xp: Engine, q: Array) -> Array:
    """Return exp(-q) for q from 0 to CUT, to 6e-11 relative: the 16th power of a Taylor polynomial of q / 16."""
    z = q * (-1.0 / 16.0)
    value = xp.full(z, 1.0 / 362880.0)
    for factorial in (40320.0, 5040.0, 720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0):
        value = xp.fma(value, z, 1.0 / factorial)
    for _ in range(4):
        value = value * value
    return value
