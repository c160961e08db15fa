"""Smooth refinement: where its pieces came from, what must stay where it was, and how near it comes to the truth."""

import numpy as np
import pytest
import trimesh

from sdfbake import BadInput, Mesh, smooth
from sdfbake.diagnosis import diagnose
from sdfbake.smooth import ls3
from sdfbake.topology import Topology, twice_areas


def icosphere(subdivisions=2, centre=(0.0, 0.0, 0.0)):
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    return Mesh(np.asarray(ball.vertices) + centre, np.asarray(ball.faces))


def cylinder(around=24, rows=8):
    """Radius 1, from z = -1 to 1: smooth walls (15 degrees per facet), sharp rims, flat caps."""
    angle = 2 * np.pi * np.arange(around) / around
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = [np.column_stack([ring, np.full(around, z)]) for z in np.linspace(-1, 1, rows + 1)]
    here = np.arange(rows * around)
    right = here - here % around + (here + 1) % around
    i, j, top = np.arange(around), (np.arange(around) + 1) % around, rows * around
    faces = [
        np.stack([here, right, right + around], axis=1),
        np.stack([here, right + around, here + around], axis=1),
        np.stack([j, i, np.full(around, top + around)], axis=1),
        np.stack([top + i, top + j, np.full(around, top + around + 1)], axis=1),
    ]
    return Mesh(np.concatenate([*vertices, [[0, 0, -1], [0, 0, 1]]]), np.concatenate(faces))


def sheet(height, count=9):
    """Open graph of a function over [-1, 1]^2."""
    x, y = (v.reshape(-1) for v in np.meshgrid(*2 * [np.linspace(-1, 1, count)], indexing="ij"))
    i, j = (v.reshape(-1) for v in np.mgrid[0 : count - 1, 0 : count - 1])
    a, b, c, d = i * count + j, (i + 1) * count + j, (i + 1) * count + j + 1, i * count + j + 1
    return Mesh(
        np.stack([x, y, height(x, y)], axis=1), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    )


def kissing():
    """Two spheres that share one vertex."""
    one, other = icosphere(1), icosphere(1)
    top, bottom = one.vertices[:, 2].argmax(), other.vertices[:, 2].argmin()
    shifted = other.vertices + one.vertices[top] - other.vertices[bottom]
    faces = other.faces + len(one.vertices)
    faces[other.faces == bottom] = top
    return Mesh(np.concatenate([one.vertices, shifted]), np.concatenate([one.faces, faces]))


def three_pages():
    """Three curved sheets that meet in one line."""
    page = sheet(lambda x, y: 0.2 * (y + 1) ** 2)
    spine = np.flatnonzero(page.vertices[:, 1] == -1)
    vertices, faces = [page.vertices], [page.faces]
    for k, turn in enumerate((2 * np.pi / 3, 4 * np.pi / 3), start=1):
        y, z = page.vertices[:, 1] + 1, page.vertices[:, 2]
        turned = np.stack(
            [page.vertices[:, 0], np.cos(turn) * y - np.sin(turn) * z - 1, np.sin(turn) * y + np.cos(turn) * z], 1
        )
        place = np.arange(len(turned)) + k * len(turned)
        place[spine] = spine
        vertices.append(turned)
        faces.append(place[page.faces])
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def half_turned():
    """A sphere with half of its faces looking inwards."""
    ball = icosphere()
    faces = np.where(ball.vertices[ball.faces].mean(axis=1)[:, :1] < 0, ball.faces[:, ::-1], ball.faces)
    return ball.with_(faces=faces)


SHAPES = {
    "sphere": icosphere,
    "cylinder": cylinder,
    "bowl": lambda: sheet(lambda x, y: 0.3 * (x**2 + y**2)),
    # A crease of up to 90 degrees that fades away inside the sheet: the cut along it ends at a vertex.
    "fading crease": lambda: sheet(lambda x, y: np.abs(y) * np.clip(x, 0, 1) + 0.1 * x**2),
    "kissing spheres": kissing,
    "three pages": three_pages,
    "half turned": half_turned,
}


@pytest.fixture(params=SHAPES.values(), ids=SHAPES.keys())
def mesh(request, rng):
    """Every shape, with random texture coordinates, charts and parts."""
    shape = request.param()
    count = len(shape.faces)
    return shape.with_(
        uv=rng.uniform(-1, 2, (count, 3, 2)),
        chart=rng.integers(0, 5, count).astype(np.int32),
        part=rng.integers(0, 2, count).astype(np.int32),
        part_names=("a", "b"),
    )


