"""Footprints through 0, 1, 2 and 3 bounces, mirrors and glass, against closed forms; and the mirrored sphere.

In: nothing from the build: grids are sampled from exact shapes, so that facets do not speak for the method. Out: per
way, kernel, resolution and number of bounces an error run: the footprint on the surface, J = [dp/dx dp/dy], relative to
the closed form's, and the defects of the identities. How far that truth itself can be trusted is measured by displaced
rays, and what the optics add without a grid by the exact shape in its place.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from datasets_synthetic import shape
from sdfbake.grid import Grid
from sdfrender import Camera, Field, GridField, Rays, reflect, transfer
from validate.beam import Beam, MeshRays, displace, only
from validate.closed import Event, ExactHits, ExactReference
from validate.course import Course, defects, follow
from validate.displaced import richardson
from validate.exact import ShapeField
from validate.experiment import Bench, Run, guarded
from validate.metrics import summary

INDEX = 1.5
# Footprints grow as 1 / |d . n| towards grazing, before a surface or behind it, and have no bound there: rays that come
# nearer to grazing than this at any of their surfaces are left out, and the report says how many.
SLOPE = 0.2
SIZE, RESOLUTIONS = 96, (64, 128, 256)
QUICK_SIZE, QUICK_RESOLUTIONS = 24, (24, 32)
RIVALS = ("linear", "catmull-rom")  # at the middle resolution only
FEW = 5  # one ray in so many goes the ways that take long: through exact shapes, displaced and with perturbations
ENGINE = "auto"  # the quickest one, in float64
EXACT, TRUTH = "exact shape", "displaced rays"
# The mirrored sphere: its picture, how far from the silhouette, pixels, and the wall around it that mirrored rays meet.
PICTURE, QUICK_PICTURE, CLEAR, WALL = 256, 64, 5.0, 4.0
SPHERE = "sphere, mirrored beam"


@dataclass(frozen=True, slots=True)
class Way:
    """A camera before (or in) a shape, and what the surfaces that its rays meet do."""

    name: str
    shape: str
    place: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float
    events: tuple[Event, ...]

    def rays(self, size: int) -> Beam:
        """Rays through all pixels of a square picture."""
        return Camera(self.place, self.target, fov=self.fov, size=(size, size)).rays()


MIRRORS, GLASS = (None, None, None), (INDEX, INDEX, INDEX)
INNER = (INDEX, None, None)  # into the glass, and mirrored by its inside: what makes a rainbow
WAYS = (
    Way("sphere, mirrors seen from inside", "sphere", (0.3, 0.2, -0.1), (0.0, 0.0, 1.0), 60.0, MIRRORS),
    Way("torus, mirrors seen from inside", "torus", (0.7, 0.0, 0.1), (0.7, 1.0, 0.0), 60.0, MIRRORS),
    Way("sphere and page, mirrors", "mirror", (0.0, 0.0, 1.9), (0.0, 0.0, 0.0), 20.0, MIRRORS),
    Way("sphere, glass and its inner mirror", "sphere", (0.3, 0.4, 3.2), (0.0, 0.0, 0.0), 28.0, INNER),
    Way("ellipsoid, glass and its inner mirror", "ellipsoid", (0.9, 1.2, 3.2), (0.0, 0.0, 0.0), 28.0, INNER),
    Way("torus, glass", "torus", (2.6, 0.0, 0.3), (0.0, 0.0, 0.0), 36.0, GLASS),
)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is true after each number of bounces k: the footprint, where there is one, and which rays count.

    Attributes
    ----------
    jacobian
        (k, n, 3, 2): [dp/dx dp/dy] on the surface, world units per pixel.
    hit, clear
        (k, n): rays that have met a surface so often; those of them that never came near grazing.
    """

    jacobian: Float[np.ndarray, "k n 3 2"]
    hit: Bool[np.ndarray, "k n"]
    clear: Bool[np.ndarray, "k n"]

    def at(self, rows: Int[np.ndarray, " m"]) -> "Truth":
        """The same for some of the rays."""
        return Truth(self.jacobian[:, rows], self.hit[:, rows], self.clear[:, rows])


def run(bench: Bench) -> Iterator[Run]:
    """The mirrored sphere, then every way: its truth's own error, the exact shape, and grids."""
    size, resolutions = (QUICK_SIZE, QUICK_RESOLUTIONS) if bench.quick else (SIZE, RESOLUTIONS)
    bench.progress("footprints of the mirrored sphere")
    for resolution, kernel in setups(resolutions, at=0):
        blank = Run("bounces", SPHERE, {"kernel": kernel}, {"resolution": resolution}, "error")
        yield guarded(blank, partial(_mirrored, blank, QUICK_PICTURE if bench.quick else PICTURE))
    for way in WAYS:
        bench.progress(f"footprints through bounces: {way.name}")
        rays = way.rays(size)
        truth = closed_truth(way, rays)
        few = np.flatnonzero(truth.clear[0])[::FEW]
        yield from _trusted(way, only(rays, few), truth.at(few))
        yield from _steps(way, only(rays, few), truth.at(few), EXACT, None)
        for resolution, kernel in setups(resolutions):
            yield from _steps(way, rays, truth, kernel, resolution)


