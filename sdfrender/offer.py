"""What a grid has to offer to a picture.

In: the head of its file. Out: an `Offer`, and one sentence where a scene asks for more, with the command that bakes it.
Arrays are not read for it.
"""

from dataclasses import dataclass
from math import sqrt
from pathlib import Path

from sdfbake.complaint import BadInput
from sdfbake.gridfile import whole_head
from sdfbake.lattice import BAND
from sdfbake.metadata import MODES
from sdfrender.scene import Asset

# Voxels from the surface to the farthest sample that a cell with surface reads: corners, a 4^3 stencil, and that with
# the prefilter's halo of one.
BANDS = {"linear": sqrt(3), "catmull-rom": 2 * sqrt(3), "bspline": BAND}


@dataclass(frozen=True, slots=True)
class Offer:
    """What a surface can answer.

    Attributes
    ----------
    uv_modes
        Representations of texture coordinates that it has.
    parts
        Names of its parts; None where they are not known.
    tells_parts
        Whether it knows which part a place is on.
    band
        Voxels from the surface within which its samples are exact.
    levels
        How many coarser levels it has; of what is no file, whether it has any.
    bake
        The command that bakes it anew, up to its texture coordinates; empty where it is no file.
    """

    uv_modes: tuple[str, ...] = MODES
    parts: tuple[str, ...] | None = None
    tells_parts: bool = True
    band: float = BAND
    levels: int = 1
    bake: str = ""

    @staticmethod
    def of(grid: Path) -> "Offer":
        """Ask a grid's file; what does not exist yet can be baked with all that is wished for."""
        if not grid.is_file():
            return Offer()
        lattice, metadata, levels = whole_head(grid)
        resolution = metadata.options.get("resolution", max(lattice.shape))
        return Offer(
            uv_modes=tuple(metadata.uv_modes),
            parts=tuple(metadata.parts),
            tells_parts=len(metadata.parts) == 1 or not metadata.checksums or "part" in metadata.checksums,
            band=metadata.band,
            levels=levels,
            bake=f"python -m sdfbake bake MESH -n {resolution} -o {grid}",
        )

    def command(self, modes: tuple[str, ...]) -> str:
        """Return the command that bakes the grid with some representations of texture coordinates."""
        return self.bake + (f" --uv-mode {','.join(modes)}" if modes else "")

    def require_parts(self, asset: Asset) -> None:
        """Complain if parts are asked for and not told."""
        if not self.tells_parts:
            raise BadInput(
                f"{asset.grid} was baked without its parts, which are needed here: bake it with "
                f"'{self.command(self.uv_modes)}'"
            )

    def require_band(self, asset: Asset, kernel: str) -> None:
        """Complain if a kernel would read samples that are not exact."""
        if self.band < BANDS[kernel]:
            raise BadInput(
                f"{asset.grid} is exact within {self.band:g} voxels of the surface and the kernel {kernel} reads "
                f"samples within {BANDS[kernel]:.3g}: record the output flags, whose BAND says where that matters, or "
                f"bake it with '{self.command(self.uv_modes)}'"
            )
