"""Meshes on disk.

In: a file of any common format (trimesh reads it), or our own PLY (plyfile: double precision, texture coordinates per
corner, chart and part per face). Out: a welded `Mesh`; and a `Mesh` back as PLY, the same bytes for the same mesh.
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from sdfbake import objfile
from sdfbake.atomic import replacing
from sdfbake.charts import charts_of
from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh

# Names that programs give to texture coordinates per vertex.
_VERTEX_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_FACE = [("vertex_indices", "<i4", (3,)), ("texcoord", "<f8", (6,)), ("chart", "<i4"), ("part", "<i4")]


def load(path: str | Path) -> Mesh:
    """Read a mesh.

    Parameters
    ----------
    path
        PLY, OBJ, STL, OFF, glTF and what else trimesh reads. Parts are the materials, groups or geometries of the file.

    Returns
    -------
    Mesh
        Vertices with equal bits are one; texture coordinates stay per corner; faces keep their order.

    Raises
    ------
    BadInput
        If there is no such file, or no triangle in it.
    """
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"there is no mesh file {path}: check the path")
    try:
        mesh = {".ply": _load_ply, ".obj": _load_obj}.get(path.suffix.lower(), _load_any)(path)
    except BadInput as complaint:
        raise BadInput(f"{path}: {complaint}") from None
    except Exception as error:  # foreign parsers raise whatever their formats' authors thought of
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise BadInput(f"{path} cannot be read as a mesh ({reason}): give a PLY, OBJ, STL, OFF or glTF file") from None
    if len(mesh.faces) == 0:
        raise BadInput(f"{path} has no triangles: export a surface mesh")
    return mesh


def save(mesh: Mesh, path: str | Path) -> None:
    """Write a mesh as binary PLY: double vertices; per face vertex indices, texcoord list, chart and part.

    Raises
    ------
    BadInput
        If the file cannot be written, or is not named .ply.
    """
    from plyfile import PlyData, PlyElement

    if Path(path).suffix.lower() != ".ply":
        raise BadInput(f"meshes are written as PLY, not as {Path(path).name}: give a name that ends in .ply")
    vertex = np.ascontiguousarray(mesh.vertices, "<f8").view([(axis, "<f8") for axis in "xyz"]).reshape(-1)
    face = np.zeros(len(mesh.faces), [column for column in _FACE if mesh.uv is not None or column[0] != "texcoord"])
    face["vertex_indices"], face["chart"], face["part"] = mesh.faces, mesh.chart, mesh.part
    if mesh.uv is not None:
        face["texcoord"] = mesh.uv.reshape(-1, 6)
    lengths = {name: "u1" for name, *_ in _FACE[:2]}
    elements = [PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face", len_types=lengths)]
    comments = [f"units {mesh.units}", *(f"part {i} {name}" for i, name in enumerate(mesh.part_names))]
    with replacing(path) as temporary:
        PlyData(elements, byte_order="<", comments=[_plain(comment) for comment in comments]).write(str(temporary))


def weld(vertices: Float[np.ndarray, "v 3"]) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, " v"]]:
    """Return the different positions, in order of first appearance, and the place of every vertex among them."""
    bits = (np.asarray(vertices, np.float64) + 0.0).view(np.int64)  # + 0.0 turns -0.0 into 0.0
    order = np.lexsort(bits.T)
    fresh = np.ones(len(bits), bool)
    fresh[1:] = (bits[order][1:] != bits[order][:-1]).any(axis=1)
    group = np.empty(len(bits), np.int64)
    group[order] = np.cumsum(fresh) - 1
    first = order[fresh]  # lexsort is stable, so this is the first vertex of its group
    rank = np.argsort(np.argsort(first))
    return vertices[np.sort(first)], rank[group]


def _load_ply(path: Path) -> Mesh:
    """Read a PLY, ours or foreign."""
    from plyfile import PlyData, PlyElementParseError, PlyHeaderParseError

    try:  # the lists of our own files have known lengths, which makes reading a hundred times faster
        data = PlyData.read(str(path), known_list_len={"face": {"vertex_indices": 3, "texcoord": 6}})
    except (PlyElementParseError, PlyHeaderParseError, ValueError, KeyError):
        data = PlyData.read(str(path))
    names = {element.name for element in data.elements}
    if not {"vertex", "face"} <= names or len(data["face"].data) == 0:
        raise BadInput("the PLY has no triangles: export a surface mesh")
    vertex, face = data["vertex"].data, data["face"].data
    lists = "vertex_indices" if "vertex_indices" in face.dtype.names else "vertex_index"
    corners, parent = _fans(face[lists])
    p = np.stack([vertex[axis] for axis in "xyz"], axis=-1).astype(np.float64)
    uv = _ply_uv(vertex, face, corners, parent)
    tables = {name: face[name][parent].astype(np.int32) for name in ("chart", "part") if name in face.dtype.names}
    vertices, place = weld(p)
    faces = place[corners]
    if uv is not None and "chart" not in tables:
        tables["chart"] = charts_of(faces, uv)
    comments = [comment.split(maxsplit=2) for comment in data.comments]
    named = {int(c[1]): c[2] for c in comments if len(c) == 3 and c[0] == "part" and c[1].isdigit()}
    highest = int(tables["part"].max(initial=0)) if "part" in tables else 0
    parts = tuple(named.get(i, f"part {i}") for i in range(max(highest, *named, 0) + 1)) if named else ("surface",)
    units = next((c[1] for c in comments if len(c) == 2 and c[0] == "units"), "unit")
    if len(parts) <= highest:
        parts = tuple(f"part {i}" for i in range(highest + 1))
    return Mesh(vertices, faces, uv, part_names=parts, units=units, **tables)


def _fans(lists: np.ndarray) -> tuple[Int[np.ndarray, "f 3"], Int[np.ndarray, " f"]]:
    """Cut polygons into triangles around their first corners; also return the polygon of every triangle."""
    if lists.dtype != object:
        return lists.astype(np.int64).reshape(len(lists), -1), np.arange(len(lists))
    length = np.array([len(polygon) for polygon in lists])
    parent = np.repeat(np.arange(len(lists)), np.maximum(length - 2, 0))
    start = np.concatenate([[0], np.cumsum(length)])[parent]
    step = np.arange(len(parent)) - np.searchsorted(parent, parent) + 1
    flat = np.concatenate(lists).astype(np.int64)
    return np.stack([flat[start], flat[start + step], flat[start + step + 1]], axis=-1), parent


def _ply_uv(vertex: np.ndarray, face: np.ndarray, corners: np.ndarray, parent: np.ndarray) -> np.ndarray | None:
    """Return texture coordinates per corner, from wedges or from vertices, or None."""
    if "texcoord" in (face.dtype.names or ()) and len(parent) == len(face):
        wedge = face["texcoord"]
        if wedge.dtype != object or all(len(row) == 6 for row in wedge):
            wedges: np.ndarray = np.stack(list(wedge)).astype(np.float64).reshape(-1, 3, 2)
            return wedges
    for pair in _VERTEX_UV:
        if set(pair) <= set(vertex.dtype.names or ()):
            uv: np.ndarray = np.stack([vertex[name] for name in pair], axis=-1).astype(np.float64)[corners]
            return uv
    return None


def _load_obj(path: Path) -> Mesh:
    """Read an OBJ."""
    obj = objfile.read(path)
    vertices, place = weld(obj.vertices)
    faces = place[obj.faces]
    chart = np.zeros(len(faces), np.int32) if obj.uv is None else charts_of(faces, obj.uv)
    return Mesh(vertices, faces, obj.uv, chart, obj.part, obj.part_names)


def _load_any(path: Path) -> Mesh:
    """Read what trimesh reads, one part per geometry of the scene."""
    import trimesh

    scene = trimesh.load_scene(str(path), process=False, maintain_order=True)
    pieces = [(name, scene.geometry[name], matrix) for matrix, name in map(scene.graph.get, scene.graph.nodes_geometry)]
    pieces = [piece for piece in pieces if isinstance(piece[1], trimesh.Trimesh) and len(piece[1].faces)]
    if not pieces:
        raise BadInput("the file has no triangles: export a surface mesh")
    vertices = [_moved(geometry.vertices, matrix) for _, geometry, matrix in pieces]
    offsets = np.cumsum([0, *map(len, vertices)])
    corners = np.concatenate([g.faces + offset for (_, g, _), offset in zip(pieces, offsets, strict=False)])
    part = np.repeat(np.arange(len(pieces)), [len(g.faces) for _, g, _ in pieces])
    coordinates = [np.asarray(getattr(g.visual, "uv", None)) for _, g, _ in pieces]
    welded, place = weld(np.concatenate(vertices))
    faces, uv, chart = place[corners], None, np.zeros(len(corners), np.int32)
    if all(c.shape == (len(v), 2) for c, v in zip(coordinates, vertices, strict=True)):
        uv = np.concatenate(coordinates).astype(np.float64)[corners]
        chart = charts_of(faces, uv)
    names = tuple(name for name, _, _ in pieces) if len(pieces) > 1 else ("surface",)
    return Mesh(welded, faces, uv, chart, part, names)


def _moved(vertices: np.ndarray, matrix: np.ndarray) -> Float[np.ndarray, "v 3"]:
    """Return points under an affine map; the same bits where the map is the identity."""
    p = np.asarray(vertices, np.float64)
    return p if np.array_equal(matrix, np.eye(4)) else p @ matrix[:3, :3].T + matrix[:3, 3]


def _plain(text: str) -> str:
    """Return one line of ASCII: all that a PLY header may hold."""
    return re.sub(r"\s+", " ", text).encode("ascii", "replace").decode()
