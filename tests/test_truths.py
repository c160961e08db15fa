"""The suite that holds truths against each other: what it finds on made-up routes, and what the section says."""

from dataclasses import dataclass

import numpy as np
import pytest

from datasets_synthetic import mesh
from validate.embree import MeshReference
from validate.experiment import Run
from validate.sections import truths as section
from validate.suites import truths
from validate.views import TEXELS, framing


@dataclass
class Hits:
    """A page that rays meet at right angles: u = sin p_x, and its derivative times `wrong`."""

    p: np.ndarray
    duv_dx: np.ndarray
    duv_dy: np.ndarray

    @property
    def t(self):
        return np.ones(len(self.p))

    @property
    def n(self):
        return np.tile([0.0, 0.0, 1.0], (len(self.p), 1))

    @property
    def uv(self):
        return np.stack([np.sin(self.p[:, 0]), self.p[:, 1]], axis=1)

    @property
    def chart(self):
        return np.zeros(len(self.p), np.int64)


def route(wrong, rays):
    slope = wrong * np.cos(rays.p[:, :1])
    du, dv = (np.hstack([slope * dp[:, :1], dp[:, 1:2]]) for dp in (rays.dp_dx, rays.dp_dy))
    hits = Hits(rays.p, du, dv)
    return hits, hits.chart


def rays():
    from sdfrender import Rays

    p = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    d, x, y, none = (np.tile(row, (20, 1)) for row in ([0.0, 0, -1], [0.1, 0, 0], [0, 0.1, 0], [0.0, 0, 0]))
    return Rays(p, d, x, y, none, none)


def measured(wrong, step):
    blank = Run("truths", "page", {"truth": "closed forms", "against": "displaced rays"}, {"step": step}, "error")
    return truths._displaced(blank, lambda given: route(wrong, given), rays(), step)


def test_displaced_rays_agree_with_a_right_derivative_within_their_bar():
    errors = []
    for step in (0.8, 0.4):
        values = measured(1.0, step).values
        assert values["difference.max"] < values["bar.max"]
        errors.append(values["difference.p50"])
    # Fourth order: half the step leaves a sixteenth.
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.01)


def test_a_wrong_derivative_is_off_by_what_it_is_wrong():
    # J = diag(cos, 1) / 10: one percent of the first entry, of the length of both.
    values = measured(1.01, 0.05).values
    c = np.cos(rays().p[:, 0])
    assert values["difference.max"] == pytest.approx(np.max(0.01 * c / np.hypot(1.01 * c, 1)), rel=1e-6)


def test_the_closest_face_is_the_one_that_embree_names():
    reference = MeshReference(mesh("torus", 0.2))
    blank = Run("truths", "m", {"truth": "texture coordinates by face", "against": "the mesh, by Embree"}, {}, "error")
    found = truths._by_face(blank, reference, framing(reference.mesh.bounds, 16, truths.DIRECTION).rays())
    # A place on a face, rounded by 2e-16 of the size, read in texels of up to 1024 per 0.3 of it.
    assert found.values["difference.max"] < 16 * np.finfo(float).eps * TEXELS * 10
    assert found.values["difference.count"] > 50


def test_the_section_follows_the_numbers():
    runs = [measured(1.0, step) for step in (0.8, 0.4, 0.2, section.STEP)]
    found = section.section(runs)
    assert "Closed forms and displaced rays differ by at most" in found.finding[0]
    assert "shrink with order 4.0" in found.finding[1]
    assert len(found.tables[0].rows) == 1 and len(found.pictures) == 1
