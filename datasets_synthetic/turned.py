"""A shape turned about the origin: the oblique plane is a sheet under a rotation.

In: an exact shape and a rotation matrix. Out: an exact shape. With q = R^T p in the shape's own frame, distances are
its own, and gradients and Hessians turn with it: n = R n_q, H = R H_q R^T.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic.box import Box
from datasets_synthetic.net import Net
from datasets_synthetic.shape import ExactShape
from sdfbake.mesh import Mesh

#: R must be orthogonal to the rounding of its own products.
_ROUNDING = 4 * np.finfo(np.float64).eps


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """Any exact shape under a rotation.

    Attributes
    ----------
    member
        The shape, in its own frame.
    rotation
        (3, 3), takes the shape's frame to the world: p = R q.
    """

    member: ExactShape
    rotation: Float[np.ndarray, "3 3"]

    def __post_init__(self) -> None:
        if not np.allclose(self.rotation @ self.rotation.T, np.eye(3), rtol=0, atol=_ROUNDING):
            raise ValueError("rotation must be orthogonal")
        if np.linalg.det(self.rotation) < 0:
            raise ValueError("rotation must be right-handed, or the shape is mirrored")

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Box around the turned corners of the shape's own bounds: tight for a box, and never too small."""
        low, high = self.member.bounds
        extent = np.abs(self.rotation) @ ((high - low) / 2)
        bounds: Float[np.ndarray, "2 3"] = self.rotation @ ((low + high) / 2) + np.stack([-extent, extent])
        return bounds

    @property
    def part_names(self) -> tuple[str, ...]:
        """The shape's own."""
        return self.member.part_names

    @property
    def charts(self) -> int:
        """The shape's own."""
        return self.member.charts

    @property
    def area(self) -> float:
        """The shape's own."""
        return self.member.area

    @property
    def volume(self) -> float:
        """The shape's own."""
        return self.member.volume

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """The shape's own, at R^T p."""
        return self.member.distance(p @ self.rotation)

    def normal(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """R n_q."""
        normal: Float[np.ndarray, "n 3"] = self.member.normal(p @ self.rotation) @ self.rotation.T
        return normal

    def hessian(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """R H_q R^T, made symmetric to the last bit."""
        turned = self.rotation @ self.member.hessian(p @ self.rotation) @ self.rotation.T
        hessian: Float[np.ndarray, "n 3 3"] = (turned + np.swapaxes(turned, 1, 2)) / 2
        return hessian

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """The shape's own."""
        return self.member.uv(p @ self.rotation)

    def uv_gradient(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
        """The shape's own, turned."""
        gradient: Float[np.ndarray, "n 2 3"] = self.member.uv_gradient(p @ self.rotation) @ self.rotation.T
        return gradient

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """The shape's own."""
        return self.member.chart(p @ self.rotation)

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """The shape's own."""
        return self.member.part(p @ self.rotation)

    def intersect(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """The shape's own, along the ray turned back."""
        return self.member.intersect(o @ self.rotation, d @ self.rotation)

    def mesh(self, edge: float) -> Mesh:
        """The shape's own, its vertices turned."""
        mesh = self.member.mesh(edge)
        return mesh.with_(vertices=mesh.vertices @ self.rotation.T)


def rotation(axis: tuple[float, float, float], angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about `axis` (of any length) by `angle` radians, right-handed; Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Float[np.ndarray, "3 3"] = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)
    return rotation


def plane(side: float = 2.0, thickness: float = 0.5) -> Turned:
    """Build an oblique plane that has an inside: a slab whose front face is exactly the texture's [0, 1]^2.

    Its normal is at more than 15 degrees from every plane of the lattice's axes. As thick as eight voxels of a grid of
    64, so that no stencil at its front reaches the part of its inside that is nearer to its back.
    """
    half = (side / 2, side / 2, thickness / 2)
    return Turned(Box(Net.front(half), (0.0, 0.0, -half[2]), part_names=("plane",)), rotation((3.0, -2.0, 1.0), 0.7))
