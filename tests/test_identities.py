"""The identities against steps whose maps are known: kept by what is right, broken by what is wrong, by how much."""

import numpy as np
import pytest

from datasets_synthetic.sphere import Sphere
from sdfrender import Rays
from validate.beam import MeshRays
from validate.course import Course, as_rays, defects, follow
from validate.exact import ShapeField
from validate.identities import direction_defect, perturbed, surface_defect, symplectic_defect


def bundles(rng, n=50, length=1.0):
    p = rng.normal(size=(n, 3))
    d = rng.normal(size=(n, 3))
    return perturbed(p, d / np.linalg.norm(d, axis=1, keepdims=True), rng, length)


def moved(rays, t):
    """Free flight by t: dp + t dd."""
    return MeshRays(rays.p + t * rays.d, rays.d, rays.dp_dx + t * rays.dd_dx, rays.dp_dy + t * rays.dd_dy, *turns(rays))


def turns(rays):
    return rays.dd_dx, rays.dd_dy


def test_free_flight_keeps_the_form(rng):
    before = bundles(rng)
    after = tuple(moved(rays, 3.0) for rays in before)
    # Sums of six products, each rounded once or twice, of lengths that the defect is relative to.
    assert symplectic_defect(before, after).max() < 16 * np.finfo(float).eps


def test_a_scaled_map_breaks_the_form_by_what_it_scales(rng):
    before = bundles(rng)
    after = tuple(MeshRays(r.p, r.d, 2 * r.dp_dx, 2 * r.dp_dy, *turns(r)) for r in before)
    # Omega doubles; and an index of 1/2 behind the step makes up for it.
    assert np.median(symplectic_defect(before, after)) > 0.01
    assert symplectic_defect(before, after, 1.0, 0.5).max() < 16 * np.finfo(float).eps


def test_the_defect_does_not_depend_on_the_unit_of_length(rng):
    for scale in (1e-6, 1e6):
        before = bundles(np.random.default_rng(1), length=scale)
        after = tuple(MeshRays(r.p, r.d, 2 * r.dp_dx, 2 * r.dp_dy, *turns(r)) for r in before)
        found = symplectic_defect(before, after, length=scale)
        reference = bundles(np.random.default_rng(1))
        doubled = tuple(MeshRays(r.p, r.d, 2 * r.dp_dx, 2 * r.dp_dy, *turns(r)) for r in reference)
        np.testing.assert_allclose(found, symplectic_defect(reference, doubled), rtol=1e-9)


def test_a_pinhole_cameras_own_derivatives_prove_nothing(rng):
    """dp = 0 on both axes: the form is 0 before and after, whatever becomes of the directions."""
    d = np.array([[0.0, 0.0, -1.0]])
    none = np.zeros((1, 3))
    pixel = [MeshRays(none, d, none, none, np.array([[1e-3, 0, 0]]), np.array([[0, 1e-3, 0]]))] * 2
    wrong = [MeshRays(none, d, none, none, 7 * ray.dd_dx, 5 * ray.dd_dy) for ray in pixel]
    assert symplectic_defect(tuple(pixel), tuple(wrong)).max() == 0


def test_directions_and_displacements_off_their_planes_are_seen():
    d, n = np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]])
    x, none = np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 3))
    good = MeshRays(none, d, x, none, x, none)
    assert direction_defect(good)[0] == 0 and surface_defect(n, good)[0] == 0
    tilted = MeshRays(none, d, x + 0.1 * n, none, x + 0.1 * d, none)
    # 0.1 of a vector of length sqrt(1.01) leaves the plane.
    assert direction_defect(tilted)[0] == pytest.approx(0.1 / np.sqrt(1.01))
    assert surface_defect(n, tilted)[0] == pytest.approx(0.1 / np.sqrt(1.01))
    assert direction_defect(MeshRays(none, 1.1 * d, x, none, x, none))[0] == pytest.approx(0.21)


def glass_rays(rng, n=64):
    p = np.tile([0.0, 0.0, 3.0], (n, 1))
    target = rng.uniform(-0.5, 0.5, (n, 3))
    d = (target - p) / np.linalg.norm(target - p, axis=1, keepdims=True)
    return perturbed(p, d, rng)[0]


def test_a_course_goes_in_and_out_of_glass_with_the_index_of_each_side(rng):
    course = Course(ShapeField(Sphere(0.8)), (1.5, 1.5))
    rays = glass_rays(rng)
    steps = list(follow(course, rays))
    assert [step.index[0] for step in steps] == [1.0, 1.5, 1.0]
    assert [step.beyond[0] for step in steps[:2]] == [1.5, 1.0]
    # Behind a ball there is nothing more to meet; what missed stays where it was.
    assert not steps[2].hits.hit.any() and np.array_equal(steps[2].at.p, steps[1].after.p)
    found = defects(course, rays, rng)
    assert found.hit[:2].all() and not found.hit[2].any()
    assert found.greatest.max() < 1e-12  # DESIGN's limit per bounce


def test_a_wrong_index_is_seen_on_the_way(rng, monkeypatch):
    from validate import course as module

    refract = module.refract
    monkeypatch.setattr(module, "refract", lambda *given, eta: refract(*given, eta=1 / eta))
    found = defects(Course(ShapeField(Sphere(0.8)), (1.5,)), glass_rays(rng), rng)
    assert np.median(found.symplectic[0]) > 1e-3


def test_as_rays_is_the_renderers_record(rng):
    assert isinstance(as_rays(bundles(rng)[0]), Rays)
