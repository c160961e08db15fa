"""The web page of a grid against our renderer: the same camera, light and texture, pixel by pixel.

In: a grid file and a Chromium. Out: `compare`'s figures: how far hits, normals, texture coordinates and colours lie
apart, and what the page complained about or asked the network for.
"""

import base64
import json
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from datasets_synthetic.texture import save_texture
from sdfbake.export.texture import channels
from sdfbake.grid import Grid
from sdfbake.gridfile import describe
from sdfbake.view import view
from sdfrender.render import render
from sdfrender.scene import Scene
from sdfrender.texture import linear_to_srgb
from validate.browser import Browser

SIZE = (256, 256)
OFF_EDGE = 0.2  # of a normal against the ray: pixels nearer to the silhouette may hit another part of the surface
_FIELD, _TURN, _RISE = 32.0, 0.55, 0.32  # degrees; radians: the page's own first view
_OUTPUTS = ("rgb", "Z", "N", "uv", "lod", "chart", "flags")


class Seen(NamedTuple):
    """What was seen of a grid: by the page or by the renderer.

    Attributes
    ----------
    normal
        Outward unit normals, (h, w, 3).
    t
        Distance, voxels; 0 for a miss.
    uv
        Texture coordinates, (h, w, 2).
    lod
        Level of detail.
    chart
        -1 for none.
    colour
        sRGB, 0 to 255.
    """

    normal: Float[np.ndarray, "h w 3"]
    t: Float[np.ndarray, "h w"]
    uv: Float[np.ndarray, "h w 2"]
    lod: Float[np.ndarray, "h w"]
    chart: Float[np.ndarray, "h w"]
    colour: Float[np.ndarray, "h w 3"]


def compare(grid: str | Path, chromium: str, kernel: str = "bspline", size: tuple[int, int] = SIZE) -> dict[str, float]:
    """Draw a grid in the page of a new browser and by the renderer; see `compare_in`.

    Parameters
    ----------
    grid, kernel, size
        As for `compare_in`.
    chromium
        The browser; see `validate.browser.found`.
    """
    with Browser(chromium) as browser:
        return compare_in(browser, grid, kernel, size)


def compare_in(
    browser: Browser, grid: str | Path, kernel: str = "bspline", size: tuple[int, int] = SIZE
) -> dict[str, float]:
    """Draw a grid in the page and by the renderer, and return how far they are apart.

    Parameters
    ----------
    browser
        A running browser.
    grid
        A grid file with texture coordinates.
    kernel
        Of both.
    size
        Width and height, pixels.

    Returns
    -------
    figures
        `hits`, pixels both hit; `missed_share`, pixels only one hits, of all hits; `t_mean`, `t_max`, voxels, and
        `normal_mean`, `normal_max`, degrees, both where the surface is not seen edge-on, and `t_p99`, `normal_p99`
        likewise; `uv_mean`, `uv_p99`, texels of the texture, where both see the same chart; `lod_mean`, `lod_p99`,
        levels; `chart_share`, hits of another chart; `colour_mean`, `colour_max`, of 255, over pixels both hit;
        `inner_mean`, `inner_max`, the same where the charts agree and the surface is not seen edge-on; `colour_share`,
        hits whose colour differs by more than 8; `complaints`, `requests` of the page; `bytes`; `load`, seconds;
        `frame`, milliseconds.
    """
    grid = Path(grid).resolve()
    with tempfile.TemporaryDirectory(prefix="viewer-") as folder:
        texture, page = Path(folder) / "texture.png", Path(folder) / "viewer.html"
        save_texture("checker", texture)
        loaded = Grid.load(grid, channels(describe(grid).uv_modes))
        written = view(loaded, page, texture=texture, title=grid.name)
        before, begin = (len(browser.complaints), len(browser.requests)), time.perf_counter()
        browser.open(page, (64, 64))
        head = browser.evaluate("viewer.ready.then((ready) => ready.head)")
        load = time.perf_counter() - begin
        camera = {**_camera(head), "size": list(size), "kernel": kernel}
        answer = browser.evaluate(f"viewer.probe({json.dumps(camera)})")
        heard = {
            "complaints": float(len(browser.complaints) - before[0]),
            "requests": float(len(browser.requests) - before[1]),
        }
        ours = _rendered(grid, texture, camera, answer["lights"], loaded.lattice.spacing)
    costs = {"bytes": written.size, "load": load, "frame": float(answer["milliseconds"])}
    return _figures(_shown(answer), ours, camera) | heard | costs


