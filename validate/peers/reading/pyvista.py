"""PyVista (VTK) reads image data: point data at samples, its own probe between them, its own contour.

In: a .vti file. Out: signed distances, positions, texture coordinates, points of the contour.
"""

from typing import Any

import numpy as np

from validate.peers.reading.question import Arrays, Question, Reader, Words, serve


def _reader() -> Reader:
    import pyvista

    def look(image: Any, asked: Question) -> "tuple[Arrays, Words]":
        at = np.ravel_multi_index(tuple(asked.samples.T), image.dimensions, order="F")
        probed = pyvista.PolyData(asked.points).sample(image)
        arrays = {
            "value": np.asarray(image.point_data["sdf"])[at],
            "position": np.asarray(image.points)[at],
            "between": np.asarray(probed.point_data["sdf"]),
            "surface": np.asarray(image.contour([0.0], scalars="sdf").points, np.float64),
        }
        names = image.point_data.keys()
        arrays |= {name: np.asarray(image.point_data[name])[at] for name in names if name != "sdf"}
        return arrays, {"arrays": ", ".join(names)}

    return Reader(f"{pyvista.__version__}, VTK {pyvista.vtk_version_info}", pyvista.read, look)


if __name__ == "__main__":
    serve(_reader)
