"""A stress case, as a record: what must hold and why, and the checks that tell.

In: an engine. Out: `Finding`s, an error per ray (or place), the worst of which is kept so that it can be replayed. A
case that the method cannot meet is a known limit, with its sentence and its figure; it is never dropped.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped

from sdfbake.engine import Choice
from validate.beam import Beam
from validate.course import Course


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """What a check found.

    Attributes
    ----------
    errors
        (n,) one number per ray or place, in the check's unit; the greatest is the figure, and one that is not finite
        fails the check.
    rays
        The n rays, where the check traces any: the worst is kept for replay.
    """

    errors: Shaped[np.ndarray, " n"]
    rays: Beam | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """One statement of a case on one engine.

    Attributes
    ----------
    name
        What is varied and compared: "cos 1e-4: J against the closed form".
    unit
        Of the figure: "relative", "voxel", "texel", "share", "count".
    limit
        The figure may be this at most; derived in a comment where it is written.
    find
        Makes the measurement.
    course
        The way of its rays, for replay; None where it traces none.
    known
        Why the method cannot meet the limit; empty where it must.
    """

    name: str
    unit: str
    limit: float
    find: Callable[[], Finding]
    course: Callable[[], Course] | None = None
    known: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A named case.

    Attributes
    ----------
    name
        In lower case with hyphens, for the command line: "plane-grazing".
    title
        In words.
    holds
        What must hold, and why, in a sentence or two.
    checks
        From an engine to its checks; built lazily, so that grids are made only when the case runs.
    engines
        Names of the setups that it is meant for, of `SETUPS`.
    """

    name: str
    title: str
    holds: str
    checks: Callable[[Choice], Iterable[Check]]
    engines: tuple[str, ...] = ("numpy 64", "drjit 64", "drjit 32")


# Every setup a case may be meant for; those of Dr.Jit are left out where it cannot run.
SETUPS: dict[str, tuple[str, int]] = {"numpy 64": ("numpy", 64), "drjit 64": ("drjit", 64), "drjit 32": ("drjit", 32)}
