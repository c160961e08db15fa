"""The report: runs in, one self-contained page out.

In: `Run` records. Out: index.html with every picture inside, the same bytes for the same runs.
"""

import importlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2

from sdfbake.atomic import replacing
from sdfbake.complaint import BadInput
from validate.experiment import Run
from validate.section import Section
from validate.suites import SUITES

# Of a section's tables these many are open, if they have no more rows than this; the others are folded, in print open.
OPEN_TABLES, LONG_TABLE = 2, 48


@dataclass(frozen=True, slots=True)
class Failure:
    """A run that failed, as the report shows it."""

    suite: str
    what: str
    status: str


def write_report(runs: Sequence[Run], folder: str | Path) -> Path:
    """Write `folder`/index.html.

    Parameters
    ----------
    runs
        Of any suites; those without runs are named as not run.
    folder
        Made where it does not exist.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    BadInput
        If there are no runs, or of a suite that has no section, or the page cannot be written.
    """
    page = render(runs)
    path = Path(folder) / "index.html"
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8", newline="\n")
    return path


def render(runs: Sequence[Run]) -> str:
    """The page as a string."""
    if not runs:
        raise BadInput("there are no runs to report on: run 'python -m validate run SUITE -o RUNS.jsonl' first")
    unknown = sorted({run.suite for run in runs} - set(SUITES))
    if unknown:
        raise BadInput(f"there is no section for the suite {unknown[0]!r}: name runs of {', '.join(SUITES)}")
    sections = [_section(name, [run for run in runs if run.suite == name]) for name in SUITES]
    loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("report.html").render(
        sections=[section for section in sections if section],
        absent=[name for name, section in zip(SUITES, sections, strict=True) if section is None],
        headlines=[(section, line) for section in sections if section for line in section.headlines],
        failures=_failures(runs),
        open=OPEN_TABLES,
        long=LONG_TABLE,
        counts={"ok": sum(run.ok for run in runs), "all": len(runs)},
        footer=_footer(runs),
    )


def _section(name: str, runs: Sequence[Run]) -> Section | None:
    if not runs:
        return None
    section: Section = importlib.import_module(f"validate.sections.{name}").section(runs)
    return section


def _failures(runs: Sequence[Run]) -> list[Failure]:
    return [
        Failure(run.suite, ", ".join([run.problem, *run.setup.values(), *_knobs(run), run.kind]), run.status)
        for run in runs
        if not run.ok
    ]


def _knobs(run: Run) -> list[str]:
    return [f"{name} {value:g}" for name, value in run.knob.items()]


def _footer(runs: Sequence[Run]) -> list[tuple[str, str]]:
    """What the runs ran on; several answers where the runs were not made together."""
    machine = _distinct(", ".join(f"{name} {value}" for name, value in run.machine.items()) for run in runs)
    versions = _distinct(", ".join(f"{name} {value}" for name, value in run.versions.items()) for run in runs)
    return [
        ("Machine", machine),
        ("Versions", versions),
        ("Commit", _distinct(run.commit for run in runs)),
        ("Commands", _distinct(run.command for run in runs)),
    ]


def _distinct(words: Iterable[str]) -> str:
    return "; ".join(dict.fromkeys(words))