def setups(resolutions: tuple[int, ...], at: int = 1) -> list[tuple[int, str]]:
    """The B-spline at all resolutions, the others at one."""
    return [(n, "bspline") for n in resolutions] + [(resolutions[at], kernel) for kernel in RIVALS]


@lru_cache(maxsize=3)
def _grid(name: str, resolution: int) -> Grid:
    return Grid.from_function(shape(name), resolution, uv_mode="none")


def closed_truth(way: Way, rays: Beam) -> Truth:
    """Follow a way over the exact shape in closed form."""
    count, hops = len(rays.p), len(way.events) + 1
    jacobian, hit, clear = np.zeros((hops, count, 3, 2)), np.zeros((hops, count), bool), np.zeros((hops, count), bool)
    good = np.ones(count, bool)
    for k, step in enumerate(ExactReference(shape(way.shape)).steps(rays, way.events)):
        met = step.alive[step.hits.hit]
        hit[k, met] = True
        jacobian[k, step.alive] = footprints(step.at)
        before, behind = (np.abs(np.sum(step.hits.n * d, axis=1)) for d in (step.at.d, step.after.d))
        steep = np.zeros(count, bool)
        steep[step.alive] = before > SLOPE
        clear[k] = good & steep & hit[k]
        steep[step.alive] &= behind > SLOPE
        good &= steep
    return Truth(jacobian, hit, clear)


def footprints(rays: Beam) -> Float[np.ndarray, "n 3 2"]:
    """J = [dp/dx dp/dy] of rays at a surface."""
    return np.stack([rays.dp_dx, rays.dp_dy], axis=2)


def _blank(way: Way, setup: str, resolution: int | None, bounces: int) -> Run:
    knob: dict[str, float | int] = {"bounces": bounces}
    if resolution is not None:
        knob["resolution"] = resolution
    return Run("bounces", way.name, {"kernel": setup}, knob, "error")


def _trusted(way: Way, rays: Beam, truth: Truth) -> Iterator[Run]:
    """How far the closed forms lie from displaced rays, and how far those can be trusted; both relative to J."""
    reference, hops = ExactReference(shape(way.shape)), len(way.events) + 1
    size = np.linalg.norm(truth.jacobian, axis=(2, 3)).T
    middle = _places(reference, rays, way.events)

    def outputs(dx: float, dy: float) -> Float[np.ndarray, "n k"]:
        near = _places(reference, displace(rays, dx, dy), way.events)
        # What lands a hundred footprints away has met another surface on its way.
        stray = np.linalg.norm(near - middle, axis=2) > 100 * (abs(dx) + abs(dy)) * size
        return np.where(stray[..., None], np.nan, near).reshape(len(near), -1)

    def measured(blank: Run, k: int) -> Run:
        ours, bar, theirs = truth.jacobian[k], columns(found.error_dx, found.error_dy, k), columns(*derivative, k)
        good = truth.clear[k] & np.isfinite(bar).all(axis=(1, 2))
        values = {"rays": float(truth.clear[k].sum()), "compared": float(good.sum())}
        for name, gap in (("difference", ours - theirs), ("bar", bar)):
            share = np.linalg.norm(gap[good], axis=(1, 2)) / size[good, k]
            values |= {f"{name}.{key}": figure for key, figure in summary(share, ()).items()}
        return replace(blank, values=values)

    def columns(dx: np.ndarray, dy: np.ndarray, k: int) -> Float[np.ndarray, "n 3 2"]:
        return np.stack([dx, dy], axis=2)[:, 3 * k : 3 * k + 3]

    # Steps of a hundredth of a pixel: the bar falls as their fourth power, and rounding is 1e-15 over them.
    found = richardson(outputs, step=0.004)
    derivative = found.d_dx, found.d_dy
    for k in range(hops):
        blank = _blank(way, TRUTH, None, k)
        yield guarded(blank, partial(measured, blank, k))


def _places(reference: ExactReference, rays: Beam, events: tuple[Event, ...]) -> Float[np.ndarray, "n k 3"]:
    """Where rays meet one surface after the other; NaN from where they meet none."""
    hops = reference.follow(rays, events)
    return np.stack([np.where(hop.hit[:, None], hop.p, np.nan) for hop in hops], axis=1)


def _steps(way: Way, rays: Beam, truth: Truth, setup: str, resolution: int | None) -> Iterator[Run]:
    """A field against the closed forms, bounce by bounce, traced once."""
    traced = lru_cache(maxsize=1)(partial(_traced, way, rays, truth, setup, resolution))

    def measured(blank: Run, k: int) -> Run:
        return replace(blank, values=traced()[k])

    for k in range(len(way.events) + 1):
        blank = _blank(way, setup, resolution, k)
        yield guarded(blank, partial(measured, blank, k))


