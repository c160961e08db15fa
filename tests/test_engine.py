"""Both engines run one program and agree; the choice between them never crashes the process."""

import os
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest

from sdfbake.complaint import BadInput
from sdfbake.engine import choose
from sdfbake.engine.choose import _version
from sdfbake.engine.tree import leaves, rebuild


class State(NamedTuple):
    value: object
    count: tuple


def collatz(xp, n):
    """Steps of the Collatz iteration: a loop whose length differs from ray to ray."""
    start = State(n, (xp.full(n, 0),))

    def step(state, constants):
        odd = (state.value & 1) == 1
        return State(xp.where(odd, state.value * 3 + constants[0], state.value >> 1), (state.count[0] + 1,))

    end = xp.while_loop(lambda state: state.value > 1, step, start, (xp.full(n, 1),))
    return {"steps": end.count[0], "end": end.value}


def test_loops_of_different_length(choice):
    n = np.arange(1, 100)
    expected = []
    for value in n.tolist():
        steps = 0
        while value > 1:
            value = value * 3 + 1 if value & 1 else value // 2
            steps += 1
        expected.append(steps)
    out = choice.engine.run(collatz, [n])
    assert out["steps"].tolist() == expected
    assert (out["end"] == 1).all()


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_body_among_some(share, choice, rng):
    """Lanes that do not ask keep floats, integers and masks as they are, and the caller's arrays stay."""
    active = rng.uniform(size=500) < share

    def program(xp, n, on, x):
        even = (n & 1) == 0

        def body(state):
            mask, inner, kept = state
            return ~mask, State(inner.value * 2.0, (inner.count[0] + xp.integer(mask),)), kept

        mask, inner, kept = xp.among(on > 0, body, (even, State(x, (n,)), x))
        counts = {"mask": xp.integer(mask), "count": inner.count[0], "before": xp.integer(even)}
        return counts | {"value": inner.value, "kept": kept, "x": x}

    n, x = np.arange(500), rng.normal(size=500).astype(np.float32).astype(float)
    out = choice.engine.run(program, [n, active, x])
    even = n % 2 == 0
    assert np.array_equal(out["mask"], even ^ active)
    assert np.array_equal(out["value"], np.where(active, 2 * x, x))
    assert np.array_equal(out["count"], n + (active & even))
    assert np.array_equal(out["before"], even) and np.array_equal(out["x"], x) and np.array_equal(out["kept"], x)


def test_a_body_among_some_is_given_no_others(rng):
    """NumPy does the work of the lanes that ask, and none where there are none."""
    widths = []

    def program(xp, x):
        def body(state):
            widths.append(len(state[0]))
            return state

        for limit in (0.5, 2.0):
            xp.among(x > limit, body, (x,))
        return {"x": x}

    x = rng.uniform(size=100)
    choose("numpy").engine.run(program, [x])
    assert widths == [np.count_nonzero(x > 0.5)]


@pytest.mark.parametrize("alive", [0, 1, 2, 137, 500])
def test_a_program_apart(alive, choice, rng):
    """What `among` does, also for constants, for arrays that are one and the same, and for a single lane."""
    active = np.zeros(500, bool)
    active[rng.permutation(500)[:alive]] = True

    def program(xp, n, on, x):
        def body(state):
            one, (two, three), mask, count = state
            return one + 1.0, (two * 2.0, three - two), ~mask, count + xp.integer(mask)

        state = (xp.full(x, 0.5), (x, x), xp.full(x, True), n)
        one, (two, three), mask, count = xp.apart(on > 0, body, state)
        return {"one": one, "two": two, "three": three, "mask": xp.integer(mask), "count": count, "x": x + 0.0}

    n, x = np.arange(500), rng.normal(size=500).astype(np.float32).astype(float)
    out = choice.engine.run(program, [n, active, x])
    assert np.array_equal(out["one"], np.where(active, 1.5, 0.5))
    assert np.array_equal(out["two"], np.where(active, 2 * x, x))
    assert np.array_equal(out["three"], np.where(active, 0, x))
    assert np.array_equal(out["mask"], ~active) and np.array_equal(out["count"], n + active)
    assert np.array_equal(out["x"], x)


def test_programs_apart_are_compiled_once(rng):
    """However many lanes are left, and whatever their arrays were before: literals at first, results later."""
    dr = pytest.importorskip("drjit")
    engine = choose("drjit").engine
    bodies = []

    def program(xp, x):
        def body(state):
            bodies.append(xp)
            value, step, left = state
            return value * step + 0.25, step, left - 1

        state = (x, xp.full(x, 0.5), xp.integer(x * 4.0))
        for _ in range(6):
            state = xp.apart(state[2] > 0, body, state)
        return {"value": state[0]}

    engine.run(program, [np.ones(7)])  # what surrounds the bodies is compiled by now, and they are, too
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        bodies.clear()
        engine.run(program, [np.concatenate([rng.uniform(0, 1.4, 999), [1.5]])])
        compiled = [kernel for kernel in dr.kernel_history() if not kernel.get("cache_hit", True)]
    assert len(bodies) == 6 and not compiled


def test_no_rays(choice):
    out = choice.engine.run(collatz, [np.zeros(0, np.int32)])
    assert out["steps"].shape == (0,)


