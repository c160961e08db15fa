"""The figures of the renderers, paired, and the limits that were set for ours.

In: runs of the suite `rendering`. Out: `Points`, ratios round by round, and `LIMITS`.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from sdfrender.kernels import NAMES
from validate.experiment import Run
from validate.peers import limits
from validate.peers.catalogue import MITSUBA, OURS
from validate.peers.frames import EVERYTHING, JOBS, MIRROR
from validate.peers.limit import Limit
from validate.peers.limits import Point, Points

ENGINES = {"drjit": "Dr.Jit", "numpy": "NumPy"}


def ours(kernel: str = "bspline", precision: str = "32", engine: str = "drjit") -> str:
    """Return the label of one of our setups."""
    return f"{ENGINES[engine]} float{precision}, {kernel}"


LABELS = (*(ours(kernel, bits, engine) for engine in ENGINES for bits in ("32", "64") for kernel in NAMES), MITSUBA)


def label_of(setup: dict[str, str]) -> str:
    """Return the name of a setup, one of `LABELS` for what can be asked for."""
    if setup.get("tool") != OURS:
        return setup.get("tool", "unknown")
    return ours(setup["kernel"], setup["precision"], setup["engine"])


def paired(runs: Sequence[Run]) -> Points:
    """Pair error and timed runs of every job; a failed renderer has a point without figures."""
    return limits.paired(runs, label_of)


def cold(job: str) -> str:
    """Return the problem under which a job's first frames are kept."""
    return f"cold start, {job}"


def sizes(points: Points) -> list[int]:
    """Return the samples per axis of all runs but the cold ones."""
    return sorted({n for job, _, n in points if not job.startswith("cold")})


def ratio(
    points: Points, job: str, label: str, resolution: int, other: str = MITSUBA, other_job: str | None = None
) -> float | None:
    """Median over the rounds of one setup's time over another's in the same round; None where either is missing."""
    one, two = (points.get(key) for key in ((job, label, resolution), (other_job or job, other, resolution)))
    if one is None or two is None or one.timing is None or two.timing is None:
        return None
    pairs = zip(one.timing.samples["seconds"], two.timing.samples["seconds"], strict=False)  # NumPy has fewer rounds
    return float(np.median([a / b for a, b in pairs]))


def _largest(found: Sequence[float | None]) -> float | None:
    there = [value for value in found if value is not None]
    return max(there) if there else None


def _everywhere(points: Points, label: str, other: str, job: str, other_job: str) -> float | None:
    """Greatest ratio of two of our setups over all sizes."""
    return _largest([ratio(points, job, label, n, other, other_job) for n in sizes(points)])


def _greatest(points: Points, job: str, label: str, name: str) -> float | None:
    """Greatest value of a figure over all sizes."""
    return _largest([limits.figure(points, job, label, n, name) for n in sizes(points)])


def _cold(points: Points) -> float | None:
    """Greatest difference between a first frame with nothing compiled and a warm one, field included; float32."""
    return _largest([extra(points, job, ours(kernel)) for job in JOBS for kernel in NAMES])


def start(points: Points, job: str, label: str) -> Point | None:
    """Return the run of a job's first frames."""
    found = [point for (problem, one, _), point in points.items() if (problem, one) == (cold(job), label)]
    return found[0] if found and found[0].timing else None


def extra(points: Points, job: str, label: str, name: str = "cold_seconds") -> float | None:
    """Seconds that preparing the field and a first frame take over those of a warm process."""
    point = start(points, job, label)
    return None if point is None else (point.value(name) or 0.0) - (point.value("warm_seconds") or 0.0)


def _compiled_again(points: Points) -> float | None:
    """Programs that a second grid of another size makes Dr.Jit compile, all our setups and jobs together."""
    starts = [p for (job, label, _), p in points.items() if job.startswith("cold") and label != MITSUBA and p.timing]
    return sum(point.value("programs_again") or 0.0 for point in starts) if starts else None


def _against_mitsuba(kernel: str, resolution: int, most: float, *, headline: bool = False) -> Limit:
    what = f"Mirror, {resolution}³, {kernel} with Hessian, Dr.Jit float32: time over Mitsuba's"
    measured = partial(ratio, job=MIRROR, label=ours(kernel), resolution=resolution)
    return Limit(what, most, "x", measured, headline)


LIMITS = (
    *(_against_mitsuba("bspline", n, most, headline=True) for n, most in ((64, 0.5), (256, 0.25), (512, 0.2))),
    *(_against_mitsuba("catmull-rom", n, most) for n, most in ((64, 0.5), (256, 0.25), (512, 0.2))),
    Limit("Differentials, texture coordinates and trilinear look-up on top, worst size: time over the mirror's", 1.35,
          "x", partial(_everywhere, label=ours(), other=ours(), job=EVERYTHING, other_job=MIRROR), headline=True),
    Limit("Mirror, float64 over float32, bspline, worst size", 1.5, "x",
          partial(_everywhere, label=ours(precision="64"), other=ours(), job=MIRROR, other_job=MIRROR)),
    Limit("Mirror on NumPy, float64, bspline, worst size: a frame", 2.0, "s",
          partial(_greatest, job=MIRROR, label=ours(precision="64", engine="numpy"), name="seconds")),
    Limit("First frame and field, nothing compiled before, worst kernel: over the warm ones", 1.5, "s", _cold,
          headline=True),
    Limit("Programs that a second grid of another size compiles", 0.0, "", _compiled_again),
    *(Limit(f"Wrong pixels of the sphere, bspline, {ENGINES[engine]} float{bits}, worst size", 0.0, "",
            partial(_greatest, job=MIRROR, label=ours("bspline", bits, engine), name="wrong_pixels"))
      for engine in ENGINES for bits in ("32", "64")),
)  # fmt: skip
