"""What the report says about the two engines."""

from collections.abc import Sequence

from validate.experiment import Run
from validate.section import Headline, Section, Table, number, pick

TITLE = "Two engines, one answer"
ASKED = (
    "The tracer is written once and runs on NumPy and, compiled, on Dr.Jit. In float64 both must give the same "
    "footprints; float32 costs accuracy and saves time. The scene is the mirror sphere and the page, one bounce, "
    "with footprints; Dr.Jit is timed over 512 x 512 rays, NumPy over fewer."
)
QUANTITIES = (("t", "distance"), ("n", "normal"), ("uv", "uv"), ("jacobian", "footprint"))
LIMIT = 1e-10


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    errors, times = pick(runs), pick(runs, "timing")
    return Section(
        name="engines",
        title=TITLE,
        asked=ASKED,
        finding=(*_agreement(errors), *_speed(times)) or ("No run succeeded.",),
        headlines=_headlines(errors, times),
        tables=(_errors(errors), _times(times)),
    )


def _worst(run: Run) -> float:
    return max(run.values.get(f"{name}.max", 0.0) for name, _ in QUANTITIES)


def _agreement(errors: Sequence[Run]) -> tuple[str, ...]:
    double = [run for run in errors if run.setup["precision"] == "64"]
    single = [run for run in errors if run.setup["precision"] == "32"]
    sentences = []
    if double:
        worst = max(_worst(run) for run in double)
        word = "within" if worst <= LIMIT else "NOT within"
        missed = sum(run.values["missed"] for run in double)
        sentences.append(
            f"In float64 the engines differ by at most {number(worst)} relative, {word} the {number(LIMIT)} asked for; "
            f"hit or miss differs for {missed:.0f} rays."
        )
    sentences.extend(
        f"In float32 at {run.knob['resolution']:g}³, the footprint differs by {number(run.values['jacobian.p50'])} "
        f"(median) and {number(run.values['jacobian.p99'])} (99 %); hit or miss differs for "
        f"{run.values['missed']:.0f} rays."
        for run in single
    )
    return tuple(sentences)


def _speed(times: Sequence[Run]) -> tuple[str, ...]:
    sentences = []
    for resolution in sorted({run.knob["resolution"] for run in times}):
        at = {(r.setup["engine"], r.setup["precision"]): r.values for r in times if r.knob["resolution"] == resolution}
        slow, fast = at.get(("numpy", "64")), at.get(("drjit", "32"))
        if slow and fast:
            ratio = slow["us_per_ray"] / fast["us_per_ray"]
            sentences.append(
                f"At {resolution:g}³ Dr.Jit in float32 is {number(ratio, 2)} times as fast as NumPy, ray by ray."
            )
    return tuple(sentences)


def _headlines(errors: Sequence[Run], times: Sequence[Run]) -> tuple[Headline, ...]:
    lines = []
    double = [run for run in errors if run.setup["precision"] == "64"]
    if double:
        worst = max(_worst(run) for run in double)
        what = "NumPy and Dr.Jit in float64: largest relative difference"
        lines.append(Headline(what, number(worst), f"at most {LIMIT:g}", worst <= LIMIT))
    for run in times:
        if run.setup == {"engine": "drjit", "precision": "32"}:
            what = f"Mirror scene at {run.knob['resolution']:g}³, one bounce with footprints, Dr.Jit float32"
            lines.append(Headline(what, f"{number(run.values['us_per_ray'])} µs per ray", "median of the timed runs"))
    return tuple(lines)


def _name(run: Run) -> str:
    return f"{run.setup['engine']}, float{run.setup['precision']}, {run.knob['resolution']:g}³"


def _errors(errors: Sequence[Run]) -> Table:
    rows = tuple(
        (
            _name(run),
            *(number(run.values.get(f"{name}.{key}")) for name, _ in QUANTITIES for key in ("p50", "max")),
            f"{run.values['missed']:.0f}",
        )
        for run in errors
    )
    header = [f"{title} {key}" for _, title in QUANTITIES for key in ("p50", "max")]
    return Table("Relative difference from NumPy in float64.", ("Engine", *header, "rays: hit or miss differs"), rows)


def _times(times: Sequence[Run]) -> Table:
    rows = tuple(
        (_name(run), *(number(run.values[key]) for key in ("seconds", "us_per_ray", "first_seconds"))) for run in times
    )
    return Table("Times: medians, and the first call, which compiles.", ("Engine", "s", "µs per ray", "first, s"), rows)
