"""Bundles of rays for optical tests, and a crossing; what they must keep is in `validate.identities`."""

import numpy as np

from sdfrender import leaving, refract, transfer
from validate import identities
from validate.course import as_rays

INDEX = 1.5


def perturbed(p, d, rng):
    """Rays with four independent perturbations each, as two bundles of two."""
    return [as_rays(bundle) for bundle in identities.perturbed(p, d, rng)]


def crossed(field, bundle, index=INDEX, on_surface=False):
    """One crossing: hits, rays at the surface, rays beyond it, and whether they came from inside."""
    hits, at = transfer(field, bundle, on_surface=on_surface)
    inside = leaving(hits, at)
    return hits, at, refract(field, hits, at, eta=np.where(inside, index, 1 / index)), inside
