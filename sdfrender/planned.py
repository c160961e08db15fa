"""What a picture takes, as plain data.

In: what `sdfrender.plan.make_plan` derives. Out: a frozen `Plan` that tracing and loading follow, and the account of
every capability of the renderer: needed or left out, and why.
"""

from dataclasses import asdict, dataclass
from typing import Any

FUSED = 2  # hits: the last of a longer path is treated like those before, so that one program serves them all


@dataclass(frozen=True, slots=True)
class Saving:
    """How much longer a picture would take with something on that it does not need, as a share of its tracing time.

    An estimate, see `sdfrender.costs`; by engine.
    """

    numpy: float
    drjit: float


@dataclass(frozen=True, slots=True)
class Capability:
    """Something that a renderer can do.

    Attributes
    ----------
    what
        Its name.
    needed
        Whether this picture needs it.
    how
        What is done of it; empty if it is left out.
    reason
        Why.
    bytes
        Bytes of files that are not read, because it (or a part of it) is left out.
    saving
        The time that this saves; None where it would cost nothing or nobody knows.
    """

    what: str
    needed: bool
    how: str
    reason: str
    bytes: int = 0
    saving: Saving | None = None


@dataclass(frozen=True, slots=True)
class AssetPlan:
    """What is read of an asset: its file, its channels, and how it knows texture coordinates (None: not asked).

    Only the bricks `in_sight` of the picture's rays are read where no ray leaves from what these meet. Among so many
    coarser `levels` rays choose by their footprints.
    """

    grid: str
    channels: tuple[str, ...]
    uv_mode: str | None
    in_sight: bool = False
    levels: int = 0


@dataclass(frozen=True, slots=True)
class Levels:
    """Of the mip levels of a texture, 0 to `last`, the first that any footprint can reach, and why."""

    texture: str
    first: int
    last: int
    reason: str


@dataclass(frozen=True, slots=True)
class Plan:
    """What is computed.

    Attributes
    ----------
    outputs
        What is recorded.
    orders
        For the first, second, ... hit of a path the order of the jet: None for no jet at all, 1 for the gradient, 2
        for the Hessian too. As many hits as entries are followed.
    differentials
        Whether ray differentials are carried.
    footprints
        Whether they are brought to surfaces where paths end; if not, only what surrounds the scene asks for them.
    uv
        Whether texture coordinates are looked up.
    parts
        Whether the part of a hit matters.
    splits
        At how many surfaces of glass both ways are followed; 0 where none is.
    lit
        Whether matt surfaces ask lights.
    assets
        What is read of each asset of the scene.
    capabilities
        All that the renderer can do, needed or not, with reasons.
    levels
        Mip levels of the textures that are filtered by footprints. They are known once it is known which bricks are in
        sight: `sdfrender.stage.prepare` and `sdfrender.forecast.forecast` fill them in.
    """

    outputs: tuple[str, ...]
    orders: tuple[int | None, ...]
    differentials: bool
    footprints: bool
    uv: bool
    parts: bool
    splits: int
    lit: bool
    assets: tuple[AssetPlan, ...]
    capabilities: tuple[Capability, ...] = ()
    levels: tuple[Levels, ...] = ()

    @property
    def grid_levels(self) -> bool:
        """Whether rays choose among levels of grids by their footprints."""
        return any(asset.levels for asset in self.assets)

    @property
    def left_out(self) -> tuple[Capability, ...]:
        """What is not done, with reasons."""
        return tuple(capability for capability in self.capabilities if not capability.needed)

    def record(self) -> dict[str, Any]:
        """Return the plan as plain data."""
        return {**asdict(self), "left_out": [asdict(capability) for capability in self.left_out]}
