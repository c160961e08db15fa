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
