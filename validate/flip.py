"""FLIP: how visible a difference is to an eye that flips between two pictures (Andersson et al. 2020).

In: two pictures in linear light. Out: the error of each pixel, from 0 (the same) to 1, by its authors' own code. The
pictures are taken for what a screen shows: clipped to [0, 1], in sRGB.
"""

import flip_evaluator
import numpy as np
from jaxtyping import Float

from sdfrender.texture import linear_to_srgb

# How many pixels a degree of the eye's field holds: the authors' screen, 3840 pixels over 0.7 m at a distance of 0.7 m.
PIXELS_PER_DEGREE = 67.0


def flip(ours: Float[np.ndarray, "h w 3"], truth: Float[np.ndarray, "h2 w2 3"]) -> Float[np.ndarray, "h w"]:
    """Return the LDR-FLIP error of each pixel.

    Parameters
    ----------
    ours, truth
        (h, w, 3) linear light, finite, of one size.

    Returns
    -------
    error
        (h, w) float64, 0 to 1; the same if the pictures change places.

    Raises
    ------
    ValueError
        If the pictures are of different sizes.

    Examples
    --------
    >>> grey = np.full((16, 16, 3), 0.2)
    >>> float(flip(grey, grey).max())
    0.0
    """
    if ours.shape != truth.shape:
        raise ValueError(f"one picture is {ours.shape[:2]} pixels and the other {truth.shape[:2]}")
    error, _, _ = flip_evaluator.evaluate(
        _shown(truth), _shown(ours), "LDR", applyMagma=False, parameters={"ppd": PIXELS_PER_DEGREE}
    )
    return np.asarray(error[..., 0], np.float64)


def _shown(linear: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """What a screen shows; float32, which is all that the authors' code reads."""
    return np.ascontiguousarray(linear_to_srgb(np.clip(linear, 0.0, 1.0)), np.float32)
