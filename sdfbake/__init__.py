"""Mesh to grid asset: sparse signed distances, exact near the surface, with texture coordinates.

In: a mesh, an exact shape or a dense array. Out: a `Grid`, in memory and on disk. Geometry libraries are imported by
the functions that need them, so that `import sdfbake` is light.
"""

from sdfbake.bake import bake  # before all else: the function takes the name of its module
from sdfbake.complaint import BadInput
from sdfbake.grid import Grid
from sdfbake.lattice import Lattice
from sdfbake.mesh import Mesh

__all__ = ["BadInput", "Grid", "Lattice", "Mesh", "bake"]
