"""Blender's own simplification of a shader graph: without groups, reroutes, muted nodes, zones, closures and bundles.

Cycles renders the simplified graph from Blender 5.0 on, so that the effect of such nodes need not be computed again
here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import bpy


class Inlined:
    """The simplified tree of `owner`, a material, world or light, with the output node that stands for `output`.

    The nodes exist as long as this object.
    """

    def __init__(self, owner: bpy.types.ID, output: bpy.types.Node) -> None:
        self.output = None  # output node of the simplified tree; None if it has none
        self._tree: Any = None  # owner of the nodes
        if not is_inlinable(owner) or output.id_data != owner.node_tree:
            return
        self._tree = owner.inline_shader_nodes()
        found = self._tree.node_tree.nodes.get(output.name)
        if found is not None and found.bl_idname == output.bl_idname:
            self.output = found


def is_inlinable(owner: bpy.types.ID) -> bool:
    """Whether this Blender simplifies the graphs of `owner`."""
    return hasattr(owner, "inline_shader_nodes")
