"""The two layouts, word by word."""

import numpy as np
import pytest

from raybatch_addon.core.bvh.node import (
    BOXES_GROUP,
    BOXES_NODE,
    EMPTY_CHILD,
    QUANTISED_NODE,
    QUANTISED_TRIANGLE,
    Layout,
    aligned_empty,
    decode_children,
)
from tests.support.wide_trees import soup, wide
from tests.twins.tree_walk import walk_tree


def test_sizes():
    assert (BOXES_NODE.itemsize, BOXES_GROUP.itemsize, QUANTISED_NODE.itemsize, QUANTISED_TRIANGLE.itemsize) == (
        256,
        320,
        80,
        48,
    )
    assert (Layout.BOXES.node_words, Layout.BOXES.triangle_words) == (64, 80)
    assert (Layout.QUANTISED.node_words, Layout.QUANTISED.triangle_words) == (20, 12)


@pytest.mark.parametrize("shape", [(1, 20), (1000, 20)])
def test_memory_is_aligned(shape):
    array = aligned_empty(shape, np.uint32)
    assert (
        array.shape == shape and array.dtype == np.uint32 and array.flags.c_contiguous and array.ctypes.data % 64 == 0
    )


def boxes_nodes() -> np.ndarray:
    """A root with a leaf in slot 0 and a node in slot 1, whose only child is a leaf of two groups."""
    nodes = np.zeros(2, BOXES_NODE)
    nodes["planes"][:, :, 0], nodes["planes"][:, :, 1] = np.inf, -np.inf
    nodes["child"] = EMPTY_CHILD
    nodes["planes"][0, :, 0, :2] = [[-1, 0], [-2, 1], [-3, 2]]
    nodes["planes"][0, :, 1, :2] = [[1, 5], [2, 6], [3, 7]]
    nodes["child"][0, :2] = [~(0 * 8 + 0), 1]
    nodes["planes"][1, :, 0, 0], nodes["planes"][1, :, 1, 0] = [0, 0, 0], [9, 5, 9]
    nodes["child"][1, 0] = ~(1 * 8 + 1)
    return nodes.view(np.float32).reshape(2, 64)


def quantised_nodes() -> np.ndarray:
    """A root with a leaf of two triangles in slot 5 and nodes in slots 2 and 7, each with a leaf of three, the second
    after one of one.
    """
    nodes = np.zeros(3, QUANTISED_NODE)
    nodes["exponent"] = 127
    nodes["origin"][0] = [10, 20, 30]
    nodes["exponent"][0] = [127, 126, 128]
    nodes["inner_mask"][0] = 1 << 2 | 1 << 7
    nodes["child_base"][0] = 1
    nodes["meta"][0, [2, 5, 7]] = [1 << 5 | 26, 3 << 5, 1 << 5 | 31]
    nodes["low"][0][:, 2], nodes["high"][0][:, 2] = [1, 2, 3], [4, 5, 255]
    nodes["triangle_base"] = [0, 2, 5]
    nodes["meta"][1, 0] = 7 << 5
    nodes["meta"][2, [0, 6]] = [1 << 5, 7 << 5 | 1]
    return nodes.view(np.uint32).reshape(3, 20)


def test_boxes_are_decoded():
    children = decode_children(Layout.BOXES, boxes_nodes())
    assert children.low[0, :2].tolist() == [[-1, -2, -3], [0, 1, 2]] and children.high[0, :2].tolist() == [
        [1, 2, 3],
        [5, 6, 7],
    ]
    assert np.isposinf(children.low[0, 2:]).all() and np.isneginf(children.high[0, 2:]).all()
    assert children.inner[0].tolist() == [-1, 1] + 6 * [-1]
    assert children.first[:, 0].tolist() == [0, 1] and children.count[:, 0].tolist() == [1, 2]
    assert children.count.sum() == 3


def test_quantised_nodes_are_decoded():
    children = decode_children(Layout.QUANTISED, quantised_nodes())
    assert children.low[0, 2].tolist() == [11, 21, 36] and children.high[0, 2].tolist() == [14, 22.5, 540]
    assert np.isposinf(children.low[0, 0]).all() and np.isneginf(children.high[0, 0]).all()
    assert children.inner[0].tolist() == [-1, -1, 1, -1, -1, -1, -1, 2]
    assert (children.first[0, 5], children.count[0, 5]) == (0, 2)
    assert (children.first[1, 0], children.count[1, 0]) == (2, 3)
    assert children.first[2, [0, 6]].tolist() == [5, 6] and children.count[2, [0, 6]].tolist() == [1, 3]


def test_a_walk_meets_leaves_within_all_boxes_on_the_way():
    walk = walk_tree(Layout.BOXES, boxes_nodes())
    assert walk.depth.tolist() == [0, 1]
    assert list(zip(walk.leaf_node, walk.leaf_slot, walk.leaf_first, walk.leaf_count)) == [(0, 0, 0, 1), (1, 0, 1, 2)]
    assert walk.leaf_low[1].tolist() == [0, 1, 2] and walk.leaf_high[1].tolist() == [5, 5, 7]


def spoil_boxes(what: str) -> np.ndarray:
    nodes = boxes_nodes()
    child = nodes.view(BOXES_NODE)["child"][:, 0]
    child[
        {"reached twice": (0, 2), "outside": (0, 1), "itself": (1, 0), "never": (0, 1), "childless": (1, 0)}[what]
    ] = {"reached twice": 1, "outside": 2, "itself": 1, "never": EMPTY_CHILD, "childless": EMPTY_CHILD}[what]
    return nodes


@pytest.mark.parametrize("what", ["reached twice", "outside", "itself", "never", "childless"])
def test_a_broken_tree_is_noticed(what):
    with pytest.raises(ValueError):
        walk_tree(Layout.BOXES, spoil_boxes(what))


@pytest.mark.parametrize(
    "field, index, value",
    [("meta", (0, 2), 1 << 5 | 27), ("meta", (1, 0), 5 << 5), ("inner_mask", 0, 4), ("exponent", (2, 1), 0)],
)
def test_broken_codes_are_noticed(field, index, value):
    nodes = quantised_nodes()
    walk_tree(Layout.QUANTISED, nodes)
    nodes.view(QUANTISED_NODE)[:, 0][field][index] = value
    with pytest.raises(ValueError):
        walk_tree(Layout.QUANTISED, nodes)


@pytest.mark.parametrize("layout", Layout)
def test_figures_of_memory(layout):
    mesh = wide(*soup(100), layout)
    assert mesh.byte_count == 4 * (mesh.node_count * layout.node_words + len(mesh.triangles) * layout.triangle_words)
