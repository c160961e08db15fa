"""What a bake answers, warns of and refuses; sample by sample it is checked in `test_band`."""

import adversarial
import numpy as np
import pytest
import trimesh
from adversarial import every_distance, in_pieces, winding

from sdfbake import BadInput, Mesh, bake
from sdfbake.bricks import REACH, in_lattice, sample_index
from sdfbake.closest import Surface, closest
from sdfbake.diagnosis import diagnose
from sdfbake.lattice import BAND
from sdfbake.repair import crossings, repair
from sdfbake.sign import Winding

RESOLUTION = 24


def ball(subdivisions=2, **options):
    return adversarial.ball(subdivisions, **options).with_(uv=None)


def joined(*meshes):
    return adversarial.joined(*meshes).with_(uv=None)


def rotated_box():
    return adversarial.box(1.0, 0.7, 0.4, turned=True).with_(uv=None)


def solid_angle_sign(mesh, points):
    """Return -1 inside, by the exact winding number."""
    return np.where(np.abs(winding(mesh, points)) > 0.5, -1, 1)


MESHES = {
    "ball": ball(),
    "box": rotated_box(),
    "nested": joined(ball(2), ball(1, radius=0.5, inward=True)),
    "inverted": ball(2, inward=True),
    "overlapping": joined(ball(1), ball(1, centre=(0.9, 0.1, 0.05))),
}


@pytest.mark.parametrize("name", ["ball", "box"])
def test_dense_samples_are_exact_in_the_band_and_bounds_beyond(name):
    mesh = MESHES[name]
    grid = bake(mesh, 20)
    index = np.moveaxis(np.indices(grid.lattice.shape), 0, -1).reshape(-1, 3)
    true = in_pieces(lambda p: every_distance(mesh, p).min(axis=1), grid.lattice.to_world(index))
    near = true <= REACH * grid.lattice.spacing * (1 - 1e-12)
    assert len(grid.samples()[0]) == np.count_nonzero(true.astype(np.float32) <= BAND * grid.lattice.spacing)
    # Absent bricks hold a lower bound, and so do the samples of a brick that are out of reach.
    dense = np.abs(grid.to_dense().reshape(-1))
    assert (dense <= true * (1 + 2.0**-24)).all()
    assert (dense[~near] > (REACH - 2) * grid.lattice.spacing).all()


