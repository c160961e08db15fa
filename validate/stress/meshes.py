"""Meshes that are no closed, oriented, simple surfaces: refused in one sentence, mended, or their wrong signs counted.

In: nothing, as no ray is traced here. Out: cases. Every mesh is a solid that is known (a union of
convex polytopes, whose inside is a few inequalities) broken in one way; signs are judged at all samples of the band and
at random places in it. `python -m sdfbake bake` mends a mesh first, `sdfbake.bake` takes it as it is: both are asked.
"""

import json
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sdfbake import BadInput, Grid, Mesh, bake
from sdfbake.commands.check import check as check_command
from sdfbake.commands.show import repaired
from sdfbake.engine import Choice
from sdfbake.meshfile import save
from sdfrender import GridField
from validate.exactuv import foot
from validate.stress import solids
from validate.stress.case import Case, Check, Finding
from validate.stress.solids import Solid

ENGINES = ("numpy 64",)
RESOLUTION = 32
PLACES = 8_000  # at random, a third of which are in the band
# World units: within this of a face a place has no side. Planes and distances are good to a few units of 2e-16, and a
# sample's distance is a float32 of at most a third.
ON_FACE = 1e-9
# Voxels: nearer than this to the surface an interpolant may be off, at edges, by more than a place's distance.
CLOSE = 0.5
WINDING = "half of all directions see no face, or one that looks the wrong way: the winding number falls below 1/2"


# ---- signs -----------------------------------------------------------------------------------------------------------
def signs(solid: Solid, baked: Callable[[], Grid], name: str, known: str = "") -> Check:
    """The share of wrong signs of a grid that stands for a solid: 0, or a known limit.

    Of its samples in the band, and of random places there, whichever is more.
    """

    def find() -> Finding:
        grid = baked()
        return Finding(np.array([_of_samples(solid, grid), _at_random(solid, grid)]))

    return Check(f"{name}: wrong signs", "share", 0.0, find, known=known)


def _of_samples(solid: Solid, grid: Grid) -> float:
    p, distance = grid.samples()
    depth = solid.depth(p)
    return float(np.mean(((distance < 0) != (depth < 0))[np.abs(depth) > ON_FACE]))


def _at_random(solid: Solid, grid: Grid) -> float:
    field = GridField(grid, "bspline", "numpy")
    low, high = grid.lattice.bounds
    p = np.random.default_rng(12).uniform(low, high, (PLACES, 3))
    depth, value = solid.depth(p) / grid.lattice.spacing, field.jet(p, 0)[0]
    # A plane's height is no more than the distance: where it is in the band, the place is near it, or a corner.
    band = (np.abs(depth) > CLOSE) & (np.abs(depth) < grid.metadata.band)
    return float(np.mean(((value < 0) != (depth < 0))[band]))


def as_is(mesh: Mesh, open_: str | None = None) -> Grid:
    """What Python's `bake` makes of a mesh; what it warns of is another check's matter."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return bake(mesh, RESOLUTION, open=open_)


def mended(mesh: Mesh) -> Grid:
    """What the command makes of a mesh."""
    return as_is(repaired(mesh)[0])


def warned(mesh: Mesh, word: str) -> Finding:
    """0 if a bake warns of something, 1 if it is silent."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", UserWarning)
        bake(mesh, RESOLUTION)
    return _unless(any(word in str(warning.message) for warning in heard))


# ---- what is told ----------------------------------------------------------------------------------------------------
def told(mesh: Mesh, verdict: str, *defects: str) -> Finding:
    """0 if `python -m sdfbake check` gives a verdict and names the defects, 1 if not."""
    out = StringIO()
    with redirect_stdout(out), TemporaryDirectory() as folder:
        save(mesh, path := Path(folder) / "mesh.ply")
        check_command.main([str(path), "--json"], standalone_mode=False)
    record = json.loads(out.getvalue())
    return _unless(record["verdict"] == verdict and {entry["name"] for entry in record["findings"]} == set(defects))


def refused(mesh: Mesh, *words: str) -> Finding:
    """Ways to bake a mesh, or to check it, that do not end in one sentence with all of some words in it."""
    with TemporaryDirectory() as folder:
        save(mesh, path := Path(folder) / "mesh.ply")
        ways: tuple[Callable[[], object], ...] = (
            lambda: bake(mesh, RESOLUTION),
            lambda: check_command.main([str(path)], standalone_mode=False),
        )
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            return Finding(np.array([_refusal(way, words) for way in ways]))


