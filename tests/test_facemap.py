"""Texture coordinates from faces: against the mesh itself, where a sheet is thin, and wherever the search starts."""

from dataclasses import replace

import numpy as np
import pytest
from charted import ask, with_faces

from datasets_synthetic import shape
from datasets_synthetic.sheet import sheet
from sdfbake import Grid, triangle
from sdfbake.closest import Surface
from sdfbake.complaint import BadInput
from sdfbake.faces import FaceTable
from sdfbake.lattice import Lattice
from sdfbake.mesh import Mesh
from sdfrender import GridField, Rays, facemap, footprint, transfer
from sdfrender.facemap import rings
from sdfrender.flags import Flag
from sdfrender.triangle import nearest

SHAPES = {"box": (shape("box"), 0.3), "sphere": (shape("sphere"), 0.2)}


@pytest.fixture(scope="module", params=SHAPES.values(), ids=SHAPES)
def charted(request):
    """A mesh of six charts and a grid that names its faces."""
    exact, edge = request.param
    mesh = exact.mesh(edge)
    return mesh, with_faces(Grid.from_function(exact, 32, uv_mode="none"), mesh)


def on_mesh(mesh, rng, count=2000):
    """Random points on faces, 0.01 of a face off its edges: face, texture coordinates, place."""
    face = rng.integers(0, len(mesh.faces), count)
    weights = 0.01 + 0.97 * rng.dirichlet(np.ones(3), count)
    return (
        face,
        np.einsum("nk,nkc->nc", weights, mesh.uv[face]),
        np.einsum("nk,nkd->nd", weights, mesh.vertices[mesh.faces[face]]),
    )


def affine(mesh, face):
    """The gradient of the texture coordinates in each face's plane, by least squares."""
    corners = mesh.vertices[mesh.faces[face]]
    edges, differences = corners[:, 1:] - corners[:, :1], mesh.uv[face, 1:] - mesh.uv[face, :1]
    return np.einsum("nkc,ndk->ncd", differences, np.linalg.pinv(edges))


def tangential(gradient, n):
    return gradient - np.einsum("ncd,nd,ne->nce", gradient, n, n)


def rounding(field):
    """Positions in voxels round by 11 N units of half an eps (docs/tracing.md), the vertices by another N / 2."""
    return 12 * max(field.grid.lattice.shape) * field.engine.eps


def test_on_the_mesh_it_is_the_mesh(charted, choice, rng):
    """Texture coordinates change by at most 2 per unit; a voxel is 0.08, so positions cost under `rounding`.

    Charts are exact: no point is nearer than 0.01 * 0.2 of a face's height to its edges.
    """
    mesh, grid = charted
    field = GridField(grid, "bspline", choice)
    face, expected, points = on_mesh(mesh, rng)
    n = field.jet(points, 1)[1]
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    uv, gradient, chart = field.uv(points)
    assert np.abs(uv - expected).max() < max(rounding(field), 1e-12) and rounding(field) < 1e-4
    slope = tangential(affine(mesh, face), n)
    # The jet's normal rounds by some 1e3 eps: 64 taps, a derivative's weights, and positions.
    assert np.abs(gradient - slope).max() < 1e4 * choice.engine.eps and np.abs(slope).max() > 0.1
    assert np.array_equal(chart, mesh.chart[face]) and len(set(chart.tolist())) == 6


def test_any_start_leads_to_the_closest_face(charted, choice, rng):
    """On a convex surface distances fall all the way: every sample may as well name one and the same face."""
    mesh, grid = charted
    named = np.where(grid.face >= 0, 7, -1).astype(np.int32)
    _, expected, points = on_mesh(mesh, rng, 300)
    uv, _, _ = GridField(replace(grid, face=named), "bspline", choice).uv(points)
    assert np.abs(uv - expected).max() < max(rounding(GridField(grid, "bspline", choice)), 1e-12)


def test_off_the_mesh_it_is_the_closest_point(charted, rng):
    mesh, grid = charted
    _, _, points = on_mesh(mesh, rng)
    points = points + 0.3 * grid.lattice.spacing * rng.normal(size=points.shape) / 3
    found = Surface.of(mesh).closest(points)
    expected = np.einsum("nk,nkc->nc", found.barycentric, mesh.uv[found.face])
    uv, _, chart = GridField(grid, engine="numpy").uv(points)
    same = chart == mesh.chart[found.face]
    # Inside, near an edge of the box, the normal may look along another side than the closest one.
    assert same.mean() > 0.97
    assert (np.abs(uv - expected)[same] < 1e-12).all(axis=1).mean() > 0.99


