"""Grids for other programs to read.

In: a `Grid` and the name of a format. Out: files in that format, and `Exported`, which says what was written and what
was left out. Every format has a file of its own with `write(grid, path, *, progress, ...) -> Exported`, imported when
it is asked for.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

from sdfbake.atomic import check_writable
from sdfbake.complaint import BadInput
from sdfbake.export.result import Exported, Progress, silent
from sdfbake.grid import Grid


class Writer(Protocol):
    """How a format is written; some take options of their own by name."""

    def __call__(self, grid: Grid, path: Path, *, progress: Progress, **options: Any) -> Exported:
        """Write a grid."""


@dataclass(frozen=True, slots=True)
class Format:
    """A file format.

    Attributes
    ----------
    name
        As it is asked for.
    suffix
        Of the file that is asked for.
    module
        In this folder, with the function `write`.
    about
        In a few words, for whom it is.
    textured
        Whether it carries texture coordinates.
    options
        Keywords of `write` that a user may set.
    """

    name: str
    suffix: str
    module: str
    about: str
    textured: bool = True
    options: tuple[str, ...] = ()

    @property
    def write(self) -> Writer:
        """The function that writes it."""
        writer: Writer = import_module(f"sdfbake.export.{self.module}").write
        return writer


FORMATS: Mapping[str, Format] = MappingProxyType({
    entry.name: entry
    for entry in (
        Format("vdb", ".vdb", "vdb", "OpenVDB level set, for Blender and Houdini"),
        Format("nvdb", ".nvdb", "nvdb", "NanoVDB, for renderers on GPUs"),
        Format("vol", ".vol", "vol", "Mitsuba's sdfgrid", options=("exact",)),
        Format("vti", ".vti", "vti", "VTK image data", options=("exact",)),
        Format("raw", ".json", "raw", "plain blocks with a description in JSON", options=("precision",)),
        Format("npy", ".npy", "npy", "NumPy array of distances", options=("exact",)),
        Format(
            "coefficients",
            ".npy",
            "coefficients",
            "NumPy array of B-spline coefficients",
            textured=False,
            options=("exact",),
        ),
    )
})  # fmt: skip


def format_of(to: str, path: Path, options: Mapping[str, Any]) -> Format:
    """Return the format of that name once the output and the options are known to fit it.

    Raises
    ------
    BadInput
        If there is no such format, the path has another suffix or cannot be written, or the format has no such option.
    """
    if to not in FORMATS:
        raise BadInput(f"there is no format {to!r}: choose from {', '.join(FORMATS)}")
    chosen = FORMATS[to]
    if path.suffix.lower() != chosen.suffix:
        raise BadInput(f"the format {to} is written to a file *{chosen.suffix}, not {path.name}: rename the output")
    if not path.absolute().parent.is_dir():
        raise BadInput(f"there is no folder {path.parent} to write {path.name} to: make it first")
    check_writable(path)
    for name in options:
        if name not in chosen.options:
            takers = ", ".join(entry.name for entry in FORMATS.values() if name in entry.options)
            raise BadInput(f"the format {to} takes no option --{name} (only {takers or 'none'} does): leave it out")
    return chosen


def export(grid: Grid, path: str | Path, to: str, *, progress: Progress | None = None, **options: Any) -> Exported:
    """Write a grid in another format.

    Parameters
    ----------
    grid
        Any grid, loaded whole.
    path
        The file; its folder must exist. Some formats put others beside it.
    to
        One of `FORMATS`.
    progress
        Called with a stage and the share of it that is done, 0 to 1.
    options
        What that format takes.

    Returns
    -------
    Exported
        The files, and what they do not carry.

    Raises
    ------
    BadInput
        If the request does not fit the format, the grid was read in part, or the result would not fit in memory or on
        the disk.

    Examples
    --------
    >>> export(grid, "bunny.vdb", "vdb").files  # doctest: +SKIP
    (PosixPath('bunny.vdb'),)
    """
    path = Path(path)
    chosen = format_of(to, path, options)
    if grid.bricks.left_out is not None:
        raise BadInput("only a part of this grid was read, an export would lack the rest: load it whole")
    return chosen.write(grid, path, progress=progress or silent, **options)
