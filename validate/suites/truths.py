"""The truths against each other: how far each can be trusted, by its own estimate and by another route.

In: nothing of the build. Out: error runs. Closed forms against displaced rays, whose step is the knob; the mesh by
Embree against displaced rays over the same mesh; texture coordinates by face against those that Embree's hits have.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from datasets_synthetic import mesh, shape
from sdfrender import Camera, Rays
from validate import metrics
from validate.beam import Beam, displace
from validate.closed import ExactReference
from validate.displaced import richardson
from validate.embree import MeshReference
from validate.exactuv import ExactUv
from validate.experiment import Bench, Run, guarded
from validate.views import TEXELS, Hop, framing

SUITE = "truths"
SIZE = 64  # pixels along a side
SHAPES = ("sphere", "torus", "ellipsoid", "cylinder")
BOUNCES = {"torus": (0, 1)}  # the others do not see themselves in their mirror
STEPS = (0.4, 0.2, 0.1, 0.05, 0.025, 0.0125, 0.00625)  # pixels
STEP = 0.05
DIRECTION = (0.35, 0.3, 1.0)
EDGE = 0.06  # of the mesh whose every face is compared with every point
# Of a hit flatter than this the footprint is as long as the picture, and differences of rays are no derivatives.
GRAZING = 0.1

# From rays to their last hits, and the pieces on which texture coordinates are one smooth function: charts, or faces.
Route = Callable[[Beam], tuple[Hop, Int[np.ndarray, " n"]]]


def run(bench: Bench) -> Iterator[Run]:
    """Hold every truth against another."""
    for name in SHAPES:
        reference = ExactReference(shape(name))
        bench.progress(f"truths: {name}")
        for bounces in BOUNCES.get(name, (0,)):
            rays = _camera(reference.shape.bounds, bounces).rays()
            route = partial(_on_shape, reference, bounces)
            for step in STEPS if name == "torus" else (STEP,):
                blank = _blank(f"{name}, {_way(bounces)}", "closed forms", "displaced rays", {"step": step})
                yield guarded(blank, partial(_displaced, blank, route, rays, step))
    bench.progress("truths: meshes")
    torus = MeshReference(mesh("torus", EDGE))
    for bounces in BOUNCES["torus"]:
        rays = _camera(torus.mesh.bounds, bounces).rays()
        blank = _blank(f"mesh of the torus, {_way(bounces)}", "the mesh, by Embree", "displaced rays", {"step": STEP})
        yield guarded(blank, partial(_displaced, blank, partial(_on_mesh, torus, bounces), rays, STEP))
    blank = _blank("mesh of the torus, primary rays", "texture coordinates by face", "the mesh, by Embree", {})
    yield guarded(blank, partial(_by_face, blank, torus, _camera(torus.mesh.bounds, 0).rays()))


def _camera(bounds: Float[np.ndarray, "2 3"], bounces: int) -> Camera:
    """From outside; for mirrored rays from within the hole of the torus, where they meet its other side."""
    if bounces:
        return Camera((0.0, 0.0, 0.2), (0.4, 0.1, -0.05), fov=60.0, size=(SIZE, SIZE))
    return framing(bounds, SIZE, DIRECTION)


def _blank(problem: str, truth: str, against: str, knob: dict[str, float | int]) -> Run:
    return Run(SUITE, problem, {"truth": truth, "against": against}, knob, "error")


def _way(bounces: int) -> str:
    return "one mirror bounce" if bounces else "primary rays"


def _on_shape(reference: ExactReference, bounces: int, rays: Beam) -> tuple[Hop, Int[np.ndarray, " n"]]:
    hits = reference.follow(rays, bounces)[-1]
    return hits, hits.chart


def _on_mesh(reference: MeshReference, bounces: int, rays: Beam) -> tuple[Hop, Int[np.ndarray, " n"]]:
    hops = reference.follow(rays, bounces, "angle")
    # Where a face is left at an earlier hop, the normal bends.
    return hops[-1], hops[0].face * len(reference.mesh.faces) + hops[-1].face


def _displaced(blank: Run, route: Route, rays: Rays, step: float) -> Run:
    """Compare footprints with differences of displaced rays that stay on the same chart, and the same face."""
    hits, piece = route(rays)

    def outputs(dx: float, dy: float) -> Float[np.ndarray, "n 2"]:
        near, beside = route(displace(rays, dx, dy))
        return np.where((np.isfinite(near.t) & (beside == piece))[:, None], near.uv * TEXELS, np.nan)

    truth = richardson(outputs, step)
    jacobian = metrics.footprint(hits.duv_dx, hits.duv_dy, TEXELS)
    bar = np.linalg.norm(np.stack([truth.error_dx, truth.error_dy], axis=2), axis=(1, 2))
    good = np.isfinite(hits.t) & np.isfinite(bar) & _steep(hits, rays)
    size = np.linalg.norm(jacobian[good], axis=(1, 2))
    difference = jacobian[good] - np.stack([truth.d_dx, truth.d_dy], axis=2)[good]
    return replace(blank, values=_values(np.linalg.norm(difference, axis=(1, 2)) / size, bar[good] / size))


def _steep(hits: Hop, rays: Rays) -> Bool[np.ndarray, " n"]:
    """Rays that do not graze, as far as the last hit's normal can say of a ray that came straight."""
    return np.asarray(np.abs(np.sum(hits.n * rays.d, axis=1)) > GRAZING)


def _by_face(blank: Run, reference: MeshReference, rays: Rays) -> Run:
    """Compare the texture coordinates of the closest face with those of the face that Embree named."""
    hits = reference.follow(rays, 0)[-1]
    truth = ExactUv(reference.mesh).at(hits.p[hits.hit])
    difference = np.linalg.norm(truth.uv - hits.uv[hits.hit], axis=1) * TEXELS
    return replace(blank, values=_values(difference, truth.error * TEXELS))


def _values(difference: Float[np.ndarray, " n"], bar: Float[np.ndarray, " n"]) -> dict[str, float]:
    if len(difference) == 0:
        raise ValueError("no ray can be compared")
    found = {"difference": difference, "bar": bar}
    return {f"{name}.{key}": value for name, errors in found.items() for key, value in metrics.summary(errors).items()}
