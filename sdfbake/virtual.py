"""Virtual charts: pieces of the charts of an atlas that are single-valued within every cell.

In: a mesh, the charts that fold over within a cell. Out: a piece per face. A chart of which two sheets pass through one
cell is cut by the six directions its normals may mostly have; one that meets itself along a cut of the atlas, as the
side of a cylinder does, is halved in texture space until the two sides of the cut are apart.
"""

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from sdfbake.mesh import Mesh
from sdfbake.topology import Topology

_HALVINGS = 4  # of a chart that meets itself; what is left are the ends of darts, where the cut has just opened


def split(
    mesh: Mesh, normals: Float[np.ndarray, "f 3"], folds: Bool[np.ndarray, " charts"]
) -> tuple[Int[np.ndarray, " f"], Int[np.ndarray, " c"]]:
    """Cut the charts that need it.

    Parameters
    ----------
    mesh
        With texture coordinates.
    normals
        Of the faces; zero where a face has none.
    folds
        Which charts fold over within a cell; see `folded`.

    Returns
    -------
    piece, of
        Virtual chart of every face, int32, ascending with the chart it is of; and that chart, int32.
    """
    chart = mesh.chart.astype(np.int64)
    piece = _dense(np.where(folds[chart], 6 * chart + _direction(normals), 6 * chart))
    left, right = _torn(mesh)
    centre = np.zeros((0, 2)) if mesh.uv is None else mesh.uv.mean(axis=1)
    for _ in range(_HALVINGS):
        meets = np.zeros(piece.max(initial=-1) + 1, bool)
        meets[piece[left][piece[left] == piece[right]]] = True
        if not meets.any():
            break
        piece = _dense(2 * piece + (meets[piece] & _upper_half(piece, centre)))
    of = np.zeros(piece.max(initial=-1) + 1, np.int32)
    of[piece] = mesh.chart
    return piece.astype(np.int32), of


def folded(
    normals: Float[np.ndarray, "f 3"],
    chart: Int[np.ndarray, " f"],
    corners: Int[np.ndarray, "8 n"],
    charts: int,
) -> Bool[np.ndarray, " charts"]:
    """Say which charts fold over within a cell: opposite corners of it are closest to faces that look apart.

    Where the middle between two sheets passes through a cell, it parts some corner from the opposite one. (If it parted
    none of the four pairs, the centre would be on both sides of it.) Sheets so near that no such corner exists in the
    whole grid are thinner than what a grid can show.

    Parameters
    ----------
    normals, chart
        Of the faces.
    corners
        Closest faces of the corners of some cells, in C order.
    charts
        How many charts there are.
    """
    folds = np.zeros(charts, bool)
    for k in range(4):
        one, other = corners[k], corners[7 - k]
        apart = np.einsum("nd,nd->n", normals[one], normals[other]) < 0
        folds[chart[one[apart & (chart[one] == chart[other])]]] = True
    return folds


def bent(normals: Float[np.ndarray, "f 3"], chart: Int[np.ndarray, " f"], charts: int) -> Bool[np.ndarray, " charts"]:
    """Say which charts can fold at all: some normal is more than 45 degrees off their mean (else all agree)."""
    mean = np.stack([np.bincount(chart, normals[:, axis], charts) for axis in range(3)], axis=-1)
    length = np.linalg.norm(mean, axis=-1)
    there = np.linalg.norm(normals, axis=-1) > 0
    off = there & (np.einsum("nd,nd->n", normals, mean[chart]) <= np.sqrt(0.5) * length[chart])
    return np.bincount(chart[off], minlength=charts) > 0


def direction_bits(normals: Float[np.ndarray, "f 3"]) -> UInt8[np.ndarray, " f"]:
    """Return one bit for the direction every normal is closest to; none where there is no normal."""
    bits = np.uint8(1) << _direction(normals).astype(np.uint8)
    return np.where((normals != 0).any(axis=1), bits, 0).astype(np.uint8)


def _direction(normals: Float[np.ndarray, "f 3"]) -> Int[np.ndarray, " f"]:
    """Return which of +x, -x, +y, -y, +z, -z every normal is closest to, 0 to 5; on a tie the first."""
    axis = np.abs(normals).argmax(axis=1)
    direction: Int[np.ndarray, " f"] = 2 * axis + (np.take_along_axis(normals, axis[:, None], 1)[:, 0] < 0)
    return direction


def _torn(mesh: Mesh) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Return pairs of faces of one chart that share an edge of the surface and not its texture coordinates."""
    if mesh.uv is None:
        raise ValueError("virtual charts need texture coordinates")
    topology = Topology.of(mesh.faces)
    forward = topology.forward[..., None]
    start, end = mesh.uv, np.roll(mesh.uv, -1, axis=1)
    ends = np.concatenate([np.where(forward, start, end), np.where(forward, end, start)], axis=-1).reshape(-1, 4)
    order = np.argsort(topology.edge.reshape(-1), kind="stable")
    edge, ends, face = topology.edge.reshape(-1)[order], ends[order], order // 3
    torn = (edge[1:] == edge[:-1]) & (ends[1:] != ends[:-1]).any(axis=1)
    torn &= (mesh.chart[face[1:]] == mesh.chart[face[:-1]]) & (face[1:] != face[:-1])
    return face[:-1][torn], face[1:][torn]


def _upper_half(piece: Int[np.ndarray, " f"], centre: Float[np.ndarray, "f 2"]) -> Bool[np.ndarray, " f"]:
    """Say which faces lie beyond the middle of their piece, along its longer side in texture space."""
    low = np.full((piece.max() + 1, 2), np.inf)
    high = -low
    np.minimum.at(low, piece, centre)
    np.maximum.at(high, piece, centre)
    axis = (high - low).argmax(axis=1)
    middle = np.take_along_axis((low + high) / 2, axis[:, None], axis=1)[:, 0]
    beyond: Bool[np.ndarray, " f"] = np.take_along_axis(centre, axis[piece][:, None], axis=1)[:, 0] > middle[piece]
    return beyond


def _dense(key: Int[np.ndarray, " f"]) -> Int[np.ndarray, " f"]:
    """Number keys from 0 in their order."""
    number: Int[np.ndarray, " f"] = np.unique(key, return_inverse=True)[1].reshape(-1)
    return number