def test_a_mesh_that_is_inside_out_has_the_same_texture(charted, choice, rng):
    mesh, grid = charted
    flipped = Mesh(mesh.vertices, mesh.faces[:, ::-1].copy(), mesh.uv[:, ::-1].copy(), mesh.chart)
    _, _, points = on_mesh(mesh, rng, 300)
    uv, gradient, chart = GridField(grid, "bspline", choice).uv(points)
    other = GridField(with_faces(grid, flipped), "bspline", choice).uv(points)
    assert np.abs(other[0] - uv).max() < max(rounding(GridField(grid, "bspline", choice)), 1e-12)
    assert np.abs(other[1] - gradient).max() < 1e4 * choice.engine.eps
    assert np.array_equal(other[2], chart)


def test_the_faces_of_a_shell_have_two_sides(charted, rng):
    """Whatever the normal says, the closest face has the texture."""
    mesh, grid = charted
    metadata = grid.metadata.model_copy(update={"options": {"open": "shell:0.1"}})
    _, expected, points = on_mesh(mesh, rng, 300)
    uv, *_ = ask(GridField(replace(grid, metadata=metadata), engine="numpy"), points, np.eye(3)[0])
    assert np.abs(uv - expected).max() < 1e-12


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["front", "back"])
def test_a_thin_plate_has_two_sides(side, choice, rng):
    """Two sheets 0.3 voxel apart: the normal says which one a place is on, even right on the other."""
    lattice = Lattice.around(np.array([[-1.0, -1, -1], [1, 1, 1]]), 32)
    plate = sheet((1.6, 1.6), 0.3 * lattice.spacing)
    grid = with_faces(Grid.from_function(plate, lattice=lattice, uv_mode="none"), plate.mesh(0.1))
    points = np.append(rng.uniform(-0.7, 0.7, (500, 2)), rng.uniform(-0.3, 0.0, (500, 1)) * lattice.spacing, axis=1)
    foot = points.copy()
    foot[:, 2] = 0.1 if side > 0 else -1.0  # beyond the side that is meant
    field = GridField(grid, "bspline", choice)
    uv, gradient, chart, seam = ask(field, points, [0.0, 0.0, side])
    assert np.array_equal(chart, plate.chart(foot)) and not seam.any()
    assert np.abs(uv - plate.uv(foot)).max() < max(rounding(field), 1e-12)
    assert np.abs(gradient - plate.uv_gradient(foot)).max() < 1e4 * choice.engine.eps


def test_faces_without_area_have_no_gradient(choice, rng):
    """A face of no area in space next to sound ones, and a chart of no area in the atlas."""
    mesh = shape("box").mesh(0.3)
    uv = mesh.uv.copy()
    uv[mesh.chart == 2] = [0.25, 0.75]
    corner = mesh.faces[0]
    faces = np.concatenate([[[corner[0], corner[0], corner[1]]], mesh.faces])
    broken = Mesh(mesh.vertices, faces, np.concatenate([uv[:1], uv]), np.concatenate([mesh.chart[:1], mesh.chart]))
    grid = with_faces(Grid.from_function(shape("box"), 24, uv_mode="none"), broken)
    named = np.where((grid.face >= 0) & (rng.random(grid.face.shape) < 0.5), 0, grid.face).astype(np.int32)
    face, expected, points = on_mesh(replace(mesh, uv=uv), rng)
    field = GridField(replace(grid, face=named), "bspline", choice)
    uv_, gradient, chart = field.uv(points)
    assert np.isfinite(gradient).all() and not gradient[chart == 2].any() and (chart == 2).any()
    assert np.abs(uv_ - expected).max() < max(rounding(field), 1e-12)
    assert np.array_equal(chart, mesh.chart[face])
    affine_ = facemap._affine(np.zeros((1, 3, 3)), mesh.uv[:1])
    assert np.isfinite(affine_).all() and not affine_[:, 6:].any()


def test_footprints_have_no_seam(charted, choice, directions):
    """Hits of the interpolant, mapped by the closest point of the mesh."""
    mesh, grid = charted
    field = GridField(grid, "bspline", choice)
    zero = np.zeros_like(directions)
    hits, moved = transfer(field, Rays(3 * directions, -directions, zero, zero, zero, zero))
    seen = footprint(field, hits, moved)
    found = Surface.of(mesh).closest(hits.p)
    expected = np.einsum("nk,nkc->nc", found.barycentric, mesh.uv[found.face])
    assert hits.hit.all() and not (seen.flags & Flag.SEAM).any()
    # The closest point of a hit may lie on a cut, of either chart: nothing but rounding decides.
    same = seen.chart == mesh.chart[found.face]
    assert same.mean() > 0.99 and (same | (found.feature != triangle.INTERIOR) | (choice.engine.precision == 32)).all()
    assert np.abs(seen.uv - expected)[same].max() < max(rounding(field), 1e-12)


