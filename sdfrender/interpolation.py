"""The interpolant of a cell and its derivatives (Galim 2018, eq. 10, 14, 18).

In: the coefficients behind a cell and places in it, 0 to 1 along each axis. Out: value, gradient, Hessian per cell
width.
"""

from sdfbake.engine import Array, Engine
from sdfbake.engine.cube import orders
from sdfrender.kernels import Kernel
from sdfrender.vector import Vector

# Which derivative of each axis' weights makes which entry of a jet.
_ORDERS = {
    0: ((0, 0, 0),),
    1: ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    2: ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (1, 0, 1), (0, 1, 1)),
}


def contract(xp: Engine, kernel: Kernel, taps: Array, u: Vector, order: int) -> list[Array]:
    """Sum the taps with the weights and their derivatives, one axis after the other (Galim 2018, eq. 10, 14, 18)."""
    weights = [[_weights(xp, kernel, u[axis], o) for o in range(order + 1)] for axis in range(3)]
    sums = dict(zip(orders(order + 1), xp.by_order(taps, weights), strict=True))
    return [sums[key] for key in _ORDERS[order]]


def _weights(xp: Engine, kernel: Kernel, u: Array, order: int) -> list[Array]:
    """Evaluate every tap's weight, or a derivative of it, by Horner's rule."""
    values = []
    for row in kernel.derivative(order).tolist():
        value = xp.full(u, float(row[-1]))
        for coefficient in reversed(row[:-1]):
            value = value * u + float(coefficient)
        values.append(value)
    return values
