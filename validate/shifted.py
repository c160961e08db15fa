"""Pictures of the same scene with the film moved by parts of a pixel: what boils when a camera moves.

In: a camera. Out: a `View` whose picture is all of those, one below the other; and the truth for each of them, cut from
one picture of FINE times as many pixels along either side.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine
from sdfrender.camera import AnyCamera
from sdfrender.field import Field
from sdfrender.viewing import CameraView, Pixels, Start, brought

Shifts = tuple[tuple[int, int], ...]
# Shifts are multiples of a quarter of a pixel, so that one picture of quarter pixels holds the truth for all of them.
FINE = 4
STILL: Shifts = ((0, 0),)
# Every other one of the sixteen quarters, as a checker has its squares: all rows and columns, none twice as often.
EIGHT: Shifts = tuple((i, j) for j in range(FINE) for i in range(FINE) if (i + j) % 2 == 0)


@dataclass(frozen=True, slots=True, eq=False)
class ShiftedView:
    """A camera's picture, once for each shift of the film to the right and down, one below the other.

    Attributes
    ----------
    camera
        The camera.
    per_axis
        Samples per pixel along an axis, in the middles of their shares.
    shifts
        In pixels over FINE.
    """

    camera: AnyCamera
    per_axis: int
    shifts: Shifts = STILL

    @property
    def size(self) -> tuple[int, int]:
        """Width, and height of all pictures together."""
        width, height = self.camera.size
        return width, height * len(self.shifts)

    @property
    def still(self) -> CameraView:
        """The picture that is not moved."""
        return CameraView(self.camera, self.per_axis, None)

    @property
    def samples(self) -> int:
        """Samples per pixel."""
        return self.still.samples

    @property
    def middle(self) -> int:
        """The sample in the middle of the pixel, or below it to the right."""
        return self.still.middle

    @property
    def step(self) -> float:
        """A sample's share of the pixel."""
        return self.still.step

    def origins(self) -> Float[np.ndarray, "_ 3"]:
        """Where the camera stands."""
        return self.still.origins()

    def columns(self, field: Field, samples: Pixels, pixels: Pixels) -> list[np.ndarray]:
        """Return film coordinates; for samples by powers of two they are exact in float32 too."""
        width, height = self.camera.size
        row, x = np.divmod(pixels, width)
        picture, y = np.divmod(row, height)
        down, right = np.divmod(samples, self.per_axis)
        shift = np.array(self.shifts, np.float64)[picture] / FINE
        return [x + shift[:, 0] + (right + 0.5) * self.step, y + shift[:, 1] + (down + 0.5) * self.step]

    def start(self, xp: Engine, field: Field, columns: tuple[Array, ...]) -> Start:
        """Return the beams, at the field's bounding sphere."""
        x, y = (xp.at(64).real(column) for column in columns)
        return brought(xp, self.camera, field, (x, y), self.step)


def parted(rows: Float[np.ndarray, "hs w c"], shifts: Shifts) -> Float[np.ndarray, "shifts h w c"]:
    """Cut what a `ShiftedView` saw into its pictures."""
    return rows.reshape(len(shifts), -1, *rows.shape[1:])


def moved(fine: Float[np.ndarray, "hf wf c"], shift: tuple[int, int]) -> Float[np.ndarray, "h w c"]:
    """Means over whole pixels of a film moved by `shift` quarters, of a picture of quarter pixels.

    What leaves the film on the right and below comes in again on the other side: the last row and column of a film that
    has moved are no truth.
    """
    turned = np.roll(fine, (-shift[1], -shift[0]), axis=(0, 1))
    height, width, channels = turned.shape
    return np.asarray(turned.reshape(height // FINE, FINE, width // FINE, FINE, channels).mean(axis=(1, 3)))
