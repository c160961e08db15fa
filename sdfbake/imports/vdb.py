"""Level sets and dense float grids of OpenVDB files.

In: a `.vdb` file of version 222 to 225 (OpenVDB 3 and later). Out: `Field` on the box of the grid's active samples,
with a margin of background around a narrow band. Read by our own code: the one library that pip installs everywhere,
tinyvdb 0.9, loses leaves of nodes that have more than 63, and says nothing.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sdfbake.bricks import SIDE
from sdfbake.complaint import BadInput
from sdfbake.imports.field import Field, corrupt, mapped, require_lattice, require_memory
from sdfbake.imports.vdbstream import Cursor
from sdfbake.imports.vdbtree import TYPES, Tree, read_tree

_MAGIC = 0x56444220
_VERSIONS = range(222, 226)
_HALF = "_HalfFloat"
_WHOLE = 0.9  # share of active samples in their box, from which a grid that is no level set counts as dense
_MARGIN = 3  # samples around a narrow band, which stencils at its rim may touch
# Numbers that a transform stores after its name, as triples, and which of them are the translation and the scale.
_MAPS = {
    "ScaleMap": (5, None, 0),
    "UniformScaleMap": (5, None, 0),
    "ScaleTranslateMap": (6, 0, 1),
    "UniformScaleTranslateMap": (6, 0, 1),
    "TranslationMap": (1, 0, None),
}
_CLASSES = {"fog volume": "densities, no distances", "staggered": "a staggered vector field"}


@dataclass(frozen=True, slots=True)
class _Entry:
    """A grid in the list of a file."""

    name: str
    kind: str
    half: bool
    parent: str
    at: int


@dataclass(frozen=True, slots=True)
class _Head:
    """What is known of a grid before its tree is read; `at` is the tree's first byte."""

    entry: _Entry
    compression: int
    metadata: dict[str, tuple[str, bytes]]
    at: int
    origin: Float[np.ndarray, "3"]
    spacing: Float[np.ndarray, "3"]
    turned: bool

    @property
    def class_(self) -> str:
        """What the grid says it is; empty where it does not."""
        return self.metadata.get("class", ("", b""))[1].decode("utf-8", "replace")


def read(path: Path, grid: str | None = None) -> Field:
    """Read one grid of a file: the named one, or `sdf`, or the first level set, or the first of floats.

    Raises
    ------
    BadInput
        If the file is corrupt, of another version, or holds no such grid; if that is no field of distances, turned
        against the axes, or too large.
    """
    cursor = Cursor(mapped(path), path.name)
    head = _chosen(cursor, _entries(cursor), grid)
    where = f"grid {head.entry.name!r} of {path.name}"
    if head.class_ in _CLASSES:
        raise BadInput(f"{where} is a {head.class_}: {_CLASSES[head.class_]}; convert it to a level set first")
    if head.turned:
        raise BadInput(f"{where} is turned or sheared against the axes: resample it onto an axis-aligned transform")
    require_lattice(where, head.origin, head.spacing)
    cursor.at = head.at
    tree = read_tree(cursor, head.entry.kind, head.compression, half=head.entry.half)
    return _field(head, tree, where)


def _entries(cursor: Cursor) -> list[_Entry]:
    """Read the file's header and what stands before every grid."""
    if len(cursor.data) < 8 or cursor.number("q") != _MAGIC:
        raise corrupt(cursor.name, "it does not begin like an OpenVDB file")
    version = cursor.number("I")
    if version not in _VERSIONS:
        raise BadInput(
            f"{cursor.name} is an OpenVDB file of version {version} and {_VERSIONS[0]} to {_VERSIONS[-1]} are read: "
            "write it anew by another version of OpenVDB"
        )
    cursor.numbers("II")  # the library's version
    if not cursor.number("?"):
        raise BadInput(f"{cursor.name} was written as a stream, without offsets of its grids: write it to a file")
    cursor.take(36)  # an identifier
    cursor.metadata()
    entries = []
    for _ in range(cursor.number("I")):
        name, kind, parent = cursor.text().split("\x1e")[0], cursor.text(), cursor.text()
        at, _, end = cursor.numbers("3q")
        if not cursor.at <= at <= end <= len(cursor.data):
            raise corrupt(cursor.name, f"grid {name!r} would reach from byte {at} to {end} of {len(cursor.data)}")
        entries.append(_Entry(name, kind.removesuffix(_HALF), kind.endswith(_HALF), parent, at))
        cursor.at = end
    return entries


def _chosen(cursor: Cursor, entries: list[_Entry], wanted: str | None) -> _Head:
    """Return the grid that was asked for or is most likely meant."""
    there = ", ".join(f"{entry.name!r} ({entry.kind})" for entry in entries) or "none"
    named = [entry for entry in entries if entry.name == wanted]
    if wanted is not None and not named:
        raise BadInput(f"{cursor.name} has no grid {wanted!r}: name one of its grids, {there}")
    if named and (named[0].kind not in TYPES or named[0].parent):
        raise BadInput(f"grid {wanted!r} of {cursor.name} holds no distances of its own: name one of {there}")
    heads = [_head(cursor, entry) for entry in named or entries if entry.kind in TYPES and not entry.parent]
    if not heads:
        raise BadInput(f"{cursor.name} has no grid of floating-point numbers, only {there}: write a level set")
    # False sorts first.
    return min(heads, key=lambda head: (head.entry.name != "sdf", head.class_ != "level set", head.class_ in _CLASSES))