def median_edge(mesh):
    p = mesh.vertices[mesh.faces]
    return float(np.median(np.linalg.norm(p - np.roll(p, 1, axis=1), axis=-1)))


def unmoved(mesh, refined):
    """Corners of the refined faces before they were moved: (g, 3, 3)."""
    return np.einsum("gkj,gjx->gkx", refined.place, mesh.vertices[mesh.faces][refined.parent])


def twice(mesh):
    """Refine by two levels, whatever the shape's bent edges measure."""
    refined = ls3(mesh, median_edge(mesh) / 3.2)
    assert refined.iterations == 2
    return refined


def test_places_are_those_of_pieces(mesh):
    refined = twice(mesh)
    corners, faces = unmoved(mesh, refined), refined.mesh.faces
    # Binary fractions: nothing rounds.
    assert np.array_equal(refined.place * 4, np.rint(refined.place * 4))
    assert np.array_equal(refined.place.sum(axis=-1), np.ones((len(faces), 3)))
    assert refined.place.min() == 0
    # All faces at a vertex agree on where it was; three products and two sums of coordinates up to 4.
    place = np.empty((len(refined.mesh.vertices), 3))
    place[faces] = corners
    np.testing.assert_allclose(place[faces], corners, rtol=0, atol=4 * 5 * np.finfo(float).eps)
    np.testing.assert_allclose(place[mesh.faces], mesh.vertices[mesh.faces], rtol=0, atol=0)
    # Pieces are 16 for every face, look the same way and share its area equally.
    assert np.array_equal(np.bincount(refined.parent), np.full(len(mesh.faces), 16))
    a, b, c = np.moveaxis(corners, 1, 0)
    whole = mesh.vertices[mesh.faces][refined.parent]
    normal = np.cross(whole[:, 1] - whole[:, 0], whole[:, 2] - whole[:, 0])
    np.testing.assert_allclose(np.cross(b - a, c - a), normal / 16, rtol=0, atol=1e-14)


def test_topology_stays(mesh):
    """Each closed curve of edges has 4 times as many edges after two levels; Euler's number stays."""
    refined = twice(mesh).mesh
    before, after = Topology.of(mesh.faces), Topology.of(refined.faces)
    for kind in ("open_edges", "crowded_edges", "flipped_edges"):
        assert len(getattr(after, kind)) == 4 * len(getattr(before, kind)), kind
    assert len(refined.vertices) - len(after.edges) == len(mesh.vertices) - len(before.edges) - 15 * len(mesh.faces)
    assert len(after.pinched_vertices(refined.faces)) == len(before.pinched_vertices(mesh.faces))
    assert diagnose(refined).certified == diagnose(mesh).certified
    assert twice_areas(refined.vertices, refined.faces).min() > 0


def test_creases_and_borders_stay(mesh):
    refined = twice(mesh)
    topology = Topology.of(mesh.faces)
    sharp = topology.faces_per_edge != 2
    sharp[topology.flipped_edges] = True
    pieces = np.flatnonzero(sharp[topology.edge[refined.parent]].any(axis=1))
    on_side = refined.place[pieces] == 0  # corner k of the parent has no weight: on the side k + 1
    on_side &= np.roll(sharp[topology.edge[refined.parent[pieces]]], -1, axis=1)[:, None, :]
    corner = on_side.any(axis=2)
    moved = refined.mesh.vertices[refined.mesh.faces[pieces]] - unmoved(mesh, refined)[pieces]
    assert np.abs(moved[corner]).max(initial=0) < 4 * 5 * np.finfo(float).eps
    assert corner.any() or not sharp.any()
    assert np.abs(moved).max(initial=0) > 1e-4 or not sharp.any()  # not because nothing moves


def test_what_is_inherited(mesh, rng):
    refined = twice(mesh)
    assert np.array_equal(refined.mesh.chart, mesh.chart[refined.parent])
    assert np.array_equal(refined.mesh.part, mesh.part[refined.parent])
    assert (refined.mesh.part_names, refined.mesh.units) == (mesh.part_names, mesh.units)
    face = rng.integers(0, len(refined.parent), 1000)
    weights = rng.dirichlet([1, 1, 1], 1000)
    parent, barycentric = refined.original(face, weights)
    ours = np.einsum("nk,nkc->nc", weights, refined.mesh.uv[face])
    # Two ways to add up the same nine products of numbers below 2.
    np.testing.assert_allclose(np.einsum("nk,nkc->nc", barycentric, mesh.uv[parent]), ours, rtol=0, atol=1e-14)
    np.testing.assert_allclose(barycentric.sum(axis=1), 1, rtol=0, atol=1e-15 * 4)


