"""Signed distance grids to footprints and images.

Rays meet the zero set of a grid's interpolant for certain; their differentials go with them through transfer,
reflection and refraction and become footprints on a texture.
"""

from sdfrender.camera import Camera
from sdfrender.field import Field
from sdfrender.flags import Flag
from sdfrender.footprint import nonlinear, nonlinearity
from sdfrender.glass import curvature, fresnel, leaving, refract
from sdfrender.gridfield import GridField
from sdfrender.rays import Rays
from sdfrender.render import render
from sdfrender.scene import Scene, load_scene
from sdfrender.trace import Footprint, Hits, footprint, reflect, trace, transfer

__all__ = [
    "Camera",
    "Field",
    "Flag",
    "Footprint",
    "GridField",
    "Hits",
    "Rays",
    "Scene",
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
