"""Work counters against counts by hand, and against the field that is not watched."""

import numpy as np
import pytest
from scenery import furnish, mirror_scene, sphere_scene

from datasets_synthetic import shape
from sdfbake import Grid, bake
from sdfbake.complaint import BadInput
from sdfrender import Camera, GridField, footprint, reflect, render, trace, transfer
from sdfrender.scene import load_scene
from validate.counters import Counters, Work

CELLS = 5


def plane(level, size=CELLS + 1):
    """One brick, spacing 1: the surface is z = level."""
    z = np.broadcast_to(np.arange(size) - level, (size,) * 3)
    return Grid.from_dense(z, origin=[0.0] * 3, spacing=1.0)


def watched(grid, kernel="linear"):
    counters = Counters()
    return counters.watch(GridField(grid, kernel, engine="numpy")), counters


def along_z(*height, d=-1.0):
    """Rays through the middles of columns of cells."""
    p = np.array([[2.5, 2.5, z] for z in height])
    return p, np.tile([0.0, 0.0, d], (len(p), 1))


def test_one_cell_is_one_slab_and_one_polynomial():
    """The surface z = 1.4 lies in the layer of cells from 1 to 2; from the top, one step leads through the three above.

    They are an empty cube: three cells are left to the right of the middle column as well.
    """
    field, counters = watched(plane(1.4))
    hits = trace(field, *along_z(7.0))
    assert hits.t[0] == pytest.approx(5.6)
    work = counters.work
    assert (work.marches, work.slabs, work.polynomials) == (1, 1, 1)
    assert work.cubes - work.slabs == 1 and work.absent == 0
    # The polynomial's stencil, and that of the gradient for the normal.
    assert (work.stencils, work.values, work.gradients, work.hessians) == (2, 1, 1, 0)


@pytest.mark.parametrize("cells", [1, 2, 3, 4])
def test_cells_are_visited_one_by_one_where_all_may_hold_surface(cells):
    """Values are +1 and -1 alternately along x, so that every cell is occupied.

    A ray in the plane x = 0 starts so many cells above the bottom. The interpolant is 1 - 2 x in its cells, which a
    slab holds without any width: above 0 at either end, so that no cell needs its polynomial.
    """
    x = np.broadcast_to(((-1.0) ** np.arange(CELLS + 1))[:, None, None], (CELLS + 1,) * 3)
    field, counters = watched(Grid.from_dense(x, origin=[0.0] * 3, spacing=1.0))
    hits = trace(field, np.array([[0.0, 2.5, cells - 0.5]]), np.array([[0.0, 0.0, -1.0]]))
    assert not hits.hit[0]
    work = counters.work
    assert work.cubes == work.slabs == cells
    assert work.polynomials == work.stencils == work.values == work.gradients == 0


def test_absent_bricks_are_told_from_empty_cells():
    """Three bricks above each other of which the middle one is absent: constant 9 there, and no sign changes.

    A ray down the middle passes it in one step.
    """
    z = np.full((6, 6, 24), 9.0)
    z[..., :4] = np.arange(4) - 1.5
    z[..., 20:] = 1.0
    grid = Grid.from_dense(z, origin=[0.0] * 3, spacing=1.0)
    field, counters = watched(grid)
    hits = trace(field, *along_z(30.0))
    assert hits.t[0] == pytest.approx(28.5)
    assert len(grid.bricks) < 3 and counters.work.absent == 1
    assert counters.work.cubes > counters.work.absent


def test_rays_count_alone_and_together():
    """Compaction, tiles and threads change nothing: many rays take what each takes by itself."""
    field, counters = watched(Grid.from_function(shape("torus"), 32, uv_mode="none"), "bspline")
    rays = Camera((0.3, 1.0, 2.5), (0.0, 0.0, 0.0), fov=35.0, size=(6, 6)).rays()
    total = Work()
    for p, d in zip(rays.p, rays.d, strict=True):
        trace(field, p[None], d[None])
        total = total + counters.taken()
    trace(field, rays.p, rays.d)
    assert counters.taken() == total
    assert total.marches == 36 and total.slabs > total.polynomials > 0
    assert counters.work == Work()


