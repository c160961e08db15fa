"""Which mip levels of a texture footprints can reach, where rays come from a camera alone.

In: a camera, where the bricks in sight are, how texture coordinates are stretched over faces. Out: the first level that
a look-up may read; finer ones need not be kept. docs/plans.md derives the bound.

A footprint is J = G D, where D holds the steps of a hit per step of a sample and G the gradients of (u, v) in the face.
D moves a hit no less than the ray's own spread at its depth does, since what it adds is along the ray. Interpolated
normals may stand askew to a face, so that it sees D foreshortened, yet along one direction at most: the greatest
singular value of J is at least the least of G times the least of D. Of the shorter axis nothing is known.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, log2

import numpy as np

from sdfbake.bricks import SIDE, Bricks
from sdfbake.lattice import Lattice
from sdfbake.metadata import Metadata
from sdfrender.anisotropic import FINEST
from sdfrender.camera import AnyCamera, OrthographicCamera
from sdfrender.facts import NO_COLOUR
from sdfrender.materials import Diffuse, ImageTexture
from sdfrender.planned import Levels, Plan
from sdfrender.reach import Sight, frusta
from sdfrender.scene import Scene
from sdfrender.sharing import sights
from sdfrender.similarity import Similarity
from sdfrender.viewing import CameraView, View

MARGIN = 1.0 / 16.0  # levels, for the rounding of footprints that are up to some thousand times longer than wide
_LOST = 2.0**-16  # of the greatest stretch: what float32 may make of the least
# A trilinear look-up asks for the longer column of J, which has its greatest singular value over sqrt(2) or more; an
# ellipse for the shorter half axis over sqrt(FINEST).
_TRILINEAR, _ELLIPSE = -0.5, -1.0 - 0.5 * log2(FINEST)


@dataclass(frozen=True, slots=True)
class Ground:
    """What bounds the footprints on an asset.

    Attributes
    ----------
    depth
        Least depth along the view of anything of it that rays can meet, world units; infinite where there is nothing.
    stretch
        Least d(uv)/d(position) of its faces, per world unit; None where nothing is known.
    why
        What is not known.
    """

    depth: float
    stretch: float | None
    why: str = ""


def grounds(
    scene: Scene,
    plan: Plan,
    view: View,
    heads: Sequence[tuple[Lattice, Metadata]],
    bricks: Callable[[int], Bricks | None],
) -> tuple[Ground, ...] | None:
    """Return what bounds the footprints on every asset.

    Parameters
    ----------
    scene, plan, view
        What is rendered.
    heads
        What the grid of every asset says of itself.
    bricks
        Given the number of an asset, the bricks of its grid, those in sight at least; None where none is.

    Returns
    -------
    grounds
        None where rays do not come from a camera.
    """
    around = frusta(view)
    if not isinstance(view, CameraView) or around is None:
        return None
    seen = sights(scene, around, [lattice for lattice, _ in heads])
    found = []
    for number, (asset, read, (lattice, metadata)) in enumerate(zip(scene.assets, plan.assets, heads, strict=True)):
        placed, known = asset.placed(), bricks(number)
        near = inf if known is None else _depth(placed, lattice, known, seen[number], view.camera)
        if read.uv_mode != "faces":
            found.append(Ground(near, None, f"texture coordinates as {read.uv_mode} are bounded by no face"))
        elif metadata.stretch is None:
            found.append(Ground(near, None, f"{asset.grid.name} does not say how its faces stretch the texture"))
        else:
            least, greatest = metadata.stretch
            found.append(Ground(near, max(least - _LOST * greatest, 0.0) / placed.scale))
    return tuple(found)


def _depth(placed: Similarity, lattice: Lattice, bricks: Bricks, sight: Sight, camera: AnyCamera) -> float:
    """Return the least depth of any cell of a brick in sight, less the rounding of a ray."""
    low = bricks.index[sight.meets(bricks)] * float(SIDE)
    if not len(low) or not sight.meets_lattice(lattice):
        return inf
    view, voxel = camera.frame()[0], placed.scale * lattice.spacing
    along = voxel * (placed.rotation.T @ view)  # depth per voxel along the axes of the grid
    origin = (placed.to_world(lattice.origin[None])[0] - np.array(camera.position)) @ view
    nearest = (low @ along).min() + SIDE * np.minimum(along, 0.0).sum()
    return float(origin + nearest - (sight.margin - 1) * voxel)


def levels_of(
    scene: Scene,
    plan: Plan,
    view: View,
    known: Sequence[Ground] | None,
    texture: ImageTexture,
    size: tuple[int, int],
) -> Levels:
    """Return the levels of a texture that is filtered by footprints, of those that its pyramid has.

    Parameters
    ----------
    scene, plan, view
        What is rendered.
    known
        What bounds the footprints on every asset; None where nothing does.
    texture, size
        The texture; width and height of its image, texels.
    """
    last = max(size).bit_length() - 1
    if "rgb" not in plan.outputs:
        return Levels(texture.name, last, last, NO_COLOUR)
    if len(plan.orders) > 1:
        return Levels(texture.name, 0, last, "no bound: mirrors and glass make footprints as small as they like")
    if any(asset.levels for asset in plan.assets):
        return Levels(texture.name, 0, last, "no bound: rays choose levels of grids, whose bricks lie elsewhere")
    if known is None or not isinstance(view, CameraView):
        return Levels(texture.name, 0, last, "no bound: rays are given one by one, or surfaces are no grids as baked")
    named = zip(scene.assets, known, strict=True)
    seen = [ground for asset, ground in named if _has(asset.materials, texture) and ground.depth < inf]
    if not seen:
        return Levels(texture.name, last, last, "no surface that has it is in sight")
    for ground in seen:
        if ground.stretch is None:
            return Levels(texture.name, 0, last, f"no bound: {ground.why}")
    step = min(size) * min(spread(view, ground.depth) * (ground.stretch or 0.0) for ground in seen)
    first = min(max(int(np.floor(max(finest(texture, step), 0.0))), 0), last)
    return Levels(texture.name, first, last, _reason(view, min(ground.depth for ground in seen), step))


def _has(materials: Sequence[object], texture: ImageTexture) -> bool:
    return any(isinstance(material, Diffuse) and material.texture == texture.name for material in materials)


def _reason(view: CameraView, depth: float, step: float) -> str:
    if isinstance(view.camera, OrthographicCamera):
        where = "rays are parallel"
    elif depth > 0:
        where = f"the nearest bricks with surface are {depth:.3g} away"
    else:
        return "no bound: the camera stands among bricks with surface"
    return f"{where}, where a footprint is {step:.2g} texels long or more"


def finest(texture: ImageTexture, step: float) -> float:
    """Return a lower bound of the level of a look-up, not rounded.

    Parameters
    ----------
    texture
        How it is filtered: an ellipse's shorter axis may be as short as `anisotropy` allows.
    step
        Lower bound of the greatest singular value of J, texels.
    """
    if step <= 0:
        return -inf
    if texture.filter == "anisotropic":
        return log2(step / texture.anisotropy) + _ELLIPSE - MARGIN
    return log2(step) + _TRILINEAR - MARGIN


def spread(view: CameraView, depth: float) -> float:
    """Return how far apart rays are, one sample apart, at a depth along the view: the least, world units.

    Away from the axis the angle of a pixel shrinks with the square of the cosine at most, while the way to the same
    depth grows with its inverse.
    """
    _, right, down = (np.linalg.norm(vector) for vector in view.camera.frame())
    if isinstance(view.camera, OrthographicCamera):
        return float(right) * view.step
    width, height = view.size
    return float(right * view.step * max(depth, 0.0) / np.hypot(1.0, np.hypot(right * width, down * height) / 2))
