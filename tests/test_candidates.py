"""Candidate lists against brute force: nothing that may win is lost, whatever the faces and wherever they lie."""

import numpy as np
import pytest
from adversarial import EPS, ball, box, dirty, every_distance, flattened, in_pieces, named, sliver, soup

from sdfbake.band import Target, filled
from sdfbake.bricks import REACH, SIDE
from sdfbake.candidates import brick_candidates, children, offset, places, record, records
from sdfbake.engine import choose
from sdfbake.engine.choose import _jit_problem
from sdfbake.lattice import Lattice
from sdfbake.topology import corners

HALF_EPS32 = 2.0**-24


@pytest.fixture(params=["numpy", "drjit"])
def xp(request):
    if request.param == "drjit" and _jit_problem() is not None:
        pytest.skip("Dr.Jit cannot run here")
    return choose(request.param, 32).engine


def triangles(rng, count, thinness, extent):
    """Triangles anywhere in a lattice, of all sizes: a third corner off the first edge by the edge over a thinness."""
    a = rng.uniform(0, extent, (count, 3))
    size = extent * 10.0 ** rng.uniform(-3, -0.5, (count, 1))
    along, off = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, count, 3)))
    b, c = a + size * along, a + size * (rng.uniform(-0.5, 1.5, (count, 1)) * along + off / thinness)
    return named(np.concatenate([a, b, c]), np.arange(3 * count).reshape(3, -1).T)


@pytest.mark.parametrize("thinness", [1.0, 30.0, 1e3, 1e5, np.inf], ids=lambda value: f"{value:g}")
@pytest.mark.parametrize("bits", [32, 64])
def test_the_fast_distance_is_too_long_by_less_than_the_slack(xp, bits, thinness, rng):
    extent, count = 100.0, 200
    mesh = triangles(rng, count, thinness, extent)
    rows, slack = records(corners(mesh.vertices, mesh.faces), extent)
    points = rng.uniform(0, extent, (300, 3)).astype(np.float32).astype(float)
    points[::3] = np.einsum("pk,pkd->pd", rng.dirichlet([1, 1, 1], 100), mesh.vertices[mesh.faces[:100]])
    points = points.astype(np.float32).astype(float)
    fine = xp.at(bits)

    def program(xp, face, *p):
        gap = offset(xp, record(xp, fine.table(rows), face), p)
        return {"d": xp.sqrt(gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2])}

    face, at = (index.ravel() for index in np.meshgrid(np.arange(count), np.arange(300)))
    fast = fine.run(program, [face, *points[at].T])["d"].astype(float)
    true = every_distance(mesh, points)[at, face]
    # What single precision takes from the slack, double precision takes 2^29 times less of, but for thin faces, whose
    # foot moves along the face by as many digits as they are thin, at most by their least altitude.
    if bits == 32:
        assert (fast <= true + slack).all()
        # Too short it can be by the rounding of coordinates alone: the point that it is measured from is off by less.
        assert (fast >= true - slack).all()
    elif thinness <= 1e3:
        assert np.abs(fast - true).max() <= 64 * EPS * extent * thinness**2


def test_slack_is_small_for_good_faces_and_never_more_than_the_altitude(rng):
    mesh = ball(3)
    p = corners((mesh.vertices + 1) * 50, mesh.faces)
    assert records(p, 100.0)[1] < 64 * HALF_EPS32 * 100
    thin = corners((sliver().vertices + 1) * 50, sliver().faces)
    # The prism's edge is 50 / 1000 long, and its faces' altitudes are no more.
    assert records(thin, 100.0)[1] < 0.05 + 64 * HALF_EPS32 * 100


# A mesh, and where it lies: bricks of 8 in a box of less than 64, so that three levels lead to bricks.
MESHES = {
    "ball": ball(2),
    "turned box": box(1.0, 0.7, 0.4, turned=True),
    "sliver": sliver(),
    "flattened": flattened(),
    "dirty": dirty(),
    "soup": soup(30),
}


def in_voxels(mesh, resolution):
    lattice = Lattice.around(mesh.bounds, resolution)
    vertices = lattice.to_grid(mesh.vertices)
    area = np.linalg.norm(np.cross(*np.moveaxis(np.diff(vertices[mesh.faces], axis=1), 1, 0)), axis=1)
    return named(vertices, mesh.faces[area > 0]), lattice.shape


