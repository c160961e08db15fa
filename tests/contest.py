"""Made-up runs of the benchmark of bakers, for the tests of what is said about them."""

from validate.experiment import Run

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
