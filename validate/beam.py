"""Rays with differentials, as both routes speak of them.

In: nothing but a protocol, so that the reference needs no import of the renderer. Out: `Beam`, which the renderer's
rays satisfy as they are, `MeshRays`, the reference's own, and `displace`, which moves rays by a pixel offset.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int


@runtime_checkable
class Beam(Protocol):
    """Rays with differentials per pixel step; all arrays (n, 3), float64, world frame."""

    @property
    def p(self) -> Float[np.ndarray, "n 3"]:
        """Origins."""
        ...

    @property
    def d(self) -> Float[np.ndarray, "n 3"]:
        """Unit directions."""
        ...

    @property
    def dp_dx(self) -> Float[np.ndarray, "n 3"]:
        """Derivative of the origin per pixel step to the right."""
        ...

    @property
    def dp_dy(self) -> Float[np.ndarray, "n 3"]:
        """Derivative of the origin per pixel step down."""
        ...

    @property
    def dd_dx(self) -> Float[np.ndarray, "n 3"]:
        """Derivative of the direction per pixel step to the right."""
        ...

    @property
    def dd_dy(self) -> Float[np.ndarray, "n 3"]:
        """Derivative of the direction per pixel step down."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class MeshRays:
    """Rays with differentials; see `Beam`."""

    p: Float[np.ndarray, "n 3"]
    d: Float[np.ndarray, "n 3"]
    dp_dx: Float[np.ndarray, "n 3"]
    dp_dy: Float[np.ndarray, "n 3"]
    dd_dx: Float[np.ndarray, "n 3"]
    dd_dy: Float[np.ndarray, "n 3"]


def only(rays: Beam, where: Bool[np.ndarray, " n"] | Int[np.ndarray, " m"]) -> MeshRays:
    """Some of the rays."""
    return MeshRays(
        rays.p[where], rays.d[where], rays.dp_dx[where], rays.dp_dy[where], rays.dd_dx[where], rays.dd_dy[where]
    )


def displace(rays: Beam, dx: float, dy: float) -> MeshRays:
    """Move rays by a pixel offset along their own differentials; directions are normalised again.

    A pinhole camera's pixel moves along another curve with the same tangent, so the derivative at zero is the same.
    """
    d = rays.d + dx * rays.dd_dx + dy * rays.dd_dy
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    p = rays.p + dx * rays.dp_dx + dy * rays.dp_dy
    return MeshRays(p, d, rays.dp_dx, rays.dp_dy, rays.dd_dx, rays.dd_dy)
