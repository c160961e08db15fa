"""Finer meshes on the smooth surface that coarse facets stand for: least squares subdivision, with pymeshlab.

In: a mesh and the edge length wanted. Out: `Refined`: every face cut into four, as often as it takes, with the vertices
moved by LS3 (Boye, Guennebaud and Schlick 2010: Loop's weights, projected to the sphere that fits positions and normals
best). Connectivity, origin of faces and creases are kept here; pymeshlab is asked for positions only.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake.complaint import BadInput
from sdfbake.diagnosis import proper
from sdfbake.mesh import Mesh
from sdfbake.topology import Topology

Progress = Callable[[str, float], None]
# Radians. A surface that bends by this much from face to face leaves them by an eighth of it: 1e-5 of an edge.
_FLAT = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A subdivided mesh whose faces and corners know where they came from.

    Attributes
    ----------
    mesh
        Vertices moved, the original ones first; texture coordinates, chart and part are those of the original faces.
    parent
        Face of the original mesh that every face is a piece of, int64.
    place
        Barycentric coordinates in the parent of every corner; multiples of 2^-iterations, hence exact.
    iterations
        How often every face was cut into four.
    put_back
        How many vertices LS3 moved farther than half an edge, so that they were left where they had been.
    """

    mesh: Mesh
    parent: Int[np.ndarray, " g"]
    place: Float[np.ndarray, "g 3 3"]
    iterations: int
    put_back: int

    def original(
        self, face: Int[np.ndarray, " n"], barycentric: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Return where points of the refined mesh lie in the original one.

        Parameters
        ----------
        face, barycentric
            Faces of the refined mesh, and the weights of their corners.

        Returns
        -------
        face, barycentric
            Faces of the original mesh, and the weights of their corners.
        """
        return self.parent[face], np.einsum("nk,nkj->nj", barycentric, self.place[face])


class _Level(NamedTuple):
    """A mesh between two subdivisions (v vertices in world units, f faces; side k runs from corner k to k + 1)."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    sharp: Bool[np.ndarray, "f 3"]  # sides that are creases
    bent: Bool[np.ndarray, "f 3"]  # sides where the surface bends without a crease
    parent: Int[np.ndarray, " f"]
    place: Float[np.ndarray, "f 3 3"]


def ls3(
    mesh: Mesh,
    longest: float,
    *,
    crease: float = 40.0,
    most_faces: int = 4_000_000,
    progress: Progress | None = None,
) -> Refined:
    """Subdivide a mesh until the edges where it bends are short, and move it to the smooth surface it stands for.

    Parameters
    ----------
    mesh
        Without degenerate faces. Edges with one face, with more than two, or with faces of opposite orientation stay
        as they are, as creases do.
    longest
        Length, in the mesh's units, that half of the edges shall not exceed. The median is what `bake` reports, and a
        higher quantile would let a few slivers multiply all faces by four. Creases and edges between coplanar faces
        do not count: there is nothing to gain there.
    crease
        Degrees between the normals of two faces beyond which their edge stays sharp.
    most_faces
        Largest mesh that may come out.
    progress
        Called with a stage and the share of it that is done, 0 to 1.

    Returns
    -------
    Refined
        With the very same mesh if its edges are short enough. A closed mesh stays closed; coplanar faces are cut, but
        not moved.

    Raises
    ------
    BadInput
        If the mesh would have more than `most_faces` faces, has degenerate faces, or an option makes no sense.

    Examples
    --------
    >>> refined = ls3(Mesh.load("bunny.obj"), 0.01)  # doctest: +SKIP
    """
    _check(mesh, longest, crease)
    level, iterations, put_back = _start(mesh, crease), 0, 0
    while (levels := _levels(level, longest)) > 0:
        faces = len(level.faces) * 4**levels
        if faces > most_faces:
            raise BadInput(
                f"smoothing down to edges of {longest:.4g} takes {faces:,} faces, more than {most_faces:,}: bake at a"
                " coarser resolution, or with --smooth none"
            )
        if progress:
            progress("smooth", iterations / (iterations + levels))
        level, back = _subdivided(level)
        iterations, put_back = iterations + 1, put_back + back
    if progress and iterations:
        progress("smooth", 1.0)
    return Refined(_mesh(mesh, level) if iterations else mesh, level.parent, level.place, iterations, put_back)


def _check(mesh: Mesh, longest: float, crease: float) -> None:
    """Refuse what cannot be worked on."""
    if not 0 < longest < np.inf:
        raise BadInput(f"the edge length wanted is {longest}: give a positive number")
    if not 0 <= crease <= 180:
        raise BadInput(f"the crease angle is {crease}: give degrees from 0 to 180")
    if not np.isfinite(mesh.vertices).all() or len(proper(mesh.faces)) < len(mesh.faces):
        raise BadInput("the mesh has degenerate faces or vertices that are not finite: repair it before smoothing")


def _start(mesh: Mesh, crease: float) -> _Level:
    """Find creases and bends of the original mesh; subdivision inherits them, since its own angles say less."""
    topology = Topology.of(mesh.faces)
    smooth = topology.faces_per_edge == 2
    smooth[topology.flipped_edges] = False
    p = mesh.vertices[mesh.faces]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= max(float(np.abs(normal).max(initial=0)), 1e-300)
    order = np.argsort(topology.edge.reshape(-1), kind="stable")
    first = (np.cumsum(topology.faces_per_edge) - topology.faces_per_edge)[smooth]
    one, other = normal[order[first] // 3], normal[order[first + 1] // 3]
    # Needs no unit normals: a face without area bends nowhere.
    angle = np.zeros(len(smooth))
    angle[smooth] = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1))
    smooth &= angle <= np.radians(crease)
    sharp, bent = ~smooth[topology.edge], (smooth & (angle > _FLAT))[topology.edge]
    count = len(mesh.faces)
    return _Level(mesh.vertices, mesh.faces, sharp, bent, np.arange(count), np.tile(np.eye(3), (count, 1, 1)))


