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
    # by entry; one whose mesh tree has nodes for each of some ranges of time is there once for each of these
    entry_node: wp.array(dtype=int)  # first node of the entry's mesh tree
    entry_triangle: wp.array(dtype=int)  # its first triangle, or first group of triangles (BOXES)
    entry_centre: wp.array(dtype=wp.vec3)  # its boxes are relative to this point of object space [m]
    entry_from_world: wp.array(dtype=mat34)  # object-space rays, the direction not normalised
    entry_instance: wp.array(dtype=int)  # instance id, or -1: baked instances that share one tree
    entry_visibility: wp.array(dtype=int)
    merged_first: wp.array(dtype=int)  # first of an entry's baked instances in the next two, shape [entry_count + 1]
    merged_instance: wp.array(dtype=int)
    merged_triangle_first: wp.array(dtype=int)
    # what moves; no entries where nothing does
    entry_motion: wp.array(dtype=int)  # row of an entry's keys in the next; -1: it stays where it is
    motion_keys: wp.array(dtype=float)  # `motion_keys` of what moves, shape [rows * steps * KEY_FLOATS]
    motion_steps: int
    # by entry: triangles, or groups of them, of one step of its vertices: those of all steps lie one behind another.
    # 0: they do not deform. Of trees that are cut, of those above treelets
    entry_deform: wp.array(dtype=int)
    deform_steps: int
    # top level
    top_node: int  # its first node
    top_entry: wp.array(dtype=int)  # what its leaves list, shape [entry_count] or more
    top_centre: wp.vec3
    top_margin: float  # as `SLAB_MARGIN`, for rays against the boxes of entries
    # where something moves: the top level of each of so many equal ranges of time, a power of two; rays know no other
    top_ranges: int
    range_node: wp.array(dtype=int)  # as `top_node`, by range
    range_centre: wp.array(dtype=wp.vec3)  # as `top_centre`, by range
    entry_count: int


NEW, DONE = -2, -1
"""In place of a treelet: the ray has not begun; the ray is done."""

TRAIL_LEVELS = 6
"""Levels of a trail's word: 5 bits each, the first lowest."""


@wp.struct
class Treelets:
    """Where the parts of mesh trees lie that are visited as units. `Tree.nodes` and `Tree.triangles` hold what is above
    them.

    A treelet is a subtree. Its root is among `Tree.nodes`; the nodes and triangles below the root form two blocks,
    whose indices, the root's too, are relative to the block's first. Blocks can be anywhere, and be absent.
    """

    of_node: wp.array(dtype=int)  # by node of `Tree.nodes`: the treelet whose root it is, or -1
    root: wp.array(dtype=int)  # by treelet: its root among `Tree.nodes`
    nodes: wp.array(dtype=wp.uint64)  # by treelet: address of its block of nodes; 0 where that is absent
    triangles: wp.array(dtype=wp.uint64)  # likewise of its triangles
    deform: wp.array(dtype=int)  # by treelet, as `Tree.entry_deform`; no entries where nothing moves


@wp.struct
class TopProgress:
    """How far rays have come through the top level, by ray slot: enough to go on behind a treelet.

    A trail says, level by level from the root, which child of a resident node the ray is in (`TRAIL_LEVELS`), down to
    the treelet that it stopped at; or, with a mark in the last word, down to the node that it visits next. What it has
    met so far is in `Rays`: `hit_t`, `hit_uv`, the triangle in `hit_primitive` (-1: none) and its entry in
    `hit_instance`.
    """

    trail: wp.array2d(dtype=wp.uint32)  # shape [words, slots]
    entry: wp.array(dtype=int)  # the tree that the ray is in; empty where there is no instancing
    visits: wp.array(dtype=wp.int64)  # visits to treelets so far, of all rays, shape [1]
