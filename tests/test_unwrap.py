"""Atlases: figures with closed forms, the gutter that a grid needs, and what mip levels it carries."""

import io
import json
import sys
from contextlib import redirect_stderr, redirect_stdout
from unittest import mock

import numpy as np
import pytest
import trimesh

from sdfbake import BadInput, Mesh, commandline
from sdfbake.__main__ import cli
from sdfbake.atlas import Cover, Quality, cover, gutter, quality
from sdfbake.charts import charts_of
from sdfbake.lattice import Lattice
from sdfbake.meshfile import save
from sdfbake.unwrap import unwrap

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def flat(matrix=((1.0, 0), (0, 1)), offset=(0.0, 0)):
    """The unit square, its texture coordinates an affine map of x and y."""
    uv = SQUARE[:, :2] @ np.array(matrix).T + offset
    return Mesh(SQUARE, HALVES, uv[HALVES])


def joined(*meshes):
    """Several meshes side by side, a chart each."""
    count = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices + np.array([3.0 * k, 0, 0]) for k, mesh in enumerate(meshes)]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, count, strict=False)]),
        np.concatenate([mesh.uv for mesh in meshes]),
        np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes]),
    )


def cube_cross():
    """A unit cube laid out as a cross of six squares on a lattice of quarters."""
    frames = {  # place of the square -> corner of the cube, direction of u, direction of v
        (1, 0): ([0, 1, 0], [1, 0, 0], [0, 0, -1]),  # a column of four sides round the x axis...
        (1, 1): ([0, 1, -1], [1, 0, 0], [0, -1, 0]),
        (1, 2): ([0, 0, -1], [1, 0, 0], [0, 0, 1]),
        (1, 3): ([0, 0, 0], [1, 0, 0], [0, 1, 0]),
        (0, 1): ([0, 1, 0], [0, 0, -1], [0, -1, 0]),  # ...and the two ends of it
        (2, 1): ([1, 1, -1], [0, 0, 1], [0, -1, 0]),
    }
    p, uv = [], []
    for place, (corner, u, v) in frames.items():
        for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
            p.append(np.add(corner, np.multiply(a, u)) + np.multiply(b, v))
            uv.append(np.add(place, (a, b)) / 4)
    vertices, index = np.unique(np.array(p, float), axis=0, return_inverse=True)
    corners = (4 * np.arange(6)[:, None, None] + HALVES).reshape(-1, 3)
    faces, uv = index.reshape(-1)[corners], np.array(uv)[corners]
    return Mesh(vertices, faces, uv, charts_of(faces, uv))


# Maps with exact figures: everything is a power of two, so that the arithmetic is exact.
ISOMETRIES = {
    "identity": np.eye(2),
    "quarter turn": [[0, -1], [1, 0]],
    "mirrored": [[-1, 0], [0, 1]],
    "smaller": np.eye(2) / 4,
}


@pytest.mark.parametrize("name", ISOMETRIES)
def test_a_similarity_has_no_stretch(name):
    found = quality(flat(ISOMETRIES[name]), 64)
    assert found.stretch_l2 == found.stretch_linf == found.utilisation == 1.0
    assert (found.flipped, found.zero_area, found.overlapping_texels, found.seam_length) == (0, 0, 0, 0)
    assert found.mirrored_charts == (name == "mirrored")
    scale = np.sqrt(abs(np.linalg.det(ISOMETRIES[name])))
    assert found.density == found.density_p5 == found.density_p95 == 64 * scale
    assert found.gutter is None and found.charts == 1  # nothing to keep apart


@pytest.mark.parametrize(("a", "b"), [(0.5, 0.25), (1.0, 0.1), (0.3, 0.3)])
@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_stretch_of_an_anisotropic_map(a, b, turn):
    """u = a x, v = b y: from texture to surface it is 1/a and 1/b, times sqrt(a b) by the normalisation."""
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    found = quality(flat(rotation @ np.diag([a, b]), offset=(2.0, 2.0)), 64)
    assert found.stretch_l2 == pytest.approx(np.sqrt((a / b + b / a) / 2), rel=1e-12)
    assert found.stretch_linf == pytest.approx(np.sqrt(max(a / b, b / a)), rel=1e-12)
    assert found.density == pytest.approx(64 * np.sqrt(a * b), rel=1e-12)


