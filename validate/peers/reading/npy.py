"""NumPy reads the arrays of an export, and where their samples lie from the description beside them.

In: a .npy file. Out: signed distances and texture at samples; interpolated linearly, by eight corners, between them.
"""

from pathlib import Path
from typing import Any

import numpy as np

from validate.peers.reading.question import Arrays, Question, Reader, Words, described, linear, serve


def _read(path: str) -> "tuple[dict[str, np.ndarray], Any]":
    about = described(str(Path(path).with_suffix(".npy.json")))
    folder = Path(path).parent
    return {name: np.load(folder / file, mmap_mode="r") for name, file in about["arrays"].items()}, about["lattice"]


def _look(given: "tuple[dict[str, np.ndarray], Any]", asked: Question) -> "tuple[Arrays, Words]":
    fields, lattice = given
    distance = fields.pop("distance")
    origin, spacing, at = np.array(lattice["origin"]), lattice["spacing"], tuple(asked.samples.T)
    answer = {
        "value": distance[at],
        "position": origin + spacing * asked.samples,
        "between": linear(distance, (asked.points - origin) / spacing),
    }
    return answer | {name: values[at] for name, values in fields.items()}, {"type": str(distance.dtype)}


if __name__ == "__main__":
    serve(lambda: Reader(np.__version__, _read, _look))
