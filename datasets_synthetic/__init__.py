"""Shapes with closed-form answers, their meshes, textures and scenes.

In: a name. Out: an exact shape, a mesh, or a texture.
"""

from datasets_synthetic.registry import exact_names, mesh, names, shape
from datasets_synthetic.shape import ExactShape
from datasets_synthetic.texture import save_texture, texture, textures

__all__ = ["ExactShape", "exact_names", "mesh", "names", "save_texture", "shape", "texture", "textures"]