def test_stretch_is_weighted_by_area():
    """Two squares, one at half the scale: L2^2 = mean(1, 4), normalised by sqrt(2 / 1.25)."""
    found = quality(joined(flat(), flat(np.eye(2) / 2, (2.0, 0))), 64)
    assert found.stretch_l2 == pytest.approx(np.sqrt(2.5 * 1.25 / 2), rel=1e-12)
    assert found.stretch_linf == pytest.approx(2 * np.sqrt(1.25 / 2), rel=1e-12)
    assert (found.density, found.density_p5, found.density_p95) == (48, 32, 64)


def test_cube_as_a_cross():
    found = quality(cube_cross(), 1024)
    assert found.charts == 1 and found.seam_length == 7 and found.seam_ratio == pytest.approx(7 / np.sqrt(6))
    assert found.stretch_l2 == pytest.approx(1, rel=1e-12) and found.flipped == found.mirrored_charts == 0
    assert found.overlapping_texels == 0 and found.utilisation == 6 / 12  # of a rectangle of 3 x 4 squares


def test_seams_between_charts_alone():
    """Equal coordinates on both sides, but different charts: still a seam."""
    assert quality(flat().with_(chart=np.array([0, 1])), 16).seam_length == pytest.approx(np.sqrt(2), rel=1e-15)


@pytest.mark.parametrize("shift", [0, 3, -2])
def test_overlap_of_two_charts(shift):
    """Two squares of side 0.4 that share 0.2 x 0.3, wherever the texture repeats."""
    size, side = 500, 0.4 * np.eye(2)
    two = joined(flat(side, (0.1, 0.1)), flat(side, (0.3 + shift, 0.2 - shift)))
    found = quality(two, size)
    # a raster counts a convex area to within half its perimeter, in texels, plus one
    assert abs(found.overlapping_texels - 0.06 * size**2) <= 0.5 * size + 1
    assert found.gutter == 0 and found.mip_levels == 0 and found.charts == 2


def test_overlap_within_a_chart_is_no_gutter():
    folded = quality(flat().with_(uv=flat().uv[[0, 0]]), 64)
    assert folded.overlapping_texels == 64 * 65 / 2 and folded.flipped == 0  # half of it, and its diagonal
    assert folded.gutter is None
    assert quality(flat().with_(uv=np.stack([flat().uv[0], flat().uv[0][::-1]])), 64).flipped == 1


def test_flipped_and_flat_faces():
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(*2 * [np.arange(5.0)], indexing="ij"), axis=-1).reshape(-1, 2)
    corner = (5 * np.arange(4)[:, None] + np.arange(4)).reshape(-1, 1)
    faces = np.concatenate([corner + np.array(ends) for ends in ([0, 5, 6], [0, 6, 1])])
    uv = (grid / 8 + rng.uniform(-0.01, 0.01, grid.shape))[faces]
    mesh = Mesh(np.column_stack([grid, np.zeros(25)]), faces, uv)
    assert (quality(mesh).flipped, quality(mesh).zero_area) == (0, 0)
    uv[3] = uv[3, [0, 2, 1]]
    uv[7] = uv[7, [0, 0, 1]]
    uv[9, 2] = (uv[9, 0] + uv[9, 1]) / 2  # a needle
    uv[11, 0] = np.inf
    for sign in (1, -1):
        found = quality(mesh.with_(uv=uv * [sign, 1]))
        assert (found.flipped, found.zero_area, found.mirrored_charts) == (1, 3, int(sign < 0))
        assert np.isfinite(found.stretch_linf)


