"""What hits say about themselves: CAUSTIC, HORIZON, BAND and EDGE, each where it must and nowhere else."""

import numpy as np
import pytest

from datasets_synthetic import shape
from datasets_synthetic.sphere import Sphere
from sdfbake import Grid
from sdfbake.complaint import BadInput
from sdfrender import Camera, Flag, GridField, Rays, optics, reflect, transfer
from sdfrender.rays import Beam


def hollow(choice, n=48):
    """The inside of a ball of radius 0.8 as empty space: a concave mirror all around."""
    ball = Grid.from_function(Sphere(0.8), n, uv_mode="none")
    axis = [
        np.arange(count) * ball.lattice.spacing + ball.lattice.origin[a] for a, count in enumerate(ball.lattice.shape)
    ]
    x, y, z = np.meshgrid(*axis, indexing="ij")
    values = 0.8 - np.sqrt(x * x + y * y + z * z)
    return GridField(
        Grid.from_dense(values, origin=ball.lattice.origin, spacing=ball.lattice.spacing), "bspline", choice
    )


def test_a_concave_mirror_has_a_focus(choice):
    """Near the axis rays that run parallel meet at r / 2; the beam's cross-section vanishes there: CAUSTIC.

    Before the mirror the beam has none. A ray that stops at a surface short of the focus has none either: that is
    tested on the beam itself, at 0.9 and 1.1 of the focal length.
    """
    field = hollow(choice)
    p, d = np.array([[0.05, 0.02, -0.5]]), np.array([[0.0, 0.0, 1.0]])
    width = np.array([[1e-3, 0, 0]]), np.array([[0, 1e-3, 0]])
    rays = Rays(p, d, *width, np.zeros((1, 3)), np.zeros((1, 3)))
    hits, at = transfer(field, rays)
    assert hits.hit.all() and not hits.flags[0] & Flag.CAUSTIC
    out = reflect(field, hits, at)
    again, _ = transfer(field, out, on_surface=True)
    assert again.hit.all() and again.flags[0] & Flag.CAUSTIC
    # The focus: p + t d with dp + t dd = 0, r / 2 from the mirror; spherical aberration of (0.05 / 0.8)^2.
    focus = -np.sum(out.dp_dx * out.dd_dx, axis=1) / np.sum(out.dd_dx**2, axis=1)
    assert focus[0] == pytest.approx(0.4, rel=2e-2)

    def program(xp, *c):
        beam = optics.Beam(*(tuple(c[i : i + 3]) for i in range(0, 18, 3)))
        return {str(share): xp.integer(optics.passes_caustic(xp, beam, share * c[18])) for share in (0.9, 1.1)}

    out = choice.engine.run(program, [*out.columns(), focus])
    assert (out["0.9"].item(), out["1.1"].item()) == (0, 1)


def test_a_diverging_beam_has_no_caustic(choice, sphere):
    field = GridField(Grid.from_function(sphere, 32, uv_mode="none"), "bspline", choice)
    hits, at = transfer(field, Camera((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), size=(16, 16)).rays())
    assert not (hits.flags & Flag.CAUSTIC).any()
    mirrored = reflect(field, hits, at)
    again, _ = transfer(field, mirrored, on_surface=True)
    assert not (again.flags & Flag.CAUSTIC).any()


@pytest.mark.parametrize("size", [1e-30, 1e-7, 1.0, 1e30])
def test_a_caustic_does_not_depend_on_the_beams_width(size, choice):
    """Two foci at 1 and 2 of a beam of any width: none seen up to 0.9, one up to 1.1, both up to 2.1 (the cross-section
    is positive again), and none from 2.1 on."""

    def program(xp, x, dx, dy, begin, t):
        zero, one = xp.full(x, 0.0), xp.full(x, 1.0)
        thin = Beam((zero,) * 3, (zero, zero, one), (x + begin * dx, zero, zero), (zero, x + begin * dy, zero),
                    (dx, zero, zero), (zero, dy, zero))  # fmt: skip
        return {"seen": xp.integer(optics.passes_caustic(xp, thin, t))}

    begin, t = np.array([0.0, 0.0, 0.0, 2.1]), np.array([0.9, 1.1, 2.1, 3.0])
    out = choice.engine.run(program, [np.full(4, size), np.full(4, -size), np.full(4, -size / 2), begin, t])
    assert out["seen"].tolist() == [0, 1, 1, 0]


