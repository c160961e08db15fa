"""Solids of revolution about the z axis: cylinder, cone and capsule.

In: a convex profile in the half plane (r, z), r >= 0. Out: an exact shape. For a function f(r, z) of that half plane
the Hessian in space has the profile's own second derivative across its gradient, the meridian's, and around the axis

    f_r / r,

so that all answers follow from the closest point in the half plane. Texture: the side is a strip around the axis, cut
into quarter turns; the caps are discs by arc length from the axis, which are smooth at the poles.
"""

from dataclasses import dataclass
from math import ceil, pi, sqrt
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic.net import lattice_mesh
from sdfbake.mesh import Mesh

#: Pieces of a profile, from the axis below to the axis above.
BOTTOM, SIDE, TOP = 0, 1, 2
#: Chart of each quarter turn of the side, from -45 degrees on; those of the caps. They are the faces of the cube.
_QUARTER = np.array([1, 3, 2, 4])
_CAP = np.array([5, -1, 0])


class ProfileFoot(NamedTuple):
    """The closest point of a profile to each (r, z), and the distance's derivatives at (r, z); arrays over n."""

    distance: np.ndarray  # signed
    nr: np.ndarray  # gradient of the distance
    nz: np.ndarray
    bend: np.ndarray  # second derivative of the distance across its gradient
    r: np.ndarray  # of the foot
    piece: np.ndarray  # BOTTOM, SIDE or TOP
    s: np.ndarray  # arc length to the foot: on a cap from the axis, on the side from below
    tr: np.ndarray  # unit direction of growing s on that piece
    tz: np.ndarray


