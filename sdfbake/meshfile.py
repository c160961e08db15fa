"""Meshes on disk.

In: a file of any common format (trimesh reads it), or our own PLY (plyfile: double precision, texture coordinates per
corner, chart and part per face). Out: a welded `Mesh`; and a `Mesh` back as PLY, the same bytes for the same mesh.
"""

import json
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
from jaxtyping import Float, Int

from sdfbake import objfile
from sdfbake.atomic import replacing
from sdfbake.charts import charts_of
from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh

# Names that programs give to texture coordinates per vertex.
_VERTEX_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
# What a path keeps in an ASCII line; the rest, and the percent sign, are escaped as in URLs.
_PRINTABLE = "".join(map(chr, range(33, 127))).replace("%", "") + " "
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
        Vertices with equal bits are one; texture coordinates stay per corner; faces keep their order. `texture` is the
        image of the first part that has one: a path, FILE.glb#image NAME inside a file, or the bare name of one that is
        missing.

    Warns
    -----
    UserWarning
        If the image is missing, or the parts have several.

    Raises
    ------
    BadInput
        If there is no such file, or no triangle in it.
    """
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"there is no mesh file {path}: check the path")
    try:
        mesh, images = {".ply": _load_ply, ".obj": _load_obj}.get(path.suffix.lower(), _load_any)(path)
    except BadInput as complaint:
        raise BadInput(f"{path}: {complaint}") from None
    except Exception as error:  # foreign parsers raise whatever their formats' authors thought of
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise BadInput(f"{path} cannot be read as a mesh ({reason}): give a PLY, OBJ, STL, OFF or glTF file") from None
    if len(mesh.faces) == 0:
        raise BadInput(f"{path} has no triangles: export a surface mesh")
    return mesh.with_(texture=_one_of(images, path)) if images else mesh


def save(mesh: Mesh, path: str | Path) -> None:
    """Write a mesh as binary PLY: double vertices; per face vertex indices, texcoord list, chart and part.

    Units, part names and texture are comments: `units mm`, `part 0 glass`, `texture wood.png`.

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
    comments = [_plain(comment) for comment in comments]
    if mesh.texture is not None:
        comments.append(f"texture {quote(mesh.texture, safe=_PRINTABLE)}")  # a path must come back as it was
    with replacing(path) as temporary:
        PlyData(elements, byte_order="<", comments=comments).write(str(temporary))


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


def _load_ply(path: Path) -> tuple[Mesh, Sequence[str]]:
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
    texture = next((unquote(c[len("texture ") :]) for c in data.comments if c.startswith("texture ")), None)
    # MeshLab's word for it.
    foreign = [comment.split(maxsplit=1)[1:] for comment in data.comments if comment.startswith("TextureFile ")]
    images = [objfile.beside(path, name[0]) for name in foreign if name and texture is None]
    return Mesh(vertices, faces, uv, part_names=parts, units=units, texture=texture, **tables), images


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


def _load_obj(path: Path) -> tuple[Mesh, Sequence[str]]:
    """Read an OBJ."""
    obj = objfile.read(path)
    vertices, place = weld(obj.vertices)
    faces = place[obj.faces]
    chart = np.zeros(len(faces), np.int32) if obj.uv is None else charts_of(faces, obj.uv)
    return Mesh(vertices, faces, obj.uv, chart, obj.part, obj.part_names), objfile.images(path, obj)


def _load_any(path: Path) -> tuple[Mesh, Sequence[str]]:
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
    images = _gltf_images(path) if path.suffix.lower() in (".gltf", ".glb") else ()
    return Mesh(welded, faces, uv, chart, part, names), images


def _gltf_images(path: Path) -> Sequence[str]:
    """Return the image of every used material's base colour, in the order of the file's meshes."""
    with path.open("rb") as file:
        head = file.read(20)  # of a GLB: magic, version, length; length and type of the first chunk, which is the JSON
        binary = head[:4] == b"glTF"
        text = file.read(int.from_bytes(head[12:16], "little")) if binary else head + file.read()
    tree = json.loads(text)
    used = [primitive.get("material") for mesh in tree.get("meshes", ()) for primitive in mesh["primitives"]]
    named = (_gltf_image(path, tree, material) for material in dict.fromkeys(used) if material is not None)
    return [name for name in named if name is not None]


def _gltf_image(path: Path, tree: dict[str, Any], material: int) -> str | None:
    """Return the image of a material's base colour, or None."""
    colour = tree["materials"][material].get("pbrMetallicRoughness", {}).get("baseColorTexture")
    if colour is None:
        return None
    texture = tree["textures"][colour["index"]]
    # Formats that not every program reads, such as WebP, are named by an extension.
    sources = [texture, *texture.get("extensions", {}).values()]
    source = next((entry["source"] for entry in sources if "source" in entry), None)
    if source is None:
        return None
    image = tree["images"][source]
    if "uri" in image and not image["uri"].startswith("data:"):
        return objfile.beside(path, unquote(image["uri"]))
    return f"{path}#image {image.get('name') or source}"


def _one_of(images: Sequence[str], path: Path) -> str:
    """Return the first image, an existing one if possible, and warn of what that leaves out."""
    names = tuple(dict.fromkeys(images))
    there = [name for name in names if Path(name.partition("#image ")[0]).is_file()]
    chosen = (there or names)[0]
    if not there:
        warnings.warn(f"{path} names the texture {chosen}, which is missing: put it there", UserWarning, stacklevel=3)
    if len(names) > 1:
        others = ", ".join(name for name in names if name != chosen)
        warnings.warn(f"{path} has several textures: {chosen} is recorded, not {others}", UserWarning, stacklevel=3)
    return chosen


def _moved(vertices: np.ndarray, matrix: np.ndarray) -> Float[np.ndarray, "v 3"]:
    """Return points under an affine map; the same bits where the map is the identity."""
    p = np.asarray(vertices, np.float64)
    return p if np.array_equal(matrix, np.eye(4)) else p @ matrix[:3, :3].T + matrix[:3, 3]


def _plain(text: str) -> str:
    """Return one line of ASCII: all that a PLY header may hold."""
    return re.sub(r"\s+", " ", text).encode("ascii", "replace").decode()
