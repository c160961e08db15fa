"""Faults to plant in the renderer, one at a time: what a check must catch, or be known to be blind to.

In: nothing. Out: `Fault` records, and `planted`, which replaces one function of the renderer while it lasts and puts it
back. Python modules are shared by threads: plant nothing while another thread traces.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Num

from sdfbake.engine import Array, Engine
from sdfbake.lattice import Lattice
from sdfrender import layermap, optics
from sdfrender.field import Jet
from sdfrender.layertable import Rows
from sdfrender.rays import Beam
from sdfrender.vector import Vector, along, apply, dot, scale, subtract

Function = Callable[..., Any]


@dataclass(frozen=True, slots=True)
class Fault:
    """One mistake.

    Attributes
    ----------
    name, about
        What it is called, and what is wrong with it.
    owner, attribute
        Where the function is that it takes the place of.
    wrong
        From the right function to the wrong one.
    """

    name: str
    about: str
    owner: Any
    attribute: str
    wrong: Callable[[Function], Function]


@contextmanager
def planted(fault: Fault | None) -> Iterator[None]:
    """Let the renderer make a mistake within a `with` block; None lets it be right."""
    if fault is None:
        yield
        return
    right = getattr(fault.owner, fault.attribute)
    setattr(fault.owner, fault.attribute, fault.wrong(right))
    try:
        yield
    finally:
        setattr(fault.owner, fault.attribute, right)


def _inverted_eta(right: Function) -> Function:
    def refract(xp: Engine, beam: Beam, n: Vector, dn_dx: Vector, dn_dy: Vector, eta: Array) -> tuple[Beam, Array]:
        beyond: tuple[Beam, Array] = right(xp, beam, n, dn_dx, dn_dy, 1.0 / eta)
        return beyond

    return refract


def _without_dt(right: Function) -> Function:
    def transfer(xp: Engine, beam: Beam, jet: Jet, p: Vector, t: Array) -> Beam:
        straight = along(beam.dp_dx, beam.dd_dx, t), along(beam.dp_dy, beam.dd_dy, t)
        return Beam(p, beam.d, *straight, beam.dd_dx, beam.dd_dy)

    return transfer


def _unnormalised(right: Function) -> Function:
    def normal_differential(xp: Engine, jet: Jet, n: Vector, dp: Vector) -> Vector:
        assert jet.gradient is not None and jet.hessian is not None
        change = apply(jet.hessian, dp)
        return subtract(change, scale(jet.gradient, dot(jet.gradient, change)))

    return normal_differential


def _tripled(right: Function) -> Function:
    def normal_differential(xp: Engine, jet: Jet, n: Vector, dp: Vector) -> Vector:
        return scale(right(xp, jet, n, dp), 3.0)

    return normal_differential


def _exchanged(right: Function) -> Function:
    def rows_of(*given: Any) -> Rows:
        rows: Rows = right(*given)
        first, second = np.unique(rows.chart)[:2]
        chart = np.where(rows.chart == first, second, np.where(rows.chart == second, first, rows.chart))
        return rows._replace(chart=chart.astype(rows.chart.dtype))

    return rows_of


def _between_nodes(right: Function) -> Function:
    def to_world(self: Lattice, index: Num[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        p: Float[np.ndarray, "*n 3"] = right(self, np.asarray(index, np.float64) + 0.5)
        return p

    return to_world


FAULTS = (
    Fault("wrong eta", "n_t / n_i where n_i / n_t is meant", optics, "refract", _inverted_eta),
    Fault("no dt/dx", "transfer as in table 1 of Galim 2018, without dt/dx", optics, "transfer", _without_dt),
    Fault("normal not normalised", "eq. 20 with n for N", optics, "normal_differential", _unnormalised),
    Fault("curvature times three", "3 dN/dx", optics, "normal_differential", _tripled),
    Fault("layer swapped", "two charts' texture coordinates exchanged", layermap, "rows_of", _exchanged),
    Fault("half a voxel off", "samples taken for the middles of voxels", Lattice, "to_world", _between_nodes),
)
