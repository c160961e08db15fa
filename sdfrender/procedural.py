"""A texture without texels: a checker, whose mean over a footprint is known in closed form.

In: texture coordinates with their footprint. Out: the colour; nothing is clamped.
"""

from sdfbake.engine import Array, Engine
from sdfrender.texels import Look, Pair

Shade = tuple[float, float, float]
WIDEST = 1e6  # squares: the mean of more differs from grey by less than a millionth


class Checker:
    """Squares of two colours, without end.

    Parameters
    ----------
    colours
        Linear light: of the square at the origin of texture coordinates, and of its neighbours.
    squares
        How many fit between 0 and 1 along u and v. They stand for texels where a level of detail is recorded.
    """

    needs_footprint = True

    def __init__(self, colours: tuple[Shade, Shade], squares: tuple[int, int]) -> None:
        self.colours, self.size = colours, squares

    def look_up(self, xp: Engine, u: Array, v: Array, footprint: tuple[Pair, Pair] | None, active: Array) -> Look:
        """Return the mean over the box around the pixel's parallelogram; see `sdfrender.sampler.Sampler.look_up`.

        The box has the sides |du_dx| + |du_dy| and |dv_dx| + |dv_dy|: the pixel itself where its sides run along u
        and v, and wider where it lies aslant. The pattern is a product of square waves, so its mean is one of means.
        """
        assert footprint is not None
        (du_dx, dv_dx), (du_dy, dv_dy) = footprint
        across, up = (xp.uniform(float(count)) for count in self.size)
        balance = _square_wave(xp, u * across, (xp.abs(du_dx) + xp.abs(du_dy)) * across)
        balance = balance * _square_wave(xp, v * up, (xp.abs(dv_dx) + xp.abs(dv_dy)) * up)
        share = 0.5 - 0.5 * balance
        pairs = zip(*self.colours, strict=True)
        colour = tuple(xp.fma(share, xp.uniform(float(b - a)), xp.uniform(float(a))) for a, b in pairs)
        never = xp.full(u, False)
        return Look(colour, never, never, never)


def _square_wave(xp: Engine, x: Array, width: Array) -> Array:
    """Return the mean of the wave, 1 from 0 to 1, -1 from 1 to 2 and so on, over an interval around x.

    An interval shorter than 1 has one edge at most, and the mean follows from the distance to it. Of a longer one it is
    the difference of the integral, the distance from the nearest even number.
    """
    width = xp.minimum(width, WIDEST)
    square = xp.floor(x)
    side = 1.0 - 2.0 * (square - 2.0 * xp.floor(0.5 * square))
    edge = xp.abs(x - xp.floor(x + 0.5))
    near = side * xp.minimum(2.0 * edge / xp.maximum(width, 1e-30), 1.0)

    def integral(x: Array) -> Array:
        return xp.abs(x - 2.0 * xp.floor(0.5 * x + 0.5))

    far = (integral(x + 0.5 * width) - integral(x - 0.5 * width)) / xp.maximum(width, 1.0)
    return xp.where(width < 1.0, near, far)
