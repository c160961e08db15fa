"""What the report says about the proof of the validators."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.plots import Series
from validate.section import Headline, Picture, Section, Table, number, pick

HEALTHY = "none"
TITLE = "Do the checks find a fault?"
ASKED = (
    "A check that cannot fail proves nothing. Six faults are planted in the renderer, one at a time, and a battery of "
    "checks looks at each: identities, closed forms, displaced rays through the same field, order of convergence, "
    "hits and texture coordinates. Which checks catch which fault, and to which are they blind?"
)
NOTES = (
    "A dot after a figure means that the check is blind to the fault: its figure stays within the limit. Displaced "
    "rays go through the same field as the beam, so they are blind to all that is wrong in the same way for both: a "
    "wrong index, or a surface that is elsewhere. The symplectic form is blind to a wrong curvature that is some "
    "surface's own. No check alone is enough.",
)


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = pick(runs)
    if not found:
        return Section("faults", TITLE, ASKED, ("No run succeeded, so no check was tried.",))
    names = list(dict.fromkeys(run.problem for run in found))
    rows = {name: [run for run in found if run.problem == name] for name in names}
    planted = [name for name in names if name != HEALTHY]
    return Section(
        name="faults",
        title=TITLE,
        asked=ASKED,
        finding=_finding(rows, planted),
        headlines=_headlines(rows, planted),
        pictures=(_picture(rows),),
        tables=(_table(rows), _limits(found)),
        notes=(*NOTES, *(f"{name}: {rows[name][0].setup['about']}." for name in planted)),
    )


def caught(runs: Sequence[Run]) -> list[str]:
    """Names of the checks whose figure passes the limit."""
    return [run.setup["check"] for run in runs if run.values["figure"] > run.values["limit"]]


def _finding(rows: dict[str, list[Run]], planted: Sequence[str]) -> tuple[str, ...]:
    alarms = caught(rows.get(HEALTHY, []))
    sentences = []
    if HEALTHY in rows:
        count = len(rows[HEALTHY])
        sentences.append(
            f"The healthy renderer passes all {count} checks."
            if not alarms
            else f"The healthy renderer fails {len(alarms)} of {count} checks: {', '.join(alarms)}."
        )
    escaped = [name for name in planted if not caught(rows[name])]
    if planted:
        head = f"Of {len(planted)} planted faults {len(planted) - len(escaped)} are caught"
        sentences.append(head + (f"; nothing finds {', '.join(escaped)}." if escaped else "."))
    for name in planted:
        by = caught(rows[name])
        blind = len(rows[name]) - len(by)
        if by:
            checks = "check is" if blind == 1 else "checks are"
            sentences.append(f"{name}: caught by {', '.join(by)}; {blind} {checks} blind to it.")
    return tuple(sentences)


def _headlines(rows: dict[str, list[Run]], planted: Sequence[str]) -> tuple[Headline, ...]:
    if not planted:
        return ()
    finders = sum(bool(caught(rows[name])) for name in planted)
    alarms = len(caught(rows.get(HEALTHY, [])))
    return (
        Headline(
            "Planted faults that the checks catch / false alarms on the healthy renderer",
            f"{finders} of {len(planted)} / {alarms}",
            "all / none",
            finders == len(planted) and not alarms,
        ),
    )


def _picture(rows: dict[str, list[Run]]) -> Picture:
    """Every check's figure as a share of its limit, one colour per fault."""
    checks = list(dict.fromkeys(run.setup["check"] for found in rows.values() for run in found))
    series = [
        Series(
            "healthy" if name == HEALTHY else name,
            np.array([run.values["figure"] / run.values["limit"] for run in found]),
            np.array([float(checks.index(run.setup["check"])) for run in found]),
        )
        for name, found in rows.items()
    ]
    caption = "Figures of the checks as shares of their limits; in the shaded part a fault is caught."
    return Picture(plots.shares(series, "figure / limit", checks), caption)


def _table(rows: dict[str, list[Run]]) -> Table:
    """Checks down, faults across."""
    checks = list(dict.fromkeys(run.setup["check"] for found in rows.values() for run in found))
    by = {(name, run.setup["check"]): run.values for name, found in rows.items() for run in found}

    def cell(name: str, check: str) -> str:
        values = by.get((name, check))
        if values is None:
            return "failed"
        if name == HEALTHY:
            return number(values["figure"])
        return f"{number(values['figure'])} {'caught' if values['figure'] > values['limit'] else '·'}"

    lines = tuple((check, *(cell(name, check) for name in rows)) for check in checks)
    header = ("Check", *("healthy" if name == HEALTHY else name for name in rows))
    return Table("Figure of every check with every fault: caught, or blind (a dot).", header, lines)


def _limits(found: Sequence[Run]) -> Table:
    first = {run.setup["check"]: run for run in reversed(found)}
    lines = tuple(
        (check, run.setup["compares"], run.setup["unit"], number(run.values["limit"]))
        for check, run in reversed(first.items())
    )
    return Table("The checks.", ("Check", "compares", "unit", "limit"), lines, prose=(1,))
