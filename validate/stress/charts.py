"""Atlases that are hard: cuts, hundreds of charts, corners of three, poles, triangles without area; wild footprints.

In: an engine. Out: cases. What is right is what the mesh's own faces say at the hit (`validate.exactuv`), and every
representation of texture coordinates is held against it: `faces`, which must be exact; `layers`, right but for what
trilinear interpolation does; `grid`, the seed's, which cannot be right across cuts, and must say where (SEAM).
"""

from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np
from jaxtyping import Bool, Float

from datasets_synthetic import shape
from datasets_synthetic.box import Box
from sdfbake import Mesh
from sdfbake.engine import Choice
from sdfbake.metadata import MODES
from validate.beam import MeshRays
from validate.facets import unit
from validate.stress import atlases
from validate.stress.case import Case, Check
from validate.stress.lookups import LOOKUPS
from validate.stress.sights import TEXELS, Probe, Sight, Subject, aimed, joined, on_faces

HALF = 0.5  # voxels: so near a cut `layers` may speak for either side
PIXEL = 1e-3  # side of a pixel, world units
AIMED = 200  # rays at the places that a case is about
BACK = 3.0  # voxels from a place to where its ray starts
CODES = 2**16 - 1  # per range of a chart, in `layers`
# Rounding of a footprint's entry: three products and their sum, and as many when G was projected and scaled.
PRODUCT = 16
FARTHER = 0.1  # voxels: of faces beyond, none is asked what it says
ONE_INTERPOLANT = "one interpolant serves both sides of a cut (Galim 2018, eq. 22)"

MESHES: dict[str, Callable[[], Mesh]] = {
    "wrapped": atlases.wrapped,
    "halved": atlases.halved,
    "patches": partial(atlases.patchwork, 0.2),
    "small patches": partial(atlases.patchwork, 0.05),
    "box": partial(shape("box").mesh, 0.2),
    "polar": atlases.polar,
    "slivers": atlases.slivers,
}


@cache
def subject(name: str) -> Subject:
    """One of `MESHES`, baked; slivers at a voxel that shows what they do to the search for the closest face."""
    return Subject.of(MESHES[name](), 32 if name == "slivers" else None)


def at_faces(of: Subject, which: Bool[np.ndarray, " f"], seed: int) -> MeshRays:
    """Rays at places on some faces, however small, each from its own side."""
    rng = np.random.default_rng(seed)
    p, n = on_faces(of.mesh, rng.choice(np.flatnonzero(which), AIMED), rng)
    return aimed(p, n, PIXEL, BACK * of.spacing)


def exact(of: Subject, choice: Choice, beam: MeshRays, name: str = "") -> Iterator[Check]:
    """What must hold of `faces` wherever faces have an area: texture coordinates, chart and footprint of the mesh."""
    probe = Probe(of, "faces", choice, beam, of.rounding(choice))
    eps, double = choice.engine.eps, np.finfo(np.float64).eps
    # The place's rounding times the steepest texture; then sums of products of coordinates up to 1.
    texels = TEXELS * (of.steepest * of.rounding(choice) + 8 * eps)
    yield probe.check(f"{name}uv of the closest face", "texel", texels, Sight.uv_error)
    yield probe.check(f"{name}chart of a closest face", "count", 0.0, Sight.wrong_chart)
    # Edges are differences of places up to N / 2 voxels in float64, in both routes; a gradient has two.
    relative = PRODUCT * eps + 2 * of.samples * double / of.edge
    yield probe.check(f"{name}J against G dp", "relative", relative, Sight.jacobian_error)


