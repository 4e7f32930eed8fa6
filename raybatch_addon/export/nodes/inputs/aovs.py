"""AOV Output nodes: values that a material writes to passes of the view layer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..node import Graph, Node

if TYPE_CHECKING:
    import bpy


def write_aovs(graph: Graph, tree: bpy.types.NodeTree) -> None:
    """Add what the AOV Output nodes of `tree` write, before any closure."""
    for found in tree.nodes:
        if found.bl_idname != "ShaderNodeOutputAOV" or found.mute:
            continue
        number = graph.collections.aov(found.aov_name)
        if number < 0:
            continue
        node = Node(graph, found)
        is_number = number % 2 == 1
        value = node.as_vector(node.number("Value")) if is_number else node.color("Color")
        node.closure("aov", value, number // 2)