def test_raster_agrees_with_points_in_triangles(rng):
    """Random triangles, partly outside: every texel against the signs of its three edge functions."""
    corners, chart, size = rng.uniform(-8, 40, (60, 3, 2)), rng.integers(0, 4, 60), 32
    x, y = (np.stack(np.meshgrid(*2 * [np.arange(-64, 96) + 0.5]))).reshape(2, -1)
    faces, charts = np.zeros((size, size), int), np.zeros((size, size, 4), bool)
    for triangle, c in zip(corners, chart, strict=True):
        ends = zip(triangle, np.roll(triangle, -1, axis=0), strict=True)
        side = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ends]
        inside = np.all(np.array(side) > 0, axis=0) | np.all(np.array(side) < 0, axis=0)
        where = np.floor(y[inside]).astype(int) % size, np.floor(x[inside]).astype(int) % size
        np.add.at(faces, where, 1)
        charts[(*where, c)] = True
    found = cover(corners, chart, size)
    np.testing.assert_array_equal(found.faces, faces)
    one = np.where(charts.sum(axis=-1) == 1, charts.argmax(axis=-1), -2)
    np.testing.assert_array_equal(found.chart, np.where(faces == 0, -1, one))


def test_raster_in_blocks(rng, monkeypatch):
    corners, chart = rng.uniform(0, 64, (50, 3, 2)), np.zeros(50, int)
    whole = cover(corners, chart, 64)
    monkeypatch.setattr("sdfbake.atlas._BLOCK", 20)  # many a face alone has more rows
    np.testing.assert_array_equal(cover(corners, chart, 64).faces, whole.faces)


def test_too_many_repetitions_are_not_counted():
    found = quality(flat(1e9 * np.eye(2)))
    assert found.overlapping_texels is found.utilisation is found.gutter is None and found.stretch_l2 == 1


def test_gutter_agrees_with_all_pairs(rng):
    """Against the least king's distance of all pairs of texels."""
    for _ in range(20):
        chart = np.full((24, 24), -1)
        place = rng.integers(0, 24, (6, 2))
        chart[tuple(place.T)] = rng.integers(0, 3, 6)
        at = np.argwhere(chart >= 0)
        far = np.abs(at[:, None] - at).max(axis=-1)[chart[tuple(at.T)][:, None] != chart[tuple(at.T)]]
        found = gutter(Cover((chart >= 0).astype(int), chart))
        assert found == (far.min() - 1 if len(far) else None)


def figures(gap):
    """A quality of which only the gutter matters."""
    return Quality(2, 0, 0.0, None, None, None, 0, 0, 0, 0.5, 1.0, 1.0, 1.0, gap, 1024)


@pytest.mark.parametrize(
    ("gap", "levels"), [(None, None), (0, 0), (1, 0), (2, 1), (4, 1), (5, 2), (11, 3), (22, 3), (23, 4)]
)
def test_mip_levels(gap, levels):
    assert figures(gap).mip_levels == levels


def bleeding(gap, level, start):
    """Greatest share of chart B in look-ups on chart A, which ends at `start`, B beginning `gap` later; texels."""
    centre = np.arange(256) + 0.5
    image = (np.abs(centre - start) > np.abs(centre - start - gap)).astype(float)  # filled from the nearest chart
    image[centre < start] = 0
    texels = image.reshape(-1, 2**level).mean(axis=1)
    return np.interp(np.linspace(0, start, 5000), (np.arange(len(texels)) + 0.5) * 2**level, texels).max()


@pytest.mark.parametrize("level", range(4))
def test_mip_levels_do_not_bleed(level):
    """The image filled, filtered to a level and looked up: as many levels as promised, for charts anywhere."""
    gap = 3 * 2**level - 1
    starts = 96 + np.arange(0, 32, 0.25)
    assert figures(gap).mip_levels == level + 1
    assert max(bleeding(gap, level, start) for start in starts) == 0
    assert max(bleeding(gap - 1, level, start) for start in starts) > 0  # one texel less is not enough


