"""Balls of glass by hand: scenes of them, and the light through them by textbook formulas in float64.

Rays and balls in closed form, Snell's law and Fresnel's amplitudes as they stand in the books, the whole tree of paths:
no code in common with the renderer.
"""

from typing import NamedTuple

import numpy as np

from datasets_synthetic.sheet import sheet
from datasets_synthetic.sphere import Sphere
from sdfrender.scene import Scene
from validate.exact import ShapeField

PAGE = ((3.0, 3.0), 0.5, (0.0, 0.0, -2.0))  # size, thickness and front of the sheet, which looks to +z
SHAPES = {"ball": Sphere(1.0), "page": sheet(*PAGE), "small": Sphere(0.5)}
CAMERA = {"position": (0.0, 0.0, 3.0), "target": (0.0, 0.0, 0.0), "fov": 45.0}


class Ball(NamedTuple):
    """A ball of the world: `what` is the material's type."""

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 1.0
    what: str = "glass"
    index: float = 1.5


def exact(made):
    """Return the exact shapes of a scene's assets, by the names of their grids."""
    return [ShapeField(SHAPES[asset.grid.name.partition(".")[0]]) for asset in made.assets]


def asset(ball, grid="ball.zarr.zip"):
    """Return the asset of a ball in a scene."""
    material = {"type": ball.what, **({"index": ball.index} if ball.what == "glass" else {})}
    return {"grid": grid, "scale": ball.radius, "translate": ball.centre, "materials": [material]}


def scene(
    balls, *others, camera=CAMERA, size=(24, 24), outputs=("rgb",), background=(1.0, 1.0, 1.0), trace=None, **more
):
    """Return a scene of balls and other assets."""
    film = {"size": size, "outputs": outputs, **more.pop("film", {})}
    assets = [*(asset(ball) for ball in balls), *others]
    surround = {} if "environment" in more else {"background": background}
    data = {"camera": camera, "film": film, "trace": trace or {}, "assets": assets, **surround, **more}
    return Scene.model_validate(data)


def paper(**material):
    """Return the asset of the sheet."""
    return {"grid": "page.zarr.zip", "materials": [{"type": "diffuse", **material}]}


class Met(NamedTuple):
    """First hits: parameter (infinite for a miss), ball, place, outward normal."""

    t: np.ndarray
    ball: np.ndarray
    p: np.ndarray
    n: np.ndarray


def meet(balls, p, d, left):
    """Return first hits of rays that leave the ball `left` (-1: none); grazing ones may fall either way."""
    best, which = np.full(len(p), np.inf), np.full(len(p), -1)
    for k, ball in enumerate(balls):
        q = p - ball.centre
        b = np.sum(q * d, axis=1)
        gap = b * b - np.sum(q * q, axis=1) + ball.radius**2
        root = np.sqrt(np.maximum(gap, 0.0))
        for t in (-b - root, -b + root):
            closer = (gap > 0) & (t > np.where(left == k, 1e-9, 0.0)) & (t < best)
            best, which = np.where(closer, t, best), np.where(closer, k, which)
    hit = np.isfinite(best)
    at = p + np.where(hit, best, 0.0)[:, None] * d
    n = at - np.array([ball.centre for ball in balls])[which]
    return Met(best, which, at, n / np.linalg.norm(n, axis=1, keepdims=True))


def medium(balls, within):
    """Return the index of the last ball of glass that holds a point."""
    index = np.ones(len(within))
    for k, ball in enumerate(balls):
        index = np.where(within[:, k] & (ball.what == "glass"), ball.index, index)
    return index


def crossed(balls, d, met, within):
    """Return reflectance (1: total), the direction beyond, the balls that hold the place beyond."""
    inward = np.sum(d * met.n, axis=1) < 0
    here, beyond = within.copy(), within.copy()
    rows = np.arange(len(d))
    here[rows, met.ball], beyond[rows, met.ball] = ~inward, inward
    n1, n2 = medium(balls, here), medium(balls, beyond)
    toward = met.n * np.where(inward, 1.0, -1.0)[:, None]
    c1 = -np.sum(d * toward, axis=1)
    sine = n1 / n2 * np.sqrt(np.maximum(1 - c1 * c1, 0))
    total = (sine >= 1) & (n1 != n2)
    c2 = np.sqrt(np.where(total, 0.0, 1 - sine * sine))
    across, along = (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2), (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2)
    out = (n1 / n2)[:, None] * d + (n1 / n2 * c1 - c2)[:, None] * toward
    same = n1 == n2  # there is no surface
    share = np.where(total, 1.0, np.where(same, 0.0, (across**2 + along**2) / 2))
    return share, np.where(same[:, None], d, out), beyond


