"""Shader graphs as closures and programs; each handler of a node is registered by its `bl_idname`."""

from .inputs import attributes, function_nodes, inputs, light_falloff, normals, ray_inputs, strands  # noqa: F401  (they register their handlers)
from .node import Node  # noqa: F401
from .registry import shader, values  # noqa: F401
from .shaders import basic, diffuse, facets, hair, principled, volumes  # noqa: F401  (they register their handlers)
from .textures import gabor, ies, image, procedural, sky, voronoi  # noqa: F401  (they register their handlers)
from .values import colors, converters, curves, maths  # noqa: F401  (they register their handlers)