@pytest.fixture(scope="module")
def bar():
    box = trimesh.creation.box((4.0, 1, 1))
    return Mesh(np.asarray(box.vertices), box.faces)


@pytest.mark.parametrize("n", [16, 64, 1024])
def test_gutter_for_a_grid(bar, n):
    mesh = unwrap(bar, for_resolution=n, resolution=256)
    found = quality(mesh, 256)
    spacing = Lattice.around(bar.bounds, n).spacing
    # independently: the density of a box is constant, the gutter in texels over texels per voxel
    density = 256 * np.sqrt(trimesh.triangles.area(np.pad(mesh.uv, ((0, 0), (0, 0), (0, 1)))).sum() / 18)
    assert found.density == pytest.approx(density, rel=0.02)  # charts are snapped to texels
    assert found.gutter_voxels(spacing) == pytest.approx(found.gutter / (density * spacing), rel=0.05)
    assert found.gutter >= 2 and found.gutter_voxels(spacing) >= 0.5
    # each chart is padded by half a voxel, or by 2 texels; xatlas rounds up to whole texels on both sides
    assert found.gutter <= max(density * spacing, 2 * 2) + 2
    # isotropic although the atlas is no square: by both axes of the charts
    assert found.stretch_linf < 1.05 and found.overlapping_texels == 0 and found.flipped == 0


def test_gutter_out_of_reach(bar, monkeypatch):
    monkeypatch.setattr("sdfbake.unwrap._packed", lambda mesh, *_: joined(*2 * [flat()]))
    with pytest.warns(UserWarning, match="charts are 0 texels"):
        unwrap(bar, for_resolution=64)


def run(*arguments, code=0):
    out, err = io.StringIO(), io.StringIO()
    argv = mock.patch.object(sys, "argv", ["sdfbake", *map(str, arguments)])
    with argv, redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as left:
        commandline.run(cli, "python -m sdfbake")
    assert left.value.code == code, err.getvalue()
    return out.getvalue(), err.getvalue()


def test_the_command_prints_the_figures(bar, tmp_path):
    save(bar, tmp_path / "bar.ply")
    arguments = [
        "unwrap",
        tmp_path / "bar.ply",
        "-o",
        tmp_path / "atlas.ply",
        "--resolution",
        256,
        "--for-resolution",
        64,
    ]
    out, err = run(*arguments, "--json")
    record = json.loads(out)
    assert err == "" and record["done"] == ["unwrapped"]
    expected = quality(Mesh.load(tmp_path / "atlas.ply"), 256)
    voxels = expected.gutter_voxels(Lattice.around(bar.bounds, 64).spacing)
    assert record["quality"] == {**expected.record(), "gutter_voxels": voxels}
    assert "stretch_l2" in run("unwrap", tmp_path / "atlas.ply", "-o", tmp_path / "same.ply")[0]
    assert (tmp_path / "same.ply").read_bytes() == (tmp_path / "atlas.ply").read_bytes()


def test_textures_go_with_their_coordinates(tmp_path):
    save(cube_cross().with_(texture="wood.png"), tmp_path / "a.ply")
    assert json.loads(run("unwrap", tmp_path / "a.ply", "-o", tmp_path / "b.ply", "--json")[0])["texture"] == "wood.png"
    told = json.loads(run("unwrap", tmp_path / "a.ply", "-o", tmp_path / "b.ply", "--again", "--json")[0])
    assert told["texture"] is None and Mesh.load(tmp_path / "b.ply").texture is None


def test_refusals(bar, tmp_path):
    with pytest.raises(BadInput, match="no texture coordinates"):
        quality(bar)
    with pytest.raises(BadInput, match="0 texels"):
        quality(flat(), 0)
    save(bar, tmp_path / "bar.ply")
    err = run("unwrap", tmp_path / "bar.ply", "-o", tmp_path / "a.ply", "--for-resolution", 4, code=2)[1]
    assert "resolution 4 is outside" in err and not (tmp_path / "a.ply").exists()
