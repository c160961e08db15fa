"""Made-up runs of benchmarks, pictures and the search for misses, for the tests of what is said about them."""

from dataclasses import replace
from functools import partial

import numpy as np

from validate.experiment import Run
from validate.peers.catalogue import MITSUBA
from validate.peers.catalogue import OURS as OUR_NAME
from validate.peers.frames import EVERYTHING, MIRROR, PRIMARY

# Seconds of ours and OpenVDB per samples per axis: ours grows with exponent 1 from 128 on.
OURS = {64: 0.3, 128: 0.4, 512: 1.6, 1024: 3.2}
THEIRS = {64: 0.1, 128: 0.5, 512: 3.2, 1024: 8.0}


def baking_runs() -> list[Run]:
    """Both tools on the bunny, and a third that could not run."""
    runs = []
    ours = {"tool": "ours", "uv": "faces", "engine": "drjit"}
    for seconds, setup, error in ((OURS, ours, 1e-7), (THEIRS, {"tool": "OpenVDB"}, 0.25)):
        for n, median in seconds.items():
            knob = {"resolution": n}
            values = {"seconds": median, "first_seconds": 2 * median, "peak_mb": 700.0, "calls": 4.0}
            runs.append(Run("baking", "bunny", setup, knob, "timing", values | {"file_bytes": 4e7}))
            figures = {"error.max": error, "error.p99": error, "error.p50": error, "samples": 100.0}
            figures["wrong_signs"] = 0.0 if setup["tool"] == "ours" else 3.0
            runs.append(Run("baking", "bunny", setup, knob, "error", figures))
    return [*runs, Run("baking", "every mesh", {"tool": "trueform"}, {}, "timing", status="failed: not here")]


def _pace(job: str, setup: dict[str, str], n: int, seconds: list[float], wrong: float = 0.0) -> list[Run]:
    samples = {"seconds": seconds, "warm_up": [1.0]}
    median = float(np.median(seconds))
    values = {"seconds": median, "first_seconds": 1.0, "prepare_seconds": 0.1, "us_per_ray": median * 4}
    errors = {"wrong_pixels": wrong, "missed_pixels": wrong, "t.max": 0.1, "t.p99": 0.01, "t.p50": 0.001, "rays": 9.0}
    errors |= {"t.p50_world": 0.001 / n, "met_again": wrong}
    blank = partial(Run, "rendering", job, setup, {"resolution": n})
    return [blank("timing", values=values, samples=samples), blank("error", values=errors)]


def rendering_runs() -> list[Run]:
    """Ours takes half of Mitsuba's time at 64, though the machine was three times slower in one round."""
    single = {"tool": OUR_NAME, "engine": "drjit", "precision": "32", "kernel": "bspline"}
    double, numpy = single | {"precision": "64"}, single | {"engine": "numpy", "precision": "64"}
    theirs = {"tool": MITSUBA}
    runs = [
        *_pace(MIRROR, single, 64, [0.1, 0.3, 0.1]),
        *_pace(MIRROR, theirs, 64, [0.2, 0.6, 0.2], wrong=272.0),
        *_pace(MIRROR, double, 64, [0.2, 0.6, 0.2]),
        *_pace(EVERYTHING, single, 64, [0.12, 0.36, 0.12]),
        *_pace(MIRROR, numpy, 64, [2.5], wrong=2.0),
        *_pace(PRIMARY, single, 64, [0.3, 0.9, 0.3]),
        *_pace(PRIMARY, theirs, 64, [0.1, 0.3, 0.1], wrong=272.0),
    ]
    frames = {"cold_frame": 1.5, "disk_frame": 0.3, "warm_frame": 0.1, "again_frame": 0.1}
    starts = {"cold_seconds": 1.7, "disk_seconds": 0.5, "warm_seconds": 0.2, "programs": 3.0, "programs_again": 0.0}
    cold = Run("rendering", "cold start, everything", single, {"resolution": 64}, "timing", frames | starts)
    plain = [replace(cold, problem="cold start, mirror", setup=setup) for setup in (single, theirs)]
    return [*runs, cold, *plain]


def misses_runs(**wrong: float) -> list[Run]:
    """One problem in both precisions, on which float32 disagrees within its tolerance, and does what is wrong."""
    figures = dict.fromkeys(("missed", "late", "false", "within", "depth", "double_roots"), 0.0)
    base = {"rays": 1000.0, "hits": 600.0, **figures}
    setup = {"engine": "drjit", "precision": "64", "kernel": "bspline"}
    double = Run("misses", "noise", setup, {"rays": 1000}, "error", base)
    single = replace(double, setup=setup | {"precision": "32"}, values=base | {"within": 4.0, "depth": 0.4} | wrong)
    return [double, single]


def picture_runs() -> list[Run]:
    values = {"mean": 0.003, "p99": 0.02, "noted": 0.01, "flags": 0.04, "pixels": 16000.0}
    compared = Run("pictures", "glass", {"truth": "exact shapes"}, {}, "error", values)
    return [compared, Run("pictures", "lights", {"truth": "none"}, {}, "error")]
