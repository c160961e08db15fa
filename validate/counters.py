"""Work counters: what rays take of a surface and its tables, counted while the very same programs run.

In: fields on the NumPy engine. Out: the same fields, whose programs are counted, and the counts (`validate.counting`
says how).
"""

from threading import Lock
from typing import cast

from sdfbake.complaint import BadInput
from sdfbake.engine import Array, Engine
from sdfbake.engine.numpy import NumpyEngine
from sdfrender import Field
from sdfrender.field import Jet, Mapped, Spot, Spread
from sdfrender.vector import Vector
from validate.counting import CHANNEL, JET, MARCH, CountingEngine, Work

__all__ = ["CountedField", "Counters", "Work"]


class Counters:
    """Watches fields, and sums up what programs on them took.

    The fields answer as they would by themselves, bit for bit; what was prepared before is not counted.

    Parameters
    ----------
    precision
        That of the fields' engine, NumPy, bits.

    Examples
    --------
    >>> import numpy as np
    >>> from datasets_synthetic import shape
    >>> from sdfbake import Grid
    >>> from sdfrender import GridField, trace
    >>> grid = Grid.from_function(shape("sphere"), 16, uv_mode="none")
    >>> counters = Counters()
    >>> field = counters.watch(GridField(grid, engine="numpy"))
    >>> hits = trace(field, np.array([[0.0, 0.0, 3.0]]), np.array([[0.0, 0.0, -1.0]]))
    >>> counters.work.gradients, counters.work.hessians
    (1, 0)
    """

    def __init__(self, precision: int = 64) -> None:
        self.engine = CountingEngine(NumpyEngine(precision), self._add)
        self._work = Work()
        self._lock = Lock()

    def watch(self, field: Field) -> "CountedField":
        """Return a field that is counted, for `trace`, `render` and all else that takes one; several can be watched.

        Raises
        ------
        BadInput
            If it is not on a NumPy engine of this precision.
        """
        engine = field.engine
        if not isinstance(engine, NumpyEngine) or engine.precision != self.engine.precision:
            raise BadInput(
                f"work is counted on the engine numpy in {self.engine.precision} bits, and the field is on "
                f"{engine.name} in {engine.precision}: make it with engine='numpy', precision={self.engine.precision}"
            )
        return CountedField(field, self.engine)

    @property
    def work(self) -> Work:
        """What was counted since the last `taken`."""
        return self._work

    def taken(self) -> Work:
        """Return what was counted, and begin again at 0."""
        with self._lock:
            work, self._work = self._work, Work()
        return work

    def _add(self, work: Work) -> None:
        """Add what a tile of rays took; they come from several threads."""
        with self._lock:
            self._work = self._work + work


class CountedField:
    """A field that tells its engine which question it answers; see `sdfrender.field.Field`."""

    def __init__(self, inner: Field, engine: CountingEngine) -> None:
        self._inner, self.engine = inner, engine
        self.anchor, self.bounds = inner.anchor, inner.bounds
        self.is_distance, self.part_names, self.uv_mode = inner.is_distance, inner.part_names, inner.uv_mode
        self.prepare_uv = inner.prepare_uv

    def first_hit(
        self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None, spread: Spread | None = None
    ) -> Spot:
        """Find first hits."""
        return self._inner.first_hit(_sent(xp, active), p, d, active, start, spread)

    def occluded(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None, limit: Array) -> Array:
        """Say which rays meet anything."""
        return self._inner.occluded(_sent(xp, active), p, d, active, start, limit)

    def inside(self, xp: Engine, p: Vector, active: Array) -> Array:
        """Say which positions are inside."""
        return self._inner.inside(_asking(xp, JET), p, active)

    def locate(self, xp: Engine, p: Vector, active: Array) -> Spot:
        """Turn positions into places."""
        return self._inner.locate(_asking(xp, JET), p, active)

    def jet_at(self, xp: Engine, spot: Spot, order: int) -> Jet:
        """Signed distance and derivatives."""
        return self._inner.jet_at(_asking(xp, JET), spot, order)

    def uv_at(self, xp: Engine, spot: Spot, n: Vector | None) -> Mapped:
        """Texture coordinates."""
        return self._inner.uv_at(_asking(xp, CHANNEL), spot, n)

    def part_at(self, xp: Engine, spot: Spot) -> Array:
        """Part of the surface."""
        return self._inner.part_at(_asking(xp, CHANNEL), spot)

    def beyond_band(self, xp: Engine, spot: Spot) -> Array:
        """Say whether values that are not exact stand behind the surface."""
        return self._inner.beyond_band(_asking(xp, CHANNEL), spot)


def _asking(xp: Engine, question: str) -> Engine:
    return cast("CountingEngine", xp).asking(question)


def _sent(xp: Engine, active: Array) -> Engine:
    cast("CountingEngine", xp).count(active, "marches")
    return _asking(xp, MARCH)
