"""Proof of the validators: faults planted in the renderer one at a time, and which checks catch each.

In: nothing from the build. Out: an error run per fault and check, with figure and limit; the healthy renderer first.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from validate.battery import CHECKS, Check, Ground, Subject, measured
from validate.experiment import Bench, Run, guarded
from validate.faults import FAULTS, Fault, planted

HEALTHY = "none"


def run(bench: Bench) -> Iterator[Run]:
    """The battery without a fault, and with each."""
    ground = Ground.made()
    for fault in (None, *FAULTS):
        bench.progress(f"the battery with the fault: {HEALTHY if fault is None else fault.name}")
        yield from battery(fault, ground)


def battery(fault: Fault | None, ground: Ground) -> list[Run]:
    """All checks with one fault planted; the renderer is right again when they are back."""
    runs: list[Run] = []
    made: list[Subject] = []

    def subject() -> Subject:
        if not made:
            made.append(Subject.at_work(ground))
        return made[0]

    with planted(fault):
        for check in CHECKS:
            setup = {"check": check.name, "about": "nothing is wrong" if fault is None else fault.about}
            setup |= {"compares": check.compares, "unit": check.unit}
            blank = Run("faults", HEALTHY if fault is None else fault.name, setup, {}, "error")
            runs.append(guarded(blank, partial(_judged, blank, check, subject)))
    return runs


def _judged(blank: Run, check: Check, subject: Callable[[], Subject]) -> Run:
    figure = measured(check, subject())
    return replace(blank, values={"figure": figure, "limit": check.limit, "caught": float(figure > check.limit)})