def _traced(way: Way, rays: Beam, truth: Truth, setup: str, resolution: int | None) -> list[dict[str, float]]:
    field: Field
    figures: dict[str, float] = {"slope": SLOPE}
    if resolution is None:
        field = ShapeField(shape(way.shape))
    else:
        grid = _grid(way.shape, resolution)
        field, figures["spacing"] = GridField(grid, setup, ENGINE, 64), grid.lattice.spacing
    course = Course(field, way.events)
    chosen = np.flatnonzero(truth.clear[0])[:: 1 if resolution is None else FEW]
    kept = defects(course, only(rays, chosen), np.random.default_rng(41))
    ours, found = np.ones(len(rays.p), bool), []
    for k, step in enumerate(follow(course, rays)):
        differ = step.hits.hit & ours != truth.hit[k]
        ours &= step.hits.hit
        both = ours & truth.clear[k]
        values = figures | {
            "pixels": float(both.sum()),
            "left_out": 1.0 - _share(truth.clear[k], truth.hit[k]),
            "missed": _share(differ, truth.clear[k] | (ours & ~truth.hit[k])),
        }
        values |= {f"jacobian.{key}": v for key, v in relative(footprints(step.at), truth.jacobian[k], both).items()}
        among = truth.clear[k][chosen] & kept.hit[k]
        for name, defect in (
            ("symplectic", kept.symplectic),
            ("direction", kept.direction),
            ("surface", kept.surface),
        ):
            values[f"{name}.max"] = float(defect[k][among].max(initial=0.0))
        found.append(values)
    return found


def relative(
    ours: Float[np.ndarray, "n 3 2"], truth: Float[np.ndarray, "n 3 2"], among: Bool[np.ndarray, " n"]
) -> dict[str, float]:
    """Sum up ||J - J*|| / ||J*|| over some rays."""
    size = np.linalg.norm(truth[among], axis=(1, 2))
    return summary(np.linalg.norm((ours - truth)[among], axis=(1, 2)) / np.where(size > 0, size, 1.0), ())


def _share(what: Bool[np.ndarray, " n"], among: Bool[np.ndarray, " n"]) -> float:
    return float(what[among].mean()) if among.any() else 0.0


@lru_cache(maxsize=1)
def _mirror(size: int) -> tuple[Rays, ExactHits, MeshRays]:
    """A camera on the exact sphere: its rays, what they hit, and the mirrored rays, in closed form."""
    rays = Camera((0.3, 0.4, 3.2), (0.0, 0.0, 0.0), fov=35.0, size=(size, size)).rays()
    reference = ExactReference(shape("sphere"))
    hits, at = reference.transfer(rays)
    return rays, hits, reference.reflect(hits, at)


def _mirrored(blank: Run, size: int) -> Run:
    """The mirrored beam's footprint on a distant environment, and on a wall around, away from the silhouette."""
    rays, hits, truth = _mirror(size)
    grid = _grid("sphere", int(blank.knob["resolution"]))
    field = GridField(grid, blank.setup["kernel"], ENGINE, 64)
    met, there = transfer(field, rays)
    ours = reflect(field, met, there)
    both = hits.hit & met.hit
    # Away from the silhouette: more than CLEAR pixels from the nearest one that either of the two does not hit.
    away = distance_transform_edt(both.reshape(size, size)).ravel() > CLEAR
    values = {
        "pixels": float(away.sum()),
        "left_out": 1.0 - _share(away, both),
        "missed": float(np.mean(hits.hit != met.hit)),
        "spacing": grid.lattice.spacing,
    }
    for name, look in (("environment", turning), ("wall", partial(on_wall, radius=WALL))):
        figures = relative(look(_where(ours, away)), look(_where(truth, away)), np.ones(int(away.sum()), bool))
        values |= {f"{name}.{key}": figure for key, figure in figures.items()}
    return replace(blank, values=values)


def _where(rays: Beam, chosen: Bool[np.ndarray, " n"]) -> MeshRays:
    return only(rays, np.flatnonzero(chosen))


def turning(rays: Beam) -> Float[np.ndarray, "n 3 2"]:
    """J = [dd/dx dd/dy]: the footprint on an environment so far away that places do not count."""
    return np.stack([rays.dd_dx, rays.dd_dy], axis=2)


def on_wall(rays: Beam, radius: float) -> Float[np.ndarray, "n 3 2"]:
    """J = [dp/dx dp/dy] where rays from within a ball about the origin meet it."""
    along = np.sum(rays.p * rays.d, axis=1)
    t = np.sqrt(along**2 + radius**2 - np.sum(rays.p**2, axis=1)) - along
    n = (rays.p + t[:, None] * rays.d) / radius
    slope = np.sum(n * rays.d, axis=1, keepdims=True)
    moved = (rays.dp_dx + t[:, None] * rays.dd_dx, rays.dp_dy + t[:, None] * rays.dd_dy)
    return np.stack([v - np.sum(n * v, axis=1, keepdims=True) / slope * rays.d for v in moved], axis=2)
