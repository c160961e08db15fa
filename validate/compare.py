"""One route against another over the pixels of a view: every metric, summed up.

In: what was seen, what is true, and which pixels lie at a seam. Out: flat figures by name, and error maps.
"""

import numpy as np
from jaxtyping import Bool, Float

from validate.metrics import FOOTPRINT, Seen, lod_error, summary


def compare(
    ours: Seen,
    truth: Seen,
    among: Bool[np.ndarray, " n"] | None = None,
    seam: Bool[np.ndarray, " n"] | None = None,
) -> dict[str, float]:
    """Sum up every footprint metric.

    Parameters
    ----------
    ours, truth
        What was seen at the same pixels.
    among
        Pixels that count; all by default.
    seam
        Pixels whose stencil crosses a cut of the atlas, as our own flags say.

    Returns
    -------
    dict
        "missed" (share of the pixels that either route hits), "seam" and "chart_mismatch" (share of those that both
        hit), and "METRIC.SUMMARY" over all that both hit, with "inside.METRIC.SUMMARY" where the charts agree and no
        seam is near.
    """
    among = np.ones(len(truth.t), bool) if among is None else among
    seam = np.zeros(len(truth.t), bool) if seam is None else seam
    either, both = among & (ours.hit | truth.hit), among & ours.hit & truth.hit
    inside = both & (ours.chart == truth.chart) & ~seam
    values = {
        "pixels": float(both.sum()),
        "missed": _share(ours.hit != truth.hit, either),
        "seam": _share(seam, both),
        "chart_mismatch": _share(ours.chart != truth.chart, both),
    }
    for prefix, where in (("", both), ("inside.", inside)):
        ours_there, truth_there = ours.at(where), truth.at(where)
        for metric in FOOTPRINT[:-1]:
            figures = summary(metric.function(ours_there, truth_there))
            values |= {f"{prefix}{metric.name}.{name}": figure for name, figure in figures.items()}
    return values


def lod_map(
    ours: Seen, truth: Seen, shape: tuple[int, int], among: Bool[np.ndarray, " n"] | None = None
) -> Float[np.ndarray, "h w"]:
    """Level-of-detail error per pixel; NaN where there is nothing to compare."""
    both = ours.hit & truth.hit & (True if among is None else among)
    values = np.full(len(truth.t), np.nan, np.float32)
    values[both] = lod_error(ours.at(both), truth.at(both))
    return values.reshape(shape)


def _share(what: Bool[np.ndarray, " n"], among: Bool[np.ndarray, " n"]) -> float:
    return float(what[among].mean()) if among.any() else 0.0
