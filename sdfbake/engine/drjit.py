"""The Dr.Jit engine: programs compiled to the processor by LLVM, or to a GPU by CUDA.

`choose` looks for a usable LLVM library before this file is imported: a wrong one would end the process.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np

from sdfbake.engine.protocol import Array, Program, State
from sdfbake.engine.tree import leaves, rebuild


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