def test_lanes_that_run_along_do_not_count():
    """The engine keeps some lanes that are done; here they would go on, and look up whatever they like.

    Eight lanes go from 0 to 5, one from 4, and one is there already: 8 * 5 + 1 steps. On each they look up once, in an
    inner loop twice more, and once again where i is even, which is on 8 * 3 + 1 of the steps.
    """
    counters = Counters()
    table = counters.engine.table(np.arange(64.0))

    def program(xp, start):
        def look(state):
            xp.gather(table, state[0], True)
            return state

        def twice(state, _):
            xp.gather(table, state[0], True)
            return (state[0] + 1,)

        def step(state, _):
            xp.gather(table, state[0], True)
            xp.while_loop(lambda inner: inner[0] < 2, twice, (xp.full(state[0], 0),))
            xp.among((state[0] & 1) == 0, look, state)
            return (state[0] + 1,)

        return {"i": xp.while_loop(lambda state: state[0] != 5, step, (start,))[0]}

    out = counters.engine.run(program, [np.array([0] * 8 + [4, 5])])
    assert out["i"].tolist() == [5] * 10
    assert counters.work == Work(scene=41 + 82 + 25)


@pytest.mark.parametrize("mode", ["grid", "faces"])
def test_a_watched_field_answers_bit_for_bit(mode):
    exact = shape("sphere")
    grid = Grid.from_function(exact, 32) if mode == "grid" else bake(exact.mesh(0.2), 32, uv_mode=mode)
    plain, counters = GridField(grid, engine="numpy"), Counters()
    field = counters.watch(plain)
    rays = Camera((0.3, 0.4, 3.2), (0.0, 0.0, 0.0), fov=35.0, size=(16, 16)).rays()
    answers = []
    for each in (plain, field):
        hits, at = transfer(each, rays)
        mirrored = reflect(each, hits, at)
        prints = footprint(each, hits, at)
        answers.append((hits.t, hits.flags, at.dp_dx, mirrored.dd_dx, prints.duv_dx, prints.chart))
    for ours, theirs in zip(*answers, strict=True):
        assert np.array_equal(ours, theirs)
    assert min(counters.work.channels, counters.work.hessians, counters.work.slabs) > 0


@pytest.mark.parametrize("order", [0, 1, 2])
def test_jets_count_up_to_their_order(order):
    """A Hessian that nobody asks for is not computed."""
    field, counters = watched(Grid.from_function(shape("sphere"), 64, uv_mode="none"), "bspline")
    p = np.array([[0.8, 0.0, 0.0], [0.0, 0.8, 0.0], [0.0, 0.0, 0.0]])  # the last is 27 voxels inside: no brick

    def program(xp, *c):
        spot = field.locate(xp, c, xp.full(c[0], True))
        return {"value": field.jet_at(xp, spot, order).value}

    field.engine.run(program, list((p - field.anchor).T))
    work = counters.work
    assert (work.values, work.gradients, work.hessians) == (2, 2 if order else 0, 2 if order == 2 else 0)
    assert (work.stencils, work.polynomials, work.marches) == (2, 0, 0)


def test_a_scene_that_asks_for_less_takes_less(tmp_path):
    """Without a texture no channel and no texel is looked up; with one both are; a mirror asks for Hessians."""
    folder = furnish(tmp_path)
    grids = {name: Grid.load(folder / f"{name}.zarr.zip") for name in ("sphere", "mirror")}

    def work(path, name):
        field, counters = watched(grids[name], "bspline")
        render(load_scene(path), field=field)
        return counters.work

    normals = work(sphere_scene(folder), "sphere")
    assert normals.channels == normals.hessians == 0 and normals.gradients == normals.values > 0
    page = work(sphere_scene(folder, '"diffuse", texture = "page"'), "sphere")
    assert page.channels > 0 and page.scene > normals.scene
    assert (page.cubes, page.polynomials) == (normals.cubes, normals.polynomials)
    mirrored = work(mirror_scene(folder), "mirror")
    assert 0 < mirrored.hessians < mirrored.gradients
    assert work(mirror_scene(folder, outputs=("Z",)), "mirror").hessians == 0


def test_other_engines_are_refused():
    field = GridField(plane(1.4), "linear", engine="numpy", precision=32)
    with pytest.raises(BadInput, match="precision=64"):
        Counters().watch(field)
    assert Counters(32).watch(field).engine.precision == 32


def test_nothing_sent_is_nothing_counted():
    field, counters = watched(plane(1.4))
    trace(field, np.zeros((0, 3)), np.zeros((0, 3)))
    assert counters.work == Work()
    assert Work(cubes=6).per(4)["cubes"] == 1.5
