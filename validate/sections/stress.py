"""What the report says about stiff and extreme cases."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.plots import Series
from validate.section import Headline, Picture, Section, Table, number
from validate.stress.outcome import Outcome, outcome
from validate.suites import stress

TITLE = "Stiff and extreme cases"
ASKED = (
    "Where do derivatives of rays break: at grazing angles, at caustics, after a thousand bounces, near the critical "
    "angle, on lattices of two samples, at the poles and corners of an atlas, on broken meshes? Each case below states "
    "what must hold and is measured on NumPy in float64 and on Dr.Jit in float64 and float32. Its figure is the worst "
    "of all its rays, against a limit derived from rounding or from the method's order; in every optical case the "
    "identities of ray differentials are checked as well, on four independent perturbations. What the method cannot "
    "meet is a known limit, with its figure."
)
NOTES = (
    "'python -m validate stress --replay CASE' traces the worst ray of a case alone and prints every step.",
    "A figure that is a share of its limit says how much room is left; 1 is at the limit.",
)
BEYOND = 1e4  # times its limit: where the picture ends
MARKS = {"pass": "pass", "known limit": "known limit", "fail": "FAIL", "broken": "BROKEN"}


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = [outcome(run) for run in runs]
    return Section(
        name="stress",
        title=TITLE,
        asked=ASKED,
        finding=_finding(found),
        headlines=_headlines(found),
        pictures=_picture(found),
        tables=(_overview(found), *_limits(found), _all(found)),
        notes=NOTES,
    )


def tally(found: Sequence[Outcome]) -> dict[str, int]:
    """How many outcomes there are of each verdict."""
    return {verdict: sum(one.verdict == verdict for one in found) for verdict in MARKS}


def _finding(found: Sequence[Outcome]) -> tuple[str, ...]:
    count = tally(found)
    names = dict.fromkeys(one.case for one in found)
    sentences = [
        f"{count['pass']} of {len(found)} checks of {len(names)} cases pass, {count['known limit']} show a known "
        f"limit, {count['fail'] + count['broken']} fail.",
        f"{sum(one.nonfinite for one in found)} errors of {sum(one.places for one in found):,} rays and places are not "
        "finite.",
    ]
    passed = [one for one in found if one.verdict == "pass" and one.limit > 0]
    if passed:
        tight = max(passed, key=lambda one: one.share)
        sentences.append(
            f"The tightest pass is {_titled(tight)}, '{tight.check}' on {tight.engine}, at {number(tight.share)} of "
            "its limit."
        )
    failed = [f"{_titled(one)}, '{one.check}' on {one.engine}" for one in found if one.verdict in ("fail", "broken")]
    if failed:
        sentences.append(f"Failed: {'; '.join(failed)}.")
    return tuple(sentences)


def _headlines(found: Sequence[Outcome]) -> tuple[Headline, ...]:
    count = tally(found)
    figure = f"{count['pass']} of {len(found)}"
    against = f"{count['known limit']} known limits, {count['fail'] + count['broken']} failures"
    identities = [one for one in found if one.check.startswith("identities") and one.engine != "drjit 32"]
    fails = count["fail"] + count["broken"]
    lines = [Headline("Stress checks that pass, on every engine and precision", figure, against, fails == 0)]
    if identities:
        worst = max(identities, key=lambda one: one.figure)
        what = f"Identities of ray differentials in {len(identities)} optical checks, float64: greatest defect"
        lines.append(Headline(what, number(worst.figure), "at most 1e-12", worst.figure <= 1e-12))
    return tuple(lines)


def _picture(found: Sequence[Outcome]) -> tuple[Picture, ...]:
    """Every check's figure as a share of its limit, the cases from the top."""
    names = list(dict.fromkeys(one.case for one in found))
    measured = [one for one in found if one.verdict != "broken"]
    if not measured:
        return ()
    series = []
    for engine in dict.fromkeys(one.engine for one in measured):
        mine = [one for one in measured if one.engine == engine]
        share = np.array([min(one.share, BEYOND) for one in mine])
        series.append(Series(engine, share, np.array([float(names.index(one.case)) for one in mine])))
    titles = [_titled(next(one for one in found if one.case == name)) for name in names]
    caption = (
        "Every check: the worst figure as a share of its limit, 1e-8 at the left standing for less, or nothing; beyond "
        "1, in the shaded part, are the known limits."
    )
    return (Picture(plots.shares(series, "figure / limit", titles), caption),)


def _overview(found: Sequence[Outcome]) -> Table:
    """One row per case: what must hold, how many checks pass, and how near to its limit the nearest is."""
    known = stress.cases()
    rows = []
    for name in dict.fromkeys(one.case for one in found):
        mine = [one for one in found if one.case == name]
        count = tally(mine)
        verdicts = ", ".join(f"{n} {MARKS[verdict]}" for verdict, n in count.items() if n)
        near = [one.share for one in mine if one.verdict == "pass" and one.limit > 0]
        holds = known[name].holds if name in known else ""
        rows.append((_titled(mine[0]), holds, verdicts, number(max(near, default=0.0))))
    header = ("Case", "What must hold", "Checks", "nearest to its limit")
    return Table(
        "Cases; the last column is the greatest figure over its limit of those that pass.",
        header,
        tuple(rows),
        prose=(1, 2),
    )


def _limits(found: Sequence[Outcome]) -> tuple[Table, ...]:
    """Known limits, with their figures and why; those of several engines in one row."""
    limited = [one for one in found if one.verdict == "known limit"]
    rows = []
    for key in dict.fromkeys((one.case, one.check, one.known) for one in limited):
        mine = [one for one in limited if (one.case, one.check, one.known) == key]
        figures = "; ".join(f"{one.engine}: {number(one.figure)}" for one in mine)
        rows.append(
            (f"{_titled(mine[0])}: {mine[0].check}", figures, f"{number(mine[0].limit)} {mine[0].unit}", mine[0].known)
        )
    if not rows:
        return ()
    header = ("Known limit", "Figure", "Limit", "Why")
    return (Table("What the method cannot meet.", header, tuple(rows), prose=(3, 1)),)


def _all(found: Sequence[Outcome]) -> Table:
    """Every check, the engines beside each other."""
    engines = tuple(dict.fromkeys(one.engine for one in found))
    rows = []
    for case, check in dict.fromkeys((one.case, one.check) for one in found):
        mine = {one.engine: one for one in found if (one.case, one.check) == (case, check)}
        first = next(iter(mine.values()))
        cells = [_cell(mine[engine]) if engine in mine else "-" for engine in engines]
        limits = dict.fromkeys(number(one.limit) for one in mine.values())
        rows.append((f"{_titled(first)}: {check}", *cells, " / ".join(limits), first.unit))
    header = ("Check", *engines, "limit", "unit")
    return Table("Every check: the worst figure per engine.", header, tuple(rows))


def _cell(one: Outcome) -> str:
    mark = "" if one.verdict == "pass" else f" ({MARKS[one.verdict]})"
    return f"{number(one.figure)}{mark}"


def _titled(one: Outcome) -> str:
    known = stress.cases()
    return known[one.case].title if one.case in known else one.case
