"""Limits that were set for ours, and whether the figures keep them.

In: limits, and what their figures are found in. Out: sentences, a table and headlines for the report.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from validate.section import Headline, Table, number


@dataclass(frozen=True, slots=True)
class Limit:
    """A figure of ours and the most that it may be.

    Attributes
    ----------
    what
        In words.
    most
        The limit.
    unit
        Of both; "x" is written without a space.
    measured
        Finds the figure; None where its runs are missing.
    headline
        Whether it is shown at the head of the report.
    """

    what: str
    most: float
    unit: str
    measured: Callable[[Any], float | None]
    headline: bool = False

    def shown(self, value: float) -> str:
        """A figure with the unit."""
        return f"{number(value)}{'' if self.unit in ('', 'x') else ' '}{self.unit}"


Figures = Sequence[tuple[Limit, float | None]]


def figures(limits: Sequence[Limit], points: Any) -> Figures:
    """Find the figure of every limit."""
    return [(limit, limit.measured(points)) for limit in limits]


def table(found: Figures) -> Table:
    """Every limit, and whether it is kept."""
    rows = tuple(
        (
            limit.what,
            "-" if value is None else limit.shown(value),
            limit.shown(limit.most),
            "not measured" if value is None else "yes" if value <= limit.most else "no",
        )
        for limit, value in found
    )
    return Table("Ours against the limits that were set for it.", ("Figure", "measured", "at most", "met"), rows)


def met(found: Figures) -> str:
    """Say in a sentence how many limits are kept, and name the others."""
    measured = [(limit, value) for limit, value in found if value is not None]
    broken = [f"{limit.what} ({limit.shown(value)})" for limit, value in measured if value > limit.most]
    tail = f"; not met: {'; '.join(broken)}." if broken else "."
    return f"Of {len(measured)} limits that could be measured, {len(measured) - len(broken)} are met{tail}"


def headlines(found: Figures) -> tuple[Headline, ...]:
    """Lines for the head of the report."""
    return tuple(
        Headline(limit.what, limit.shown(value), f"at most {limit.shown(limit.most)}")
        for limit, value in found
        if limit.headline and value is not None
    )
