"""Footprints beyond all measure: a thousand times as long as wide, far finer than a texel, far larger than a texture.

In: an engine. Out: cases over a flat page, where footprints are known in closed form, and its texture.
"""

from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from PIL import Image

from datasets_synthetic.sheet import sheet
from sdfbake import Grid, bake
from sdfbake.engine import Array, Choice, Engine
from sdfrender import Flag, GridField, Scene, footprint, render, transfer
from sdfrender.footprint import axes
from sdfrender.picture import srgb_to_linear
from sdfrender.pyramid import Texture
from sdfrender.sampler import MOST_ANISOTROPIC, Sampler
from sdfrender.viewing import GivenView
from validate.beam import MeshRays
from validate.course import Course, as_rays
from validate.stress.case import Case, Check, Finding
from validate.stress.sights import RESOLUTION

# ---- a thousand to one -----------------------------------------------------------------------------------------------
SIZE = 1024  # texels along either side
MAJOR, RATIO = 400.0, 1000.0  # half axis of the ellipse, texels, and how much longer it is than the other
PERIODS = (12, 16)  # of a grating, along u and along v
# Of the major axis, in half a turn; the first along the grating's stripes, where a short axis that is widened shows.
ANGLES = np.arctan2(-PERIODS[0], PERIODS[1]) + np.pi * np.arange(24) / 24


@cache
def _page() -> Grid:
    """A page of 2 x 2 that faces +z at z = 0, its texture [0, 1]^2."""
    return bake(sheet().mesh(0.25), RESOLUTION, uv_mode="faces")


def _field(choice: Choice) -> GridField:
    return GridField(_page(), "bspline", choice)


def _long(half: float, ratio: float) -> tuple[MeshRays, Float[np.ndarray, " n"]]:
    """Rays onto the middle of the page whose footprints have given half axes, texels, at all angles."""
    turned = np.arange(len(ANGLES)) * 0.7  # of the pixel's own axes against the ellipse's: no footprint of theirs
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    major = half * 2 / SIZE * np.stack([c, s, 0 * c], axis=-1)
    minor = half / ratio * 2 / SIZE * np.stack([-s, c, 0 * c], axis=-1)
    x, y = np.cos(turned)[:, None], np.sin(turned)[:, None]
    nothing = np.zeros_like(major)
    p = nothing + np.array([0.013, -0.027, 0.5])
    return MeshRays(p, nothing - [0, 0, 1], x * major - y * minor, y * major + x * minor, nothing, nothing), ANGLES


def _anisotropic(choice: Choice) -> Iterator[Check]:
    beam, angles = _long(MAJOR, RATIO)
    eps = choice.engine.eps
    found = cache(partial(_ellipses, choice, beam))

    def check(name: str, unit: str, limit: float, column: int, truth: Float[np.ndarray, " n"] | float) -> Check:
        def find() -> Finding:
            off = found()[column] - truth
            return Finding(np.abs(off / truth) if unit == "relative" else np.abs(np.sin(off)), beam)

        return Check(name, unit, limit, find, partial(_course, choice))

    # J's entries carry some 16 units of rounding each, from the transfer and the product with G. The minor axis is
    # |det J| over the major one: a difference of products 1000 times as large, two of them. Angles are atan2's.
    yield check("major axis", "relative", 16 * eps, 0, MAJOR)
    yield check("minor axis", "relative", 2 * RATIO * 16 * eps, 1, MAJOR / RATIO)
    yield check("angle", "radian", 16 * eps, 2, angles)
    for ratio, capped in ((RATIO, True), (MOST_ANISOTROPIC * 1.01, True), (MOST_ANISOTROPIC * 0.99, False)):
        name = f"{ratio:.4g} to 1 is {'' if capped else 'not '}CLAMPED"
        yield Check(name, "count", 0.0, partial(_capped, choice, ratio, capped))
    # The Gaussian that ends differs from one that does not by 0.02 (docs/textures.md); as much again for its sum over
    # texels in place of the integral.
    yield Check("colour against the integral at 16 to 1", "colour", 0.04, partial(_colours, choice, MOST_ANISOTROPIC))
    why = "the look-up widens the ellipse to 16 to 1: it blurs, and does not alias"
    yield Check("colour against the integral at 1000 to 1", "colour", 0.04, partial(_colours, choice, RATIO), known=why)


