"""Coordinates of a texture node: linked or generated ones, moved by the node's own mapping."""

from __future__ import annotations

import numpy as np

from ....core.programs.builder import Value
from ..graph import AXES
from ..node import Node

_INVERTED = ("TEXTURE", "NORMAL")
SCALE_LEAST = 1e-5  # least scale of mappings that are inverted


def texture_coordinates(node: Node) -> Value:
    """The vector input of a texture node, after the mapping in its properties."""
    return mapped(node, node.vector("Vector") if node.linked("Vector") else node.coordinates())


def mapped(node: Node, coordinates: Value) -> Value:
    """`coordinates` after the mapping in the properties of a texture node (which is seldom set)."""
    if is_unmapped(node):
        return coordinates
    mapping = node.node.texture_mapping
    matrix, offset = affine_of(mapping)
    return node.op("affine", mapping.vector_type == "NORMAL", coordinates, *map(tuple, matrix), tuple(offset))


def is_unmapped(node: Node) -> bool:
    """Whether the mapping in the properties of a texture node leaves coordinates as they are."""
    matrix, offset = affine_of(node.node.texture_mapping)
    return np.array_equal(matrix, np.eye(3)) and not offset.any()


def affine_of(mapping) -> tuple[np.ndarray, np.ndarray]:
    """Matrix [3, 3] and offset [3] of Blender's texture mapping; its limits (min, max) are ignored, as in Cycles."""
    scale = np.array(mapping.scale, float)
    if mapping.vector_type in _INVERTED:
        scale = np.where(np.abs(scale) < SCALE_LEAST, np.copysign(SCALE_LEAST, scale), scale)
    matrix = _rotation(mapping.rotation) * scale
    offset = np.array(mapping.translation, float) if mapping.vector_type in ("POINT", "TEXTURE") else np.zeros(3)
    if mapping.vector_type == "TEXTURE":
        matrix = np.linalg.inv(matrix)
        offset = -matrix @ offset
    if mapping.vector_type == "NORMAL":
        matrix = np.linalg.inv(matrix).T
    axes = np.zeros((3, 3))
    for row, axis in enumerate((mapping.mapping_x, mapping.mapping_y, mapping.mapping_z)):
        if axis != "NONE":
            axes[row, AXES[axis]] = 1.0
    return matrix @ axes, offset


def _rotation(angles) -> np.ndarray:
    """Matrix [3, 3] that turns about x, then y, then z [rad]."""
    turned = np.eye(3)
    for axis, angle in enumerate(angles):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[[a, b], [a, b]] = np.cos(angle)
        turn[a, b], turn[b, a] = -np.sin(angle), np.sin(angle)
        turned = turn @ turned
    return turned
