"""Bundles of rays for optical tests: four independent perturbations each, the form that they keep, a crossing."""

import numpy as np

from sdfrender import Rays, leaving, refract, transfer

INDEX = 1.5


def perpendicular(vectors, d):
    return vectors - np.sum(vectors * d, axis=1, keepdims=True) * d


def perturbed(p, d, rng):
    """Rays with four independent perturbations each, as two bundles of two."""
    n = len(p)
    moves = [(perpendicular(rng.normal(size=(n, 3)), d), perpendicular(rng.normal(size=(n, 3)), d)) for _ in range(4)]
    return [Rays(p, d, a[0], b[0], a[1], b[1]) for a, b in (moves[:2], moves[2:])]


def perturbations(bundles):
    """The four (dp, dd) of two bundles, dp taken across the ray, where the form looks."""
    pairs = [(b.dp_dx, b.dd_dx) for b in bundles] + [(b.dp_dy, b.dd_dy) for b in bundles]
    return [(perpendicular(dp, bundles[0].d), dd) for dp, dd in pairs]


def forms(bundles):
    """dd_1 . dp_2 - dd_2 . dp_1 of all six pairs of perturbations, (6, n)."""
    moves = perturbations(bundles)

    def form(i, j):
        (dp_i, dd_i), (dp_j, dd_j) = moves[i], moves[j]
        return np.sum(dd_i * dp_j - dd_j * dp_i, axis=1)

    return np.array([form(i, j) for i in range(4) for j in range(i)])


def symplectic_defect(before, after, index_before=1.0, index_after=1.0):
    """Greatest change of n (dd_1 . dp_2 - dd_2 . dp_1) over all pairs, relative to the map's gain squared.

    Omega is a number per pair of perturbations and must stay; rounding grows with the squared length of the results.
    """
    moves = perturbations(before) + perturbations(after)
    size = np.max([np.sum(dp * dp + dd * dd, axis=1) for dp, dd in moves], axis=0)
    defects = np.abs(index_after * forms(after) - index_before * forms(before)) / size
    return np.max(defects, axis=0)


def crossed(field, bundle, index=INDEX, on_surface=False):
    """One crossing: hits, rays at the surface, rays beyond it, and whether they came from inside."""
    hits, at = transfer(field, bundle, on_surface=on_surface)
    inside = leaving(hits, at)
    return hits, at, refract(field, hits, at, eta=np.where(inside, index, 1 / index)), inside
