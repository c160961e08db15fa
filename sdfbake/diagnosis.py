"""What is wrong with a mesh, how much of it, and where.

In: a mesh. Out: a frozen `Diagnosis`: findings with a name, a count, a place, and what follows from them.
"""

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from sdfbake.closest import Surface
from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh
from sdfbake.topology import Topology, twice_areas

Consequence = Literal["refused", "repairable", "noted"]

_ADVICE = {
    "empty": "export a surface mesh",
    "non-finite": "export it again, or delete those vertices",
    "open": "close its holes, or say what inside means with --open winding or --open shell:THICKNESS",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """One kind of defect.

    Attributes
    ----------
    name
        "empty", "non-finite", "degenerate", "duplicate", "unreferenced", "flipped", "inside-out", "open",
        "non-manifold", "self-intersecting"; of a mesh in a lattice also "thin" and "gap".
    count
        How many vertices, faces or edges have it.
    of
        What is counted.
    place
        World position of the first one; None where there is none to give.
    consequence
        "refused": there is no inside, or nothing to bake; "repairable": `sdfbake.repair` mends it; "noted": the bake
        takes it as it is, with signs by winding number.
    """

    name: str
    count: int
    of: str
    place: tuple[float, float, float] | None
    consequence: Consequence

    def __str__(self) -> str:
        where = "" if self.place is None else " at ({:.6g}, {:.6g}, {:.6g})".format(*self.place)
        first = "" if self.place is None else ", the first" if self.count > 1 else ""
        return f"{self.name}: {self.count} {self.of}{first}{where}"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All findings, in the order they were looked for.

    Attributes
    ----------
    findings
        Defects; none for a clean mesh.
    """

    findings: tuple[Finding, ...]

    @property
    def refused(self) -> bool:
        """Whether a bake will not take the mesh."""
        return any(finding.consequence == "refused" for finding in self.findings)

    @property
    def repairable(self) -> bool:
        """Whether `sdfbake.repair` has something to do."""
        return any(finding.consequence == "repairable" for finding in self.findings)

    @property
    def certified(self) -> bool:
        """Whether the surface is closed, oriented and manifold, so that pseudonormals tell inside from outside."""
        return not {finding.name for finding in self.findings} - {"unreferenced", "inside-out", "thin", "gap"}

    def has(self, name: str) -> bool:
        """Say whether a defect was found."""
        return any(finding.name == name for finding in self.findings)

    def require_bakeable(self, *, open_too: bool = False) -> None:
        """Raise BadInput with the first finding that is refused; holes are not if it was said what inside means."""
        for finding in self.findings:
            if finding.consequence == "refused" and not (open_too and finding.name == "open"):
                raise BadInput(f"the mesh is {finding}: {_ADVICE[finding.name]}")

    def record(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        verdict = "refused" if self.refused else "repairable" if self.repairable else "clean"
        return {"verdict": verdict, "findings": [asdict(finding) for finding in self.findings]}


def diagnose(mesh: Mesh, surface: Surface | None = None) -> Diagnosis:
    """Look for everything that can be told from the arrays alone (self-intersections: `sdfbake.repair.crossings`).

    Parameters
    ----------
    mesh
        Any mesh; non-finite or empty ones end the search at once.
    surface
        The mesh made ready, if that was done already; else as much of it as is needed is done here.
    """
    if len(mesh.faces) == 0:
        return Diagnosis((Finding("empty", 0, "faces", None, "refused"),))
    broken = ~np.isfinite(mesh.vertices).all(axis=1)
    if broken.any():
        return Diagnosis((Finding("non-finite", int(broken.sum()), "vertices", None, "refused"),))
    degenerate = np.ones(len(mesh.faces), bool)
    if surface is None and not twice_areas(mesh.vertices, mesh.faces).any():
        return Diagnosis((Finding("empty", len(mesh.faces), "faces without area", None, "refused"),))
    surface = surface or Surface.of(mesh)
    degenerate[surface.ids] = False
    whole = surface.topology if len(surface.faces) == len(mesh.faces) else Topology.of(mesh.faces)
    return Diagnosis(tuple(_vertex_and_face_findings(mesh, degenerate, whole) + _edge_findings(mesh, surface)))


def _vertex_and_face_findings(mesh: Mesh, degenerate: Bool[np.ndarray, " f"], topology: Topology) -> list[Finding]:
    """Find what single faces and vertices show."""
    unused = np.ones(len(mesh.vertices), bool)
    unused[mesh.faces] = False
    found = [
        _finding("degenerate", "faces", _middles(mesh, mesh.faces[degenerate]), "repairable"),
        _finding("duplicate", "faces", _middles(mesh, mesh.faces[topology.repeated_faces(mesh.faces)]), "repairable"),
        _finding("unreferenced", "vertices", mesh.vertices[unused], "repairable"),
    ]
    return [finding for finding in found if finding.count]


def _edge_findings(mesh: Mesh, surface: Surface) -> list[Finding]:
    """Find what edges show, on the faces with three different vertices."""
    faces = proper(mesh.faces)
    topology = surface.topology if len(surface.faces) == len(faces) else Topology.of(faces)
    edges = topology.edges
    found = [
        _finding("flipped", "edges", _middles(mesh, edges[topology.flipped_edges]), "repairable"),
        _finding("open", "boundary edges", _middles(mesh, edges[topology.open_edges]), "refused"),
        _finding("non-manifold", "edges", _middles(mesh, edges[topology.crowded_edges]), "noted"),
    ]
    if not any(finding.count for finding in found):
        pinched = mesh.vertices[topology.pinched_vertices(faces)]
        found = [_finding("non-manifold", "vertices", pinched, "noted")]
        if surface.volume < 0:
            found.append(_finding("inside-out", "faces", _middles(mesh, faces), "repairable"))
    return [finding for finding in found if finding.count]


def _middles(mesh: Mesh, which: Int[np.ndarray, "n k"]) -> Float[np.ndarray, "n 3"]:
    """Return the middles of edges or faces."""
    middle: Float[np.ndarray, "n 3"] = mesh.vertices[which].mean(axis=1)
    return middle


def proper(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "g 3"]:
    """Return the faces with three different vertices."""
    kept: Int[np.ndarray, "g 3"] = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return kept


def _finding(name: str, of: str, places: Float[np.ndarray, "n 3"], consequence: Consequence) -> Finding:
    """Return a finding with the first of its places."""
    place = None if len(places) == 0 else (float(places[0][0]), float(places[0][1]), float(places[0][2]))
    return Finding(name, len(places), of, place, consequence)
