"""What is different between two grids.

In: two grids on one lattice. Out: a frozen `Difference`: what they say of themselves, which bricks they have, and how
far apart their channels are on the bricks that both have.
"""

from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from sdfbake.bricks import in_lattice
from sdfbake.complaint import BadInput
from sdfbake.grid import CHANNELS, Grid
from sdfbake.lattice import BAND, Lattice

_BRICKS_AT_ONCE = 4096
# Of the metadata: what says how a file came to be written, not what it holds,
_UNTOLD = {"format_version", "tool_version", "checksums"}
# and where the numbers come from rather than what they mean: two ways to the same numbers are no difference of grids.
_ORIGIN = {"source", "mesh_hash", "sign", "options", "edge_over_h", "overflow", "stretch"}


@dataclass(frozen=True, slots=True)
class ChannelDifference:
    """How far apart two grids are in one channel, on the bricks that both have.

    Attributes
    ----------
    samples
        Samples of the exact band of both.
    differ
        How many of those are not the same.
    share
        Their share, 0 to 1.
    max, rms
        Of the absolute difference over those samples: voxels for distances, the atlas's unit for texture coordinates
        (the larger of u and v); None for ids.
    signs
        Samples inside in one and outside in the other; None but for distances.
    anywhere
        Samples whose bits differ, in the band or not.
    """

    samples: int
    differ: int
    share: float
    max: float | None
    rms: float | None
    signs: int | None
    anywhere: int


