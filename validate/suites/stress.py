"""Stiff and extreme cases: each states what must hold, and is measured on every engine that it is meant for.

In: nothing of the build. Out: an error run per case, check and engine, with the worst ray.
"""

import importlib
from collections.abc import Iterator
from functools import cache

from sdfbake.complaint import BadInput
from validate.experiment import Bench, Run
from validate.stress import THEMES
from validate.stress.case import Case
from validate.stress.outcome import outcomes, usable


@cache
def cases() -> dict[str, Case]:
    """All cases by name, in the order of the report."""
    found: dict[str, Case] = {}
    for theme in THEMES:
        found |= {case.name: case for case in importlib.import_module(f"validate.stress.{theme}").CASES}
    return found


def case_named(name: str) -> Case:
    """The case of that name.

    Raises
    ------
    BadInput
        If there is none.
    """
    known = cases()
    if name not in known:
        raise BadInput(f"there is no stress case '{name}': choose one of {', '.join(known)}")
    return known[name]


def run(bench: Bench) -> Iterator[Run]:
    """Run all cases, or the one that is named."""
    for case in cases().values() if bench.only is None else [case_named(bench.only)]:
        bench.progress(f"stress: {case.title}")
        for name, choice in usable().items():
            if name in case.engines:
                yield from outcomes(case, name, choice)
