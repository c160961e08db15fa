"""What a program may ask of an engine.

Arrays of an engine are one-dimensional: floats of one precision, 32-bit integers, masks. Arithmetic, comparisons and
`& | ~ >> <<` are the arrays' own operators; everything else is a method here. A program must not look at a size, at a
dtype, or at a value: on a compiling engine there is none yet.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

Array = Any  # a NumPy array or a Dr.Jit array: the two share operators, not a type
State = TypeVar("State", bound=tuple[Any, ...])
Program = Callable[..., Mapping[str, Array]]
# Of each of three axes, per order, per tap.
Weights = Sequence[Sequence[Sequence[Array]]]
# Of what a lane knows, and then of one item after another.
Measures = Callable[..., Callable[[Array], tuple[Array, ...]]]


class Lists(NamedTuple):
    """A list of items for every lane: `items[start : start + count]`; integers."""

    start: Array
    count: Array
    items: Array


@runtime_checkable
class Engine(Protocol):
    """An array engine; see the module's text for what its arrays can do by themselves."""

    @property
    def name(self) -> str:
        """`numpy` or `drjit`."""
        ...

    @property
    def precision(self) -> int:
        """Bits of a float, 32 or 64."""
        ...

    @property
    def eps(self) -> float:
        """Distance from 1 to the next float."""
        ...

    def run(self, program: Program, inputs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Call `program(self, *inputs)` on whole rays and return its arrays as NumPy arrays.

        The inputs have one common length; floats become floats of the engine's precision, integers 32-bit integers.
        """
        ...

    def table(self, values: np.ndarray) -> Array:
        """Make a look-up table for `gather`: floats of the engine's precision, int32, or uint8."""
        ...

    def uniform(self, value: float | int) -> Array:
        """Make one number that all rays share and that no compiled program contains as a literal."""
        ...

    def gather(self, table: Array, index: Array, active: Array) -> Array:
        """Return `table[index]` where active, anything elsewhere; uint8 tables give integers."""
        ...

    def stencil(self, table: Array, base: Array, size: int, width: int, active: Array) -> Array:
        """Return cubes of size^3 entries for `by_order` and `by_degree`, anything where not active.

        `table` is a sequence of larger cubes, width^3; an entry of one is at base + (i * width + j) * width + k.
        """
        ...

    def by_order(self, taps: Array, weights: Weights) -> Sequence[Array]:
        """Sum the taps of cubes with weights of every order of their axes; see `sdfbake.engine.cube`."""
        ...

    def by_degree(self, taps: Array, weights: Weights) -> Sequence[Array]:
        """Sum the taps of cubes with weights of all orders that add up alike; see `sdfbake.engine.cube`."""
        ...

    def where(self, mask: Array, yes: Array, no: Array) -> Array:
        """Choose by mask; at least one of the two is an array."""
        ...

    def fma(self, a: Array, b: Array, c: Array) -> Array:
        """Return a * b + c."""
        ...

    def sqrt(self, x: Array) -> Array:
        """Return the square root."""
        ...

    def log2(self, x: Array) -> Array:
        """Return the binary logarithm."""
        ...

    def floor(self, x: Array) -> Array:
        """Round down, as floats."""
        ...

    def abs(self, x: Array) -> Array:
        """Return the magnitude."""
        ...

    def minimum(self, a: Array, b: Array) -> Array:
        """Return the lesser of two."""
        ...

    def maximum(self, a: Array, b: Array) -> Array:
        """Return the greater of two."""
        ...

    def least(self, arrays: Sequence[Array]) -> Array:
        """Return the least of several arrays, none of which is NaN."""
        ...

    def most(self, arrays: Sequence[Array]) -> Array:
        """Return the greatest of several arrays, none of which is NaN."""
        ...

    def integer(self, x: Array) -> Array:
        """Truncate floats to integers, or turn a mask into 0 and 1."""
        ...

    def real(self, x: Array) -> Array:
        """Turn integers into floats."""
        ...

    def full(self, like: Array, value: float | int | bool) -> Array:
        """Make an array of one value as long as `like`: floats, integers or a mask by the value's type."""
        ...

    def while_loop(
        self,
        condition: Callable[[State], Array],
        body: Callable[[State, Any], State],
        state: State,
        constants: Any = (),
    ) -> State:
        """Repeat `state = body(state, constants)` for every ray on its own while its `condition(state)` holds.

        State and constants are nested tuples of full-width arrays; `constants` may also hold what is not an array
        through the closure of `body`. A ray whose condition fails keeps its state.
        """
        ...

    def among(self, active: Array, body: Callable[[State], State], state: State) -> State:
        """Return `body(state)` for the lanes where active; the others keep their state.

        The state is nested tuples of full-width arrays, and the body returns the like. It may be called with the active
        lanes alone, or not at all: what it knows of a lane must come in the state. It may as well be called with all
        lanes: what it gathers needs a mask.
        """
        ...

    def at(self, precision: int) -> "Engine":
        """Return the same engine with floats of another precision; integers and masks serve both."""
        ...

    def lanes(self, count: int) -> Array:
        """Return the integers from 0."""
        ...

    def rows(self, table: Array, index: Array, active: Array) -> tuple[Array, Array, Array, Array]:
        """Look up rows of four in a table of floats."""
        ...

    def kept(self, mask: Array) -> Array:
        """Return the numbers of the lanes where a mask holds, ascending."""
        ...

    def first_least(
        self, lists: Lists, lane: Sequence[Array], measure: Measures, tie: Callable[[Array], Array]
    ) -> tuple[Array, ...]:
        """Return for every lane the first item of its list that is least, by each of several measures;
        no list is empty.

        Items count as equally small if they differ by at most `tie(least)`.
        """
        ...

    def interleaved(self, arrays: Sequence[Array]) -> Array:
        """Return one array of integers with the entries of lane 0 of all arrays, then those of lane 1, and so on."""
        ...

    def narrowed(self, lists: Lists, lane: Sequence[Array], within: Measures) -> Lists:
        """Return lists of the items for which `within(*lane)(item)` holds, in order; they may be empty.

        `within` returns several masks, and every lane so many lists, which follow each other.
        """
        ...

    def scattered(self, size: int, fill: float | int, place: Array, value: Array, active: Array) -> Array:
        """Return an array of `size` with the active lanes' values at their places, `fill` elsewhere; floats or integers
        by the type of `fill`.
        """
        ...

    def replaced(self, whole: Array, place: Array, value: Array) -> Array:
        """Return an array with some entries, all at places of their own, replaced."""
        ...

    def tabulated(self, count: int, rows: Callable[[Array], Sequence[Sequence[Array]]]) -> tuple[Array, ...]:
        """Return tables of what `rows(lane)` gives for the lanes 0 to count - 1, computed.

        It gives one row per table; a table has the entries of lane 0's row, then those of lane 1, and so on.
        """
        ...

    def joined(self, parts: Sequence[Array]) -> Array:
        """Return one array with the entries of some, one after the other."""
        ...

    def extremes(self, values: Array) -> tuple[float, float]:
        """Return the least and the greatest of some floats."""
        ...

    def settled(self, *arrays: Array) -> None:
        """Compute arrays that were only described so far."""
        ...

    def apart(self, active: Array, body: Callable[[State], State], state: State) -> State:
        """Return `body(state)` for the lanes where active, as `among` does, but as a program of its own.

        It is run at once, on those lanes alone; with states of the same form again it is not compiled again.
        """
        ...
