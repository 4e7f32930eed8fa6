"""A scene's tree with its nodes and triangles spelled out, the same for both layouts."""

from __future__ import annotations

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.node import BOXES_GROUP, QUANTISED_TRIANGLE, WIDTH, Layout, decode_children
from raybatch_addon.core.bvh.tree import Tree as DeviceTree


@wp.struct
class FlatTree:
    """Device side. Children of a node lie at node * 8 + slot; nodes and triangles count as those of `Tree` do, but that
    a group of eight triangles is eight, some of which may not be there."""

    low: wp.array(dtype=wp.vec3)  # by child, relative to the tree's centre [m]
    high: wp.array(dtype=wp.vec3)
    first: wp.array(dtype=int)  # by child: a node; or the first triangle or entry of a leaf
    count: wp.array(dtype=int)  # by child: 0 for a node, what a leaf lists, -1 where there is none
    a: wp.array(dtype=wp.vec3)  # corners by triangle [m]
    b: wp.array(dtype=wp.vec3)
    c: wp.array(dtype=wp.vec3)
    face: wp.array(dtype=int)  # -1: no triangle
    group: int  # triangles of a group: 8 of BOXES, 1 of QUANTISED


def flat_tree(tree: DeviceTree, layout: Layout, instancing: bool, device: wp.Device) -> FlatTree:
    """The nodes and triangles of `tree`; with `instancing`, nodes from `tree.top_node` on are its top level's."""
    words = layout.node_words
    nodes = tree.nodes.numpy().reshape(-1).view(layout.node_type)
    children = decode_children(layout, nodes[: len(nodes) // words * words].reshape(-1, words))
    there = np.isfinite(children.low).all(2)
    low, high = children.low.astype(np.float32), children.high.astype(np.float32)
    low = np.where(low > children.low, np.nextafter(low, np.float32(-np.inf)), low)
    high = np.where(high < children.high, np.nextafter(high, np.float32(np.inf)), high)
    leaf = children.count > 0
    group = WIDTH if layout is Layout.BOXES else 1
    of_top = np.zeros((len(low), 1), bool)
    of_top[tree.top_node :] = instancing
    times = np.where(leaf & ~of_top, group, 1)
    first = np.where(leaf, children.first, children.inner) * times
    count = np.where(leaf, children.count * times, np.where(there, 0, -1))
    made = FlatTree()
    made.low, made.high = (
        wp.array(np.where(there[..., None], each, 0.0).reshape(-1, 3), dtype=wp.vec3, device=device)
        for each in (low, high)
    )
    made.first, made.count = (
        wp.array(each.reshape(-1).astype(np.int32), dtype=int, device=device) for each in (first, count)
    )
    triangles = tree.triangles.numpy().reshape(-1)
    if layout is Layout.BOXES:
        groups = triangles[: len(triangles) // 80 * 80].view(BOXES_GROUP)
        corners = groups["corners"].transpose(0, 3, 1, 2).reshape(-1, 3, 3)
        face = groups["face"].reshape(-1)
    else:
        single = triangles[: len(triangles) // 12 * 12].view(QUANTISED_TRIANGLE)
        corners = np.stack([single["a"], single["b"], single["c"]], 1)
        face = single["face"]
    made.a, made.b, made.c = (
        wp.array(np.ascontiguousarray(corners[:, k]), dtype=wp.vec3, device=device) for k in range(3)
    )
    made.face = wp.array(np.ascontiguousarray(face), dtype=int, device=device)
    made.group = group
    return made
