"""Richardson differences: exact where they must be, of order four, honest about their error."""

import numpy as np
import pytest

from validate.beam import MeshRays, displace
from validate.displaced import richardson


def test_exact_up_to_degree_four() -> None:
    # Central differences are even in the step: the extrapolation removes the e^2 term, so degrees 1 to 4 are exact.
    truth = richardson(lambda dx, dy: np.array([[dx**4 + dx**3 - 2 * dx, 5 * dy + dx * dy]]), step=0.5)
    np.testing.assert_allclose(truth.d_dx, [[-2.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(truth.d_dy, [[0.0, 5.0]], atol=1e-15)


def test_order_is_four_and_the_bar_covers_the_error() -> None:
    errors = []
    for step in (0.4, 0.2, 0.1):
        truth = richardson(lambda dx, dy: np.array([[np.exp(dx) * np.cos(dy)]]), step)
        error = abs(truth.d_dx[0, 0] - 1.0)
        assert error <= truth.error_dx[0, 0]
        errors.append(error)
    slope = np.log2(errors[0] / errors[1]), np.log2(errors[1] / errors[2])
    assert slope == pytest.approx((4.0, 4.0), abs=0.05)  # next term is relative e^2 / 20 < 1 %


def test_missing_neighbours_give_an_infinite_bar() -> None:
    truth = richardson(lambda dx, dy: np.array([[dx + 2 * dy, np.nan if dx > 0 else dx]]))
    assert np.isinf(truth.error_dx[0, 1]) and truth.d_dx[0, 1] == 0.0
    assert truth.d_dx[0, 0] == pytest.approx(1.0) and np.isfinite(truth.error_dy).all()


def test_displaced_rays_move_along_their_differentials() -> None:
    rng = np.random.default_rng(1)
    d = rng.normal(size=(5, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    tangent = [v - d * np.sum(v * d, axis=1, keepdims=True) for v in rng.normal(size=(2, 5, 3)) * 1e-2]
    p, dp_dx, dp_dy = rng.normal(size=(3, 5, 3))
    rays = MeshRays(p, d, dp_dx, dp_dy, tangent[0], tangent[1])
    truth = richardson(lambda dx, dy: np.hstack([displace(rays, dx, dy).p, displace(rays, dx, dy).d]), step=0.1)
    # Steps of 1e-3 rad leave a remainder of 1e-15; rounding 1e-16 / 0.05.
    np.testing.assert_allclose(truth.d_dx, np.hstack([dp_dx, tangent[0]]), atol=1e-13)
    np.testing.assert_allclose(truth.d_dy, np.hstack([dp_dy, tangent[1]]), atol=1e-13)
