"""Voxels that are not cubes, made cubes.

In: samples at one spacing per axis. Out: samples at the finest of these, by the cubic spline with not-a-knot ends along
each axis (de Boor 1978, ch. IV): it keeps the samples that it meets, and cubic polynomials everywhere.
"""

import numpy as np
from jaxtyping import Float

_STEP = 1 << 22  # samples made at once
# Of a voxel: how far the last sample may be off for spacings to count as equal. Files hold float32.
_EQUAL = 1e-3


def is_even(spacing: Float[np.ndarray, "3"], shape: tuple[int, ...]) -> bool:
    """Say whether the spacings are one number but for rounding, so that no sample is off by over 1e-3 voxels."""
    off = np.abs(spacing / np.median(spacing) - 1) * (np.array(shape) - 1)
    return bool(off.max() <= _EQUAL)


def even_shape(shape: tuple[int, ...], spacing: Float[np.ndarray, "3"]) -> tuple[int, int, int]:
    """Return how many samples of the finest spacing fit between the first and the last along each axis."""
    ratio = spacing / spacing.min()
    nx, ny, nz = np.floor((np.array(shape) - 1) * ratio + 1e-6).astype(int) + 1
    return int(nx), int(ny), int(nz)


def evened(values: Float[np.ndarray, "nx ny nz"], spacing: Float[np.ndarray, "3"]) -> Float[np.ndarray, "mx my mz"]:
    """Resample onto the finest spacing.

    Parameters
    ----------
    values
        Samples [x, y, z], at least 2 along every axis.
    spacing
        Along x, y, z.

    Returns
    -------
    samples
        float32, from the same first sample on; `even_shape` of them, none beyond the last one.
    """
    made = np.asarray(values, np.float32)
    for axis, count in enumerate(even_shape(values.shape, spacing)):
        if spacing[axis] != spacing.min():
            made = _along(made, axis, np.arange(count) * (spacing.min() / spacing[axis]))
    return np.ascontiguousarray(made)


def _along(values: Float[np.ndarray, "nx ny nz"], axis: int, at: Float[np.ndarray, " m"]) -> np.ndarray:
    """Interpolate at some places along an axis, in steps so that little is held in float64.

    The spline is linear in its samples, so that one matrix does for all lines of them.
    """
    from scipy.interpolate import make_interp_spline  # takes its time to import, and most files need none

    n = values.shape[axis]
    spline = make_interp_spline(np.arange(n), np.eye(n), k=min(3, n - 1))
    weights = spline(np.minimum(at, n - 1))
    lines = np.moveaxis(values, axis, 0).reshape(n, -1)
    made = np.empty((len(at), lines.shape[1]), np.float32)
    step = max(_STEP // len(at), 1)
    for start in range(0, lines.shape[1], step):
        made[:, start : start + step] = weights @ lines[:, start : start + step].astype(np.float64)
    rest = np.moveaxis(values, axis, 0).shape[1:]
    return np.moveaxis(made.reshape(len(at), *rest), 0, axis)
