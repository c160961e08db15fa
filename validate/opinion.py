"""Open3D's second opinion on distance and sign.

In: a mesh and points. Out: signed distances that share nothing with the baker. Open3D works in float32, so points go
in recentred and scaled to the unit box; it is good to about 1e-6 of the box there.
"""

import ctypes
from typing import Any

import libusb_package
import numpy as np
from jaxtyping import Float

from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh


def signed_distance(mesh: Mesh, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Signed distance to a closed mesh, negative inside, in the mesh's unit; good to float32 of the mesh's size.

    Raises
    ------
    BadInput
        If Open3D cannot be loaded on this machine.
    """
    open3d = load_open3d()
    low, high = mesh.bounds
    centre, scale = (low + high) / 2, float((high - low).max()) / 2
    scene = open3d.t.geometry.RaycastingScene()
    vertices = ((mesh.vertices - centre) / scale).astype(np.float32)
    scene.add_triangles(open3d.core.Tensor(vertices), open3d.core.Tensor(mesh.faces.astype(np.uint32)))
    asked = open3d.core.Tensor(((points - centre) / scale).astype(np.float32))
    return np.asarray(scene.compute_signed_distance(asked).numpy().astype(np.float64) * scale)


def load_open3d() -> Any:
    """Import Open3D; on a bare machine it lacks libusb, which a package of its own brings.

    Raises
    ------
    BadInput
        If Open3D cannot be loaded on this machine.
    """
    try:
        library = libusb_package.get_library_path()
        if library is not None:
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        import open3d
    except (ImportError, OSError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"Open3D cannot be loaded ({reason}): reinstall it, or leave the suite 'opinion' out") from None
    return open3d
