"""Our own tracer as one of the renderers.

In: a grid asset and a view. Out: first hits; with normal, Hessian and the mirrored ray's hit; with footprints and
filtered colours where the path ends.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import atan, degrees

import numpy as np

from sdfbake.engine import Array, Engine, choose
from sdfbake.engine.tree import leaves, rebuild
from sdfbake.grid import Grid
from sdfbake.metadata import tool_version
from sdfrender import Camera, GridField, optics
from sdfrender.field import Spot
from sdfrender.footprint import derivatives
from sdfrender.rays import Beam
from sdfrender.sampler import Sampler
from sdfrender.texture import Texture
from sdfrender.trace import mirrored, transferred
from sdfrender.vector import Symmetric, Vector, zero
from validate.peers.frames import EVERYTHING, MIRROR, PRIMARY, Renderer, View, serve

TEXELS = 512  # along a side of the texture


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    """What a frame is traced in."""

    field: GridField
    camera: Camera
    sampler: Sampler


def _read(samples: str) -> Grid:
    return Grid.load(f"{samples}.zarr.zip")


def _prepare(grid: Grid, view: View, options: Mapping[str, str]) -> _Prepared:
    choice = choose(options["engine"], int(options["precision"]))
    x, y, z = view.eye
    camera = Camera(view.eye, (x, y, z - 1), fov=2 * degrees(atan(view.slope)), size=(view.pixels, view.pixels))
    noise = np.random.default_rng(1).uniform(size=(TEXELS, TEXELS, 3)).astype(np.float32)
    sampler = Sampler(choice.engine, Texture.of(noise), "trilinear", "repeat")
    field = GridField(grid, options["kernel"], choice)
    field.prepare_uv()
    return _Prepared(field, camera, sampler)


def _frame(given: _Prepared, job: str) -> dict[str, Array]:
    """Run a program and leave its arrays with the engine."""
    engine, count = given.field.engine, given.camera.size[0] * given.camera.size[1]
    program = partial(JOBS[job], given)
    if engine.name == "numpy":  # its arrays are NumPy's; `run` spreads tiles of rays over the cores
        return dict(engine.run(lambda xp, lane: program(xp, lane), [np.arange(count)]))
    found = dict(program(engine, engine.lanes(count)))
    engine.settled(*found.values())
    found["t"][0]  # reading one number waits for all of them
    return found


def _beam(given: _Prepared, xp: Engine, lane: Array) -> Beam:
    width = xp.uniform(given.camera.size[0])
    row = lane // width
    return given.camera.beam(xp, xp.real(lane - row * width) + 0.5, xp.real(row) + 0.5, given.field.anchor)


def _primary(given: _Prepared, xp: Engine, lane: Array) -> dict[str, Array]:
    """First hits alone."""
    ray = _beam(given, xp, lane)
    spot = given.field.first_hit(xp, ray.p, ray.d, xp.full(ray.d[0], True))
    return {"t": spot.t, "hit": spot.hit}


def _mirror(given: _Prepared, xp: Engine, lane: Array) -> dict[str, Array]:
    """First hits with normal and Hessian, and the hits of the mirrored rays."""
    field, ray = given.field, _beam(given, xp, lane)
    first = field.first_hit(xp, ray.p, ray.d, xp.full(ray.d[0], True))
    nothing = zero(xp, first.t)

    def bent(state: tuple[Spot, Vector, Vector, Symmetric]) -> tuple[Spot, Vector, Vector, Symmetric]:
        spot, d, *_ = state
        jet = field.jet_at(xp, spot, 2)
        assert jet.hessian is not None
        n = optics.normal(xp, jet)
        return spot, optics.reflected(d, n), n, jet.hessian

    _, d, n, hessian = xp.among(first.hit, bent, (first, ray.d, nothing, Symmetric(*nothing, *nothing)))
    second = field.first_hit(xp, first.p, d, first.hit, first)
    curved = {f"h{i}": entry for i, entry in enumerate(hessian)} | {f"n{a}": n[a] for a in range(3)}
    return {"t": first.t, "hit": first.hit, "t2": second.t, "hit2": second.hit, **curved}


def _everything(given: _Prepared, xp: Engine, lane: Array) -> dict[str, Array]:
    """The mirror with differentials all the way, and a filtered colour at the last surface that the path met."""
    field, ray = given.field, _beam(given, xp, lane)
    nothing = xp.full(ray.d[0], 0.0)

    def arrive(state: tuple[Spot, Beam, Beam]) -> tuple[Spot, Beam, Beam]:
        spot, beam, _ = state
        jet = field.jet_at(xp, spot, 2)
        arrived = transferred(xp, beam, jet, spot, xp.full(spot.t, 0.0))
        return spot, arrived, mirrored(xp, arrived, jet, spot.hit)

    def again(state: tuple[Spot, Beam]) -> tuple[Spot, Beam]:
        spot, beam = state
        return spot, transferred(xp, beam, field.jet_at(xp, spot, 1), spot, xp.full(spot.t, 0.0))

    def shown(state: tuple[Spot, Beam, tuple[Array, ...]]) -> tuple[Spot, Beam, tuple[Array, ...]]:
        spot, beam, _ = state
        mapped = field.uv_at(xp, spot, None)  # `grid`, the mode of exact shapes, asks for no normal
        footprint = derivatives(mapped, beam)
        look = given.sampler.look_up(xp, mapped.u, mapped.v, footprint, spot.hit)
        return spot, beam, (*look.colour, *footprint[0], *footprint[1])

    first = field.first_hit(xp, ray.p, ray.d, xp.full(nothing, True))
    _, arrived, sent = xp.among(first.hit, arrive, (first, ray, ray))
    second = field.first_hit(xp, first.p, sent.d, first.hit, first)
    _, onward = xp.among(second.hit, again, (second, sent))
    pairs = zip(leaves((second, onward)), leaves((first, arrived)), strict=True)
    last = rebuild((first, arrived), [xp.where(second.hit, new, old) for new, old in pairs])
    *_, seen = xp.among(first.hit, shown, (*last, (nothing,) * 7))
    named = {f"c{i}": value for i, value in enumerate(seen[:3])} | {f"j{i}": value for i, value in enumerate(seen[3:])}
    return {"t": first.t, "hit": first.hit, "t2": second.t, "hit2": second.hit, **named}


JOBS: dict[str, Callable[[_Prepared, Engine, Array], dict[str, Array]]] = {
    PRIMARY: _primary,
    MIRROR: _mirror,
    EVERYTHING: _everything,
}


def _look(found: dict[str, Array]) -> dict[str, np.ndarray]:
    pairs = {"t": "hit", "t2": "hit2"}
    arrays = {t: np.where(np.array(found[hit]), np.array(found[t]), np.inf) for t, hit in pairs.items() if t in found}
    return arrays | {name: np.array(values) for name, values in found.items() if name[0] in "cj"}


if __name__ == "__main__":
    serve(lambda: Renderer(tool_version(), _read, _prepare, _frame, _look))