@runtime_checkable
class Profile(Protocol):
    """A convex curve from the axis to the axis, in three pieces that meet at rims."""

    @property
    def part_name(self) -> str:
        """Name of the solid."""
        ...

    @property
    def extent(self) -> tuple[float, float, float]:
        """Greatest radius, least and greatest z."""
        ...

    @property
    def lengths(self) -> tuple[float, float, float]:
        """Arc lengths of the pieces."""
        ...

    @property
    def area(self) -> float:
        """Area of the surface."""
        ...

    @property
    def volume(self) -> float:
        """Volume of the solid."""
        ...

    def foot(self, r: Float[np.ndarray, " n"], z: Float[np.ndarray, " n"]) -> ProfileFoot:
        """Closest point to each (r, z)."""
        ...

    def place(self, piece: int, s: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Radius and height at arc length `s` of a piece, counted as in `ProfileFoot`."""
        ...

    def interval(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Where each line enters and leaves the solid; enter > leave for a miss."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Revolution:
    """A solid of revolution; six charts: caps (0 on top, 5 below) and quarter turns of the side (+x, -x, +y, -y).

    On the axis, where every direction around it is alike, that of +x is used.
    """

    profile: Profile

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and greatest corner."""
        radius, low, high = self.profile.extent
        return np.array([[-radius, -radius, low], [radius, radius, high]])

    @property
    def part_names(self) -> tuple[str, ...]:
        """One part."""
        return (self.profile.part_name,)

    @property
    def charts(self) -> int:
        """Four quarter turns and two caps."""
        return 6

    @property
    def area(self) -> float:
        """The profile's closed form."""
        return self.profile.area

    @property
    def volume(self) -> float:
        """The profile's closed form."""
        return self.profile.volume

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Distance in the half plane."""
        distance: Float[np.ndarray, " n"] = self._foot(p).distance
        return distance

    def normal(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """(f_r cos phi, f_r sin phi, f_z)."""
        foot, (outward, _) = self._foot(p), _around(p)
        normal: Float[np.ndarray, "n 3"] = foot.nr[:, None] * outward + foot.nz[:, None] * _UP
        return normal

    def hessian(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """Curvature of the meridian, and f_r / r around the axis; at a pole both are equal."""
        foot, (outward, forward) = self._foot(p), _around(p)
        r = np.hypot(p[:, 0], p[:, 1])
        around = np.where(r > 0, foot.nr * _inverse(r), np.where(foot.nr == 0, foot.bend, 0.0))
        along = foot.nr[:, None] * _UP - foot.nz[:, None] * outward
        hessian: Float[np.ndarray, "n 3 3"] = _outer(along, foot.bend) + _outer(forward, around)
        return hessian

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Strip of the side below, discs of the caps above."""
        foot, (outward, _) = self._foot(p), _around(p)
        return self._laid(foot.piece, foot.s, _turns(p), outward[:, :2])

    def uv_gradient(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
        """On the side grad u = 1 / (2 pi r) around; on a cap grad (s cos phi) = cos phi grad s - s / r sin phi around.

        At a pole s / r tends to ds / dr.
        """
        foot, (outward, forward) = self._foot(p), _around(p)
        side, scale = (foot.piece == SIDE)[:, None], self._scale
        along = foot.tr[:, None] * outward + foot.tz[:, None] * _UP
        grow = scale * along
        spin = scale * np.where(foot.r > 0, foot.s * _inverse(foot.r), _inverse(foot.tr))[:, None] * forward
        cos, sin = outward[:, :1], outward[:, 1:2]
        u = np.where(side, _inverse(2 * pi * foot.r)[:, None] * forward, cos * grow - sin * spin)
        v = np.where(side, grow, _mirrored(foot.piece)[:, None] * (sin * grow + cos * spin))
        return np.stack([u, v], axis=1)

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Piece of the profile, the side's by quarter turns."""
        piece = self._foot(p).piece
        quarter = np.minimum(4 * _turns(p), 3).astype(np.int64)
        chart: Int[np.ndarray, " n"] = np.where(piece == SIDE, _QUARTER[quarter], _CAP[piece])
        return chart

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """One part."""
        return np.zeros(len(p), np.int64)

    def intersect(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Where the line enters the convex solid, if that is ahead."""
        enter, leave = self.profile.interval(o, d)
        return np.where((enter <= leave) & (enter >= 0), enter, np.inf)

    def mesh(self, edge: float) -> Mesh:
        """Lattice of a cube: its top and bottom are drawn into discs (Shirley and Chiu 1997), its sides into strips."""
        radius = self.profile.extent[0]
        # Rings are the cap's length / half apart, their points pi radius / (4 half): `edge` is their geometric mean.
        half = max(1, ceil(sqrt(self.profile.lengths[BOTTOM] * pi * radius / 4) / edge))
        cube, faces, face = lattice_mesh((2 * half, 2 * half, max(1, ceil(self.profile.lengths[SIDE] / edge))))
        faces = _spoked(cube, faces, face)
        share, cos_sin = _disc(cube)
        vertices = np.empty_like(cube)
        for piece, on in enumerate((cube[:, 2] == -1, np.abs(cube[:, 2]) < 1, cube[:, 2] == 1)):
            s = self._arc(piece, cube[on], share[on])
            r, z = self.profile.place(piece, s)
            vertices[on] = np.column_stack([r[:, None] * cos_sin[on], z])
        uv = self._corner_uv(cube[faces].reshape(-1, 3), np.repeat(face, 3)).reshape(-1, 3, 2)
        return Mesh(vertices, faces, uv, face, part_names=self.part_names)

    def _corner_uv(self, cube: Float[np.ndarray, "n 3"], face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Texture coordinates of places on the cube, taken to lie on the given faces."""
        share, cos_sin = _disc(cube)
        piece = np.select([face == _CAP[BOTTOM], face == _CAP[TOP]], [BOTTOM, TOP], SIDE)
        s = np.select([piece == k for k in range(3)], [self._arc(k, cube, share) for k in range(3)])
        quarter = np.argsort(_QUARTER)[np.clip(face, 1, 4) - 1]
        # Within a quarter the angle is even along the face's edge, counter-clockwise: y on +x, -x on +y, ...
        along = np.choose(quarter, [cube[:, 1], -cube[:, 0], -cube[:, 1], cube[:, 0]])
        return self._laid(piece, s, (quarter + (along + 1) / 2) / 4, cos_sin)

    def _arc(self, piece: int, cube: np.ndarray, share: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Arc length of places on the cube, on one piece of the profile."""
        arc: Float[np.ndarray, " n"] = self.profile.lengths[piece] * ((cube[:, 2] + 1) / 2 if piece == SIDE else share)
        return arc

    def _laid(
        self,
        piece: Int[np.ndarray, " n"],
        s: Float[np.ndarray, " n"],
        turn: Float[np.ndarray, " n"],
        cos_sin: Float[np.ndarray, "n 2"],
    ) -> Float[np.ndarray, "n 2"]:
        """Lay out the pieces: the side is (turn, arc length), the caps are discs above its left and right half."""
        lengths, scale = self.profile.lengths, self._scale
        middle = scale * (lengths[SIDE] + max(lengths[BOTTOM], lengths[TOP]))
        cap = scale * s[:, None] * cos_sin * np.stack([np.ones(len(s)), _mirrored(piece)], axis=1)
        cap += np.stack([np.where(piece == TOP, 0.25, 0.75), np.full(len(s), middle)], axis=1)
        laid: Float[np.ndarray, "n 2"] = np.where((piece == SIDE)[:, None], np.stack([turn, scale * s], axis=1), cap)
        return laid

    @property
    def _scale(self) -> float:
        """Texture units per unit of arc length: at the greatest radius the strip is stretched alike both ways."""
        return 1 / (2 * pi * self.profile.extent[0])

    def _foot(self, p: Float[np.ndarray, "n 3"]) -> ProfileFoot:
        return self.profile.foot(np.hypot(p[:, 0], p[:, 1]), p[:, 2])


_UP = np.array([0.0, 0.0, 1.0])


def line_and_cylinder(
    o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], radius: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Where lines enter and leave the endless cylinder about the z axis, from their closest approach to the axis."""
    speed = np.hypot(d[:, 0], d[:, 1])
    inverse = _inverse(speed)
    middle = -(o[:, 0] * d[:, 0] + o[:, 1] * d[:, 1]) * inverse * inverse
    # A line along the axis is as far from it as its origin.
    closest = np.where(speed > 0, np.abs(o[:, 0] * d[:, 1] - o[:, 1] * d[:, 0]) * inverse, np.hypot(o[:, 0], o[:, 1]))
    half = np.sqrt(np.maximum((radius - closest) * (radius + closest), 0.0)) * inverse
    half = np.where(speed > 0, half, np.inf)
    missed = closest > radius
    return np.where(missed, np.inf, middle - half), np.where(missed, -np.inf, middle + half)


def line_and_slab(
    o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], low: float, high: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Where lines enter and leave low <= z <= high; one that is parallel is in it always or never."""
    inverse = _inverse(d[:, 2])
    first, last = (low - o[:, 2]) * inverse, (high - o[:, 2]) * inverse
    always = np.where((o[:, 2] >= low) & (o[:, 2] <= high), np.inf, -np.inf)
    parallel = d[:, 2] == 0
    return (
        np.where(parallel, -always, np.minimum(first, last)),
        np.where(parallel, always, np.maximum(first, last)),
    )


def _around(p: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors away from the axis and counter-clockwise around it, each (n, 3)."""
    r = np.hypot(p[:, 0], p[:, 1])
    inverse = _inverse(r)
    cos, sin, zero = np.where(r > 0, p[:, 0] * inverse, 1.0), p[:, 1] * inverse, np.zeros(len(p))
    return np.stack([cos, sin, zero], axis=1), np.stack([-sin, cos, zero], axis=1)


def _turns(p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Azimuth in turns, 0 at the first quarter's start."""
    turns: Float[np.ndarray, " n"] = np.mod(np.arctan2(p[:, 1], p[:, 0]) + pi / 4, 2 * pi) / (2 * pi)
    return turns


def _disc(cube: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Share of the radius (n,), and (cos phi, sin phi) (n, 2), of (x, y) in [-1, 1]^2; squares become rings."""
    x, y = cube[:, 0], cube[:, 1]
    wide = np.abs(x) >= np.abs(y)
    share = np.maximum(np.abs(x), np.abs(y))
    minor = pi / 4 * np.where(wide, y, x) * _inverse(np.where(wide, x, y))
    turned = np.where(wide, np.stack([np.cos(minor), np.sin(minor)]), np.stack([np.sin(minor), np.cos(minor)]))
    return share, (turned * np.where(np.where(wide, x, y) < 0, -1.0, 1.0)).T


def _spoked(
    cube: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], face: Int[np.ndarray, " f"]
) -> Int[np.ndarray, "f 3"]:
    """Turn the diagonals of the caps' squares towards the axis, or a corner's triangle has all of itself on the rim."""
    quad = faces.reshape(-1, 2, 3)  # (a, b, c), (a, c, d)
    a, b, c, d = quad[:, 0, 0], quad[:, 0, 1], quad[:, 0, 2], quad[:, 1, 2]
    middle, diagonal = cube[a] + cube[c], cube[c] - cube[a]
    across = np.prod(middle[:, :2] * diagonal[:, :2], axis=1) < 0
    turn = across & np.isin(face[::2], _CAP)
    turned = np.stack([a, b, d, b, c, d], axis=1).reshape(-1, 2, 3)
    return np.where(turn[:, None, None], turned, quad).reshape(-1, 3)


def _mirrored(piece: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """-1 below, where an eye outside sees the plane from behind."""
    return np.where(piece == BOTTOM, -1.0, 1.0)


def _outer(v: Float[np.ndarray, "n 3"], factor: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    outer: Float[np.ndarray, "n 3 3"] = factor[:, None, None] * (v[:, :, None] * v[:, None, :])
    return outer


def _inverse(x: np.ndarray) -> np.ndarray:
    """1 / x, and 0 where x is 0: the caller says what that limit means."""
    zero = x == 0
    return np.where(zero, 0.0, 1 / np.where(zero, 1.0, x))
