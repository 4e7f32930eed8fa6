"""Node trees of materials and worlds, in every Blender that is supported."""

from __future__ import annotations

from typing import TypeVar

import bpy

_Block = TypeVar("_Block", bpy.types.Material, bpy.types.World)


def with_nodes(block: _Block) -> _Block:
    """`block`, a new one, with a node tree, which Blender 5 gives it by itself; there `use_nodes` is deprecated."""
    if bpy.app.version < (5, 0, 0):
        block.use_nodes = True
    return block
