"""Cameras and their ray differentials: pinhole (Galim 2018, eq. 3, 4, times the pixel's size) and orthographic.

In: where the camera stands. Out: for pixel coordinates a beam that starts at the camera.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from sdfbake.complaint import BadInput
from sdfbake.engine import Array, Engine
from sdfbake.engine.numpy import NumpyEngine
from sdfrender.rays import Beam, Rays, components, rays
from sdfrender.vector import Vector, dot, scale, subtract, zero

Frame = tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera.

    Attributes
    ----------
    position, target
        World positions: of the pinhole, and of what appears in the middle of the picture.
    up
        Direction that points up in the picture.
    fov
        Vertical field of view, degrees.
    size
        Width and height, pixels. Pixel (i, j) has its centre at (i + 1/2, j + 1/2), x to the right, y down.

    Raises
    ------
    BadInput
        If the camera looks at its own position or along `up`, or for a field of view outside (0, 180).
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov: float = 45.0
    size: tuple[int, int] = (512, 512)

    def __post_init__(self) -> None:
        if not 0 < self.fov < 180:
            raise BadInput(f"camera.fov is {self.fov} degrees: choose a number between 0 and 180")
        _check(self)

    def frame(self) -> Frame:
        """Return View, and Right and Down per pixel, at unit distance."""
        return _frame(self, 2 * np.tan(np.radians(self.fov) / 2) / self.size[1])

    def beam(self, xp: Engine, x: Array, y: Array, anchor: Float[np.ndarray, " 3"], step: float = 1.0) -> Beam:
        """Return the beams through points of the picture.

        Parameters
        ----------
        xp
            The engine.
        x, y
            Pixel coordinates, floats.
        anchor
            World point that positions are relative to.
        step
            Derivatives are per this many pixels (a sub-pixel's width under supersampling).
        """
        view, right, down = ([xp.uniform(float(c)) for c in vector] for vector in self.frame())
        x, y = x - 0.5 * self.size[0], y - 0.5 * self.size[1]
        d: Vector = tuple(xp.fma(x, right[a], xp.fma(y, down[a], view[a])) for a in range(3))
        squared = dot(d, d)
        length = xp.sqrt(squared)
        nothing = zero(xp, x)
        position = [xp.uniform(float(c)) for c in np.subtract(self.position, anchor)]
        p: Vector = (nothing[0] + position[0], nothing[0] + position[1], nothing[0] + position[2])

        def derivative(axis: list[Array]) -> Vector:
            """Galim 2018, eq. 4."""
            across = (axis[0] * step, axis[1] * step, axis[2] * step)
            along = d[0] * across[0] + d[1] * across[1] + d[2] * across[2]
            top = subtract((across[0] * squared, across[1] * squared, across[2] * squared), scale(d, along))
            return scale(top, 1.0 / (squared * length))

        return Beam(p, scale(d, 1.0 / length), nothing, nothing, derivative(right), derivative(down))

    def clearance(self, bounds: Float[np.ndarray, "2 3"]) -> float:
        """Return how far every ray goes at least before it meets the sphere around a box."""
        centre, radius = bounds.mean(axis=0), np.linalg.norm(bounds[1] - bounds[0]) / 2
        return _clear(np.linalg.norm(centre - self.position) - radius, radius)

    def rays(self) -> Rays:
        """Return the rays through all pixel centres, row by row, float64."""
        return _rays(self)


@dataclass(frozen=True, slots=True)
class OrthographicCamera:
    """A camera without perspective: its rays are parallel, and a pixel is as wide everywhere.

    Attributes
    ----------
    position, target
        World positions: of the middle of the picture, where its rays start, and of a point that appears there.
    up
        Direction that points up in the picture.
    height
        Of the picture, world units.
    size
        Width and height, pixels; as for `Camera`.

    Raises
    ------
    BadInput
        If the camera looks at its own position or along `up`, or for a height that is not positive.
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    height: float = 1.0
    size: tuple[int, int] = (512, 512)

    def __post_init__(self) -> None:
        if not 0 < self.height < np.inf:
            raise BadInput(f"camera.height is {self.height}: choose a positive number")
        _check(self)

    def frame(self) -> Frame:
        """Return View, and Right and Down per pixel."""
        return _frame(self, self.height / self.size[1])

    def beam(self, xp: Engine, x: Array, y: Array, anchor: Float[np.ndarray, " 3"], step: float = 1.0) -> Beam:
        """Return the beams through points of the picture; see `Camera.beam`."""
        view, right, down = ([xp.uniform(float(c)) for c in vector] for vector in self.frame())
        x, y = x - 0.5 * self.size[0], y - 0.5 * self.size[1]
        position = [xp.uniform(float(c)) for c in np.subtract(self.position, anchor)]
        nothing = xp.full(x, 0.0)

        def spread(vector: list[Array], times: float = 1.0) -> Vector:
            return nothing + vector[0] * times, nothing + vector[1] * times, nothing + vector[2] * times

        p: Vector = tuple(xp.fma(x, right[a], xp.fma(y, down[a], position[a])) for a in range(3))
        still = zero(xp, x)
        return Beam(p, spread(view), spread(right, step), spread(down, step), still, still)

    def clearance(self, bounds: Float[np.ndarray, "2 3"]) -> float:
        """Return how far every ray goes at least before it meets the sphere around a box."""
        centre, radius = bounds.mean(axis=0), np.linalg.norm(bounds[1] - bounds[0]) / 2
        return _clear((centre - self.position) @ self.frame()[0] - radius, radius)

    def rays(self) -> Rays:
        """Return the rays through all pixel centres, row by row, float64."""
        return _rays(self)


AnyCamera = Camera | OrthographicCamera


def _clear(way: np.floating[Any], radius: np.floating[Any]) -> float:
    """Stop a rounding short of the sphere; nowhere, where that is behind."""
    return max(float(way) - 1e-9 * float(radius), 0.0)


def _check(camera: AnyCamera) -> None:
    if min(camera.size) < 1:
        raise BadInput(f"camera.size is {camera.size[0]}x{camera.size[1]}: choose at least 1x1 pixels")
    view = np.subtract(camera.target, camera.position)
    if not np.linalg.norm(np.cross(view, camera.up)) > 1e-12 * np.linalg.norm(view) * np.linalg.norm(camera.up):
        raise BadInput("the camera looks at itself or straight along 'up': move camera.target or turn camera.up")


def _frame(camera: AnyCamera, pixel: float) -> Frame:
    """Return View, and Right and Down in pixels of that size."""
    view = np.subtract(camera.target, camera.position)
    view = view / np.linalg.norm(view)
    right = np.cross(view, camera.up)
    right /= np.linalg.norm(right)
    return view, right * pixel, np.cross(view, right) * pixel


def _rays(camera: AnyCamera) -> Rays:
    width, height = camera.size
    index = np.arange(width * height)

    def program(xp: Engine, index: Array) -> dict[str, Array]:
        x, y = xp.real(index % width) + 0.5, xp.real(index // width) + 0.5
        return components(camera.beam(xp, x, y, np.zeros(3)))

    return rays(NumpyEngine(64).run(program, [index]))
