"""Shader graphs as closures and programs. A file a family of nodes; each registers its handlers by `bl_idname`."""

from . import shaders_basic, shaders_diffuse, shaders_facets, shaders_principled  # noqa: F401  (they register their handlers)
from . import gabor, ies, image, inputs, light_falloff, sky, voronoi  # noqa: F401
from . import attributes, natives, normals  # noqa: F401
from . import colours, converters, curves, maths, textures_procedural  # noqa: F401
from .node import Node  # noqa: F401
from .registry import shader, values  # noqa: F401
