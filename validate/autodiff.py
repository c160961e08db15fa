"""Derivatives of the sampled value by automatic differentiation, as Galim 2018 (section 4.3.2) takes them.

In: a grid's field on Dr.Jit. Out: value, gradient and Hessian twice: in closed form, from the kernels' differentiated
weights, and by Dr.Jit from the program that samples the value. Dr.Jit differentiates once: its gradient is that of the
value, its Hessian the derivative of the closed-form gradient.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Choice, Engine, Program, choose
from sdfbake.grid import Grid
from sdfrender import GridField

# Where the entries of a symmetric matrix stand among the six that a jet has: xx, yy, zz, xy, xz, yz.
SYMMETRIC = ((0, 3, 4), (3, 1, 5), (4, 5, 2))
VALUE, GRADIENT = ("value",), ("x", "y", "z")
HESSIAN = ("xx", "yy", "zz", "xy", "xz", "yz")


@runtime_checkable
class Differentiating(Protocol):
    """An engine that differentiates programs."""

    def derivatives(
        self, program: Program, inputs: Sequence[np.ndarray]
    ) -> tuple[dict[str, np.ndarray], dict[str, list[np.ndarray]]]:
        """Return a program's outputs, and for each its derivative with respect to every input."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Derivatives:
    """Value, gradient and Hessian at points, in the engine's precision; per world unit."""

    value: Float[np.ndarray, " n"]
    gradient: Float[np.ndarray, "n 3"]
    hessian: Float[np.ndarray, "n 3 3"]


def differentiable_field(grid: Grid, kernel: str, precision: int) -> GridField:
    """A grid on arrays that can be differentiated; every program computes what it does on the plain ones.

    Raises
    ------
    BadInput
        If Dr.Jit cannot run here.
    """
    plain = choose("drjit", precision)
    from sdfbake.engine.drjit import DrjitEngine  # not before `choose` has found an LLVM

    assert isinstance(plain.engine, DrjitEngine)
    return GridField(grid, kernel, Choice(plain.engine.differentiable(), "to differentiate"))


def sampling(field: GridField, order: int, names: Sequence[str]) -> Program:
    """The tracer's own program from points to value and derivatives; some of them, by name."""

    def program(xp: Engine, *p: Array) -> Mapping[str, Array]:
        spot = field.locate(xp, (p[0], p[1], p[2]), xp.full(p[0], True))
        jet = field.jet_at(xp, spot, order)
        entries = (jet.value, *(jet.gradient or ()), *(jet.hessian or ()))
        named = dict(zip((*VALUE, *GRADIENT, *HESSIAN), entries, strict=False))
        return {name: named[name] for name in names}

    return program


def columns(field: GridField, points: Float[np.ndarray, "n 3"]) -> list[np.ndarray]:
    """What the programs are given: coordinates relative to the field's anchor."""
    return list(np.ascontiguousarray((points - field.anchor).T))


def closed_columns(field: GridField, places: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """The work of `closed_form` alone, entry by entry: what can be timed."""
    return field.engine.run(sampling(field, 2, (*VALUE, *GRADIENT, *HESSIAN)), places)


def automatic_columns(
    field: GridField, places: Sequence[np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, list[np.ndarray]]]:
    """The work of `automatic` alone, entry by entry."""
    if not isinstance(field.engine, Differentiating):
        raise TypeError("this field's engine does not differentiate: make the field by differentiable_field")
    return field.engine.derivatives(sampling(field, 1, (*VALUE, *GRADIENT)), places)


def closed_form(field: GridField, points: Float[np.ndarray, "n 3"]) -> Derivatives:
    """By the kernels' differentiated weights (Galim 2018, eq. 14 to 19)."""
    out = closed_columns(field, columns(field, points))
    entries = np.stack([out[name] for name in HESSIAN], axis=-1)
    return Derivatives(out["value"], np.stack([out[name] for name in GRADIENT], axis=-1), entries[:, SYMMETRIC])


def automatic(field: GridField, points: Float[np.ndarray, "n 3"]) -> Derivatives:
    """By automatic differentiation: the gradient from the value, the Hessian from the gradient.

    Parameters
    ----------
    field
        Of `differentiable_field`.
    points
        (n, 3) float64, world frame. On a face between two cells the program cuts a place to its cell, and what is cut
        has no derivative: no point should lie there.

    Raises
    ------
    TypeError
        If the field's engine does not differentiate.
    """
    values, slopes = automatic_columns(field, columns(field, points))
    hessian = np.stack([np.stack(slopes[name], axis=-1) for name in GRADIENT], axis=1)
    return Derivatives(values["value"], np.stack(slopes["value"], axis=-1), hessian)


def inside_cells(grid: Grid, points: Float[np.ndarray, "n 3"], margin: float = 1e-3) -> Float[np.ndarray, "m 3"]:
    """Those of the points that keep a margin, in voxels, from all faces between cells."""
    place = np.mod(grid.lattice.to_grid(points), 1.0)
    return np.asarray(points[(np.abs(place - 0.5) < 0.5 - margin).all(axis=1)])
