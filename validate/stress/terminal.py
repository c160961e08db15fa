"""Stress cases on the terminal: the table of what became of them, and the replay of a worst ray.

In: names of cases. Out: text, or one JSON object; whether nothing failed.
"""

import sys
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from sdfbake.commandline import print_json
from sdfbake.complaint import BadInput
from validate.experiment import Bench, Run, read_runs, write_runs
from validate.section import number
from validate.stress.outcome import SUITE, Outcome, outcome
from validate.stress.replay import told, worst
from validate.suites import stress

COLOURS = {"pass": "green", "known limit": "yellow", "fail": "bold red", "broken": "bold red"}


def table(only: str | None, output: Path | None, *, as_json: bool) -> bool:
    """Run cases and print what became of each check; says whether nothing failed.

    Raises
    ------
    BadInput
        If there is no such case, or the runs cannot be written.
    """
    runs = _measured(only)
    if output is not None:
        write_runs(output, runs)
    found = [outcome(one) for one in runs]
    if as_json:
        print_json({"checks": [asdict(one) for one in found]})
    else:
        _print(found)
    return all(one.verdict in ("pass", "known limit") for one in found)


def replay(name: str, check: str | None, runs: Path) -> None:
    """Trace the worst ray of a case alone, step by step.

    Parameters
    ----------
    name
        The case.
    check
        The check whose worst ray is meant; None for the one nearest to its limit.
    runs
        Where the worst rays are stored; the case is run now where there is no such file, or the case is not in it.

    Raises
    ------
    BadInput
        If there is no such case or check, or none that traces rays.
    """
    case = stress.case_named(name)
    stored = [one for one in read_runs([runs]) if one.suite == SUITE and one.problem == name] if runs.exists() else []
    found = [outcome(one) for one in stored or _measured(name)]
    if check is not None:
        named = [one for one in found if one.check == check]
        if not named:
            names = ", ".join(f"'{one}'" for one in dict.fromkeys(one.check for one in found))
            raise BadInput(f"the case '{name}' has no check '{check}': choose one of {names}")
        found = named
    for line in told(case, worst(found)):
        print(line)


def _measured(only: str | None) -> list[Run]:
    console = Console(stderr=True)
    with Progress(console=console, disable=not sys.stderr.isatty(), transient=True) as bar:
        task = bar.add_task("stress", total=1 if only else len(stress.cases()))

        def progress(line: str) -> None:
            bar.update(task, description=line, advance=1)

        return list(stress.run(Bench(Path(), Path(), progress, only)))


def _print(found: list[Outcome]) -> None:
    console = Console(soft_wrap=False)
    shown = Table("case", "check", "engine", "figure", "limit", "unit", "verdict", box=None, pad_edge=False)
    for one in found:
        cells = (one.case, one.check, one.engine, number(one.figure), number(one.limit), one.unit)
        shown.add_row(*cells, f"[{COLOURS[one.verdict]}]{one.verdict}[/]")
    console.print(shown, highlight=False)
    for text in dict.fromkeys(f"{one.case}: {one.known}" for one in found if one.verdict in ("known limit", "broken")):
        console.print(f"known limit of {text}", highlight=False, markup=False)
