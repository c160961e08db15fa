"""Sums over the taps of a cube, by the weights of its three axes.

In: n^3 taps, z fastest, and for every axis its weights `weights[order][tap]`. Out: for the orders x, y, z of the axes'
weights the sum over i, j, k of taps[i, j, k] weights_x[x][i] weights_y[y][j] weights_z[z][k], one axis after the other:
`by_order` each of them, `by_degree` added up where x + y + z is the same, as in a product of polynomials.
"""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import chain
from typing import NamedTuple

import numpy as np

from sdfbake.engine.protocol import Array, Weights

_LANES = 1024  # at once: half a megabyte of cubes
# Sums by order are always made for so many, the others with weights of 0: which digits of an entry rounding leaves must
# not depend on what else is asked for.
MOST_ORDERS = 3
_ROWS = 64  # lanes to a matrix product: BLAS starts threads of its own for larger ones, and ours are busy


def orders(count: int) -> list[tuple[int, int, int]]:
    """Return all (x, y, z) with x + y + z < count, x slowest."""
    every = range(count)
    return [(x, y, z) for x in every for y in every for z in every if x + y + z < count]


def by_order(fma: Callable[..., Array], taps: Sequence[Array], weights: Weights) -> list[Array]:
    """Return the sums for every (x, y, z) of `orders(len(weights[0]))`, for arrays of any kind."""
    wanted, n = orders(len(weights[0])), len(weights[0][0])
    totals: dict[tuple[int, int, int], Array] = {}
    for i in range(n):
        planes: dict[tuple[int, int], Array] = {}
        for j in range(n):
            lines = _lines(fma, taps[(i * n + j) * n : (i * n + j + 1) * n], weights[2])
            for y, z in sorted({(y, z) for _, y, z in wanted}):
                planes[y, z] = _added(fma, planes.get((y, z)), lines[z], weights[1][y][j])
        for x, y, z in wanted:
            totals[x, y, z] = _added(fma, totals.get((x, y, z)), planes[y, z], weights[0][x][i])
    return [totals[order] for order in wanted]


def by_degree(fma: Callable[..., Array], taps: Sequence[Array], weights: Weights) -> list[Array]:
    """Return the sums over all (x, y, z) with x + y + z = 0, 1, 2 and so on, for arrays of any kind."""
    count, n = len(weights[0]), len(weights[0][0])
    whole: list[Array | None] = [None] * (3 * count - 2)
    for i in range(n):
        plane: list[Array | None] = [None] * (2 * count - 1)
        for j in range(n):
            lines = _lines(fma, taps[(i * n + j) * n : (i * n + j + 1) * n], weights[2])
            for y in range(count):
                for z, line in enumerate(lines):
                    plane[y + z] = _added(fma, plane[y + z], line, weights[1][y][j])
        for x in range(count):
            for rest, value in enumerate(plane):
                whole[x + rest] = _added(fma, whole[x + rest], value, weights[0][x][i])
    return whole


def _lines(fma: Callable[..., Array], row: Sequence[Array], weights: Sequence[Sequence[Array]]) -> list[Array]:
    """Return the sums along z, by order."""
    sums = []
    for of_order in weights:
        total = None
        for tap, weight in zip(row, of_order, strict=True):
            total = _added(fma, total, tap, weight)
        sums.append(total)
    return sums


def _added(fma: Callable[..., Array], total: Array | None, value: Array, weight: Array) -> Array:
    return value * weight if total is None else fma(value, weight, total)


class Cubes(NamedTuple):
    """NumPy's cubes that are yet to be looked up: `all[place]`, (n, n, n) each."""

    all: np.ndarray
    place: np.ndarray


def in_matrices(taps: Cubes | Sequence[np.ndarray], weights: Weights, *, degrees: bool) -> list[np.ndarray]:
    """Return `by_degree` or `by_order` of NumPy's arrays: three small matrix products for every lane.

    Some lanes after others, so that what is between the products stays in the cache.
    """
    cubes = taps if isinstance(taps, Cubes) else Cubes(np.stack(taps, axis=-1), np.arange(len(taps[0])))
    asked, width = len(weights[0]), len(cubes.place)
    if not degrees:
        weights = [[*axis, *([np.zeros(width)] * len(axis[0]) for _ in range(MOST_ORDERS - asked))] for axis in weights]
    count = len(weights[0])
    chosen = _chosen(count, asked, degrees).astype(cubes.all.dtype)
    out = np.empty((chosen.shape[1], width), cubes.all.dtype)
    x, *others = weights
    rows = list(chain(*x, *chain.from_iterable(zip(*axis, strict=True) for axis in others)))
    for start in range(0, width, _LANES):
        part = slice(start, start + _LANES)
        out[:, part] = _summed(cubes.all[cubes.place[part]], [row[part] for row in rows], count, chosen).T
    return list(out)


def _summed(cubes: np.ndarray, rows: list[np.ndarray], count: int, chosen: np.ndarray) -> np.ndarray:
    """Return sums, (lanes, entries); `rows` are the weights of x by order and tap, of y and z by tap and order."""
    width = len(cubes)
    n = len(rows) // (3 * count)
    # Row after row and then turned: several times as fast as column after column.
    flat = np.empty((len(rows), width), cubes.dtype)
    for row, weight in zip(flat, rows, strict=True):
        row[...] = weight
    turned = np.ascontiguousarray(flat.T).reshape(width, 3, -1)
    by_x, by_y, by_z = turned[:, 0].reshape(-1, count, n), *(turned[:, a].reshape(-1, n, count) for a in (1, 2))
    sums = by_x @ cubes.reshape(width, n, n * n)
    sums = sums.reshape(width, count * n, n) @ by_z
    sums = np.ascontiguousarray(sums.reshape(width, count, n, count).swapaxes(2, 3))
    whole = np.zeros((-(-width // _ROWS), _ROWS, count**3), cubes.dtype)
    np.matmul(sums.reshape(width, -1, n), by_y, out=whole.reshape(-1, count * count, count)[:width])
    entries: np.ndarray = whole @ chosen
    return entries.reshape(-1, chosen.shape[1])[:width]


@cache
def _chosen(count: int, asked: int, degrees: bool) -> np.ndarray:
    """Return which sums, by (x, z, y), are added up to an entry of the result; of orders only those asked for."""
    x, z, y = np.indices((count,) * 3).reshape(3, -1)
    chosen: np.ndarray
    if degrees:
        chosen = np.equal.outer(x + y + z, np.arange(3 * count - 2))
    else:
        wanted = np.array(orders(asked)).T
        chosen = np.equal.outer(x, wanted[0]) & np.equal.outer(y, wanted[1]) & np.equal.outer(z, wanted[2])
    return chosen
