"""Meshes that are hard on a baker, and oracles that share no code with it."""

from typing import NamedTuple

import igl
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from sdfbake import Mesh
from sdfbake.bricks import SIDE, in_lattice, sample_index

TURN = Rotation.from_euler("xyz", (0.3, 0.5, 0.7)).as_matrix()
EPS = 2.0**-53


def named(vertices, faces):
    """A mesh with texture coordinates, so that a bake stores the faces."""
    return Mesh(vertices, faces, np.zeros((len(faces), 3, 2)))


def ball(subdivisions=2, *, centre=(0.0, 0, 0), radius=1.0, inward=False):
    shape = trimesh.creation.icosphere(subdivisions)
    return named(np.asarray(shape.vertices) * radius + centre, shape.faces[:, ::-1] if inward else shape.faces)


def joined(*meshes):
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return named(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def box(*extents, turned=False):
    shape = trimesh.creation.box(extents)
    return named(np.asarray(shape.vertices) @ (TURN.T if turned else np.eye(3)), shape.faces)


def sliver(sides=4, aspect=1000.0):
    """A prism as long as so many of its edges: faces that are all edge."""
    edge = 1 / aspect
    shape = trimesh.creation.cylinder(edge / (2 * np.sin(np.pi / sides)), 1.0, sides)
    return named(np.asarray(shape.vertices) @ TURN.T, shape.faces)


def flattened(by=1000.0):
    shape = ball(1)
    return named(shape.vertices * [1, 1, 1 / by] @ TURN.T, shape.faces)


def dirty():
    """A ball with faces of no area first, and some faces twice: again, turned, and before the one that it repeats."""
    clean = ball(1)
    a, b, c = clean.faces[0]
    empty = [[a, b, a], [c, c, c]]
    again = clean.faces[[5, 7, 11]]
    return named(clean.vertices, np.concatenate([empty, again[:2], clean.faces, np.roll(again, 1, axis=1)]))


def nested():
    """A ball with a cavity."""
    return joined(ball(1), ball(1, radius=0.4, inward=True))


def soup(count=60, seed=7):
    """Triangles that cross, and enclose nothing."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * 0.5
    return named(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def capless(subdivisions=3, height=0.5):
    """A unit ball without the faces whose corners all lie above a height: a hole with a ragged rim about z."""
    whole = ball(subdivisions)
    kept = (whole.vertices[whole.faces][..., 2] <= height).any(axis=1)
    return named(whole.vertices, whole.faces[kept])


def every_distance(mesh, points):
    """Return every face's distance from every point (n, f), float64.

    Every face in the frame of a QR factorisation of its edges: the distance of the projection from a plane triangle,
    and the height. Householder's frame is orthonormal to rounding even for slivers and faces without area.
    """
    middle = mesh.bounds.mean(axis=0)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces] - middle, 1, 0)
    frame, sides = np.linalg.qr(np.stack([b - a, c - a], axis=-1), mode="complete")
    x, y, z = ((points - middle) @ frame[:, :, k].T - np.einsum("fd,fd->f", a, frame[:, :, k])[None] for k in range(3))
    bx, cx, cy = sides[:, 0, 0], sides[:, 0, 1], sides[:, 1, 1]
    corners = [(0 * bx, 0 * bx), (bx, 0 * bx), (cx, cy)]
    square, inside = np.full(x.shape, np.inf), np.full(x.shape, True)
    for (px, py), (qx, qy) in zip(corners, corners[1:] + corners[:1], strict=True):
        ux, uy = qx - px, qy - py
        length = ux * ux + uy * uy
        wx, wy = x - px, y - py
        t = np.clip((wx * ux + wy * uy) / np.where(length > 0, length, 1), 0, 1)
        square = np.minimum(square, (wx - t * ux) ** 2 + (wy - t * uy) ** 2)
        inside &= (ux * wy - uy * wx) * (bx * cy) > 0
    return np.sqrt(np.where(inside, 0, square) + z * z)


def in_pieces(function, points, size=2000):
    return np.concatenate([function(points[start : start + size]) for start in range(0, max(len(points), 1), size)])


def winding(mesh, points):
    """Return exact winding numbers, face by face."""
    return np.asarray(igl.winding_number(mesh.vertices, mesh.faces, np.ascontiguousarray(points)))


class Samples(NamedTuple):
    """All samples of a grid's lattice, as lists."""

    points: np.ndarray
    distance: np.ndarray
    face: np.ndarray
    present: np.ndarray


def spread(grid):
    """List every sample of a grid's lattice in C order: position, distance, face (-1), whether its brick is there."""
    shape = grid.lattice.shape
    inside = in_lattice(grid.bricks.index, shape)
    at = tuple(sample_index(grid.bricks.index)[inside].T)
    distance, face, present = np.full(shape, np.nan), np.full(shape, -1), np.zeros(shape, bool)
    distance[at], present[at] = grid.distance[inside], True
    if grid.face is not None:
        face[at] = grid.face[inside]
    points = grid.lattice.to_world(np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3))
    return Samples(points, distance.ravel(), face.ravel(), present.ravel())


def rounding(mesh, lattice):
    """Return what float64 makes of positions, world units.

    A vertex is rounded in the surface's frame, back, from the lattice's origin and by its spacing; a sample twice on
    its way to the oracle's frame: six times half an eps of the largest coordinate, along three axes, and as much again
    for the arithmetic of either distance. Faces that are thin lose as many digits in the foot as they are thin; those
    move it along the face only, so that the distance feels them where it is as small itself.
    """
    largest = max(np.abs(mesh.bounds).max(), np.abs(lattice.bounds).max())
    return 2 * 6 * 3**0.5 * EPS * largest


def points_between(grid, rng, count=8):
    """Return points of absent bricks' closed cubes of cells, corners and gaps included, and the bounds there."""
    absent = np.argwhere(grid.bricks.slot < 0)
    within = np.concatenate(
        [
            rng.uniform(0, SIDE, (count, 3)),
            rng.uniform(SIDE - 1, SIDE, (count, 3)),
            np.indices((2, 2, 2)).reshape(3, -1).T * SIDE,
        ]
    )
    p_grid = np.minimum(absent[:, None] * SIDE + within, np.array(grid.lattice.shape) - 1)
    bound = np.broadcast_to(grid.bricks.far[tuple(absent.T)].astype(float)[:, None], p_grid.shape[:2])
    return grid.lattice.to_world(p_grid).reshape(-1, 3), bound.ravel()