def mirrored(d, n):
    """Return mirrored directions."""
    return d - 2 * np.sum(d * n, axis=1, keepdims=True) * n


def held(balls, p):
    """Return which balls of glass hold points."""
    return np.stack([np.linalg.norm(p - b.centre, axis=1) < b.radius for b in balls], axis=1)


def radiance(balls, sky, rays, splits, hits):
    """Return the light along rays: both ways at the first `splits` surfaces, then only what passes.

    `sky(p, d)` is what leaves the balls; `hits` is how often a path may look for a surface.
    """
    p, d = rays
    state = (p, d, np.full(len(p), -1), held(balls, p), np.full(len(p), splits))
    return _light(balls, sky, state, hits)


def _light(balls, sky, state, hits):
    p, d, left, within, splits = state
    light = np.zeros(len(p))
    if hits == 0 or not len(p):
        return light
    met = meet(balls, p, d, left)
    out = np.isinf(met.t)
    light[out] = sky(p[out], d[out])

    def on(rows, share, towards, inside, remaining):
        there = (met.p[rows], towards, met.ball[rows], inside, remaining)
        light[rows] += share * _light(balls, sky, there, hits - 1)

    kinds = np.array([ball.what for ball in balls])[met.ball]
    rows = np.flatnonzero(~out & (kinds == "mirror"))
    on(rows, 1.0, mirrored(d[rows], met.n[rows]), within[rows], splits[rows])
    rows = np.flatnonzero(~out & (kinds == "glass"))
    chosen = Met(*(column[rows] for column in met))
    share, beyond, inside = crossed(balls, d[rows], chosen, within[rows])
    total, both = share == 1, (share > 0) & (share < 1) & (splits[rows] > 0)
    back = mirrored(d[rows], chosen.n)
    on(rows[total], 1.0, back[total], within[rows][total], splits[rows][total])
    on(rows[both], share[both], back[both], within[rows][both], splits[rows][both] - 1)
    one = ~total
    on(rows[one], 1 - share[one], beyond[one], inside[one], (splits[rows] - both)[one])
    return light


def straight(balls, rays, hits):
    """Follow the paths that pass wherever they can: places and directions with which they leave, and whether they do,
    whether any was mirrored totally."""
    p, d = (column.copy() for column in rays)
    left, within = np.full(len(p), -1), held(balls, p)
    alive, total = np.full(len(p), True), np.full(len(p), False)
    for _ in range(hits):
        rows = np.flatnonzero(alive)
        met = meet(balls, p[rows], d[rows], left[rows])
        alive[rows] = np.isfinite(met.t)
        met, rows = Met(*(column[np.isfinite(met.t)] for column in met)), rows[np.isfinite(met.t)]
        share, beyond, inside = crossed(balls, d[rows], met, within[rows])
        glass = np.array([ball.what == "glass" for ball in balls])[met.ball]
        on = glass & (share < 1)
        total[rows] |= glass & (share == 1)
        d[rows] = np.where(on[:, None], beyond, mirrored(d[rows], met.n))
        within[rows] = np.where(on[:, None], inside, within[rows])
        p[rows], left[rows] = met.p, met.ball
    return p, d, ~alive, total


def on_paper(p, d):
    """Return texture coordinates where rays meet the front of the sheet; NaN beside it."""
    (width, height), _, front = PAGE
    t = (front[2] - p[:, 2]) / np.where(d[:, 2] < 0, d[:, 2], np.nan)
    at = p + t[:, None] * d
    uv = np.stack([at[:, 0] / width + 0.5, at[:, 1] / height + 0.5], axis=1)
    return np.where(((uv > 0) & (uv < 1)).all(axis=1, keepdims=True), uv, np.nan)
