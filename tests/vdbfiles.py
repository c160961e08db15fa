"""Three ways to read an OpenVDB file, for tests: plain struct, libopenvdb in Debian's Python, and tinyvdb."""

import json
import struct
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

DEBIAN = "/usr/bin/python3"


class Read(NamedTuple):
    """A grid over a box of the index space from [0, 0, 0] on; `values` is NaN where a reader tells active ones only."""

    background: float
    values: np.ndarray
    active: np.ndarray
    entries: dict
    voxel: tuple
    origin: tuple


class _Cursor:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, form):
        found = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return found if len(found) > 1 else found[0]

    def text(self):
        return self.take(f"{self.take('I')}s").decode()

    def bits(self, count):
        self.at += count // 8
        return np.unpackbits(np.frombuffer(self.data, np.uint8, count // 8, self.at - count // 8), bitorder="little")

    def array(self, kind, count):
        self.at += np.dtype(kind).itemsize * count
        return np.frombuffer(self.data, kind, count, self.at - np.dtype(kind).itemsize * count)


KINDS = {"Tree_float_5_4_3": ("<f4", 1), "Tree_vec3s_5_4_3": ("<f4", 3), "Tree_bool_5_4_3": ("?", 1)}
ENTRIES = {"string": lambda c, n: c.take(f"{n}s").decode(), "int64": lambda c, n: c.take("q"),
           "vec3i": lambda c, n: c.take("3i"), "bool": lambda c, n: c.take("?")}  # fmt: skip


def by_struct(path, shape):
    """Read as the format is written down, one number after the other; every byte has to be accounted for."""
    c = _Cursor(Path(path).read_bytes())
    assert c.take("q") == 0x56444220 and c.take("I") == 224
    assert c.take("II")[0] >= 6 and c.take("?")
    assert len(c.take("36s")) == 36 and c.take("I") == 0
    grids = {}
    for _ in range(c.take("I")):
        name, kind, parent = c.text(), c.text(), c.text()
        start, blocks, end = c.take("qqq")
        assert parent == "" and name not in grids and start == c.at
        assert c.take("I") == 2  # inactive values are compressed, nothing else is
        entries = {}
        for _ in range(c.take("I")):
            key, type_, size = c.text(), c.text(), c.take("I")
            entries[key] = ENTRIES[type_](c, size)
        assert c.text() == "UniformScaleTranslateMap"
        origin, *scales = (c.take("3d") for _ in range(6))
        h = scales[0][0]
        np.testing.assert_allclose(scales, np.outer([h, h, 1 / h, 1 / h**2, 1 / (2 * h)], np.ones(3)), rtol=1e-15)
        grids[name] = _tree(c, kind, blocks, shape)._replace(entries=entries, voxel=scales[1], origin=origin)
        assert c.at == end
    assert c.at == len(c.data)
    return grids


def _tree(c, kind, blocks, shape):
    number, width = KINDS[kind]
    assert c.take("I") == 1
    background = c.array(number, width)
    size = tuple(-(-n // 8) * 8 for n in shape)
    values, active = np.empty((*size, width), number), np.zeros(size, bool)
    values[:] = background
    leaves = []
    tiles, children = c.take("II")
    assert tiles == 0
    for _ in range(children):
        _inner(c, c.take("3i"), 5, values, leaves, (number, width, background))
    assert c.at == blocks
    for place, mask in leaves:
        assert (c.bits(512) == mask).all()
        cube = tuple(slice(n, n + 8) for n in place)
        active[cube] = mask.reshape(8, 8, 8)
        if number == "?":
            assert c.take("3i") == tuple(place)
            values[cube] = c.bits(512).reshape(8, 8, 8, 1)
        else:
            values[cube] = _values(c, mask, 512, (number, width, background)).reshape(8, 8, 8, width)
    whole = tuple(map(slice, shape))
    return Read(
        background.item(0), values[whole].squeeze(-1) if width == 1 else values[whole], active[whole], {}, (), ()
    )


def _inner(c, place, log2, values, leaves, kind):
    """Read an inner node: tiles into `values`, leaves (origin and mask) into `leaves`."""
    side = 1 << log2
    child, on = c.bits(side**3), c.bits(side**3)
    assert not on.any()
    tile = _values(c, on, side**3, kind)
    step = 128 if log2 == 5 else 8
    for n in np.flatnonzero((child == 1) | (tile != kind[2]).any(axis=1)):
        at = np.array(place) + np.array([n >> 2 * log2, (n >> log2) % side, n % side]) * step
        if not child[n]:
            values[tuple(slice(i, i + step) for i in at)] = tile[n]
        elif log2 == 5:
            _inner(c, at, 4, values, leaves, kind)
        else:
            leaves.append((at, c.bits(512)))


def _values(c, on, count, kind):
    number, width, background = kind
    code = c.take("B")
    assert code in (0, 3)
    found = np.empty((count, width), number)
    found[:] = background
    if code == 3:
        found[c.bits(count) == 0] = -background
    found[on == 1] = c.array(number, width * on.sum()).reshape(-1, width)
    return found


WORKER = """
import json, sys
import numpy as np
import pyopenvdb as vdb
path, out, shape = sys.argv[1], sys.argv[2], tuple(map(int, sys.argv[3:]))
arrays, facts = {}, {}
for grid in vdb.readAll(path)[0]:
    width = (3,) if grid.valueTypeName == "vec3s" else ()
    kind = bool if grid.valueTypeName == "bool" else np.float32
    values, marked = np.empty(shape + width, kind), np.empty(shape + width, kind)
    grid.copyToArray(values)
    marks = grid.deepCopy()
    marks.mapOn(lambda value: (7e7,) * 3 if width else 7e7 if kind is np.float32 else True)
    marks.copyToArray(marked)
    active = marked == (7e7 if kind is np.float32 else True)
    arrays[grid.name], arrays[grid.name + ".active"] = values, active[..., 0] if width else active
    outside = grid.getConstAccessor().probeValue((-1, 3, 4000))
    box = grid.evalActiveVoxelBoundingBox() if grid.activeVoxelCount() else None
    facts[grid.name] = {
        "background": grid.background[0] if width else grid.background, "voxel": grid.transform.voxelSize(),
        "origin": grid.transform.indexToWorld((0, 0, 0)), "entries": {k: grid[k] for k in grid.metadata},
        "active": grid.activeVoxelCount(), "outside": outside, "box": box, "class": grid.gridClass,
    }
np.savez(out, **arrays)
print(json.dumps(facts))
"""


def by_openvdb(path, shape):
    """Read by libopenvdb, which also says what lies outside, how many voxels are active and where."""
    facts, arrays = _asked(path, shape)
    grids = {}
    for name, said in facts.items():
        active, entries = arrays[name + ".active"], said["entries"]
        assert said["active"] == entries["file_voxel_count"] == active.sum()
        if said["box"]:
            assert said["box"] == [entries["file_bbox_min"], entries["file_bbox_max"]]
        outside, on = said["outside"]
        assert not on and outside in (said["background"], [said["background"]] * 3)
        grids[name] = Read(said["background"], arrays[name], active, entries, said["voxel"], said["origin"])
    return grids


def openvdb_arrays(path, shape):
    """Return values and which are active of the grids of any file."""
    facts, arrays = _asked(path, shape)
    return {name: (arrays[name], arrays[name + ".active"]) for name in facts}


def _asked(path, shape):
    found = subprocess.run([DEBIAN, "-c", "import pyopenvdb"], capture_output=True) if Path(DEBIAN).exists() else None
    if found is None or found.returncode:
        pytest.skip("Debian's python3-openvdb is not installed")
    out = Path(path).with_suffix(".npz")
    command = [DEBIAN, "-c", WORKER, str(path), str(out), *map(str, shape)]
    facts = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    return facts, np.load(out)


READERS = {"struct": by_struct, "openvdb": by_openvdb}


def leaves_by_tinyvdb(path):
    """Read the leaves' values in their order; where they lie, tinyvdb 0.9 does not tell."""
    tinyvdb = pytest.importorskip("tinyvdb")
    file, grids = tinyvdb.open(str(path)), {}
    file.read_grids()
    for number in range(file.grid_count):
        grid = file.grid(number)
        nodes = [grid.tree.node(n) for n in range(grid.tree.num_nodes)]
        leaves = [node for node in nodes if node.type == "leaf"]
        grids[grid.name] = (grid, [node.data for node in leaves], sum(node.active_voxel_count for node in leaves))
    return grids
