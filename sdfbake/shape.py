"""What the baker asks of an exact shape.

In: nothing but a protocol. Out: the names `Shape` and `Charted` that `Grid.from_function` samples.
"""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int


@runtime_checkable
class Shape(Protocol):
    """A solid with a closed-form signed distance and texture coordinates; points are (n, 3), world frame."""

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and greatest corner of the box around the solid."""
        ...

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Exact signed distance, negative inside, in the unit of `p`."""
        ...

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Texture coordinates of the surface point closest to `p`."""
        ...


@runtime_checkable
class Charted(Protocol):
    """A shape whose surface has several charts or parts; a chart never touches itself across a cut."""

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts, in the order of their ids."""
        ...

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Chart id of the surface point closest to `p`."""
        ...

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Part id of the surface point closest to `p`."""
        ...
