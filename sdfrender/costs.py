"""What things cost, roughly, so that a plan can say what it saves.

In: how often a path does something, hit by hit, as counters would count it (`validate.counters`; tests/test_evaluations
compares them). Out: nanoseconds and shares of the planned tracing time.

What one time costs was measured once, on two cores of a server: the bunny at 128, 147,456 rays on Dr.Jit and 9,216 on
NumPy, three quarters of them hits, the least of several runs, each figure the difference between two pictures of which
one does one thing more, per hit: Z alone (a march, per ray); with N, with curvature (gradient, Hessian); with uv, by
each representation; with lod (differentials); with a part; rgb with one texture, by each filter; with a light, with its
shadow; and any output of one channel more, per pixel. A surface of another form or size changes them all; their ratios
less. So they are estimates, of one digit, and of paths that hit at every turn. The suite `savings` of `validate` shows
the shares that they give beside those that it measures.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from sdfrender.image import CHANNELS
from sdfrender.planned import Plan, Saving


class Cost(NamedTuple):
    """Nanoseconds on the two engines."""

    numpy: float
    drjit: float

    def times(self, count: float) -> "Cost":
        """Return the cost of that many."""
        return Cost(self.numpy * count, self.drjit * count)


FREE = Cost(0.0, 0.0)
MARCH = Cost(5600.0, 160.0)  # a ray to its first hit
GRADIENT, HESSIAN, DIFFERENTIALS = Cost(1000.0, 5.0), Cost(300.0, 7.0), Cost(400.0, 7.0)  # of a hit
PART = Cost(100.0, 3.0)
UV: Mapping[str, Cost] = {"faces": Cost(5500.0, 210.0), "layers": Cost(1300.0, 70.0), "grid": Cost(1700.0, 75.0)}
FILTER: Mapping[str, Cost] = {
    "point": Cost(200.0, 10.0),
    "bilinear": Cost(300.0, 15.0),
    "trilinear": Cost(900.0, 25.0),
    "anisotropic": Cost(40000.0, 600.0),
    "checker": Cost(300.0, 10.0),
}
LIGHT, SHADOW = Cost(700.0, 20.0), Cost(8700.0, 75.0)
RECORD = Cost(70.0, 10.0)  # a channel of an output, of a pixel


@dataclass(frozen=True, slots=True)
class Evaluations:
    """How often paths do what; `validate.counters` counts the first four by the same names.

    Attributes
    ----------
    marches
        Rays sent out, those to lights aside.
    values, gradients, hessians
        Jets, of their order and above.
    parts, coordinates
        Looks at the part of a hit, and at the texture coordinates where a path ends.
    """

    marches: float
    values: float
    gradients: float
    hessians: float
    parts: float
    coordinates: float


def evaluations(plan: Plan, sent: Sequence[float], met: Sequence[float], ended: float) -> Evaluations:
    """Return what a plan does.

    Parameters
    ----------
    plan
        The plan.
    sent, met
        For the first, second, ... hit of a path how many rays are sent for it, and how many of them meet something.
    ended
        How many paths end on something that is neither mirror nor glass.
    """
    jets = [(order or 0, count) for order, count in zip(plan.orders, met, strict=True) if order is not None]
    return Evaluations(
        marches=sum(sent),
        values=sum(count for _, count in jets),
        gradients=sum(count for order, count in jets if order >= 1),
        hessians=sum(count for order, count in jets if order == 2),
        parts=sum(met) if plan.parts else 0,
        coordinates=ended if plan.uv else 0,
    )


def total(*costs: Cost) -> Cost:
    """Add up."""
    return Cost(sum(cost.numpy for cost in costs), sum(cost.drjit for cost in costs))


def of_plan(plan: Plan, lights: Cost, filters: Cost) -> Cost:
    """Return what a path takes that meets something at every turn.

    Parameters
    ----------
    plan
        What is done at its hits.
    lights, filters
        Of lights and of textures, where it ends.
    """
    once = [1.0] * len(plan.orders)
    done = evaluations(plan, once, once, 1.0)
    uv = [UV.get(asset.uv_mode, FREE) for asset in plan.assets if asset.uv_mode]
    dearest = max(uv, key=lambda cost: cost.numpy, default=FREE)
    return total(
        MARCH.times(done.marches),
        GRADIENT.times(done.gradients),
        HESSIAN.times(done.hessians),
        DIFFERENTIALS.times(len(once) if plan.differentials else 0),
        PART.times(done.parts),
        dearest.times(done.coordinates),
        lights,
        filters,
        RECORD.times(sum(len(CHANNELS[output][0]) for output in plan.outputs)),
    )


def saving(extra: Cost, planned: Cost) -> Saving | None:
    """Return what leaving something out saves, as a share of what is planned; None for nothing."""
    if extra == FREE:
        return None
    return Saving(round(extra.numpy / planned.numpy, 2), round(extra.drjit / planned.drjit, 2))