def seams(
    of: Subject, choice: Choice, beam: MeshRays, off: float, name: str = "", *, told: bool = True
) -> Iterator[Check]:
    """What `grid` cannot do, as a share of the rays; and that none is wrong, by more than `off` texels, in silence."""
    probe = Probe(of, "grid", choice, beam, HALF * of.spacing)

    def wrong(seen: Sight) -> Float[np.ndarray, " n"]:
        return (seen.uv_error(turns=True) > off).astype(np.float64)

    def silent(seen: Sight) -> Float[np.ndarray, " n"]:
        return np.where(seen.seam, 0.0, wrong(seen))

    yield probe.share(f"{name}wrong", 0.0, wrong, ONE_INTERPOLANT)
    if told:
        yield probe.check(f"{name}wrong without SEAM", "count", 0.0, silent)
    else:
        why = "SEAM tells one chart from another, and here a chart touches itself: unwrap it into two"
        yield probe.share(f"{name}wrong without SEAM", 0.0, silent, why)


# ---- a chart that goes round -----------------------------------------------------------------------------------------
def _wrap(choice: Choice) -> Iterator[Check]:
    of = subject("wrapped")
    uv = of.exact.facets.uv
    at_cut = (np.abs(uv.mean(axis=1) - 0.5) > 0.46).any(axis=1)
    beam = joined(of.camera(), at_faces(of, at_cut, 1))
    yield from exact(of, choice, beam)
    texels, slope = _round(of)
    layers = Probe(of, "layers", choice, beam, HALF * of.spacing)
    yield layers.check("uv, modulo 1", "texel", texels, partial(Sight.uv_error, turns=True))
    yield layers.check("J against G dp", "relative", slope, Sight.jacobian_error)
    yield from seams(of, choice, beam, texels, told=False)
    yield from seams(subject("halved"), choice, beam, texels, "in four charts, ")


def _round(of: Subject) -> tuple[float, float]:
    """How far a trilinear interpolant is from the torus's map: uv in texels, and slopes as a share.

    An angle about an axis at distance r has second derivatives whose magnitudes add up to 2 / r^2: h^2 / 8 of that is
    lost in the value, and h / r of the slope. Where two faces meet at an angle, a sample up to a diagonal of a voxel
    from them has its foot off that of the smooth surface by half the angle times its distance.
    """
    h, turn = of.spacing, 2 * np.pi
    inner, tube = atlases.MAJOR - atlases.MINOR, atlases.MINOR
    smooth = h * h / 8 * 2 * (inner**-2 + tube**-2) / turn
    angle = turn / 32  # of the faces around the tube, the coarser way
    faceted = angle / 2 * np.sqrt(3) * h / (turn * tube)
    return TEXELS * (smooth + faceted), h / tube + np.sqrt(3) * angle


# ---- more charts than cells can hold ---------------------------------------------------------------------------------
def _patches(choice: Choice) -> Iterator[Check]:
    of = subject("patches")
    beam = joined(of.camera(), at_faces(of, np.ones(len(of.mesh.faces), bool), 2))
    yield from exact(of, choice, beam)
    layers = Probe(of, "layers", choice, beam, HALF * of.spacing)
    # A chart goes on past its border where the closest face is another's: by half a voxel of its gradient.
    off = TEXELS * of.steepest * HALF * of.spacing
    yield layers.check("uv", "texel", off, Sight.uv_error)
    yield layers.check("chart of a face within half a voxel", "count", 0.0, Sight.wrong_chart)
    # Slopes of affine maps are exact but for their codes: one unit a voxel, of the chart's range and its margins.
    slope = np.sqrt(2) * (0.2 / of.spacing + 6) / CODES
    yield layers.check("J against G dp", "relative", slope, Sight.jacobian_error)
    yield from seams(of, choice, beam, off)

    of = subject("small patches")
    beam = joined(of.camera(), at_faces(of, np.ones(len(of.mesh.faces), bool), 3))
    yield from exact(of, choice, beam, "charts of a voxel, ")
    why = "borders are known to a fraction of a voxel, and a cell keeps three charts of four and more that meet in it"
    layers = Probe(of, "layers", choice, beam, of.rounding(choice))
    yield layers.share("charts of a voxel, in another than the closest face's", 0.0, Sight.wrong_chart, why)
    off = TEXELS * of.steepest * HALF * of.spacing
    yield from seams(of, choice, beam, off, "charts of a voxel, ")


