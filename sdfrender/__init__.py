"""Signed distance grids to footprints and images.

Rays meet the zero set of a grid's interpolant for certain; their differentials go with them through transfer,
reflection and refraction and become footprints on a texture.
"""

from sdfrender.assembly import Assembly
from sdfrender.camera import Camera, OrthographicCamera
from sdfrender.field import Field
from sdfrender.flags import Flag
from sdfrender.footprint import nonlinear, nonlinearity
from sdfrender.glass import curvature, fresnel, leaving, refract
from sdfrender.gridfield import GridField
from sdfrender.instance import Instance
from sdfrender.rays import Rays
from sdfrender.render import render
from sdfrender.scene import Scene, load_scene
from sdfrender.similarity import Similarity
from sdfrender.trace import Footprint, Hits, footprint, reflect, trace, transfer

__all__ = [
    "Assembly",
    "Camera",
    "Field",
    "Flag",
    "Footprint",
    "GridField",
    "Hits",
    "Instance",
    "OrthographicCamera",
    "Rays",
    "Scene",
    "Similarity",
    "curvature",
    "footprint",
    "fresnel",
    "leaving",
    "load_scene",
    "nonlinear",
    "nonlinearity",
    "reflect",
    "refract",
    "render",
    "trace",
    "transfer",
]
