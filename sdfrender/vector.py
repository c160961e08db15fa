"""Vectors as tuples of three one-dimensional arrays: what both engines do fastest."""

from typing import NamedTuple

from sdfbake.engine import Array, Engine

Vector = tuple[Array, Array, Array]


class Symmetric(NamedTuple):
    """A symmetric 3x3 matrix."""

    xx: Array
    yy: Array
    zz: Array
    xy: Array
    xz: Array
    yz: Array


def dot(a: Vector, b: Vector) -> Array:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a: Vector, s: Array) -> Vector:
    """Return s a."""
    return (a[0] * s, a[1] * s, a[2] * s)


def along(p: Vector, d: Vector, t: Array) -> Vector:
    """Return p + t d."""
    return (p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2])


def apply(matrix: Symmetric, a: Vector) -> Vector:
    """Return the matrix times the vector."""
    return (
        matrix.xx * a[0] + matrix.xy * a[1] + matrix.xz * a[2],
        matrix.xy * a[0] + matrix.yy * a[1] + matrix.yz * a[2],
        matrix.xz * a[0] + matrix.yz * a[1] + matrix.zz * a[2],
    )


def select(xp: Engine, mask: Array, yes: Vector, no: Vector) -> Vector:
    """Choose vectors by mask."""
    return (xp.where(mask, yes[0], no[0]), xp.where(mask, yes[1], no[1]), xp.where(mask, yes[2], no[2]))


def zero(xp: Engine, like: Array) -> Vector:
    """Return null vectors as many as `like`."""
    nothing = xp.full(like, 0.0)
    return (nothing, nothing, nothing)
