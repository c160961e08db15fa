"""How much light an environment sends to a matt surface, by its normal.

In: a latitude-longitude picture of radiance. Out: a small one of the cosine-weighted mean, E / pi: the radiance of a
white matt surface that looks there. Nothing shades it.
"""

import numpy as np
from jaxtyping import Float

from sdfrender.environment import by_solid_angle
from sdfrender.pyramid import halved

WIDEST, SIZE = 128, (64, 32)  # of the picture that is summed; of the result, which has no finer detail than a cosine
_ROWS = 256  # of the result at once


def irradiance(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "H W 3"]:
    """Integrate radiance times the cosine to the normal, over pi.

    The picture is averaged by solid angle to at most 128 columns; a result of (32, 64, 3) is a sum over those texels,
    divided by the sum of their weights, so that a constant comes back to rounding.
    """
    weighted = by_solid_angle(image)
    while weighted.shape[1] > WIDEST:
        weighted = halved(weighted)
    light = weighted.reshape(-1, 4).astype(np.float64)
    toward = directions(weighted.shape[1], weighted.shape[0]).reshape(-1, 3)
    normals = directions(*SIZE).reshape(-1, 3)
    sums = np.concatenate(
        [np.maximum(normals[i : i + _ROWS] @ toward.T, 0.0) @ light for i in range(0, len(normals), _ROWS)]
    )
    mean: Float[np.ndarray, "H W 3"] = (sums[:, :3] / sums[:, 3:]).reshape(SIZE[1], SIZE[0], 3)
    return mean


def directions(width: int, height: int) -> Float[np.ndarray, "h w 3"]:
    """Return the directions of the texels of a picture; `sdfrender.latlong` says which is where."""
    longitude = (np.arange(width) + 0.5) / width * 2 * np.pi - np.pi
    latitude = np.pi / 2 - (np.arange(height) + 0.5) / height * np.pi
    x, z = np.sin(longitude), -np.cos(longitude)
    level, up = np.cos(latitude)[:, None], np.sin(latitude)[:, None]
    return np.stack([level * x, up + 0 * x, level * z], axis=-1)
