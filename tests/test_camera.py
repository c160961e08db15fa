"""The pinhole camera: where pixels look, and the derivatives of it."""

import numpy as np
import pytest

from sdfbake.complaint import BadInput
from sdfrender import Camera
from validate.displaced import richardson

CAMERAS = {
    "plain": Camera((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), size=(6, 4)),
    "tilted": Camera((1.0, -2.0, 3.0), (0.2, 0.1, -0.3), (0.3, 1.0, 0.2), 70.0, (5, 8)),
    "wide": Camera((0.0, 1e3, 0.0), (0.0, 0.0, 0.5), (0.0, 0.0, 1.0), 120.0, (16, 2)),
}


@pytest.fixture(params=CAMERAS.values(), ids=CAMERAS)
def camera(request):
    return request.param


def test_directions_are_unit_and_their_differentials_perpendicular(camera):
    """A few roundings each: 4 units in the last place."""
    rays = camera.rays()
    eps = np.finfo(float).eps
    assert len(rays) == camera.size[0] * camera.size[1]
    assert np.abs(np.linalg.norm(rays.d, axis=1) - 1).max() < 4 * eps
    for dd in (rays.dd_dx, rays.dd_dy):
        assert np.abs(np.sum(rays.d * dd, axis=1)).max() < 4 * eps * np.linalg.norm(dd, axis=1).max()
    assert not rays.dp_dx.any() and not rays.dp_dy.any()
    assert (rays.p == np.array(camera.position)).all()


def pixel_directions(camera, dx, dy):
    """Directions by elementary geometry, without the camera's own frame: a basis by Gram and Schmidt."""
    view = np.subtract(camera.target, camera.position)
    view = view / np.linalg.norm(view)
    up = np.array(camera.up) - np.dot(camera.up, view) * view
    up = up / np.linalg.norm(up)
    right = np.cross(view, up)
    width, height = camera.size
    row, column = np.mgrid[0:height, 0:width]
    y = 1 - 2 * (row.ravel() + 0.5 + dy) / height
    x = (2 * (column.ravel() + 0.5 + dx) / width - 1) * width / height
    tangent = np.tan(np.radians(camera.fov) / 2)
    d = view + tangent * (x[:, None] * right + y[:, None] * up)
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_pixels_look_where_geometry_says(camera):
    # Ten operations of rounding 1e-16 each.
    assert np.abs(camera.rays().d - pixel_directions(camera, 0, 0)).max() < 2e-15


def test_differentials_are_those_of_displaced_pixels(camera):
    rays = camera.rays()
    truth = richardson(lambda dx, dy: pixel_directions(camera, dx, dy), step=0.05)
    for ours, theirs, error in ((rays.dd_dx, truth.d_dx, truth.error_dx), (rays.dd_dy, truth.d_dy, truth.error_dy)):
        assert (np.abs(ours - theirs) <= error + 1e-13).all()  # rounding 2e-16 over a step of 0.025, twice
        assert error.max() < 1e-3 * np.abs(ours).max()


def test_the_first_pixel_is_top_left():
    rays = CAMERAS["plain"].rays()
    first, last = rays.d[0], rays.d[-1]
    assert first[0] < 0 < first[1] and last[1] < 0 < last[0]
    assert rays.d[5][0] > 0 and rays.d[5][1] > 0  # the end of the first row
    assert (rays.dd_dx[:, 0] > 0).all() and (rays.dd_dy[:, 1] < 0).all()


def test_pixels_are_square_and_the_field_of_view_is_vertical():
    camera = Camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=90.0, size=(30, 10))
    d = camera.rays().d.reshape(10, 30, 3)
    plane = d[..., :2] / -d[..., 2:]  # at distance 1 the picture is 2 high and 6 wide
    assert plane[0, 0] == pytest.approx([-2.9, 0.9], abs=1e-14)
    assert plane[-1, -1] == pytest.approx([2.9, -0.9], abs=1e-14)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"target": (0.0, 0.0, 2.0)}, "looks at itself"),
        ({"up": (0.0, 0.0, 1.0)}, "along 'up'"),
        ({"up": (0.0, 0.0, 0.0)}, "along 'up'"),
        ({"fov": 0.0}, "fov"),
        ({"fov": 180.0}, "fov"),
        ({"fov": float("nan")}, "fov"),
        ({"size": (0, 4)}, "size"),
        ({"position": (float("nan"), 0.0, 0.0)}, "camera"),
    ],
    ids=str,
)
def test_cameras_that_cannot_be(change, says):
    with pytest.raises(BadInput, match=says):
        Camera(**{"position": (0.0, 0.0, 2.0), "target": (0.0, 0.0, 0.0), **change})