# ---- a corner of three charts ----------------------------------------------------------------------------------------
def _corner(choice: Choice) -> Iterator[Check]:
    of, box = subject("box"), shape("box")
    assert isinstance(box, Box)
    corner, rng = box.half, np.random.default_rng(4)
    # On each of the three faces, up to a voxel and a half from the corner; seen along the diagonal, more or less.
    p = corner - 1.5 * of.spacing * rng.random((AIMED, 3)) * (1 - np.eye(3)[np.arange(AIMED) % 3])
    beam = aimed(p, unit(1.0 + 0.3 * rng.normal(size=(AIMED, 3))), PIXEL, BACK * of.spacing)
    yield from exact(of, choice, beam)
    layers = Probe(of, "layers", choice, beam, HALF * of.spacing)

    def continued(seen: Sight) -> Float[np.ndarray, " n"]:
        off = seen.found.uv - box.net.uv(seen.found.chart, seen.at.p)
        return np.asarray(TEXELS * np.linalg.norm(off, axis=1))

    # Half a code of a range, at most all of the texture, both ways; and the place's rounding.
    off = TEXELS * (0.5 * np.sqrt(2) / CODES + of.steepest * of.rounding(choice) + 8 * choice.engine.eps)
    yield layers.check("uv on its chart, in closed form", "texel", off, continued)
    yield layers.check("chart of a face within half a voxel", "count", 0.0, Sight.wrong_chart)
    yield from seams(of, choice, beam, TEXELS * of.steepest * HALF * of.spacing)


# ---- a pole ----------------------------------------------------------------------------------------------------------
def _pole(choice: Choice) -> Iterator[Check]:
    of, rng = subject("polar"), np.random.default_rng(6)
    first = atlases.colatitudes()[0]
    theta = first * (0.1 / first) ** rng.random(AIMED)
    phi = 2 * np.pi * rng.random(AIMED)
    n = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    near = aimed(atlases.SPHERE * n, n, PIXEL, BACK * of.spacing)
    yield from exact(of, choice, joined(of.camera(), near))
    faces = Probe(of, "faces", choice, near, of.rounding(choice))
    # Half a quarter octave of sines in a row of triangles, the chord of an angle for its arc, and, in the smallest
    # ones, what rounding moves.
    step = 2 * np.pi / atlases.FEW
    row = first * (1 - 2**-0.25) * atlases.SPHERE
    growth = 2**0.25 * step / np.sin(step) - 1 + 2 * of.rounding(choice) / row
    yield faces.check("|du| as 1 / (2 pi r sin)", "relative", growth, partial(_growth, of))
    axis = np.array([[0.0, 0.0, 1.0]])
    pole = Probe(of, "faces", choice, aimed(atlases.SPHERE * axis, axis, PIXEL, BACK * of.spacing), of.rounding(choice))
    # The triangles at the pole are flat: there |du| is that of the first row's chords.
    cap = 1 / (atlases.FEW * 2 * atlases.SPHERE * np.sin(first) * np.sin(step / 2))
    bound = PRODUCT * choice.engine.eps + 2 * of.samples * np.finfo(np.float64).eps / of.edge
    # The field's normal at the pole is off the triangle's by the slope of the cap and by what the kernel makes of it.
    tilt = (first + of.spacing**2) ** 2
    yield pole.check("|du| at the pole itself", "relative", bound + tilt, lambda seen: np.abs(_du(seen) / cap - 1))
    why = "a trilinear cell cannot follow 1 / sin within itself"
    layers = Probe(of, "layers", choice, near, of.rounding(choice))
    yield layers.check("J against G dp, within two voxels", "relative", 0.2, Sight.jacobian_error, why)
    yield layers.check("numbers that are none", "count", 0.0, Sight.unusable)


def _du(seen: Sight) -> Float[np.ndarray, " n"]:
    """Length of the gradient of u, seen by pixels that are square on the surface."""
    return np.asarray(np.hypot(seen.found.duv_dx[:, 0], seen.found.duv_dy[:, 0]) / PIXEL)


