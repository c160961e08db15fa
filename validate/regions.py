"""Where in a picture a pixel lies: near the silhouette, near a seam, near an edge, or in the interior.

In: what is true at every pixel, and our flags. Out: one class per pixel, the first of `CLASSES` that holds. Errors have
other causes in each, and an average over all of them hides three.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from sdfrender import Flag
from validate.metrics import Seen

CLASSES = ("silhouette", "seams", "edges", "interior")
TITLES = {
    "silhouette": "near the silhouette",
    "seams": "near seams",
    "edges": "near edges",
    "interior": "in the interior",
}
SILHOUETTE = 5  # pixels
NEAR = 2  # pixels from a seam or an edge
CREASE = 40.0  # degrees between neighbouring normals, the angle from which `--smooth` keeps a crease
# A step in depth is a break where it is this many times both steps beside it: where depth is smooth it lies between
# them; and this many times the picture's median step, below which the facets of a mesh break it everywhere.
ALONE, STEEP = 2.0, 8.0


def regions(
    truth: Seen,
    shape: tuple[int, int],
    among: Bool[np.ndarray, " n"] | None = None,
    flags: Int[np.ndarray, " n"] | None = None,
) -> dict[str, Bool[np.ndarray, " n"]]:
    """Classify the pixels of a picture.

    Parameters
    ----------
    truth
        What is true at the pixels, row by row.
    shape
        Height and width of the picture.
    among
        Pixels that count; the others are taken for misses.
    flags
        Our own flags, of which SEAM and EDGE are read.

    Returns
    -------
    dict
        For each of `CLASSES` its pixels; no pixel has two. "silhouette" is within 5 pixels of both a hit and either a
        miss or a break of depth; "seams" within 2 pixels of where the chart changes, or flagged SEAM; "edges" within
        2 pixels of where the normal turns by more than 40 degrees, or flagged EDGE; "interior" is what is left of
        the hits. Pixels that miss, far from any hit, have none.
    """
    there = (truth.hit if among is None else truth.hit & among).reshape(shape)
    flags = (np.zeros(len(truth.t), np.int64) if flags is None else flags).reshape(shape)
    holds = {
        "silhouette": near(~there | _breaks(truth.t.reshape(shape), there), SILHOUETTE) & near(there, SILHOUETTE),
        "seams": there & (near(_changes(truth.chart.reshape(shape), there), NEAR) | (flags & Flag.SEAM != 0)),
        "edges": there & (near(_turns(truth.n.reshape(*shape, 3), there), NEAR) | (flags & Flag.EDGE != 0)),
        "interior": there,
    }
    taken = np.zeros(shape, bool)
    found = {}
    for name in CLASSES:
        found[name] = (holds[name] & ~taken).ravel()
        taken |= holds[name]
    return found


def near(where: Bool[np.ndarray, "h w"], reach: float) -> Bool[np.ndarray, "h w"]:
    """Pixels that have such a one at most `reach` pixels away."""
    return np.asarray(distance_transform_edt(~where) <= reach) if where.any() else where


def _both(steps: Bool[np.ndarray, "h w"], axis: int) -> Bool[np.ndarray, "h2 w2"]:
    """Mark the two pixels of every marked step along an axis."""
    low, high = ([(0, 1) if a == axis else (0, 0) for a in (0, 1)], [(1, 0) if a == axis else (0, 0) for a in (0, 1)])
    return np.asarray(np.pad(steps, low) | np.pad(steps, high))


def _pair(values: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """The earlier and the later pixel of every step along an axis."""
    last = values.shape[axis] - 1
    return values.take(range(last), axis), values.take(range(1, last + 1), axis)


def _breaks(t: Float[np.ndarray, "h w"], there: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels on either side of a break of depth."""
    depth = np.where(there, t, np.nan)
    steps = [np.abs(np.diff(depth, axis=axis)) for axis in (0, 1)]
    known = np.concatenate([step[np.isfinite(step)] for step in steps])
    # Depth that does not change but for rounding has no breaks.
    floor = max(STEEP * float(np.median(known)), 1e-9 * float(depth[there].max())) if known.size else np.inf
    found = np.zeros(there.shape, bool)
    for axis, step in enumerate(steps):
        beside = [(1, 1) if a == axis else (0, 0) for a in (0, 1)]
        padded = np.pad(step, beside, constant_values=np.nan)
        before, after = (padded.take(range(first, step.shape[axis] + first), axis) for first in (0, 2))
        alone = step > ALONE * np.fmax(np.fmax(before, after), 0.0)
        found |= _both(alone & (step > floor), axis)
    return found


def _changes(ids: Int[np.ndarray, "h w"], there: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels whose neighbour is on another chart."""
    found = np.zeros(there.shape, bool)
    for axis in (0, 1):
        (a, b), (known, known_) = _pair(ids, axis), _pair(there, axis)
        found |= _both((a != b) & known & known_, axis)
    return found


def _turns(n: Float[np.ndarray, "h w 3"], there: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels whose neighbour has a normal that is turned by more than a crease."""
    found = np.zeros(there.shape, bool)
    for axis in (0, 1):
        (a, b), (known, known_) = _pair(n, axis), _pair(there, axis)
        found |= _both((np.sum(a * b, axis=-1) < np.cos(np.radians(CREASE))) & known & known_, axis)
    return found
