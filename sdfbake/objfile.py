"""Wavefront OBJ as it is written: positions and texture coordinates with indices of their own.

In: a file. Out: its arrays, polygons cut into fans, a part name per triangle, and the images that its materials name.
(trimesh 5 merges the two kinds of indices, and fails on files that count backwards from the last vertex.)
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from sdfbake.complaint import BadInput

# Options of a texture map in an MTL file, with what follows them: up to three numbers, two words or one.
_OPTION = re.compile(
    r"-(?:[ost]\s+(?:[-+]?[\d.]+(?:e[-+]?\d+)?\s+){1,3}|mm\s+\S+\s+\S+\s+"
    r"|(?:blendu|blendv|boost|bm|cc|clamp|colorspace|imfchan|texres|type)\s+\S+\s+)",
    re.IGNORECASE,
)


class Obj(NamedTuple):
    """What an OBJ file holds.

    Attributes
    ----------
    vertices, faces
        Positions, and three of them per triangle.
    uv
        Texture coordinates per corner; None unless every corner has them.
    part, part_names
        Part of every triangle: its material where the file uses several, else its group or object.
    materials, libraries
        Materials of the triangles, in order of first use, and what the file says after `mtllib`.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    uv: Float[np.ndarray, "f 3 2"] | None
    part: Int[np.ndarray, " f"]
    part_names: tuple[str, ...]
    materials: tuple[str, ...]
    libraries: tuple[str, ...]


def read(path: Path) -> Obj:
    """Read an OBJ file; lines, points, normals and curves are passed over.

    Raises
    ------
    BadInput
        If a face names a vertex that does not exist.
    """
    positions: list[Sequence[str]] = []
    coordinates: list[Sequence[str]] = []
    corners: list[tuple[int, int]] = []
    labels: list[tuple[str, str]] = []
    libraries: list[str] = []
    group = material = ""
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            word, *rest = line.split() or [""]
            if word == "v":
                positions.append(rest[:3])
            elif word == "vt":
                coordinates.append([*rest, "0"][:2])
            elif word == "f":
                here = [_corner(token, len(positions), len(coordinates)) for token in rest]
                for i in range(1, len(here) - 1):
                    corners += (here[0], here[i], here[i + 1])
                    labels.append((group, material))
            elif word in ("g", "o"):
                group = " ".join(rest)
            elif word == "usemtl":
                material = " ".join(rest)
            elif word == "mtllib":
                libraries.append(line.split(maxsplit=1)[-1].strip())
    place = np.array(corners, np.int64).reshape(-1, 3, 2)
    _check_range(place[..., 0], len(positions))
    vertices = np.array(positions, np.float64).reshape(-1, 3)
    materials = tuple(dict.fromkeys(material for _, material in labels))
    uv = _uv(place[..., 1], coordinates)
    return Obj(vertices, place[..., 0], uv, *_parts(labels), materials, tuple(libraries))


def images(path: Path, obj: Obj) -> tuple[str, ...]:
    """Return the image (`map_Kd`) of every used material that has one, in order of first use.

    Parameters
    ----------
    path
        The OBJ file: libraries are found beside it, images beside their library.
    obj
        What `read` returned for it.

    Returns
    -------
    tuple of str
        Paths of images that exist; of others, the names that the library has for them.
    """
    found: dict[str, str] = {}
    for named in obj.libraries:
        # Names may hold spaces, and several names may share a line: as written first, else word by word.
        files = [path.parent / name for name in (named, *named.split())]
        for library in dict.fromkeys(file for file in files if file.is_file()):
            for material, image in _maps(library).items():
                found.setdefault(material, image)
    return tuple(found[material] for material in obj.materials if material in found)


def _maps(library: Path) -> dict[str, str]:
    """Return the image of every material in an MTL file that has one."""
    found: dict[str, str] = {}
    material = ""
    for line in library.read_text(encoding="utf-8", errors="replace").splitlines():
        word, rest = (*line.split(maxsplit=1), "", "")[:2]
        if word == "newmtl":
            material = " ".join(rest.split())
        elif word.lower() == "map_kd":
            while option := _OPTION.match(rest):
                rest = rest[option.end() :]
            if name := rest.strip().strip('"'):
                found.setdefault(material, beside(library, name))
    return found


def beside(file: Path, name: str) -> str:
    """Return the path of an image that a file names, if it exists, else the name."""
    plain = name.replace("\\", "/")
    # Exporters like to write paths of their own machine: then the image often lies next to the file.
    places = (file.parent / spelling for spelling in (name, plain, plain.rpartition("/")[2]))
    return next((str(place) for place in places if place.is_file()), name)


def _corner(token: str, positions: int, coordinates: int) -> tuple[int, int]:
    """Return the indices, from 0, of a corner such as 7, 7/2, 7//3 or -1/-1; -1 for no texture coordinates."""
    v, _, rest = token.partition("/")
    vt = rest.partition("/")[0]
    i, j = int(v), int(vt) if vt else 0
    return i - 1 if i > 0 else positions + i, j - 1 if j > 0 else coordinates + j if j else -1


def _check_range(index: Int[np.ndarray, "f 3"], count: int) -> None:
    if index.size and (index.min() < 0 or index.max() >= count):
        raise BadInput("faces name vertices which do not exist: export it again")


def _uv(index: Int[np.ndarray, "f 3"], coordinates: list[Sequence[str]]) -> Float[np.ndarray, "f 3 2"] | None:
    if not coordinates or index.size == 0 or index.min() < 0:
        return None
    _check_range(index, len(coordinates))
    uv: Float[np.ndarray, "f 3 2"] = np.array(coordinates, np.float64)[index]
    return uv


def _parts(labels: list[tuple[str, str]]) -> tuple[Int[np.ndarray, " f"], tuple[str, ...]]:
    """Number materials, if there are several, else groups, in order of first appearance."""
    for column in (1, 0):
        names = dict.fromkeys(label[column] for label in labels)
        if len(names) > 1:
            number = {name: i for i, name in enumerate(names)}
            ids = np.array([number[label[column]] for label in labels], np.int32)
            return ids, tuple(name or "unnamed" for name in names)
    return np.zeros(len(labels), np.int32), ("surface",)
