"""Which representation of texture coordinates is read.

In: what a grid has and what somebody wishes. Out: one of `sdfbake.metadata.MODES`, or `EXACT` for shapes that need
none of them.
"""

from collections.abc import Collection

from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.metadata import MODES

AUTO, EXACT = "auto", "exact"
# Channels of the asset that each representation reads.
CHANNELS: dict[str, tuple[str, ...]] = {"faces": ("face",), "layers": ("layers",), "grid": ("uv", "chart"), EXACT: ()}
# Those that tell by the normal which side of a thin wall a place is on.
BY_NORMAL = frozenset({"faces", "layers"})


def stored_in(grid: Grid) -> tuple[str, ...]:
    """Return the representations that a grid holds in memory, the most exact first."""
    held = {"faces": grid.face, "layers": grid.layers, "grid": grid.uv}
    return tuple(mode for mode in MODES if held[mode] is not None)


def choose_mode(stored: Collection[str], wish: str, source: str, bake: str = "") -> str:
    """Choose a representation.

    Parameters
    ----------
    stored
        What there is: of `MODES`, or `EXACT`.
    wish
        One of `MODES`, or "auto" for the most exact there is.
    source
        Of whom a complaint speaks.
    bake
        The command that bakes it, as far as it is known.

    Raises
    ------
    BadInput
        If what is wished for does not exist or is not stored, or nothing is.
    """
    if wish not in (AUTO, *MODES):
        raise BadInput(f"there are no texture coordinates '{wish}': choose {AUTO} or one of {', '.join(MODES)}")
    with_ = f"bake it with '{bake} --uv-mode {{}}'" if bake else "bake it with --uv-mode {}"
    if not stored:
        modes = wish if wish != AUTO else "faces" if bake else "faces, or --uv-mode grid"
        raise BadInput(f"{source} has no texture coordinates, which are needed here: {with_.format(modes)}")
    if wish == AUTO:
        return next(mode for mode in (*MODES, EXACT) if mode in stored)
    if wish not in stored:
        has = ", ".join(mode for mode in MODES if mode in stored)
        raise BadInput(
            f"{source} has no texture coordinates as '{wish}' (it has {has}): {with_.format(f'{wish},{has}')}"
        )
    return wish
