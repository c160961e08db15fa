"""Mitsuba 3: trilinear `sdfgrid` with smooth normals, on a dense cube of samples.

In: samples [x, y, z] and a view. Out: ray parameters of the first hit and, after a mirror, of the next; float32. Its
samples lie on the corners of cells of the unit cube, stored [z][y][x][1].
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from validate.peers.frames import MIRROR, PRIMARY, Renderer, View, serve


def _renderer() -> Renderer:
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")

    def prepare(samples: np.ndarray, view: View, options: "Mapping[str, str]") -> "tuple[Any, View]":
        edge = view.spacing * (len(samples) - 1)
        shape = {
            "type": "sdfgrid",
            "grid": mi.TensorXf(samples),
            "normals": "smooth",
            "to_world": mi.ScalarTransform4f().translate(list(view.origin)).scale(edge),
        }
        scene = mi.load_dict({"type": "scene", "shape": shape})
        dr.sync_thread()
        return scene, view

    def rays(view: View) -> Any:
        index = dr.arange(mi.UInt32, view.pixels**2)
        width = dr.opaque(mi.UInt32, view.pixels)  # as ours: no size is a literal of the program
        step = dr.opaque(mi.Float, 2 * view.slope / view.pixels)
        x, y = (step * (mi.Float(i) + 0.5) - view.slope for i in (index % width, index // width))
        return mi.Ray3f(mi.Point3f(*view.eye), dr.normalize(mi.Vector3f(x, -y, -1)))

    def primary(scene: Any, view: View) -> "dict[str, Any]":
        met = scene.ray_intersect_preliminary(rays(view))
        return {"t": met.t, "hit": met.is_valid()}

    def mirror(scene: Any, view: View) -> "dict[str, Any]":
        ray = rays(view)
        met = scene.ray_intersect(ray)
        n = met.sh_frame.n
        again = scene.ray_intersect(met.spawn_ray(ray.d - 2 * dr.dot(ray.d, n) * n), met.is_valid())
        return {"t": met.t, "hit": met.is_valid(), "n": n, "t2": again.t, "hit2": again.is_valid()}

    jobs = {PRIMARY: primary, MIRROR: mirror}

    def frame(given: "tuple[Any, View]", job: str) -> "dict[str, Any]":
        found = jobs[job](*given)
        dr.eval(*found.values())
        dr.sync_thread()
        return found

    def look(found: "dict[str, Any]") -> "dict[str, np.ndarray]":
        pairs = {"t": "hit", "t2": "hit2"}
        return {t: np.where(np.array(found[hit]), np.array(found[t]), np.inf) for t, hit in pairs.items() if t in found}

    return Renderer(mi.__version__, _stored, prepare, frame, look)


def _stored(samples: str) -> np.ndarray:
    """Read the dense cube, in the order that `sdfgrid` wants."""
    return np.ascontiguousarray(np.load(f"{samples}.npy").transpose(2, 1, 0))[..., None]


if __name__ == "__main__":
    serve(_renderer)
