"""Error bars of footprints: how far a footprint may be off, told without knowing the truth.

In: footprints of the same pixels on a grid and on one of half the resolution. Out: a bar per pixel, and how often the
truth lies inside. The bar is |J_N - J_N/2|, which bounds the error of a method that converges, plus the difference of
neighbouring footprints, which is what a linear footprint leaves out.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sdfrender.footprint import nonlinearity
from validate.metrics import Seen


@dataclass(frozen=True, slots=True, eq=False)
class Bar:
    """Error bars, in the unit of J (texels per pixel, Frobenius norm).

    Attributes
    ----------
    known
        Where there is a bar: both grids were hit, on the same chart.
    resolution
        |J_N - J_N/2|; 0 where there is no bar.
    neighbours
        The greatest |J' - J| over the four neighbours on the same chart; 0 where there is no bar.
    """

    known: Bool[np.ndarray, " n"]
    resolution: Float[np.ndarray, " n"]
    neighbours: Float[np.ndarray, " n"]

    @property
    def whole(self) -> Float[np.ndarray, " n"]:
        """The bar: both parts."""
        return np.asarray(self.resolution + self.neighbours)


def error_bar(fine: Seen, coarse: Seen, shape: tuple[int, int]) -> Bar:
    """Make the bar of every pixel.

    Parameters
    ----------
    fine, coarse
        The same pixels on a grid of resolution N and of N/2, row by row.
    shape
        Height and width of the picture.

    Returns
    -------
    Bar
        Without a bar where charts differ or one of the two missed.

    Examples
    --------
    >>> at = {"t": np.ones(1), "n": np.ones((1, 3)), "uv": np.ones((1, 2)), "chart": np.zeros(1, int)}
    >>> fine, coarse = (Seen(jacobian=np.full((1, 2, 2), size), **at) for size in (1.0, 1.5))
    >>> error_bar(fine, coarse, (1, 1)).whole
    array([1.])
    """
    known = fine.hit & coarse.hit & (fine.chart == coarse.chart)
    resolution = np.linalg.norm(fine.jacobian - coarse.jacobian, axis=(1, 2))
    picture = fine.jacobian.reshape(*shape, 2, 2)
    share = nonlinearity(picture, fine.hit.reshape(shape), fine.chart.reshape(shape)).ravel()
    neighbours = share * np.linalg.norm(fine.jacobian, axis=(1, 2))
    return Bar(known, np.where(known, resolution, 0.0), np.where(known, neighbours, 0.0))


def coverage(fine: Seen, bar: Bar, truth: Seen, where: Bool[np.ndarray, " n"]) -> dict[str, float]:
    """Say how often the truth lies inside the bars, and how wide these are.

    Parameters
    ----------
    fine, bar, truth
        Footprints, their bars, and the true ones.
    where
        Pixels that count.

    Returns
    -------
    dict
        "bars" (how many), "no_bar" (share of pixels that both hit), "covered" (share of |J - J*| <= bar), "width"
        (median bar over median error), and "covered.resolution", "width.resolution" of the bar's first part alone.
        Only the first two where there are no bars; no width where the median error is nothing.
    """
    both = where & fine.hit & truth.hit
    chosen = both & bar.known
    found = {"bars": float(chosen.sum()), "no_bar": float(1.0 - bar.known[both].mean()) if both.any() else 0.0}
    if not chosen.any():
        return found
    error = np.linalg.norm(fine.jacobian - truth.jacobian, axis=(1, 2))[chosen]
    # An error of rounding alone, of J itself and of the truth's, is no error.
    rounding = 64 * np.finfo(np.float64).eps * np.linalg.norm(truth.jacobian, axis=(1, 2))[chosen]
    median = float(np.median(error))
    for suffix, width in (("", bar.whole[chosen]), (".resolution", bar.resolution[chosen])):
        found[f"covered{suffix}"] = float((error <= width + rounding).mean())
        if median > float(np.median(rounding)):
            found[f"width{suffix}"] = float(np.median(width)) / median
    return found
