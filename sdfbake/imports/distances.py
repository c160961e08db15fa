"""Whether somebody's numbers are distances, and how far from the surface.

In: samples. Out: where they were cut off, how steep they are at the surface, and what is odd about them in one sentence
each. The gradient of a distance has unit length.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

OFF = 0.1  # a gradient that differs from unit length by more is off, as for the flag EDGE
_UNLIKE = 0.05  # a median that differs by more is no accident
_ALIKE = 0.25  # share of cells that may be off once the numbers are scaled, for a scale to be worth naming
_PLATEAU = 0.01  # share of samples
_SLAB = 8  # layers of cells looked at together


@dataclass(frozen=True, slots=True)
class Steepness:
    """Length of the gradient in the cells that the surface crosses.

    Attributes
    ----------
    cells
        How many there are.
    median
        Of the lengths; 1 for distances.
    off
        Share of the cells where it differs from 1 by more than `OFF`.
    off_scaled
        The same with the median in place of 1.
    """

    cells: int
    median: float
    off: float
    off_scaled: float

    @property
    def is_distance(self) -> bool:
        """Whether the numbers can be distances."""
        return abs(self.median - 1) <= _UNLIKE

    def __str__(self) -> str:
        return (
            f"at the surface the gradient has a median length of {self.median:.3g}, and in {self.off:.1%} of the cells "
            f"it is off 1 by over {OFF:.0%}"
        )

    def note(self, scale: float, spacing: float | None) -> str | None:
        """Say what is wrong, and what would mend it.

        Parameters
        ----------
        scale
            What the file's values were multiplied by.
        spacing
            The one that was assumed; None where it is known, and only another scale can help.
        """
        if not self.cells or self.is_distance:
            return None
        if self.off_scaled > _ALIKE:
            return f"these are no distances: {self}, and no scale would mend that; every hit is flagged BAND"
        cure = f"--scale {scale / self.median:.3g}" if spacing is None else f"--spacing {spacing * self.median:.3g}"
        return f"these are no distances: {self}; {cure} would make them some, and without it every hit is flagged BAND"


def cut_off(values: Float[np.ndarray, "nx ny nz"]) -> float | None:
    """Return the magnitude at which values were cut off on either side, or None where they go on.

    A sample is on a plateau if it and its next neighbours along all three axes have the very greatest value, or the
    very least. Those of a true distance have a slope somewhere.
    """
    found = []
    for extreme in (values.max(), values.min()):
        at = values == extreme
        flat = at[:-1, :-1, :-1] & at[1:, :-1, :-1] & at[:-1, 1:, :-1] & at[:-1, :-1, 1:]
        if np.count_nonzero(flat) > _PLATEAU * flat.size:
            found.append(abs(float(extreme)))
    return min(found, default=None)


def border_note(values: Float[np.ndarray, "nx ny nz"]) -> str | None:
    """Say so where most of the box's border is inside: the file may mean inside by positive numbers."""
    faces = [values[0], values[-1], values[:, 0], values[:, -1], values[..., 0], values[..., -1]]
    negative = sum(int(np.count_nonzero(face < 0)) for face in faces) / sum(face.size for face in faces)
    if negative <= 0.5:
        return None
    return (
        f"{negative:.0%} of the box's border is negative, which is inside here: if the file means outside, give --flip"
    )


def steepness(values: Float[np.ndarray, "nx ny nz"], spacing: float) -> Steepness:
    """Measure the gradient at the centres of cells whose corners have both signs, by central differences."""
    found = [_slopes(values[start : start + _SLAB + 1]) for start in range(0, len(values) - 1, _SLAB)]
    length = np.concatenate(found) / spacing
    if not len(length):
        return Steepness(0, 1.0, 0.0, 0.0)
    median = float(np.median(length))
    scaled = length / median if median > 0 else length
    off, off_scaled = (float(np.mean(np.abs(one - 1) > OFF)) for one in (length, scaled))
    return Steepness(len(length), median, off, off_scaled)


def _slopes(v: Float[np.ndarray, "sx ny nz"]) -> Float[np.ndarray, " n"]:
    """Return the gradient's length in the cells with surface of a slab, in units of value per voxel."""
    corners = [
        tuple(slice(d, n - 1 + d) for d, n in zip((c >> 2 & 1, c >> 1 & 1, c & 1), v.shape, strict=True))
        for c in range(8)
    ]
    negative = v < 0
    some, all_ = negative[corners[0]].copy(), negative[corners[0]].copy()
    for corner in corners[1:]:
        some |= negative[corner]
        all_ &= negative[corner]
    crossed = some & ~all_
    at = [v[corner][crossed].astype(np.float64) for corner in corners]
    # Corner c lies at the bits of c along x, y, z: the mean over four edges of their differences.
    gradient = [np.mean([at[c] - at[c ^ bit] for c in range(8) if c & bit], axis=0) for bit in (4, 2, 1)]
    return np.asarray(np.linalg.norm(gradient, axis=0))
