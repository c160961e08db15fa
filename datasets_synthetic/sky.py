"""A sky to light scenes with: a latitude-longitude picture of radiance.

In: nothing. Out: linear light; a blue gradient, a sun of 6 degrees, pale ground with a line grid that shows how a
mirror or a lens bends it. -z is in the middle of the picture, y is up.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from sdfbake.atomic import replacing
from sdfbake.complaint import BadInput

NAME = "sky"
SIZE = (1024, 512)
SUN = np.array([0.48, 0.64, 0.6])  # unit
SUN_RADIUS = np.radians(3.0)
SUN_RADIANCE = (60.0, 54.0, 42.0)  # 0.5 falls on a surface across it
_LINES = np.radians(10.0)  # apart, on the ground


def sky() -> Float32[np.ndarray, "h w 3"]:
    """Draw the sky.

    Returns
    -------
    array
        (512, 1024, 3) float32, first row at the zenith; the same numbers every time.
    """
    width, height = SIZE
    longitude = (np.arange(width) + 0.5) / width * 2 * np.pi - np.pi
    latitude = np.pi / 2 - (np.arange(height)[:, None] + 0.5) / height * np.pi
    level = np.cos(latitude)
    d = np.stack([level * np.sin(longitude), np.sin(latitude) + 0 * longitude, -level * np.cos(longitude)], axis=-1)
    up = d[..., 1:2]
    blue = np.array([0.75, 0.85, 1.0]) + np.clip(up, 0, 1) ** 0.5 * (np.array([0.15, 0.32, 0.75]) - [0.75, 0.85, 1.0])
    line = (_near(longitude + 0 * latitude, level + 0 * longitude) | _near(latitude, np.ones((height, 1))))[..., None]
    ground = np.where(line, 0.12, 0.45) * np.array([1.0, 0.95, 0.85])
    radiance = np.where(up > 0, blue, ground)
    share = np.clip((np.cos(SUN_RADIUS) - d @ SUN) / (np.cos(SUN_RADIUS) - np.cos(1.06 * SUN_RADIUS)) + 0.5, 0, 1)
    return np.asarray(radiance + (1 - share)[..., None] * SUN_RADIANCE, np.float32)


def _near(angle: Float[np.ndarray, "*any"], scale: Float[np.ndarray, "*any"]) -> np.ndarray:
    """Say where an angle is within half a degree, as seen from the middle, of a line."""
    off = np.abs(angle / _LINES - np.rint(angle / _LINES)) * _LINES * scale
    return np.asarray(off < np.radians(0.5))


def save_sky(path: str | Path) -> None:
    """Write the sky as OpenEXR: whole or not at all.

    Raises
    ------
    BadInput
        For a file name that does not end in .exr, or a folder that cannot be written.
    """
    import OpenEXR  # a compiled library that only writing needs

    if Path(path).suffix.lower() != ".exr":
        raise BadInput(f"the sky is written as OpenEXR: let {path} end in .exr")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with replacing(path) as temporary, OpenEXR.File(header, {"RGB": sky()}) as file:
        file.write(str(temporary))