def test_nowhere_near_there_is_nothing(charted, choice):
    mesh, grid = charted
    bare = replace(grid, face=np.full_like(grid.face, -1))
    uv, gradient, chart = GridField(bare, "bspline", choice).uv(mesh.vertices[:50])
    assert not uv.any() and not gradient.any() and not chart.any()


def test_rings_are_all_that_share_a_vertex(charted):
    mesh, _ = charted
    first, ring = rings(FaceTable.of(mesh))
    sets = [set(face) for face in mesh.faces.tolist()]
    for face in range(0, len(sets), 17):
        expected = [other for other in range(len(sets)) if other != face and sets[other] & sets[face]]
        assert ring[first[face] : first[face + 1]].tolist() == expected


def test_too_many_faces_at_one_vertex_are_refused(charted, monkeypatch):
    monkeypatch.setattr(facemap, "MOST_NEIGHBOURS", 1000)
    with pytest.raises(BadInput, match="meet at one vertex.*'layers' or 'grid'"):
        rings(charted[1].surface)


@pytest.mark.parametrize("thin", [1.0, 1e-3, 1e-6, 0.0], ids=["fat", "sliver", "needle", "flat"])
def test_nearest_is_never_too_near(thin, choice, rng):
    """Against the least over the three segments and, by least squares, the plane, in float64.

    Rounding is that of places within 10 of the origin: squares of up to 100, some ten operations.
    """
    a, ab, ac = rng.normal(size=(3, 3, 1000))
    ac = ab * rng.uniform(0.2, 0.9, 1000) + thin * ac
    q = a + 1.5 * rng.normal(size=a.shape)
    columns = [column for vector in (q, a, ab, ac) for column in vector]

    def program(xp, *c):
        vectors = [(c[i], c[i + 1], c[i + 2]) for i in range(0, 12, 3)]
        return nearest(xp, *vectors)._asdict()

    out = {name: column.astype(float) for name, column in choice.engine.run(program, columns).items()}
    t = np.linspace(0, 1, 401)
    segments = [(a, ab), (a, ac), (a + ab, ac - ab)]
    sampled = min_over(q[:, :, None] - start[:, :, None] - t * edge[:, :, None] for start, edge in segments)
    edges = np.stack([ab.T, ac.T], axis=-1)
    foot = np.einsum("nkd,nd->nk", np.linalg.pinv(edges, rcond=1e-12), (q - a).T)
    inside = (foot >= 0).all(axis=1) & (foot.sum(axis=1) <= 1) & (thin > 0)
    over = ((q - a).T - np.einsum("ndk,nk->nd", edges, foot)) ** 2
    truth = np.where(inside, over.sum(axis=1), sampled)
    slack = 1000 * choice.engine.eps
    # Steps of 1/400 of an edge of up to 8 miss the foot by 0.01: squared distances by 1e-4.
    assert (out["squared"] < truth + slack).all() and (out["squared"] > np.minimum(truth, sampled) - 1e-4 - slack).all()
    point = a + out["second"] * ab + out["third"] * ac
    assert np.abs(((q - point) ** 2).sum(axis=0) - out["squared"]).max() < slack
    for weight in (out["second"], out["third"], 1 - out["second"] - out["third"]):
        assert weight.min() >= -2 * choice.engine.eps and weight.max() <= 1 + 2 * choice.engine.eps


def min_over(gaps):
    return np.min([(gap**2).sum(axis=0).min(axis=1) for gap in gaps], axis=0)


def test_what_a_grid_lacks_is_refused(charted, sphere):
    _, grid = charted
    assert GridField(grid, engine="numpy").uv_mode == "faces"
    with pytest.raises(BadInput, match="as 'layers'.*--uv-mode layers"):
        GridField(grid, engine="numpy", uv_mode="layers")
    with pytest.raises(BadInput, match="'charts'.*faces, layers, grid"):
        GridField(grid, engine="numpy", uv_mode="charts")
    bare = Grid.from_function(sphere, 24, uv_mode="none")
    assert GridField(bare, engine="numpy").uv_mode is None
    with pytest.raises(BadInput, match="--uv-mode faces"):
        GridField(bare, engine="numpy", uv_mode="faces")
