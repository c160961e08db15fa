"""NumPy arrays.

In: a `.npy` file of numbers [x, y, z], and where its samples lie: from the user, else from the JSON file NAME.npy.json
that `export --to npy` writes beside it, else spacing 1 from the origin on. Out: `Field`.
"""

import json
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from sdfbake.complaint import BadInput
from sdfbake.imports.field import Field, corrupt, require_lattice, require_memory


def read(path: Path, spacing: float | None = None, origin: tuple[float, float, float] | None = None) -> Field:
    """Read an array without ever unpickling anything.

    Parameters
    ----------
    path
        The file.
    spacing, origin
        What the user says of the lattice, world; if either is there, the description beside the file is not looked at.

    Raises
    ------
    BadInput
        If the file is no array of at least 2 real numbers along each of three axes, or is described as another one.
    """
    try:
        values = np.lib.format.open_memmap(path, mode="r")
    except (ValueError, EOFError, SyntaxError, TokenError, TypeError, OverflowError, MemoryError) as error:
        raise corrupt(path.name, f"it cannot be read as a NumPy array ({error})") from None
    if values.ndim != 3 or values.dtype.kind not in "fiu":
        raise BadInput(
            f"{path.name} holds an array of {values.dtype}{values.shape}, no grid: give real numbers (nx, ny, nz)"
        )
    if min(values.shape) < 2:
        raise BadInput(f"{path.name} holds {values.shape} samples and has no cell: give 2 or more along every axis")
    require_memory(path.name, values.shape)
    if spacing is None and origin is None:
        described = path.with_name(f"{path.name}.json")
        if described.is_file():
            return _placed(path, values, _record(described))
    step, corner = np.full(3, 1.0 if spacing is None else spacing), np.array(origin or (0.0, 0.0, 0.0))
    require_lattice(path.name, corner, step)
    if spacing is not None:
        return Field(values, corner, step)
    note = f"{path.name} does not say where its samples lie: their spacing is taken as 1, see --spacing and --origin"
    return Field(values, corner, step, placed=False, notes=(note,))


def _record(path: Path) -> dict[str, Any]:
    """Read a description."""
    try:
        record = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        raise corrupt(path.name, "it is no JSON") from None
    return record if isinstance(record, dict) else {}


def _placed(path: Path, values: np.ndarray, record: dict[str, Any]) -> Field:
    """Return the array on the lattice of its description."""
    if "coefficients" in record:
        raise BadInput(f"{path.name} holds B-spline coefficients, no distances: import what 'export --to npy' writes")
    try:
        lattice, band = record["lattice"], record["band"]
        shape = tuple(lattice["shape"])
        spacing = np.full(3, float(lattice["spacing"]))
        origin = np.array(lattice["origin"], np.float64).reshape(3)
        half_width = None if band is None else float(band) * float(spacing[0])
    except (KeyError, TypeError, ValueError):
        raise BadInput(
            f"{path.name}.json describes no lattice for {path.name}: give --spacing to leave it unread"
        ) from None
    if shape != values.shape:
        raise BadInput(
            f"{path.name}.json describes {list(shape)} samples and {path.name} has {list(values.shape)}: give "
            "--spacing to leave it unread"
        )
    require_lattice(path.name, origin, spacing)
    return Field(values, origin, spacing, half_width=half_width)
