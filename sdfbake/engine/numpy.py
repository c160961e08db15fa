"""The NumPy engine: always there, float64 by default, the reference.

Programs run on tiles of rays over a pool of threads (NumPy releases the interpreter lock in its loops); loops compact
the rays that are still alive.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided

from sdfbake.engine import cube
from sdfbake.engine.pairs import Pairs, over_tiles
from sdfbake.engine.protocol import Array, Lists, Measures, Program, State, Weights
from sdfbake.engine.tree import leaves, rebuild

TILE = 131072  # rays: a megabyte per float64 array; with half as many, two threads took 1.3 times as long
WORTH = 0.75  # of a loop's lanes alive: with fewer, those are taken out; sooner, that costs more than it saves


def _taken(tree: State, rows: np.ndarray) -> State:
    """Return the rows of all arrays; the arrays themselves where that is all rows."""
    flat = leaves(tree)
    return tree if not flat or len(flat[0]) == rows.size else rebuild(tree, [leaf.take(rows) for leaf in flat])


@dataclass(frozen=True, slots=True)
class NumpyEngine:
    """Programs as plain NumPy."""

    precision: int = 64
    name: str = "numpy"

    @property
    def float_type(self) -> type[np.floating[Any]]:
        """The float type of the arrays."""
        return np.float64 if self.precision == 64 else np.float32

    @property
    def eps(self) -> float:
        """Distance from 1 to the next float."""
        return float(np.finfo(self.float_type).eps)

    def run(self, program: Program, inputs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Run a program in tiles; see `Engine.run`."""
        columns = [self.table(column) for column in inputs]
        count = len(columns[0])
        if count == 0:  # a program cannot be asked for the names of its outputs without a ray
            one = [np.zeros(1, column.dtype) for column in columns]
            return {name: value[:0] for name, value in self._tile(program, one, 0).items()}
        starts = range(0, count, TILE)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            tiles = list(pool.map(lambda start: self._tile(program, columns, start), starts))
        return {name: np.concatenate([tile[name] for tile in tiles]) for name in tiles[0]}

    def _tile(self, program: Program, columns: list[np.ndarray], start: int) -> dict[str, np.ndarray]:
        part = [column[start : start + TILE] for column in columns]
        with np.errstate(all="ignore"):  # rays that are masked out compute whatever they like
            return {name: np.asarray(value) for name, value in program(self, *part).items()}

    def table(self, values: np.ndarray) -> Array:
        """Make a look-up table; see `Engine.table`."""
        values = np.asarray(values)
        if values.dtype == np.uint8:
            return np.ascontiguousarray(values).ravel()
        kind = self.float_type if values.dtype.kind == "f" else np.int32
        return np.ascontiguousarray(values, kind).ravel()

    def uniform(self, value: float | int) -> Array:
        """Return the number itself."""
        return value

    def gather(self, table: Array, index: Array, active: Array) -> Array:
        """Look up a table; see `Engine.gather`."""
        # Whatever inactive lanes ask for is clipped; 64-bit indices spare `take` a slower conversion of its own.
        found = table.take(np.asarray(index, np.intp), mode="clip")
        return found.astype(np.int32) if table.dtype == np.uint8 else found

    def stencil(self, table: Array, base: Array, size: int, width: int, active: Array) -> Array:
        """Say where cubes are; see `Engine.stencil`."""
        span = (size - 1) * (width * width + width + 1)
        steps = np.multiply(table.itemsize, (1, width * width, width, 1))
        cubes = as_strided(table, (len(table) - span, size, size, size), steps, writeable=False)
        return cube.Cubes(cubes, np.where(active, base, 0))

    def by_order(self, taps: Array, weights: Weights) -> Sequence[Array]:
        """Sum over a cube; see `Engine.by_order`."""
        return cube.in_matrices(taps, weights, degrees=False)

    def by_degree(self, taps: Array, weights: Weights) -> Sequence[Array]:
        """Sum over a cube; see `Engine.by_degree`."""
        return cube.in_matrices(taps, weights, degrees=True)

    def where(self, mask: Array, yes: Array, no: Array) -> Array:
        """Choose by mask."""
        return np.where(mask, yes, no)

    def fma(self, a: Array, b: Array, c: Array) -> Array:
        """Return a * b + c (rounded twice: NumPy has no fused form)."""
        return a * b + c

    def sqrt(self, x: Array) -> Array:
        """Return the square root."""
        return np.sqrt(x)

    def log2(self, x: Array) -> Array:
        """Return the binary logarithm."""
        return np.log2(x)

    def floor(self, x: Array) -> Array:
        """Round down."""
        return np.floor(x)

    def abs(self, x: Array) -> Array:
        """Return the magnitude."""
        return np.abs(x)

    def minimum(self, a: Array, b: Array) -> Array:
        """Return the lesser of two."""
        return np.minimum(a, b)

    def maximum(self, a: Array, b: Array) -> Array:
        """Return the greater of two."""
        return np.maximum(a, b)

    def least(self, arrays: Sequence[Array]) -> Array:
        """Return the least of several."""
        return reduce(np.minimum, arrays)

    def most(self, arrays: Sequence[Array]) -> Array:
        """Return the greatest of several."""
        return reduce(np.maximum, arrays)

    def integer(self, x: Array) -> Array:
        """Truncate to int32; what does not fit becomes something (rays that are masked out)."""
        return np.asarray(x).astype(np.int32)

    def real(self, x: Array) -> Array:
        """Turn integers into floats."""
        return np.asarray(x, self.float_type)

    def full(self, like: Array, value: float | int | bool) -> Array:
        """Make an array of one value."""
        kind = bool if isinstance(value, bool) else np.int32 if isinstance(value, int) else self.float_type
        return np.full(like.shape, value, kind)

    def while_loop(
        self,
        condition: Callable[[State], Array],
        body: Callable[[State, Any], State],
        state: State,
        constants: Any = (),
    ) -> State:
        """Repeat the body on the rays that still want it; see `Engine.while_loop`."""
        result = [np.array(leaf) for leaf in leaves(state)]
        alive = np.flatnonzero(condition(state))
        current, fixed, live = _taken(state, alive), _taken(constants, alive), np.full(alive.size, True)
        while alive.size:
            current = body(current, fixed)
            going = condition(current) & live
            count = np.count_nonzero(going)
            if count == alive.size:
                continue
            done = np.flatnonzero(live & ~going)
            for whole, part in zip(result, leaves(current), strict=True):
                whole[alive[done]] = part[done]
            live = going
            if count < WORTH * alive.size:  # those that are done may run along, but nobody looks at them
                kept = np.flatnonzero(going)
                current, fixed, alive, live = _taken(current, kept), _taken(fixed, kept), alive[kept], live[kept]
        return rebuild(state, result)

    def among(self, active: Array, body: Callable[[State], State], state: State) -> State:
        """Run the body on the active lanes alone; see `Engine.among`."""
        rows = np.flatnonzero(active)
        if rows.size in (0, len(active)):
            return body(state) if rows.size else state
        whole = leaves(state)
        part = [leaf.take(rows) for leaf in whole]
        merged = []
        for old, given, new in zip(whole, part, leaves(body(rebuild(state, part))), strict=True):
            merged.append(old if new is given else old.copy())
            if new is not given:
                merged[-1][rows] = new
        return rebuild(state, merged)

    def at(self, precision: int) -> "NumpyEngine":
        """Return the engine of another precision; see `Engine.at`."""
        return NumpyEngine(precision)

    def lanes(self, count: int) -> Array:
        """Return the integers from 0."""
        return np.arange(count, dtype=np.int32)

    def rows(self, table: Array, index: Array, active: Array) -> tuple[Array, Array, Array, Array]:
        """Look up rows of four; see `Engine.rows`."""
        row = table.reshape(-1, 4).take(np.asarray(index, np.intp), axis=0, mode="clip")
        return row[:, 0], row[:, 1], row[:, 2], row[:, 3]

    def kept(self, mask: Array) -> Array:
        """Return the lanes where a mask holds."""
        return np.flatnonzero(mask).astype(np.int32)

    def first_least(
        self, lists: Lists, lane: Sequence[Array], measure: Measures, tie: Callable[[Array], Array]
    ) -> tuple[Array, ...]:
        """Reduce lists; see `Engine.first_least`."""

        def first(pairs: Pairs) -> list[np.ndarray]:
            found = []
            for values in pairs.measured(measure):
                least = pairs.least(values)
                equal = values <= (least + tie(least))[pairs.owner]
                found.append(pairs.item[pairs.least(np.where(equal, np.arange(len(values)), len(values)))])
            return found

        return tuple(np.concatenate(parts) for parts in zip(*over_tiles(lists, lane, first), strict=True))

    def interleaved(self, arrays: Sequence[Array]) -> Array:
        """Mix arrays lane by lane."""
        return np.stack(arrays, axis=-1).reshape(-1)

    def narrowed(self, lists: Lists, lane: Sequence[Array], within: Measures) -> Lists:
        """Filter lists; see `Engine.narrowed`."""

        def filtered(pairs: Pairs) -> list[tuple[np.ndarray, np.ndarray]]:
            counted = len(pairs.first)
            return [
                (pairs.item[good], np.bincount(pairs.owner[good], minlength=counted).astype(np.int32))
                for good in pairs.measured(within)
            ]

        ways = list(zip(*over_tiles(lists, lane, filtered), strict=True))
        items = np.concatenate([part[0] for way in ways for part in way])
        counts = [np.concatenate([part[1] for part in way]) for way in ways]
        ends = np.cumsum(np.concatenate(counts), dtype=np.int32).reshape(len(ways), -1)
        starts = [end - count for end, count in zip(ends, counts, strict=True)]
        return Lists(self.interleaved(starts), self.interleaved(counts), items)

    def scattered(self, size: int, fill: float | int, place: Array, value: Array, active: Array) -> Array:
        """Put values in their places; see `Engine.scattered`."""
        whole = np.full(size, fill, np.int32 if isinstance(fill, int) else self.float_type)
        whole[place[active]] = value[active]
        return whole

    def replaced(self, whole: Array, place: Array, value: Array) -> Array:
        """Replace entries in a copy; see `Engine.replaced`."""
        whole = whole.copy()
        whole[place] = value
        return whole

    def tabulated(self, count: int, rows: Callable[[Array], Sequence[Sequence[Array]]]) -> tuple[Array, ...]:
        """Fill tables tile by tile; see `Engine.tabulated`."""

        def tile(start: int) -> list[np.ndarray]:
            with np.errstate(all="ignore"):  # lanes that are masked out compute whatever they like
                found = rows(np.arange(start, min(start + TILE, count), dtype=np.int32))
            return [np.stack(row, axis=-1).reshape(-1) for row in found]

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            tiles = list(pool.map(tile, range(0, count, TILE)))
        return tuple(np.concatenate(parts) for parts in zip(*tiles, strict=True))

    def joined(self, parts: Sequence[Array]) -> Array:
        """Return arrays one after the other."""
        return np.concatenate(parts)

    def extremes(self, values: Array) -> tuple[float, float]:
        """Return the least and the greatest."""
        return float(values.min()), float(values.max())

    def settled(self, *arrays: Array) -> None:
        """Do nothing: arrays are computed as they are described."""

    def apart(self, active: Array, body: Callable[[State], State], state: State) -> State:
        """Run the body on the active lanes; see `Engine.apart`."""
        return self.among(active, body, state)
