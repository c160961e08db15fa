"""The box, placed with its axes along the world's, in any of their orders.

In: a net (half extents and texture frame), a centre, a signed permutation of the axes. Out: an exact shape. The
distance outside is |p - clip(p)|, inside that to the nearest face.
"""

from dataclasses import dataclass, field
from math import ceil

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic.net import AXIS, SIGN, Net, face_of, lattice_mesh
from sdfbake.mesh import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A box; six charts, its faces (ids of `net.FACES`, in the box's own frame).

    On edges and corners, and where two faces are equally near inside, the normal is that of the face with the lowest
    id. Outside, past an edge, the distance is that to the edge and its Hessian grows as 1 / distance; on the edge
    itself the Hessian is that of the faces, 0.

    Attributes
    ----------
    net
        Half extents and texture frame.
    centre
        Middle of the box, world frame.
    frame
        (3, 3), rows are the box's x, y, z in the world; a rotation by quarter turns, so that products are exact.
    """

    net: Net
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    frame: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    part_names: tuple[str, ...] = ("box",)

    def __post_init__(self) -> None:
        quarter_turns = np.all(np.isin(self.frame, (-1.0, 0.0, 1.0)))
        if not quarter_turns or not np.array_equal(self.frame @ self.frame.T, np.eye(3)):
            raise ValueError("frame must be a signed permutation of the axes")
        if np.linalg.det(self.frame) < 0:
            raise ValueError("frame must be right-handed, or the texture is mirrored")

    @property
    def half(self) -> Float[np.ndarray, " 3"]:
        """Half extents in the box's own frame."""
        return np.asarray(self.net.half)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and greatest corner."""
        extent = self.half @ np.abs(self.frame)
        bounds: Float[np.ndarray, "2 3"] = np.asarray(self.centre) + np.stack([-extent, extent])
        return bounds

    @property
    def charts(self) -> int:
        """Six faces."""
        return 6

    @property
    def area(self) -> float:
        """Twice the three faces."""
        hx, hy, hz = self.net.half
        return 8 * (hx * hy + hy * hz + hz * hx)

    @property
    def volume(self) -> float:
        """Product of the extents."""
        return 8 * float(np.prod(self.half))

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """|p - clip(p)| outside, the greatest excess over a face inside."""
        x, y, z = np.abs(self._local(p).T) - self.half[:, None]  # columns: NumPy is slow along an axis of three
        outside = np.sqrt(np.maximum(x, 0.0) ** 2 + np.maximum(y, 0.0) ** 2 + np.maximum(z, 0.0) ** 2)
        distance: Float[np.ndarray, " n"] = outside + np.minimum(np.maximum(np.maximum(x, y), z), 0.0)
        return distance

    def normal(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """From the foot outside, the nearest face's normal inside and on the surface."""
        local = self._local(p)
        face = face_of(local, self.net.half)
        outward = local - np.clip(local, -self.half, self.half)
        length = np.linalg.norm(outward, axis=1, keepdims=True)
        flat = np.eye(3)[AXIS[face]] * SIGN[face][:, None]
        n: Float[np.ndarray, "n 3"] = (
            np.where(length > 0, outward / np.where(length > 0, length, 1.0), flat) @ self.frame
        )
        return n

    def hessian(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """(A - n n^T) / distance outside, with A the identity on the axes that are exceeded; 0 inside."""
        local = self._local(p)
        exceeded = (np.abs(local) > self.half).astype(np.float64)
        n, distance = self.normal(p) @ self.frame.T, self.distance(p)
        inverse = np.where(distance > 0, 1 / np.where(distance > 0, distance, 1.0), 0.0)
        local_hessian = (exceeded[:, :, None] * np.eye(3) - n[:, :, None] * n[:, None, :]) * inverse[:, None, None]
        hessian: Float[np.ndarray, "n 3 3"] = self.frame.T @ local_hessian @ self.frame
        return hessian

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Net of the box at the foot."""
        local = self._local(p)
        # Clipping leaves coordinates within the face; the net ignores the one across it.
        return self.net.uv(face_of(local, self.net.half), np.clip(local, -self.half, self.half))

    def uv_gradient(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
        """Constant on each face."""
        gradient: Float[np.ndarray, "n 2 3"] = self.net.gradient(self.chart(p)) @ self.frame
        return gradient

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Face with the greatest excess, the lowest id on ties."""
        return face_of(self._local(p), self.net.half)

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """One part."""
        return np.zeros(len(p), np.int64)

    def intersect(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Last of the three slabs' entries, if it comes before the first of their exits."""
        origin, direction = self._local(o), d @ self.frame.T
        along = direction != 0
        safe = np.where(along, direction, 1.0)
        reach = np.where(direction < 0, -self.half, self.half)
        # A ray parallel to a slab is in it always or never.
        parallel = np.where(np.abs(origin) <= self.half, np.inf, -np.inf)
        enter = np.where(along, (-reach - origin) / safe, -parallel).max(axis=1)
        leave = np.where(along, (reach - origin) / safe, parallel).min(axis=1)
        return np.where((enter <= leave) & (enter >= 0), enter, np.inf)

    def mesh(self, edge: float) -> Mesh:
        """Six even grids; creases run along the edges of the box."""
        nx, ny, nz = (max(1, ceil(2 * extent / edge)) for extent in self.net.half)
        cube, faces, face = lattice_mesh((nx, ny, nz))
        local = cube * self.half
        uv = self.net.uv(np.repeat(face, 3), local[faces].reshape(-1, 3)).reshape(-1, 3, 2)
        return Mesh(np.asarray(self.centre) + local @ self.frame, faces, uv, face, part_names=self.part_names)

    def _local(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        local: Float[np.ndarray, "n 3"] = (p - np.asarray(self.centre)) @ self.frame.T
        return local
