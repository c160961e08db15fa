"""VTK image data.

In: a `.vti` file with an array of one number per point. Out: `Field`. Read by our own code: VTK itself takes half a
gigabyte of disk, and this is all that is wanted of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float, Int, Real

from sdfbake.complaint import BadInput
from sdfbake.imports.field import Field, corrupt, mapped, require_lattice, require_memory
from sdfbake.imports.vtidata import TYPES, Layout, decoded, written_out

_REACH = 1 << 24  # farthest index that is believed
_APPENDED = b"<AppendedData"


@dataclass(frozen=True, slots=True)
class _File:
    """An opened file: its elements, how arrays are written, and the bytes of appended ones."""

    name: str
    image: Element
    layout: Layout
    appended: memoryview
    encoded: bool


def read(path: Path, grid: str | None = None) -> Field:
    """Read one array: the named one, or `sdf`, or the first of floats with one component.

    Raises
    ------
    BadInput
        If the file is corrupt, has no such array on points, is flat, turned or too large.
    """
    file = _opened(path)
    extent = _extent(file, file.image, "WholeExtent")
    origin, spacing = (_numbers(file, file.image, key, 3) for key in ("Origin", "Spacing"))
    if "Direction" in file.image.attrib:
        turn = _numbers(file, file.image, "Direction", 9).reshape(3, 3)
        if np.abs(turn - np.eye(3)).max() > 1e-9:
            raise BadInput(f"{path.name} is turned against the axes: resample it onto an axis-aligned image first")
    shape = extent[:, 1] - extent[:, 0] + 1
    if shape.min() < 2:
        raise BadInput(f"{path.name} has {shape.tolist()} samples: a volume needs 2 or more along every axis")
    require_lattice(path.name, origin, spacing)
    require_memory(path.name, tuple(shape.tolist()))
    pieces = file.image.findall("Piece")
    name = _chosen(file, pieces, grid)
    values = _joined(file, pieces, name, extent)
    return Field(values, origin + spacing * extent[:, 0], spacing, name)


def _opened(path: Path) -> _File:
    """Part the XML from the bytes that may follow it, and read it."""
    data = mapped(path)
    cut = _find(data, _APPENDED, 0)
    head = bytes(data if cut is None else data[:cut])
    if b"<!" in head.replace(b"<!--", b""):  # the format has no document type; entities are traps
        raise corrupt(path.name, "it declares things that such files do not have")
    try:
        root = ElementTree.fromstring(head if cut is None else head + b"</VTKFile>")
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise corrupt(path.name, f"it is not the XML of a VTK file ({error})") from None
    image = root.find("ImageData")
    if root.tag != "VTKFile" or image is None:
        raise BadInput(
            f"{path.name} holds {root.get('type', root.tag)} and no ImageData: resample it to an image first"
        )
    layout = Layout.of(root.attrib, path.name)
    begin = None if cut is None else _find(data, b"_", cut)
    if cut is None or begin is None:
        return _File(path.name, image, layout, memoryview(b""), encoded=False)
    encoded = b"base64" in bytes(data[cut:begin])
    return _File(path.name, image, layout, data[begin + 1 :], encoded)


def _find(data: memoryview, what: bytes, start: int) -> int | None:
    """Return where bytes first occur, or None; a megabyte at a time, since a file may be larger than memory."""
    step = 1 << 20
    for at in range(start, len(data), step):
        found = bytes(data[at : at + step + len(what)]).find(what)
        if found >= 0:
            return at + found
    return None


def _numbers(file: _File, element: Element, key: str, count: int) -> Float[np.ndarray, " count"]:
    """Return the numbers of an attribute."""
    try:
        values = np.array(element.attrib[key].split(), np.float64)
    except (KeyError, ValueError):
        values = np.empty(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise corrupt(file.name, f"{key} of {element.tag} should be {count} numbers")
    return values


def _points(piece: Element) -> dict[str, Element]:
    """Return the arrays on points of a piece, by name."""
    return {array.get("Name", ""): array for array in piece.findall("PointData/DataArray")}


def _scalar(array: Element) -> bool:
    return array.get("NumberOfComponents", "1") in ("", "1") and array.get("type") in TYPES


def _chosen(file: _File, pieces: list[Element], wanted: str | None) -> str:
    """Return the name of the array that was asked for or is most likely meant."""
    arrays = _points(pieces[0]) if pieces else {}
    there = ", ".join(f"{name!r} ({array.get('type')})" for name, array in arrays.items()) or "none"
    if wanted is not None:
        if wanted not in arrays or not _scalar(arrays[wanted]):
            raise BadInput(f"{file.name} has no array {wanted!r} of one number per point: name one of {there}")
        return wanted
    floats = [name for name, array in arrays.items() if _scalar(array) and array.get("type", "").startswith("Float")]
    if not floats:
        cells = any(piece.find("CellData/DataArray") is not None for piece in pieces)
        cure = "move its arrays from cells to points by VTK's CellDataToPointData" if cells else "add one"
        raise BadInput(f"{file.name} has no array of one float per point (there is {there}): {cure}")
    return min(floats, key=lambda name: name != "sdf")


def _joined(
    file: _File, pieces: list[Element], name: str, whole: Int[np.ndarray, "3 2"]
) -> Real[np.ndarray, "nx ny nz"]:
    """Put the pieces of an array together; one alone is taken as it is."""
    if len(pieces) == 1 and (_extent(file, pieces[0]) == whole).all():
        return _array(file, pieces[0], name, whole)
    values = np.full(whole[:, 1] - whole[:, 0] + 1, np.nan)
    for piece in pieces:
        extent = _extent(file, piece)
        if (extent[:, 0] < whole[:, 0]).any() or (extent[:, 1] > whole[:, 1]).any():
            raise corrupt(file.name, "a piece lies outside the whole")
        first, end = extent[:, 0] - whole[:, 0], extent[:, 1] - whole[:, 0] + 1
        values[tuple(map(slice, first, end))] = _array(file, piece, name, extent)
    return values


def _extent(file: _File, element: Element, key: str = "Extent") -> Int[np.ndarray, "3 2"]:
    """Return first and last index along each axis."""
    extent = _numbers(file, element, key, 6)
    if np.abs(extent).max() > _REACH:
        raise corrupt(file.name, f"{key} of {element.tag} reaches too far")
    return extent.astype(np.int64).reshape(3, 2)


def _array(file: _File, piece: Element, name: str, extent: Int[np.ndarray, "3 2"]) -> Real[np.ndarray, "nx ny nz"]:
    """Return an array of a piece."""
    array, shape = _points(piece).get(name), extent[:, 1] - extent[:, 0] + 1
    if array is None or not _scalar(array) or shape.min() < 1:
        raise corrupt(file.name, f"a piece has no array {name!r} of one number per point")
    count, kind = int(shape.prod()), array.attrib["type"]
    values = _stored(file, array, kind, count)
    return values.reshape(shape[::-1].tolist()).T


def _stored(file: _File, array: Element, kind: str, count: int) -> Real[np.ndarray, " count"]:
    """Return an array's numbers, wherever they are."""
    form = array.get("format", "ascii")
    text = " ".join([array.text or "", *(child.tail or "" for child in array)])  # remarks may stand before the numbers
    if form == "ascii":
        return written_out(text, kind, count, file.name)
    if form == "binary":
        inline = memoryview("".join(text.split()).encode())
        return decoded(inline, kind, count, file.layout, encoded=True, name=file.name)
    offset = _offset(file, array.attrib)
    return decoded(file.appended[offset:], kind, count, file.layout, encoded=file.encoded, name=file.name)


def _offset(file: _File, attributes: Mapping[str, str]) -> int:
    """Return where an appended array begins."""
    try:
        offset = int(attributes["offset"])
    except (KeyError, ValueError):
        offset = -1
    if not 0 <= offset < len(file.appended):
        raise corrupt(file.name, "an array begins outside the appended data")
    return offset
