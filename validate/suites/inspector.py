"""Both footprints of every pixel of a picture, the grid's and the mesh's, for the report's inspector.

In: build/scenes, grids, meshes and textures of a textured object, and of the mirror scene of Galim 2018. Out: one error
run per scene, whose artefact holds the picture, its texture, and per route what was seen at each pixel.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from datasets_synthetic import shape
from sdfbake.mesh import Mesh
from sdfrender import load_scene
from sdfrender.image import srgb_bytes
from sdfrender.render import shoot
from sdfrender.scene import Scene
from sdfrender.stage import prepare
from validate.beam import Beam
from validate.closed import ExactReference
from validate.embree import MeshReference
from validate.experiment import Bench, Run, guarded
from validate.metrics import Seen, jacobian_error, lod_error, summary
from validate.views import TEXELS, seen, through_field

SIZE = 224  # pixels along a side of the picture


@dataclass(frozen=True, slots=True)
class View:
    """A picture to inspect: its scene, the mesh and the texture of its object, and the shape that is its truth."""

    scene: str
    mesh: str
    texture: str
    bounces: int = 0
    exact: str | None = None


VIEWS = {
    "bunny": View("bunny", "bunny", "checker"),
    "torus": View("torus", "torus", "checker"),
    "mirror": View("figure-6-cubic", "mirror", "page", bounces=1, exact="mirror"),
}


def run(bench: Bench) -> Iterator[Run]:
    """Render each picture and follow its pixels by every route."""
    for name, view in VIEWS.items():
        bench.progress(f"inspector: {name}")
        blank = Run("inspector", name, {"truth": "exact shape" if view.exact else "mesh"}, {}, "error")
        yield guarded(blank, partial(_inspected, bench, blank, view))


def _inspected(bench: Bench, blank: Run, view: View) -> Run:
    scene = _small(load_scene(bench.build / "scenes" / f"{view.scene}.toml"))
    stage = prepare(scene)
    image = srgb_bytes(shoot(stage)["rgb"])
    rays = scene.camera.camera((SIZE, SIZE)).rays()
    routes = {"grid": through_field(stage.members[0], rays, view.bounces, 1.0)[0], **_references(bench, view, rays)}
    truth = routes["exact" if view.exact else "mesh"]
    both = np.logical_and.reduce([route.hit for route in routes.values()])
    values = {"pixels": float(both.sum())}
    for name, route in routes.items():
        if route is not truth:
            errors = {"lod": lod_error, "jacobian": jacobian_error}
            for metric, function in errors.items():
                found = summary(function(route.at(both), truth.at(both)))
                values |= {f"{name}.{metric}.{key}": figure for key, figure in found.items()}
    arrays = {f"{name}_{part}": values for name, route in routes.items() for part, values in _packed(route, both)}
    texture = _texture(bench, view.texture)
    artefact = bench.store(f"inspector-{blank.problem}", image=image, texture=texture, hit=both, **arrays)
    return replace(blank, values=values, artefact=artefact)


def _small(scene: Scene) -> Scene:
    film = scene.film.model_copy(update={"size": (SIZE, SIZE), "supersample": 1, "outputs": ("rgb",)})
    return scene.model_copy(update={"film": film})


def _references(bench: Bench, view: View, rays: Beam) -> dict[str, Seen]:
    """What the mesh sees, as renderers see it (interpolated normals), and the exact shape where there is one."""
    mesh = MeshReference(Mesh.load(bench.mesh(view.mesh)))
    routes = {"mesh": seen(mesh.follow(rays, view.bounces, "angle")[-1])}
    if view.exact is not None:
        routes["exact"] = seen(ExactReference(shape(view.exact)).follow(rays, view.bounces)[-1])
    return routes


def _packed(route: Seen, both: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Of the pixels that every route hits: texture coordinates, footprint in texels, chart."""
    yield "uv", route.uv[both].astype(np.float32)
    yield "jacobian", route.jacobian[both].reshape(-1, 4).astype(np.float32)
    yield "chart", route.chart[both].astype(np.int32)


def _texture(bench: Bench, name: str) -> UInt8[np.ndarray, "h w 3"]:
    with Image.open(bench.build / "textures" / f"{name}.png") as image:
        return np.asarray(image.convert("RGB").resize((TEXELS, TEXELS)))
