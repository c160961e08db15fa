"""Footprints of primary rays on every mesh: the grid baked from it against the mesh itself, by Embree.

In: nothing from the build; meshes are made, unwrapped and baked here. Out: per mesh and kernel one error run. Meshes of
exact shapes have the shapes' own texture coordinates, the textured bunny its own of 136 pieces, the cow an atlas.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from datasets_synthetic import exact_names, mesh
from sdfbake import Grid, Mesh, bake
from sdfbake.complaint import BadInput
from sdfbake.repair import repair
from sdfbake.unwrap import unwrap
from sdfrender import GridField, Rays
from validate.compare import compare, lod_map
from validate.embree import MeshReference
from validate.experiment import Bench, Run, guarded
from validate.metrics import Seen
from validate.suites.shapes import DIRECTION, DOUBLE
from validate.views import framing, seen, through_field

KERNELS = ("bspline",)  # what the linear one costs, three of these meshes show in `footprints`
REAL = ("cow", "bunny_textured")
# The textured bunny has no floor; what is inside it, winding numbers say.
OPEN = {"bunny_textured": "winding"}


@dataclass(frozen=True, slots=True)
class Sizes:
    """Samples along a grid of a synthetic and of a real mesh, pixels along a picture."""

    synthetic: int = 128
    real: int = 256
    picture: int = 160


QUICK = Sizes(synthetic=32, real=32, picture=40)


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A mesh in a picture: its rays, what is true, and its grid."""

    rays: Rays
    truth: Seen
    grid: Grid


def run(bench: Bench) -> Iterator[Run]:
    """One mesh at a time."""
    names = (*exact_names(), *REAL)
    if bench.only not in (None, *names):
        raise BadInput(f"this suite does not look at '{bench.only}': choose one of {', '.join(names)}")
    sizes = QUICK if bench.quick else Sizes()
    for name in names if bench.only is None else [bench.only]:
        bench.progress(f"footprints on the mesh of the {name.replace('_', ' ')}")
        resolution = sizes.real if name in REAL else sizes.synthetic
        case = cache(partial(_case, name, resolution, sizes.picture))
        for kernel in KERNELS:
            blank = Run("meshes", name, {"kernel": kernel}, {"resolution": resolution}, "error")

            def measured(blank: Run = blank, case: Callable[[], Case] = case) -> Run:
                return _judged(bench, blank, case(), sizes.picture)

            yield guarded(blank, measured)


def _case(name: str, resolution: int, size: int) -> Case:
    surface = _mapped(mesh(name))
    rays = framing(surface.bounds, size, DIRECTION).rays()
    truth = seen(MeshReference(surface).follow(rays, 0)[0])
    return Case(rays, truth, bake(surface, resolution, open=OPEN.get(name)))


def _mapped(surface: Mesh) -> Mesh:
    """A mesh with texture coordinates: as it is, or repaired and unwrapped."""
    return surface if surface.uv is not None else unwrap(repair(surface)[0])


def _judged(bench: Bench, blank: Run, case: Case, size: int) -> Run:
    field = GridField(case.grid, blank.setup["kernel"], precision=DOUBLE)
    ours, flags = through_field(field, case.rays, 0, case.grid.lattice.spacing)
    values = compare(ours, case.truth, (size, size), flags=flags)
    if blank.problem not in REAL:
        return replace(blank, values=values)
    error = lod_map(ours, case.truth, (size, size)).astype(np.float16)
    return replace(
        blank, values=values, artefact=bench.store(f"meshes-{blank.problem}-{blank.setup['kernel']}", lod_error=error)
    )
