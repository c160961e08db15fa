"""Layers against the meshes they were baked from: an evaluator of the rule, written here, meets the true map."""

import os
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest
import trimesh

import datasets_synthetic
from sdfbake import Lattice, Mesh
from sdfbake.bricks import REACH, active, in_lattice, sample_index
from sdfbake.closest import Surface
from sdfbake.layering import layer
from sdfbake.layers import BORDER, FULL, NORMAL
from sdfbake.nearcharts import NEAR, Samples, surface_cells
from sdfbake.virtual import folded, split

STEPS = np.array(list(product((0, 1), repeat=3)))
HALF = 2.0**-10  # voxels: half a unit in the last place of the border distances of a cell with surface, all below 4


class Baked(NamedTuple):
    mesh: Mesh
    lattice: Lattice
    bricks: object
    distance: np.ndarray
    face: np.ndarray
    layers: object
    overflow: int


def bake(mesh, resolution, lattice=None):
    lattice = lattice or Lattice.around(mesh.bounds, resolution)
    surface = Surface.of(mesh)
    bricks = active(lattice, surface.distance)
    distance = np.zeros((len(bricks), 8, 8, 8), np.float32)
    face = np.full(distance.shape, -1, np.int32)
    inside = in_lattice(bricks.index, lattice.shape)
    found = surface.closest(lattice.to_world(sample_index(bricks.index)[inside]))
    distance[inside] = found.distance
    face[inside] = np.where(found.distance <= REACH * lattice.spacing, found.face, -1)
    layers, overflow = layer(mesh, lattice, bricks, distance, face)
    return Baked(mesh, lattice, bricks, distance, face, layers, overflow)


class Hit(NamedTuple):
    """What the rule answers: virtual chart (-1: none), uv, its gradient per world unit, layers of the cell."""

    chart: np.ndarray
    uv: np.ndarray
    gradient: np.ndarray
    count: np.ndarray


