"""What every exact shape of this room answers.

In: points and rays, (n, 3) float64, world frame. Out: distance, texture coordinates, ids, and their derivatives, in
closed form (or to the rounding of float64); a mesh whose vertices lie on the same surface.
"""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from sdfbake.mesh import Mesh


@runtime_checkable
class ExactShape(Protocol):
    """A closed solid whose every answer is exact near and far, inside and outside.

    "The foot of p" is the surface point closest to p. Where several are equally close (the medial axis), any one of
    them is used, always the same one. All points are (n, 3) float64 in the unit and frame of the shape.
    """

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and greatest corner of the box around the solid."""
        ...

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts, in the order of their ids."""
        ...

    @property
    def charts(self) -> int:
        """Number of charts; ids run from 0. A chart never touches itself across a cut."""
        ...

    @property
    def area(self) -> float:
        """Area of the surface, unit squared."""
        ...

    @property
    def volume(self) -> float:
        """Volume of the solid, unit cubed."""
        ...

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Signed distance, negative inside."""
        ...

    def normal(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Unit gradient of the signed distance at `p`; on the surface the outward normal."""
        ...

    def hessian(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """Hessian of the signed distance at `p`, 1/unit; the shape operator where `p` is on the surface.

        Where a curvature of the distance is infinite (medial axis, centre), that curvature is left out (0).
        """
        ...

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Texture coordinates of the foot of `p`."""
        ...

    def uv_gradient(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
        """Surface gradient of the texture coordinates at the foot of `p`, 1/unit; it annihilates the normal there."""
        ...

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Chart id of the foot of `p`."""
        ...

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Part id of the foot of `p`."""
        ...

    def intersect(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Ray distance t >= 0 at which o + t d first enters the solid, inf for a miss; `d` is of unit length.

        An origin on the surface does not hit its own start when it leaves. An origin inside is not asked for: it hits
        where it comes in again, if ever.
        """
        ...

    def mesh(self, edge: float) -> Mesh:
        """Closed outward triangle mesh with vertices on the surface, edges about `edge` long, and the shape's own uv.

        Vertices are shared across cuts; texture coordinates are exact at the corners and linear between them.
        """
        ...
