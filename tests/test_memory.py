"""Threads and memory change nothing but time: the same bytes; refusals come with the number."""

import os
import warnings
from unittest import mock

import numpy as np
import pytest
from adversarial import ball, box, dirty, soup

import datasets_synthetic
from sdfbake import BadInput, bake
from sdfbake.closest import Surface
from sdfbake.engine.choose import _jit_problem
from sdfbake.lattice import Lattice
from sdfbake.memory import GIB, Budget

NEEDS_JIT = pytest.mark.skipif(_jit_problem() is not None, reason="Dr.Jit cannot run here")


def baked(mesh, resolution, **options):
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # of soups and duplicates
        return bake(mesh, resolution, **options)


def saved(grid, folder):
    grid.save(folder / "grid.zarr.zip")
    return (folder / "grid.zarr.zip").read_bytes()


SAME = {
    "torus with all texture coordinates": (datasets_synthetic.shape("torus").mesh(0.2), {"uv_mode": "faces,grid"}),
    "box": (box(1.0, 0.7, 0.4, turned=True), {}),
    "soup": (soup(), {"open": "winding"}),
}


@NEEDS_JIT
@pytest.mark.parametrize(("mesh", "options"), SAME.values(), ids=SAME)
def test_the_same_bytes_on_any_number_of_threads(mesh, options, tmp_path):
    import drjit

    files = []
    before = drjit.thread_count()
    try:
        for threads in (1, 2, 8):
            drjit.set_thread_count(threads)
            with mock.patch.object(os, "cpu_count", lambda threads=threads: threads):
                files.append(saved(baked(mesh, 32, engine="drjit", **options), tmp_path))
    finally:
        drjit.set_thread_count(before)
    assert files[1:] == files[:1] * 2


def test_numpy_gives_the_same_bytes_on_any_number_of_threads(tmp_path):
    files = []
    for threads in (1, 2, 8):
        with mock.patch.object(os, "cpu_count", lambda threads=threads: threads):
            files.append(saved(baked(dirty(), 20, engine="numpy"), tmp_path))
    assert files[1:] == files[:1] * 2


@pytest.mark.parametrize("name", ["numpy", pytest.param("drjit", marks=NEEDS_JIT)])
def test_the_same_bytes_for_any_number_of_bricks_at_once(name, tmp_path):
    files = []
    for at_once in (5, 16, 8192):
        with mock.patch.object(Budget, "bricks_at_once", lambda self, count, at_once=at_once: at_once):
            files.append(saved(baked(ball(1), 24, engine=name), tmp_path))
    assert files[1:] == files[:1] * 2


def test_little_memory_is_enough_or_refused_with_the_number(tmp_path):
    mesh = ball(3)
    with pytest.raises(
        BadInput, match=r"resolution 64 needs about \d\.\d\d GB of memory and 0\.10 GB are allowed"
    ) as no:
        bake(mesh, 64, max_memory=0.1)
    needed = float(str(no.value).split("about ")[1].split(" GB")[0])
    little = bake(mesh, 64, max_memory=needed + 0.02)
    plenty = bake(mesh, 64, max_memory=8.0)
    assert saved(little, tmp_path) == saved(plenty, tmp_path)


def test_budget():
    surface, bounds = Surface.of(ball(3)), ball(3).bounds
    lattice = Lattice.around(bounds, 512)

    def budget(gigabytes, modes=(), parts=1):
        return Budget.of(gigabytes, surface, lattice, modes, parts)

    # float32 and a face; uv and chart; layers; a part.
    assert budget(4.0).per_brick == 8 * 512
    assert budget(4.0, ("faces", "layers", "grid"), 2).per_brick == (8 + 12 + 18 + 1) * 512
    # A sphere of radius r voxels crosses pi r^2 / 16 areas of 8^2; the least is half of that.
    radius = (512 - 1 - 10.4) / 2
    assert budget(4.0).least == pytest.approx(np.pi * radius**2 / 16 / 2, rel=0.01)
    counts = [budget(gigabytes).bricks_at_once(16_000) for gigabytes in (0.4, 0.5, 0.6, 64.0)]
    assert counts == sorted(counts) and counts[0] < counts[-1] == 8192
    with pytest.raises(BadInput, match="0\\.40 GB are allowed"):
        budget(0.4).bricks_at_once(200_000)
    assert budget(None).limit > GIB / 8
    with pytest.raises(BadInput, match="8192 needs about"):
        Budget.of(2.0, surface, Lattice.around(bounds, 8192), (), 1).check_tables()
