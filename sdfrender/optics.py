"""What happens to a beam: transfer to a surface, reflection, refraction, with derivatives (Galim 2018, table 1).

In: a beam and a jet of the surface. Out: the beam after the step. Derivatives are linear in the incoming ones and are
never clamped.
"""

from typing import NamedTuple

from sdfbake.engine import Array, Engine
from sdfrender.field import Jet
from sdfrender.rays import Beam
from sdfrender.vector import Vector, add, along, apply, cross, dot, scale, select, subtract

EDGE_LIMIT = 0.1  # a distance has a gradient of length 1; interpolation on smooth surfaces stays within 1 % of it


def normal(xp: Engine, jet: Jet) -> Vector:
    """Return the unit normal, outward (Galim 2018, eq. 7); any unit vector where the gradient vanishes."""
    assert jet.gradient is not None
    squared = dot(jet.gradient, jet.gradient)
    flat = squared == 0
    n = scale(jet.gradient, 1.0 / xp.sqrt(xp.where(flat, 1.0, squared)))
    return n[0], n[1], xp.where(flat, 1.0, n[2])


def normal_differential(xp: Engine, jet: Jet, n: Vector, dp: Vector) -> Vector:
    """Return dn for a displacement dp along the surface (Galim 2018, eq. 19, 20)."""
    assert jet.gradient is not None and jet.hessian is not None
    squared = dot(jet.gradient, jet.gradient)
    change = apply(jet.hessian, dp)
    tangential = subtract(change, scale(n, dot(n, change)))
    return scale(tangential, 1.0 / xp.sqrt(xp.where(squared == 0, 1.0, squared)))


def transfer(xp: Engine, beam: Beam, jet: Jet, p: Vector, t: Array) -> Beam:
    """Move a beam to the surface (Galim 2018, table 1, with the dt/dx that it lacks).

    Parameters
    ----------
    xp
        The engine.
    beam
        The beam at its origin.
    jet
        Jet of the surface at the hit, order 1.
    p, t
        The hit and its ray parameter.
    """
    assert jet.gradient is not None
    g = jet.gradient
    cosine = dot(g, beam.d)
    inverse = 1.0 / xp.where(cosine == 0, 1.0, cosine)

    def moved(dp: Vector, dd: Vector) -> Vector:
        straight = along(dp, dd, t)
        dt = -dot(g, straight) * inverse
        return along(straight, beam.d, dt)

    return Beam(p, beam.d, moved(beam.dp_dx, beam.dd_dx), moved(beam.dp_dy, beam.dd_dy), beam.dd_dx, beam.dd_dy)


def reflect(beam: Beam, n: Vector, dn_dx: Vector, dn_dy: Vector) -> Beam:
    """Mirror a beam at a surface (Igehy 1999, eq. 14, 15; Galim 2018, table 1)."""
    cosine = dot(beam.d, n)

    def mirrored(dd: Vector, dn: Vector) -> Vector:
        change = dot(dd, n) + dot(beam.d, dn)
        return subtract(dd, add(scale(dn, 2.0 * cosine), scale(n, 2.0 * change)))

    d = reflected(beam.d, n)
    return Beam(beam.p, d, beam.dp_dx, beam.dp_dy, mirrored(beam.dd_dx, dn_dx), mirrored(beam.dd_dy, dn_dy))


def reflected(d: Vector, n: Vector) -> Vector:
    """Return the mirrored direction."""
    return subtract(d, scale(n, 2.0 * dot(d, n)))


class Passage(NamedTuple):
    """How a ray stands to a surface between two media.

    Attributes
    ----------
    facing
        -1 where the ray comes from inside (d . n > 0), 1 elsewhere: times the outward normal, the one that faces it.
    c, c_out
        Cosines of the angles to the normal before and after; `c_out` is 1 where there is no ray after.
    mu
        c' - eta c: how much of the facing normal is taken from eta d.
    total
        Mask: total internal reflection, at the critical angle itself too.
    """

    facing: Array
    c: Array
    c_out: Array
    mu: Array
    total: Array