def look_up(baked, p, n):
    """Take, of a cell's layers whose mean normal faces n (else of all), the one of least border distance."""
    layers, bricks = baked.layers, baked.bricks
    grid = baked.lattice.to_grid(p)
    cell = np.clip(np.floor(grid).astype(int), 0, np.array(baked.lattice.shape) - 2)
    t = (grid - cell)[:, None]
    axes = np.where(STEPS, t, 1 - t)
    weight, slope = axes.prod(axis=-1), np.empty_like(axes)
    for k in range(3):
        slope[..., k] = (2 * STEPS[:, k] - 1) * np.delete(axes, k, axis=-1).prod(axis=-1)
    corner = cell[:, None] + STEPS
    slot, (i, j, k) = bricks.slot[tuple(np.moveaxis(corner // 8, -1, 0))], np.moveaxis(corner % 8, -1, 0)
    rows = {(b, c): row for row, (b, c) in enumerate(zip(layers.brick.tolist(), layers.chart.tolist(), strict=True))}
    charts = range(len(layers.of))
    table = np.array([[rows.get((b, c), -1) for c in charts] for b in range(len(bricks))])
    hit = Hit(np.full(len(p), -1), np.full((len(p), 2), np.nan), np.full((len(p), 2, 3), np.nan), np.zeros(len(p), int))
    best, best_faces = np.full(len(p), np.inf), np.zeros(len(p), bool)
    for c in charts:
        row = np.where(slot >= 0, table[slot, c], -1)
        border = np.where(row >= 0, layers.border[row, i, j, k].astype(float), np.inf)
        there = np.isfinite(border).all(axis=1)
        s = np.where(there, (weight * np.where(there[:, None], border, 0)).sum(axis=1), np.inf)
        mean = np.einsum("nk,nkd->nd", weight, layers.normal[row, i, j, k].astype(float))
        faces = there & (np.einsum("nd,nd->n", mean, n) > 0)
        wins = there & np.where(faces == best_faces, s < best, faces)
        uv = layers.offset[c] + layers.scale[c] * layers.uv[row, i, j, k] / FULL
        best[wins], best_faces[wins], hit.chart[wins] = s[wins], faces[wins], c
        hit.uv[wins] = np.einsum("nk,nkd->nd", weight, uv)[wins]
        hit.gradient[wins] = np.einsum("nki,nkd->ndi", slope, uv)[wins] / baked.lattice.spacing
        hit.count[there] += 1
    return hit


class Points(NamedTuple):
    face: np.ndarray
    p: np.ndarray
    n: np.ndarray
    uv: np.ndarray


def on_surface(mesh, count, rng):
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=-1)
    face = rng.choice(len(area), count, p=area / area.sum())
    weight = rng.dirichlet(np.ones(3), count)
    p, uv = (np.einsum("nk,nkd->nd", weight, of[face]) for of in (corners, mesh.uv))
    return Points(face, p, normal[face] / area[face, None], uv)


def gradients(mesh):
    """Return G by pseudo-inverses, (f, 2, 3)."""
    corners = mesh.vertices[mesh.faces]
    return np.swapaxes(mesh.uv[:, 1:] - mesh.uv[:, :1], 1, 2) @ np.swapaxes(
        np.linalg.pinv(corners[:, 1:] - corners[:, :1]), 1, 2
    )


def octaves(mesh, at, gradient, rng):
    """Return |log2| of the ratio of the greatest extents of random tangent footprints under both gradients."""
    axes = rng.normal(size=(len(at.p), 3, 2))
    axes -= at.n[:, :, None] * np.einsum("nd,ndk->nk", at.n, axes)[:, None]
    given, true = (np.linalg.norm(g @ axes, axis=1).max(axis=1) for g in (gradient, gradients(mesh)[at.face]))
    return np.abs(np.log2(given / true))


TURNS = {"straight": np.eye(3), "turned": trimesh.transformations.euler_matrix(0.3, 0.5, 0.7)[:3, :3]}


def box(turn, extents=(1.0, 0.7, 0.4)):
    """Return a box whose sides are charts, each with an affine map of its own, some mirrored, some beyond [0, 1]."""
    shape = trimesh.creation.box(extents)
    vertices, faces = np.asarray(shape.vertices), np.asarray(shape.faces)
    normal = np.rint(shape.face_normals).astype(int)
    chart = (np.abs(normal) @ [0, 1, 2]) * 2 + (normal.sum(axis=1) < 0)
    maps = np.random.default_rng(5).normal(size=(6, 2, 4))
    uv = np.einsum("fij,fkj->fki", maps[chart][..., :3], vertices[faces]) + maps[chart][:, None, :, 3]
    return Mesh(vertices @ turn.T, faces, uv, chart)


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
def test_affine_charts_come_back_exactly_but_for_their_bits(turn, rng):
    baked = bake(box(turn), 33)
    at = on_surface(baked.mesh, 4000, rng)
    hit = look_up(baked, at.p, at.n)
    right = baked.layers.of[hit.chart] == baked.mesh.chart[at.face]
    # Two sides' border distances: rounded to float16 each, and linear, hence exact, but near the box's corners.
    inner = baked.mesh.vertices @ turn - (at.p @ turn)[:, None]
    from_edge = np.sort(np.abs(np.abs(at.p @ turn) - np.array([1.0, 0.7, 0.4]) / 2), axis=1)[:, 1]
    from_corner = np.linalg.norm(inner, axis=-1).min(axis=1)
    assert right[(from_edge > 2 * HALF * baked.lattice.spacing) & (from_corner > 2.5 * baked.lattice.spacing)].all()
    assert right.mean() > 0.99
    step = baked.layers.scale[hit.chart] / FULL
    assert (np.abs(hit.uv - at.uv)[right] <= step[right] / 2 + 1e-9).all()
    # Half a step at each of 8 corners; the moduli of the weights' derivatives sum to 2 per voxel.
    error = np.abs(hit.gradient - gradients(baked.mesh)[at.face])
    assert (error[right] <= step[right][:, :, None] / baked.lattice.spacing + 1e-9).all()
    assert baked.overflow == 0


@pytest.mark.parametrize("name", ["torus", "sphere", "box"])
def test_curved_charts_are_right_but_for_a_hair_beside_their_seams(name, rng):
    mesh = datasets_synthetic.mesh(name, 0.08)
    baked = bake(mesh, 48)
    at = on_surface(mesh, 4000, rng)
    hit = look_up(baked, at.p, at.n)
    wrong = baked.layers.of[hit.chart] != mesh.chart[at.face]
    # Less than 20 voxels of seam per 1000 voxels of surface, and border distances that err by 0.03 voxels at most.
    assert wrong.mean() < 1e-3
    assert (octaves(mesh, at, hit.gradient, rng)[~wrong] < 0.5).all()
    # Facets of two to three voxels turn the gradient by a tenth from each to the next, over half a cell on either side.
    voxel = baked.lattice.spacing * np.linalg.norm(gradients(mesh), axis=(1, 2))[at.face]
    assert (np.linalg.norm(hit.uv - at.uv, axis=1) < 0.1 * voxel)[~wrong].all()


def plate():
    """Return a plate of one chart without a cut: its rim joins the front to the back, elsewhere in the atlas."""
    shape = trimesh.creation.box((1.0, 1.0, 0.02))
    vertices, faces = np.asarray(shape.vertices), np.asarray(shape.faces)
    uv = vertices[:, :2] * [0.4, 0.8] + np.where(vertices[:, 2:] < 0, [0.75, 0.25], 0.25)
    return Mesh(vertices, faces, uv[faces])


def test_the_two_sides_of_a_thin_plate_are_told_apart(rng, monkeypatch):
    baked = bake(plate(), 40)
    at = on_surface(baked.mesh, 4000, rng)
    flat = (np.abs(at.n[:, 2]) > 0.5) & (np.abs(at.p[:, :2]).max(axis=1) < 0.5 - 2.5 * baked.lattice.spacing)
    hit = look_up(baked, at.p, at.n)
    step = baked.layers.scale[hit.chart] / FULL
    assert (np.abs(hit.uv - at.uv) <= step / 2 + 1e-9)[flat].all()
    assert (baked.layers.of == 0).all()

    monkeypatch.setattr("sdfbake.layering.folds", lambda *_: np.zeros(1, bool))
    hit = look_up(bake(plate(), 40), at.p, at.n)
    assert (np.abs(hit.uv - at.uv) > 0.1).any(axis=1)[flat].mean() > 0.3


def fan(faces, vertices):
    """Return a mesh of which every face is a chart."""
    vertices, faces = np.array(vertices, float), np.array(faces)
    uv = np.tile([[0.0, 0], [1, 0], [0, 1]], (len(faces), 1, 1))
    return Mesh(vertices, faces, uv, np.arange(len(faces), dtype=np.int32))


FOUR = fan([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
EIGHT = fan(
    [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]],
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]],
)


@pytest.mark.parametrize("mesh", [FOUR, EIGHT], ids=["tetrahedron", "octahedron"])
def test_overflow_counts_cells_near_more_than_three_charts(mesh):
    baked = bake(mesh, 32)
    cell = np.moveaxis(np.indices(np.array(baked.lattice.shape) - 1), 0, -1).reshape(-1, 3) + 0.5
    near = np.zeros(len(cell), int)
    for face in range(len(mesh.faces)):
        alone = Surface.of(Mesh(mesh.vertices, mesh.faces[face : face + 1]))
        near += alone.distance(baked.lattice.to_world(cell)) <= NEAR * baked.lattice.spacing
    assert baked.overflow == (near > 3).sum()
    assert (baked.overflow > 0) == (mesh is EIGHT)


def test_images_and_faces_without_area_leave_no_trace(rng):
    whole = box(TURNS["turned"])
    uv = np.where((whole.chart < 2)[:, None, None], 0.25, whole.uv)  # both sides are points in the atlas
    vertices, faces = np.append(whole.vertices, whole.vertices[:1], axis=0), whole.faces
    needle = [[faces[0, 0], faces[0, 1], faces[0, 0]], [faces[0, 0], len(whole.vertices), faces[0, 1]]]
    mesh = Mesh(
        vertices, np.append(faces, needle, axis=0), np.append(uv, uv[:2], axis=0), np.append(whole.chart, [0, 9])
    )
    baked = bake(mesh, 24)
    assert np.isfinite(baked.layers.offset).all()
    assert (np.isfinite(baked.layers.scale) & (baked.layers.scale > 0)).all()
    assert not np.isnan(baked.layers.border).any()
    at = on_surface(whole.with_(uv=uv), 2000, rng)
    hit = look_up(baked, at.p, at.n)
    right = baked.layers.of[hit.chart] == whole.chart[at.face]
    assert right.mean() > 0.98
    assert (np.abs(hit.uv - at.uv) <= (baked.layers.scale[hit.chart] / FULL) / 2 + 1e-9)[right].all()


def test_a_sliver_does_not_spend_the_bits_of_its_chart():
    whole = box(TURNS["straight"])
    a, b, c = whole.faces[0]  # cut into three at a point that all but lies on side a b, and is displaced in the atlas
    (mate,) = whole.faces[1:][whole.chart[1:] == whole.chart[0]]
    shared = [np.isin(ends, mate).all() for ends in ((a, b), (b, c), (c, a))]
    side = shared.index(False)  # on the border of its chart: the chart's other face does not have it
    a, b, c = np.roll([a, b, c], -side)
    uv = np.roll(whole.uv[0], -side, axis=0)
    inner = (whole.vertices[a] + whole.vertices[b]) / 2 * (1 - 1e-6) + whole.vertices[c] * 1e-6
    m, at = len(whole.vertices), uv[:2].mean(axis=0) + 0.05
    faces = np.append(whole.faces[1:], [[a, b, m], [m, b, c], [a, m, c]], axis=0)
    corners = np.append(whole.uv[1:], [[uv[0], uv[1], at], [at, uv[1], uv[2]], [uv[0], at, uv[2]]], axis=0)
    chart = np.append(whole.chart[1:], whole.chart[[0, 0, 0]])
    baked = bake(Mesh(np.append(whole.vertices, [inner], axis=0), faces, corners, chart), 24)
    size = np.ptp(whole.uv[whole.chart == whole.chart[0]].reshape(-1, 2), axis=0).max()
    slope = np.linalg.norm(gradients(whole)[0])
    # Continued by 16 times the usual slope over the 2.1 voxels that a sample may be off, on two sides; 5e4 uncapped.
    assert baked.layers.scale[whole.chart[0]].max() < 2 * size + 2 * 16 * 1.5 * slope * 2.1 * baked.lattice.spacing


def bent_sheet(cut):
    """Return a cylinder without lids, unrolled into one chart that meets itself at an angle `cut`."""
    around, along = np.meshgrid(np.arange(48), np.arange(9), indexing="ij")
    angle = 2 * np.pi * around.ravel() / 48 + cut
    vertices = np.stack([np.cos(angle), np.sin(angle), along.ravel() / 4], axis=-1)
    a, b = (part.ravel() for part in np.meshgrid(np.arange(48), np.arange(8), indexing="ij"))
    quad = np.stack([a * 9 + b, (a + 1) % 48 * 9 + b, (a + 1) % 48 * 9 + b + 1, a * 9 + b + 1], axis=-1)
    corner = np.stack([np.stack([a, a + 1, a + 1, a]) / 48, np.stack([b, b, b + 1, b + 1]) / 8], axis=-1)
    pick = [0, 1, 2, 0, 2, 3]
    return Mesh(vertices, quad[:, pick].reshape(-1, 3), corner[pick].transpose(1, 0, 2).reshape(-1, 3, 2))


@pytest.mark.parametrize("cut", [0.0, 0.4])
def test_a_chart_that_meets_itself_is_cut(cut, rng):
    mesh = bent_sheet(cut)
    baked = bake(mesh, 32)
    assert len(baked.layers.of) == 2
    at = on_surface(mesh, 4000, rng)
    hit = look_up(baked, at.p, at.n)
    # One voxel is 0.012 of the way around. On the wrong side of the cut, by a hair, coordinates are off by 1.
    error = np.abs(hit.uv - at.uv).max(axis=1)
    assert (error > 0.01).mean() < 0.004
    assert (np.abs(error - 1) < 0.02)[error > 0.01].all()


def test_rows_are_sorted_and_complete(rng):
    baked = bake(box(TURNS["turned"]), 30)
    layers = baked.layers
    names = np.stack([layers.brick, layers.chart], axis=-1)
    np.testing.assert_array_equal(names, np.unique(names, axis=0))
    empty = ~np.isfinite(layers.border)
    assert (empty | (np.abs(layers.border) <= BORDER)).all()
    assert not layers.uv[empty].any()
    assert not layers.normal[empty].any()
    # Components are rounded by half at most, so the length is off by at most sqrt(3) / 2.
    length = np.linalg.norm(layers.normal[~empty].astype(float), axis=-1)
    assert (np.abs(length - NORMAL) <= np.sqrt(3) / 2).all()
    assert not (~empty & ~in_lattice(baked.bricks.index, baked.lattice.shape)[layers.brick]).any()
    # Hits off the surface by as much as they may be find a layer too.
    at = on_surface(baked.mesh, 2000, rng)
    off = rng.uniform(-0.3, 0.3, (len(at.p), 1)) * baked.lattice.spacing
    assert (look_up(baked, at.p + off * at.n, at.n).chart >= 0).all()


def test_a_lattice_that_cuts_the_surface_off_has_layers_up_to_its_last_cells():
    whole = Lattice.around(box(TURNS["turned"]).bounds, 30)
    cut = Lattice(whole.origin, whole.spacing, tuple(n // 2 + 1 for n in whole.shape))
    baked = bake(box(TURNS["turned"]), 30, cut)
    values = np.isfinite(baked.layers.border)
    assert not (values & ~in_lattice(baked.bricks.index, cut.shape)[baked.layers.brick]).any()
    at = sample_index(baked.bricks.index[baked.layers.brick])[values]
    assert (at == np.array(cut.shape) - 1).any(axis=0).all()


def test_the_bytes_do_not_depend_on_the_threads(monkeypatch):
    mesh = datasets_synthetic.mesh("torus", 0.15)
    baked = bake(mesh, 40)
    for threads in (1, 3):
        monkeypatch.setattr(os, "cpu_count", lambda threads=threads: threads)
        again, overflow = layer(mesh, *baked[1:5])
        assert overflow == baked.overflow
        for name in again.__slots__:
            assert getattr(again, name).tobytes() == getattr(baked.layers, name).tobytes(), name


def test_cells_with_surface_are_all_those_within_reach_and_few_more():
    mesh = box(TURNS["turned"])
    baked = bake(mesh, 30)
    cells = surface_cells(Samples(*baked[1:5]))
    found = np.zeros(np.array(baked.bricks.slot.shape) * 8, bool)
    slot, *at = np.nonzero(cells.mask)
    found[tuple((baked.bricks.index[cells.slot[slot]] * 8 + np.stack(at, axis=-1)).T)] = True
    centre = np.moveaxis(np.indices(np.array(baked.lattice.shape) - 1), 0, -1) + 0.5
    d = Surface.of(mesh).distance(baked.lattice.to_world(centre).reshape(-1, 3)) / baked.lattice.spacing
    found = found[tuple(slice(0, n - 1) for n in baked.lattice.shape)].ravel()
    assert found[d <= NEAR].all()
    # Over a plane the mean of D^2 is that at the centre plus 1/4: cells as far as 1.37 pass, others only at edges.
    assert (d[found] < np.sqrt(NEAR**2 + 0.5)).mean() > 0.95


def test_a_fold_is_two_corners_that_look_apart():
    normals = np.array([[0.0, 0, 1], [0, 0, -1], [0.8, 0, 0.6], [0, 0, 0]], np.float32)
    cells = np.array([[0, 0, 0, 0, 1, 1, 1, 1], [0] * 8, [0, 2, 0, 2, 2, 0, 2, 0], [3, 0, 3, 0, 3, 1, 3, 3]]).T
    for k, expected in enumerate([True, False, False, False]):
        assert folded(normals, np.zeros(4, np.int32), cells[:, k : k + 1], 1).tolist() == [expected], k
    # The same sheets, of two charts.
    assert not folded(normals, np.array([0, 1, 0, 0]), cells[:, :1], 2).any()


def test_charts_are_cut_only_where_they_must_be():
    mesh = box(TURNS["straight"])
    normals = np.cross(*(mesh.vertices[mesh.faces[:, k]] - mesh.vertices[mesh.faces[:, 0]] for k in (1, 2)))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    piece, of = split(mesh, normals, np.zeros(6, bool))
    np.testing.assert_array_equal(of[piece], mesh.chart)
    np.testing.assert_array_equal(of, np.arange(6))
    one = mesh.with_(chart=np.zeros(12, np.int32), uv=mesh.vertices[mesh.faces][..., :2])
    piece, of = split(one, normals, np.ones(1, bool))
    assert len(of) == 6
    assert all(len(np.unique(mesh.chart[piece == k])) == 1 for k in range(6))


def test_no_texture_coordinates_no_layers():
    baked = bake(box(TURNS["straight"]), 20)
    with pytest.raises(ValueError, match="layers need texture coordinates"):
        layer(baked.mesh.with_(uv=None), *baked[1:5])
