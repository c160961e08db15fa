"""Rays from files: NumPy archives and tables of text.

In: `.npz` with arrays named like the fields of `Rays`, (n, 3) or (h, w, 3); or `.csv` with a header of their
components, `p.X, p.Y, p.Z, d.X, ...`. Out: `Rays`, and the size of the picture that they make.
"""

import csv
import zipfile
import zlib
from pathlib import Path

import numpy as np

from sdfbake.complaint import BadInput
from sdfrender.rays import COLUMNS, Rays
from sdfrender.viewing import GivenView

UNIT = 1e-6  # by which the length of a direction with derivatives may differ from 1
ASK = "give .npz with p and d of shape (n, 3) or (h, w, 3), or .csv with columns p.X p.Y p.Z d.X d.Y d.Z"


def read_rays(path: str | Path, *, differentials: bool) -> GivenView:
    """Read rays.

    Parameters
    ----------
    path
        The file: p and d, world frame; dp_dx, dp_dy, dd_dx, dd_dy where they are given, per pixel. Directions without
        derivatives may have any length but 0, and are given length 1.
    differentials
        Whether derivatives are needed.

    Raises
    ------
    BadInput
        If there is no such file, it holds no rays, they are not finite or have no direction, or derivatives are missing
        or belong to directions that are not of unit length.
    """
    path = Path(path)
    columns = _read(path)
    missing = [name for name in ("p", "d") if name not in columns]
    if missing:
        raise BadInput(f"{path} has no {' and no '.join(missing)}: {ASK}")
    shape = columns["p"].shape
    if len(shape) not in (2, 3) or shape[-1] != 3 or 0 in shape:
        raise BadInput(f"{path} has p of shape {shape}: {ASK}")
    for name, values in columns.items():
        if values.shape != shape:
            raise BadInput(f"{path} has {name} of shape {values.shape} and p of shape {shape}: make them alike")
        if not np.isfinite(values).all():
            raise BadInput(f"{path} has numbers in {name} that are not finite: a ray needs a place and a direction")
    given = [name in columns for name in COLUMNS[2:]]
    if differentials and not all(given):
        lacking = ", ".join(name for name, there in zip(COLUMNS[2:], given, strict=True) if not there)
        raise BadInput(f"{path} has no {lacking}, which outputs or textures here need: add them, or leave those out")
    size = (shape[1], shape[0]) if len(shape) == 3 else (shape[0], 1)
    return GivenView(_rays(path, {name: values.reshape(-1, 3) for name, values in columns.items()}), size)


def _rays(path: Path, columns: dict[str, np.ndarray]) -> Rays:
    largest = np.abs(columns["d"]).max(axis=1)  # a square of which may be no number
    length = largest * np.linalg.norm(columns["d"] / np.where(largest > 0, largest, 1.0)[:, None], axis=1)
    if not (length > 0).all():
        raise BadInput(f"{path} has {int((length == 0).sum())} directions of no length: give every ray a direction")
    derived = any(name in columns for name in COLUMNS[2:])
    if derived and np.abs(length - 1).max() > UNIT:
        raise BadInput(f"{path} has directions that are not of unit length: their derivatives would have no meaning")
    columns = {**columns, "d": columns["d"] / largest[:, None] / (length / largest)[:, None]}
    return Rays(*(columns.get(name, np.zeros_like(columns["p"])) for name in COLUMNS))


def _read(path: Path) -> dict[str, np.ndarray]:
    try:
        found = _archive(path) if path.suffix == ".npz" else _table(path)
        return {name: np.asarray(values, np.float64) for name, values in found.items()}
    except FileNotFoundError:
        raise BadInput(f"there are no rays {path}: correct the path") from None
    except (OSError, ValueError, EOFError, csv.Error, zipfile.BadZipFile, zlib.error) as error:
        said = " ".join(str(error).split())
        raise BadInput(f"{path} cannot be read as rays ({said}): {ASK}") from None


def _archive(path: Path) -> dict[str, np.ndarray]:
    with path.open("rb") as stream:  # which `np.load` forgets to close where it fails
        file = np.load(stream, allow_pickle=False)
        if isinstance(file, np.ndarray):
            raise ValueError("it holds one array")
        return {name: file[name] for name in file.files if name in COLUMNS}


def _table(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = [row for row in csv.reader(file, skipinitialspace=True) if row]
    header, *rows = rows or [[]]
    numbers = np.array([[float(cell) for cell in row] for row in rows]).reshape(len(rows), len(header))
    columns = dict(zip((name.strip() for name in header), numbers.T, strict=True))
    named = {name: [f"{name}.{axis}" for axis in "XYZ"] for name in COLUMNS}
    return {
        name: np.stack([columns[part] for part in parts], axis=-1)
        for name, parts in named.items()
        if all(part in columns for part in parts)
    }
