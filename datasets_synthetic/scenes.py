"""Scenes as TOML: the figures of Galim 2018, pictures of shapes, and of glass, lights and an environment.

In: a name. Out: the text of a scene file whose paths expect `scenes/`, `grids/` and `textures/` side by side.

The report's scene: a mirror sphere in front of the camera, a page of text behind it, visible in the mirror only. Its
"cubic" is the Catmull-Rom spline of its eq. 21, and its texture coordinates are interpolated (eq. 22): uv = "grid". The
captions of its figures 6 and 7 are swapped against its text; here figure 6 is the grid of 512 and figure 7 that of 64,
as the text has it.
"""

from dataclasses import dataclass

from sdfbake.complaint import BadInput


@dataclass(frozen=True, slots=True)
class Variant:
    """One picture: which grid, which template, and what differs."""

    template: str
    grid: str
    kernel: str = "bspline"
    filter: str = "trilinear"
    supersample: int = 1


_MIRROR = """\
# A mirror sphere; behind the camera a page of text that only the mirror shows (Galim 2018, figures 5 to 8).
background = [0.18, 0.2, 0.24]

[camera]
position = [0.0, 0.0, 1.9]
target = [0.0, 0.0, 0.0]
fov = 53.13

[film]
size = [512, 512]
supersample = {supersample}
outputs = ["rgb"]

[trace]
kernel = "{kernel}"
bounces = 1

[[textures]]
name = "page"
image = "../textures/page.png"
filter = "{filter}"
wrap = "clamp"

[[assets]]
grid = "../grids/{grid}.zarr.zip"
uv = "grid"
materials = [
    {{ type = "mirror", part = "sphere", colour = [0.85, 0.9, 0.95] }},
    {{ type = "diffuse", part = "sheet", texture = "page" }},
]
"""

_NORMALS = """\
# A sphere coloured by its normals: what the kernel makes of a coarse grid (Galim 2018, figure 4).
background = [0.05, 0.05, 0.06]

[camera]
position = [0.0, 0.0, 3.0]
target = [0.0, 0.0, 0.0]
fov = 35.0

[film]
size = [512, 512]
supersample = {supersample}
outputs = ["rgb"]

[trace]
kernel = "{kernel}"

[[assets]]
grid = "../grids/{grid}.zarr.zip"
materials = [{{ type = "normals" }}]
"""

_TEXTURED = """\
# A textured object, with the footprints that filter its texture.
background = [0.05, 0.05, 0.06]

[camera]
position = {position}
target = {target}
fov = 40.0

[film]
size = [512, 512]
supersample = {supersample}
outputs = ["rgb", "Z", "P", "N", "uv", "duv_dx", "duv_dy", "lod", "flags"]

[trace]
kernel = "{kernel}"

[[textures]]
name = "checker"
image = "../textures/checker.png"
filter = "{filter}"
wrap = "repeat"

[[assets]]
grid = "../grids/{grid}.zarr.zip"
materials = [{{ type = "diffuse", texture = "checker" }}]
"""

_GLASS = """\
# A ball of glass, a mirror and a checkered ball on a page of text, under a sky with a sun.
[camera]
position = [0.0, 1.3, 4.2]
target = [0.0, -0.1, 0.0]
fov = 40.0

[film]
size = [768, 480]
supersample = {supersample}
outputs = ["rgb"]

[trace]
kernel = "{kernel}"
bounces = 8
splits = 2

[environment]
image = "../textures/sky.exr"

[[lights]]
type = "directional"
direction = [-0.48, -0.64, -0.6]
irradiance = [2.5, 2.3, 2.0]

[[textures]]
name = "page"
image = "../textures/page.png"
filter = "{filter}"

[[textures]]
name = "squares"
type = "checker"
squares = [12, 12]

[[assets]]
grid = "../grids/exact-sphere@64.zarr.zip"
translate = [-1.0, 0.0, 0.3]
materials = [{{ type = "glass", index = 1.5 }}]

[[assets]]
grid = "../grids/exact-sphere@64.zarr.zip"
translate = [1.0, 0.0, -0.3]
materials = [{{ type = "mirror", colour = [0.95, 0.8, 0.5] }}]

[[assets]]
grid = "../grids/exact-sphere@64.zarr.zip"
scale = 0.4
translate = [0.25, -0.48, 1.0]
materials = [{{ type = "diffuse", texture = "squares" }}]

[[assets]]
grid = "../grids/exact-sheet@128.zarr.zip"
scale = 2.2
rotate = [1, 0, 0, -90]
translate = [0.0, -0.8, 0.0]
materials = [{{ type = "diffuse", texture = "page" }}]
"""

