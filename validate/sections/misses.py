"""What the report says about surface that the tracer misses, or invents."""

from collections.abc import Sequence

from validate.experiment import Run
from validate.section import Headline, Section, Table, number, pick

TITLE = "No surface missed"
ASKED = (
    "Does the certified tracer miss surface, find it late, or find what is not there? It is held against float64 "
    "brute force, which samples the interpolant along every ray, looks into every dip and bisects every sign change. "
    "Where the two disagree, finer samples and the interpolant's value decide. Problems are hard: a wall thinner than "
    "a voxel, random numbers, tangents to within 1e-9 voxel, rays along axes and through nodes, mirrored rays that "
    "start on the surface. A float64 tracer must be right everywhere, a float32 one but for its stated tolerance: a "
    "value of twice the rounding bound, at a place 11 N u voxels away."
)
WRONG = (("missed", "missed"), ("late", "late"), ("false", "false"))
ENGINES = {"drjit": "Dr.Jit", "numpy": "NumPy"}


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    found = pick(runs)
    return Section(
        name="misses",
        title=TITLE,
        asked=ASKED,
        finding=tuple(_sentence(found, bits) for bits in ("64", "32") if _of(found, bits)) or ("No run succeeded.",),
        headlines=tuple(_headline(found, bits) for bits in ("64", "32") if _of(found, bits)),
        tables=(_table(found),) if found else (),
        notes=(
            "'Within the tolerance' are disagreements that it allows; 'reached' is the greatest share of it that any "
            "disagreement reaches. 'Double roots' are touches that brute force missed and finer samples confirm.",
        ),
    )


def _of(found: Sequence[Run], bits: str) -> list[Run]:
    return [run for run in found if run.setup["precision"] == bits]


def wrong(found: Sequence[Run]) -> float:
    """Misses, late hits and false hits beyond the tolerance."""
    return sum(run.values[name] for run in found for name, _ in WRONG)


def _sum(found: Sequence[Run], name: str) -> float:
    return sum(run.values[name] for run in found)


def _sentence(found: Sequence[Run], bits: str) -> str:
    chosen = _of(found, bits)
    of = f"Of {_sum(chosen, 'rays'):,.0f} rays in float{bits}"
    said = ", ".join(f"{_sum(chosen, name):.0f} {word}" for name, word in WRONG)
    bad = ", ".join(sorted({f"{run.problem} ({run.setup['kernel']})" for run in chosen if wrong([run])}))
    return (
        f"{of} the wrong ones beyond the tolerance are: {said}{f', in {bad}' if bad else ''}; within it "
        f"{_sum(chosen, 'within'):.0f} disagree. Brute force missed {_sum(chosen, 'double_roots'):.0f} double roots "
        "that the tracer found."
    )


def _headline(found: Sequence[Run], bits: str) -> Headline:
    chosen = _of(found, bits)
    what = f"Misses, late and false hits in float{bits}, of {_sum(chosen, 'rays'):,.0f} rays"
    against = "0 asked for" if bits == "64" else "0 beyond the stated tolerance asked for"
    return Headline(what, f"{wrong(chosen):.0f}", against, wrong(chosen) == 0)


def _table(found: Sequence[Run]) -> Table:
    rows = tuple(
        (
            f"{run.problem}, {run.setup['kernel']}, {ENGINES[run.setup['engine']]} float{run.setup['precision']}",
            *(f"{run.values[name]:,.0f}" for name in ("rays", "hits", "missed", "late", "false", "within")),
            number(run.values["depth"]),
            f"{run.values['double_roots']:.0f}",
        )
        for run in found
    )
    header = (
        "Problem and setup",
        "rays",
        "hits",
        "missed",
        "late",
        "false",
        "within the tolerance",
        "reached",
        "double roots",
    )
    return Table("Against brute force in float64.", header, rows)
