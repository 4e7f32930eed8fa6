"""Gabor Texture."""

from __future__ import annotations

from ....core.programs.builder import Value
from ..node import Node
from ..registry import values
from .mapping import texture_coordinates


@values("ShaderNodeTexGabor", family="Textures")
def gabor(node: Node) -> dict[str, Value]:
    """Value, phase and intensity of Gabor noise."""
    coordinates = texture_coordinates(node)
    numbers = [node.number(name) for name in ("Scale", "Frequency", "Anisotropy")]
    if node.node.gabor_type == "3D":
        outputs = node.op("gabor_3d", coordinates, *numbers, node.vector("Orientation 3D"))
    else:
        outputs = node.op("gabor_2d", coordinates, *numbers, node.number("Orientation 2D"))
    return dict(zip(("Value", "Phase", "Intensity"), outputs))
