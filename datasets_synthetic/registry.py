"""All shapes and meshes by name.

In: a name, and for meshes of exact shapes an edge length. Out: an exact shape, or a mesh.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

from datasets_synthetic import real
from datasets_synthetic.box import Box
from datasets_synthetic.bumps import bumps
from datasets_synthetic.capsule import capsule
from datasets_synthetic.cone import cone
from datasets_synthetic.cylinder import cylinder
from datasets_synthetic.ellipsoid import ellipsoid
from datasets_synthetic.gyroid import gyroid
from datasets_synthetic.knot import knot
from datasets_synthetic.net import Net
from datasets_synthetic.shape import ExactShape
from datasets_synthetic.sheet import sheet
from datasets_synthetic.sphere import Sphere
from datasets_synthetic.terrain import terrain
from datasets_synthetic.torus import torus
from datasets_synthetic.turned import plane
from datasets_synthetic.union import Union
from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh

#: More triangles than this is a slip of the edge length, not a wish.
_MOST_FACES = 20_000_000


@dataclass(frozen=True, slots=True)
class Entry:
    """How to build a shape, its default edge length (20,000 to 60,000 faces), and what it is."""

    build: Callable[[], ExactShape]
    edge: float
    about: str


def mirror() -> Union:
    """Build the scene of Galim 2018: a mirror sphere, and a page that faces it from behind the camera.

    The sphere (part 0) has radius 0.8 about the origin. The front of the sheet (part 1), 2.8 by 2.8, looks towards -z
    from z = 2.0; it is 0.5 thick, eight voxels of a grid of 64, so that no stencil at its front reaches the part of its
    inside that is nearer to its back. A camera between them, at (0, 0, 1.9), looking to -z, sees the text mirrored.
    """
    page = sheet((2.8, 2.8), 0.5, (0.0, 0.0, 2.0), "-z")
    return Union((Sphere(0.8), page), ("sphere", "sheet"))


def wall() -> Box:
    """Build a wall thinner than a voxel of a grid of 64 (2 / 62 = 0.03), its front [0, 1]^2 and facing +z."""
    return sheet((2.0, 2.0), 0.02, name="wall")


ENTRIES = {
    "sphere": Entry(lambda: Sphere(0.8), 0.022, "sphere of radius 0.8, equiangular cube map"),
    "torus": Entry(torus, 0.021, "torus, major radius 0.7, minor 0.3"),
    "box": Entry(lambda: Box(Net.fitted((0.8, 0.6, 0.5))), 0.021, "box of 1.6 x 1.2 x 1, unfolded without stretch"),
    "sheet": Entry(sheet, 0.022, "sheet of 2 x 2 x 0.2, its front [0, 1]^2"),
    "knot": Entry(knot, 0.021, "tube of radius 0.14 around a (2, 3) torus knot"),
    "plane": Entry(plane, 0.026, "oblique slab of 2 x 2 x 0.5, its front [0, 1]^2"),
    "wall": Entry(wall, 0.02, "wall of 2 x 2 x 0.02, thinner than a voxel at 64"),
    "cylinder": Entry(cylinder, 0.02, "cylinder, radius 0.6, height 1.4"),
    "cone": Entry(cone, 0.018, "cone, radius 0.7, height 1.4"),
    "capsule": Entry(capsule, 0.02, "capsule, radius 0.5, 1.9 long"),
    "ellipsoid": Entry(ellipsoid, 0.021, "ellipsoid, half axes 0.95, 0.7, 0.5"),
    "gyroid": Entry(gyroid, 0.03, "gyroid shell in a ball of radius 0.9, six projections"),
    "bumps": Entry(bumps, 0.021, "sphere of radius 0.75 displaced by up to 0.15"),
    "terrain": Entry(terrain, 0.024, "rounded block of 1.8 x 1.8 x 1 with hills on top"),
    "mirror": Entry(mirror, 0.034, "sphere and sheet, Galim 2018"),
}


def names() -> tuple[str, ...]:
    """Names of all meshes; those in `exact_names()` have exact shapes too."""
    return (*ENTRIES, *real.FILES)


def exact_names() -> tuple[str, ...]:
    """Names of all exact shapes."""
    return tuple(ENTRIES)


def shape(name: str) -> ExactShape:
    """Exact shape of that name.

    Raises
    ------
    BadInput
        For an unknown name, or that of a real mesh.

    Examples
    --------
    >>> import numpy as np
    >>> float(shape("sphere").distance(np.array([[0.0, 0.0, 2.0]]))[0])
    1.2
    """
    if name in real.FILES:
        raise BadInput(f"{name} is a scanned mesh without an exact shape: use one of {', '.join(ENTRIES)}")
    return _entry(name).build()


def mesh(name: str, edge: float | None = None) -> Mesh:
    """Mesh of that name.

    Parameters
    ----------
    name
        One of `names()`.
    edge
        Length of the edges along the grid of an exact shape's mesh, in the shape's unit; about 40,000 faces if left
        out. Real meshes have edges of their own.

    Raises
    ------
    BadInput
        For an unknown name, an edge length that is not positive or too small, or one given for a real mesh.
    """
    if name in real.FILES:
        if edge is not None:
            raise BadInput(f"{name} is a scanned mesh with edges of its own: leave out the edge length")
        return real.load(name)
    entry = _entry(name)
    exact, length = entry.build(), entry.edge if edge is None else edge
    if not isfinite(length) or length <= 0:
        raise BadInput(f"the edge length {length} is not positive: try {entry.edge}")
    if 2 * exact.area > _MOST_FACES * length**2:
        raise BadInput(f"edges of {length} give {name} more than {_MOST_FACES:,} faces: try {entry.edge}")
    return exact.mesh(length)


def _entry(name: str) -> Entry:
    if name not in ENTRIES:
        raise BadInput(f"there is no shape named {name!r}: choose one of {', '.join(names())}")
    return ENTRIES[name]
