"""Grazing light: planes, the silhouette of a ball, the horizon; the narrowest pixels; the report's curved mirror.

In: an engine. Out: `CASES`. Footprints grow like 1 / cos; what a cosine keeps of its digits is derived, and beyond that
a footprint must still be finite and flagged.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from datasets_synthetic import shape
from datasets_synthetic.sheet import sheet
from sdfbake import Grid
from sdfbake.engine import Choice
from sdfrender import Camera, Flag, GridField, Rays, footprint
from validate.closed import ExactReference
from validate.course import Course, Step
from validate.stress.case import Case, Check
from validate.stress.optical import (
    BALL_NORMAL,
    BALL_RADIUS,
    PLANE_NORMAL,
    PLANE_PLACE,
    SLOPE,
    SPREAD,
    USELESS,
    PerRay,
    Vectors,
    Way,
    ball,
    field,
    flagged,
    frames,
    met,
    oblique,
    relative,
)

FAR = 3.0  # voxels from a ray's origin to the plane
# J = FAR / cos: the cosine is off by the normal's error, t by the place's over FAR.
GRAZE = PLANE_NORMAL + PLANE_PLACE / FAR


def _planes(choice: Choice) -> dict[str, tuple[GridField, Vectors, Vectors]]:
    """Fields of 16 samples along each axis, their normals, and a place on each."""
    x = np.arange(16.0)
    axial = np.broadcast_to((x - 7.25)[:, None, None], (16, 16, 16))
    n = SLOPE / 3.0
    return {
        "axial": (field(axial, (0.0, 0.0, 0.0), 1.0, choice), np.array([1.0, 0, 0]), np.array([7.25, 7.5, 7.5])),
        "oblique": (field(oblique(x) - 37.25, (0.0, 0.0, 0.0), 1.0, choice), n, np.full(3, 7.5) - 0.25 / 3 * n),
    }


def _grazing(n: Vectors, place: Vectors, cosine: PerRay, rng: np.random.Generator) -> tuple[Rays, Vectors, Vectors]:
    """Rays that meet a plane at given cosines, and the closed form of dp_dx and dp_dy there."""
    count = len(cosine)
    turn, move = rng.uniform(0, 2 * np.pi, count), rng.uniform(-2, 2, (2, count, 1))
    first = np.cross(n, [0.0, 0.6, 0.8])
    first /= np.linalg.norm(first)
    second = np.cross(n, first)
    along = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    aside = np.cross(n, along)
    c, s = cosine[:, None], np.sqrt((1 - cosine) * (1 + cosine))[:, None]
    d = s * along - c * n
    p = place + move[0] * first + move[1] * second - FAR * d
    zero = np.zeros_like(d)
    rays = Rays(p, d, zero, zero, SPREAD * (s * n + c * along), SPREAD * aside)
    return rays, SPREAD * FAR / c * along, SPREAD * FAR * aside


def _plane_error(steps: tuple[Step, ...], dp_dx: Vectors, dp_dy: Vectors) -> PerRay:
    at = steps[0].at
    return met(steps[0], np.maximum(relative(at.dp_dx, dp_dx), relative(at.dp_dy, dp_dy)))


def plane(choice: Choice) -> Iterator[Check]:
    """J against the closed form, cosine by cosine."""
    rng, eps = np.random.default_rng(1), choice.engine.eps
    planes = _planes(choice)
    surface, n, place = planes["axial"]
    for power in range(1, 9):
        rays, dp_dx, dp_dy = _grazing(n, place, np.full(16, 10.0**-power), rng)
        bound = GRAZE * eps * 10.0**power
        known = "float32 keeps no digit of so small a cosine: rounding of the normal is as large"
        yield Way.of(Course(surface), rays, choice).check(
            f"cos 1e-{power}: J against t / cos",
            "relative",
            min(bound, USELESS),
            partial(_plane_error, dp_dx=dp_dx, dp_dy=dp_dy),
            known=known if bound > USELESS else "",
        )
    surface, n, place = planes["oblique"]
    cosine = np.logspace(-1, -8, 96)
    rays, dp_dx, dp_dy = _grazing(n, place, cosine, rng)
    way = Way.of(Course(surface), rays, choice)
    yield way.check(
        "oblique plane: error of J, times cos",
        "relative",
        GRAZE * eps,
        lambda steps: cosine * _plane_error(steps, dp_dx, dp_dy),
    )
    yield from way.guards(rng, FAR)


def silhouette(choice: Choice) -> Iterator[Check]:
    """Rays at impact parameters b = 1 -+ delta, and b = 1 itself."""
    rng, eps = np.random.default_rng(2), choice.engine.eps
    delta = np.repeat(np.logspace(-1, -13, 25), 6)
    side = np.resize([1.0, 1.0, 1.0, 1.0, -1.0, -1.0], delta.size)
    b = np.append(1 - side * delta, np.ones(24))
    delta, side = np.append(delta, np.zeros(24)), np.append(side, np.zeros(24))
    d, e, aside = frames(rng, b.size)
    for vectors, shift in ((d, 0), (e, 1), (aside, 2)):  # a few of them along the axes
        vectors[-6:] = np.roll(np.concatenate([np.eye(3), -np.eye(3)]), shift, axis=1)
    rays = Rays(b[:, None] * e - 3.0 * d, d, e, aside, np.zeros_like(d), np.zeros_like(d))
    way = Way.of(Course(ball(choice)), rays, choice)
    decided = delta > 4 * BALL_RADIUS * eps  # what moves the surface, at both of its sides, and as much to spare
    cosine = np.sqrt(np.where(decided & (side > 0), delta * (1 + b), 1.0))

    def wrong(steps: tuple[Step, ...], among: PerRay) -> PerRay:
        return np.where(among, steps[0].hits.hit != (side > 0), False).astype(float)

    def stretch(steps: tuple[Step, ...]) -> PerRay:
        truth = e + (b / cosine)[:, None] * d
        error = np.maximum(relative(steps[0].at.dp_dx, truth), relative(steps[0].at.dp_dy, aside))
        return np.where(decided & (side > 0), cosine**2 * met(steps[0], error), 0.0)

    yield way.check("met inside the silhouette, missed outside", "count", 0.0, lambda steps: wrong(steps, decided))
    # cos^2 is off by twice the radius' error, cos by the normal's.
    yield way.check("error of J, times cos^2", "relative", (BALL_RADIUS + BALL_NORMAL) * eps, stretch)
    # Half a chord of a ball whose radius is too large by that.
    reach = np.sqrt(2 * 2 * BALL_RADIUS * eps)
    tangent = (side == 0) & np.ones(b.size, bool)
    yield way.check(
        "tangent ray: missed, or met near where it touches",
        "radius",
        float(reach),
        lambda steps: np.where(tangent & steps[0].hits.hit, np.linalg.norm(steps[0].at.p - e, axis=1), 0.0),
    )
    if choice.engine.precision == 32:
        known = "float32 moves the silhouette by 1e-5 of a radius: grazes shallower than that may fall either way"
        near = (side != 0) & ~decided
        yield way.check(
            "met or missed, closer to the silhouette than rounding", "count", 0.0, lambda s: wrong(s, near), known=known
        )
    yield from way.guards(rng)


HEIGHT = 0.125  # of the camera above the plane, voxels
SIDE = 24  # pixels


def horizon(choice: Choice) -> Iterator[Check]:
    """Pictures of an oblique plane from close above it, rolled, so that its horizon crosses pixels in every way."""
    rng, eps = np.random.default_rng(3), choice.engine.eps
    n = SLOPE / 3.0
    eye = np.full(3, 15.5) + HEIGHT * n
    surface = field(oblique(np.arange(32.0)) - 77.5, (0.0, 0.0, 0.0), 1.0, choice)
    cameras = []
    for d, up, _ in zip(*frames(rng, 4), strict=True):
        level = d - np.sum(d * n) * n
        cameras.append(Camera(tuple(eye), tuple(eye + level), tuple(up), 60.0, (SIDE, SIDE)))
    parts = [camera.rays() for camera in cameras]
    names = ("p", "d", "dp_dx", "dp_dy", "dd_dx", "dd_dy")
    rays = Rays(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    way = Way.of(Course(surface), rays, choice)
    least, greatest = (np.concatenate(sides) for sides in zip(*(_corners(c, n) for c in cameras), strict=True))
    cosine = -(rays.d @ n)

    def wrong(steps: tuple[Step, ...]) -> PerRay:
        # The linear pixel differs from the true one by the square of its width; so near 0 nothing is decided.
        open_ = np.minimum(np.abs(least), np.abs(greatest)) < (60.0 / SIDE / 57.0) * np.abs(cosine)
        crosses = (least < 0) & (greatest > 0)
        return np.where(steps[0].hits.hit & ~open_, flagged(steps[0], Flag.HORIZON) != crosses, False).astype(float)

    def stretch(steps: tuple[Step, ...]) -> PerRay:
        c, hit = np.where(cosine > 0, cosine, 1.0)[:, None], steps[0].hits.hit
        far = HEIGHT / c
        truths = [far * (dd + (dd @ n)[:, None] / c * rays.d) for dd in (rays.dd_dx, rays.dd_dy)]
        errors = [relative(a, b) for a, b in zip((steps[0].at.dp_dx, steps[0].at.dp_dy), truths, strict=True)]
        return np.where(hit, cosine * np.maximum(*errors), 0.0)

    yield way.check("HORIZON where a corner of the pixel looks above it", "count", 0.0, wrong)
    yield way.check(
        "some pixels see the horizon: share of those that do not",
        "share",
        0.999,
        lambda steps: np.full(len(rays), 1.0 - np.mean(flagged(steps[0], Flag.HORIZON))),
    )
    # The cosine is off by the normal's error, and by the place's over the way, which is HEIGHT / cos long.
    limit = (PLANE_NORMAL + PLANE_PLACE / HEIGHT) * eps
    yield way.check("error of J, times cos", "relative", limit, stretch)
    yield from way.guards(rng, HEIGHT)


def _corners(camera: Camera, n: Vectors) -> tuple[PerRay, PerRay]:
    """Least and greatest n . d over the four corners of every pixel, directions at unit depth."""
    view, right, down = camera.frame()
    y, x = np.mgrid[0:SIDE, 0:SIDE].reshape(2, -1).astype(float)
    corners = [
        (view @ n) + (x + i - SIDE / 2) * (right @ n) + (y + j - SIDE / 2) * (down @ n) for i in (0, 1) for j in (0, 1)
    ]
    return np.min(corners, axis=0), np.max(corners, axis=0)


WIDTHS = (1e-3, 1e-7, 1e-12)  # radians per pixel


def narrow(choice: Choice) -> Iterator[Check]:
    """The same rays with pixels of several widths."""
    rng, eps = np.random.default_rng(4), choice.engine.eps
    page = sheet((2.0, 2.0), 1.0)
    surface = GridField(Grid.from_function(page, 40), "bspline", choice)
    count = 100
    aim = np.concatenate([rng.uniform(-0.6, 0.6, (count, 2)), np.zeros((count, 1))], axis=1)
    p = np.array([0.0, 0.0, 1e3]) * [1, 1, 1] + rng.normal(size=(count, 3)) * [500, 500, 100]
    d = aim - p
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    across = np.cross(d, [0.6, 0.8, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    aside, zero = np.cross(d, across), np.zeros((len(WIDTHS) * count, 3))
    p, d, across, aside = (np.tile(vectors, (len(WIDTHS), 1)) for vectors in (p, d, across, aside))
    width = np.repeat(WIDTHS, count)[:, None]
    rays = Rays(p, d, zero, zero, width * across, width * aside)
    truth, _ = ExactReference(page).transfer(rays)
    way = Way.of(Course(surface), rays, choice)

    def prints(steps: tuple[Step, ...]) -> Vectors:
        found = footprint(surface, steps[0].hits, steps[0].at)
        return np.concatenate([found.duv_dx, found.duv_dy], axis=1)

    def scaling(steps: tuple[Step, ...]) -> PerRay:
        wide = np.tile(prints(steps)[:count] / WIDTHS[0], (len(WIDTHS), 1))
        return relative(prints(steps) / width, wide)

    # Linear in the pixel's width: some 30 products and sums, each rounded relative to terms as wide as the pixel.
    yield way.check("J per radian, against that of the widest", "relative", 64 * eps, scaling)
    # uv on the page is affine, and stored in float32: 2^-24 over a gradient of 1/2 per 0.07; the engine's sum of taps.
    spacing = surface.grid.lattice.spacing
    limit = (2.0**-24 + 30 * eps / 2) * 2 * 2 / spacing
    exact = np.concatenate([truth.duv_dx, truth.duv_dy], axis=1)
    yield way.check("J against the closed form", "relative", limit, lambda s: met(s[0], relative(prints(s), exact)))
    yield from way.guards(rng)


def page(choice: Choice) -> Iterator[Check]:
    """The report's scene at 64 samples."""
    rng, scene = np.random.default_rng(5), shape("mirror")
    surface = GridField(Grid.from_function(scene, 64), "bspline", choice)
    rays = Camera((0.0, 0.0, 1.9), (0.0, 0.0, 0.0), fov=28.0, size=(40, 40)).rays()
    first, second = ExactReference(scene).follow(rays, 1)
    slope = np.abs(np.sum(first.n * rays.d, axis=1))
    inner = np.all(np.abs(second.uv - 0.5) < 0.4, axis=1)  # four voxels from the page's edges
    clear = first.hit & second.hit & (first.part == 0) & (second.part == 1) & (slope > 0.3) & inner
    rays = rays.where(np.flatnonzero(clear))
    exact = np.concatenate([second.duv_dx, second.duv_dy], axis=1)[clear]
    way = Way.of(Course(surface, (None,)), rays, choice)

    def error(steps: tuple[Step, ...]) -> PerRay:
        found = footprint(surface, steps[1].hits, steps[1].at)
        return met(steps[1], relative(np.concatenate([found.duv_dx, found.duv_dy], axis=1), exact))

    # The Hessian of a cubic B-spline is off by h^2 / 12 of the fourth derivative, 3 / r^3 here: (h / r)^2 / 4 of the
    # curvature, which makes up the reflected footprint; as much for the normal's error at slopes above 0.3. Float32
    # adds 30 u of taps of 2 sqrt(3) h times 4 / h^2.
    spacing = surface.grid.lattice.spacing
    limit = (spacing / 0.8) ** 2 / 2 + 30 * choice.engine.eps / 2 * 3.5 * 4 * 0.8 / spacing
    yield way.check("J on the page through the mirror, against the closed form", "relative", limit, error)
    yield way.check(
        "texture coordinates on the page",
        "share",
        (spacing / 0.8) ** 3,
        lambda s: met(s[1], np.linalg.norm(footprint(surface, s[1].hits, s[1].at).uv - second.uv[clear], axis=1)),
    )
    yield from way.guards(rng)


