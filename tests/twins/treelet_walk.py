"""Everything that rays can reach in a tree that was cut into treelets, in NumPy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.node import BOXES_NODE, EMPTY_CHILD, QUANTISED_NODE, Layout, triangle_faces
from raybatch_addon.core.bvh.treelets.cut import TREELET_CHILD
from raybatch_addon.core.bvh.treelets.tree import TreeletTree

from .tree_walk import Walk, walk_tree


class CutBlocks(NamedTuple):
    """A cut mesh tree as its blocks lie in memory; `treelets.cut.Cut` describes them."""

    top_nodes: np.ndarray  # words, shape [n_top, words]
    top_treelet: np.ndarray  # int32, shape [n_top]
    nodes: list[np.ndarray]  # by treelet: its block of nodes
    triangles: list[np.ndarray]  # by treelet: its block of triangles or groups
    top_triangles: np.ndarray  # those that are resident


def mesh_blocks(made: TreeletTree, mesh: int) -> CutBlocks:
    """The blocks of a mesh tree of `made` as kernels find them, by the addresses of its treelets; raises `ValueError`
    where one is absent.
    """
    layout, device = made.layout, made.tree.nodes.device
    treelets = range(int(made.mesh_treelet[mesh]), int(made.mesh_treelet[mesh + 1]))
    nodes = slice(int(made.mesh_node[mesh]), int(made.mesh_node[mesh + 1]))
    triangles = slice(int(made.mesh_triangle[mesh]), int(made.mesh_triangle[mesh + 1]))
    of_node = made.treelets.of_node.numpy()[nodes]
    node_address, triangle_address = made.treelets.nodes.numpy().tolist(), made.treelets.triangles.numpy().tolist()
    if any(0 in (node_address[k], triangle_address[k]) for k in treelets):
        raise ValueError("a treelet is absent")

    def words_of(array: wp.array, words: int, dtype: type) -> np.ndarray:
        whole = array.size * 4 // words * words // 4  # an array without any has one element
        return array[:whole].numpy().view(dtype).reshape(-1, words)

    def block(address: int, count: int, words: int, dtype: type) -> np.ndarray:
        if count == 0:
            return np.empty((0, words), dtype)
        memory = wp.array(ptr=address, dtype=wp.vec4, shape=count * words // 4, device=device)
        return words_of(memory, words, dtype).copy()

    node_form, triangle_form = (layout.node_words, layout.node_type), (layout.triangle_words, np.float32)
    return CutBlocks(
        words_of(made.tree.nodes, *node_form)[nodes],
        np.where(of_node < 0, -1, of_node - treelets.start).astype(np.int32),
        [block(node_address[k], int(made.treelet_sizes[k]) - 1, *node_form) for k in treelets],
        [block(triangle_address[k], int(made.treelet_units[k]), *triangle_form) for k in treelets],
        words_of(made.tree.triangles, *triangle_form)[triangles],
    )


class Reached(NamedTuple):
    """Leaves in an order of their own, which is the same however a tree is cut."""

    faces: np.ndarray  # int32, shape [leaves, most]: triangles of each leaf as it lists them; -1 where there are fewer
    low: np.ndarray  # float64, shape [leaves, 3]: corner of what a ray must meet to visit the leaf (`tree_walk.Walk`)
    high: np.ndarray
    words: np.ndarray  # uint32, shape [leaves, units, words]: the units themselves, 0 where there are fewer


def walk_treelets(layout: Layout, blocks: CutBlocks) -> Walk:
    """Follow every child from the root through all treelets.

    The walk's units are the resident ones, then those of each treelet. Raises `ValueError` where blocks are not one
    tree: where an index leads out of its block, a node is not reached or reached twice, a triangle is in no leaf or in
    two, or the table of roots and the marks of children disagree.
    """
    node_count = np.array([len(part) for part in blocks.nodes])
    unit_count = np.array([len(part) for part in blocks.triangles])
    node_first = len(blocks.top_nodes) + np.concatenate([[0], np.cumsum(node_count)])
    unit_first = len(blocks.top_triangles) + np.concatenate([[0], np.cumsum(unit_count)])
    treelet_count = len(blocks.nodes)
    roots = np.flatnonzero(blocks.top_treelet >= 0)
    if not np.array_equal(np.sort(blocks.top_treelet[roots]), np.arange(treelet_count)):
        raise ValueError("not every treelet has one root")
    # treelet in whose blocks a node's indices are; treelet_count: the resident ones
    treelet = np.concatenate([blocks.top_treelet, np.repeat(np.arange(treelet_count), node_count)]).astype(np.int64)
    treelet[treelet < 0] = treelet_count
    node_base, unit_base = np.append(node_first[:-1], 0)[treelet], np.append(unit_first[:-1], 0)[treelet]
    node_end = np.append(node_first[1:], len(blocks.top_nodes))[treelet]
    words = np.concatenate([blocks.top_nodes, *blocks.nodes])

    if layout is Layout.BOXES:
        child = words.view(BOXES_NODE)[:, 0]["child"]
        inner, leaf = (child >= 0) & (child != EMPTY_CHILD), child < 0
        marked = inner & (child & TREELET_CHILD != 0)
        target = np.where(inner, (child & ~TREELET_CHILD) + node_base[:, None], 0)
        if (inner & (target >= node_end[:, None])).any():
            raise ValueError("a child lies outside of its block")
        is_root = np.append(blocks.top_treelet >= 0, np.zeros(len(words) - len(blocks.top_nodes), bool))
        if (marked != inner & is_root[target]).any():
            raise ValueError("the mark of a child and the table of roots disagree")
        child[:] = np.where(
            inner, target, np.where(leaf, child - 8 * unit_base[:, None], child)
        )  # ~(8 (first + base) + count - 1)
    else:
        fields = words.view(QUANTISED_NODE)[:, 0]
        last = fields["child_base"] + node_base + np.unpackbits(fields["inner_mask"][:, None], axis=1).sum(1)
        if ((fields["inner_mask"] != 0) & (last > node_end)).any():
            raise ValueError("a child lies outside of its block")
        fields["child_base"] += node_base.astype(np.int32)
        fields["triangle_base"] += unit_base.astype(np.int32)
    walk = walk_tree(layout, words)
    _check_units(walk, treelet, unit_first)
    return walk


def _check_units(walk: Walk, treelet: np.ndarray, unit_first: np.ndarray) -> None:
    by_place = np.argsort(walk.leaf_first, kind="stable")
    first, end = walk.leaf_first[by_place], (walk.leaf_first + walk.leaf_count)[by_place]
    if first[0] != 0 or (first[1:] != end[:-1]).any() or end[-1] != unit_first[-1]:
        raise ValueError("a triangle is in no leaf, or in two")
    holder = treelet[walk.leaf_node[by_place]]
    holder[holder == len(unit_first) - 1] = -1  # resident
    if any((np.searchsorted(unit_first, unit, side="right") - 1 != holder).any() for unit in (first, end - 1)):
        raise ValueError("a leaf lists triangles of another block")


def reached(layout: Layout, walk: Walk, triangles: np.ndarray) -> Reached:
    """What `walk`, of a tree that was cut or not, comes to; `triangles` are the words of all its units in order."""
    by_unit = triangle_faces(layout, triangles).reshape(len(triangles), -1)
    most = int(walk.leaf_count.max())
    listed = np.full((len(walk.leaf_first), most, by_unit.shape[1]), -1, np.int32)
    words = np.zeros((len(walk.leaf_first), most, layout.triangle_words), np.uint32)
    for offset in range(most):
        there = walk.leaf_count > offset
        listed[there, offset] = by_unit[walk.leaf_first[there] + offset]
        words[there, offset] = triangles.view(np.uint32)[walk.leaf_first[there] + offset]
    listed = listed.reshape(len(listed), -1)
    order = np.lexsort(np.concatenate([listed.astype(np.float64), walk.leaf_low, walk.leaf_high], 1).T[::-1])
    return Reached(listed[order], walk.leaf_low[order], walk.leaf_high[order], words[order])


def check_same(layout: Layout, nodes: np.ndarray, triangles: np.ndarray, blocks: CutBlocks) -> None:
    """Raise `ValueError` unless the cut tree has the leaves of the uncut one: the same triangles, as whole, in the same
    boxes.
    """
    uncut = reached(layout, walk_tree(layout, nodes), triangles)
    cut = reached(layout, walk_treelets(layout, blocks), np.concatenate([blocks.top_triangles, *blocks.triangles]))
    for name, a, b in zip(Reached._fields, uncut, cut, strict=True):
        if not np.array_equal(a, b):
            raise ValueError(f"the leaves of a cut tree differ from those of the uncut one: {name}")
