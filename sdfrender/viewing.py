"""The rays of a picture: through the samples of its pixels, or given by hand.

In: a camera and a film, or a file of rays. Out: for numbers of pixels the columns of a program, and in the program the
beam. A sample lies in the middle of its share of the pixel, or anywhere in it (stratified).
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from sdfbake.engine import Array, Engine
from sdfrender.camera import AnyCamera
from sdfrender.field import Field
from sdfrender.rays import Beam, Rays, beam
from sdfrender.trace import approach
from sdfrender.vector import Vector, along

Pixels = Int[np.ndarray, " n"]


class Start(NamedTuple):
    """Where rays begin: beams with positions relative to the field's anchor, and how far these are along the rays.

    Derivatives are those at the rays' origins, which may be far away.
    """

    beam: Beam
    begin: Array


@runtime_checkable
class View(Protocol):
    """Where the rays of a picture come from."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture."""
        ...

    @property
    def samples(self) -> int:
        """Samples per pixel."""
        ...

    @property
    def middle(self) -> int:
        """Number of the sample that is recorded where there is no mean."""
        ...

    @property
    def step(self) -> float:
        """Of how many pixels the beams' derivatives are."""
        ...

    def origins(self) -> Float[np.ndarray, "_ 3"]:
        """Where rays start, world: once for all pixels, or once for each."""
        ...

    def columns(self, field: Field, samples: Pixels, pixels: Pixels) -> list[np.ndarray]:
        """Return what a program is given for some samples (their number in the pixel) of some pixels."""
        ...

    def start(self, xp: Engine, field: Field, columns: tuple[Array, ...]) -> Start:
        """Return the beams, near the field."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """A camera's picture.

    Attributes
    ----------
    camera
        The camera.
    per_axis
        Samples per pixel along an axis.
    seed
        Of the places of samples within their shares; None for the middles.
    """

    camera: AnyCamera
    per_axis: int
    seed: int | None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.camera.size

    @property
    def samples(self) -> int:
        """Samples per pixel."""
        return self.per_axis**2

    @property
    def middle(self) -> int:
        """The sample in the middle of the pixel, or below it to the right."""
        return (self.per_axis // 2) * (self.per_axis + 1)

    @property
    def step(self) -> float:
        """A sample's share of the pixel."""
        return 1.0 / self.per_axis

    def origins(self) -> Float[np.ndarray, "_ 3"]:
        """Where the camera stands."""
        return np.array([self.camera.position], np.float64)

    def columns(self, field: Field, samples: Pixels, pixels: Pixels) -> list[np.ndarray]:
        """Return pixel numbers, sample numbers and, where there is a seed, places in the samples' shares."""
        if self.seed is None:
            return [pixels, samples]
        width, height = self.size
        places = np.empty((2, len(pixels)))
        for number in np.unique(samples):
            # Of all pixels, so that a pixel's samples do not depend on which others are asked for.
            everywhere = np.random.default_rng([self.seed, number]).random((2, width * height), np.float32)
            chosen = samples == number
            places[:, chosen] = everywhere[:, pixels[chosen]]
        return [pixels, samples, *places]

    def start(self, xp: Engine, field: Field, columns: tuple[Array, ...]) -> Start:
        """Return the beams, at the field's bounding sphere."""
        pixel, sample, *place = columns
        wide, width, across = xp.at(64), xp.uniform(self.size[0]), xp.uniform(self.per_axis)
        row, down = pixel // width, sample // across
        share = [wide.real(p) for p in place] or [0.5, 0.5]
        x = wide.real(pixel - row * width) + (share[0] + wide.real(sample - down * across)) * self.step
        y = wide.real(row) + (share[1] + wide.real(down)) * self.step
        return brought(xp, self.camera, field, (x, y), self.step)


@dataclass(frozen=True, slots=True, eq=False)
class GivenView:
    """Rays given one by one.

    Attributes
    ----------
    rays
        The rays, row by row.
    size
        Width and height of the picture that they make.
    """

    rays: Rays
    size: tuple[int, int]

    @property
    def samples(self) -> int:
        """One ray is one pixel."""
        return 1

    @property
    def middle(self) -> int:
        """The only pass."""
        return 0

    @property
    def step(self) -> float:
        """Derivatives are per pixel."""
        return 1.0

    def origins(self) -> Float[np.ndarray, "_ 3"]:
        """Where every ray starts."""
        return self.rays.p

    def columns(self, field: Field, samples: Pixels, pixels: Pixels) -> list[np.ndarray]:
        """Return the rays' components, brought to the field's box, and how far that was."""
        chosen = self.rays.where(pixels)
        ahead = approach(field, chosen.p, chosen.d)
        columns = chosen.columns()
        columns[:3] = (chosen.p + ahead[:, None] * chosen.d - field.anchor).T
        return [*columns, ahead]

    def start(self, xp: Engine, field: Field, columns: tuple[Array, ...]) -> Start:
        """Return the beams."""
        return Start(beam(columns[:18]), columns[18])


def brought(xp: Engine, camera: AnyCamera, field: Field, film: tuple[Array, Array], step: float) -> Start:
    """Return a camera's beams through places of its film, in double precision, at the field's bounding sphere.

    They are made in float64 and brought there, so that no direction's rounding grows with the camera's distance.
    """
    wide = xp.at(64)
    far = camera.beam(wide, *film, field.anchor, step)
    ahead = wide.uniform(camera.clearance(field.bounds))
    near = Beam(*(_narrowed(xp, vector) for vector in far._replace(p=along(far.p, far.d, ahead))))
    return Start(near, xp.full(near.p[0], 0.0) + xp.real(ahead))


def _narrowed(xp: Engine, vector: Vector) -> Vector:
    return xp.real(vector[0]), xp.real(vector[1]), xp.real(vector[2])
