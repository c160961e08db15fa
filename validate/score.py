"""Footprints that any renderer wrote, against the truth of the scene that they are of.

In: a file (`validate.scorefile`), a scene, and what its assets truly are: exact shapes, or meshes. Out: every footprint
metric. Through exact shapes paths are traced in closed form, mirrors and glass and all; over meshes by Embree, through
mirrors only, and a mirror is as flat as its faces.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int
from rich.console import Console
from rich.table import Table

from datasets_synthetic import shape
from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh
from sdfrender import render
from sdfrender.image import CHANNELS
from sdfrender.materials import Glass, Mirror
from sdfrender.scene import Asset, Film, Scene, load_scene
from validate import metrics
from validate.beam import Beam, only
from validate.compare import compare
from validate.embree import MeshHits, MeshReference
from validate.exact import ShapeField
from validate.experiment import Run
from validate.metrics import FOOTPRINT, UV_ERROR, Metric, Seen, summary
from validate.regions import CLASSES, TITLES
from validate.scorefile import Written, read_written, written
from validate.section import number, percent
from validate.views import TEXELS

RECORDED = ("Z", "P", "N", "uv", "duv_dx", "duv_dy", "chart")


def score(
    file: str | Path, scene: str | Path | Scene, shapes: Sequence[str] = (), meshes: Sequence[str | Path] = ()
) -> Run:
    """Score a file of footprints.

    Parameters
    ----------
    file
        What a renderer wrote: OpenEXR, or a table that ends in .csv.
    scene
        The scene that it is of; its camera's rays go through the middles of pixels, one each.
    shapes, meshes
        Truth: names of exact shapes, or files of meshes with texture coordinates, one for each asset in the scene's
        order; one of the two.

    Returns
    -------
    Run
        Of the suite "scores", with the figures of `validate.compare.compare` in texels of a 1024 x 1024 texture,
        hit errors in world units, and "position_error.SUMMARY", |P - P*| in world units. What the file does not have
        (normals, charts) is left out.

    Raises
    ------
    BadInput
        If the file, the scene or the truth cannot be read, or they do not belong together.

    Examples
    --------
    >>> run = score("torus.exr", "torus.toml", shapes=["torus"])  # doctest: +SKIP
    >>> run.values["lod_error.p50"]  # doctest: +SKIP
    """
    if bool(shapes) == bool(meshes):
        raise BadInput("truth is either exact shapes or meshes: give --shape NAME or --mesh FILE, once for each asset")
    described = scene if isinstance(scene, Scene) else load_scene(scene)
    size = described.film.size
    ours = read_written(file, size)
    single = described.model_copy(update={"film": Film(size=size, outputs=RECORDED)})
    truth = _of_shapes(single, shapes) if shapes else _of_meshes(single, meshes)
    values = judged(ours, truth, described.camera.camera(size).rays(), size)
    names = ", ".join([f"exact {name}" for name in shapes] + [Path(mesh).name for mesh in meshes])
    problem = "scene" if isinstance(scene, Scene) else Path(scene).stem
    return Run("scores", problem, {"file": Path(file).name, "truth": names}, {}, "error", values)


def judged(ours: Written, truth: Written, rays: Beam, size: tuple[int, int]) -> dict[str, float]:
    """Sum up every metric that the file has what is needed for.

    Parameters
    ----------
    ours, truth
        Pixel by pixel, row by row.
    rays
        Of the camera, through the middles of the pixels.
    size
        Width and height.
    """
    lacking = [("normal_angle", ours.n), ("chart_mismatch", ours.chart), ("seam", None)]
    absent = [name for name, values in lacking if values is None]
    # What a file does not have is taken from the truth, so that it weighs nothing; its figures are dropped.
    ours = replace(
        ours, n=truth.n if ours.n is None else ours.n, chart=truth.chart if ours.chart is None else ours.chart
    )
    values = compare(_seen(ours, rays), _seen(truth, rays), (size[1], size[0]))
    both = ours.hit & truth.hit
    away = summary(np.linalg.norm(ours.p[both] - truth.p[both], axis=1))
    values |= {f"position_error.{name}": figure for name, figure in away.items()}
    return {key: value for key, value in values.items() if not any(name in key.split(".") for name in absent)}


def _seen(what: Written, rays: Beam) -> Seen:
    """As the metrics want it: a miss where the path ends on no texture, distances those of the first hit."""
    assert what.n is not None and what.chart is not None
    t = np.sum((what.p - rays.p) * rays.d, axis=1)
    jacobian = metrics.footprint(what.duv_dx, what.duv_dy, TEXELS)
    return Seen(np.where(what.hit, t, np.inf), what.n, what.uv, jacobian, what.chart, texels=TEXELS)


# ---- truth -----------------------------------------------------------------------------------------------------------
def _of_shapes(scene: Scene, names: Sequence[str]) -> Written:
    """Paths over exact shapes, in float64."""
    arrays = render(scene, field=[ShapeField(shape(name)) for name in names])
    return written({part: arrays[name][..., i] for name in RECORDED for i, part in enumerate(CHANNELS[name][0])})


def _of_meshes(scene: Scene, paths: Sequence[str | Path]) -> Written:
    """Paths over meshes: mirrors turn them around, everything else ends them."""
    if any(isinstance(material, Glass) for material in scene.materials):
        raise BadInput("meshes are no truth for glass here: name exact shapes with --shape")
    if len(paths) != len(scene.assets):
        raise BadInput(f"the scene has {len(scene.assets)} assets, and {len(paths)} meshes are given for them")
    meshes = [_placed(Path(path), asset) for path, asset in zip(paths, scene.assets, strict=True)]
    mirrors = np.concatenate(
        [_mirrors(mesh, asset, path) for mesh, asset, path in zip(meshes, scene.assets, paths, strict=True)]
    )
    reference, rays = MeshReference(_joined(meshes)), scene.camera.camera(scene.film.size).rays()
    first, at = reference.transfer(rays)
    ends = _Ends(len(first.t))
    hits, alive = first, np.arange(len(first.t))
    for bounce in range(scene.bounces + 1):
        mirror = hits.hit & mirrors[np.maximum(hits.part, 0)]
        ends.add(hits, alive, np.flatnonzero(hits.hit & ~mirror))
        rows = np.flatnonzero(mirror)
        if bounce == scene.bounces or not len(rows):
            break
        alive, onward = alive[rows], only(reference.reflect(hits, at), rows)
        hits, at = reference.transfer(onward, hits.face[rows])
    p = np.where(first.hit[:, None], first.p, 0.0)
    return Written(p, ends.uv, ends.duv_dx, ends.duv_dy, np.where(first.hit, first.t, 0.0), first.n, ends.chart)


class _Ends:
    """Where paths end: zeros, and chart -1, for those that end nowhere."""

    def __init__(self, count: int) -> None:
        self.uv, self.duv_dx, self.duv_dy = (np.zeros((count, 2)) for _ in range(3))
        self.chart = np.full(count, -1, np.int64)

    def add(self, hits: MeshHits, pixels: Int[np.ndarray, " n"], rows: Int[np.ndarray, " m"]) -> None:
        """Record the hits that end their paths."""
        where = pixels[rows]
        self.uv[where], self.chart[where] = hits.uv[rows], hits.chart[rows]
        self.duv_dx[where], self.duv_dy[where] = hits.duv_dx[rows], hits.duv_dy[rows]


def _placed(path: Path, asset: Asset) -> Mesh:
    """A mesh with texture coordinates, where its asset stands."""
    mesh = Mesh.load(path)
    if mesh.uv is None:
        raise BadInput(f"{path} has no texture coordinates: unwrap it first, by 'python -m sdfbake unwrap'")
    return mesh.with_(vertices=asset.placed().to_world(mesh.vertices))


def _mirrors(mesh: Mesh, asset: Asset, path: str | Path) -> np.ndarray:
    """Which parts are mirrors."""
    given = {material.part: material for material in asset.materials}
    unknown = set(given) - {"*", *mesh.part_names}
    if unknown:
        raise BadInput(f"{path} has no part '{min(unknown)}' that the scene has a material for")
    return np.array([isinstance(given.get(part, given.get("*")), Mirror) for part in mesh.part_names], bool)


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """All meshes as one; vertices, charts and parts are counted on."""

    def counted(arrays: Sequence[np.ndarray], sizes: Sequence[int]) -> np.ndarray:
        begin = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        return np.concatenate([array + first for array, first in zip(arrays, begin, strict=True)])

    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=counted([mesh.faces for mesh in meshes], [len(mesh.vertices) for mesh in meshes]),
        uv=np.concatenate([mesh.uv for mesh in meshes if mesh.uv is not None]),
        chart=counted([mesh.chart for mesh in meshes], [int(mesh.chart.max()) + 1 for mesh in meshes]),
        part=counted([mesh.part for mesh in meshes], [len(mesh.part_names) for mesh in meshes]),
        part_names=tuple(name for mesh in meshes for name in mesh.part_names),
    )


# ---- what a terminal shows -------------------------------------------------------------------------------------------
def show(run: Run, console: Console) -> None:
    """Print the figures as tables."""
    v = run.values
    console.print(f"{run.setup['file']} against {run.setup['truth']}: {v['pixels']:,.0f} pixels", highlight=False)
    shares = [("hit or miss differs", "missed"), ("charts differ", "chart_mismatch")]
    for title, key in shares:
        if key in v:
            console.print(f"{title}: {percent(v[key])}", highlight=False)
    columns = ("mean", "p50", "p95", "p99", "max")
    table = Table("Metric", "unit", *columns)
    for name, title, unit in _rows():
        if f"{name}.p50" in v:
            table.add_row(title, unit, *(number(v[f"{name}.{column}"]) for column in columns))
    console.print(table)
    table = Table("Where", "pixels", "LoD error p50", "p95", "J error p50", "p95")
    for name in CLASSES:
        keys = [f"{name}.{metric}.{column}" for metric in ("lod_error", "jacobian_error") for column in ("p50", "p95")]
        table.add_row(TITLES[name], f"{v[f'{name}.pixels']:,.0f}", *(number(v.get(key)) for key in keys))
    console.print(table)


def _rows() -> list[tuple[str, str, str]]:
    """Name, title and unit of all metrics; distances are in the world's unit here."""

    def row(metric: Metric[Seen]) -> tuple[str, str, str]:
        return metric.name, metric.title, "world unit" if metric is metrics.HIT_ERROR else metric.unit

    return [("position_error", "position error", "world unit"), *(row(metric) for metric in (*FOOTPRINT, UV_ERROR))]