def test_gather_where_and_rounding(choice, rng):
    table, index = rng.normal(size=50), rng.integers(0, 50, 1000)

    def program(xp, i, x):
        bytes_ = xp.gather(xp.table(np.arange(50, dtype=np.uint8)), i, x > 0)
        return {
            "picked": xp.where(x > 0, xp.gather(xp.table(table), i, x > 0), -1.0),
            "bytes": xp.where(x > 0, bytes_, 0),
            "floor": xp.floor(x),
            "whole": xp.integer(x),
            "root": xp.sqrt(xp.abs(x)),
        }

    x = rng.normal(size=1000) * 3
    x = x.astype(np.float32).astype(float)  # the same number on every engine
    out = choice.engine.run(program, [index, x])
    kind = np.float64 if choice.engine.precision == 64 else np.float32
    assert np.array_equal(out["picked"], np.where(x > 0, table[index].astype(kind), -1))
    assert np.array_equal(out["bytes"], np.where(x > 0, index, 0))
    assert np.array_equal(out["floor"], np.floor(x))
    assert np.array_equal(out["whole"], np.trunc(x))
    # A square root is rounded correctly on both engines: half a unit in the last place.
    assert np.abs(out["root"] - np.sqrt(np.abs(x))).max() <= choice.engine.eps * 2


def test_more_rays_than_a_tile(choice):
    n = 100_000
    out = choice.engine.run(lambda xp, i: {"i": i + 1}, [np.arange(n)])
    assert np.array_equal(out["i"], np.arange(1, n + 1))


def test_tables_of_rows(choice):
    """Rows of one, of as many as are stored at once, and of others; floats and integers; more lanes than a tile."""
    xp, count = choice.engine, 40_000

    def rows(lane):
        x = xp.real(lane)
        return (lane * 2,), (x, x + 1, x + 2, x + 3), (lane, lane + 1, lane + 2), (x > 7,)

    single, four, three, mask = (np.array(table) for table in xp.tabulated(count, rows))
    n = np.arange(count)
    assert np.array_equal(single, 2 * n) and np.array_equal(mask, n > 7)
    assert np.array_equal(four.reshape(-1, 4), n[:, None] + np.arange(4))
    assert np.array_equal(three.reshape(-1, 3), n[:, None] + np.arange(3))
    assert four.dtype == (np.float64 if xp.precision == 64 else np.float32) and three.dtype == np.int32


def test_parts_of_arrays(choice, rng):
    xp = choice.engine
    values = rng.normal(size=50).astype(np.float32)
    whole, place = xp.table(values), rng.permutation(50)[:20]
    replaced = np.array(xp.replaced(whole, xp.table(place), xp.table(values[:20] + 1)))
    expected = values.copy()
    expected[place] = values[:20] + 1
    assert np.array_equal(replaced, expected) and np.array_equal(np.array(whole), values)
    assert xp.extremes(whole) == (values.min(), values.max())
    for parts in ([values], [values, values[:3], values[7:]]):
        assert np.array_equal(np.array(xp.joined([xp.table(part) for part in parts])), np.concatenate(parts))
    several = [xp.table(rng.normal(size=50).astype(np.float32)) for _ in range(5)]
    stacked = np.stack([np.array(array) for array in several])
    assert np.array_equal(np.array(xp.least(several)), stacked.min(axis=0))
    assert np.array_equal(np.array(xp.most(several)), stacked.max(axis=0))


def test_inactive_lanes_may_ask_for_anything(choice):
    """What they get is not used; the look-up must not fail."""
    xp = choice.engine
    table, index = xp.table(np.arange(4.0)), xp.table(np.array([-7, 2, 99]))
    active = (index >= 0) & (index < 4)
    assert np.array(xp.where(active, xp.gather(table, index, active), -1.0)).tolist() == [-1, 2, -1]
    row = xp.rows(table, index - 2, active)
    assert np.array(row[3])[1] == 3


def test_trees_come_back():
    tree = State(1, (2, (3, State(4, (5,)))))
    assert leaves(tree) == [1, 2, 3, 4, 5]
    assert rebuild(tree, leaves(tree)) == tree
    assert rebuild(tree, [5, 4, 3, 2, 1]).count[1][1] == State(2, (1,))


@pytest.mark.parametrize(("name", "precision"), [("cuda", 32), ("numpy", 16), ("", 64)])
def test_unknown_engines(name, precision):
    with pytest.raises(BadInput, match="choose"):
        choose(name, precision)


@pytest.mark.parametrize(
    ("file", "version"),
    [("libLLVM-14.so.1", 14), ("libLLVM.so.23.1", 23), ("libLLVM-19.so", 19), ("libLLVM.so", 0), ("libLLVM.dylib", 0)],
)
def test_llvm_versions_are_read_off_names(tmp_path, file, version):
    (tmp_path / file).touch()
    assert _version(tmp_path / file) == version


def test_an_old_llvm_is_never_loaded(tmp_path):
    """The library that aborts the process is refused by its name, in a process of its own to be sure."""
    old = tmp_path / "libLLVM-14.so.1"
    old.write_text("not even a library")
    code = "from sdfbake.engine import choose; c = choose('auto'); print(c.engine.name, c.reason)"
    out = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "DRJIT_LIBLLVM_PATH": str(old)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert out.stdout.startswith("numpy drjit cannot run here")
    assert "14" in out.stdout
