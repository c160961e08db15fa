"""What became of a check: passed, failed, or a known limit; as a run, and read back from one.

In: a case and an engine. Out: `Run` records that hold the figure, its limit and the worst ray; `Outcome`, what a table
or a replay reads from one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Literal

import numpy as np
from jaxtyping import Float

from sdfbake.complaint import BadInput
from sdfbake.engine import Choice, choose
from sdfrender.rays import COLUMNS
from validate.beam import Beam, MeshRays, only
from validate.experiment import Run, guarded
from validate.stress.case import SETUPS, Case, Check

SUITE = "stress"
Verdict = Literal["pass", "fail", "known limit", "broken"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """One check on one engine.

    Attributes
    ----------
    case, check, engine
        What, and on which of `validate.stress.case.SETUPS`.
    verdict
        "broken" where the check itself raised.
    figure, limit, unit
        The greatest error, what it may be, and in which unit; 0 where the check is broken.
    places, nonfinite
        Rays or places that were looked at, and those without a finite error.
    known
        Why the limit is not met, or why the check is broken; empty elsewhere.
    ray
        The 18 components of the worst ray; empty where there is none.
    """

    case: str
    check: str
    engine: str
    verdict: Verdict
    figure: float
    limit: float
    unit: str
    places: int
    nonfinite: int
    known: str
    ray: tuple[float, ...]

    @property
    def share(self) -> float:
        """The figure as a share of the limit; infinite beyond a limit of 0."""
        if self.limit > 0:
            return self.figure / self.limit
        return 0.0 if self.figure == 0 else float("inf")


@cache
def usable() -> dict[str, Choice]:
    """The setups that can run here; NumPy always can."""
    found = {}
    for name, (engine, precision) in SETUPS.items():
        try:
            found[name] = choose(engine, precision)
        except BadInput:
            continue
    return found


def outcomes(case: Case, name: str, choice: Choice) -> Iterator[Run]:
    """Run all checks of a case on one setup; those that raise are runs that failed."""
    blank = Run(SUITE, case.name, {"check": "all", "engine": name}, {}, "error")
    checks: list[Check] = []
    prepared = guarded(blank, partial(_prepared, blank, case, choice, checks))
    if not prepared.ok:
        yield prepared
    for check in checks:
        setup = {"check": check.name, "engine": name, "unit": check.unit, "known": check.known}
        one = replace(blank, setup=setup)
        yield guarded(one, partial(_checked, one, check))


def _prepared(blank: Run, case: Case, choice: Choice, checks: list[Check]) -> Run:
    checks.extend(case.checks(choice))
    return blank


def _checked(blank: Run, check: Check) -> Run:
    found = check.find()
    errors = np.abs(np.asarray(found.errors, np.float64)).ravel()
    if errors.size == 0:
        raise ValueError("the check looked at nothing")
    finite = np.isfinite(errors)
    worst = int(np.argmax(np.where(finite, errors, np.inf)))
    values = {
        "figure": float(errors[finite].max(initial=0.0)),
        "limit": check.limit,
        "places": float(errors.size),
        "nonfinite": float((~finite).sum()),
    }
    ray = {} if found.rays is None else {"ray": _components(only(found.rays, np.array([worst])))}
    return replace(blank, values=values, samples=ray)


def _components(ray: Beam) -> list[float]:
    return [float(x) for name in COLUMNS for x in getattr(ray, name)[0]]


def beam_of(ray: tuple[float, ...]) -> MeshRays:
    """The one ray that 18 components describe."""
    parts: list[Float[np.ndarray, "1 3"]] = [np.array([ray[i : i + 3]]) for i in range(0, 18, 3)]
    return MeshRays(*parts)


def outcome(run: Run) -> Outcome:
    """Read what became of a check from its run."""
    values, setup = run.values, run.setup
    known = setup.get("known", "") if run.ok else run.status
    figure, limit, nonfinite = (values.get(name, 0.0) for name in ("figure", "limit", "nonfinite"))
    passed = run.ok and figure <= limit and nonfinite == 0
    verdict: Verdict = "broken" if not run.ok else "pass" if passed else "known limit" if known else "fail"
    return Outcome(
        case=run.problem,
        check=setup.get("check", "all"),
        engine=setup.get("engine", ""),
        verdict=verdict,
        figure=figure,
        limit=limit,
        unit=setup.get("unit", ""),
        places=int(values.get("places", 0)),
        nonfinite=int(nonfinite),
        known=known,
        ray=tuple(run.samples.get("ray", ())),
    )
