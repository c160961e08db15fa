"""The Dr.Jit engine: programs compiled to the processor by LLVM, or to a GPU by CUDA.

`choose` looks for a usable LLVM library before this file is imported: a wrong one would end the process.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import reduce
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np

from sdfbake.engine import cube
from sdfbake.engine.protocol import Array, Lists, Measures, Program, State, Weights
from sdfbake.engine.tree import leaves, rebuild

# Dr.Jit gives a thread 16,384 lanes at a time.
_ENOUGH = 1 << 16
_PACKETS = (2, 4, 8)  # entries of a row that are stored at once
_SHORT = 8  # items: shorter lists are not cut


def _backend() -> ModuleType:
    if dr.has_backend(dr.JitBackend.CUDA):
        from drjit import cuda

        return cuda
    from drjit import llvm

    return llvm


def _aligned(values: np.ndarray, kind: Any) -> np.ndarray:
    """Copy to memory that starts on a cache line.

    Dr.Jit wraps NumPy's memory and writes its alignment into the program: with whatever alignment a copy happens to
    have, one program would be compiled time and again.
    """
    raw = np.empty(values.size * np.dtype(kind).itemsize + 64, np.uint8)
    start = -raw.ctypes.data % 64
    whole: np.ndarray = raw[start : start + values.size * np.dtype(kind).itemsize].view(kind)
    whole[...] = values.ravel()
    return whole


@dataclass(frozen=True, slots=True)
class DrjitEngine:
    """Programs as Dr.Jit kernels over all rays at once."""

    precision: int = 32
    name: str = "drjit"
    types: ModuleType = field(default_factory=_backend, repr=False)

    @property
    def real_type(self) -> Any:
        """Dr.Jit's array of floats of this precision."""
        return self.types.Float64 if self.precision == 64 else self.types.Float32

    @property
    def eps(self) -> float:
        """Distance from 1 to the next float."""
        return float(np.finfo(np.float64 if self.precision == 64 else np.float32).eps)

    def run(self, program: Program, inputs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Run a program on all rays at once; see `Engine.run`."""
        count = len(inputs[0])
        columns = [self.table(column if count else np.zeros(1, column.dtype)) for column in inputs]
        outputs = dict(program(self, *columns))
        dr.eval(*outputs.values())
        width = max(count, 1)
        return {name: self._whole(value, width)[:count] for name, value in outputs.items()}

    def differentiable(self) -> "DrjitEngine":
        """Return the engine whose arrays remember what is done to them, for `derivatives`."""
        return DrjitEngine(self.precision, self.name, _backend().ad)

    def derivatives(
        self, program: Program, inputs: Sequence[np.ndarray]
    ) -> tuple[dict[str, np.ndarray], dict[str, list[np.ndarray]]]:
        """Run a program and differentiate it automatically, by Dr.Jit's reverse mode.

        Parameters
        ----------
        program, inputs
            As for `Engine.run`: floats, at least one lane. What happens in a lane depends on that lane's inputs alone.

        Returns
        -------
        values
            What the program returns.
        derivatives
            For every output its derivative with respect to every input, lane by lane.
        """
        columns = [self.table(column) for column in inputs]
        dr.enable_grad(columns)
        outputs = dict(program(self, *columns))
        slopes: dict[str, list[Array]] = {}
        for name, value in outputs.items():
            dr.clear_grad(columns)
            # The way back is kept: the other outputs take it too.
            dr.backward_from(value, dr.ADFlag.ClearInterior)
            slopes[name] = [dr.grad(column) for column in columns]
        values = {name: dr.detach(value) for name, value in outputs.items()}
        dr.eval(*values.values(), *(slope for row in slopes.values() for slope in row))
        width = len(inputs[0])
        return (
            {name: self._whole(value, width) for name, value in values.items()},
            {name: [self._whole(slope, width) for slope in row] for name, row in slopes.items()},
        )

    @staticmethod
    def _whole(value: Array, width: int) -> np.ndarray:
        values = np.array(value)
        return values if len(values) == width else np.full(width, values[0])

    def table(self, values: np.ndarray) -> Array:
        """Make a look-up table; see `Engine.table`."""
        values = np.asarray(values)
        if values.dtype == np.uint8:
            return self.types.UInt8(_aligned(values, np.uint8))
        if values.dtype.kind == "f":
            return self.real_type(_aligned(values, np.float64 if self.precision == 64 else np.float32))
        return self.types.Int(_aligned(values, np.int32))

    def uniform(self, value: float | int) -> Array:
        """Make an opaque number, so that another value does not compile another program."""
        return dr.opaque(self.types.Int if isinstance(value, int) else self.real_type, value)

    def gather(self, table: Array, index: Array, active: Array) -> Array:
        """Look up a table; see `Engine.gather`."""
        found = dr.gather(type(table), table, self.types.UInt(index), active)
        return self.types.Int(found) if isinstance(table, self.types.UInt8) else found

    def stencil(self, table: Array, base: Array, size: int, width: int, active: Array) -> Array:
        """Look up cubes, as lists of arrays; see `Engine.stencil`."""
        axis = range(size)
        places = [(i * width + j) * width + k for i in axis for j in axis for k in axis]
        return [self.gather(table, base + place, active) for place in places]

    def by_order(self, taps: Array, weights: Weights) -> Sequence[Array]:
        """Sum over a cube; see `Engine.by_order`."""
        return cube.by_order(dr.fma, taps, weights)

    def by_degree(self, taps: Array, weights: Weights) -> Sequence[Array]:
        """Sum over a cube; see `Engine.by_degree`."""
        return cube.by_degree(dr.fma, taps, weights)

    def where(self, mask: Array, yes: Array, no: Array) -> Array:
        """Choose by mask."""
        return dr.select(mask, yes, no)

    def fma(self, a: Array, b: Array, c: Array) -> Array:
        """Return a * b + c, rounded once."""
        return dr.fma(a, b, c)

    def sqrt(self, x: Array) -> Array:
        """Return the square root."""
        return dr.sqrt(x)

    def log2(self, x: Array) -> Array:
        """Return the binary logarithm."""
        return dr.log2(x)

    def floor(self, x: Array) -> Array:
        """Round down."""
        return dr.floor(x)

    def abs(self, x: Array) -> Array:
        """Return the magnitude."""
        return dr.abs(x)

    def minimum(self, a: Array, b: Array) -> Array:
        """Return the lesser of two."""
        return dr.minimum(a, b)

    def maximum(self, a: Array, b: Array) -> Array:
        """Return the greater of two."""
        return dr.maximum(a, b)

    def least(self, arrays: Sequence[Array]) -> Array:
        """Return the least of several: one instruction each, where `minimum` takes five to let NaN through."""
        return reduce(lambda a, b: dr.select(a < b, a, b), arrays)

    def most(self, arrays: Sequence[Array]) -> Array:
        """Return the greatest of several; see `least`."""
        return reduce(lambda a, b: dr.select(a > b, a, b), arrays)

    def integer(self, x: Array) -> Array:
        """Truncate floats to integers, or turn a mask into 0 and 1."""
        if dr.is_mask_v(x):
            return dr.select(x, self.types.Int(1), self.types.Int(0))
        return self.types.Int(x)

    def real(self, x: Array) -> Array:
        """Turn integers into floats."""
        return self.real_type(x)

    def full(self, like: Array, value: float | int | bool) -> Array:
        """Make an array of one value, as wide as `like` (loop states must not be scalars)."""
        kind = (
            self.types.Bool if isinstance(value, bool) else self.types.Int if isinstance(value, int) else self.real_type
        )
        return dr.full(kind, value, dr.width(like))

    def while_loop(
        self,
        condition: Callable[[State], Array],
        body: Callable[[State, Any], State],
        state: State,
        constants: Any = (),
    ) -> State:
        """Run a symbolic loop; see `Engine.while_loop`."""
        result = dr.while_loop(
            tuple(leaves(state)),
            lambda *flat: condition(rebuild(state, list(flat))),
            lambda *flat: tuple(leaves(body(rebuild(state, list(flat)), constants))),
        )
        return rebuild(state, list(result))

    def among(self, active: Array, body: Callable[[State], State], state: State) -> State:
        """Run the body where any lane of a packet is active; see `Engine.among`."""
        flat = tuple(leaves(state))
        found = dr.if_stmt(
            flat,
            active,
            lambda *given: tuple(leaves(body(rebuild(state, list(given))))),
            lambda *given: given,
            mode="symbolic",
        )
        return rebuild(state, list(found))

    def at(self, precision: int) -> "DrjitEngine":
        """Return the engine of another precision; see `Engine.at`."""
        return DrjitEngine(precision, self.name, self.types)

    def lanes(self, count: int) -> Array:
        """Return the integers from 0."""
        return dr.arange(self.types.Int, count)

    def rows(self, table: Array, index: Array, active: Array) -> tuple[Array, Array, Array, Array]:
        """Look up rows of four; see `Engine.rows`."""
        kind = self.types.Array4f64 if self.precision == 64 else self.types.Array4f
        row = dr.gather(kind, table, self.types.UInt(index), active)
        return row[0], row[1], row[2], row[3]

    def kept(self, mask: Array) -> Array:
        """Return the lanes where a mask holds."""
        return self.types.Int(dr.compress(mask))

    def first_least(
        self, lists: Lists, lane: Sequence[Array], measure: Measures, tie: Callable[[Array], Array]
    ) -> tuple[Array, ...]:
        """Reduce lists; see `Engine.first_least`."""
        lists, piece, lane = self._cut(lists, lane)
        least, first = self._first_least(lists, lane, measure, tie)
        if piece is None:
            return first
        dr.eval(*least, *first)

        def of_piece(item: Array) -> tuple[Array, ...]:
            return tuple(dr.gather(self.real_type, values, item) for values in least)

        _, which = self._first_least(piece, (), lambda: of_piece, tie)
        return tuple(dr.gather(self.types.Int, items, at) for items, at in zip(first, which, strict=True))

    def _first_least(
        self, lists: Lists, lane: Sequence[Array], measure: Measures, tie: Callable[[Array], Array]
    ) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Return the measures of the first items that are least, and these.

        In one pass: an item takes the place of the first only if it is less beyond a tie.
        """
        of = measure(*lane)
        count = len(of(self.types.Int(0) * lists.start))

        def body(j: Array, *state: Array) -> tuple[Array, ...]:
            item = dr.gather(self.types.Int, lists.items, j)
            held, first = state[:count], state[count:]
            values = of(item)
            less = [value < low - tie(low) for value, low in zip(values, held, strict=True)]
            lower = [dr.select(mask, value, low) for mask, value, low in zip(less, values, held, strict=True)]
            return j + 1, *lower, *(dr.select(mask, item, at) for mask, at in zip(less, first, strict=True))

        most = float(np.finfo(np.float32).max)
        end = lists.start + lists.count
        highs = [self.full(lists.start, most) for _ in range(count)]
        firsts = [self.full(lists.start, 0) for _ in range(count)]
        state = (self.types.Int(lists.start), *highs, *firsts)
        _, *found = dr.while_loop(state, lambda j, *rest: j < end, body, mode="symbolic")
        return tuple(found[:count]), tuple(found[count:])

    def interleaved(self, arrays: Sequence[Array]) -> Array:
        """Mix arrays lane by lane."""
        dr.eval(*arrays)
        return self._mixed(arrays, dr.width(arrays[0]), 1)

    def _mixed(self, arrays: Sequence[Array], width: int, pieces: int) -> Array:
        """Return one array by lane, then array, then piece of the lane."""
        mixed = dr.empty(self.types.Int, len(arrays) * width * pieces)
        entry, each = dr.arange(self.types.Int, width * pieces), dr.opaque(self.types.Int, pieces)
        lane = entry // each
        place = lane * (each * len(arrays)) + (entry - lane * each)
        for k, values in enumerate(arrays):
            dr.scatter(mixed, values, self.types.UInt(place + each * k))
        return mixed

    def narrowed(self, lists: Lists, lane: Sequence[Array], within: Measures) -> Lists:
        """Filter lists; see `Engine.narrowed`.

        Every list gets the room that it had, so that one pass is enough; what stays empty is never read.
        """
        lists, piece, lane = self._cut(lists, lane)
        width, room = dr.width(lists.start), lists.count
        before = dr.prefix_sum(room)
        dr.eval(before)
        test = within(*lane)
        ways = len(test(self.types.Int(0) * lists.start))
        items = dr.empty(self.types.Int, ways * self._total(before, room))
        starts = [before * ways + room * k for k in range(ways)]

        def body(j: Array, *at: Array) -> tuple[Array, ...]:
            item = dr.gather(self.types.Int, lists.items, j)
            good = test(item)
            for place, mask in zip(at, good, strict=True):
                dr.scatter(items, item, self.types.UInt(place), mask)
            return j + 1, *(place + self.integer(mask) for place, mask in zip(at, good, strict=True))

        end = lists.start + lists.count
        _, *last = dr.while_loop((self.types.Int(lists.start), *starts), lambda j, *at: j < end, body, mode="symbolic")
        counts = [after - start for after, start in zip(last, starts, strict=True)]
        dr.eval(*counts, *starts, items)
        pieces = 1 if piece is None else dr.width(piece.items) // dr.width(piece.start)
        start, count = (self._mixed(arrays, width // pieces, pieces) for arrays in (starts, counts))
        return Lists(start, count, items) if piece is None else self._joined(Lists(start, count, items), pieces)

    def _cut(self, lists: Lists, lane: Sequence[Array]) -> tuple[Lists, Lists | None, Sequence[Array]]:
        """Cut the lists of few lanes into pieces that are lanes of their own, or threads would have nothing to do.

        Also return, for every lane that there was, the list of its pieces; None where nothing was cut.
        """
        width = dr.width(lists.start)
        pieces = min(_ENOUGH // width, len(lists.items) // (_SHORT * width))
        if pieces < 2:
            return lists, None, lane
        piece = dr.arange(self.types.Int, width * pieces)
        each = dr.opaque(self.types.Int, pieces)
        of = piece // each
        begin, count = (dr.gather(self.types.Int, array, of) for array in (lists.start, lists.count))
        size = (count + each - 1) // each
        start = dr.minimum((piece - of * each) * size, count)
        cut = Lists(begin + start, dr.minimum(size, count - start), lists.items)
        repeated = [dr.gather(type(known), known, of) for known in lane]
        dr.eval(cut.start, cut.count, *repeated)
        whole = dr.arange(self.types.Int, width)
        return cut, Lists(whole * each, dr.full(self.types.Int, pieces, width), piece), repeated

    def _joined(self, cut: Lists, pieces: int) -> Lists:
        """Put the pieces of every list, which follow each other, together without gaps."""
        start = dr.prefix_sum(cut.count)
        dr.eval(start)
        items = dr.empty(self.types.Int, self._total(start, cut.count))

        def body(j: Array) -> tuple[Array]:
            dr.scatter(items, dr.gather(self.types.Int, cut.items, cut.start + j), self.types.UInt(start + j))
            return (j + 1,)

        (last,) = dr.while_loop((start * 0,), lambda j: j < cut.count, body, mode="symbolic")
        dr.eval(last, items)
        each = dr.opaque(self.types.Int, pieces)
        first = dr.arange(self.types.Int, dr.width(start) // pieces) * each
        final = first + each - 1
        begin = dr.gather(self.types.Int, start, first)
        count = dr.gather(self.types.Int, start, final) + dr.gather(self.types.Int, cut.count, final) - begin
        dr.eval(begin, count)
        return Lists(begin, count, items)

    @staticmethod
    def _total(start: Array, count: Array) -> int:
        last = dr.width(count) - 1
        return max(1, int(start[last] + count[last]))

    def scattered(self, size: int, fill: float | int, place: Array, value: Array, active: Array) -> Array:
        """Put values in their places; see `Engine.scattered`."""
        kind = self.types.Int if isinstance(fill, int) else self.real_type
        whole = dr.full(kind, fill, size)
        dr.scatter(whole, kind(value), self.types.UInt(place), active)
        return whole

    def replaced(self, whole: Array, place: Array, value: Array) -> Array:
        """Replace entries; Dr.Jit copies what others still hold. See `Engine.replaced`."""
        copy = type(whole)(whole)
        dr.scatter(copy, value, self.types.UInt(place))
        return copy

    def tabulated(self, count: int, rows: Callable[[Array], Sequence[Sequence[Array]]]) -> tuple[Array, ...]:
        """Fill tables in one program; see `Engine.tabulated`."""
        lane = dr.arange(self.types.UInt, count)
        tables = []
        for row in rows(self.types.Int(lane)):
            if len(row) == 1:
                tables.append(row[0])
                continue
            table = dr.empty(type(row[0]), count * len(row))
            if len(row) in _PACKETS:
                dr.scatter(table, self._packet(row), lane)
            else:
                for place, entry in enumerate(row):
                    dr.scatter(table, entry, lane * len(row) + place)
            tables.append(table)
        dr.eval(*tables)
        return tuple(tables)

    def _packet(self, row: Sequence[Array]) -> Array:
        """Return a row as one value, which is stored at once."""
        kinds = {self.types.Int: self.types.ArrayXi, self.types.Float32: self.types.ArrayXf}
        return kinds.get(type(row[0]), self.types.ArrayXf64)(list(row))

    def joined(self, parts: Sequence[Array]) -> Array:
        """Return arrays one after the other."""
        return dr.concat(list(parts)) if len(parts) > 1 else parts[0]

    def extremes(self, values: Array) -> tuple[float, float]:
        """Return the least and the greatest."""
        least, most = dr.min(values), dr.max(values)
        dr.eval(least, most)
        return float(least[0]), float(most[0])

    def settled(self, *arrays: Array) -> None:
        """Run what was only described so far."""
        dr.eval(*arrays)

    def apart(self, active: Array, body: Callable[[State], State], state: State) -> State:
        """Run the body on the active lanes; see `Engine.apart`.

        Literals and arrays that are one and the same become arrays of their own, or each such state would be another
        program.
        """
        width = dr.width(active)
        arrays = [self.full(active, 0) + leaf if dr.width(leaf) < width else leaf for leaf in leaves(state)]
        seen: set[int] = set()
        for number, leaf in enumerate(arrays):
            if leaf.index in seen:
                arrays[number] = dr.select(dr.opaque(self.types.Bool, True), leaf, type(leaf)(0))
            seen.add(leaf.index)
        dr.make_opaque(active, *arrays)
        lanes: Any = dr.compress(active)
        if dr.width(lanes) == 0:
            return rebuild(state, arrays)
        if dr.width(lanes) == 1:  # arrays of one entry count as uniform: another program
            lanes = dr.full(self.types.UInt, int(lanes[0]), 2)
            dr.make_opaque(lanes)
        part = body(rebuild(state, [dr.gather(type(leaf), leaf, lanes) for leaf in arrays]))
        whole = [type(leaf)(leaf) for leaf in arrays]
        for leaf, value in zip(whole, leaves(part), strict=True):
            dr.scatter(leaf, value, lanes)
        dr.eval(*whole)
        return rebuild(state, whole)
