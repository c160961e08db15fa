"""Footprints that a renderer wrote, ours or another: OpenEXR channels or a table of text.

In: a file and the size of the film. Out: `Written`, pixel by pixel. Channels are those that `sdfrender render` writes;
a table has the header `x,y,px,py,pz,u,v,dudx,dvdx,dudy,dvdy`. docs/validation.md describes both.
"""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake.complaint import BadInput
from sdfrender.image import CHANNELS

NEEDED = ("P", "uv", "duv_dx", "duv_dy")
OPTIONAL = ("Z", "N", "chart")
# Columns of a table, and the channels that they stand for.
COLUMNS = {
    **{f"p{axis}": f"P.{axis.upper()}" for axis in "xyz"},
    "u": "uv.U",
    "v": "uv.V",
    "dudx": "duv_dx.U",
    "dvdx": "duv_dx.V",
    "dudy": "duv_dy.U",
    "dvdy": "duv_dy.V",
}
# Those that may be left out.
MORE = {"z": "Z", **{f"n{axis}": f"N.{axis.upper()}" for axis in "xyz"}, "chart": "chart"}
HEADER = ",".join(("x", "y", *COLUMNS))


@dataclass(frozen=True, slots=True, eq=False)
class Written:
    """What a file says of every pixel, row by row from the top left; zeros for a miss.

    Attributes
    ----------
    p
        Position of the first hit, world frame.
    uv, duv_dx, duv_dy
        Texture coordinates at the end of the path and their derivatives per pixel to the right and down.
    z, n, chart
        Distance along the ray and unit normal of the first hit, chart at the end; None where the file has none.
    """

    p: Float[np.ndarray, "n 3"]
    uv: Float[np.ndarray, "n 2"]
    duv_dx: Float[np.ndarray, "n 2"]
    duv_dy: Float[np.ndarray, "n 2"]
    z: Float[np.ndarray, " n"] | None = None
    n: Float[np.ndarray, "n 3"] | None = None
    chart: Int[np.ndarray, " n"] | None = None

    @property
    def hit(self) -> Bool[np.ndarray, " n"]:
        """False where texture coordinates and their derivatives are all zero: there the path met no texture."""
        return np.asarray(np.concatenate([self.uv, self.duv_dx, self.duv_dy], axis=1).any(axis=1))


def read_written(path: str | Path, size: tuple[int, int]) -> Written:
    """Read a file of footprints.

    Parameters
    ----------
    path
        OpenEXR, or a table whose name ends in .csv.
    size
        Width and height of the film.

    Raises
    ------
    BadInput
        If the file cannot be read, lacks a channel, is of another size, or has a value that is no finite number.
    """
    path = Path(path)
    found = _table(path, size) if path.suffix.lower() == ".csv" else _exr(path, size)
    _check_finite(path, found, size[0])
    return written(found)


def written(channels: Mapping[str, np.ndarray]) -> Written:
    """Put channels, flat or pictures, together by output name."""

    def column(name: str) -> np.ndarray:
        return np.stack([np.asarray(channels[part], np.float64).ravel() for part in CHANNELS[name][0]], axis=-1)

    there = {name for name in (*NEEDED, *OPTIONAL) if set(CHANNELS[name][0]) <= set(channels)}
    p, uv, duv_dx, duv_dy = (column(name) for name in NEEDED)
    return Written(
        p,
        uv,
        duv_dx,
        duv_dy,
        column("Z")[:, 0] if "Z" in there else None,
        column("N") if "N" in there else None,
        column("chart")[:, 0].astype(np.int64) if "chart" in there else None,
    )