def _course(choice: Choice) -> Course:
    return Course(_field(choice))


def _ellipses(choice: Choice, beam: MeshRays) -> tuple[Float[np.ndarray, " n"], ...]:
    """Half axes and angle that the engine makes of the rays' footprints."""
    field = _field(choice)
    hits, at = transfer(field, as_rays(beam))
    found = footprint(field, hits, at, size=(SIZE, SIZE))

    def program(xp: Engine, ux: Array, vx: Array, uy: Array, vy: Array) -> dict[str, Array]:
        texels = (xp.uniform(float(SIZE)), xp.uniform(float(SIZE)))
        return dict(zip("abc", axes(xp, (ux, vx), (uy, vy), texels), strict=True))

    out = choice.engine.run(program, [*found.duv_dx.T, *found.duv_dy.T])
    return tuple(out[name].astype(np.float64) for name in "abc")


@cache
def _grating() -> Texture:
    """A sine of `PERIODS` across the texture, sampled at its texels."""
    x, y = np.meshgrid(*2 * [(np.arange(SIZE) + 0.5) / SIZE])
    wave = np.sin(2 * np.pi * (PERIODS[0] * x + PERIODS[1] * (1 - y)))
    return Texture.of(wave[..., None].astype(np.float32))


def _looked_up(choice: Choice, ratio: float) -> tuple[MeshRays, Float[np.ndarray, "n 2"], dict[str, np.ndarray]]:
    """Colours and masks of the footprints at all angles, with their places on the texture."""
    xp, (beam, _) = choice.engine, _long(MAJOR, ratio)
    sampler = Sampler(xp, _grating(), "anisotropic", "repeat")
    uv = 0.5 + 0.5 * beam.p[:, :2]

    def program(xp: Engine, u: Array, v: Array, *j: Array) -> dict[str, Array]:
        look = sampler.look_up(xp, u, v, ((j[0], j[1]), (j[2], j[3])), xp.full(u, True))
        return {"colour": look.colour[0], "capped": xp.integer(look.capped)}

    steps = [0.5 * step[:, axis] for step in (beam.dp_dx, beam.dp_dy) for axis in (0, 1)]
    return beam, uv, xp.run(program, [*uv.T, *steps])


def _capped(choice: Choice, ratio: float, expected: bool) -> Finding:
    beam, _, out = _looked_up(choice, ratio)
    return Finding(((out["capped"] > 0) != expected).astype(np.float64), beam)


def _colours(choice: Choice, ratio: float) -> Finding:
    """Colours against the integral of the grating under the Gaussian of the footprint, in closed form."""
    beam, uv, out = _looked_up(choice, ratio)
    f = np.array(PERIODS, float)
    variance = sum((0.5 * 0.5 * step[:, :2] @ f) ** 2 for step in (beam.dp_dx, beam.dp_dy))
    truth = np.sin(2 * np.pi * uv @ f) * np.exp(-2 * np.pi**2 * variance)
    return Finding(np.abs(out["colour"].astype(np.float64) - truth), beam)


# ---- finer than a texel, larger than the texture ---------------------------------------------------------------------
SIDE = 16  # texels along either side of a texture of noise
BELOW, WITHIN, ABOVE = (-40.0, -10.0, -1.5), (0.5, 2.5), (8.5, 20.5, 40.5)


class Shown(NamedTuple):
    """A picture of a row of pixels: rays, the texel each meets in its middle, its level of detail, and the outputs."""

    beam: MeshRays
    texel: Int[np.ndarray, "n 2"]
    level: Float[np.ndarray, " n"]
    out: dict[str, np.ndarray]

    @property
    def colour(self) -> Float[np.ndarray, "n 3"]:
        """What was rendered."""
        return self.out["rgb"].astype(np.float64)


