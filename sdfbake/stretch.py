"""How a mesh's texture coordinates are stretched over its faces.

In: a mesh with texture coordinates, and how its signs were found. Out: the least and the greatest singular value of
d(uv)/d(position) over all faces: between them lies how far texture coordinates go along any unit of the surface.
"""

import numpy as np
from jaxtyping import Float

from sdfbake.mesh import Mesh
from sdfbake.metadata import Sign


def stretch_of(mesh: Mesh, sign: Sign) -> tuple[float, float] | None:
    """Return what bounds the footprints on a baked mesh, for `Metadata.stretch`.

    Parameters
    ----------
    mesh
        Closed, with texture coordinates.
    sign
        Where two methods disagree, the surface may change sides far from any face, where none is named.

    Returns
    -------
    least, greatest
        Texture coordinates per world unit; the least is 0 if some face has no area, in space or on the texture. None
        where faces bound nothing.
    """
    if mesh.uv is None or sign.disagree > 0:
        return None
    least, greatest = stretches(mesh.vertices[mesh.faces], mesh.uv)
    known = np.isfinite(least) & np.isfinite(greatest)
    if not known.any():
        return None
    return float(least[known].min()) if known.all() else 0.0, float(greatest[known].max())


def stretches(
    corner: Float[np.ndarray, "f 3 3"], uv: Float[np.ndarray, "f 3 2"]
) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """Return the singular values of d(uv)/d(position) of every face; not finite where it has no area.

    With the edges E and their texture coordinates U it is U E^+; the product of the singular values is the ratio of the
    areas, which leaves the lesser its digits.

    Parameters
    ----------
    corner, uv
        Of every face: its corners, world units, and their texture coordinates.
    """
    ab, ac = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    (ub, vb), (uc, vc) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    # (E^T E)^-1 = adj(E^T E) / area^2, and the sum of the squared singular values is the trace of U (E^T E)^-1 U^T.
    bb, cc, bc = (ab * ab).sum(axis=1), (ac * ac).sum(axis=1), (ab * ac).sum(axis=1)
    normal = np.cross(ab, ac)
    square = (normal * normal).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        total = (cc * (ub * ub + vb * vb) - 2 * bc * (ub * uc + vb * vc) + bb * (uc * uc + vc * vc)) / square
        product = np.abs(ub * vc - uc * vb) / np.sqrt(square)
        greatest = np.sqrt((total + np.sqrt(np.maximum(total**2 - 4 * product**2, 0.0))) / 2)
        return np.where(greatest > 0, product / greatest, 0.0 * greatest), greatest
