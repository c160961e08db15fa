"""Pictures on disk: multi-channel OpenEXR for numbers, PNG for eyes.

In: arrays (h, w, channels) by output name. Out: files, whole or not at all. The EXR header carries a sentence per
channel with its unit.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from sdfbake.atomic import replacing
from sdfrender.texture import linear_to_srgb

# Output name -> its channels in the file, and what they hold.
CHANNELS: dict[str, tuple[tuple[str, ...], str]] = {
    "rgb": (("R", "G", "B"), "linear light"),
    "Z": (("Z",), "distance along the camera ray to the first hit, world units; 0 for a miss"),
    "P": (("P.X", "P.Y", "P.Z"), "position of the first hit, world frame"),
    "N": (("N.X", "N.Y", "N.Z"), "outward unit normal of the first hit, world frame"),
    "curvature": (
        ("curvature.min", "curvature.max"),
        "principal curvatures at the first hit, per world unit, a ball's positive",
    ),
    "uv": (("uv.U", "uv.V"), "texture coordinates at the end of the path"),
    "duv_dx": (("duv_dx.U", "duv_dx.V"), "their derivative per pixel to the right, at the end of the path"),
    "duv_dy": (("duv_dy.U", "duv_dy.V"), "their derivative per pixel down, at the end of the path"),
    "lod": (("lod",), "level of detail, Galim 2018 eq. 25, in texels of the texture there, unclamped"),
    "lod_invariant": (("lod_invariant",), "log2 of the footprint's greatest singular value, in texels, unclamped"),
    "ellipse": (
        ("ellipse.major", "ellipse.minor", "ellipse.angle"),
        "half axes of the footprint, texels; angle of the longer against the u axis, radians",
    ),
    "chart": (("chart",), "chart of the texture atlas at the end of the path, -1 where there is none"),
    "nonlinearity": (("nonlinearity",), "how much duv_dx, duv_dy differ from the neighbours', share of their size"),
    "flags": (
        ("flags",),
        "bits: 1 miss, 2 horizon, 4 TIR, 8 caustic, 16 seam, 32 band, 64 edge, 128 nonlinear, 256 clamped",
    ),
    "part": (("part",), "part id of the first hit, -1 for a miss"),
}


def write_exr(path: str | Path, arrays: Mapping[str, np.ndarray], notes: Mapping[str, str] | None = None) -> None:
    """Write outputs as one multi-channel OpenEXR file: float32, flags and part as float32 integers.

    Parameters
    ----------
    path
        The file.
    arrays
        By output name, (h, w, channels).
    notes
        What else the header says, by name.
    """
    import OpenEXR  # a compiled library that only writing needs

    channels, header = {}, {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= dict(notes or {})
    for name, array in arrays.items():
        names, meaning = CHANNELS[name]
        header[f"meaning of {name}"] = meaning
        for i, channel in enumerate(names):
            channels[channel] = np.ascontiguousarray(array[..., i], np.float32)
    with replacing(path) as temporary, OpenEXR.File(header, channels) as file:
        file.write(str(temporary))


def read_exr(path: str | Path) -> dict[str, np.ndarray]:
    """Read a file that `write_exr` wrote: arrays (h, w, channels) by output name."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        found = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    return {
        name: np.stack([found[channel] for channel in channels], axis=-1)
        for name, (channels, _) in CHANNELS.items()
        if set(channels) <= set(found)
    }


def write_png(path: str | Path, rgb: Float[np.ndarray, "h w 3"]) -> None:
    """Write linear light as an 8-bit sRGB PNG; what is brighter than white becomes white."""
    with replacing(path) as temporary:
        Image.fromarray(srgb_bytes(rgb)).save(temporary, format="PNG")


def srgb_bytes(linear: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Turn linear light into 8-bit sRGB, clipped to what a screen shows."""
    pixels: UInt8[np.ndarray, "h w 3"] = np.rint(linear_to_srgb(np.clip(linear, 0.0, 1.0)) * 255).astype(np.uint8)
    return pixels
