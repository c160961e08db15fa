"""Whether a program sees in an exported grid what we see in the grid.

In: a specimen and a reader's answer. Out: `Check`: figures in voxels, each with the most that it may be.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.ndimage import map_coordinates

from sdfbake.bricks import in_lattice
from sdfbake.seams import seam_cells
from validate.peers.specimens import NEAR, Specimen, spread

Arrays = Mapping[str, np.ndarray]
Words = Mapping[str, str]
DIFFER = "differ"
#: Of hits, by the 99th percentile: the limit that was set for Mitsuba's at 256 samples.
HITS = 0.01
#: Float32 keeps a place in a box of some 64 voxels to 64 * 2^-24 voxels, and sums of eight corners lose little more.
PLACE = 1e-4
#: Where not all around is exact, coefficients are of distances whose kinks are smoothed: by 4 / 36 of a voxel beside an
#: edge, of which (2 - sqrt 3)^2 is left two samples on, where surface is.
KINK = 0.01
#: Times that a spline of fourth order is at least better than a linear interpolant, of second, on a smooth shape.
FINER = 10.0
#: A vertex is the mean of crossings in a cell; the nearest is not farther than their root mean square distance, and
#: that is at most half per axis.
CELL = sqrt(3) / 2
#: A rounded t of 100 voxels decides grazes shallower than 1e-5 voxel; one ray in some thousands comes as close.
GRAZES = 1e-3
#: Half precision has 11 binary places: half a unit of the last one, of numbers from 4 to 8.
HALF = 2.0**-9
#: Texture coordinates in 16 bits over their range.
FULL = 1 / 65535
#: Voxels: a corner of a cell with surface in it is not farther.
CORNER = sqrt(3)
#: Two ways to the barycentric coordinates of a closest point, each rounded to float32 once.
UV = 2.0**-22


@dataclass(frozen=True, slots=True)
class Check:
    """One comparison.

    Attributes
    ----------
    what
        Was compared.
    figure, limit
        The greatest error, and the most that it may be.
    unit
        Of both; `DIFFER` of what is counted.
    count
        Of the numbers that were compared.
    """

    what: str
    figure: float
    limit: float
    unit: str
    count: int

    @property
    def passed(self) -> bool:
        """Whether the limit is kept, by something that was compared."""
        return self.count > 0 and self.figure <= self.limit


def judged(specimen: Specimen, answer: Arrays, words: Words) -> list[Check]:
    """Compare all that a reader answered with what is true.

    Raises
    ------
    ValueError
        If it answered nothing that can be compared.
    """
    checks = [check for find in _FINDERS for check in find(specimen, answer, words)]
    if not checks:
        raise ValueError(f"the answer has nothing to compare: {', '.join(answer) or 'no array'}")
    return checks


def _index(specimen: Specimen, answer: Arrays) -> np.ndarray:
    """Return the samples that a reader speaks of."""
    return answer.get("index", specimen.question.samples)


def _values(specimen: Specimen, answer: Arrays, words: Words) -> Iterator[Check]:
    """Samples: equal where they are exact distances, of the same sign elsewhere; of level sets, the active ones."""
    if "value" not in answer:
        return
    at = tuple(_index(specimen, answer).T)
    h, ours, theirs = specimen.grid.lattice.spacing, specimen.values[at], answer["value"]
    exact = specimen.known[at]
    if "background" in answer:
        exact = exact & (np.abs(ours) < answer["background"][0])
    limit = HALF if words.get("type") == "float16" else 0.0
    off = np.abs(theirs[exact].astype(np.float64) - ours[exact]) / h
    yield Check("values", _most(off), limit, "voxel", len(off))
    yield Check("signs", float(np.sum((theirs < 0) != (ours < 0))), 0, DIFFER, len(ours))
    if "one_by_one" in answer:
        again = answer["one_by_one"]
        yield Check("accessor against copy", float(np.sum(again != theirs[: len(again)])), 0, DIFFER, len(again))


def _level_set(specimen: Specimen, answer: Arrays, words: Words) -> Iterator[Check]:
    """The narrow band: class, half width, which samples are active, every leaf in the order of the file."""
    if "background" not in answer:
        return
    grid, half = specimen.grid, float(answer["background"][0])
    yield Check("class", float(words["class"] != "level set"), 0, DIFFER, 1)
    yield Check("half width", abs(half / grid.lattice.spacing - NEAR), NEAR * 2.0**-24, "voxels wide", 1)
    if "invalid" in answer:
        yield Check("validator", float(answer["invalid"].sum()), 0, DIFFER, len(answer["invalid"]))
    band = int(np.sum(specimen.known & (np.abs(specimen.values) < half)))
    yield Check("active voxels", abs(float(answer["active_voxels"][0]) - band), 0, DIFFER, band)
    if "leaves" not in answer:
        return
    magnitude = np.where(in_lattice(grid.bricks.index, grid.lattice.shape), np.abs(grid.distance), np.inf)
    active = magnitude < half
    ours, theirs = grid.distance[active.any(axis=(1, 2, 3))].reshape(-1, 512), answer["leaves"]
    of = active[active.any(axis=(1, 2, 3))].reshape(-1, 512)
    equal = theirs.shape == ours.shape
    off = np.abs(theirs - ours)[of] / grid.lattice.spacing if equal else np.array([np.inf])
    yield Check("leaves", _most(off), 0, "voxel", len(off))


def _most(off: np.ndarray) -> float:
    """Return the greatest error; what is not a number is off by more than any limit."""
    return float(np.nan_to_num(off.astype(np.float64), nan=np.finfo(np.float64).max).max(initial=0.0))


def _places(specimen: Specimen, answer: Arrays, words: Words) -> Iterator[Check]:
    """World positions of samples."""
    if "position" not in answer:
        return
    theirs, lattice = answer["position"], specimen.grid.lattice
    ours = lattice.to_world(_index(specimen, answer)[: len(theirs)])
    off = np.linalg.norm(theirs - ours, axis=1) / lattice.spacing
    yield Check("positions", _most(off), PLACE, "voxel", len(off))


def _spline(specimen: Specimen, answer: Arrays, words: Words) -> Iterator[Check]:
    """A spline of coefficients: at samples these; between them that of distances exact everywhere, and the truth."""
    if "node" not in answer:
        return
    h, asked = specimen.grid.lattice.spacing, specimen.question
    at = tuple(asked.samples[: len(answer["node"])].T)
    near = np.abs(specimen.values[at]) <= CORNER * h
    off = np.abs(answer["node"] - specimen.values[at])[near] / h
    yield Check("spline at samples", _most(off), PLACE, "voxel", len(off))
    place = specimen.grid.lattice.to_grid(asked.points).T
    ours = map_coordinates(specimen.everywhere, place, np.float64, order=3, mode="mirror")
    near = np.abs(ours) <= h / 2
    points, theirs, ours = asked.points[near], answer["cubic"][near], ours[near]
    yield Check("spline between samples", _most(np.abs(theirs - ours) / h), KINK, "voxel", len(ours))
    if specimen.exact is not None:
        truth, (rough,) = specimen.exact(points), specimen.linear.jet(points, 0)
        limit = _most(np.abs(rough - truth) / h) / FINER
        yield Check("spline against closed form", _most(np.abs(theirs - truth) / h), limit, "voxel", len(ours))


def _between(specimen: Specimen, answer: Arrays, words: Words) -> Iterator[Check]:
    """Samples interpolated linearly by the program."""
    if "between" in answer:
        (ours,) = specimen.linear.jet(specimen.question.points, 0)
        off = np.abs(answer["between"] - ours) / specimen.grid.lattice.spacing
        yield Check("between samples", _most(off), PLACE, "voxel", len(off))


def _surface(specimen: Specimen, answer: Arrays, words: Words) -> Iterator[Check]:
    """Points of a surface that the program extracted, in our linear interpolant."""
    if "surface" not in answer:
        return
    (ours,) = specimen.linear.jet(answer["surface"], 0)
    limit = CELL if words.get("class") else PLACE
    yield Check("extracted surface", _most(np.abs(ours) / specimen.grid.lattice.spacing), limit, "voxel", len(ours))


def _hits(specimen: Specimen, answer: Arrays, words: Words) -> Iterator[Check]:
    """First hits, against the linear kernel's."""
    if "t" not in answer:
        return
    ours, theirs = specimen.t, answer["t"]
    both = np.isfinite(ours) & np.isfinite(theirs)
    off = np.abs(ours[both] - theirs[both]) / specimen.grid.lattice.spacing
    yield Check("hits, p99", float(np.percentile(off, 99)) if len(off) else np.inf, HITS, "voxel", len(off))
    differ = float(np.mean(np.isfinite(ours) != np.isfinite(theirs)))
    yield Check("hit or miss", differ, GRAZES, f"of all {DIFFER}", len(ours))


def _texture(specimen: Specimen, answer: Arrays, words: Words) -> Iterator[Check]:
    """Texture coordinates, charts and parts of the corners of cells with surface, and which of these are on seams."""
    grid = specimen.channels
    for name in ("uv", "chart", "seam", "part"):
        channel = seam_cells(grid) if name == "seam" else getattr(grid, name)
        if name not in answer or channel is None:
            continue
        theirs = answer[name]
        at = tuple(specimen.question.samples[: len(theirs)].T)
        corner = specimen.known[at] & (np.abs(specimen.values[at]) <= CORNER * grid.lattice.spacing)
        near = specimen.crossed[at] if name == "seam" else corner
        ours = spread(grid, channel, 0)[at][near].astype(np.float64)
        off = np.abs(theirs[near] - ours).reshape(len(ours), -1)
        if name == "uv":
            limit = PLACE if words.get("uv") == "interpolated" else FULL if words.get("type") == "float16" else UV
            yield Check(name, _most(off), limit, "of the texture", len(off))
        else:
            yield Check(name, float(np.sum(off.max(axis=1) > 0)), 0, DIFFER, len(off))


_FINDERS = (_values, _level_set, _places, _spline, _between, _surface, _hits, _texture)
