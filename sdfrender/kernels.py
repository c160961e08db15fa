"""Interpolation kernels as data (Galim 2018, eq. 8 to 10, 21).

In: a name. Out: a `Kernel`: the weights of its taps as polynomials over a cell, their Bezier form, and the prefilter
that turns samples into coefficients. The constructor asserts the algebra that a kernel must satisfy.
"""

from dataclasses import dataclass, field
from math import comb

import numpy as np
from jaxtyping import Float

from sdfbake.complaint import BadInput

NAMES = ("linear", "catmull-rom", "bspline")


@dataclass(frozen=True, slots=True, eq=False)
class Kernel:
    """A separable interpolation kernel over a cell of width 1.

    Attributes
    ----------
    name
        Its name.
    weights
        (taps, degree + 1): row k holds the coefficients of 1, t, t^2, ... of the weight of tap k.
    prefilter
        Three symmetric taps that turn samples into coefficients, or (0, 1, 0).
    reproduces
        Degree of the polynomials that samples -> prefilter -> kernel gives back.
    bezier
        (degree + 1, taps): Bernstein coefficients of the weights over the cell.
    overlap
        Greatest sum of the weights' magnitudes over the cell: 1 where the curve stays in the hull of its taps.
    """

    name: str
    weights: Float[np.ndarray, "taps terms"]
    prefilter: tuple[float, float, float]
    reproduces: int
    bezier: Float[np.ndarray, "terms taps"] = field(init=False)
    overlap: float = field(init=False)

    def __post_init__(self) -> None:
        weights = np.asarray(self.weights, float)
        degree = weights.shape[1] - 1
        power_to_bernstein = np.array(
            [[comb(r, p) / comb(degree, p) if p <= r else 0.0 for p in range(degree + 1)] for r in range(degree + 1)]
        )
        t = np.linspace(0.0, 1.0, 1025)[:, None] ** np.arange(degree + 1)
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "bezier", power_to_bernstein @ weights.T)
        object.__setattr__(self, "overlap", float(np.abs(t @ weights.T).sum(axis=1).max()))
        self._assert_algebra()

    def _assert_algebra(self) -> None:
        """Weights sum to 1, their derivatives to 0, and the polynomials of the claimed degree come back."""
        total = self.weights.sum(axis=0)
        assert abs(total[0] - 1) < 1e-15, f"{self.name}: the weights sum to {total[0]}"
        assert np.abs(total[1:]).max() < 1e-15, f"{self.name}: the derivatives of the weights sum to {total[1:]}"
        assert abs(sum(self.prefilter) - 1) < 1e-15, f"{self.name}: the prefilter changes a constant"
        t = np.linspace(0.0, 1.0, 5)
        at = t[:, None] ** np.arange(self.weights.shape[1]) @ self.weights.T
        taps = np.arange(self.taps) + self.first
        for degree in range(self.reproduces + 1):
            nodes = np.stack([(taps + shift).astype(float) ** degree for shift in (-1, 0, 1)])
            error = np.abs(at @ (np.asarray(self.prefilter) @ nodes) - t**degree).max()
            assert error < 1e-13, f"{self.name}: t^{degree} comes back with an error of {error}"

    @property
    def taps(self) -> int:
        """Taps per axis."""
        return int(self.weights.shape[0])

    @property
    def degree(self) -> int:
        """Degree of the weights."""
        return int(self.weights.shape[1]) - 1

    @property
    def first(self) -> int:
        """Position of the first tap relative to the cell's lower sample: 0 or -1."""
        return 1 - self.taps // 2

    @property
    def filtered(self) -> bool:
        """Whether the prefilter does anything."""
        return self.prefilter != (0.0, 1.0, 0.0)

    def derivative(self, order: int) -> Float[np.ndarray, "taps terms"]:
        """Coefficients of the weights' derivative of an order, as `weights`."""
        rows = self.weights
        for _ in range(order):
            rows = rows[:, 1:] * np.arange(1, rows.shape[1]) if rows.shape[1] > 1 else rows * 0
        return rows


def linear() -> Kernel:
    """Trilinear interpolation (Galim 2018, eq. 9)."""
    return Kernel("linear", np.array([[1.0, -1.0], [0.0, 1.0]]), (0.0, 1.0, 0.0), reproduces=1)


def catmull_rom(tension: float = 0.5) -> Kernel:
    """Cardinal spline (Galim 2018, eq. 21); only a tension of 1/2 gives linear functions back."""
    tau = tension
    weights = np.array(
        [[0, -tau, 2 * tau, -tau], [1, 0, tau - 3, 2 - tau], [0, tau, 3 - 2 * tau, tau - 2], [0, 0, -tau, tau]]
    )
    return Kernel("catmull-rom", weights, (0.0, 1.0, 0.0), reproduces=2 if tau == 0.5 else 0)


def bspline() -> Kernel:
    """Cubic B-spline on quasi-interpolating coefficients: C2, of fourth order, the default."""
    weights = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6
    return Kernel("bspline", weights, (-1 / 6, 8 / 6, -1 / 6), reproduces=3)


def kernel(name: str, tension: float = 0.5) -> Kernel:
    """Return a kernel by name.

    Raises
    ------
    BadInput
        For an unknown name or a tension outside [0, 1].
    """
    if name not in NAMES:
        raise BadInput(f"there is no kernel '{name}': choose one of {', '.join(NAMES)}")
    if not 0.0 <= tension <= 1.0:
        raise BadInput(f"the tension of catmull-rom is {tension}: choose a number from 0 to 1")
    return {"linear": linear, "bspline": bspline}.get(name, lambda: catmull_rom(tension))()
