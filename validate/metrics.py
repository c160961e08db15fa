"""What is measured, as records: name, unit, which way is better, and the function.

In: what two routes saw at the same pixels (`Seen`), or two images in linear light. Out: one number per pixel, and
summaries of many. Footprints J = [dT/dx dT/dy] in texels per pixel; Galim 2018, eq. 24 and 25.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Literal, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int, Num

from validate.flip import flip

T = TypeVar("T")

# Below this many texels per pixel a footprint has no level of detail worth comparing: log2 is held here.
TINY = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What one route saw at each pixel.

    Attributes
    ----------
    t
        Ray distance, infinite for a miss.
    n
        Unit normal.
    uv
        Texture coordinates.
    jacobian
        Columns d uv / dx and d uv / dy in texels per pixel.
    chart
        Chart id.
    voxel
        Spacing of the grid under test, the unit of hit errors.
    texels
        Texels along either side of the texture, the unit of errors of texture coordinates.
    """

    t: Float[np.ndarray, " n"]
    n: Float[np.ndarray, "n 3"]
    uv: Float[np.ndarray, "n 2"]
    jacobian: Float[np.ndarray, "n 2 2"]
    chart: Int[np.ndarray, " n"]
    voxel: float = 1.0
    texels: float = 1.0

    @property
    def hit(self) -> Bool[np.ndarray, " n"]:
        """True where there was a hit."""
        return np.asarray(np.isfinite(self.t))

    def at(self, where: Bool[np.ndarray, " n"] | Int[np.ndarray, " m"]) -> "Seen":
        """The same at some of the pixels."""
        return replace(
            self,
            t=self.t[where],
            n=self.n[where],
            uv=self.uv[where],
            jacobian=self.jacobian[where],
            chart=self.chart[where],
        )


Image = Float[np.ndarray, "h w c"]
# The same picture with the film shifted by parts of a pixel.
Film = Float[np.ndarray, "shifts h w c"]


@dataclass(frozen=True, slots=True)
class Metric(Generic[T]):
    """One way to compare: `function(ours, truth)` gives a number per pixel (or one for a whole image)."""

    name: str
    title: str
    unit: str
    better: Literal["lower", "higher"]
    function: Callable[[T, T], Float[np.ndarray, " n"]]


def footprint(
    duv_dx: Float[np.ndarray, "n 2"], duv_dy: Float[np.ndarray, "n 2"], size: int
) -> Float[np.ndarray, "n 2 2"]:
    """Stack derivatives per pixel into Jacobians in texels per pixel of a square texture of `size` texels."""
    return np.stack([duv_dx, duv_dy], axis=2) * float(size)