@dataclass(frozen=True, slots=True)
class Difference:
    """How two grids, A and B, differ.

    Attributes
    ----------
    metadata
        Entries that differ, with both values.
    common_bricks, only_a, only_b
        Bricks of both, and of one only.
    unmatched
        Of those of one only, how many hold samples of that one's exact band.
    channels
        Per channel that both have.
    channels_only_a, channels_only_b
        Channels of one only.
    tables
        Other arrays (bounds of absent bricks, error estimates, faces, layers) whose bits differ.
    levels
        The same of the coarser levels that both have.
    levels_only_a, levels_only_b
        How many levels only one has.
    """

    metadata: dict[str, tuple[Any, Any]]
    common_bricks: int
    only_a: int
    only_b: int
    unmatched: int
    channels: dict[str, ChannelDifference]
    channels_only_a: tuple[str, ...]
    channels_only_b: tuple[str, ...]
    tables: tuple[str, ...]
    levels: tuple["Difference", ...] = ()
    levels_only_a: int = 0
    levels_only_b: int = 0

    def within(self, tolerance: float) -> bool:
        """Say whether the grids are the same.

        Parameters
        ----------
        tolerance
            0 asks for the same bits and the same metadata. Above, it bounds the difference of distances, in voxels,
            and of texture coordinates, in units of the atlas, in the exact band; ids, channels, and what metadata say
            of the numbers' meaning must agree; where the numbers come from, bounds and tables need not.
        """
        if self.unmatched or self.channels_only_a or self.channels_only_b or set(self.metadata) - _ORIGIN:
            return False
        if self.levels_only_a or self.levels_only_b or not all(level.within(tolerance) for level in self.levels):
            return False
        if tolerance == 0:
            untouched = all(channel.anywhere == 0 for channel in self.channels.values())
            return untouched and not (self.metadata or self.tables or self.only_a or self.only_b)
        return all(
            channel.differ == 0 if channel.max is None else channel.max <= tolerance
            for channel in self.channels.values()
        )

    def record(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        entries = {name: {"a": a, "b": b} for name, (a, b) in self.metadata.items()}
        names = {name: list(getattr(self, name)) for name in ("channels_only_a", "channels_only_b", "tables")}
        return {**asdict(self), **names, "metadata": entries, "levels": [level.record() for level in self.levels]}


def compare(a: Grid, b: Grid) -> Difference:
    """Compare two grids.

    Raises
    ------
    BadInput
        If their lattices differ: then no sample of one has a counterpart in the other.

    Examples
    --------
    >>> from datasets_synthetic import shape
    >>> grid = Grid.from_function(shape("sphere"), 16)
    >>> compare(grid, grid).within(0)
    True
    """
    _require_same(a.lattice, b.lattice)
    common = (a.bricks.slot >= 0) & (b.bricks.slot >= 0)
    pairs = np.stack([a.bricks.slot[common], b.bricks.slot[common]])
    has_a, has_b = ({name for name in CHANNELS if getattr(grid, name) is not None} for grid in (a, b))
    tables_a, tables_b = _tables(a), _tables(b)
    everything = a.metadata.source == "dense" or b.metadata.source == "dense"  # no band: not necessarily distances
    return Difference(
        _metadata(a, b),
        pairs.shape[1],
        len(a.bricks) - pairs.shape[1],
        len(b.bricks) - pairs.shape[1],
        _unmatched(a, ~common) + _unmatched(b, ~common),
        {name: _channel(a, b, name, pairs, everything=everything) for name in CHANNELS if name in has_a & has_b},
        tuple(name for name in CHANNELS if name in has_a - has_b),
        tuple(name for name in CHANNELS if name in has_b - has_a),
        tuple(
            name
            for name in sorted(tables_a | tables_b)
            if name not in tables_a or name not in tables_b or not _same_bits(tables_a[name], tables_b[name])
        ),
        tuple(compare(one, other) for one, other in zip(a.levels, b.levels, strict=False)),
        max(len(a.levels) - len(b.levels), 0),
        max(len(b.levels) - len(a.levels), 0),
    )


def _require_same(a: Lattice, b: Lattice) -> None:
    """Raise BadInput with the first way in which two lattices differ."""
    for name, one, other in (
        ("shapes", a.shape, b.shape),
        ("spacings", a.spacing, b.spacing),
        ("origins", tuple(a.origin.tolist()), tuple(b.origin.tolist())),
    ):
        if one != other:
            raise BadInput(
                f"the grids lie on different lattices, with {name} {one} and {other}: compare grids of one mesh, "
                "resolution and box"
            )


def _metadata(a: Grid, b: Grid) -> dict[str, tuple[Any, Any]]:
    """Return the entries that differ; of the signs, the method is compared and not how it was checked."""
    one, other = (grid.metadata.model_dump(mode="json", exclude=_UNTOLD) for grid in (a, b))
    for entries in (one, other):
        entries["sign"] = entries["sign"]["method"]
    return {name: (one[name], other[name]) for name in one if one[name] != other[name]}


def _unmatched(grid: Grid, elsewhere: Bool[np.ndarray, "bx by bz"]) -> int:
    """Count the bricks there that hold samples of the exact band; all, where the numbers need not be distances."""
    slots = grid.bricks.slot[elsewhere & (grid.bricks.slot >= 0)]
    if grid.metadata.source == "dense":
        return len(slots)
    near = np.abs(grid.distance[slots]) <= BAND * grid.lattice.spacing
    near &= in_lattice(grid.bricks.index[slots], grid.lattice.shape)
    return int(np.count_nonzero(near.any(axis=(1, 2, 3))))


class _Piece(NamedTuple):
    """What some of the bricks add to a `ChannelDifference`."""

    samples: int
    differ: int
    signs: int
    anywhere: int
    max: float
    square: float


def _channel(a: Grid, b: Grid, name: str, pairs: Int[np.ndarray, "2 m"], *, everything: bool) -> ChannelDifference:
    """Compare a channel on the common bricks."""
    starts = range(0, max(pairs.shape[1], 1), _BRICKS_AT_ONCE)
    pieces = [_piece(a, b, name, pairs[:, start : start + _BRICKS_AT_ONCE], everything=everything) for start in starts]
    samples, differ, signs, anywhere, most, square = zip(*pieces, strict=True)
    count, numbers = sum(samples), CHANNELS[name][1].startswith("<f")
    return ChannelDifference(
        count,
        sum(differ),
        sum(differ) / max(count, 1),
        max(most) if numbers else None,
        float(np.sqrt(sum(square) / max(count, 1))) if numbers else None,
        sum(signs) if name == "distance" else None,
        sum(anywhere),
    )


def _piece(a: Grid, b: Grid, name: str, pairs: Int[np.ndarray, "2 m"], *, everything: bool) -> _Piece:
    """Compare a channel on some of the common bricks, in the band of both or everywhere."""
    x, y = getattr(a, name)[pairs[0]], getattr(b, name)[pairs[1]]
    other = _bits(x) != _bits(y)
    other = other.any(axis=tuple(range(4, other.ndim)))
    near = in_lattice(a.bricks.index[pairs[0]], a.lattice.shape)
    if not everything:
        farther = np.maximum(np.abs(a.distance[pairs[0]]), np.abs(b.distance[pairs[1]]))
        near &= farther <= BAND * a.lattice.spacing
    apart = np.zeros(1)
    if x.dtype.kind == "f":
        apart = np.abs(x[near].astype(np.float64) - y[near])
        apart = apart.max(axis=tuple(range(1, apart.ndim)), initial=0)
        apart = apart / (a.lattice.spacing if name == "distance" else 1)
    signs = np.count_nonzero(((x < 0) != (y < 0)) & near) if name == "distance" else 0
    samples, differ, anywhere = (int(np.count_nonzero(v)) for v in (near, other & near, other))
    return _Piece(samples, differ, int(signs), anywhere, float(apart.max(initial=0)), float(apart @ apart))


def _bits(v: np.ndarray) -> np.ndarray:
    """Return the bits of numbers as whole numbers: 0 and -0 differ, and a NaN is the same as itself."""
    bits: np.ndarray = np.ascontiguousarray(v).view(f"u{v.dtype.itemsize}")
    return bits


def _tables(grid: Grid) -> dict[str, np.ndarray]:
    """Return the arrays of a grid that are no channels."""
    tables = {"far": grid.bricks.far}
    if grid.error is not None:
        tables["error"] = grid.error
    for name, record in (("surface", grid.surface), ("layers", grid.layers)):
        if record is not None:
            tables |= {f"{name}.{entry.name}": getattr(record, entry.name) for entry in fields(record)}
    return tables


def _same_bits(x: np.ndarray, y: np.ndarray) -> bool:
    """Say whether two arrays are the same, bit for bit."""
    return x.shape == y.shape and x.dtype == y.dtype and x.tobytes() == y.tobytes()
