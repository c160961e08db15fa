"""TinyVDB reads a level set: the active voxels that it lists, every leaf, background, class and transform.

In: a .vdb file. Out: signed distances. Its version 0.9 lists the voxels of 64 leaves alone and gives no leaf's place,
in files of OpenVDB's own too: the others are compared in the order of the file.
"""

from importlib.metadata import version
from typing import Any

import numpy as np

from validate.peers.reading.question import Arrays, Question, Reader, Words, serve


def _reader() -> Reader:
    import tinyvdb

    def read(path: str) -> Any:
        file = tinyvdb.open(path)
        file.read_grids()
        return file

    return Reader(version("tinyvdb"), read, _look)


def _look(file: Any, asked: Question) -> "tuple[Arrays, Words]":
    names = [file.grid_name(i) for i in range(file.grid_count)]
    grid = file.grid(names.index("sdf"))
    listed, map_ = grid.to_sparse(), grid.transform
    index = np.frombuffer(listed["coords"], np.int32).reshape(-1, 3).astype(np.int64)
    nodes = [grid.tree.node(i) for i in range(grid.tree.num_nodes)]
    leaves = [node for node in nodes if node.type == "leaf"]
    arrays: Arrays = {
        "index": index,
        "value": np.frombuffer(listed["values"], np.float32),
        "position": np.array(map_["translation"]) + np.array(map_["scale"]) * index,
        "background": np.array([grid.float_background()]),
        "leaves": np.array([np.frombuffer(leaf.data, np.float32) for leaf in leaves]),
        "active_voxels": np.array([sum(leaf.active_voxel_count for leaf in leaves)]),
    }
    return arrays, {"class": str(grid.metadata["class"]), "grids": ", ".join(names)}


if __name__ == "__main__":
    serve(_reader)