def test_sphere_comes_nearer():
    """Facets leave the sphere by e^2 / 8: a quarter per level, as long as LS3's own error is below."""
    ball = icosphere(3)
    errors, normals, before = [], [], ball.vertices
    for level in range(4):
        refined = ls3(ball, 1.05 * median_edge(ball) / 2**level)
        assert (refined.iterations, refined.put_back) == (level, 0)
        # Nothing is flat here: old vertices are smoothed anew at every level, inside the original faces too.
        assert level == 0 or (refined.mesh.vertices[: len(before)] != before).any(axis=1).all()
        before = refined.mesh.vertices
        p = refined.mesh.vertices[refined.mesh.faces]
        centre = p.mean(axis=1)
        n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        errors.append(np.abs(np.linalg.norm(centre, axis=1) - 1).mean())
        cosine = (n * centre).sum(axis=1) / np.linalg.norm(n, axis=1) / np.linalg.norm(centre, axis=1)
        normals.append(np.arccos(np.minimum(cosine, 1)).max())
    assert errors[0] > 3.5 * errors[1] > 3.5**2 * errors[2]
    assert errors[2] > 2.5 * errors[3]
    # Midpoints alone would leave the normals of the facets: off by as much as before at the new centres.
    assert normals[0] > 1.4 * normals[1] > 1.4**2 * normals[2]


@pytest.mark.parametrize("make", [kissing, half_turned])
def test_where_surfaces_only_touch_or_turn(make):
    """The crease angle has no say: here they share a vertex, there an edge, with normals that disagree."""
    mesh = make()
    topology = Topology.of(mesh.faces)
    fixed = np.union1d(topology.edges[topology.flipped_edges], topology.pinched_vertices(mesh.faces))
    assert len(fixed) > 0
    refined = ls3(mesh, 0.6 * median_edge(mesh), crease=180.0)
    moved = np.linalg.norm(refined.mesh.vertices[: len(mesh.vertices)] - mesh.vertices, axis=1)
    assert np.intersect1d(np.flatnonzero(moved == 0), mesh.faces).tolist() == fixed.tolist()


def test_cylinder_keeps_caps_and_rims():
    tin = cylinder()
    refined = twice(tin)
    vertices, corners = refined.mesh.vertices, unmoved(tin, refined)
    cap = np.abs(tin.vertices[tin.faces[refined.parent]][:, :, 2].mean(axis=1)) == 1
    # Caps are flat: cut, not moved at all (midpoints of a ring's coordinates round, z = 1 does not).
    assert np.array_equal(np.abs(vertices[refined.mesh.faces[cap]][:, :, 2]), np.ones((cap.sum(), 3)))
    np.testing.assert_allclose(vertices[refined.mesh.faces[cap]], corners[cap], rtol=0, atol=1e-15)
    # Away from the rims, which stay polygons, the worst radius was cos(pi / 24) = 0.99144 and is ten times nearer.
    wall = vertices[refined.mesh.faces[~cap]].mean(axis=1)
    radius = np.linalg.norm(wall[np.abs(wall[:, 2]) < 0.5][:, :2], axis=1)
    assert np.abs(radius - 1).max() < (1 - np.cos(np.pi / 24)) / 10


def test_flat_meshes_are_left_alone():
    box = trimesh.creation.box()
    cube = Mesh(np.asarray(box.vertices), np.asarray(box.faces))
    refined = ls3(cube, 1e-3)
    assert refined.mesh is cube
    assert refined.iterations == 0


def test_domed_cube_keeps_its_other_sides(rng):
    """A cube with a pyramid of 0.1 on top: its five sides stay planes, its twelve edges straight."""
    box = trimesh.creation.box()
    old = Mesh(np.asarray(box.vertices), np.asarray(box.faces))
    top = (old.vertices[old.faces][:, :, 2] == 0.5).all(axis=1)
    rim = old.faces[top]
    side = np.concatenate([rim, np.roll(rim, -1, axis=1)]).reshape(2, -1, 3).transpose(1, 2, 0).reshape(-1, 2)
    straight = side[np.isclose(np.linalg.norm(np.diff(old.vertices[side], axis=1)[:, 0], axis=1), 1)]
    tent = np.column_stack([straight, np.full(len(straight), len(old.vertices))])
    domed = Mesh(np.concatenate([old.vertices, [[0, 0, 0.6]]]), np.concatenate([old.faces[~top], tent]))
    assert diagnose(domed).certified
    refined = ls3(domed, 0.1)
    assert refined.iterations == 3
    p, still = refined.mesh.vertices[refined.mesh.faces], unmoved(domed, refined)
    body = refined.parent < (~top).sum()
    assert np.array_equal(p[body], still[body])  # coordinates of few bits: nothing rounds
    assert np.abs(p[~body] - still[~body]).max() > 0.01