CASES = (
    Case(
        "plane-grazing",
        "A plane at cosines of 1e-1 to 1e-8",
        "The footprint is t / cos long, whatever the cosine. The plane's normal is rounded, so the relative error may "
        "grow like eps / cos and no faster, and nothing may be infinite.",
        plane,
    ),
    Case(
        "sphere-silhouette",
        "The silhouette of a ball, and rays that touch it",
        "A ray that passes a ball inside its silhouette meets it and one outside does not, down to the rounding of the "
        "radius; J grows like 1 / cos. A ray that just touches may fall either way, but with finite numbers.",
        silhouette,
    ),
    Case(
        "horizon",
        "A footprint across the horizon",
        "Where some ray of a pixel runs along the tangent plane, no linear footprint describes the pixel: HORIZON must "
        "say so there and nowhere else, and J must stay the finite one of the pixel's centre.",
        horizon,
    ),
    Case(
        "narrow-pixels",
        "Pixels 1e-7 radians wide and narrower",
        "A footprint is linear in the pixel's width: it keeps all its digits however narrow the pixel, in float32 too, "
        "where offset rays would have none.",
        narrow,
    ),
    Case(
        "mirror-page",
        "The mirror ball and the page (Galim 2018)",
        "The footprint on the page seen through the ball is that of the closed form, to the kernel's error of "
        "curvature at 64 samples, (h / r)^2 / 2.",
        page,
    ),
)
