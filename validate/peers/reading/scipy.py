"""SciPy interpolates B-spline coefficients that somebody else has found: `map_coordinates` without its prefilter.

In: a .npy file of coefficients and the description beside it. Out: values at samples, where the spline interpolates,
and between them.
"""

from pathlib import Path
from typing import Any

import numpy as np

from validate.peers.reading.question import Arrays, Question, Reader, Words, described, serve

_SOME = 4096  # samples asked for: 64 coefficients each


def _reader() -> Reader:
    import scipy
    from scipy.ndimage import map_coordinates

    def look(path: str, asked: Question) -> "tuple[Arrays, Words]":
        coefficients = np.load(path, mmap_mode="r")
        return _answer(coefficients, _lattice(path), asked), {"type": str(coefficients.dtype)}

    def _answer(coefficients: np.ndarray, lattice: Any, asked: Question) -> Arrays:
        origin, spacing = np.array(lattice["origin"]), lattice["spacing"]
        some = asked.samples[:_SOME]

        def cubic(place: np.ndarray) -> Any:
            return map_coordinates(coefficients, place.T, np.float64, order=3, mode="nearest", prefilter=False)

        return {
            "node": cubic(some),
            "position": origin + spacing * some,
            "cubic": cubic((asked.points - origin) / spacing),
        }

    return Reader(scipy.__version__, str, look)


def _lattice(path: str) -> Any:
    return described(str(Path(path).with_suffix(".npy.json")))["lattice"]


if __name__ == "__main__":
    serve(_reader)
