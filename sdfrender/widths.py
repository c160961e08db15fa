"""How wide the footprint of a ray is across it.

In: a beam, or how a ray spreads. Out: the lesser singular value of its two pixel steps, at two places of the ray, and 0
if it passes a focus between them. `sdfrender.leveled` chooses by it.
"""

from sdfbake.engine import Array, Engine
from sdfrender.field import Spread
from sdfrender.rays import Beam
from sdfrender.vector import Vector, along, cross, dot, scale, subtract

_TINY = 1e-37  # of a square: above what underflows in single precision


def spreading(beam: Beam, begin: Array) -> Spread:
    """Return how footprints grow from where beams are; their derivatives are of a place `begin` behind."""
    dp_dx, dp_dy = along(beam.dp_dx, beam.dd_dx, begin), along(beam.dp_dy, beam.dd_dy, begin)
    return Spread(dp_dx, dp_dy, beam.dd_dx, beam.dd_dy)


def least_width(xp: Engine, d: Vector, spread: Spread, near: Array, far: Array) -> Array:
    """Return how narrow footprints are between two places of rays: at these, and 0 if there is a focus between them.

    The lesser singular value of a footprint is its area over the greater one. Its signed area d . (q_x x q_y), with the
    pixel steps q = dp + t dd, is a quadratic of t, whose roots are the foci.

    Parameters
    ----------
    xp
        The engine.
    d
        Directions of any length.
    spread
        How rays spread from where t is 0.
    near, far
        Parameters of the two places, near first.
    """
    dp_dx, dp_dy, dd_dx, dd_dy = spread
    a, c = dot(d, cross(dp_dx, dp_dy)), dot(d, cross(dd_dx, dd_dy))
    b = dot(d, cross(dp_dx, dd_dy)) + dot(d, cross(dd_dx, dp_dy))
    squared = dot(d, d)
    areas = [a + t * (b + t * c) for t in (near, far)]
    widths = [
        xp.abs(area) / xp.sqrt(xp.maximum(squared * _longest(xp, d, squared, spread, t), _TINY))
        for area, t in zip(areas, (near, far), strict=True)
    ]
    turn = -b / xp.where(xp.abs(c) > 0, 2.0 * c, 1.0)
    between = (turn > near) & (turn < far) & ((a + turn * (b + turn * c) > 0) != (areas[0] > 0))
    focus = between | ((areas[0] > 0) != (areas[1] > 0))
    return xp.where(focus, 0.0, xp.minimum(*widths))


def _longest(xp: Engine, d: Vector, squared: Array, spread: Spread, t: Array) -> Array:
    """Return the square of a footprint's greater singular value, across the ray."""
    steps = along(spread.dp_dx, spread.dd_dx, t), along(spread.dp_dy, spread.dd_dy, t)
    x, y = (subtract(q, scale(d, dot(q, d) / squared)) for q in steps)
    xx, yy, xy = dot(x, x), dot(y, y), dot(x, y)
    half = 0.5 * (xx - yy)
    return 0.5 * (xx + yy) + xp.sqrt(half * half + xy * xy)