def _levels(choice: Choice) -> Iterator[Check]:
    eps = choice.engine.eps
    # The place's rounding over a texel's width times the greatest contrast; then float32 texels, each of four.
    place = 8 * RESOLUTION * eps * _page().lattice.spacing / (2 / SIDE) + 4 * 2.0**-24
    checks: tuple[tuple[str, str, float, Callable[[Shown], np.ndarray]], ...] = (
        # A logarithm to a unit of its size; J's own 16 units are 16 / ln 2 of a level.
        ("recorded lod, unclamped", "level", 40 * eps + 16 / np.log(2) * eps, _lod),
        ("CLAMPED where it is, and only there", "count", 0.0, _flagged),
        ("below 0, the finest texel", "colour", place, _finest),
        # Means of means are rounded to float32 in each of four levels, and the weights of an ellipse's texels sum to 1.
        ("above the top, the mean texel", "colour", 8 * 2.0**-24 + 64 * eps, _mean),
    )
    for filtering in ("trilinear", "anisotropic"):
        shown = cache(partial(_rendered, choice, filtering))
        for name, unit, limit, measure in checks:
            find = partial(_found, shown, measure)
            yield Check(f"{filtering}: {name}", unit, limit, find, partial(_course, choice))


def _found(shown: Callable[[], Shown], measure: Callable[[Shown], np.ndarray]) -> Finding:
    return Finding(measure(shown()), shown().beam)


def _lod(shown: Shown) -> Float[np.ndarray, " n"]:
    return np.asarray(np.abs(shown.out["lod"][:, 0].astype(np.float64) - shown.level))


def _flagged(shown: Shown) -> Float[np.ndarray, " n"]:
    flagged = (shown.out["flags"][:, 0].astype(np.int64) & Flag.CLAMPED) != 0
    return np.where(flagged == np.isin(shown.level, WITHIN), 1.0, 0.0)


def _finest(shown: Shown) -> Float[np.ndarray, " n"]:
    column, row = shown.texel.T
    off = np.abs(shown.colour - srgb_to_linear(_noise() / 255.0)[row, column]).max(axis=1)
    return np.where(np.isin(shown.level, BELOW), off, 0.0)


def _mean(shown: Shown) -> Float[np.ndarray, " n"]:
    off = np.abs(shown.colour - srgb_to_linear(_noise() / 255.0).mean(axis=(0, 1))).max(axis=1)
    return np.where(np.isin(shown.level, ABOVE), off, 0.0)


def _noise() -> np.ndarray:
    return np.random.default_rng(9).integers(0, 256, (SIDE, SIDE, 3), np.uint8)


def _rendered(choice: Choice, filtering: str) -> Shown:
    level = np.array(BELOW + WITHIN + ABOVE)
    side, count = 2.0**level * 2 / SIDE, len(level)
    texel = np.random.default_rng(10).integers(0, SIDE, (count, 2))
    x, y = (2 * (texel + 0.5) / SIDE - 1).T
    nothing = np.zeros((count, 3))
    across, down = (side[:, None] * np.array(axis) for axis in ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0)))
    beam = MeshRays(np.stack([x, -y, 0 * x + 1], axis=-1), nothing - [0, 0, 1], across, down, nothing, nothing)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "noise.png"
        Image.fromarray(_noise()).save(path)
        scene = Scene.model_validate(
            {
                "camera": {"position": (0.0, 0.0, 1.0), "target": (0.0, 0.0, 0.0)},
                "film": {"size": (count, 1), "outputs": ("rgb", "lod", "flags")},
                "assets": [{"grid": "page.zarr.zip", "materials": [{"type": "diffuse", "texture": "noise"}]}],
                "textures": [{"name": "noise", "image": path, "filter": filtering}],
            }
        )
        out = render(scene, field=_field(choice), view=GivenView(as_rays(beam), (count, 1)))
    return Shown(beam, texel, level, {name: array[0] for name, array in out.items()})


LOOKUPS: tuple[Case, ...] = (
    Case(
        "thousand-to-one",
        "A footprint a thousand times as long as wide",
        "Its axes and angle are those of the pixel's own steps: the short axis comes from the determinant, so rounding "
        "is magnified by the ratio and no more. The look-up widens it to 16 to 1 and says so.",
        _anisotropic,
    ),
    Case(
        "beyond-the-pyramid",
        "Levels of detail far below 0 and far above the top",
        "The level is recorded as it is; the look-up alone is clamped, once, with the flag CLAMPED: to the texel "
        "itself where the texture is magnified, to the mean of all where it is far away.",
        _levels,
    ),
)