def _camera(head: dict[str, Any]) -> dict[str, Any]:
    """Return the page's first view of a square picture."""
    distance = 1.06 * head["radius"] / np.sin(np.radians(_FIELD) / 2)
    back = np.array([np.cos(_RISE) * np.sin(_TURN), np.sin(_RISE), np.cos(_RISE) * np.cos(_TURN)])
    origin = (np.array(head["centre"]) + distance * back).tolist()
    return {"origin": origin, "target": head["centre"], "up": [0, 1, 0], "fov": _FIELD}


def _shown(answer: dict[str, Any]) -> Seen:
    """Return the page's arrays."""
    width, height = answer["size"]

    def array(name: str, kind: str) -> Float[np.ndarray, "h w 4"]:
        values = np.frombuffer(base64.b64decode(answer[name]), kind).reshape(height, width, 4)
        return values.astype(np.float64)

    normal, uv, colour = array("normal", "<f4"), array("uv", "<f4"), array("colour", "u1")
    return Seen(normal[..., :3], normal[..., 3], uv[..., :2], uv[..., 2], uv[..., 3], colour[..., :3])


def _rendered(grid: Path, texture: Path, camera: dict[str, Any], lights: list[dict[str, Any]], spacing: float) -> Seen:
    """Render the same by our renderer."""
    scene = Scene.model_validate(
        {
            "camera": {"position": camera["origin"], **{key: camera[key] for key in ("target", "up", "fov")}},
            "film": {"size": camera["size"], "outputs": _OUTPUTS},
            "trace": {"kernel": camera["kernel"]},
            "textures": [{"name": "checker", "type": "image", "image": texture, "filter": "trilinear"}],
            "lights": [
                {
                    "type": "directional",
                    "direction": [-c for c in light["toward"]],
                    "irradiance": light["irradiance"],
                    "shadows": False,
                }
                for light in lights
            ],
            "assets": [{"grid": grid, "materials": [{"type": "diffuse", "texture": "checker"}]}],
        }
    )
    out = render(scene)
    colour = np.rint(255 * linear_to_srgb(out["rgb"].clip(0, 1)))
    flat = {name: out[name][..., 0] for name in ("Z", "lod", "chart")}
    return Seen(out["N"], flat["Z"] / spacing, out["uv"], flat["lod"], flat["chart"], colour)


def _figures(page: Seen, ours: Seen, camera: dict[str, Any], texels: float = 1024.0) -> dict[str, float]:
    """Return the differences."""
    hit, mine = page.t > 0, ours.t > 0
    both = hit & mine
    face_on = both & (np.abs(_cosine(ours.normal, camera)) > OFF_EDGE)
    alike = face_on & (page.chart == ours.chart)
    sine = np.linalg.norm(np.cross(page.normal, ours.normal), axis=-1)
    angle = np.degrees(np.arctan2(sine, (page.normal * ours.normal).sum(axis=-1)))
    colour = np.abs(page.colour - ours.colour).max(axis=-1)
    uv = texels * np.abs(page.uv - ours.uv).max(axis=-1)
    figures = {
        "hits": float(both.sum()),
        "missed_share": float((hit != mine).sum() / max(both.sum(), 1)),
        "chart_share": float((both & (page.chart != ours.chart)).sum() / max(both.sum(), 1)),
        "colour_share": float((colour[both] > 8).mean()),
    }
    figures |= _summary("t", np.abs(page.t - ours.t)[face_on]) | _summary("normal", angle[face_on])
    figures |= _summary("uv", uv[alike]) | _summary("lod", np.abs(page.lod - ours.lod)[alike])
    return figures | _summary("colour", colour[both]) | _summary("inner", colour[alike])


def _cosine(normal: Float[np.ndarray, "h w 3"], camera: dict[str, Any]) -> Float[np.ndarray, "h w"]:
    """Return the cosine between normals and the line of sight; in the picture's middle it is exact."""
    along = np.subtract(camera["target"], camera["origin"])
    cosine: Float[np.ndarray, "h w"] = normal @ (along / np.linalg.norm(along))
    return cosine


def _summary(name: str, values: Float[np.ndarray, " n"]) -> dict[str, float]:
    """Return mean, 99th percentile and greatest."""
    if len(values) == 0:
        return {f"{name}_{what}": 0.0 for what in ("mean", "p99", "max")}
    return {
        f"{name}_mean": float(values.mean()),
        f"{name}_p99": float(np.quantile(values, 0.99)),
        f"{name}_max": float(values.max()),
    }
