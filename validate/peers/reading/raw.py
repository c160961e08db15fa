"""NumPy reads plain blocks by their JSON description alone, as an engine would upload them.

In: a .json file and the blocks beside it. Out: signed distances and texture at samples: those of a brick by its slot,
the bound where there is none.
"""

from pathlib import Path
from typing import Any

import numpy as np

from validate.peers.reading.question import Arrays, Question, Reader, Words, described, serve


def _read(path: str) -> "tuple[dict[str, np.ndarray], Any]":
    about = described(path)
    data = (Path(path).parent / about["data"]).read_bytes()
    arrays = {}
    for entry in about["arrays"]:
        kind = np.dtype(entry["dtype"]).newbyteorder("<")
        count = int(np.prod(entry["shape"]))
        arrays[entry["name"]] = np.frombuffer(data, kind, count, entry["offset"]).reshape(entry["shape"])
    return arrays, about


def _look(given: "tuple[dict[str, np.ndarray], Any]", asked: Question) -> "tuple[Arrays, Words]":
    arrays, about = given
    side, scale, lattice = about["brick"], about["distance_scale"], about["lattice"]
    brick = tuple((asked.samples // side).T)
    slot = arrays["slot"][brick]
    at = (slot, *(asked.samples % side).T)
    distance = np.where(slot >= 0, arrays["distance"][at], arrays["far"][brick])
    answer = {
        "value": distance.astype(np.float64) * scale,
        "position": np.array(lattice["origin"]) + lattice["spacing"] * asked.samples,
    }
    if "uv" in arrays:
        answer["uv"] = np.array(about["uv_offset"]) + np.array(about["uv_scale"]) * arrays["uv"][at]
    answer |= {name: arrays[name][at] for name in ("chart", "seam", "part") if name in arrays}
    return answer, {"type": str(arrays["distance"].dtype)}


if __name__ == "__main__":
    serve(lambda: Reader(np.__version__, _read, _look))
