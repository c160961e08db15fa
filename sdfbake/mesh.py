"""The mesh that everything starts from.

In: arrays. Out: a frozen `Mesh`: welded vertices, triangles, texture coordinates per corner, chart and part per face.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from sdfbake.complaint import BadInput


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh with texture coordinates per corner.

    Attributes
    ----------
    vertices
        Positions, float64, in the mesh's own units. Vertices are shared across UV seams, so that a closed surface is
        closed here too.
    faces
        Vertex indices, int64, counter-clockwise seen from outside.
    uv
        Texture coordinates per corner, origin lower left, v up; None where the mesh has none.
    chart
        Chart of the atlas per face, int32, from 0; all 0 where there is no atlas.
    part
        Part (submesh or material) per face, int32, index into `part_names`.
    part_names
        Names of the parts.
    units
        Name of the unit of length; recorded, never converted.
    texture
        Path or name of the image that the file names for the surface's colour; recorded, never opened. An image inside
        a file is FILE#image and its name or number. None where the file names none.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    uv: Float[np.ndarray, "f 3 2"] | None = None
    chart: Int[np.ndarray, " f"] = field(default_factory=lambda: np.zeros(0, np.int32))
    part: Int[np.ndarray, " f"] = field(default_factory=lambda: np.zeros(0, np.int32))
    part_names: tuple[str, ...] = ("surface",)
    units: str = "unit"
    texture: str | None = None

    def __post_init__(self) -> None:
        count = len(self.faces)
        set_ = object.__setattr__
        set_(self, "vertices", np.ascontiguousarray(self.vertices, np.float64).reshape(-1, 3))
        set_(self, "faces", np.ascontiguousarray(self.faces, np.int64).reshape(-1, 3))
        if self.uv is not None:
            set_(self, "uv", np.ascontiguousarray(self.uv, np.float64).reshape(count, 3, 2))
        for name in ("chart", "part"):
            values = getattr(self, name)
            values = np.zeros(count, np.int32) if len(values) == 0 else np.ascontiguousarray(values, np.int32)
            if values.shape != (count,):
                raise ValueError(f"{name} has shape {values.shape}, expected ({count},)")
            set_(self, name, values)
        if count and (self.faces.min() < 0 or self.faces.max() >= len(self.vertices)):
            raise BadInput("the mesh has faces that name vertices which do not exist: export it again")

    @staticmethod
    def load(path: str | Path) -> "Mesh":
        """Read a mesh file of any common format; see `sdfbake.meshfile.load`."""
        from sdfbake.meshfile import load  # the file formats import Mesh, so Mesh meets them only here

        return load(path)

    def with_(self, **changes: object) -> "Mesh":
        """Return a copy with some attributes replaced."""
        return replace(self, **changes)  # type: ignore[arg-type]

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and greatest corner of the box around the faces."""
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        p = self.vertices[used]
        return np.stack([p.min(axis=0), p.max(axis=0)])