def _refusal(way: Callable[[], object], words: tuple[str, ...]) -> float:
    try:
        way()
    except BadInput as complaint:
        sentence = str(complaint)
        return float("\n" in sentence or not all(word in sentence for word in words))
    return 1.0


def _unless(good: bool) -> Finding:
    return Finding(np.array([0.0 if good else 1.0]))


def _count(name: str, find: Callable[[], Finding]) -> Check:
    return Check(name, "count", 0.0, find)


# ---- holes -----------------------------------------------------------------------------------------------------------
def _open(choice: Choice) -> Iterator[Check]:
    whole = solids.ball()
    one = np.arange(len(whole.mesh.faces)) != 77
    # Holes as seen from the middle: a face, then cones of 26, 60 and 90 degrees about an axis.
    holes = {
        "one face missing": (one, ""),
        "a hole of 26 degrees": (~solids.around(whole, 0.9), WINDING),
        "a hole of 60 degrees": (~solids.around(whole, 0.5), WINDING),
        "a hemisphere missing": (~solids.around(whole, 0.0), WINDING),
    }
    for name, (kept, known) in holes.items():
        broken = whole.with_faces(whole.mesh.faces[kept])
        words = ("open", "boundary edges", "--open winding", "--open shell:")
        yield _count(f"{name}: refused, with what to say", partial(refused, broken.mesh, *words))
        yield signs(whole, partial(as_is, broken.mesh, "winding"), f"{name}, --open winding", known)
    yield Check("a hemisphere missing, --open shell: distance", "voxel", _SHELL, partial(_shell, whole, kept))


# A sample is a float32 of at most 5.7 voxels, of a distance that is good to 1e-12 voxel.
_SHELL = 5.7 * 2.0**-24 + 1e-12
THICKNESS = 0.1
SPARSE = 50  # one in so many samples is held against every face


def _shell(whole: Solid, kept: np.ndarray) -> Finding:
    """Distances of a shell against those from every face, less half of its thickness."""
    mesh = Mesh(whole.mesh.vertices, whole.mesh.faces[kept])
    grid = as_is(mesh, f"shell:{THICKNESS}")
    p, distance = grid.samples()
    p, distance = p[::SPARSE], distance[::SPARSE]
    pairs = np.repeat(p, len(mesh.faces), axis=0), np.tile(mesh.vertices[mesh.faces], (len(p), 1, 1))
    truth = foot(*pairs)[0].reshape(len(p), -1).min(axis=1) - THICKNESS / 2
    return Finding(np.abs(distance - truth) / grid.lattice.spacing)


# ---- faces that look the wrong way -----------------------------------------------------------------------------------
def _flipped(choice: Choice) -> Iterator[Check]:
    whole = solids.ball()
    count = len(whole.mesh.faces)
    some = {
        "one face": np.arange(count) == 77,
        "a patch of 26 degrees": solids.around(whole, 0.9),
        "one in twenty": np.random.default_rng(3).random(count) < 0.05,
    }
    for name, which in some.items():
        broken = solids.flipped(whole, which)
        yield _count(f"{name}: told", partial(told, broken.mesh, "repairable", "flipped"))
        yield signs(whole, partial(mended, broken.mesh), f"{name}, mended")
        yield signs(whole, partial(as_is, broken.mesh), f"{name}, as it is", WINDING)
    turned = solids.flipped(whole, np.ones(count, bool))
    yield _count("all: told", partial(told, turned.mesh, "repairable", "inside-out"))
    yield _count("all: the bake warns", partial(warned, turned.mesh, "inside out"))
    yield signs(whole, partial(as_is, turned.mesh), "all, as it is")


# ---- surfaces that cross ---------------------------------------------------------------------------------------------
def _crossing(choice: Choice) -> Iterator[Check]:
    two = solids.union(solids.ball((-0.35, 0.0, 0.0)), solids.ball((0.4, 0.1, 0.05)))
    yield _count("two balls: told", partial(told, two.mesh, "clean", "self-intersecting"))
    yield _count("two balls: the bake warns", partial(warned, two.mesh, "overlaps itself"))
    yield signs(two, partial(as_is, two.mesh), "two balls")
    first = np.arange(len(two.mesh.faces)) < len(two.mesh.faces) // 2
    against = solids.flipped(two, first)
    why = "where a solid and one that is inside out overlap, winding numbers cancel"
    yield _count("one inside out: the bake warns", partial(warned, against.mesh, "overlaps itself"))
    yield signs(two, partial(as_is, against.mesh), "one inside out", why)