def unpacked(lists):
    start, count, items = (np.array(array) for array in lists)
    return [items[s : s + n] for s, n in zip(start, count, strict=True)]


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_every_closest_face_is_a_candidate(xp, mesh):
    mesh, shape = in_voxels(mesh, 36)
    target = Target.of(xp, mesh.vertices, mesh.faces, shape, None)
    bricks = brick_candidates(xp, target.coarse, target.size, shape, REACH)
    leaves = children(xp, target.coarse, children(xp, target.coarse, bricks, shape, REACH), shape, REACH)
    rng = np.random.default_rng(3)
    index = np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3)
    index = index[rng.permutation(len(index))[:4000]]
    every = in_pieces(lambda p: every_distance(mesh, p), index.astype(float))
    least = every.min(axis=1)
    near = least <= REACH
    lowest = (every <= (least * (1 + 1e-12) + 1e-12)[:, None]).argmax(axis=1)
    for cubes in (bricks, leaves):
        at = places(cubes)
        lists = {tuple(place): items for place, items in zip(at.tolist(), unpacked(cubes.lists), strict=True)}
        assert len(lists) == len(at) and all((np.diff(items) > 0).all() for items in lists.values())
        for place, face in zip((index[near] // cubes.side).tolist(), lowest[near], strict=True):
            assert face in lists[tuple(place)]
    assert (np.lexsort(places(bricks).T[::-1]) == np.arange(len(places(bricks)))).all()
    assert (places(bricks) * SIDE < shape).all()


def test_the_distance_of_a_cube_is_that_of_its_centre(xp):
    mesh, shape = in_voxels(ball(2), 36)
    target = Target.of(xp, mesh.vertices, mesh.faces, shape, None)
    bricks = brick_candidates(xp, target.coarse, target.size, shape, REACH)
    centre = places(bricks) * SIDE + (SIDE - 1) / 2
    true = every_distance(mesh, centre).min(axis=1)
    assert np.abs(np.array(bricks.distance) - true).max() <= target.coarse.slack
    # None of them is farther than a sample in reach and half a diagonal.
    assert true.max() <= REACH + 3**0.5 * (SIDE - 1) / 2 + target.coarse.slack


def test_lists_are_short(xp):
    """A leaf of a fine mesh has the faces that are nearest to its eight samples, and few more."""
    mesh, shape = in_voxels(ball(4), 64)
    target = Target.of(xp, mesh.vertices, mesh.faces, shape, None)
    cubes = brick_candidates(xp, target.coarse, target.size, shape, REACH)
    assert np.array(cubes.lists.count).mean() < len(mesh.faces) / 16
    for _ in range(2):
        cubes = children(xp, target.coarse, cubes, shape, REACH)
    assert np.array(cubes.lists.count).mean() < 16


def test_nothing_in_reach(xp):
    mesh, shape = in_voxels(ball(1), 24)
    away = named(mesh.vertices + 500, mesh.faces)
    target = Target.of(xp, away.vertices, away.faces, shape, None)
    assert brick_candidates(xp, target.coarse, target.size, shape, REACH) is None


SIZES = {"2048": (2048,) * 3, "4096": (4096,) * 3, "8192": (8192,) * 3, "rod": (40, 4093, 50)}


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_the_far_corner_of_a_large_lattice(xp, size):
    """A small mesh where indices are largest."""
    low = np.array(size) - 12.0
    mesh = named((ball(0).vertices * 3 + [0.11, 0.23, 0.37]) + low, ball(0).faces)
    target = Target.of(xp, mesh.vertices, mesh.faces, size, None)
    bricks = brick_candidates(xp, target.coarse, target.size, size, REACH)
    at = places(bricks)
    index = np.moveaxis(np.indices((24, 24, 24)), 0, -1).reshape(-1, 3) + np.array(size) - 24
    least = in_pieces(lambda p: every_distance(mesh, p), index.astype(float), 5000).min(axis=1)
    needed = np.unique(index[least <= REACH] // SIDE, axis=0)
    assert {tuple(place) for place in needed.tolist()} <= {tuple(place) for place in at.tolist()}
    assert len(at) <= 4**3
    found = {tuple(place): least for place, least in zip(index.tolist(), least, strict=True)}
    checked = 0
    for part, band in filled(xp, target, bricks, REACH, 1.0, 64):
        for place, face, distance in zip(at[part], band.face, band.distance, strict=True):
            for sample in np.flatnonzero(face >= 0)[::17]:
                i, j, k = np.unravel_index(sample, (SIDE,) * 3)
                true = found[tuple((place * SIDE + [i, j, k]).tolist())]
                # float32 rounds by 2^-24; coordinates of that size by eps of it, a few times.
                assert abs(distance[sample] - true) <= true * HALF_EPS32 + 32 * EPS * max(size)
                checked += 1
    assert checked > 100


def test_two_million_faces(rng):
    """Rows of the last faces of a torus of a thousand by a thousand quads are theirs."""
    n = 1000
    u, v = (angle.ravel() for angle in np.meshgrid(*[np.arange(n) * 2 * np.pi / n] * 2, indexing="ij"))
    ring = 300 + 100 * np.cos(v)
    vertices = np.stack([512 + ring * np.cos(u), 512 + ring * np.sin(u), 512 + 100 * np.sin(v)], axis=1)
    corner = np.arange(n * n).reshape(n, n)
    quad = [np.roll(corner, (-i, -j), (0, 1)).ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    faces = np.concatenate([np.stack([quad[0], quad[1], quad[2]], -1), np.stack([quad[0], quad[2], quad[3]], -1)])
    engine = choose("numpy", 32).engine
    target = Target.of(engine, vertices, faces, (1024, 1024, 1024), None)
    assert target.size == 2_000_000 and target.coarse.slack < 0.01
    face = np.concatenate([rng.integers(0, len(faces), 500), [0, len(faces) - 1]]).astype(np.int32)
    middle = vertices[faces[face]].mean(axis=1)
    normal = np.cross(vertices[faces[face, 1]] - vertices[faces[face, 0]], vertices[faces[face, 2]] - middle)
    p = middle + 3 * normal / np.linalg.norm(normal, axis=1, keepdims=True)
    fine = engine.at(64)
    gap = offset(fine, record(fine, target.fine.table, face), tuple(p.T))
    np.testing.assert_allclose(np.linalg.norm(gap, axis=0), 3, rtol=1e-9)