def _levels(level: _Level, longest: float) -> int:
    """Return how many subdivisions bring the median length of bent edges down to `longest`."""
    start, end = level.faces[level.bent], np.roll(level.faces, -1, axis=1)[level.bent]
    if len(start) == 0:
        return 0
    # Every bent edge has two sides here: the median is that of the edges.
    median = float(np.median(np.linalg.norm(level.vertices[start] - level.vertices[end], axis=1)))
    return 0 if median <= longest else int(np.ceil(np.log2(median) - np.log2(longest)))


def _subdivided(level: _Level) -> tuple[_Level, int]:
    """Cut every face into four and move the vertices; also return how many were put back."""
    topology = Topology.of(level.faces)
    owner, cut = _fans(level, topology)
    even, odd = _positions(level.vertices[owner], cut)

    ends = level.vertices[topology.edges]
    still = np.concatenate([level.vertices, ends.mean(axis=1)])
    moved = still.copy()
    moved[owner] = even
    moved[len(level.vertices) + topology.edge] = odd
    free, faces_bent = _free(level, topology, owner, cut)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    far = free & ~(np.linalg.norm(moved - still, axis=1) <= _reach(level, topology, length))  # not finite is far too
    vertices = np.where((free & ~far)[:, None], moved, still)

    middle = len(level.vertices) + topology.edge
    inside = np.repeat(faces_bent[:, None], 3, axis=1)
    middles = (level.place + np.roll(level.place, -1, axis=1)) / 2
    refined = _Level(
        vertices,
        _quartered(level.faces, middle),
        _quartered_sides(level.sharp, np.zeros_like(inside)),
        _quartered_sides(level.bent, inside),
        np.repeat(level.parent, 4),
        _quartered(level.place, middles),
    )
    return refined, int(far.sum())


def _fans(level: _Level, topology: Topology) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, "f 3"]]:
    """Cut the mesh along its creases: return the vertex that every new vertex is a copy of, and the new faces.

    The vertices of the cut mesh are the fans of corners that hang together across edges that are no creases.
    """
    from scipy.sparse import coo_array  # here, so that `import sdfbake` is light
    from scipy.sparse.csgraph import connected_components

    count = level.faces.size
    corner = np.arange(count).reshape(-1, 3)
    ends = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1)
    ends = np.where(topology.forward[..., None], ends, ends[..., ::-1])[~level.sharp].reshape(-1)
    # Both faces of an edge see the same two vertices there: one meeting point for each.
    meeting = (count + 2 * topology.edge[..., None] + np.arange(2))[~level.sharp].reshape(-1)
    nodes = count + 2 * len(topology.edges)
    links = coo_array((np.ones(len(ends), np.int8), (ends, meeting)), shape=(nodes, nodes))
    fan = connected_components(links, directed=False)[1][:count]
    _, first, cut = np.unique(fan, return_index=True, return_inverse=True)
    return level.faces.reshape(-1)[first], cut.reshape(-1, 3)


