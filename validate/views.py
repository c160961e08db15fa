"""What each route sees of a scene through a number of mirrors, as `Seen`, pixel by pixel.

In: a camera's rays and a field, a mesh or an exact shape. Out: the same record from all of them.
"""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from sdfrender import Camera, Field, footprint, reflect, transfer
from validate import metrics
from validate.beam import Beam, only
from validate.course import as_rays
from validate.metrics import Seen

# Texels along either side of the texture that footprints are measured in.
TEXELS = 1024


@runtime_checkable
class Hop(Protocol):
    """What the references tell of a hit."""

    @property
    def t(self) -> Float[np.ndarray, " n"]:
        """Ray distance, infinite for a miss."""
        ...

    @property
    def n(self) -> Float[np.ndarray, "n 3"]:
        """Unit normal."""
        ...

    @property
    def uv(self) -> Float[np.ndarray, "n 2"]:
        """Texture coordinates."""
        ...

    @property
    def chart(self) -> Int[np.ndarray, " n"]:
        """Chart."""
        ...

    @property
    def duv_dx(self) -> Float[np.ndarray, "n 2"]:
        """Derivative of the texture coordinates per pixel step to the right."""
        ...

    @property
    def duv_dy(self) -> Float[np.ndarray, "n 2"]:
        """Derivative of the texture coordinates per pixel step down."""
        ...


def framing(bounds: Float[np.ndarray, "2 3"], size: int, direction: tuple[float, float, float]) -> Camera:
    """A square camera that looks at a box from `direction` and just holds its bounding sphere."""
    fov = 35.0
    centre, radius = bounds.mean(axis=0), float(np.linalg.norm(bounds[1] - bounds[0])) / 2
    toward = np.asarray(direction) / np.linalg.norm(direction)
    position = centre + toward * radius / np.sin(np.radians(fov / 2))
    x, y, z = (float(c) for c in position)
    cx, cy, cz = (float(c) for c in centre)
    return Camera((x, y, z), (cx, cy, cz), fov=fov, size=(size, size))


def seen(hop: Hop, voxel: float = 1.0) -> Seen:
    """What a reference saw."""
    return Seen(
        hop.t, hop.n, hop.uv, metrics.footprint(hop.duv_dx, hop.duv_dy, TEXELS), hop.chart, voxel, float(TEXELS)
    )


def through_field(field: Field, rays: Beam, bounces: int, voxel: float) -> tuple[Seen, Int[np.ndarray, " n"]]:
    """Trace a field through mirrors: what is seen at the last hop, and its flags.

    Rays that miss on the way are dropped at once, and are misses of the last hop.
    """
    alive = np.arange(len(rays.p))
    hits, at = transfer(field, as_rays(rays))
    for _ in range(bounces):
        hit = np.flatnonzero(hits.hit)
        mirrored = reflect(field, hits, at)
        alive = alive[hit]
        hits, at = transfer(field, as_rays(only(mirrored, hit)), on_surface=True)
    prints = footprint(field, hits, at, size=(TEXELS, TEXELS))
    count = len(rays.p)
    jacobian = metrics.footprint(prints.duv_dx, prints.duv_dy, TEXELS)
    view = Seen(
        t=_spread(hits.t, alive, count, np.inf),
        n=_spread(hits.n, alive, count, 0.0),
        uv=_spread(prints.uv, alive, count, 0.0),
        jacobian=_spread(jacobian, alive, count, 0.0),
        chart=_spread(prints.chart, alive, count, -1),
        voxel=voxel,
        texels=float(TEXELS),
    )
    return view, _spread(prints.flags, alive, count, 0)


def _spread(values: np.ndarray, where: Int[np.ndarray, " m"], count: int, blank: float | int) -> np.ndarray:
    """Values at some pixels among `count`, and `blank` at the others."""
    out = np.full((count, *values.shape[1:]), blank, values.dtype)
    out[where] = values
    return out
