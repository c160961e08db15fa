"""The tracer held against brute force on any samples, as a check.

In: dense samples, an engine, rays. Out: a `Check` that counts rays whose first root was missed, came late or is none.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Choice
from sdfbake.grid import Grid
from sdfrender import GridField, trace
from sdfrender.kernels import Kernel
from validate.beam import MeshRays
from validate.bruteforce import Interpolant, Lines
from validate.course import Course
from validate.stress.case import Check, Finding
from validate.suites.misses import compare, setups, tolerances

Aim = Callable[[np.random.Generator, int, tuple[int, ...], GridField], Lines]
SEED = 20180412


def none_missed(
    name: str, values: Float[np.ndarray, "nx ny nz"], of: Kernel, choice: Choice, aim: Aim, count: int
) -> Check:
    """No first root is missed, late or false, beyond the tracer's own rounding bound.

    Parameters
    ----------
    name
        Of the check.
    values
        Samples, spacing 1, origin 0.
    of, choice
        The kernel and the tracer's engine; brute force takes the fastest one in float64.
    aim, count
        Makes so many rays, as those of `validate.suites.misses`.
    """
    dense = values.astype(np.float32)

    def field() -> GridField:
        return GridField(Grid.from_dense(dense), of, choice)

    def find() -> Finding:
        ours = field()
        rays = aim(np.random.default_rng(SEED), count, dense.shape, ours)
        truth = Interpolant(dense.astype(np.float64), of, setups()[0][0].engine)

        def wrong(some: Lines) -> float:
            found = compare(truth, some, lambda rays: trace(ours, rays.p, rays.d).t, tolerances(ours))
            return found["missed"] + found["late"] + found["false"]

        errors = np.zeros(len(rays.p))
        if wrong(rays):
            errors[_one_of(rays, wrong)] = wrong(rays)
        still = np.zeros_like(rays.p)
        return Finding(errors, MeshRays(rays.p, rays.d, still, still, still, still))

    return Check(name, "count", 0.0, find, lambda: Course(field()))


def _one_of(rays: Lines, wrong: Callable[[Lines], float]) -> int:
    """Halve the rays until one that is wrong is left."""
    rows = np.arange(len(rays.p))
    while len(rows) > 1:
        half = rows[: len(rows) // 2]
        rows = half if wrong(rays.where(half)) else rows[len(rows) // 2 :]
    return int(rows[0])