def test_grazing_footprints_cross_the_horizon(choice):
    """A plane seen at cosine c by pixels of 1e-2 rad: half a pixel of 5e-3 crosses the horizon iff c is below it."""
    x = np.arange(32.0)[:, None, None] + np.zeros((32, 8, 8))
    field = GridField(Grid.from_dense(x - 15.25), "linear", choice)
    cosines = np.array([0.5, 0.1, 0.02, 0.006, 0.004, 0.001])
    sine = np.sqrt(1 - cosines**2)
    d = np.stack([-cosines, sine, 0 * sine], axis=-1)
    across = 1e-2 * np.stack([sine, cosines, 0 * sine], axis=-1)
    p = np.array([15.25, 3.5, 3.5]) - 2.0 * d
    hits, _ = transfer(field, Rays(p, d, 0 * d, 0 * d, across, 0 * d + [0, 0, 1e-2]))
    assert hits.hit.all()
    assert ((hits.flags & Flag.HORIZON) > 0).tolist() == [False, False, False, False, True, True]


def test_an_edge_says_so(choice):
    """A box's edge is where interpolation cannot have a unit gradient; its faces can. Noise is no distance at all."""
    box = shape("box")
    field = GridField(Grid.from_function(box, 40, uv_mode="none"), "bspline", choice)
    low, high = box.bounds
    middle = 0.5 * (low + high)
    edge = np.array([high[0], high[1], middle[2]])
    targets = np.array([edge, [high[0], middle[1], middle[2]], [middle[0], middle[1], high[2]]])
    outward = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    nothing = np.zeros((3, 3))
    rays = Rays(targets + outward, -outward, nothing, nothing, nothing, nothing)
    hits, _ = transfer(field, rays)
    assert hits.hit.all()
    assert ((hits.flags & Flag.EDGE) > 0).tolist() == [True, False, False]
    values = np.random.default_rng(3).normal(size=(9, 9, 9))
    noise = GridField(Grid.from_dense(values), "bspline", choice)
    hits, _ = transfer(
        noise, Rays(np.full((1, 3), 4.0) - [[9, 0, 0]], np.array([[1.0, 0, 0]]), *(nothing[:1] for _ in range(4)))
    )
    assert hits.hit.all() and not hits.flags[0] & Flag.EDGE


@pytest.mark.parametrize(("band", "kernel"), [(1.2, "linear"), (1.75, "linear"), (3.0, "bspline")])
def test_beyond_the_band(choice, band, kernel):
    """A ball of 12 voxels, cut off at a band: BAND where a sample behind the hit's cell is cut off, and only there.

    The linear kernel reads the cell's eight corners: those of a cell with surface are less than sqrt(3) away. Samples
    that the B-spline's stencil and its prefilter read lie 2 voxels beyond the cell along every axis, the farthest
    3 sqrt(3) = 5.2 from a surface in it: with a band of 3 every hit sees some.
    """
    axis = np.arange(40) - 19.37
    r = np.sqrt(axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2) - 12.0
    values = np.clip(r, -band, band).astype(np.float32)
    rays = Camera((19.37, 19.37, 90.0), (19.37, 19.37, 19.37), fov=22.0, size=(32, 32)).rays()
    hits, _ = transfer(GridField(Grid.from_dense(values, band=band), kernel, choice), rays)
    unclaimed, _ = transfer(GridField(Grid.from_dense(values), kernel, choice), rays)
    flagged = (hits.flags[hits.hit] & Flag.BAND) > 0
    assert hits.hit.sum() > 400 and not (unclaimed.flags & Flag.BAND).any()
    if kernel == "bspline":
        assert flagged.all()
        return
    low = np.floor(hits.p[hits.hit]).astype(int)
    corners = [low + step for step in np.ndindex(2, 2, 2)]
    cut = np.any([np.abs(values[tuple(corner.T)]) >= np.float32(band * (1 - 1e-6)) for corner in corners], axis=0)
    inner = np.abs(hits.p[hits.hit] - np.rint(hits.p[hits.hit])).min(axis=1) > 1e-3  # either cell counts on a face
    assert np.array_equal(flagged[inner], cut[inner]) and inner.mean() > 0.9
    assert 0 < flagged.mean() < 1 if band < 1.73 else not flagged.any()


def test_a_band_is_positive():
    with pytest.raises(BadInput, match="band of 0 voxels"):
        Grid.from_dense(np.zeros((4, 4, 4)), band=0)


def test_our_own_grids_reach_far_enough():
    grid = Grid.from_function(Sphere(0.8), 24, uv_mode="none")
    hits, _ = transfer(GridField(grid, engine="numpy"), Camera((0, 0, 3), (0, 0, 0), size=(24, 24)).rays())
    assert hits.hit.any() and not (hits.flags & Flag.BAND).any()