def test_short_edges_change_nothing(mesh):
    refined = ls3(mesh, 10.0)
    assert refined.mesh is mesh
    assert (refined.iterations, refined.put_back) == (0, 0)
    assert np.array_equal(refined.parent, np.arange(len(mesh.faces)))
    assert np.array_equal(refined.place, np.tile(np.eye(3), (len(mesh.faces), 1, 1)))


@pytest.mark.parametrize("longest", [0.2, 0.1, 0.05])
def test_edges_are_as_short_as_asked(longest):
    refined = ls3(icosphere(), longest)
    # One level less would not do; moving vertices to the sphere lengthens edges by e^2 / 24 < 1 %.
    assert longest / 2.02 < median_edge(refined.mesh) <= longest


def test_same_bytes(mesh):
    one, other = twice(mesh), twice(mesh)
    for name in ("vertices", "faces", "uv"):
        assert getattr(one.mesh, name).tobytes() == getattr(other.mesh, name).tobytes()
    assert one.place.tobytes() == other.place.tobytes()


def test_moves_with_the_mesh(mesh):
    """Rotated, shifted and scaled.

    At an offset of 1e4 positions round by 2e-12, and so does a fit of few points to second order; without recentring
    its squares would round by 1e-8. At 1e9 pymeshlab alone would use its formula for planes.
    """
    offset = [1e4, -3e3, 5e3]
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    there = twice(mesh.with_(vertices=1e9 * (mesh.vertices @ turn.T + offset)))
    here = twice(mesh)
    moved = 1e9 * (here.mesh.vertices @ turn.T + offset)
    np.testing.assert_allclose(there.mesh.vertices, moved, rtol=0, atol=1e9 * 1e-10)


@pytest.mark.parametrize("bad", [np.nan, 10.0], ids=["not a number", "far away"])
def test_wild_vertices_are_put_back(bad, monkeypatch):
    ball, honest = icosphere(), smooth._positions

    def wild(vertices, faces):
        even, odd = honest(vertices, faces)
        even[7] = bad
        both = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1)
        odd[(np.sort(both) == np.sort(both[3, 1])).all(axis=-1)] = bad
        return even, odd

    monkeypatch.setattr(smooth, "_positions", wild)
    refined = ls3(ball, 0.7 * median_edge(ball))
    p, still = refined.mesh.vertices[refined.mesh.faces], unmoved(ball, refined)
    assert (refined.iterations, refined.put_back) == (1, 2)
    left = np.unique(refined.mesh.faces[np.abs(p - still).max(axis=2) < 1e-15])
    assert ((left < len(ball.vertices)).sum(), len(left)) == (1, 2)
    assert np.linalg.norm(refined.mesh.vertices, axis=1).max() < 1.01


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"longest": 0.01}, r"327,680 faces, more than 100,000: .*coarser.*--smooth none"),
        ({"longest": 0.0}, "edge length"),
        ({"longest": np.inf}, "edge length"),
        ({"longest": 0.1, "crease": 181.0}, "crease angle"),
    ],
    ids=["too many faces", "no length", "infinite length", "no angle"],
)
def test_refusals(options, message):
    with pytest.raises(BadInput, match=message):
        ls3(icosphere(), options.pop("longest"), most_faces=100_000, **options)


def test_degenerate_faces_are_refused():
    ball = icosphere()
    with pytest.raises(BadInput, match="repair"):
        ls3(Mesh(ball.vertices, np.concatenate([ball.faces, [[0, 0, 1]]])), 0.1)
    vertices = ball.vertices.copy()
    vertices[ball.faces[0, 0]] = vertices[ball.faces[0, 1]]
    doubled = ball.with_(vertices=vertices)
    with pytest.raises(BadInput, match="without length"):
        ls3(doubled, 0.1)


def test_progress_ends_at_one():
    heard = []
    ls3(icosphere(), 0.1, progress=lambda stage, share: heard.append((stage, share)))
    assert {stage for stage, _ in heard} == {"smooth"}
    shares = [share for _, share in heard]
    assert shares == sorted(shares)
    assert shares[-1] == 1
