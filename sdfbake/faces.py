"""The faces that a grid's samples name, for texture coordinates that are exact across charts.

In: a mesh. Out: a `FaceTable`, all that a renderer needs to find the texture coordinates of a surface point itself.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sdfbake.mesh import Mesh

NONE = -1  # in the channel `face`: too far from the surface to name one


@dataclass(frozen=True, slots=True, eq=False)
class FaceTable:
    """A mesh as a grid carries it.

    Attributes
    ----------
    vertices
        World positions, float64, shared across the cuts of the atlas.
    corners
        Vertices of every face, int32, counter-clockwise seen from outside.
    uv
        Texture coordinates per corner, float64.
    chart
        Chart of every face, int32.
    """

    vertices: Float[np.ndarray, "v 3"]
    corners: Int[np.ndarray, "f 3"]
    uv: Float[np.ndarray, "f 3 2"]
    chart: Int[np.ndarray, " f"]

    @staticmethod
    def of(mesh: Mesh) -> "FaceTable":
        """Take what is needed of a mesh with texture coordinates; unused vertices and all."""
        if mesh.uv is None:
            raise ValueError("a face table needs texture coordinates")
        return FaceTable(mesh.vertices, mesh.faces.astype(np.int32), mesh.uv, mesh.chart)

    def mesh(self) -> Mesh:
        """Return the table as a mesh again."""
        return Mesh(self.vertices, self.corners.astype(np.int64), self.uv, self.chart)
