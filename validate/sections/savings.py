"""What the report says about what scenes leave out."""

from collections.abc import Sequence

from validate.experiment import Run
from validate.section import Headline, Section, Table, number, percent, pick
from validate.suites.savings import FLAT, IDLE, TENTH

TITLE = "What a scene does not need"
ASKED = (
    "A scene pays only for what its outputs use. Each is rendered as planned, and with everything on: all channels and "
    "bricks read, all outputs recorded, Hessians and differentials at every hit; same rays, same engine. Pictures must "
    "be the same to the last bit, and counters show that what was left out was not done."
)
LIMITS = {"drjit": 0.6, "numpy": 0.5, "bytes": 0.75, "bricks": 0.2}


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    errors, times = {run.problem: run for run in pick(runs)}, pick(runs, "timing")
    rows = tuple(_row(name, run, times) for name, run in errors.items())
    header = (
        "Scene",
        "left out",
        "bytes read",
        "bricks in sight",
        "bricks read",
        "NumPy time",
        "Dr.Jit time",
        "values differ",
    )
    return Section(
        name="savings",
        title=TITLE,
        asked=ASKED,
        finding=_finding(errors, times) or ("No run succeeded.",),
        headlines=_headlines(errors, times),
        tables=(
            Table(
                "Shares of what everything takes; times as measured, and in brackets as the plan had them.",
                header,
                rows,
            ),
            _work(errors),
        )
        if rows
        else (),
    )


def share(times: Sequence[Run], problem: str, engine: str) -> float | None:
    """Return the time of the planned run over that of everything."""
    found = {
        run.setup["what"]: run.values["seconds"]
        for run in times
        if run.kind == "timing" and run.problem == problem and run.setup["engine"] == engine
    }
    return found["planned"] / found["everything"] if len(found) == 2 else None


def _row(name: str, run: Run, times: Sequence[Run]) -> tuple[str, ...]:
    values = run.values
    return (
        f"{name}, {run.knob['resolution']:g}³",
        f"{values['left_out']:.0f} things",
        percent(values["bytes"] / values["of_bytes"]),
        percent(values["in_sight"]),
        percent(values["bricks"] / values["of_bricks"]),
        *(_both(share(times, name, engine), values.get(f"said.{engine}")) for engine in ("numpy", "drjit")),
        f"{values['differing']:.0f}" if "differing" in values else "-",
    )


def _both(measured: float | None, said: float | None) -> str:
    """Return a share as measured, and as the plan had it."""
    return percent(measured) if measured is None or said is None else f"{percent(measured)} ({percent(said)})"


def _finding(errors: dict[str, Run], times: Sequence[Run]) -> tuple[str, ...]:
    sentences = []
    differing = sum(run.values.get("differing", 0.0) for run in errors.values())
    if errors:
        same = "the same to the last bit" if not differing else f"NOT the same: {differing:.0f} values differ"
        idle = sum(run.values.get(f"planned.{name}", 0.0) for run in errors.values() for name in IDLE)
        done = "none was" if not idle else "SOME were"
        sentences.append(
            f"Planned pictures are {same}; of Hessians and texture look-ups that were left out {done} done."
        )
    for engine, word in (("drjit", "Dr.Jit"), ("numpy", "NumPy")):
        found = share(times, FLAT, engine)
        if found is not None:
            asked = f"at most {LIMITS[engine]:g}" + ("" if found <= LIMITS[engine] else " is asked for and NOT reached")
            said = errors[FLAT].values.get(f"said.{engine}") if FLAT in errors else None
            planned = f"; the plan had estimated {number(said, 2)}" if said is not None else ""
            sentences.append(f"Flat colours take {number(found, 2)} of the time on {word} ({asked}){planned}.")
    wrong = [name for name, run in errors.items() if any(_missed(run, what) for what in ("bytes", "bricks"))]
    if errors and not wrong:
        sentences.append("Bytes and bricks read are those that the plan said before, to the byte.")
    elif wrong:
        sentences.append(f"Bytes or bricks read are NOT those that the plan said: {', '.join(wrong)}.")
    return tuple(sentences)


def _missed(run: Run, what: str) -> bool:
    return run.values.get(f"said.{what}") != run.values[what]


def _headlines(errors: dict[str, Run], times: Sequence[Run]) -> tuple[Headline, ...]:
    lines = []
    for engine, word in (("drjit", "Dr.Jit"), ("numpy", "NumPy")):
        found = share(times, FLAT, engine)
        if found is not None:
            what, limit = f"Flat scene, planned: share of the time, {word}", LIMITS[engine]
            lines.append(Headline(what, number(found, 2), f"at most {limit:g}", found <= limit))
    for name, what in ((FLAT, "bytes"), (TENTH, "bricks")):
        if name in errors:
            values = errors[name].values
            share_read, limit = values[what] / values[f"of_{what}"], LIMITS[what]
            title = f"{name.capitalize()}: share of the {what} read"
            lines.append(Headline(title, number(share_read, 2), f"at most {limit:g}", share_read <= limit))
    return tuple(lines)


def _work(errors: dict[str, Run]) -> Table:
    """Counts per ray, planned and with everything on."""
    names = ("values", "gradients", "hessians", "channels", "polynomials")
    rows = tuple(
        (f"{name}, {word}", *(number(run.values.get(f"{kind}.{counter}")) for counter in names))
        for name, run in errors.items()
        for kind, word in (("planned", "planned"), ("full", "everything"))
        if f"{kind}.values" in run.values
    )
    return Table("Work per ray, counted.", ("Run", *names), rows)
