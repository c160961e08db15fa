"""Pictures from files, in linear light.

In: a PNG, JPEG or other file that Pillow reads, or an OpenEXR file. Out: (h, w, 3) float32, first row on top. Integers
are sRGB, of 8 or 16 bits per channel; OpenEXR is linear. Colours are multiplied by their alpha (in OpenEXR they are
already), so that what is transparent adds nothing to a mean.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped
from PIL import Image, UnidentifiedImageError

from sdfbake.complaint import BadInput
from sdfrender.png16 import read_deep_png

EXR_MAGIC = b"\x76\x2f\x31\x01"


def read_picture(path: str | Path) -> Float[np.ndarray, "h w 3"]:
    """Read a picture.

    Returns
    -------
    image
        Linear light, first row on top. Grey is repeated; alpha is multiplied in and dropped.

    Raises
    ------
    BadInput
        If there is no such file, it is no image, or some of its values are no numbers.
    """
    try:
        with Path(path).open("rb") as file:
            magic = file.read(len(EXR_MAGIC))
        return _read_exr(path) if magic == EXR_MAGIC else _linear(_read_integers(path))
    except FileNotFoundError:
        raise BadInput(f"there is no texture {path}: correct the path, or make it first") from None
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        said = " ".join(str(error).split())
        raise BadInput(f"{path} cannot be read as an image ({said}): give a PNG, JPEG or EXR file") from None


def picture_size(path: str | Path) -> tuple[int, int]:
    """Return width and height of a picture, of which the head alone is read; errors are those of `read_picture`."""
    try:
        with Path(path).open("rb") as file:
            magic = file.read(len(EXR_MAGIC))
        if magic == EXR_MAGIC:
            height, width, _ = _read_exr(path).shape
            return width, height
        with Image.open(path) as image:
            return image.size
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        height, width, _ = read_picture(path).shape  # says what is wrong with it
        return width, height


def srgb_to_linear(values: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Undo the sRGB transfer curve (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Apply the sRGB transfer curve to values from 0 to 1."""
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * np.maximum(values, 0.0031308) ** (1 / 2.4) - 0.055)


def _read_integers(path: str | Path) -> Shaped[np.ndarray, "h w c"]:
    """Return uint8 or uint16 of 1 to 4 channels: grey, grey and alpha, RGB, RGBA."""
    deep = read_deep_png(path)
    if deep is not None:
        return deep
    with Image.open(path) as image:
        if image.mode.startswith("I"):  # grey of 16 bits, which older versions of Pillow call 32
            pixels = np.asarray(image)
            if pixels.min() < 0 or pixels.max() > 65535:
                raise ValueError("grey of more than 16 bits")
            pixels = pixels.astype(np.uint16)
        else:
            pixels = np.asarray(image.convert(_mode(image)), np.uint8)
    return pixels.reshape(*pixels.shape[:2], -1)


def _mode(image: Image.Image) -> str:
    """Return the mode to read in: as it is, or RGB, with alpha where the file has any."""
    if image.mode in ("L", "LA", "RGB", "RGBA"):
        return "RGBA" if "transparency" in image.info else image.mode
    return "RGBA" if image.has_transparency_data else "RGB"


def _linear(pixels: Shaped[np.ndarray, "h w c"]) -> Float[np.ndarray, "h w 3"]:
    values = pixels / np.float32(np.iinfo(pixels.dtype).max)
    colour = srgb_to_linear(values[..., :3] if values.shape[2] > 2 else values[..., :1])
    if values.shape[2] in (2, 4):
        colour = colour * values[..., -1:]
    return np.ascontiguousarray(np.broadcast_to(colour, (*colour.shape[:2], 3)), np.float32)


def _read_exr(path: str | Path) -> Float[np.ndarray, "h w 3"]:
    """Read R, G, B, or Y, or A alone (as grey)."""
    import OpenEXR  # a compiled library that only these files need

    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            found = {name: np.array(channel.pixels, np.float32) for name, channel in file.channels().items()}
    except RuntimeError as error:
        raise ValueError(str(error)) from None
    names = next((names for names in ("RGB", "YYY", "AAA") if set(names) <= set(found)), None)
    if names is None:
        raise BadInput(f"{path} has channels {', '.join(sorted(found))}: a texture needs R, G and B, or Y, or A")
    image = np.stack([found[name] for name in names], axis=-1)
    if not np.isfinite(image).all():
        count = int((~np.isfinite(image)).any(axis=-1).sum())
        raise BadInput(
            f"{path} has {count} pixels that are infinite or no numbers: repair them, a mean would spread them"
        )
    return image
