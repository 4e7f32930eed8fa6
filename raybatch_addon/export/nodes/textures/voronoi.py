"""Voronoi Texture."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.textures.voronoi.cells import CHEBYCHEV, EUCLIDEAN, MANHATTAN, MINKOWSKI
from ....core.programs.ops.textures.voronoi.ops import op_name
from ..node import Node
from ..registry import values
from .mapping import texture_coordinates

_METRICS = {"EUCLIDEAN": EUCLIDEAN, "MANHATTAN": MANHATTAN, "CHEBYCHEV": CHEBYCHEV, "MINKOWSKI": MINKOWSKI}
# Inputs in the order of the ops' operands; unused ones are disabled sockets, whatever is linked to them
_NUMBERS = ("W", "Scale", "Detail", "Roughness", "Lacunarity", "Smoothness", "Exponent", "Randomness")


@values("ShaderNodeTexVoronoi", family="Textures")
def voronoi(node: Node) -> dict[str, Value]:
    """Distance, colour and position of a cell's point, or one number."""
    settings = node.node
    dimensions = int(settings.voronoi_dimensions[0])
    feature = settings.feature.lower()
    coordinates = texture_coordinates(node) if dimensions > 1 else node.constant((0.0, 0.0, 0.0))
    numbers = [node.number(name) if node.socket(name).enabled else node.constant(0.0) for name in _NUMBERS]
    outputs = node.op(
        op_name(dimensions, feature), _METRICS[settings.distance], settings.normalize, coordinates, *numbers
    )
    if feature == "distance_to_edge":
        return {"Distance": outputs}
    if feature == "n_sphere_radius":
        return {"Radius": outputs}
    return dict(zip(("Distance", "Color", "Position", "W"), outputs))
