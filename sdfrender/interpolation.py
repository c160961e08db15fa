"""The interpolant of a cell and its derivatives (Galim 2018, eq. 10, 14, 18).

In: the coefficients behind a cell and places in it, 0 to 1 along each axis. Out: value, gradient, Hessian per cell
width.
"""

from typing import Any

from sdfbake.engine import Array, Engine
from sdfrender.kernels import Kernel
from sdfrender.vector import Vector

# Which derivative of each axis' weights makes which entry of a jet.
_ORDERS = {
    0: ((0, 0, 0),),
    1: ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    2: ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (1, 0, 1), (0, 1, 1)),
}


def contract(xp: Engine, kernel: Kernel, taps: list[Array], u: Vector, order: int) -> list[Array]:
    """Sum the taps with the weights and their derivatives, one axis after the other (Galim 2018, eq. 10, 14, 18)."""
    n = kernel.taps
    weights = [[_weights(xp, kernel, u[axis], o) for o in range(order + 1)] for axis in range(3)]
    wanted = _ORDERS[order]
    lines = sorted({(y, z) for _, y, z in wanted})
    totals: dict[tuple[int, int, int], Array] = {}
    for i in range(n):
        plane: dict[tuple[int, int], Array] = {}
        for j in range(n):
            row = taps[(i * n + j) * n : (i * n + j + 1) * n]
            along_z = [_sum(xp, row, weights[2][o]) for o in range(order + 1)]
            for y, z in lines:
                _add(xp, plane, (y, z), along_z[z], weights[1][y][j])
        for x, y, z in wanted:
            _add(xp, totals, (x, y, z), plane[y, z], weights[0][x][i])
    return [totals[key] for key in wanted]


def _add(xp: Engine, sums: dict[Any, Array], key: tuple[int, ...], value: Array, weight: Array) -> None:
    """Accumulate into a caller's own dictionary."""
    sums[key] = xp.fma(value, weight, sums[key]) if key in sums else value * weight


def _sum(xp: Engine, values: list[Array], weights: list[Array]) -> Array:
    total = values[0] * weights[0]
    for value, weight in zip(values[1:], weights[1:], strict=True):
        total = xp.fma(value, weight, total)
    return total


def _weights(xp: Engine, kernel: Kernel, u: Array, order: int) -> list[Array]:
    """Evaluate every tap's weight, or a derivative of it, by Horner's rule."""
    values = []
    for row in kernel.derivative(order).tolist():
        value = xp.full(u, float(row[-1]))
        for coefficient in reversed(row[:-1]):
            value = value * u + float(coefficient)
        values.append(value)
    return values
