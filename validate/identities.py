"""What every step of a ray with differentials keeps, whatever the surface: the identities that guard the optics.

In: rays before and after a step, as `Beam`, two bundles of the same rays that carry two perturbations each. Out:
defects per ray, 0 up to rounding. With Omega the form n (dd_1 . dp_2 - dd_2 . dp_1), n the medium's index, a step keeps
Omega of any two of four independent perturbations; a pinhole camera's own two have Omega = 0 and prove nothing.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from validate.beam import Beam, MeshRays

# The bound of every identity, 1e-12 in float64, in units of a precision's eps: a step has some 30 products and sums of
# numbers no greater than what it makes; what n, t and H are does not matter to it.
ROUNDINGS = 1e-12 / float(np.finfo(np.float64).eps)

Bundles = Sequence[Beam]  # two
PerRay = Float[np.ndarray, " n"]


def across(vectors: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The share of vectors perpendicular to unit directions."""
    return np.asarray(vectors - np.sum(vectors * d, axis=1, keepdims=True) * d)


def perturbed(
    p: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"], rng: np.random.Generator, length: float = 1.0
) -> tuple[MeshRays, MeshRays]:
    """Rays with four independent perturbations each, as two bundles of two.

    Parameters
    ----------
    p, d
        Origins and unit directions, world.
    rng
        Source of the perturbations, normal numbers.
    length
        Size of the positions' perturbations, world units: that of the object.
    """
    moves = [(length * across(rng.normal(size=p.shape), d), across(rng.normal(size=p.shape), d)) for _ in range(4)]
    first, second = (MeshRays(p, d, a[0], b[0], a[1], b[1]) for a, b in (moves[:2], moves[2:]))
    return first, second


def symplectic_defect(
    before: Bundles,
    after: Bundles,
    index_before: PerRay | float = 1.0,
    index_after: PerRay | float = 1.0,
    length: float = 1.0,
) -> PerRay:
    """Greatest change of Omega over all six pairs of perturbations, relative to the map's squared size.

    Parameters
    ----------
    before, after
        The same rays on either side of a step. Rays that made no step have defect 0.
    index_before, index_after
        Refractive index of the medium on either side.
    length
        World units that count as 1 beside an angle of 1, as in `perturbed`.

    Returns
    -------
    numpy.ndarray
        (n,): |n' Omega' - n Omega| / max(|dp|^2 / length^2 + |dd|^2), both sides.
    """
    moves = _moves(before, length) + _moves(after, length)
    size = np.max([np.sum(dp * dp + dd * dd, axis=1) for dp, dd in moves], axis=0)
    change = np.abs(index_after * forms(after, length) - index_before * forms(before, length)).max(axis=0)
    return np.asarray(change / np.where(size > 0, size, 1.0))


def direction_defect(rays: Beam) -> PerRay:
    """|d . d - 1| and |d . dd| / |dd|, the greater: directions have unit length and stay so."""
    unit = np.abs(np.sum(rays.d * rays.d, axis=1) - 1.0)
    return np.asarray(np.maximum.reduce([unit, *(_cosine(rays.d, dd) for dd in (rays.dd_dx, rays.dd_dy))]))


def surface_defect(n: Float[np.ndarray, "n 3"], rays: Beam) -> PerRay:
    """|n . n - 1| and |n . dp| / |dp| at a hit, the greater: displacements lie in the surface.

    Towards grazing, dp is a difference of terms 1 / |d . n| times as large; the defect is relative to those.
    """
    slope = np.abs(np.sum(n * rays.d, axis=1))
    unit = np.abs(np.sum(n * n, axis=1) - 1.0)
    return np.asarray(np.maximum.reduce([unit, *(slope * _cosine(n, dp) for dp in (rays.dp_dx, rays.dp_dy))]))


def _moves(bundles: Bundles, length: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """The four (dp, dd) of two bundles; dp across the ray, where the form looks, in units of `length`."""
    first, second = bundles
    pairs = [(b.dp_dx, b.dd_dx) for b in (first, second)] + [(b.dp_dy, b.dd_dy) for b in (first, second)]
    return [(across(dp, first.d) / length, dd) for dp, dd in pairs]


def forms(bundles: Bundles, length: float = 1.0) -> Float[np.ndarray, "6 n"]:
    """dd_1 . dp_2 - dd_2 . dp_1 of all six pairs of the four perturbations."""
    moves = _moves(bundles, length)
    pairs = [(moves[i], moves[j]) for i in range(4) for j in range(i)]
    return np.array([np.sum(dd_i * dp_j - dd_j * dp_i, axis=1) for (dp_i, dd_i), (dp_j, dd_j) in pairs])


def _cosine(unit: Float[np.ndarray, "n 3"], vectors: Float[np.ndarray, "n 3"]) -> PerRay:
    length = np.linalg.norm(vectors, axis=1)
    return np.asarray(np.abs(np.sum(unit * vectors, axis=1)) / np.where(length > 0, length, 1.0))
