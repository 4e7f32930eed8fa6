"""Gabor Texture."""

from __future__ import annotations

from ...core.shading.nodes.builder import Value
from .node import Node
from .registry import values
from .texture_mapping import texture_coordinates


@values("ShaderNodeTexGabor", family="Textures")
def gabor(node: Node) -> dict[str, Value]:
    """Value, phase and intensity."""
    place = texture_coordinates(node)
    numbers = [node.number(name) for name in ("Scale", "Frequency", "Anisotropy")]
    if node.node.gabor_type == "3D":
        outputs = node.op("gabor_3d", place, *numbers, node.vector("Orientation 3D"))
    else:
        outputs = node.op("gabor_2d", place, *numbers, node.number("Orientation 2D"))
    return dict(zip(("Value", "Phase", "Intensity"), outputs))