def test_signs_of_the_far_field():
    mesh = MESHES["nested"]
    grid = bake(mesh, 48)
    p = grid.lattice.to_world(np.moveaxis(np.indices(grid.lattice.shape), 0, -1).reshape(-1, 3))
    far = np.abs(grid.to_dense().reshape(-1)) > BAND * grid.lattice.spacing
    assert far.any()
    chosen = np.flatnonzero(far)[:: max(1, far.sum() // 3000)]
    np.testing.assert_array_equal(np.sign(grid.to_dense().reshape(-1))[chosen], solid_angle_sign(mesh, p[chosen]))


@pytest.mark.parametrize("method", ["pseudonormal", "winding"])
def test_both_sign_methods_agree_on_a_clean_mesh(method):
    grid = bake(MESHES["nested"], RESOLUTION, sign=method)
    assert grid.metadata.sign.method == method
    assert grid.metadata.sign.checked > 1000 and grid.metadata.sign.disagree == 0
    np.testing.assert_array_equal(grid.distance, bake(MESHES["nested"], RESOLUTION).distance)


def test_disagreement_is_told_and_winding_takes_over():
    with pytest.warns(UserWarning, match="differ from another method's"):
        grid = bake(MESHES["overlapping"], RESOLUTION)
    assert grid.metadata.sign.method == "winding" and grid.metadata.sign.disagree > 1e-3
    with pytest.warns(UserWarning, match="signs by pseudonormal"):
        assert bake(MESHES["overlapping"], RESOLUTION, sign="pseudonormal").metadata.sign.method == "pseudonormal"


def test_inverted_mesh_is_noticed():
    with pytest.warns(UserWarning, match="inside out"):
        turned = bake(MESHES["inverted"], RESOLUTION)
    np.testing.assert_array_equal(turned.distance, bake(MESHES["ball"], RESOLUTION).distance)


def test_block_rule_gives_every_sample_its_sign():
    mesh = MESHES["overlapping"]
    with pytest.warns(UserWarning):
        grid = bake(mesh, RESOLUTION)
    winding = Winding.of(Surface.of(mesh))
    p = grid.lattice.to_world(sample_index(grid.bricks.index))
    one_by_one = winding.signs(p.reshape(-1, 3)).reshape(grid.distance.shape)
    inside = in_lattice(grid.bricks.index, grid.lattice.shape)
    np.testing.assert_array_equal(np.where(grid.distance < 0, -1, 1)[inside], one_by_one[inside])


def test_lowest_face_wins_ties():
    mesh = MESHES["box"]
    # Over every edge and corner of the box, where two and more faces are equally near.
    edges = np.unique(np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    middle = mesh.vertices[edges].mean(axis=1)
    out = np.concatenate([mesh.vertices, middle]) * 1.3
    every = every_distance(mesh, out)
    # Twelve digits: far above rounding (1e-16), far below any true difference here.
    lowest = (every <= every.min(axis=1, keepdims=True) * (1 + 1e-12)).argmax(axis=1)
    at = closest(mesh, out)
    np.testing.assert_array_equal(at.face, lowest)
    corners = mesh.vertices[mesh.faces[at.face]]
    np.testing.assert_allclose(np.einsum("nk,nkd->nd", at.barycentric, corners), at.point, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(out - at.point, axis=1), at.distance, rtol=1e-14)


def test_degenerate_faces_do_no_harm():
    clean = ball(1)
    edge = clean.faces[0][[0, 1]]
    dirty = Mesh(clean.vertices, np.concatenate([[[edge[0], edge[1], edge[0]]], clean.faces]))
    at = closest(dirty, clean.vertices * 1.1)
    assert (at.face > 0).all() and np.isfinite(at.barycentric).all()
    np.testing.assert_array_equal(at.distance, closest(clean, clean.vertices * 1.1).distance)


def textured():
    mesh = ball(1)
    rng = np.random.default_rng(4)
    part = (mesh.vertices[mesh.faces].mean(axis=1)[:, 2] > 0).astype(int)
    chart = rng.integers(0, 3, len(mesh.faces))
    return mesh.with_(uv=rng.uniform(size=(80, 3, 2)), part=part, part_names=("low", "high"), chart=chart, units="mm")


def test_uv_chart_and_part_of_the_closest_point():
    mesh = textured()
    grid = bake(mesh, RESOLUTION, uv_mode="grid")
    near = (np.abs(grid.distance) <= BAND * grid.lattice.spacing) & in_lattice(grid.bricks.index, grid.lattice.shape)
    p = grid.lattice.to_world(sample_index(grid.bricks.index)[near])
    chosen = np.random.default_rng(0).permutation(len(p))[:1500]
    every = every_distance(mesh, p[chosen])
    face = every.argmin(axis=1)
    clear = np.partition(every, 1, axis=1)  # only where one face is nearest are the oracle's ids the only right ones
    clear = clear[:, 1] > clear[:, 0] + 1e-9
    assert clear.mean() > 0.2
    uv, chart, part = (channel[near][chosen][clear] for channel in (grid.uv, grid.chart, grid.part))
    np.testing.assert_array_equal(chart, mesh.chart[face[clear]])
    np.testing.assert_array_equal(part, mesh.part[face[clear]])
    # The foot of the perpendicular, by least squares; those points are interior to their faces.
    for k, f in list(zip(np.flatnonzero(clear), face[clear], strict=True))[:200]:
        corners = mesh.vertices[mesh.faces[f]]
        system = np.column_stack([corners[1] - corners[0], corners[2] - corners[0]])
        s, t = np.linalg.lstsq(system, p[chosen][k] - corners[0], rcond=None)[0]
        expected = np.array([1 - s - t, s, t]) @ mesh.uv[f]
        # float32 of numbers up to 1: 2^-24, and float64 rounding far below
        assert np.abs(grid.uv[near][chosen][k] - expected).max() < 7e-8
    assert uv.dtype == np.float32
    assert grid.metadata.charts == 3 and grid.metadata.parts == ("low", "high") and grid.metadata.units == "mm"


def test_uv_modes():
    assert bake(ball(1), 16).metadata.uv_modes == () and bake(textured(), 16).metadata.uv_modes == ("faces",)
    assert bake(textured(), 16, uv_mode="grid, faces").metadata.uv_modes == ("faces", "grid")
    assert bake(textured(), 16, uv_mode="none").uv is None
    with pytest.raises(BadInput, match="has none"):
        bake(ball(1), 16, uv_mode="grid")
    with pytest.raises(BadInput, match="faces, layers, grid"):
        bake(textured(), 16, uv_mode="fancy")


def test_metadata():
    mesh = MESHES["ball"]
    grid = bake(mesh, 32, cube=True)
    assert grid.lattice.shape == (32, 32, 32)
    sides = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).edges_unique_length
    # In a closed mesh every edge is counted twice by its faces: the median is that of the edges.
    assert grid.metadata.edge_over_h == pytest.approx(np.median(sides) / grid.lattice.spacing, rel=1e-12)
    assert grid.metadata.mesh_hash != bake(rotated_box(), 16).metadata.mesh_hash
    assert grid.metadata.source == "mesh" and grid.metadata.options["resolution"] == 32


def test_progress_goes_from_start_to_end():
    heard = []
    bake(ball(1), 32, progress=lambda stage, share: heard.append((stage, share)))
    stages = list(dict.fromkeys(stage for stage, _ in heard))
    assert stages[:2] == ["bricks", "closest faces"]
    for stage in stages:
        shares = [share for name, share in heard if name == stage]
        assert shares == sorted(shares) and shares[0] == 0 and shares[-1] == 1


def holed():
    mesh = ball(2)
    return mesh.with_(faces=mesh.faces[3:], chart=mesh.chart[3:], part=mesh.part[3:])


NAN = ball(1).with_(vertices=np.where(np.arange(42)[:, None] == 7, np.nan, ball(1).vertices))
REFUSED = {
    "open": (holed(), {}, r"open: \d+ boundary edges, the first at \(.*\): close its holes"),
    "nan": (NAN, {}, "non-finite: 1 vertices"),
    "empty": (Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), {}, "empty"),
    "flat faces": (Mesh(np.eye(3), np.array([[0, 1, 1], [2, 2, 2]])), {}, "empty: 2 faces without area"),
    "resolution 1": (ball(1), {"resolution": 1}, "resolution 1 is outside"),
    "resolution 100000": (ball(1), {"resolution": 100_000}, "resolution 100000 is outside"),
    "memory": (ball(1), {"resolution": 8192, "max_memory": 1.0}, r"8192 needs about .* GB .* and 1\.00 GB are allowed"),
    "sign": (ball(1), {"sign": "dice"}, "dice"),
}


@pytest.mark.parametrize(("mesh", "options", "match"), REFUSED.values(), ids=REFUSED)
def test_refused(mesh, options, match):
    with pytest.raises(BadInput, match=match):
        bake(mesh, **{"resolution": 16, **options})


def test_open_edges_are_counted():
    boundary = trimesh.Trimesh(holed().vertices, holed().faces, process=False)
    expected = len(trimesh.grouping.group_rows(boundary.edges_sorted, require_count=1))
    (finding,) = diagnose(holed()).findings
    assert (finding.name, finding.count, finding.consequence) == ("open", expected, "refused")
    assert abs(np.linalg.norm(finding.place) - 1) < 0.05


def test_pinched_vertex_is_found():
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    tetra = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), faces)
    other = np.array([0, 4, 5, 6])[tetra.faces]  # mirrored through the shared vertex 0
    both = Mesh(np.concatenate([tetra.vertices, -tetra.vertices[1:]]), np.concatenate([tetra.faces, other[:, ::-1]]))
    assert [(f.name, f.count, f.of) for f in diagnose(both).findings] == [("non-manifold", 1, "vertices")]
    assert diagnose(tetra).findings == ()


