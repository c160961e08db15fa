"""Textures: what a material asks for its colour.

The parts: `picture` reads files, `pyramid` builds levels, `texels` puts them on an engine, `sampler` filters by
`anisotropic` and by levels, `procedural` needs no texels. All are asked by `look_up(xp, u, v, footprint, active)`.
"""

from sdfrender.picture import linear_to_srgb, srgb_to_linear
from sdfrender.procedural import Checker
from sdfrender.pyramid import Texture
from sdfrender.sampler import Sampler
from sdfrender.texels import Look

Lookup = Sampler | Checker

__all__ = ["Checker", "Look", "Lookup", "Sampler", "Texture", "linear_to_srgb", "srgb_to_linear"]