def passage(xp: Engine, d: Vector, n: Vector, eta: Array) -> Passage:
    """Return the cosines of a refraction; `eta` = n_i / n_t.

    mu = (1 - eta^2) / (c' + eta c) in place of c' - eta c (Galim 2018, table 1), which has no digits left near eta = 1.
    """
    slope = dot(d, n)
    c = xp.abs(slope)
    # 1 - eta^2 (1 - c^2) without the cancellations of an index near 1 and of grazing light.
    step = (1.0 - eta) * (1.0 + eta)
    squared = step + (eta * c) * (eta * c)
    total = squared <= 0
    facing = xp.where(slope > 0, xp.full(slope, -1.0), 1.0)
    c_out = xp.sqrt(xp.where(total, 1.0, squared))
    return Passage(facing, c, c_out, step / (c_out + eta * c), total)


def refract(xp: Engine, beam: Beam, n: Vector, dn_dx: Vector, dn_dy: Vector, eta: Array) -> tuple[Beam, Array]:
    """Refract a beam at a surface; where nothing passes, mirror it (Igehy 1999, eq. 16 to 18; Galim 2018, table 1).

    The differential of mu is (eta mu / c') d(d . n).

    Parameters
    ----------
    xp
        The engine.
    beam
        The beam at the surface.
    n, dn_dx, dn_dy
        Outward unit normal and its differentials; all three are turned around for a beam from inside.
    eta
        n_i / n_t: index of the medium that the beam comes from over that of the one it enters.

    Returns
    -------
    beam
        The beam that goes on.
    total
        Mask: total internal reflection.
    """
    way = passage(xp, beam.d, n, eta)
    toward = scale(n, way.facing)
    growth = eta * way.mu / way.c_out

    def bent(dd: Vector, outward: Vector) -> Vector:
        dn = scale(outward, way.facing)
        dmu = growth * (dot(dd, toward) + dot(beam.d, dn))
        return subtract(scale(dd, eta), add(scale(dn, way.mu), scale(toward, dmu)))

    d = subtract(scale(beam.d, eta), scale(toward, way.mu))
    through = Beam(beam.p, d, beam.dp_dx, beam.dp_dy, bent(beam.dd_dx, dn_dx), bent(beam.dd_dy, dn_dy))
    back = reflect(beam, n, dn_dx, dn_dy)
    return Beam(*(select(xp, way.total, a, b) for a, b in zip(back, through, strict=True))), way.total


def refracted(xp: Engine, d: Vector, n: Vector, eta: Array) -> tuple[Vector, Array]:
    """Return the refracted direction alone, mirrored where nothing passes, and the mask of total reflection."""
    way = passage(xp, d, n, eta)
    through = subtract(scale(d, eta), scale(n, way.facing * way.mu))
    return select(xp, way.total, reflected(d, n), through), way.total


def reflectance(xp: Engine, d: Vector, n: Vector, eta: Array) -> Array:
    """Return the share of unpolarised light that a dielectric surface mirrors (Fresnel); 1 for total reflection.

    r_s = (eta c - c') / (eta c + c') and r_p = (c - eta c') / (c + eta c') with their numerators multiplied out, so
    that the small reflectance of an index near 1 keeps its digits.
    """
    way = passage(xp, d, n, eta)
    step = (1.0 - eta) * (1.0 + eta)
    s, p = eta * way.c + way.c_out, way.c + eta * way.c_out
    across = step / (s * s)
    # Grazing light at equal indices: nothing is mirrored, and p is 0.
    within = step * ((1.0 + eta * eta) * way.c * way.c - eta * eta) / xp.where(p == 0, 1.0, p * p)
    return xp.where(way.total, 1.0, 0.5 * (across * across + within * within))


