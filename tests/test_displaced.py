"""Richardson differences: exact where they must be, of order four; and the closed forms checked by them."""

import numpy as np
import pytest

from datasets_synthetic import mesh, shape
from sdfrender import Camera
from validate.beam import MeshRays, displace
from validate.closed import ExactReference
from validate.displaced import richardson
from validate.embree import MeshReference
from validate.metrics import footprint


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


CASES = [("sphere", 0), ("torus", 0), ("torus", 1), ("box", 0), ("mirror", 0), ("mirror", 1)]


def camera(name: str) -> Camera:
    place = (0.0, 0.0, 1.9) if name == "mirror" else (0.9, 0.8, 2.6)
    return Camera(place, (0.0, 0.0, 0.0), fov=28.0 if name == "mirror" else 40.0, size=(48, 48))


@pytest.mark.parametrize(("name", "bounces"), CASES)
def test_closed_forms_match_displaced_rays(name: str, bounces: int) -> None:
    reference, rays = ExactReference(shape(name)), camera(name).rays()
    hits = reference.follow(rays, bounces)[-1]

    def outputs(dx: float, dy: float) -> np.ndarray:
        near = reference.follow(displace(rays, dx, dy), bounces)[-1]
        return np.where((near.hit & (near.chart == hits.chart))[:, None], near.uv, np.nan)

    truth = richardson(outputs, step=0.05)
    bar = np.stack([truth.error_dx, truth.error_dy], axis=2)
    good = hits.hit & np.isfinite(bar).all(axis=(1, 2))
    assert good.sum() > 30
    ours = np.stack([hits.duv_dx, hits.duv_dy], axis=2)[good]
    difference = np.linalg.norm(ours - np.stack([truth.d_dx, truth.d_dy], axis=2)[good], axis=(1, 2))
    # Beyond the bar there is rounding: 1e-16 / 0.025 in uv, and 1e-7 of the hit where two Newton steps start 1e-9 off.
    excess = difference - np.linalg.norm(bar[good], axis=(1, 2))
    assert np.max(excess / np.linalg.norm(ours, axis=(1, 2))) < 1e-6


@pytest.mark.parametrize(("name", "bounces"), [("torus", 0), ("torus", 1), ("mirror", 1)])
def test_the_mesh_converges_to_the_closed_form(name: str, bounces: int) -> None:
    rays = camera(name).rays()
    truth = ExactReference(shape(name)).follow(rays, bounces)[-1]
    errors = []
    for edge in (0.08, 0.04):
        hits = MeshReference(mesh(name, edge)).follow(rays, bounces, "angle")[-1]
        both = hits.hit & truth.hit & (hits.chart == truth.chart)
        ours, exact = (footprint(h.duv_dx[both], h.duv_dy[both], 1) for h in (hits, truth))
        errors.append(np.median(np.linalg.norm(ours - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))))
    # Position converges by the square of the edge, tangents and interpolated curvature at least by its first power.
    assert errors[1] < 0.7 * errors[0] and errors[1] < 0.1
