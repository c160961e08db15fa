"""The engine that counts what programs ask of it while they run.

In: programs. Out: what they give on the NumPy engine, bit for bit, and `Work` for every tile of rays. A lane counts
where it is active and still alive in every loop around it, so that counts depend neither on the machine nor on tiles:
for every ray they are those of any engine that runs the program.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool

from sdfbake.engine import Array, Engine
from sdfbake.engine.numpy import NumpyEngine
from sdfbake.engine.protocol import Program, State, Weights
from sdfrender.stride import Walk

# Of which question to a field a program's part is: a walk, a jet, a channel; or of none.
MARCH, JET, CHANNEL, SCENE = "march", "jet", "channel", "scene"


@dataclass(frozen=True, slots=True)
class Work:
    """Totals over all rays.

    Attributes
    ----------
    marches
        Rays sent out: first hits and occlusions asked for.
    cubes
        Steps of the walk: cubes that a ray was in, each an empty one (of cells or of absent bricks) or one occupied
        cell.
    absent
        Of those, cubes of absent bricks.
    slabs
        Occupied cells, held against their slab.
    polynomials
        Cells whose polynomial was made and searched for a root; the slab settled the others.
    stencils
        Cubes of coefficients or samples gathered, taps^3 numbers each: of polynomials, jets and channels.
    values, gradients, hessians
        Evaluations of the signed distance at a place; one of second order counts in all three.
    channels
        Look-ups in a surface's other tables: texture coordinates, faces and their neighbours, charts, parts. One for
        each number of a face, one for each interpolated stencil.
    scene
        Look-ups in other tables: a texel counts once for every colour channel; materials, environments, lights.
    """

    marches: int = 0
    cubes: int = 0
    absent: int = 0
    slabs: int = 0
    polynomials: int = 0
    stencils: int = 0
    values: int = 0
    gradients: int = 0
    hessians: int = 0
    channels: int = 0
    scene: int = 0

    def __add__(self, other: "Work") -> "Work":
        theirs = asdict(other)
        return Work(**{name: count + theirs[name] for name, count in asdict(self).items()})

    def per(self, rays: int) -> dict[str, float]:
        """Return the counts by name, per ray of however many there were."""
        return {name: count / rays for name, count in asdict(self).items()}


@dataclass(slots=True)
class _Tile:
    """What a tile of rays took so far, and which lanes are alive in the loop that it is in; None for all."""

    work: Work = field(default_factory=Work)
    alive: Bool[np.ndarray, " n"] | None = None
    walking: bool = False

    def lanes(self, active: Array, like: Array) -> int:
        """Count the lanes that are active and alive; `active` may be one mask for all."""
        mask = np.broadcast_to(active, np.shape(like))
        return int(np.count_nonzero(mask if self.alive is None else mask & self.alive))

    def count(self, lanes: int, *names: str) -> None:
        """Count so many lanes by some names."""
        self.work = replace(self.work, **{name: getattr(self.work, name) + lanes for name in names})

    @contextmanager
    def within(self, alive: Bool[np.ndarray, " n"], *, walking: bool) -> Iterator[None]:
        """Know which lanes are alive while a body runs."""
        before, self.alive, self.walking = (self.alive, self.walking), alive, walking
        try:
            yield
        finally:
            self.alive, self.walking = before


class _Taps(NamedTuple):
    """A stencil, and how many lanes asked for it."""

    cubes: Array
    lanes: int


class CountingEngine:
    """The NumPy engine, with an eye on what programs ask of it; see `sdfbake.engine.protocol.Engine`.

    Outside programs, where tables are prepared, nothing is counted. Loops and `among` carry the mask of the lanes that
    are alive through the engine beside the state, for it keeps some that are done running along.
    """

    def __init__(
        self, inner: NumpyEngine, collect: Callable[[Work], None], tile: _Tile | None = None, question: str = SCENE
    ) -> None:
        self._inner, self._collect, self._tile, self._question = inner, collect, tile, question
        self.name, self.precision, self.eps = inner.name, inner.precision, inner.eps
        # What costs no look-up is the engine's own.
        self.table, self.uniform, self.where, self.fma = inner.table, inner.uniform, inner.where, inner.fma
        self.sqrt, self.log2, self.floor, self.abs = inner.sqrt, inner.log2, inner.floor, inner.abs
        self.minimum, self.maximum, self.least, self.most = inner.minimum, inner.maximum, inner.least, inner.most
        self.integer, self.real, self.full, self.lanes = inner.integer, inner.real, inner.full, inner.lanes
        self.kept, self.interleaved, self.joined = inner.kept, inner.interleaved, inner.joined
        self.extremes, self.scattered, self.replaced = inner.extremes, inner.scattered, inner.replaced
        self.tabulated, self.first_least, self.narrowed = inner.tabulated, inner.first_least, inner.narrowed
        self.settled = inner.settled

    def at(self, precision: int) -> "CountingEngine":
        """Return the engine of another precision, which counts as well."""
        return CountingEngine(self._inner.at(precision), self._collect, self._tile, self._question)

    def asking(self, question: str) -> "CountingEngine":
        """Return the engine for a part of a program that answers a question to a field."""
        return CountingEngine(self._inner, self._collect, self._tile, question)

    def count(self, active: Array, *names: str) -> None:
        """Count the active lanes."""
        if self._tile is not None:
            self._tile.count(self._tile.lanes(active, active), *names)

    def run(self, program: Program, inputs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Run a program, and count."""
        if len(inputs[0]) == 0:  # the engine then runs it on a ray that nobody sent
            return self._inner.run(lambda _, *columns: program(self, *columns), inputs)

        def watched(_: Engine, *columns: Array) -> Any:
            tile = _Tile()
            out = program(CountingEngine(self._inner, self._collect, tile), *columns)
            self._collect(tile.work)
            return out

        return self._inner.run(watched, inputs)

    def gather(self, table: Array, index: Array, active: Array) -> Array:
        """Look up a table; on a walk, every step asks for its brick, and where there is one, for its cell."""
        tile = self._tile
        if tile is not None:
            lanes = tile.lanes(active, index)
            if tile.walking and table.dtype.kind == "i":
                tile.count(-lanes, "absent")  # of two for every step, see `while_loop`
            elif self._question in (CHANNEL, SCENE):
                tile.count(lanes, "channels" if self._question == CHANNEL else "scene")
        return self._inner.gather(table, index, active)

    def rows(self, table: Array, index: Array, active: Array) -> tuple[Array, Array, Array, Array]:
        """Look up rows of four: slabs, or materials."""
        if self._tile is not None:
            names = {MARCH: "slabs", SCENE: "scene"}
            self._tile.count(self._tile.lanes(active, index), names.get(self._question, "channels"))
        return self._inner.rows(table, index, active)

    def stencil(self, table: Array, base: Array, size: int, width: int, active: Array) -> Array:
        """Say where cubes are, and for how many."""
        cubes = self._inner.stencil(table, base, size, width, active)
        if self._tile is None:
            return cubes
        lanes = self._tile.lanes(active, base)
        self._tile.count(lanes, "stencils")
        return _Taps(cubes, lanes)

    def by_order(self, taps: Array, weights: Weights) -> Sequence[Array]:
        """Sum over a cube: jets by their order, channels once."""
        if not isinstance(taps, _Taps):
            return self._inner.by_order(taps, weights)
        if self._tile is not None:
            jets = ("values", "gradients", "hessians")[: len(weights[0])]
            self._tile.count(taps.lanes, *(("channels",) if self._question == CHANNEL else jets))
        return self._inner.by_order(taps.cubes, weights)

    def by_degree(self, taps: Array, weights: Weights) -> Sequence[Array]:
        """Make a polynomial."""
        if not isinstance(taps, _Taps):
            return self._inner.by_degree(taps, weights)
        if self._tile is not None:
            self._tile.count(taps.lanes, "polynomials")
        return self._inner.by_degree(taps.cubes, weights)

    def while_loop(
        self,
        condition: Callable[[State], Array],
        body: Callable[[State, Any], State],
        state: State,
        constants: Any = (),
    ) -> State:
        """Repeat the body, knowing which lanes are alive."""
        tile = self._tile
        if tile is None:
            return self._inner.while_loop(condition, body, state, constants)
        walking = isinstance(state, Walk)

        def step(outer: tuple[Array, State], constants: Any) -> tuple[Array, State]:
            alive, state = outer
            with tile.within(alive, walking=walking):
                if walking:
                    lanes = int(np.count_nonzero(alive))
                    tile.count(lanes, "cubes")
                    tile.count(2 * lanes, "absent")  # less one for the brick, and one for its cell where it is present
                state = body(state, constants)
            return alive & condition(state), state

        asked = condition(state)
        alive = asked if tile.alive is None else asked & tile.alive
        return self._inner.while_loop(lambda outer: outer[0], step, (alive, state), constants)[1]

    def among(self, active: Array, body: Callable[[State], State], state: State) -> State:
        """Run the body on the active lanes alone, knowing which those are."""
        tile = self._tile
        if tile is None:
            return self._inner.among(active, body, state)

        def part(outer: tuple[Array, State]) -> tuple[Array, State]:
            alive, state = outer
            with tile.within(alive, walking=False):
                return alive, body(state)

        alive = active if tile.alive is None else active & tile.alive
        return self._inner.among(alive, part, (alive, state))[1]

    def apart(self, active: Array, body: Callable[[State], State], state: State) -> State:
        """Run the body on the active lanes, as `among`."""
        return self.among(active, body, state)
