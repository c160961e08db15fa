"""What a grid says about itself.

In: what the bake knew. Out: `Metadata`, frozen and validated: a file with an unknown or missing entry is refused.
"""

from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from sdfbake.lattice import BAND

FORMAT_VERSION = 2
MODES = ("faces", "layers", "grid")  # of texture coordinates, the most exact first


@cache
def tool_version() -> str:
    """Return the version of the installed distribution."""
    try:
        return version("sdf-ray-differentials")
    except PackageNotFoundError:  # run from a folder that was never installed
        return "unknown"


class Sign(BaseModel):
    """How inside was told from outside, and how sure that is.

    Attributes
    ----------
    method
        "exact" for functions and given numbers, else "pseudonormal" or "winding".
    checked
        Number of samples whose sign a second method looked at.
    disagree
        Share of those where it said otherwise, 0 to 1.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Literal["exact", "pseudonormal", "winding"] = "exact"
    checked: int = Field(default=0, ge=0)
    disagree: float = Field(default=0.0, ge=0, le=1)


class Metadata(BaseModel):
    """Record that travels with a grid.

    Attributes
    ----------
    format_version, tool_version
        Version of the file's layout and of what wrote it.
    units
        Name of the unit of length.
    band
        Half width of the exact band, voxels.
    source
        What the grid was made of.
    mesh_hash
        SHA-256 of the mesh's arrays; None for other sources.
    sign
        Method and agreement of the signs.
    parts
        Names of the parts, in the order of their ids.
    charts
        Number of charts of the atlas; 0 without texture coordinates.
    uv_modes
        How texture coordinates are stored, in the order of `MODES`; none without them.
    overflow
        Cells whose charts beyond the third were left out of the layers.
    texture
        Image that the mesh's file names for it.
    options
        What the bake was asked for.
    edge_over_h
        Median edge of the mesh in voxels; above 1, reflections look faceted. None for other sources.
    stretch
        Least and greatest singular value of d(uv)/d(position) over the faces, per world unit, where texture coordinates
        are stored as faces and every place of the surface lies on some; None elsewhere, and in older files.
    checksums
        SHA-256 per stored array, filled when the grid is saved.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    format_version: int = FORMAT_VERSION
    tool_version: str = Field(default_factory=tool_version)
    units: str = "unit"
    band: float = BAND
    source: Literal["mesh", "function", "dense"]
    mesh_hash: str | None = None
    sign: Sign = Sign()
    parts: tuple[str, ...] = ("surface",)
    charts: int = Field(default=0, ge=0)
    uv_modes: tuple[Literal["faces", "layers", "grid"], ...] = ()
    overflow: int = Field(default=0, ge=0)
    texture: str | None = None
    options: dict[str, str | int | float | bool | None] = {}
    edge_over_h: float | None = None
    stretch: tuple[float, float] | None = None
    checksums: dict[str, str] = {}
