"""One route against another over the pixels of a view: every metric, summed up, all over and region by region.

In: what was seen, what is true, and our flags. Out: flat figures by name, and error maps.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfrender import Flag
from validate.metrics import FOOTPRINT, UV_ERROR, Seen, lod_error, summary
from validate.regions import CLASSES, regions


def compare(
    ours: Seen,
    truth: Seen,
    shape: tuple[int, int],
    among: Bool[np.ndarray, " n"] | None = None,
    flags: Int[np.ndarray, " n"] | None = None,
) -> dict[str, float]:
    """Sum up every footprint metric.

    Parameters
    ----------
    ours, truth
        What was seen at the same pixels, row by row.
    shape
        Height and width of the picture.
    among
        Pixels that count; all by default.
    flags
        Our own flags; SEAM marks pixels whose stencil crosses a cut of the atlas.

    Returns
    -------
    dict
        "pixels" that both hit. "missed": share of the pixels that either hits where the other does not, of which
        "missed.silhouette" lie near the silhouette and "missed.away" do not. "seam" and "chart_mismatch": shares of
        those that both hit. "METRIC.SUMMARY" over all that both hit; "inside.METRIC.SUMMARY" where the charts agree and
        no seam is near; "away.METRIC.SUMMARY" off the silhouette; and for each of `regions.CLASSES` "CLASS.pixels",
        "CLASS.share" and "CLASS.METRIC.SUMMARY".
        "uv_error" counts only where the charts agree.
    """
    among = np.ones(len(truth.t), bool) if among is None else among
    seam = np.zeros(len(truth.t), bool) if flags is None else (flags & Flag.SEAM) != 0
    either, both = among & (ours.hit | truth.hit), among & ours.hit & truth.hit
    places = regions(truth, shape, among, flags)
    differ = ours.hit != truth.hit
    values = {
        "pixels": float(both.sum()),
        "missed": _share(differ, either),
        "missed.silhouette": _share(differ & places["silhouette"], either),
        "missed.away": _share(differ & ~places["silhouette"], either),
        "seam": _share(seam, both),
        "chart_mismatch": _share(ours.chart != truth.chart, both),
    }
    values |= dict(_figures("", ours, truth, both))
    values |= dict(_figures("inside.", ours, truth, both & (ours.chart == truth.chart) & ~seam))
    values |= dict(_figures("away.", ours, truth, both & ~places["silhouette"]))
    for name in CLASSES:
        where = both & places[name]
        values |= {f"{name}.pixels": float(where.sum()), f"{name}.share": _share(where, both)}
        values |= dict(_figures(f"{name}.", ours, truth, where))
    return values


def _figures(prefix: str, ours: Seen, truth: Seen, where: Bool[np.ndarray, " n"]) -> Iterator[tuple[str, float]]:
    """Every metric's summary over some pixels; chart mismatch is a share and stands apart."""
    pairs = [(ours.at(chosen), truth.at(chosen)) for chosen in (where, where & (ours.chart == truth.chart))]
    for metric in (*FOOTPRINT[:-1], UV_ERROR):
        for name, figure in summary(metric.function(*pairs[metric is UV_ERROR])).items():
            yield f"{prefix}{metric.name}.{name}", figure


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
