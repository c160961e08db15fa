"""What a bake is asked for.

In: what a user wrote, and the mesh it is for. Out: checked `Options`, or one sentence that says what is wrong.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh
from sdfbake.metadata import MODES

OPTIONAL = frozenset({"part", "error"})  # channels that a bake makes unless told otherwise


@dataclass(frozen=True, slots=True)
class Options:
    """What a bake is asked for, checked.

    Attributes
    ----------
    modes
        Of texture coordinates, in the order of `MODES`.
    sign
        "auto", "winding" or "pseudonormal".
    shell
        World units: an open mesh is taken for a shell of that thickness; 0 for a solid.
    open
        Whether meshes with boundary edges are taken.
    smooth
        "none" or "ls3".
    without
        Channels that are left out, of `OPTIONAL`.
    """

    modes: tuple[str, ...]
    sign: str
    shell: float
    open: bool
    smooth: str
    without: frozenset[str]

    @property
    def may_orient(self) -> bool:
        """Whether pseudonormals may tell inside from outside."""
        return not self.open and self.sign != "winding"

    @staticmethod
    def of(
        mesh: Mesh,
        uv_mode: str | Iterable[str] | None,
        sign: str,
        open_: str | None,
        smooth: str,
        without: Collection[str] = (),
    ) -> "Options":
        """Check what a user wrote; see `bake` for the meaning and the errors."""
        if sign not in ("auto", "winding", "pseudonormal"):
            raise BadInput(f"sign method {sign!r} is unknown: use auto, winding or pseudonormal")
        if smooth not in ("none", "ls3"):
            raise BadInput(f"smoothing {smooth!r} is unknown: use none or ls3")
        kept = sorted(set(without) - OPTIONAL)
        if kept:
            raise BadInput(f"a grid is never without {kept[0]!r}: leave out some of {', '.join(sorted(OPTIONAL))}")
        if len(mesh.part_names) > 256:
            raise BadInput(f"the mesh has {len(mesh.part_names)} parts and a grid stores at most 256: merge some")
        thickness = _thickness(open_)
        if open_ is not None and sign == "pseudonormal":
            raise BadInput("pseudonormals need a closed mesh: leave out --sign pseudonormal, or --open")
        return Options(_modes(mesh, uv_mode), sign, thickness, open_ is not None, smooth, frozenset(without))


def _modes(mesh: Mesh, wanted: str | Iterable[str] | None) -> tuple[str, ...]:
    """Return how texture coordinates are stored, in the order of `MODES`."""
    if wanted is None:
        wanted = "none" if mesh.uv is None else "faces"
    names = {name.strip() for name in wanted.split(",")} if isinstance(wanted, str) else set(wanted)
    unknown = sorted(names - {*MODES, "none"})
    if unknown:
        raise BadInput(f"uv mode {unknown[0]!r} is unknown: use none, or some of {', '.join(MODES)} with commas")
    if "none" in names and len(names) > 1:
        raise BadInput("uv mode 'none' goes with no other: leave it out, or ask for none alone")
    modes = tuple(mode for mode in MODES if mode in names)
    if modes and mesh.uv is None:
        raise BadInput(
            f"uv mode {modes[0]!r} needs texture coordinates and the mesh has none: unwrap it (--unwrap) or use none"
        )
    if modes and not np.isfinite(np.asarray(mesh.uv)).all():
        raise BadInput("the mesh has texture coordinates that are not finite: unwrap it again or use uv mode none")
    return modes


def _thickness(wish: str | None) -> float:
    """Return the thickness of a shell, 0 for a solid."""
    if wish in (None, "winding"):
        return 0.0
    kind, _, number = str(wish).partition(":")
    try:
        thickness = float(number) if kind == "shell" else float("nan")
    except ValueError:
        thickness = float("nan")
    if not 0 < thickness < float("inf"):
        raise BadInput(f"open {wish!r} is unknown: use winding, or shell:T with a thickness T above 0 in mesh units")
    return thickness