_ENVIRONMENT = """\
# A mirror torus in a sky, without perspective: every reflection is filtered by the ray's own differential.
[camera]
type = "orthographic"
position = [0.0, 2.2, 2.6]
target = [0.0, 0.0, 0.0]
height = 2.6

[film]
size = [512, 512]
supersample = {supersample}
outputs = ["rgb", "N", "curvature", "flags"]

[trace]
kernel = "{kernel}"
bounces = 6

[environment]
image = "../textures/sky.exr"
filter = "{filter}"

[[assets]]
grid = "../grids/{grid}.zarr.zip"
materials = [{{ type = "mirror" }}]
"""

_LIGHTS = """\
# The bunny on a page of text, lit by a lamp and by a sun, both with hard shadows.
background = [0.05, 0.05, 0.06]

[camera]
position = [0.75, 0.55, 1.35]
target = [0.31, 0.2, 0.31]
fov = 40.0

[film]
size = [512, 512]
supersample = {supersample}
outputs = ["rgb"]

[trace]
kernel = "{kernel}"

[[lights]]
type = "point"
position = [0.9, 0.9, 0.9]
intensity = [2.0, 1.7, 1.2]

[[lights]]
type = "directional"
direction = [0.6, -0.7, -0.5]
irradiance = [1.2, 1.3, 1.6]

[[textures]]
name = "page"
image = "../textures/page.png"
filter = "{filter}"

[[assets]]
grid = "../grids/{grid}.zarr.zip"
materials = [{{ type = "diffuse", colour = [0.9, 0.8, 0.7] }}]

[[assets]]
grid = "../grids/exact-sheet@128.zarr.zip"
scale = 0.8
rotate = [1, 0, 0, -90]
translate = [0.31, 0.0, 0.31]
materials = [{{ type = "diffuse", texture = "page" }}]
"""

_TEMPLATES = {
    "mirror": _MIRROR,
    "normals": _NORMALS,
    "textured": _TEXTURED,
    "glass": _GLASS,
    "environment": _ENVIRONMENT,
    "lights": _LIGHTS,
}
_OPTICS = {
    "glass": Variant("glass", "exact-sphere@64", filter="anisotropic", supersample=2),
    "environment": Variant("environment", "exact-torus@64", filter="anisotropic", supersample=2),
    "lights": Variant("lights", "bunny@512", filter="anisotropic", supersample=2),
}
_VIEWS = {
    "torus": ("[0.0, 2.2, 2.6]", "[0.0, 0.0, 0.0]"),
    "bunny": ("[0.58, 0.42, 1.45]", "[0.31, 0.24, 0.31]"),
}

_FIGURES = {
    "figure-4-linear": Variant("normals", "sphere@16", "linear"),
    "figure-4-cubic": Variant("normals", "sphere@16", "catmull-rom"),
    "figure-5": Variant("mirror", "mirror@512", "catmull-rom", filter="bilinear"),
    "figure-6-linear": Variant("mirror", "mirror@512", "linear"),
    "figure-6-cubic": Variant("mirror", "mirror@512", "catmull-rom"),
    "figure-7-linear": Variant("mirror", "mirror@64", "linear"),
    "figure-7-cubic": Variant("mirror", "mirror@64", "catmull-rom"),
    "figure-7-bspline": Variant("mirror", "mirror@64", "bspline"),
    "figure-8": Variant("mirror", "mirror@512", "catmull-rom", supersample=2),
}


def _variants() -> dict[str, Variant]:
    """Return every scene: the figures on grids of the exact shapes, their baked twins, the references, the shapes."""
    exact = {name: _on(variant, f"exact-{variant.grid}") for name, variant in _FIGURES.items()}
    baked = {f"{name}-baked": variant for name, variant in _FIGURES.items()}
    references = {
        "reference": Variant("mirror", "exact-mirror@512", filter="bilinear", supersample=8),
        "figure-4-reference": Variant("normals", "exact-sphere@16", supersample=8),
    }
    shapes = {name: Variant("textured", f"{name}@512") for name in _VIEWS}
    return {**exact, **baked, **references, **shapes, **_OPTICS}


def _on(variant: Variant, grid: str) -> Variant:
    return Variant(variant.template, grid, variant.kernel, variant.filter, variant.supersample)


def scene_names() -> list[str]:
    """Return the names of all scenes."""
    return list(_variants())


def scene(name: str) -> str:
    """Return a scene's TOML text.

    Raises
    ------
    BadInput
        For an unknown name.
    """
    variants = _variants()
    if name not in variants:
        raise BadInput(f"there is no scene '{name}': choose one of {', '.join(variants)}")
    variant = variants[name]
    position, target = _VIEWS.get(name, ("", ""))
    return _TEMPLATES[variant.template].format(
        grid=variant.grid,
        kernel=variant.kernel,
        filter=variant.filter,
        supersample=variant.supersample,
        position=position,
        target=target,
    )