def _exr(path: Path, size: tuple[int, int]) -> dict[str, np.ndarray]:
    import OpenEXR  # a compiled library that only these files need

    if not path.is_file():
        raise BadInput(f"there is no file {path}: name the footprints that a renderer wrote, .exr or .csv")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            found = {name: np.array(channel.pixels, np.float64) for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError) as error:
        said = " ".join(str(error).split())
        raise BadInput(f"{path} cannot be read as OpenEXR ({said}): give .exr, or a table that ends in .csv") from None
    missing = [part for name in NEEDED for part in CHANNELS[name][0] if part not in found]
    if missing:
        raise BadInput(
            f"{path} has no channel {', '.join(missing)}: write P.X, P.Y, P.Z, uv.U, uv.V, duv_dx.U, duv_dx.V, "
            "duv_dy.U and duv_dy.V"
        )
    wanted = {part for name in (*NEEDED, *OPTIONAL) for part in CHANNELS[name][0]}
    for name in sorted(wanted & set(found)):
        if found[name].shape != (size[1], size[0]):
            height, width = (*found[name].shape, 1)[:2]
            raise BadInput(
                f"{path} is {width}x{height} pixels in {name} and the scene's film {size[0]}x{size[1]}: render it at "
                "the film's size, or change film.size"
            )
    return {name: found[name] for name in wanted & set(found)}


def _table(path: Path, size: tuple[int, int]) -> dict[str, np.ndarray]:
    names, numbers = _rows(path)
    missing = [name for name in ("x", "y", *COLUMNS) if name not in names]
    if missing:
        raise BadInput(f"{path} has no column {', '.join(missing)}: its first line must be {HEADER}")
    table = dict(zip(names, numbers.T, strict=True))
    place = np.stack([table["x"], table["y"]], axis=1)
    off = ~((place >= 0) & (place < size) & (place == np.floor(place))).all(axis=1)
    if off.any():
        x, y = place[np.argmax(off)]
        raise BadInput(
            f"{path} has a pixel ({x:g}, {y:g}) that the film of {size[0]}x{size[1]} does not have: count from 0"
        )
    pixel = (place[:, 1] * size[0] + place[:, 0]).astype(np.int64)
    twice = np.flatnonzero(np.bincount(pixel, minlength=1) > 1)
    if len(twice):
        y, x = divmod(int(twice[0]), size[0])
        raise BadInput(f"{path} has the pixel ({x}, {y}) twice: give every pixel one line")
    found = {}
    for name, channel in (COLUMNS | MORE).items():
        if name in table:
            found[channel] = np.full(size[0] * size[1], -1.0 if name == "chart" else 0.0)
            found[channel][pixel] = table[name]
    return found


def _rows(path: Path) -> tuple[list[str], Float[np.ndarray, "rows columns"]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [(number, row) for number, row in enumerate(csv.reader(file, skipinitialspace=True), 1) if row]
    except FileNotFoundError:
        raise BadInput(f"there is no file {path}: name the footprints that a renderer wrote, .exr or .csv") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        said = " ".join(str(error).split())
        raise BadInput(f"{path} cannot be read as a table ({said}): its first line must be {HEADER}") from None
    if not rows:
        raise BadInput(f"{path} is empty: its first line must be {HEADER}")
    names = [name.strip() for name in rows[0][1]]
    numbers = np.empty((len(rows) - 1, len(names)))
    for index, (line, row) in enumerate(rows[1:]):
        try:
            numbers[index] = [float(cell) for cell in row] if len(row) == len(names) else []
        except ValueError:
            raise BadInput(
                f"{path}, line {line} does not have {len(names)} numbers as its first line has names: correct it"
            ) from None
    return names, numbers


def _check_finite(path: Path, found: Mapping[str, np.ndarray], width: int) -> None:
    for name in sorted(found):
        bad = ~np.isfinite(found[name]).ravel()
        if bad.any():
            y, x = divmod(int(np.argmax(bad)), width)
            value = found[name].ravel()[np.argmax(bad)]
            raise BadInput(
                f"{path} has the value {value} in {name} at pixel ({x}, {y}), and {int(bad.sum())} such in all: write "
                "zeros where there is no hit"
            )
