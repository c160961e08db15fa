"""Glass: what becomes of rays at the surface of a clear solid, and how that surface bends.

In: rays that `trace.transfer` brought to a surface. Out: the rays that go on (`refract`), the shares of light that are
mirrored and pass (`fresnel`), principal curvatures (`curvature`). Inside is where the field is negative; a ray comes
from inside where d . n > 0. Igehy 1999, eq. 16 to 18; Galim 2018, table 1.
"""

import numpy as np
from jaxtyping import Float

from sdfbake.engine import Array, Engine
from sdfrender import optics
from sdfrender.field import Field, Jet
from sdfrender.flags import Flag
from sdfrender.rays import Beam, Rays, beam, components, rays
from sdfrender.trace import Hits
from sdfrender.vector import select

Shares = Float[np.ndarray, " n"]


def refract(field: Field, hits: Hits, rays_: Rays, *, eta: float | Shares) -> Rays:
    """Send rays that `transfer` brought to a surface through it; where nothing passes, mirror them.

    Parameters
    ----------
    field, hits, rays_
        What was traced, and what `transfer` returned.
    eta
        n_i / n_t, the index of the medium that a ray comes from over that of the one it enters: one number for all
        rays, or one for each. For a solid of index 1.5 in air 1 / 1.5 on the way in and 1.5 on the way out; where rays
        of both kinds are mixed, `np.where(leaving(hits, rays), 1.5, 1 / 1.5)`.

    Returns
    -------
    Rays
        From the surface on, flagged TIR where they were reflected totally; rays that missed stay as they are.

    Raises
    ------
    ValueError
        If an eta is not positive and finite, or there is neither one nor one for each ray.

    Examples
    --------
    >>> import numpy as np
    >>> from sdfbake import Grid
    >>> from sdfrender import GridField, Rays, refract, transfer
    >>> x = np.arange(16.0)[:, None, None] + np.zeros((16, 16, 16))
    >>> water = GridField(Grid.from_dense(x - 7.5), "linear", "numpy")
    >>> down, none = np.array([[-0.8, 0.6, 0.0]]), np.zeros((1, 3))
    >>> hits, at = transfer(water, Rays(np.array([[12.0, 2.0, 7.0]]), down, none, none, none, none))
    >>> refract(water, hits, at, eta=0.75).d.round(3).tolist()
    [[-0.893, 0.45, 0.0]]
    """

    def program(xp: Engine, *c: Array) -> dict[str, Array]:
        incoming, hit, ratio = beam(c[:18]), c[18] > 0, c[19]
        jet = field.jet_at(xp, field.locate(xp, incoming.p, hit), 2)
        outgoing, total = refracted(xp, incoming, jet, hit, ratio)
        return {**components(outgoing), "total": xp.integer(total)}

    columns = rays_.columns()
    columns[:3] = (rays_.p - field.anchor).T
    named = field.engine.run(program, [*columns, hits.hit.astype(np.int32), _ratios(eta, len(rays_))])
    out = rays(named)
    went = Rays(rays_.p, out.d, out.dp_dx, out.dp_dy, out.dd_dx, out.dd_dy, rays_.flags)
    return went.flagged(named["total"].astype(np.int32) * int(Flag.TIR))


def fresnel(field: Field, hits: Hits, rays_: Rays, *, eta: float | Shares) -> tuple[Shares, Shares]:
    """Return the shares of unpolarised light that a dielectric surface mirrors and lets pass.

    The shares are of energy: they add up to 1. They are also the weights of the two branches for *basic radiance*
    L / n^2, which refraction does not change. A path that ends in the medium that it began in needs nothing else; the
    radiance L of one that ends in another is scaled by (1 - R) eta^2 per refraction.

    Parameters
    ----------
    field, hits, rays_, eta
        As for `refract`; the rays before it.

    Returns
    -------
    reflectance, transmittance
        (n,) float64 each; 1 and 0 for total internal reflection, 0 and 0 for a miss.
    """

    def program(xp: Engine, *c: Array) -> dict[str, Array]:
        return {"reflectance": optics.reflectance(xp, (c[0], c[1], c[2]), (c[3], c[4], c[5]), c[6])}

    out = field.engine.run(program, [*rays_.d.T, *hits.n.T, _ratios(eta, len(rays_))])
    reflectance = out["reflectance"].astype(np.float64)
    return np.where(hits.hit, reflectance, 0.0), np.where(hits.hit, 1.0 - reflectance, 0.0)


def leaving(hits: Hits, rays_: Rays) -> np.ndarray:
    """Return the mask of the rays that reach their hit from inside the solid."""
    return np.asarray(hits.hit & (np.sum(hits.n * rays_.d, axis=-1) > 0))


def curvature(field: Field, points: Float[np.ndarray, "n 3"]) -> tuple[Shares, Shares]:
    """Return the principal curvatures of the surface at points on it (of the level set through any other).

    Parameters
    ----------
    field
        The surface.
    points
        (n, 3) float64, world frame.

    Returns
    -------
    k_min, k_max
        (n,) float64, per world unit, least and greatest; a ball's are both 1 / r, a cavity's are negative. 0 where
        the field has no samples, or no gradient.
    """

    def program(xp: Engine, *p: Array) -> dict[str, Array]:
        spot = field.locate(xp, (p[0], p[1], p[2]), xp.full(p[0], True))
        least, greatest = optics.curvatures(xp, field.jet_at(xp, spot, 2))
        return {"least": xp.where(spot.hit, least, 0.0), "greatest": xp.where(spot.hit, greatest, 0.0)}

    points = np.asarray(points, np.float64).reshape(-1, 3)
    out = field.engine.run(program, list((points - field.anchor).T))
    return out["least"].astype(np.float64), out["greatest"].astype(np.float64)


def refracted(xp: Engine, incoming: Beam, jet: Jet, hit: Array, eta: Array) -> tuple[Beam, Array]:
    """Within a program: the beam beyond the surface, unchanged where there is none, and where it was total."""
    n = optics.normal(xp, jet)
    dn_dx = optics.normal_differential(xp, jet, n, incoming.dp_dx)
    dn_dy = optics.normal_differential(xp, jet, n, incoming.dp_dy)
    outgoing, total = optics.refract(xp, incoming, n, dn_dx, dn_dy, eta)
    return Beam(*(select(xp, hit, new, old) for new, old in zip(outgoing, incoming, strict=True))), total & hit


def _ratios(eta: float | Shares, count: int) -> Shares:
    ratios = np.asarray(eta, np.float64)
    if ratios.shape not in ((), (count,)):
        raise ValueError(f"eta has shape {ratios.shape}: expected one number, or ({count},)")
    if not (np.isfinite(ratios) & (ratios > 0)).all():
        raise ValueError("eta must be positive and finite")
    return np.broadcast_to(ratios, (count,))
