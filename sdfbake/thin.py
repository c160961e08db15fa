"""Where a solid, or the space between its walls, is too thin for a lattice.

In: a surface with its normals, and a spacing. Out: findings. A ball that touches the surface from inside and is cut by
a wall that looks the other way shows a solid thinner than the ball; from outside, a gap. In solids thinner than four
voxels the medial axis enters the stencils of the kernels; below two, surface may be lost.
"""

import numpy as np
from jaxtyping import Bool, Float

from sdfbake.closest import Surface
from sdfbake.diagnosis import Finding
from sdfbake.lattice import Lattice
from sdfbake.mesh import Mesh
from sdfbake.sign import Pseudonormals

# Points of the surface that are looked at: 15 ms where few balls are cut, ten times that where most are.
_MOST = 1024
# Radii of the balls, voxels. A wall of thickness t is sure to be seen by a ball whose radius is between t / 2 and t, as
# its centre lies in the wall's far half. The centre of a larger one may lie beyond, next to another wall that looks as
# the first side does. Hence halves, down to a quarter.
_RADII = (2.0, 1.0, 0.5, 0.25)
_OPPOSITE = -0.5  # cosine: walls that meet at less than 60 degrees, or face each other
_TOUCH = 1e-6  # of the radius: above the rounding of a distance in the unit frame, far below what matters
# Steps of the sequence that fills the square most evenly (Roberts 2018): 1 / g and 1 / g^2, g^3 = g + 1.
_STEPS = np.array([0.7548776662466927, 0.5698402909980532])


def thin_features(normals: Pseudonormals, spacing: float) -> tuple[Finding, ...]:
    """Look for walls and gaps thinner than four and than two voxels.

    Parameters
    ----------
    normals
        Of a closed mesh, as a bake has them.
    spacing
        Of the lattice, world units.

    Returns
    -------
    findings
        "thin" or "gap", at four voxels, then at two; none for what was not found. They count points of the surface,
        1024 of them, spread evenly over its area, the same for the same mesh: what takes less than about half a per
        cent of the area may be missed. The consequence is always "noted".

    Examples
    --------
    >>> from datasets_synthetic import mesh
    >>> from sdfbake.closest import Surface
    >>> thin_features(Pseudonormals.of(Surface.of(mesh("sphere"))), 0.05)
    ()
    """
    p, n = _points(normals)
    found = []
    for name, side, what in (("thin", -1, "the solid is"), ("gap", 1, "the space in front is")):
        opposite = _opposite(normals, p, n, side * spacing)
        for radii, word in ((opposite, "four"), (opposite[1:], "two")):
            crowded = np.asarray(radii.any(axis=0))
            if crowded.any():
                of = f"of {len(p)} surface points ({crowded.mean():.2%} of the area) where {what} thinner than {word}"
                found.append(_finding(name, f"{of} voxels", crowded, p))
    return tuple(found)


def thin_in(mesh: Mesh, lattice: Lattice) -> tuple[Finding, ...]:
    """Return the thin features of a closed mesh in a lattice; see `thin_features`."""
    return thin_features(Pseudonormals.of(Surface.of(mesh)), lattice.spacing)


def _finding(name: str, of: str, which: Bool[np.ndarray, " n"], p: Float[np.ndarray, "n 3"]) -> Finding:
    """Return a finding about some of the points."""
    x, y, z = p[which.argmax()].tolist()
    return Finding(name, int(which.sum()), of, (x, y, z), "noted")


def _points(normals: Pseudonormals) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return points spread evenly over the area, world, and the outward normals there."""
    surface = normals.surface
    through = np.cumsum(np.sqrt((surface.normals * surface.normals).sum(axis=0)))
    number = np.arange(_MOST)
    face = np.searchsorted(through, (number + 0.5) / _MOST * through[-1])
    u, v = ((number[:, None] + 1) * _STEPS % 1).T
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)  # the square's upper half folded back
    q = np.einsum("kn,nkd->nd", np.stack([1 - u - v, u, v]), surface.vertices[surface.faces[face]])
    return q * surface.scale + surface.centre, normals.outward * normals.of_face[face]


def _opposite(
    normals: Pseudonormals, p: Float[np.ndarray, "n 3"], n: Float[np.ndarray, "n 3"], voxel: float
) -> Bool[np.ndarray, "radii n"]:
    """Say for which of the balls that touch the surface at p a wall comes in from the opposite side.

    Centres lie along n where `voxel` is positive, against it where it is negative.
    """
    surface, opposite = normals.surface, np.zeros((len(_RADII), len(p)), bool)
    cut = np.arange(len(p))
    for found, radius in zip(opposite, _RADII, strict=True):
        centre = p[cut] + radius * voxel * n[cut]
        inside = surface.distance(centre) < radius * abs(voxel) * (1 - _TOUCH)
        cut, centre = cut[inside], centre[inside]  # every ball contains those that follow
        wall = normals.outward * normals.of_face[np.searchsorted(surface.ids, surface.closest(centre).face)]
        found[cut] = (wall * n[cut]).sum(axis=1) < _OPPOSITE
    return opposite
