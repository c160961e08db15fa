"""Meshes whose texture coordinates are hard: cuts, hundreds of charts, poles, triangles without area.

In: nothing. Out: small closed meshes with texture coordinates, exact at their corners.
"""

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic import shape
from sdfbake.mesh import Mesh

MAJOR, MINOR = 0.7, 0.3  # radii of the torus
SPHERE = 0.8  # radius of the sphere with a pole
FEW = 32  # triangles that meet in a pole


def ring(
    around: Float[np.ndarray, " m"],
    across: Float[np.ndarray, " k"],
    u: Float[np.ndarray, " m"],
    v: Float[np.ndarray, " k"],
) -> Mesh:
    """A torus about z as one chart that goes round both ways: its cuts are where the rows close.

    Parameters
    ----------
    around, across
        Ascending angles of the rows, radians, from 0 to 2 pi, both ends given: the last row is the first again.
    u, v
        Texture coordinates of the rows.
    """
    a, b = np.meshgrid(around[:-1], across[:-1], indexing="ij")
    width = MAJOR + MINOR * np.cos(b)
    p = np.stack([width * np.cos(a), width * np.sin(a), MINOR * np.sin(b)], axis=-1).reshape(-1, 3)
    count, rows = len(around) - 1, len(across) - 1
    node = np.stack(np.meshgrid(np.arange(count), np.arange(rows), indexing="ij"), axis=-1).reshape(-1, 1, 1, 2)
    corner = (node + np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])).reshape(-1, 3, 2)
    i, j = corner[..., 0], corner[..., 1]
    return Mesh(p, (i % count) * rows + j % rows, np.stack([u[i], v[j]], axis=-1))


def wrapped() -> Mesh:
    """A torus of one chart, u from 0 to 1 around it and v across."""
    u, v = np.linspace(0.0, 1.0, 73), np.linspace(0.0, 1.0, 33)
    return ring(2 * np.pi * u, 2 * np.pi * v, u, v)


def halved() -> Mesh:
    """The same torus in charts that touch no cut twice: halves around, halves across."""
    mesh = wrapped()
    assert mesh.uv is not None
    u, v = np.moveaxis(mesh.uv.mean(axis=1), 1, 0)
    return mesh.with_(chart=(2 * (u > 0.5) + (v > 0.5)).astype(np.int32))


def slivers() -> Mesh:
    """A torus with bands of triangles that are hardly there, in space, in the texture, and in both.

    Rows 1e-9 apart in space; rows at the same u, or the same v, so that the texture has no area; rows 1e-12 apart in v.
    """
    u, v = np.linspace(0.0, 1.0, 49), np.linspace(0.0, 1.0, 25)
    around, across = 2 * np.pi * u, 2 * np.pi * v
    around[13], across[5] = around[12] + 1e-9, across[4] + 1e-9
    u, v = u.copy(), v.copy()
    u[20:22], v[10:12] = u[20], v[10]  # a line each, and a point where they cross
    v[16] = v[15] + 1e-12
    v[4:6] = v[4]  # nothing in space, nothing in the texture
    return ring(around, across, u, v)


def patchwork(edge: float, seed: int = 5) -> Mesh:
    """A box of which every square of two triangles is a chart of its own, anywhere in the atlas, turned or mirrored."""
    mesh = shape("box").mesh(edge)
    assert mesh.uv is not None
    squares = len(mesh.faces) // 2
    rng = np.random.default_rng(seed)
    uv = mesh.uv.reshape(squares, 6, 2)
    low, high = uv.min(axis=1), uv.max(axis=1)
    side = int(np.ceil(np.sqrt(squares)))
    local = (uv - low[:, None]) / (high - low).max() - 0.5 * ((high - low) / (high - low).max())[:, None]
    turns = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[0, 1], [1, 0]], [[-1, 0], [0, 1]]], float)
    local = np.einsum("sij,scj->sci", turns[rng.integers(4, size=squares)], local)
    cell = rng.permutation(side * side)[:squares]
    middle = np.stack([cell % side, cell // side], axis=-1) + 0.5
    placed = (middle[:, None] + 0.8 * local) / side  # a tenth of a cell free on each side
    return mesh.with_(uv=placed.reshape(-1, 3, 2), chart=np.repeat(np.arange(squares, dtype=np.int32), 2))


def colatitudes() -> Float[np.ndarray, " r"]:
    """Rows of the sphere with a pole, ascending: even, but by factors of 2^(1/4) towards 0, down to 1e-4."""
    fine = 0.1 * 2.0 ** (-np.arange(40, 0, -1) / 4)
    return np.concatenate([fine, np.linspace(0.1, np.pi, 40)[:-1]])


def polar() -> Mesh:
    """A sphere about z with u its longitude and v its latitude, in turns and half turns; rows close in on +z."""
    rows = colatitudes()
    longitude = 2 * np.pi * np.arange(FEW + 1) / FEW
    u, v = np.arange(FEW + 1) / FEW, 1 - rows / np.pi
    theta, phi = np.meshgrid(rows, longitude[:-1], indexing="ij")
    p = SPHERE * np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    vertices = np.concatenate([p.reshape(-1, 3), SPHERE * np.array([[0.0, 0, 1], [0, 0, -1]])])
    k, i = np.meshgrid(np.arange(len(rows) - 1), np.arange(FEW), indexing="ij")
    a, b, c, d = (_node(k + down, i + right) for down, right in ((0, 0), (1, 0), (1, 1), (0, 1)))
    left, right, below = np.stack([k, i], -1), np.stack([k, i + 1], -1), np.array([1, 0])
    corner = np.stack([left, left + below, right + below, left, right + below, right], axis=-2)
    bands = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    placed = np.stack([u[corner[..., 1]], v[corner[..., 0]]], axis=-1).reshape(-1, 3, 2)
    north, south = _cap(len(vertices) - 2, 0, 1.0, v[0]), _cap(len(vertices) - 1, len(rows) - 1, 0.0, v[-1])
    south = south[0][:, [0, 2, 1]], south[1][:, [0, 2, 1]]  # seen from outside the other way round
    faces, uv = (np.concatenate(parts) for parts in zip((bands, placed), north, south, strict=True))
    return Mesh(vertices, faces, uv)


def _cap(
    pole: int, row: int, at_pole: float, at_row: float
) -> tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n 3 2"]]:
    """Triangles between a pole and a row, and their texture coordinates: the pole has another u in each of them."""
    i = np.arange(FEW)
    u, v = np.stack([i + 0.5, i, i + 1], axis=-1) / FEW, np.array([at_pole, at_row, at_row])
    faces = np.stack([np.full(FEW, pole), _node(np.full(FEW, row), i), _node(np.full(FEW, row), i + 1)], axis=-1)
    return faces, np.stack(np.broadcast_arrays(u, v), axis=-1)


def _node(row: Int[np.ndarray, "..."], column: Int[np.ndarray, "..."]) -> Int[np.ndarray, "..."]:
    return np.asarray(row * FEW + column % FEW)
