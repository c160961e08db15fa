"""What happens to a beam: transfer to a surface, reflection; each with its derivative (Galim 2018, table 1).

In: a beam and a jet of the surface. Out: the beam after the step. Derivatives are linear in the incoming ones and are
never clamped.
"""

from sdfbake.engine import Array, Engine
from sdfrender.field import Jet
from sdfrender.rays import Beam
from sdfrender.vector import Vector, add, along, apply, cross, dot, scale, subtract

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


def crosses_horizon(xp: Engine, beam: Beam, jet: Jet) -> Array:
    """Say whether some ray within half a pixel runs along the tangent plane, or the ray itself does."""
    assert jet.gradient is not None
    g = jet.gradient
    reach = 0.5 * (xp.abs(dot(g, beam.dd_dx)) + xp.abs(dot(g, beam.dd_dy)))
    return reach >= xp.abs(dot(g, beam.d))


def passes_caustic(xp: Engine, beam: Beam, t: Array) -> Array:
    """Say whether the beam's cross-section (dp_dx x dp_dy) . d vanishes strictly between its origin and t.

    The cross-section is a quadratic in t; its Bernstein coefficients over the way decide. A double root, the focus of
    a sphere, counts; rounding is allowed for by 64 units in the last place of the discriminant.
    """
    first = dot(cross(beam.dp_dx, beam.dp_dy), beam.d)
    mixed = 0.5 * (dot(cross(beam.dp_dx, beam.dd_dy), beam.d) + dot(cross(beam.dd_dx, beam.dp_dy), beam.d))
    last = dot(cross(beam.dd_dx, beam.dd_dy), beam.d)
    b0, b1 = first, first + mixed * t
    b2 = b1 + (mixed + last * t) * t
    opposite = (b0 < 0) & (b2 > 0) | (b0 > 0) & (b2 < 0)
    dips = (b0 < 0) & (b2 < 0) & (b1 > 0) | (b0 > 0) & (b2 > 0) & (b1 < 0)
    return opposite | dips & (b1 * b1 * (1.0 + 64.0 * xp.eps) >= b0 * b2)


def is_edge(xp: Engine, jet: Jet) -> Array:
    """Say whether the gradient of a distance is far from unit length."""
    assert jet.gradient is not None
    squared = dot(jet.gradient, jet.gradient)
    return (squared < (1 - EDGE_LIMIT) ** 2) | (squared > (1 + EDGE_LIMIT) ** 2)
