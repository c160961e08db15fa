"""What the commands of the baker share: one way to print a record, to show progress, to mend a mesh first.

In: plain records. Out: a table or one JSON object on standard output, progress and warnings on standard error.
"""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sdfbake import commandline
from sdfbake.diagnosis import diagnose
from sdfbake.mesh import Mesh

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


def repaired(mesh: Mesh) -> tuple[Mesh, list[str]]:
    """Mend what is harmless; refuse what has no cure at once."""
    from sdfbake.repair import repair

    found = diagnose(mesh)
    if found.has("empty") or found.has("non-finite"):
        found.require_bakeable()
    return repair(mesh, found) if found.repairable else (mesh, [])


def chart_count(mesh: Mesh) -> int:
    """Return the number of charts of a mesh's atlas."""
    return 0 if mesh.uv is None else int(mesh.chart.max()) + 1


def print_record(record: dict[str, Any], *, as_json: bool) -> None:
    """Print a record as JSON or as a table."""
    if as_json:
        commandline.print_json(record)
        return
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column()
    table.add_column(overflow="fold")  # a path is broken, never cut
    for name, value in record.items():
        table.add_row(name.replace("_", " "), escape(_plain(value)))
    Console().print(table)


def _plain(value: Any) -> str:
    """Return a value as a person would write it."""
    if isinstance(value, dict):
        return "\n".join(f"{name} {_plain(entry)}" for name, entry in value.items())
    if isinstance(value, list):
        return ", ".join(map(_plain, value)) or "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "-" if value is None else f"{value:,}" if isinstance(value, int) and value > 9999 else str(value)


@contextmanager
def progress() -> Iterator[Any]:
    """Yield a function that shows stages on a terminal, and print warnings as lines when all is done."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    tasks: dict[str, Any] = {}

    def report(stage: str, share: float) -> None:
        if stage not in tasks:
            tasks[stage] = bar.add_task(stage, total=1.0)
        bar.update(tasks[stage], completed=share)

    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", UserWarning)
        with bar:
            yield report
    for message in heard:
        print(f"warning: {message.message}", file=sys.stderr)
