"""The parts of the report, as records.

In: nothing. Out: `Section`, with its tables, pictures and headline figures, and how numbers are written in them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from validate.experiment import Run


@dataclass(frozen=True, slots=True)
class Picture:
    """An image (data URI) and what it shows; those that are not wide stand beside each other."""

    source: str
    caption: str
    wide: bool = True


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of text under a header; the first column is left-aligned, the others are numbers, those in `prose` words."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    prose: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Inspector:
    """A picture whose pixels can be pointed at.

    Attributes
    ----------
    name, caption
        What it is called on the page, and what it shows.
    legend
        Names and colours of the routes, in the order of the data.
    data
        JSON for templates/inspector.js: picture and texture as data URIs; per route what was seen, base64.
    """

    name: str
    caption: str
    legend: tuple[tuple[str, str], ...]
    data: str


@dataclass(frozen=True, slots=True)
class Headline:
    """One line of the headline table: what was measured, the figure, against what; whether it is met, if a limit."""

    what: str
    figure: str
    against: str
    met: bool | None = None


@dataclass(frozen=True, slots=True)
class Section:
    """One experiment: what was asked, the finding in sentences written from the numbers, tables and pictures."""

    name: str
    title: str
    asked: str
    finding: tuple[str, ...]
    headlines: tuple[Headline, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    inspectors: tuple[Inspector, ...] = ()


def number(value: float | None, digits: int = 3) -> str:
    """A number for a table: three digits, powers of ten where they are shorter, a dash for none."""
    if value is None:
        return "-"
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        return f"{value:.{digits}g}" if abs(value) < 1000 else f"{value:,.0f}"
    mantissa, exponent = f"{value:.{digits - 2}e}".split("e")
    return f"{mantissa}e{int(exponent):d}"


def percent(share: float | None) -> str:
    """A share as a percentage."""
    return "-" if share is None else f"{number(100 * share)} %"


def pick(runs: Sequence[Run], kind: str = "error", **setup: str) -> list[Run]:
    """Runs that did not fail, of one kind, whose setup agrees; by their knob."""
    chosen = [run for run in runs if run.ok and run.kind == kind and setup.items() <= run.setup.items()]
    return sorted(chosen, key=lambda run: tuple(sorted(run.knob.items())))