def test_repair_mends_what_it_names():
    mesh = textured()
    faces, uv = mesh.faces.copy(), mesh.uv.copy()
    faces[5], uv[5] = faces[5][::-1], uv[5][::-1]
    order = [*range(80), 3, 11]
    dirty = Mesh(
        np.concatenate([mesh.vertices, [[9.0, 9, 9]]]),
        np.concatenate([faces[order], [[0, 0, 1]]]),
        np.concatenate([uv[order], uv[:1]]),
        np.append(mesh.chart[order], 0),
        np.append(mesh.part[order], 0),
        mesh.part_names,
    )
    names = {finding.name for finding in diagnose(dirty).findings}
    assert {"degenerate", "duplicate", "unreferenced", "flipped"} <= names
    mended, done = repair(dirty)
    assert diagnose(mended).findings == () and len(done) == 3
    np.testing.assert_array_equal(mended.vertices, mesh.vertices)
    np.testing.assert_array_equal(mended.chart, mesh.chart)
    np.testing.assert_array_equal(mended.part, mesh.part)
    # Corners may start elsewhere or run the other way: compare every corner's (position, uv) as a set per face.
    for f in range(80):
        now = {
            (*map(float, p), *map(float, t))
            for p, t in zip(mended.vertices[mended.faces[f]], mended.uv[f], strict=True)
        }
        was = {(*map(float, p), *map(float, t)) for p, t in zip(mesh.vertices[mesh.faces[f]], mesh.uv[f], strict=True)}
        assert now == was


def test_repair_leaves_a_clean_mesh_alone():
    mesh = textured()
    mended, done = repair(mesh)
    assert mended is mesh and done == []


def test_repair_turns_an_inverted_mesh():
    mended, done = repair(MESHES["inverted"])
    assert diagnose(mended).findings == () and done == ["the whole surface turned inside out"]


def test_crossings():
    assert crossings(MESHES["ball"]) == ()
    (finding,) = crossings(MESHES["overlapping"])
    assert finding.name == "self-intersecting" and finding.count > 4
