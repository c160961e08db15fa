"""Grids out of files that others made.

In: a `.vdb`, `.vti`, `.vol` or `.npy` file with signed distances. Out: `Imported`: a grid without texture coordinates,
and what was found out about it. Every format has a file of its own with `read(path, ...) -> Field`, imported when it is
met.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.imports.distances import Steepness, border_note, cut_off, steepness
from sdfbake.imports.field import Field, require_memory
from sdfbake.imports.resample import even_shape, evened, is_even
from sdfbake.lattice import BAND

FORMATS = (".vdb", ".vti", ".vol", ".npy")


@dataclass(frozen=True, slots=True)
class Said:
    """What the user says of a file; None where the file, or a look at its numbers, is to decide.

    Attributes
    ----------
    grid
        Which grid or array of several, in a `.vdb` or `.vti` file.
    spacing, origin
        Where the samples of a `.npy` file lie, world.
    band
        Voxels from the surface within which the values are exact.
    scale
        What to multiply all values by.
    flip
        Whether inside is positive in the file.
    """

    grid: str | None = None
    spacing: float | None = None
    origin: tuple[float, float, float] | None = None
    band: float | None = None
    scale: float = 1.0
    flip: bool = False


@dataclass(frozen=True, slots=True)
class Imported:
    """A grid from elsewhere.

    Attributes
    ----------
    grid
        Its metadata's `band` says where it claims to be exact: 0 is nowhere.
    steepness
        Of its values at the surface.
    resampled
        Whether its samples are not the file's, because voxels were no cubes there.
    notes
        A sentence for everything that was assumed or is odd.
    """

    grid: Grid
    steepness: Steepness
    resampled: bool
    notes: tuple[str, ...]


def import_grid(path: str | Path, said: Said | None = None) -> Imported:
    """Read signed distances that somebody else made.

    Parameters
    ----------
    path
        A file with one of the suffixes `FORMATS`.
    said
        What the user knows better.

    Raises
    ------
    BadInput
        If the file is corrupt, of an unknown version or kind, turned against the axes, has no surface, or would not fit
        into memory.

    Examples
    --------
    >>> import_grid("bunny.vdb").grid.save("bunny.zarr.zip")  # doctest: +SKIP
    """
    path, said = Path(path), said or Said()
    _check(path, said)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what is beyond float32 is refused below
            field = _read(path, said)
    except OSError as error:
        raise BadInput(f"cannot read {path} ({error.strerror}): check the path and its permissions") from None
    values = _scaled(field, said, path)
    resampled = not is_even(field.spacing, values.shape)
    notes = [*field.notes, *filter(None, [border_note(values)])]
    band, found = _band(field, values, said)
    notes += found
    if resampled:
        require_memory(path.name, even_shape(values.shape, field.spacing))
        values = evened(values, field.spacing)
        notes.append(
            f"voxels of {' x '.join(f'{s:.6g}' for s in field.spacing)} were resampled to cubes of "
            f"{field.spacing.min():.6g} by cubic splines: no sample counts as exact, and every hit is flagged BAND"
        )
    spacing = float(field.spacing.min() if resampled else np.median(field.spacing))
    steep = steepness(values, spacing)
    notes += filter(None, [steep.note(said.scale, None if field.placed else spacing)])
    exact = 0.0 if resampled or (said.band is None and not steep.is_distance) else band
    grid = Grid.from_dense(values, origin=field.origin, spacing=spacing)
    return Imported(_signed(grid, path, field, said, exact, resampled=resampled), steep, resampled, tuple(notes))


def _check(path: Path, said: Said) -> None:
    """Refuse what makes no sense before anything is read."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise BadInput(f"{path.name} is none of the files that can be imported: give one of {', '.join(FORMATS)}")
    for name, value in (("spacing", said.spacing), ("band", said.band), ("scale", said.scale)):
        if value is not None and not 0 < value < np.inf:
            cure = "; --flip turns inside out" if name == "scale" else ""
            raise BadInput(f"--{name} {value:g}: give a positive number{cure}")
    if said.origin is not None and not np.isfinite(said.origin).all():
        raise BadInput(f"--origin {said.origin}: give three finite numbers")
    if suffix != ".npy" and (said.spacing is not None or said.origin is not None):
        raise BadInput(f"{path.name} says itself where its samples lie: leave out --spacing and --origin")
    if suffix not in (".vdb", ".vti") and said.grid is not None:
        raise BadInput(f"{path.name} has no names to choose from: leave out --grid")


def _read(path: Path, said: Said) -> Field:
    """Read a file by its suffix."""
    suffix = path.suffix.lower()
    if suffix == ".vdb":
        from sdfbake.imports import vdb

        return vdb.read(path, said.grid)
    if suffix == ".vti":
        from sdfbake.imports import vti

        return vti.read(path, said.grid)
    if suffix == ".vol":
        from sdfbake.imports import vol

        return vol.read(path)
    from sdfbake.imports import npy

    return npy.read(path, said.spacing, said.origin)


def _scaled(field: Field, said: Said, path: Path) -> Float[np.ndarray, "nx ny nz"]:
    """Return float32 values [x, y, z] in memory order, in world units, negative inside."""
    with np.errstate(over="ignore", invalid="ignore"):  # as above
        values = field.values.astype(np.float32, order="C")
        factor = np.float32(-said.scale if said.flip else said.scale)
        if factor != 1:
            values *= factor
    finite = np.isfinite(values)
    if not finite.all():
        raise BadInput(
            f"{finite.size - np.count_nonzero(finite)} of the {finite.size} values of {path.name} are NaN, infinite or "
            "beyond float32: replace them by finite numbers"
        )
    low, high = float(values.min()), float(values.max())
    if low >= 0 or high <= 0:
        raise BadInput(
            f"the values of {path.name} reach from {low:.4g} to {high:.4g} and have one sign, so there is no surface: "
            "signed distances are negative inside"
        )
    return values


def _band(field: Field, values: Float[np.ndarray, "nx ny nz"], said: Said) -> tuple[float, list[str]]:
    """Return how many voxels from the surface the values are exact, and what was found."""
    if said.band is not None:
        return said.band, []
    largest = float(field.spacing.max())
    if field.half_width is not None:
        return min(field.half_width * said.scale / largest, BAND), []
    limit = cut_off(values)
    if limit is None or limit >= BAND * largest:
        return BAND, []
    return limit / largest, [f"the values end at {limit:.6g}, {limit / largest:.3g} voxels from the surface"]


def _signed(grid: Grid, path: Path, field: Field, said: Said, band: float, *, resampled: bool) -> Grid:
    """Return the grid with a record of where it comes from: the file's name, not its path."""
    options: dict[str, str | int | float | bool | None] = {
        "file": path.name,
        "format": path.suffix.lower()[1:],
        "array": field.name or None,
        "scale": said.scale,
        "flip": said.flip,
        "resampled": resampled,
    }
    return replace(grid, metadata=grid.metadata.model_copy(update={"band": band, "options": options}))
