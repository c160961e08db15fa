"""Derivatives of the distance from those of the surface at the foot.

In: the gradient and Hessian of any function F that is 0 on the surface and positive outside, at the foot of p, and the
signed distance of p. Out: the shape operator S there, and the Hessian of the distance at p,

    S = P H_F P / |grad F|,   P = I - n n^T,   H = S (I + d S)^-1  in the tangent plane.

Inside, vectors are stored by columns, (3, n), and symmetric matrices by their six entries xx, yy, zz, yz, zx, xy: NumPy
is slow along an axis of three.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Frame(NamedTuple):
    """Unit normal and two unit tangents, each (3, n), n = e1 x e2."""

    n: np.ndarray
    e1: np.ndarray
    e2: np.ndarray


def dot(a: Float[np.ndarray, "3 n"], b: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, " n"]:
    """Inner products."""
    product: Float[np.ndarray, " n"] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def times(h: Float[np.ndarray, "6 n"], v: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "3 n"]:
    """Symmetric matrices times vectors."""
    xx, yy, zz, yz, zx, xy = h
    x, y, z = v
    return np.stack([xx * x + xy * y + zx * z, xy * x + yy * y + yz * z, zx * x + yz * y + zz * z])


def square(v: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "6 n"]:
    """Outer product of vectors with themselves."""
    return mixed(v, v) / 2


def mixed(a: Float[np.ndarray, "3 n"], b: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "6 n"]:
    """Entries of a b^T + b a^T."""
    diagonal = 2 * a * b
    beside = [a[i] * b[j] + a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return np.concatenate([diagonal, np.stack(beside)])


def frame(n: Float[np.ndarray, "3 n"]) -> Frame:
    """Tangents to a unit normal, without a direction at which they cancel (Duff et al. 2017)."""
    x, y, z = n
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    e1 = np.stack([1 + sign * x * x * a, sign * b, -sign * x])
    return Frame(n, e1, np.stack([b, sign + y * y * a, -y]))


def operator(
    at: Frame, size: Float[np.ndarray, " n"], hessian: Float[np.ndarray, "6 n"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries S11, S12, S22 of the shape operator in the tangents, each (n,); `size` is |grad F|."""
    h1, h2 = times(hessian, at.e1), times(hessian, at.e2)
    return dot(h1, at.e1) / size, dot(h1, at.e2) / size, dot(h2, at.e2) / size


def distance_hessian(
    gradient: Float[np.ndarray, "3 n"], hessian: Float[np.ndarray, "6 n"], distance: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3 3"]:
    """Hessian of the signed distance at n + d normal; a curvature that is infinite there is left out.

    Parameters
    ----------
    gradient, hessian
        Of F at the foot, outward.
    distance
        Signed distance d.
    """
    size = np.sqrt(dot(gradient, gradient))
    at = frame(gradient / size)
    s11, s12, s22 = operator(at, size, hessian)
    # For 2 x 2 matrices S (I + d S)^-1 = (S + d det S) / (1 + d tr S + d^2 det S), which factors into 1 + d k.
    determinant = s11 * s22 - s12 * s12
    bend = 1 + distance * (s11 + s22) + distance**2 * determinant
    inverse = np.where(bend == 0, 0.0, 1 / np.where(bend == 0, 1.0, bend))
    moved = distance * determinant
    entries = (s11 + moved) * inverse * square(at.e1) + (s22 + moved) * inverse * square(at.e2)
    entries += s12 * inverse * mixed(at.e1, at.e2)
    full: Float[np.ndarray, "n 3 3"] = entries[[[0, 5, 4], [5, 1, 3], [4, 3, 2]]].transpose(2, 0, 1)
    return full


def tangential(gradient: Float[np.ndarray, "n 2 3"], n: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
    """Gradients in space less their share along the unit normal."""
    share = np.einsum("nij,nj->ni", gradient, n)
    tangential: Float[np.ndarray, "n 2 3"] = gradient - share[:, :, None] * n[:, None, :]
    return tangential