def curvatures(xp: Engine, jet: Jet) -> tuple[Array, Array]:
    """Return the principal curvatures of the level set, k_min <= k_max, per world unit; 0 where the gradient vanishes.

    Eigenvalues of the shape operator (I - n n^T) H (I - n n^T) / |g| in the tangent plane; positive where the surface
    bends away from its outward normal, as a ball's does. In a tangent frame the 2x2 matrix keeps the digits that mean
    and Gaussian curvature lose where the two are equal.
    """
    assert jet.gradient is not None and jet.hessian is not None
    squared = dot(jet.gradient, jet.gradient)
    first, second = _tangents(xp, normal(xp, jet))
    turned = apply(jet.hessian, first)
    inverse = xp.where(squared == 0, 0.0, 1.0 / xp.sqrt(xp.where(squared == 0, 1.0, squared)))
    a, b, c = dot(first, turned), dot(second, turned), dot(second, apply(jet.hessian, second))
    mean, half = 0.5 * (a + c), 0.5 * (a - c)
    spread = xp.sqrt(half * half + b * b)
    return (mean - spread) * inverse, (mean + spread) * inverse


def _tangents(xp: Engine, n: Vector) -> tuple[Vector, Vector]:
    """Return two unit vectors across a unit vector and each other (Duff et al. 2017)."""
    sign = xp.where(n[2] >= 0, xp.full(n[2], 1.0), -1.0)
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]), (b, sign + n[1] * n[1] * a, -n[1])


def crosses_horizon(xp: Engine, beam: Beam, jet: Jet) -> Array:
    """Say whether some ray within half a pixel runs along the tangent plane, or the ray itself does."""
    assert jet.gradient is not None
    g = jet.gradient
    reach = 0.5 * (xp.abs(dot(g, beam.dd_dx)) + xp.abs(dot(g, beam.dd_dy)))
    return reach >= xp.abs(dot(g, beam.d))


def passes_caustic(xp: Engine, beam: Beam, t: Array) -> Array:
    """Say whether the beam's cross-section (dp_dx x dp_dy) . d vanishes strictly between its origin and t.

    The cross-section is a quadratic in t; its Bernstein coefficients over the way decide. A double root, the focus of
    a sphere, counts: each coefficient may be off by 64 units in the last place of the largest number that it is a sum
    of, for near an end of the way it is a small difference of such. Each of the two
    displacements is taken in its own size, which no root depends on: a beam as thin as 1e-30 or as wide as 1e30
    neither under- nor overflows float32. Only this segment counts: a mirror or a refraction that turns the sign of
    the cross-section does so at the segment's end.
    """
    (px, qx), (py, qy) = (
        _sized(xp, dp, scale(dd, t)) for dp, dd in ((beam.dp_dx, beam.dd_dx), (beam.dp_dy, beam.dd_dy))
    )
    first, last = dot(cross(px, py), beam.d), dot(cross(qx, qy), beam.d)
    mixed = 0.5 * (dot(cross(px, qy), beam.d) + dot(cross(qx, py), beam.d))
    b0, b1 = first, first + mixed
    b2 = b1 + (mixed + last)
    opposite = (b0 < 0) & (b2 > 0) | (b0 > 0) & (b2 < 0)
    dips = (b0 < 0) & (b2 < 0) & (b1 > 0) | (b0 > 0) & (b2 > 0) & (b1 < 0)
    rounding = 64.0 * xp.eps * (xp.abs(first) + 2.0 * xp.abs(mixed) + xp.abs(last))
    slack = rounding * (xp.abs(b0) + xp.abs(b1) + xp.abs(b2))
    return opposite | dips & (b1 * b1 + slack >= b0 * b2)


def _sized(xp: Engine, p: Vector, q: Vector) -> tuple[Vector, Vector]:
    """Divide two vectors by their greatest component; null vectors stay."""
    largest = xp.abs(p[0])
    for component in (*p[1:], *q):
        largest = xp.maximum(largest, xp.abs(component))
    inverse = 1.0 / xp.where(largest == 0, 1.0, largest)
    return scale(p, inverse), scale(q, inverse)


def is_edge(xp: Engine, jet: Jet) -> Array:
    """Say whether the gradient of a distance is far from unit length."""
    assert jet.gradient is not None
    squared = dot(jet.gradient, jet.gradient)
    return (squared < (1 - EDGE_LIMIT) ** 2) | (squared > (1 + EDGE_LIMIT) ** 2)