def hit_error(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """|t - t*| in voxels, where both hit."""
    return np.asarray(np.abs(ours.t - truth.t) / ours.voxel)


def missed(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """1 where one route hit and the other did not."""
    return np.asarray(ours.hit != truth.hit, np.float64)


def normal_angle(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """Angle between the normals in degrees, by atan2 (exact for small angles, where arccos is not)."""
    sine = np.linalg.norm(np.cross(ours.n, truth.n), axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, np.sum(ours.n * truth.n, axis=1))))


def jacobian_error(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """||J - J*|| / ||J*|| in the Frobenius norm; 0 where both vanish, 1 where only the truth does."""
    size = np.linalg.norm(truth.jacobian, axis=(1, 2))
    difference = np.linalg.norm(ours.jacobian - truth.jacobian, axis=(1, 2))
    alone = (difference > 0).astype(np.float64)
    return np.asarray(np.where(size > TINY, difference / np.where(size > TINY, size, 1.0), alone))


def lod(jacobian: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, " n"]:
    """Level of detail of Galim 2018, eq. 25: log2 of the longer column."""
    return np.asarray(np.log2(np.maximum(np.linalg.norm(jacobian, axis=1).max(axis=1), TINY)))


def lod_invariant(jacobian: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, " n"]:
    """Level of detail that does not change when the pixel axes turn: log2 of the largest singular value."""
    return np.asarray(np.log2(np.maximum(singular_values(jacobian)[:, 0], TINY)))


def singular_values(jacobian: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n 2"]:
    """Largest and smallest singular value, in closed form."""
    (a, b), (c, d) = np.moveaxis(jacobian, 0, -1)
    plus, minus = np.hypot(a + d, c - b), np.hypot(a - d, c + b)
    return np.stack([(plus + minus) / 2, np.abs(plus - minus) / 2], axis=1)


def lod_error(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """|L - L*| in mip levels, eq. 25."""
    return np.asarray(np.abs(lod(ours.jacobian) - lod(truth.jacobian)))


def lod_invariant_error(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """|L - L*| in mip levels, largest singular value."""
    return np.asarray(np.abs(lod_invariant(ours.jacobian) - lod_invariant(truth.jacobian)))


def singular_ratio(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """How far the ratio of largest singular values lies from 1: max(s/s*, s*/s) - 1."""
    return np.asarray(np.expm1(np.log(2.0) * np.minimum(lod_invariant_error(ours, truth), 64.0)))


def axis_angle(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """Angle between the ellipses' major axes in degrees, 0 to 90; weigh it by roundness: a circle has no axis."""
    turn = np.abs(_major_axis(ours.jacobian) - _major_axis(truth.jacobian)) % np.pi
    return np.asarray(np.degrees(np.minimum(turn, np.pi - turn)))


def _major_axis(jacobian: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, " n"]:
    """Direction of the largest eigenvalue of J J^T in radians."""
    (a, b), (c, d) = np.moveaxis(jacobian, 0, -1)
    return np.asarray(np.arctan2(2 * (a * c + b * d), a * a + b * b - c * c - d * d) / 2)


def wasserstein(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """Wasserstein-2 distance of the two ellipses, S = J J^T, relative to ||J*||.

    W^2 = tr S + tr S* - 2 tr (S^1/2 S* S^1/2)^1/2, and for matrices the last trace is the nuclear norm of J^T J*.
    """
    cross = np.swapaxes(ours.jacobian, 1, 2) @ truth.jacobian
    nuclear = singular_values(cross).sum(axis=1)
    square = (ours.jacobian**2).sum(axis=(1, 2)) + (truth.jacobian**2).sum(axis=(1, 2)) - 2 * nuclear
    size = np.maximum(np.linalg.norm(truth.jacobian, axis=(1, 2)), TINY)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)) / size)


def chart_mismatch(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """1 where the charts differ."""
    return np.asarray(ours.chart != truth.chart, np.float64)


def uv_error(ours: Seen, truth: Seen) -> Float[np.ndarray, " n"]:
    """|T - T*| in texels; it means something where the charts agree, and only there."""
    return np.asarray(np.linalg.norm(ours.uv - truth.uv, axis=1) * truth.texels)


def image_mse(ours: Image, truth: Image) -> Float[np.ndarray, " n"]:
    """Mean square difference of two images in linear light."""
    return np.atleast_1d(np.mean((np.asarray(ours, np.float64) - np.asarray(truth, np.float64)) ** 2))


def image_psnr(ours: Image, truth: Image) -> Float[np.ndarray, " n"]:
    """Peak signal-to-noise ratio in decibels for a peak of 1; 200 stands for equal images."""
    return np.asarray(np.minimum(-10.0 * np.log10(np.maximum(image_mse(ours, truth), 1e-20)), 200.0))


def image_flip(ours: Image, truth: Image) -> Float[np.ndarray, " n"]:
    """Mean over the picture of how visible the difference is when one flips between the two; see `validate.flip`."""
    return np.atleast_1d(flip(np.asarray(ours, np.float64), np.asarray(truth, np.float64)).mean())


def image_flicker(ours: Film, truth: Film) -> Float[np.ndarray, " n"]:
    """How much each pixel boils while the picture moves by parts of a pixel, in linear light.

    Standard deviation of ours - truth over the shifts, its root mean square over the channels. What the truth itself
    changes is no flicker, and an error that stays (a blur) is none either.
    """
    error = np.asarray(ours, np.float64) - np.asarray(truth, np.float64)
    return np.asarray(np.sqrt(error.var(axis=0).mean(axis=-1)).ravel())


HIT_ERROR: Metric[Seen] = Metric("hit_error", "hit error", "voxel", "lower", hit_error)
UV_ERROR: Metric[Seen] = Metric("uv_error", "texture coordinates where charts agree", "texel", "lower", uv_error)
MISSED: Metric[Seen] = Metric("missed", "hit or miss differs", "share", "lower", missed)
FOOTPRINT: tuple[Metric[Seen], ...] = (
    HIT_ERROR,
    Metric("normal_angle", "normal angle", "degree", "lower", normal_angle),
    Metric("jacobian_error", "footprint error", "relative", "lower", jacobian_error),
    Metric("lod_error", "level-of-detail error, eq. 25", "mip level", "lower", lod_error),
    Metric(
        "lod_invariant_error", "level-of-detail error, rotation-invariant", "mip level", "lower", lod_invariant_error
    ),
    Metric("singular_ratio", "ratio of largest singular values - 1", "relative", "lower", singular_ratio),
    Metric("axis_angle", "major-axis angle", "degree", "lower", axis_angle),
    Metric("wasserstein", "Wasserstein-2 of the ellipses", "relative", "lower", wasserstein),
    Metric("chart_mismatch", "chart differs", "share", "lower", chart_mismatch),
)
IMAGE: tuple[Metric[Image], ...] = (
    Metric("mse", "mean square error", "linear light squared", "lower", image_mse),
    Metric("psnr", "peak signal-to-noise ratio", "dB", "higher", image_psnr),
    Metric("flip", "FLIP", "0 to 1", "lower", image_flip),
)
FLICKER: Metric[Film] = Metric("flicker", "flicker under sub-pixel shifts", "linear light", "lower", image_flicker)


def summary(values: Num[np.ndarray, " n"], limits: tuple[float, ...] = (0.5, 1.0)) -> dict[str, float]:
    """Count, mean, p50, p95, p99, greatest, and the share above each limit; every value must be finite.

    Raises
    ------
    ValueError
        If a value is not finite: none may leave a comparison.
    """
    values = np.asarray(values, np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"{int((~np.isfinite(values)).sum())} of {values.size} values are not finite")
    if values.size == 0:
        return {"count": 0.0}
    p50, p95, p99 = np.percentile(values, [50, 95, 99])
    record = {"count": float(values.size), "mean": float(values.mean()), "p50": float(p50), "p95": float(p95)}
    record |= {"p99": float(p99), "max": float(values.max())}
    return record | {f"share>{limit:g}": float((values > limit).mean()) for limit in limits}


def fitted_order(
    steps: Float[np.ndarray, " k"], errors: Float[np.ndarray, " k"], floor: Float[np.ndarray, " k"] | float = 0.0
) -> float:
    """Slope of log error over log step by least squares, over the steps whose error lies above the rounding `floor`.

    Returns 0 where fewer than two steps are left.
    """
    steps, errors = np.asarray(steps, np.float64), np.asarray(errors, np.float64)
    good = (errors > floor) & (errors > 0)
    if good.sum() < 2:
        return 0.0
    return float(np.polyfit(np.log(steps[good]), np.log(errors[good]), 1)[0])
