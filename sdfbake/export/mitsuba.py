"""A scene file for Mitsuba 3 that shows an exported volume.

In: a lattice and the names of volumes. Out: the `to_world` of Mitsuba's shape and of its volume, and a scene in XML:
the shape as `sdfgrid`, a camera that sees all of it, two lights, and its texture coordinates as colours.
"""

from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float

from sdfbake.lattice import Lattice

_FOV = 30.0  # degrees, of the picture's lower side
_FROM = np.array([0.55, 0.45, 0.7])  # where the camera stands, seen from the shape
_SCENE = """<?xml version="1.0" encoding="utf-8"?>
<!-- mitsuba -m llvm_ad_rgb THIS_FILE -->
<scene version="3.0.0">
    <default name="spp" value="16"/>
    <default name="side" value="512"/>
    <integrator type="direct"/>
    <sensor type="perspective">
        <float name="fov" value="{fov}"/>
        <float name="near_clip" value="{near}"/>
        <float name="far_clip" value="{far}"/>
        <transform name="to_world">
            <lookat origin="{eye}" target="{target}" up="0, 1, 0"/>
        </transform>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width" value="$side"/>
            <integer name="height" value="$side"/>
        </film>
    </sensor>
    <emitter type="constant">
        <rgb name="radiance" value="0.5"/>
    </emitter>
    <emitter type="directional">
        <vector name="direction" value="-1, -2, -1.5"/>
        <rgb name="irradiance" value="1.5"/>
    </emitter>
    <shape type="sdfgrid">
        <string name="filename" value="{volume}"/>
        <string name="normals" value="smooth"/>
        <transform name="to_world">
            <matrix value="{to_world}"/>
        </transform>
        <bsdf type="twosided">
            <bsdf type="diffuse">
                {reflectance}
            </bsdf>
        </bsdf>
    </shape>
</scene>
"""
_GREY = '<rgb name="reflectance" value="0.6"/>'
_COORDINATES = """<!-- Red and green are u and v, blue marks cells that touch several charts. -->
                <texture type="volume" name="reflectance">
                    <volume type="gridvolume" name="volume">
                        <string name="filename" value="{volume}"/>
                        <boolean name="raw" value="true"/>
                        <string name="wrap_mode" value="clamp"/>
                        <transform name="to_world">
                            <matrix value="{to_world}"/>
                        </transform>
                    </volume>
                </texture>"""


def shape_to_world(lattice: Lattice) -> Float[np.ndarray, "4 4"]:
    """Return the map of the unit cube to the box whose corners are the first and the last sample of the cube."""
    return _scaled(lattice, (max(lattice.shape) - 1) * lattice.spacing, 0.0)


def volume_to_world(lattice: Lattice) -> Float[np.ndarray, "4 4"]:
    """Return the map of the unit cube to the box of the cells that have the cube's samples at their centres."""
    return _scaled(lattice, max(lattice.shape) * lattice.spacing, lattice.spacing / 2)


def numbers(values: Float[np.ndarray, "*shape"]) -> str:
    """Return numbers row by row with all their digits."""
    return ", ".join(map(repr, values.reshape(-1).tolist()))


def scene(lattice: Lattice, volume: str, coordinates: str | None) -> str:
    """Return a scene.

    Parameters
    ----------
    lattice
        Of the grid; its longest axis has the samples of the cube's edge.
    volume, coordinates
        Files of the distances and of u, v and the seam mask, beside the scene's own.
    """
    low, high = lattice.bounds
    radius = float(np.linalg.norm(high - low)) / 2
    target = (low + high) / 2
    away = 1.1 * radius / np.sin(np.radians(_FOV) / 2)
    reflectance = _GREY
    if coordinates is not None:
        reflectance = _COORDINATES.format(volume=_quoted(coordinates), to_world=numbers(volume_to_world(lattice)))
    return _SCENE.format(
        fov=_FOV,
        near=repr(float(away - radius) / 2),
        far=repr(float(away + radius) * 2),
        eye=numbers(target + away * _FROM / np.linalg.norm(_FROM)),
        target=numbers(target),
        volume=_quoted(volume),
        to_world=numbers(shape_to_world(lattice)),
        reflectance=reflectance,
    )


def _quoted(name: str) -> str:
    """Return a file's name as XML has it between quotes."""
    return escape(name, {'"': "&quot;"})


def _scaled(lattice: Lattice, edge: float, before: float) -> Float[np.ndarray, "4 4"]:
    """Return the map of the unit cube to one of that edge whose corner lies so far before the first sample."""
    matrix = np.diag([edge, edge, edge, 1.0])
    matrix[:3, 3] = lattice.origin - before
    return matrix
