"""Dr.Jit samples B-spline coefficients as a texture does on a GPU: `eval_cubic`, eight linear look-ups.

In: a .npy file of coefficients and the description beside it. Out: values at samples, where the spline interpolates,
and between them, float32.
"""

from importlib.metadata import version
from pathlib import Path

import numpy as np

from validate.peers.reading.question import Arrays, Question, Reader, Words, described, serve

_SOME = 4096


def _reader() -> Reader:
    from drjit.llvm import Array3f, Float, TensorXf, Texture3f

    def look(path: str, asked: Question) -> "tuple[Arrays, Words]":
        lattice = described(str(Path(path).with_suffix(".npy.json")))["lattice"]
        origin, spacing, shape = np.array(lattice["origin"]), lattice["spacing"], np.array(lattice["shape"])
        # A texture's axes are [z, y, x], the last one fastest; its texels have their middles at half-integers.
        texture = Texture3f(TensorXf(np.load(path).transpose(2, 1, 0)[..., None].copy()), use_accel=False)

        def cubic(place: np.ndarray) -> np.ndarray:
            u = ((place + 0.5) / shape).astype(np.float32)
            return np.array(texture.eval_cubic(Array3f(*(Float(np.ascontiguousarray(c)) for c in u.T)))[0])

        some = asked.samples[:_SOME]
        return {
            "node": cubic(some.astype(np.float64)),
            "position": origin + spacing * some,
            "cubic": cubic((asked.points - origin) / spacing),
        }, {"texture": "x".join(map(str, shape))}

    return Reader(version("drjit"), str, look)


if __name__ == "__main__":
    serve(_reader)
