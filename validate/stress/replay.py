"""The worst ray of a check, traced alone and told step by step.

In: an outcome and its case. Out: lines of text: per segment where the ray began, what it met, its differentials there
and beyond, its flags, and the defects of the identities.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from sdfbake.complaint import BadInput
from sdfrender import Flag, curvature, footprint
from validate.course import Course, Step, defects, follow
from validate.stress.case import Case, Check
from validate.stress.outcome import Outcome, beam_of, usable

SEED = 12  # of the perturbations that the identities are measured with


def worst(found: Sequence[Outcome]) -> Outcome:
    """The outcome nearest to its limit or farthest beyond it, of those that have a ray; failures come first.

    Raises
    ------
    BadInput
        If there is none with a ray.
    """
    traced = [one for one in found if one.ray]
    if not traced:
        raise BadInput(f"no check of '{found[0].case}' traces rays: there is nothing to replay")
    return max(traced, key=lambda one: (one.verdict == "fail", one.share))


def told(case: Case, outcome: Outcome) -> Iterator[str]:
    """Trace the worst ray of an outcome, line by line.

    Raises
    ------
    BadInput
        If the outcome's engine cannot run here, or the case has no such check any more.
    """
    check = _check(case, outcome)
    yield f"{case.title} ({case.name})"
    yield case.holds
    figures = f"{outcome.figure:.3g} {check.unit}, limit {check.limit:.3g}: {outcome.verdict}"
    yield f"{check.name} on {outcome.engine}: {figures}"
    if outcome.known:
        yield outcome.known
    if check.course is None:
        raise BadInput(f"the check '{check.name}' of '{case.name}' says no way of its rays: it cannot be replayed")
    course, ray = check.course(), beam_of(outcome.ray)
    size = float(np.linalg.norm(np.diff(course.field.bounds, axis=0)))
    kept = defects(course, ray, np.random.default_rng(SEED), size)
    for number, step in enumerate(follow(course, ray)):
        yield from _step(course, number, step)
        if not step.hits.hit[0]:
            return
        said = (f"{name} {getattr(kept, name)[number, 0]:.2e}" for name in ("symplectic", "direction", "surface"))
        yield f"  identities   {'   '.join(said)}"


def _check(case: Case, outcome: Outcome) -> Check:
    choice = usable().get(outcome.engine)
    if choice is None:
        raise BadInput(f"the engine '{outcome.engine}' cannot run here: name another with --engine")
    for check in case.checks(choice):
        if check.name == outcome.check:
            return check
    raise BadInput(f"'{case.name}' has no check '{outcome.check}' any more: run 'python -m validate stress' anew")


def _step(course: Course, number: int, step: Step) -> Iterator[str]:
    before, at, after, hits = step.before, step.at, step.after, step.hits
    yield f"step {number}, medium of index {step.index[0]:g}"
    yield f"  from         p {_vector(before.p)}   d {_vector(before.d)}"
    if not hits.hit[0]:
        yield "  missed"
        return
    yield f"  met          t {hits.t[0]:.12g}   p {_vector(hits.p)}   n {_vector(hits.n)}   part {hits.part[0]}"
    yield f"  d . n        {float(np.sum(at.d * hits.n)):.6e}"
    least, greatest = curvature(course.field, hits.p)
    yield f"  curvature    {least[0]:.6g} {greatest[0]:.6g}"
    yield f"  dp_dx dp_dy  {_vector(at.dp_dx)}   {_vector(at.dp_dy)}"
    yield f"  dd_dx dd_dy  {_vector(at.dd_dx)}   {_vector(at.dd_dy)}"
    yield f"  flags        {_flags(int(hits.flags[0]))}"
    if course.field.uv_mode is not None:
        seen = footprint(course.field, hits, at)
        yield f"  uv           {_vector(seen.uv)}   chart {seen.chart[0]}"
        yield f"  duv_dx duv_dy {_vector(seen.duv_dx)}   {_vector(seen.duv_dy)}"
    if after is not at:
        yield f"  beyond       d {_vector(after.d)}   medium of index {step.beyond[0]:g}"
        yield f"  dd_dx dd_dy  {_vector(after.dd_dx)}   {_vector(after.dd_dy)}"


def _vector(row: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.9g}" for x in row[0]) + ")"


def _flags(bits: int) -> str:
    return " ".join(flag.name or "" for flag in Flag if bits & flag) or "none"
