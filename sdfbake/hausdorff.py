"""How far two surfaces are from each other.

In: two meshes. Out: for each of them the distances of its points from the other one, exact from point to mesh; and the
Hausdorff distance, the greatest of them all. The points are samples, so the greatest is a lower bound: by how much at
most is said too, since the distance changes by no more than a point moves.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sdfbake.closest import Surface
from sdfbake.mesh import Mesh

_CHUNK = 1 << 18  # points asked for at once
_MOST = 2_000_000  # pieces of faces, for each mesh: a few seconds of queries


class OneSided(NamedTuple):
    """Distances from one mesh's points to the other mesh, world units; mean and rms over the area."""

    max: float
    mean: float
    rms: float


@dataclass(frozen=True, slots=True)
class Hausdorff:
    """Distances between two meshes, both ways.

    Attributes
    ----------
    forth, back
        From the first mesh to the second, and from the second to the first.
    samples
        Points of the first and of the second mesh.
    gap
        Every point of the two surfaces is at most this far from a sample, world units: the true greatest distance is
        at most that much more than `max`.
    """

    forth: OneSided
    back: OneSided
    samples: tuple[int, int]
    gap: float

    @property
    def max(self) -> float:
        """The Hausdorff distance over the samples."""
        return max(self.forth.max, self.back.max)


class _Samples(NamedTuple):
    """Points on a mesh, the area that each stands for (0 for vertices), and the widest gap between them."""

    p: Float[np.ndarray, "n 3"]
    area: Float[np.ndarray, " n"]
    gap: float


def hausdorff(a: Mesh, b: Mesh, step: float) -> Hausdorff:
    """Measure the distances between two meshes.

    Parameters
    ----------
    a, b
        Any finite meshes with an area.
    step
        World units. The samples are the vertices, and the centres of the equal pieces that every face is cut into
        until their edges are no longer than this (longer, where that would be more than two million pieces).

    Raises
    ------
    BadInput
        If a mesh has no face with an area.
    """
    there, back = Surface.of(a), Surface.of(b)
    of_a, of_b = _samples(a, step), _samples(b, step)
    return Hausdorff(
        _one_sided(of_a, back), _one_sided(of_b, there), (len(of_a.p), len(of_b.p)), max(of_a.gap, of_b.gap)
    )


def _one_sided(samples: _Samples, to: Surface) -> OneSided:
    """Return figures of the distances from some samples to a surface."""
    starts = range(0, len(samples.p), _CHUNK)
    d = np.concatenate([to.distance(samples.p[start : start + _CHUNK]) for start in starts])
    share = samples.area / samples.area.sum()
    return OneSided(float(d.max()), float(share @ d), float(np.sqrt(share @ d**2)))


def _samples(mesh: Mesh, step: float) -> _Samples:
    """Choose points on a mesh."""
    corners = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1) / 2
    cuts = _cuts(longest, step)
    used = mesh.vertices[np.unique(mesh.faces)]
    points, areas = [used], [np.zeros(len(used))]
    for n in np.unique(cuts):
        faces = np.flatnonzero(cuts == n)
        points.append((_centres(int(n)) @ corners[faces]).reshape(-1, 3))
        areas.append(np.repeat(area[faces] / n**2, n**2))
    # No point of a triangle is farther from its centroid than two thirds of its longest median, and no median is longer
    # than the longest edge.
    return _Samples(np.concatenate(points), np.concatenate(areas), float((longest / cuts).max() * 2 / 3))


def _cuts(longest: Float[np.ndarray, " f"], step: float) -> Int[np.ndarray, " f"]:
    """Return into how many parts the edges of every face are cut; a face is cut into the square of that."""
    while True:
        cuts = np.ceil(longest / step).clip(1)
        if (cuts**2).sum() <= max(_MOST, len(cuts)):
            return cuts.astype(np.int64)
        step *= 1.25


def _centres(n: int) -> Float[np.ndarray, "m 3"]:
    """Return barycentric coordinates of the centroids of a triangle's n^2 equal pieces."""
    i, j = (v.reshape(-1) for v in np.indices((n, n)))
    upright = np.stack([i, j], axis=-1)[i + j < n] + 1 / 3
    hanging = np.stack([i, j], axis=-1)[i + j < n - 1] + 2 / 3
    uv = np.concatenate([upright, hanging]) / n
    return np.column_stack([1 - uv.sum(axis=1), uv])