def _head(cursor: Cursor, entry: _Entry) -> _Head:
    """Read what stands before a grid's tree."""
    cursor.at = entry.at
    compression = cursor.number("I")
    metadata = cursor.metadata()
    kind = cursor.text()
    origin, spacing, turned = np.zeros(3), np.ones(3), False
    if kind in _MAPS:
        count, translation, scale = _MAPS[kind]
        triples = np.array(cursor.numbers(f"{3 * count}d")).reshape(-1, 3)
        origin = origin if translation is None else triples[translation]
        spacing = spacing if scale is None else triples[scale]
    elif kind in ("AffineMap", "UnitaryMap"):
        matrix = np.array(cursor.numbers("16d")).reshape(4, 4)  # of row vectors: the translation is the last row
        origin, spacing = matrix[3, :3], np.diagonal(matrix)[:3].copy()
        turned = bool(np.abs(matrix[:3, :3] - np.diag(spacing)).max() > 1e-9 * np.abs(matrix[:3, :3]).max())
    else:
        raise BadInput(
            f"grid {entry.name!r} of {cursor.name} has a transform of kind {kind}: resample it onto a linear one"
        )
    return _Head(entry, compression, metadata, cursor.at, origin, spacing, turned)


def _field(head: _Head, tree: Tree, where: str) -> Field:
    """Lay the tree out on the box of its active samples."""
    low, high, active = _box(tree, where)
    # Some writers call a sample inactive for having the background's value by accident, such as 0 on the surface.
    whole = head.class_ != "level set" and active >= _WHOLE * np.prod(high - low, dtype=np.float64)
    notes: tuple[str, ...] = ()
    if not whole:
        if not tree.background > 0:
            raise BadInput(
                f"{where} is sparse and its background is {tree.background:g}, no distance outside: write a level set"
            )
        if head.class_ != "level set":
            notes = (f"{where} does not say that it is a level set, and is taken for one",)
    if head.entry.half:
        notes += (f"{where} is stored in 16 bits: its distances are rounded",)
    margin = 0 if whole else _MARGIN
    low, high = low - margin, high + margin
    require_memory(where, tuple((high - low).tolist()))
    values = _laid_out(tree, low, high)
    half_width = None if whole else tree.background
    origin = head.origin + head.spacing * low
    return Field(values, origin, head.spacing, head.entry.name, half_width, notes=notes)


def _box(tree: Tree, where: str) -> tuple[Int[np.ndarray, "3"], Int[np.ndarray, "3"], float]:
    """Return first and one past last active sample along each axis, and how many there are."""
    bits = np.unpackbits(tree.active, axis=1, bitorder="little").reshape(-1, SIDE, SIDE, SIDE)
    some = tree.active.any(axis=1)
    corners = [tree.tile_origin[tree.tile_active], (tree.tile_origin + tree.tile_side[:, None])[tree.tile_active]]
    low, high = [corners[0]], [corners[1]]
    if some.any():
        lines = [np.asarray(bits[some].any(axis=axes)) for axes in ((2, 3), (1, 3), (1, 2))]
        low.append(tree.origin[some] + np.stack([line.argmax(axis=1) for line in lines], axis=-1))
        high.append(tree.origin[some] + SIDE - np.stack([line[:, ::-1].argmax(axis=1) for line in lines], axis=-1))
    lows, highs = np.concatenate(low), np.concatenate(high)
    if not len(lows):
        raise BadInput(f"{where} has no active sample: there is nothing to import")
    tiled = (tree.tile_side[tree.tile_active].astype(np.float64) ** 3).sum()
    return lows.min(axis=0), highs.max(axis=0), float(np.count_nonzero(bits) + tiled)


def _laid_out(tree: Tree, low: Int[np.ndarray, "3"], high: Int[np.ndarray, "3"]) -> Float[np.ndarray, "nx ny nz"]:
    """Return the samples of a box: the background, tiles over it, leaves over those."""
    values = np.full(high - low, tree.background, np.float32)
    for origin, side, value in zip(tree.tile_origin, tree.tile_side, tree.tile_value, strict=True):
        _put(values, origin - low, int(side), value)
    for origin, leaf in zip(tree.origin, tree.values, strict=True):
        _put(values, origin - low, SIDE, leaf)
    return values


def _put(values: np.ndarray, first: Int[np.ndarray, "3"], side: int, part: Any) -> None:
    """Write a cube, as far as it lies in the box, into an array that is ours."""
    start, end = np.maximum(first, 0), np.minimum(first + side, values.shape)
    if (start < end).all():
        inner = tuple(slice(a, b) for a, b in zip(start - first, end - first, strict=True))
        values[tuple(slice(a, b) for a, b in zip(start, end, strict=True))] = part[inner] if np.ndim(part) else part
