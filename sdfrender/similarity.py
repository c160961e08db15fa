"""Where an asset stands in the world: scaled, turned or mirrored, moved.

In: a matrix, or scale, rotation and translation. Out: a `Similarity`, world = scale * rotation @ local + translation.
Nothing else will do: under any other affine map a distance is a distance no more.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from sdfbake.complaint import BadInput

ORTHOGONAL = 1e-9  # greatest entry of R^T R - I: far above what products of rotations round to
SIMILAR = 1e-6  # of M^T M / s^2 - I: numbers that were written down in single precision pass
ALL_DISTANCES = "a distance keeps its meaning only under similarity"


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """A map that multiplies all lengths by one number: world = scale * rotation @ local + translation.

    Attributes
    ----------
    scale
        The number, positive.
    rotation
        (3, 3) float64, orthogonal; its determinant is -1 for a mirror image.
    translation
        (3,) float64: where the local origin comes to stand, world units.

    Raises
    ------
    BadInput
        If the scale is not positive, the rotation not orthogonal, or a number not finite.

    Examples
    --------
    >>> import numpy as np
    >>> placed = Similarity.of_parts(2.0, (0.0, 0.0, 1.0, 90.0), (5.0, 0.0, 0.0))
    >>> placed.to_world(np.array([[1.0, 0.0, 0.0]])).round(12).tolist()
    [[5.0, 2.0, 0.0]]
    """

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, " 3"]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise BadInput(f"scale is {self.scale}: give a positive number (a mirror image is given by a matrix)")
        if not (np.isfinite(self.rotation).all() and np.isfinite(self.translation).all()):
            raise BadInput("the transform holds a number that is not finite: give finite ones")
        if np.abs(self.rotation.T @ self.rotation - np.eye(3)).max() > ORTHOGONAL:
            raise BadInput("the rotation is not orthogonal: give one whose columns are of length 1 and at right angles")

    @staticmethod
    def of_matrix(matrix: ArrayLike) -> "Similarity":
        """Take an affine matrix apart.

        Parameters
        ----------
        matrix
            3x4 or 4x4, row by row, for column vectors: the translation is the last column.

        Returns
        -------
        Similarity
            The one next to the matrix: the orthogonal factor of its polar decomposition M = R P, the mean singular
            value.

        Raises
        ------
        BadInput
            If the matrix has another form, is not finite, singular, or no similarity within `SIMILAR`.
        """
        whole = _affine(matrix)
        u, singular, v = np.linalg.svd(whole[:3, :3])
        if not singular[2] > 3 * np.finfo(float).eps * singular[0]:  # what rounding makes of a 0
            raise BadInput("the matrix is singular, it flattens what it is applied to: give one that can be inverted")
        scale = float(singular.mean())
        if np.abs((singular / scale) ** 2 - 1).max() > SIMILAR:
            a, b, c = singular
            raise BadInput(
                f"the matrix shears or scales by different factors (singular values {a:.6g}, {b:.6g}, {c:.6g}), and "
                f"{ALL_DISTANCES}: give it one scale"
            )
        return Similarity(scale, u @ v, whole[:3, 3])

    @staticmethod
    def of_parts(
        scale: float = 1.0,
        rotate: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 0.0),
        translate: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> "Similarity":
        """Scale, then turn about an axis through the origin, then move.

        Parameters
        ----------
        scale
            Factor of all lengths.
        rotate
            x, y and z of the axis, of any length, and the angle in degrees, right-handed.
        translate
            World units.

        Raises
        ------
        BadInput
            If the scale is not positive, the axis has no length, or a number is not finite.
        """
        if not np.isfinite(rotate).all():
            raise BadInput("the rotation holds a number that is not finite: give finite ones")
        axis, angle = np.array(rotate[:3], float), np.radians(rotate[3])
        longest = np.abs(axis).max()
        if not longest > 0:
            raise BadInput("the axis of the rotation has no length: give one such as 0, 0, 1")
        x, y, z = axis / longest / np.linalg.norm(axis / longest)
        across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        # Rodrigues; 1 - cos from the half angle, which a small angle leaves its digits.
        turn = np.eye(3) + np.sin(angle) * across + 2 * np.sin(angle / 2) ** 2 * (across @ across)
        return Similarity(float(scale), turn, np.array(translate, float))

    @property
    def is_identity(self) -> bool:
        """Whether nothing is changed."""
        same = self.scale == 1 and np.array_equal(self.rotation, np.eye(3)) and not self.translation.any()
        return bool(same)

    def to_world(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Bring local points to the world."""
        world: Float[np.ndarray, "n 3"] = self.scale * (points @ self.rotation.T) + self.translation
        return world

    def to_local(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Bring world points back."""
        local: Float[np.ndarray, "n 3"] = (points - self.translation) @ self.rotation / self.scale
        return local

    def bounds(self, box: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "2 3"]:
        """Return the least world box, along the axes, around a local one."""
        half = self.scale * (np.abs(self.rotation) @ (box[1] - box[0])) / 2
        middle = self.to_world(box.mean(axis=0, keepdims=True))
        return np.concatenate([middle - half, middle + half])


def _affine(matrix: ArrayLike) -> Float[np.ndarray, "r 4"]:
    try:
        whole = np.array(matrix, np.float64)
    except (TypeError, ValueError):
        raise BadInput("the matrix does not hold rows of four numbers: give 3x4 or 4x4 of them") from None
    if whole.shape not in ((3, 4), (4, 4)):
        raise BadInput(f"the matrix has the shape {whole.shape}: give 3x4 or 4x4 numbers, row by row")
    if not np.isfinite(whole).all():
        raise BadInput("the matrix holds a number that is not finite: give finite ones")
    if len(whole) == 4 and whole[3].tolist() != [0, 0, 0, 1]:
        raise BadInput(f"the last row of the matrix is {whole[3].tolist()}: give 0, 0, 0, 1 (no perspective)")
    return whole


IDENTITY = Similarity(1.0, np.eye(3), np.zeros(3))
