"""Mitsuba 3 reads the scene file that lies beside an exported volume, and traces its `sdfgrid`.

In: a .vol file. Out: ray parameters of first hits, in the world of the scene; texture coordinates from its second
volume.
"""

from pathlib import Path
from typing import Any

import numpy as np

from validate.peers.reading.question import Arrays, Question, Reader, Words, serve

_SOME = 65536  # samples whose texture is looked up


def _reader() -> Reader:
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")

    def columns(points: np.ndarray) -> Any:
        return mi.Point3f(*(mi.Float(np.ascontiguousarray(column, np.float32)) for column in points.T))

    def hits(scene: Any, asked: Question) -> np.ndarray:
        met = scene.ray_intersect(mi.Ray3f(columns(asked.p), mi.Vector3f(columns(asked.d))))
        return np.where(np.array(met.is_valid()), np.array(met.t), np.inf)

    def colours(scene: Any, points: np.ndarray) -> np.ndarray:
        (shape,) = scene.shapes()
        at = dr.zeros(mi.SurfaceInteraction3f, len(points))
        at.p, at.wi = columns(points), mi.Vector3f(0, 0, 1)
        return np.array(shape.bsdf().eval_diffuse_reflectance(at)).T

    def look(path: str, asked: Question) -> "tuple[Arrays, Words]":
        beside = Path(path).with_suffix(".xml")
        scene = mi.load_file(str(beside))
        answer = {"t": hits(scene, asked)}
        if Path(path).with_suffix(".uv.vol").exists():
            answer["uv"] = colours(scene, asked.places[:_SOME])[:, :2]
        return answer, {"scene": beside.name, "uv": "interpolated"}

    return Reader(mi.__version__, str, look)


if __name__ == "__main__":
    serve(_reader)
