"""A surface that stands elsewhere, larger or smaller, turned or mirrored.

In: a field and the similarity that places it. Out: a `Field` in the world's frame. Rays are brought to the local frame
and what is found there is brought back; nothing of the inner field is copied or sampled again.

With x = s R q + b and the world's distance F(x) = s f(q): grad F = R grad f, the Hessian is R H R^T / s, and the
gradient of a texture coordinate, which has no unit of length, R grad u / s. Positions are relative to the image of the
inner field's anchor, so that q = R^T x / s has no offset.
"""

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine
from sdfrender.field import Field, Jet, Mapped, Spot, Spread
from sdfrender.similarity import Similarity
from sdfrender.tables import three
from sdfrender.vector import Symmetric, Vector, apply, dot, scale

Matrix = tuple[Vector, Vector, Vector]  # rows


class Instance:
    """A field under a similarity.

    Parameters
    ----------
    field
        The surface in its own frame.
    placed
        Where it stands in the world.

    Attributes
    ----------
    anchor
        Where the inner field's anchor stands.
    bounds
        World box around the inner field's box.
    """

    def __init__(self, field: Field, placed: Similarity) -> None:
        self.field = field
        self.placed = placed
        self.engine: Engine = field.engine
        self.anchor: Float[np.ndarray, " 3"] = placed.to_world(field.anchor[None])[0]
        self.bounds: Float[np.ndarray, "2 3"] = placed.bounds(field.bounds)
        # s and 1 / s go into the matrices in float64, before the engine rounds them.
        self._turn = _matrix(self.engine, placed.rotation)
        self._outward = _matrix(self.engine, placed.rotation * placed.scale)
        self._inward = _matrix(self.engine, placed.rotation.T / placed.scale)
        self._shrunk = _matrix(self.engine, placed.rotation / placed.scale)
        self._scale = self.engine.uniform(float(placed.scale))
        self._per_scale = self.engine.uniform(1.0 / float(placed.scale))

    @property
    def is_distance(self) -> bool:
        """Whether the inner field is a distance: this one is then."""
        return self.field.is_distance

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the inner field's parts."""
        return self.field.part_names

    @property
    def uv_mode(self) -> str | None:
        """How the inner field knows texture coordinates."""
        return self.field.uv_mode

    def first_hit(
        self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None = None, spread: Spread | None = None
    ) -> Spot:
        """Find first hits; a ray parameter is the same in both frames, as the direction is scaled with the ray."""
        inner = None if start is None else self._local(start)
        near = None if spread is None else Spread(*(_times(self._inward, vector) for vector in spread))
        spot = self.field.first_hit(xp, _times(self._inward, p), _times(self._inward, d), active, inner, near)
        return self._world(spot)

    def occluded(self, xp: Engine, p: Vector, d: Vector, active: Array, start: Spot | None, limit: Array) -> Array:
        """Say which rays meet anything; see `Field.occluded`."""
        inner = None if start is None else self._local(start)
        return self.field.occluded(xp, _times(self._inward, p), _times(self._inward, d), active, inner, limit)

    def inside(self, xp: Engine, p: Vector, active: Array) -> Array:
        """Say which positions are inside: a mirror image has the same inside."""
        return self.field.inside(xp, _times(self._inward, p), active)

    def locate(self, xp: Engine, p: Vector, active: Array) -> Spot:
        """Turn positions into places."""
        return self._world(self.field.locate(xp, _times(self._inward, p), active))._replace(p=p)

    def jet_at(self, xp: Engine, spot: Spot, order: int) -> Jet:
        """Signed distance in world units, and derivatives; see `Field.jet_at`."""
        jet = self.field.jet_at(xp, self._local(spot), order)
        gradient = None if jet.gradient is None else _times(self._turn, jet.gradient)
        hessian = None if jet.hessian is None else self._congruent(jet.hessian)
        return Jet(jet.value * self._scale, gradient, hessian)

    def _congruent(self, hessian: Symmetric) -> Symmetric:
        """Return R H R^T / s."""
        rows = self._turn
        bent = [scale(apply(hessian, row), self._per_scale) for row in rows]
        entries = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        return Symmetric(*(dot(rows[i], bent[j]) for i, j in entries))

    def prepare_uv(self) -> None:
        """Prepare the field that it is of; see `Field.prepare_uv`."""
        self.field.prepare_uv()

    def uv_at(self, xp: Engine, spot: Spot, n: Vector | None) -> Mapped:
        """Texture coordinates at a place; see `Field.uv_at`."""
        mapped = self.field.uv_at(xp, self._local(spot), None if n is None else _transposed(self._turn, n))
        return mapped._replace(du=_times(self._shrunk, mapped.du), dv=_times(self._shrunk, mapped.dv))

    def part_at(self, xp: Engine, spot: Spot) -> Array:
        """Part id at a place."""
        return self.field.part_at(xp, self._local(spot))

    def beyond_band(self, xp: Engine, spot: Spot) -> Array:
        """Say whether values behind a place are not exact."""
        return self.field.beyond_band(xp, self._local(spot))

    def _local(self, spot: Spot) -> Spot:
        return spot._replace(p=_times(self._inward, spot.p))

    def _world(self, spot: Spot) -> Spot:
        return spot._replace(p=_times(self._outward, spot.p))


def _matrix(engine: Engine, matrix: Float[np.ndarray, "3 3"]) -> Matrix:
    """Make the rows of a matrix of numbers that all rays share."""
    x, y, z = (three(engine.uniform(float(entry)) for entry in row) for row in matrix)
    return x, y, z


def _times(matrix: Matrix, v: Vector) -> Vector:
    """Return the matrix times a vector."""
    return dot(matrix[0], v), dot(matrix[1], v), dot(matrix[2], v)


def _transposed(matrix: Matrix, v: Vector) -> Vector:
    """Return the transposed matrix times a vector."""
    x, y, z = matrix
    return dot((x[0], y[0], z[0]), v), dot((x[1], y[1], z[1]), v), dot((x[2], y[2], z[2]), v)