def _growth(of: Subject, seen: Sight) -> Float[np.ndarray, " n"]:
    """How far |du| is from the sphere's at the foot of the hit; 0 in the triangles at the pole, which are flat."""
    truth = of.exact.at(seen.at.p)
    foot = np.einsum("nk,nkd->nd", truth.barycentric, of.mesh.vertices[of.mesh.faces[truth.face]])
    at_pole = (of.mesh.faces[truth.face] >= len(of.mesh.vertices) - 2).any(axis=1)
    return np.where(at_pole, 0.0, np.abs(_du(seen) * 2 * np.pi * np.hypot(foot[:, 0], foot[:, 1]) - 1))


# ---- triangles that are hardly there ---------------------------------------------------------------------------------
def _slivers(choice: Choice) -> Iterator[Check]:
    of = subject("slivers")
    facets = of.exact.facets
    area = np.linalg.norm(np.cross(*np.moveaxis(np.diff(facets.corners, axis=1), 1, 0)), axis=1)
    texture = np.abs(np.linalg.det(np.diff(facets.uv, axis=1)))
    thin = (area < 1e-6 * np.median(area)) | (texture < 1e-6 * np.median(texture))
    beam = joined(of.camera(), at_faces(of, thin, 7), at_faces(of, ~thin, 8))
    for mode in MODES:
        probe = Probe(of, mode, choice, beam, of.rounding(choice))
        yield probe.check("numbers that are none", "count", 0.0, Sight.unusable)
    near = Probe(of, "faces", choice, beam, FARTHER * of.spacing)
    why = "the search steps over shared vertices: past a band of slivers it does not see a face that is a little nearer"
    limit = of.rounding(choice) / of.spacing
    yield near.check("how much farther the face is whose uv is found", "voxel", limit, partial(_farther, of), why)


def _farther(of: Subject, seen: Sight) -> Float[np.ndarray, " n"]:
    """How much farther than the closest face that is whose corners' box has the texture coordinates found, voxels."""
    read = seen.readings
    corners, found = of.exact.facets.uv[read.face], seen.found.uv[read.point]
    # Weights of a face's corners are not negative and sum to 1, in float32 too, to a unit or two.
    slack = 8 * np.finfo(np.float32).eps
    inside = ((found >= corners.min(axis=1) - slack) & (found <= corners.max(axis=1) + slack)).all(axis=1)
    closest = read.least(read.distance)
    excess = (read.distance - closest[read.point]) / of.spacing
    return read.least(np.where(inside, excess, FARTHER))


CASES: tuple[Case, ...] = (
    Case(
        "chart-wraps",
        "A chart that goes round and touches itself",
        "Where u runs over the cut from 1 to 0, both sides keep their own texture coordinates and footprints, and "
        "nothing between 0 and 1 is smeared in: no representation but `grid` interpolates across a cut.",
        _wrap,
    ),
    Case(
        "many-charts",
        "Hundreds of charts, down to one voxel each",
        "However many charts there are, `faces` has the uv, the chart and the footprint of the closest face to "
        "rounding, as it asks the faces themselves; `layers` does while no more than three charts meet in a cell.",
        _patches,
    ),
    Case(
        "three-chart-corner",
        "The corner of a box, where three charts meet",
        "Each hit takes one of the three charts, that of the closest face, and none is mixed with another: the charts "
        "are affine, so the right answer is known in closed form.",
        _corner,
    ),
    Case(
        "pole",
        "The pole of a sphere in longitude and latitude",
        "|du| grows as 1 / sin of the colatitude, over three decades and triangles of a thousandth of a voxel, and "
        "ends at the pole itself: there the triangles have a gradient like any other.",
        _pole,
    ),
    Case(
        "no-area",
        "Triangles without area, in space and in the texture",
        "Slivers 1e-8 as wide as long, and triangles whose texture is a line or a point, give finite footprints and "
        "the texture coordinates of the closest face; an undefined level of detail is recorded as that of no extent.",
        _slivers,
    ),
    *LOOKUPS,
)
