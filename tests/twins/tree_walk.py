"""Everything that rays can reach in a wide tree, followed child by child in NumPy, and vertices as blocks hold them."""

from typing import NamedTuple

import numpy as np

from raybatch_addon.core.bvh.node import BOXES_GROUP, QUANTISED_NODE, QUANTISED_TRIANGLE, WIDTH, Layout, decode_children


def triangle_corners(layout: Layout, triangles: np.ndarray) -> np.ndarray:
    """Vertices as they lie in the blocks, float32, shape [groups, 8, 3 corners, 3] or [t, 3, 3]."""
    if layout is Layout.BOXES:
        return np.ascontiguousarray(triangles).view(BOXES_GROUP)[:, 0]["corners"].transpose(0, 3, 1, 2)
    fields = np.ascontiguousarray(triangles).view(QUANTISED_TRIANGLE)[:, 0]
    return np.stack([fields["a"], fields["b"], fields["c"]], 1)


class Walk(NamedTuple):
    """All that a ray could reach from the root."""

    depth: np.ndarray  # int64, shape [n]: level of each node, the root's is 0
    leaf_node: np.ndarray  # int64, shape [leaves]: node that holds the leaf
    leaf_slot: np.ndarray
    leaf_first: np.ndarray  # first triangle or group
    leaf_count: np.ndarray  # triangles or groups
    # float64, shape [leaves, 3]: corner of what a ray must meet to visit the leaf, relative to the centre: the leaf's
    # box within all boxes on the way to it
    leaf_low: np.ndarray
    leaf_high: np.ndarray


def walk_tree(layout: Layout, nodes: np.ndarray) -> Walk:
    """Follow every child from the root; raises `ValueError` where nodes are not one tree.

    Checks that each node is reached exactly once and after the node that holds it, that a node has a child, and that
    the marks of a child as a node, a leaf or nothing agree.
    """
    children = decode_children(layout, nodes)
    if layout is Layout.QUANTISED:
        _check_meta(np.ascontiguousarray(nodes).view(QUANTISED_NODE)[:, 0])
    depth = np.full(len(nodes), -1)
    depth[0] = 0
    low = np.full((len(nodes), 3), -np.inf)
    high = np.full((len(nodes), 3), np.inf)
    level = np.zeros(1, np.int64)
    found: list[tuple[np.ndarray, ...]] = []
    while len(level):
        box_low = np.maximum(children.low[level], low[level][:, None])
        box_high = np.minimum(children.high[level], high[level][:, None])
        i, slot = np.nonzero(children.count[level])
        node = level[i]
        found.append(
            (node, slot, children.first[node, slot], children.count[node, slot], box_low[i, slot], box_high[i, slot])
        )
        i, slot = np.nonzero(children.inner[level] >= 0)
        below = children.inner[level[i], slot]
        if len(below) and (
            below.max() >= len(nodes) or (below <= level[i]).any() or len(np.unique(below)) < len(below)
        ):
            raise ValueError("a child lies outside of the block, before the node that holds it, or below two nodes")
        if (depth[below] >= 0).any():
            raise ValueError("a node is reached twice")
        depth[below] = depth[level[0]] + 1
        low[below], high[below] = box_low[i, slot], box_high[i, slot]
        level = below
    if (depth < 0).any():
        raise ValueError("a node is never reached")
    if not ((children.inner >= 0) | (children.count > 0)).any(1).all():
        raise ValueError("a node has no child")
    return Walk(depth, *(np.concatenate(part) for part in zip(*found)))


def _check_meta(fields: np.ndarray) -> None:
    meta = fields["meta"].astype(np.int64)
    inner = (fields["inner_mask"].astype(np.int64)[:, None] >> np.arange(WIDTH) & 1) == 1
    if (inner != (meta & 0xF8 == 0x38)).any() or (inner & (meta & 7 != np.arange(WIDTH))).any():
        raise ValueError("the mask of inner children and their meta bytes disagree")
    if not (inner | (meta == 0) | np.isin(meta >> 5, (1, 3, 7)) & (meta & 31 < 24)).all():
        raise ValueError("a leaf's count is not 1 to 3, or its offset is not below 24")
    if not ((fields["exponent"] >= 1) & (fields["exponent"] <= 254)).all():
        raise ValueError("an exponent is not that of a normal number")