# ---- faces that are there twice --------------------------------------------------------------------------------------
def _twice(choice: Choice) -> Iterator[Check]:
    whole = solids.ball()
    faces = whole.mesh.faces
    why = "a face and its reverse are a wall without a thickness, which winding numbers do not see"
    more: dict[str, tuple[np.ndarray, str]] = {
        "one in seven again": (faces[::7], ""),
        "all again": (faces, ""),
        "one in seven again, reversed": (faces[::7, ::-1], why),
        "all again, reversed": (faces[:, ::-1], why),
    }
    for name, (again, known) in more.items():
        broken = whole.with_faces(np.concatenate([faces, again]))
        found = ("duplicate", "non-manifold", "self-intersecting")
        yield _count(f"{name}: told", partial(told, broken.mesh, "repairable", *found))
        yield signs(whole, partial(mended, broken.mesh), f"{name}, mended")
        yield signs(whole, partial(as_is, broken.mesh), f"{name}, as it is", known)


# ---- edges of many faces, vertices of many slivers -------------------------------------------------------------------
def _crowded(choice: Choice) -> Iterator[Check]:
    for name, solid in {"two boxes at an edge": solids.edge_to_edge(), "a box with a wall": solids.divided()}.items():
        yield _count(f"{name}: told", partial(told, solid.mesh, "clean", "non-manifold"))
        yield signs(solid, partial(as_is, solid.mesh), name)
    fan = solids.fan()
    yield _count("a fan of slivers: told", partial(told, fan.mesh, "clean"))
    yield signs(fan, partial(as_is, fan.mesh), "a fan of slivers")
    faces = solids.ball().mesh.faces
    line = solids.ball().with_faces(np.concatenate([faces, faces[:5][:, [0, 1, 0]]]))
    yield _count(
        "faces that are lines: told", partial(told, line.mesh, "repairable", "degenerate", "self-intersecting")
    )
    yield signs(line, partial(mended, line.mesh), "faces that are lines, mended")
    yield signs(line, partial(as_is, line.mesh), "faces that are lines, as they are")


# ---- no mesh at all --------------------------------------------------------------------------------------------------
def _nothing(choice: Choice) -> Iterable[Check]:
    whole = solids.ball().mesh
    broken = whole.vertices.copy()
    broken[3], broken[17] = np.nan, np.inf
    point = np.zeros_like(whole.faces)
    return (
        _count("no faces: refused", partial(refused, Mesh(whole.vertices, whole.faces[:0]), "export")),
        _count("NaN and infinity: refused", partial(refused, whole.with_(vertices=broken), "non-finite: 2 vertices")),
        _count("no face with an area: refused", partial(refused, whole.with_(faces=point), "without area")),
    )


CASES: tuple[Case, ...] = (
    Case(
        "open-meshes",
        "Meshes with holes",
        "A surface with a hole has no inside: it is refused, and the sentence says how to tell what inside means. By "
        "winding number the signs are right but near the hole; a shell is exact wherever there is a face.",
        _open,
        ENGINES,
    ),
    Case(
        "flipped-faces",
        "Faces that look the wrong way",
        "The command turns them before it bakes, and no sign is wrong. A bake of the mesh as it is falls back on "
        "winding numbers, which are wrong beside a patch of them; a mesh that is inside out as a whole is only told.",
        _flipped,
        ENGINES,
    ),
    Case(
        "self-intersecting",
        "Surfaces that cross each other",
        "Solids that overlap are one solid: a second method disagrees with pseudonormals, so winding numbers decide, "
        "every sign is that of the union, and the user is warned.",
        _crossing,
        ENGINES,
    ),
    Case(
        "duplicate-faces",
        "Faces that are there twice",
        "Faces that are repeated are dropped, by the command before the bake, by the winding number on its own if they "
        "look the same way: no sign is wrong.",
        _twice,
        ENGINES,
    ),
    Case(
        "crowded-meshes",
        "Edges of three and four faces, fans of slivers, faces that are lines",
        "Such meshes are closed, so their inside is defined, and winding numbers find it without asking for two faces "
        "at an edge; slivers are measured by their edges, which have no area to divide by.",
        _crowded,
        ENGINES,
    ),
    Case(
        "no-mesh",
        "Meshes without faces, with NaN, without area",
        "There is nothing to bake: `bake` and `check` refuse in one sentence that says what is wrong and what to do.",
        _nothing,
        ENGINES,
    ),
)
