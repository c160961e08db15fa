"""Real meshes, read from where the pymeshlab wheel installs them; nothing is copied, pymeshlab is not imported.

In: a name. Out: a `Mesh`. `bunny` and `bunny_textured` are the Stanford Bunny: courtesy of the Stanford Computer
Graphics Laboratory (Stanford 3D Scanning Repository, Turk and Levoy 1994).
"""

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh
from sdfbake.topology import Topology

#: Name -> file in the wheel's sample meshes, and what it is.
FILES = {
    "bunny": ("bunny.obj", "Stanford Bunny, 56,172 faces, closed, without texture coordinates"),
    "bunny_textured": ("bunny10k_textured.obj", "Stanford Bunny, 9,999 faces, with texture coordinates"),
    "cow": ("cow.obj", "cow"),
    "bunny-900k": ("bunny.obj", "Stanford Bunny, every face cut into 16: 898,752 faces, the same surface"),
}
#: How often every face is cut into four at the midpoints of its edges, where it is.
HALVED = {"bunny-900k": 2}


def path_of(name: str) -> Path:
    """Path of a real mesh inside the installed pymeshlab wheel.

    Raises
    ------
    BadInput
        If pymeshlab is not installed, or its wheel lacks the file.
    """
    spec = find_spec("pymeshlab")
    if spec is None or not spec.submodule_search_locations:
        raise BadInput(f"the mesh {name} comes with pymeshlab, which is not installed: run 'make setup'")
    path = Path(spec.submodule_search_locations[0], "tests", "sample_meshes", FILES[name][0])
    if not path.is_file():
        raise BadInput(f"the installed pymeshlab lacks {path}: install its official wheel, pip install pymeshlab")
    return path


def load(name: str) -> Mesh:
    """Read a real mesh, unrepaired, and as it is but for finer faces where its name says so."""
    mesh = Mesh.load(path_of(name))
    for _ in range(HALVED.get(name, 0)):
        mesh = halved(mesh)
    return mesh


def halved(mesh: Mesh) -> Mesh:
    """Cut every face into four at the midpoints of its edges; the surface stays, texture coordinates are left out."""
    topology = Topology.of(mesh.faces)
    midpoints = mesh.vertices[topology.edges].mean(axis=1)
    a, b, c = mesh.faces.T
    ab, bc, ca = (len(mesh.vertices) + topology.edge).T  # edge k runs from corner k to the next
    four = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    faces = np.stack([np.stack(corners, axis=-1) for corners in four], axis=1).reshape(-1, 3)
    part = np.repeat(mesh.part, 4)
    return Mesh(
        np.concatenate([mesh.vertices, midpoints]), faces, part=part, part_names=mesh.part_names, units=mesh.units
    )