def _positions(
    vertices: Float[np.ndarray, "c 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, "f 3 3"]]:
    """Return where LS3 puts the vertices, and the middles of every face's sides."""
    import pymeshlab

    low, high = vertices.min(axis=0), vertices.max(axis=0)
    # Far from the origin curvatures drown in rounding, and pymeshlab compares them with a constant.
    centre, scale = (low + high) / 2, max(float((high - low).max()) / 2, 1e-300)
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=(vertices - centre) / scale, face_matrix=faces))
    every = pymeshlab.PercentageValue(0)  # threshold below which an edge would not be cut
    try:
        meshes.apply_filter("meshing_surface_subdivision_ls3_loop", iterations=1, threshold=every)
    except pymeshlab.PyMeshLabException as error:
        raise BadInput(f"the mesh cannot be smoothed ({error}): repair it, or use --smooth none") from None
    made = meshes.current_mesh()
    cut, p = np.asarray(made.face_matrix(), np.int64), made.vertex_matrix() * scale + centre
    # The middle child takes its parent's place and names the middles of sides 0, 1, 2; then come the corners' children.
    if len(cut) != 4 * len(faces):
        raise BadInput("the mesh cannot be smoothed, as it has edges without length: repair it, or use --smooth none")
    middle, corners = cut[: len(faces)], cut[len(faces) :].reshape(-1, 3, 3)
    if not np.array_equal(np.diagonal(corners, axis1=1, axis2=2), faces):
        raise RuntimeError("pymeshlab changed the order of the subdivided faces")
    return p[: len(vertices)], p[middle]


def _free(
    level: _Level, topology: Topology, owner: Int[np.ndarray, " c"], cut: Int[np.ndarray, "f 3"]
) -> tuple[Bool[np.ndarray, " w"], Bool[np.ndarray, " f"]]:
    """Say which vertices (old ones, then middles of edges) may move, and which faces have a bend at a corner.

    Creases stay, and so does what is flat all around: moved within its plane, it would only drag the texture along.
    """
    bent = np.zeros(len(owner), bool)
    bent[cut[level.bent]] = True
    bent[np.roll(cut, -1, axis=1)[level.bent]] = True
    faces_bent: Bool[np.ndarray, " f"] = bent[cut].any(axis=1)

    even = np.zeros(len(level.vertices), bool)
    even[owner[bent]] = True
    even &= np.bincount(owner, minlength=len(even)) == 1  # where fans only touch, they must go on touching
    odd = np.zeros(len(topology.edges), bool)
    odd[topology.edge[faces_bent]] = True
    odd[topology.edge[level.sharp]] = False
    even[level.faces[level.sharp]] = False
    even[np.roll(level.faces, -1, axis=1)[level.sharp]] = False
    return np.concatenate([even, odd]), faces_bent


def _reach(level: _Level, topology: Topology, length: Float[np.ndarray, " e"]) -> Float[np.ndarray, " w"]:
    """Return how far vertices may move: half the mean of their edges, or half of the edge they are the middle of."""
    ends, count = topology.edges.reshape(-1), len(level.vertices)
    total = np.bincount(ends, np.repeat(length, 2), count)
    return np.concatenate([total / np.maximum(np.bincount(ends, minlength=count), 1), length]) / 2


def _quartered(corner: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return the corners (4 f, 3, ...) of the children: at corners 0, 1, 2, and in the middle.

    Middle k lies on side k, from corner k to corner k + 1.
    """
    at_corners = np.stack([corner, middle, np.roll(middle, 1, axis=1)], axis=2)
    children = np.concatenate([at_corners, middle[:, None]], axis=1)
    return children.reshape(-1, *children.shape[2:])


def _quartered_sides(side: Bool[np.ndarray, "f 3"], inside: Bool[np.ndarray, "f 3"]) -> Bool[np.ndarray, "g 3"]:
    """Return the sides of the children; halves of sides inherit, sides inside the parent are given."""
    at_corners = np.stack([side, inside, np.roll(side, 1, axis=1)], axis=2)
    return np.concatenate([at_corners, inside[:, None]], axis=1).reshape(-1, 3)


def _mesh(mesh: Mesh, level: _Level) -> Mesh:
    """Return the refined mesh with what its faces inherit."""
    parent = level.parent
    uv = None if mesh.uv is None else np.einsum("gkj,gjc->gkc", level.place, mesh.uv[parent])
    inherited = {"chart": mesh.chart[parent], "part": mesh.part[parent]}
    return mesh.with_(vertices=level.vertices, faces=level.faces, uv=uv, **inherited)
