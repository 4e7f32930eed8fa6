"""All trees of a scene on the device, as the tracers see them.

A *mesh tree* is one block of nodes and one block of triangles (layouts: `node.py`), whose indices are relative to the
block's first. An *entry* is one mesh tree in its place; the *top level* is a tree over the boxes of the entries. Where
a scene has no instancing there is one entry, in world space, and no top level.
"""

from __future__ import annotations

import warp as wp

from ..scene.geometry import mat34


@wp.struct
class Tree:
    """Device side. Blocks lie one after another, the top level's nodes among them."""

    nodes: wp.array(dtype=wp.vec4)  # 64-byte aligned
    triangles: wp.array(dtype=wp.vec4)  # 64-byte aligned
    # by entry
    entry_node: wp.array(dtype=int)  # first node of the entry's mesh tree
    entry_triangle: wp.array(dtype=int)  # its first triangle, or first group of triangles (BOXES)
    entry_centre: wp.array(dtype=wp.vec3)  # its boxes are relative to this point of object space [m]
    entry_from_world: wp.array(dtype=mat34)  # object-space rays, the direction not normalised
    entry_instance: wp.array(dtype=int)  # instance id, or -1: baked instances that share one tree
    entry_visibility: wp.array(dtype=int)
    merged_first: wp.array(dtype=int)  # first of an entry's baked instances in the next two, shape [entry_count + 1]
    merged_instance: wp.array(dtype=int)
    merged_triangle_first: wp.array(dtype=int)
    # top level
    top_node: int  # its first node
    top_entry: wp.array(dtype=int)  # what its leaves list, shape [entry_count]
    top_centre: wp.vec3
    top_margin: float  # as `SLAB_MARGIN`, for rays against the boxes of entries
    entry_count: int
