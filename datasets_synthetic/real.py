"""Real meshes, read from where the pymeshlab wheel installs them; nothing is copied, pymeshlab is not imported.

In: a name. Out: a `Mesh`. `bunny` and `bunny_textured` are the Stanford Bunny: courtesy of the Stanford Computer
Graphics Laboratory (Stanford 3D Scanning Repository, Turk and Levoy 1994).
"""

from importlib.util import find_spec
from pathlib import Path

from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh

#: Name -> file in the wheel's sample meshes, and what it is.
FILES = {
    "bunny": ("bunny.obj", "Stanford Bunny, 56,172 faces, closed, without texture coordinates"),
    "bunny_textured": ("bunny10k_textured.obj", "Stanford Bunny, 9,999 faces, with texture coordinates"),
    "cow": ("cow.obj", "cow"),
}


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
    """Read a real mesh as it is, unrepaired."""
    return Mesh.load(path_of(name))
