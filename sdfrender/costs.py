"""What things cost, roughly, so that a plan can say what it saves.

In: how often a path does something. Out: shares of the planned tracing time. Nanoseconds per time were measured once,
on two cores of a server: the bunny at 128, 147,456 rays on Dr.Jit and 9,216 on NumPy, three quarters of them hits, each
figure the difference between two pictures of which one does one thing more. A surface of another form or size changes
them all; their ratios less. So they are estimates, of one digit, and of a path that hits at every turn.
"""

from collections.abc import Mapping
from typing import NamedTuple

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
    hits = len(plan.orders)
    jets = [GRADIENT for order in plan.orders if order] + [HESSIAN for order in plan.orders if order == 2]
    uv = [UV.get(asset.uv_mode, FREE) for asset in plan.assets if asset.uv_mode]
    carried = DIFFERENTIALS.times(hits if plan.differentials else 0)
    parts = PART.times(hits if plan.parts else 0)
    dearest = max(uv, key=lambda cost: cost.numpy, default=FREE)
    return total(MARCH.times(hits), *jets, carried, parts, dearest, lights, filters)


def saving(extra: Cost, planned: Cost) -> Saving | None:
    """Return what leaving something out saves, as a share of what is planned; None for nothing."""
    if extra == FREE:
        return None
    return Saving(round(extra.numpy / planned.numpy, 2), round(extra.drjit / planned.drjit, 2))
