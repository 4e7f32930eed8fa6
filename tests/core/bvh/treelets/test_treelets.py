"""Trees that are cut into treelets reach what the uncut ones do, wherever the treelets lie, and the cut keeps its
rule.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raybatch_addon.core.bvh.build.collapse import collapse_mesh
from raybatch_addon.core.bvh.build.cpu.build import build_binary
from raybatch_addon.core.bvh.node import BOXES_NODE, EMPTY_CHILD, QUANTISED_NODE, Layout, WideMesh, decode_children
from raybatch_addon.core.bvh.treelets.cut import TREELET_CHILD, Cut, CutRule, cut_nodes
from raybatch_addon.core.bvh.treelets.links import tree_levels
from tests.support.wide_trees import OPTIONS, needles, soup, sphere, wide
from tests.twins.tree_walk import walk_tree
from tests.twins.treelet_walk import CutBlocks, check_same

both = pytest.mark.parametrize("layout", Layout)


RULES = {
    "one": CutRule(),
    "each node": CutRule(size=1, depth_max=10**6),
    "nodes": CutRule(size=30),
    "least nodes": CutRule(size=30, size_min=4),
    "deepest": CutRule(size=1, depth_max=2),
    "root": CutRule(size=1, depth_max=0),
    "bytes": CutRule(bytes_max=20_000),
    "no bytes": CutRule(bytes_max=1),
    "area": CutRule(top_bytes_max=30_000),
    "area and nodes": CutRule(size=8, top_bytes_max=20_000),
    "everything": CutRule(size=40, size_min=2, depth_max=5, bytes_max=30_000, top_bytes_max=40_000),
}


def blocks_of(cut: Cut, triangles: np.ndarray) -> CutBlocks:
    """The blocks of `cut` with `triangles` in their new order."""
    units = triangles[cut.triangle_order]
    return CutBlocks(
        cut.top_nodes,
        cut.top_treelet,
        [cut.nodes[i:j] for i, j in zip(cut.node_first, cut.node_first[1:])],
        [units[i:j] for i, j in zip(cut.triangle_first, cut.triangle_first[1:])],
        units[: cut.triangle_first[0]],
    )


def subtree_sizes(layout: Layout, nodes: np.ndarray) -> np.ndarray:
    """Nodes below each node and itself, one node after another from the deepest."""
    inner, size = decode_children(layout, nodes).inner, np.ones(len(nodes), int)
    for i in range(len(nodes) - 1, -1, -1):
        size[i] += size[inner[i][inner[i] >= 0]].sum()
    return size


def cut_by_hand(layout: Layout, nodes: np.ndarray, rule: CutRule) -> tuple[set[int], set[int]]:
    """Opened nodes, and roots of treelets, of a rule without `top_bytes_max`, by recursion."""
    children, size = decode_children(layout, nodes), subtree_sizes(layout, nodes)
    units = children.count.sum(1)
    for i in range(len(nodes) - 1, -1, -1):
        units[i] += units[children.inner[i][children.inner[i] >= 0]].sum()
    opened, roots, open_list = set(), set(), [(0, 0)]
    while open_list:
        node, depth = open_list.pop()
        below = children.inner[node][children.inner[node] >= 0]
        large = (rule.size and size[node] > rule.size) or (
            rule.bytes_max
            and 4 * (size[node] * layout.node_words + units[node] * layout.triangle_words) > rule.bytes_max
        )
        if large and len(below) and depth < rule.depth_max and not (size[below] < rule.size_min).any():
            opened.add(node)
            open_list += [(int(child), depth + 1) for child in below]
        else:
            roots.add(node)
    return opened, roots


def levelled(mesh: WideMesh) -> WideMesh:
    """A QUANTISED tree with its nodes level by level, as CUDA builds lay them."""
    order = np.concatenate(tree_levels(mesh.layout, mesh.nodes))
    place = np.argsort(order)
    nodes = mesh.nodes[order].copy()
    fields = nodes.view(QUANTISED_NODE)[:, 0]
    fields["child_base"] = np.where(
        fields["inner_mask"] != 0, place[np.minimum(fields["child_base"], len(order) - 1)], 0
    )
    return replace(mesh, nodes=nodes)


def split(mesh: tuple[np.ndarray, np.ndarray], layout: Layout) -> WideMesh:
    """A tree in which triangles are listed more than once."""
    options = replace(OPTIONS[layout], spatial_splits=True, split_budget=1.0)
    return collapse_mesh(build_binary(*mesh, options), *mesh, layout)


@both
@pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
@pytest.mark.parametrize("mesh", ["sphere", "soup", "split", "levels"])
def test_a_cut_tree_reaches_the_same_triangles_through_the_same_boxes(layout, rule, mesh):
    if mesh == "levels" and layout is Layout.BOXES:
        pytest.skip("no builder lays them so")
    made = {
        "sphere": lambda: wide(*sphere(40), layout),
        "soup": lambda: wide(*soup(2000), layout),
        "split": lambda: split(needles(600), layout),
        "levels": lambda: levelled(wide(*sphere(40), layout)),
    }[mesh]()
    if mesh == "split":
        assert made.reference_count > 600
    before = made.nodes.copy()
    cut = cut_nodes(layout, made.nodes, rule)
    assert np.array_equal(made.nodes.view(np.uint32), before.view(np.uint32))
    check_same(layout, made.nodes, made.triangles, blocks_of(cut, made.triangles))
    check_cut(cut)
    assert np.array_equal(np.sort(cut.triangle_order), np.arange(len(made.triangles)))
    assert cut.treelet_sizes.sum() + (cut.top_treelet < 0).sum() == made.node_count
    opened_words = (cut.top_treelet < 0).sum() * layout.node_words + cut.top_triangle_count * layout.triangle_words
    assert cut.treelet_bytes.sum() + 4 * opened_words == made.byte_count
    if not rule.top_bytes_max:
        opened, roots = cut_by_hand(layout, made.nodes, rule)
        sizes = subtree_sizes(layout, made.nodes)
        assert (cut.top_treelet < 0).sum() == len(opened)
        assert np.array_equal(np.sort(cut.treelet_sizes), np.sort(sizes[sorted(roots)]))


def check_cut(cut: Cut) -> None:
    """Tables, marks and alignment of a cut."""
    assert np.array_equal(cut.top_treelet[cut.treelet_root], np.arange(cut.treelet_count))
    assert (len(cut.nodes) == 0 or cut.nodes.ctypes.data % 64 == 0) and cut.top_nodes.ctypes.data % 64 == 0
    assert cut.nodes.flags.c_contiguous and cut.top_treelet.dtype == cut.treelet_root.dtype == np.int32
    assert (
        cut.node_first[0] == 0
        and cut.node_first[-1] == len(cut.nodes)
        and cut.triangle_first[-1] == len(cut.triangle_order)
    )
    # every treelet has triangles: no block of them is empty
    assert (np.diff(cut.triangle_first) > 0).all()
    if cut.layout is Layout.BOXES:
        child = cut.nodes.view(BOXES_NODE)[:, 0]["child"] if len(cut.nodes) else np.zeros((0, 8), np.int32)
        assert not ((child >= 0) & (child != EMPTY_CHILD) & (child & TREELET_CHILD != 0)).any()


@both
def test_levels_are_those_of_resident_nodes(layout):
    made = wide(*sphere(40), layout)
    depth = walk_tree(layout, made.nodes).depth
    assert cut_nodes(layout, made.nodes, CutRule()).levels == 1
    for depth_max in (1, 2, 3):
        assert cut_nodes(layout, made.nodes, CutRule(size=1, depth_max=depth_max)).levels == depth_max + 1
    assert cut_nodes(layout, made.nodes, CutRule(size=1)).levels == depth.max() + 1


@both
def test_ten_thousand_treelets(layout):
    made = wide(*sphere(210 if layout is Layout.QUANTISED else 430), layout)
    cut = cut_nodes(layout, made.nodes, CutRule(size=1))
    assert cut.treelet_count >= 10_000 and len(cut.nodes) == 0
    check_same(layout, made.nodes, made.triangles, blocks_of(cut, made.triangles))


@both
def test_nodes_are_opened_by_area_until_they_fill_what_they_may(layout):
    made = wide(*soup(3000), layout)
    children = decode_children(layout, made.nodes)
    extent = children.high.max(1) - children.low.min(1)
    area = extent[:, 0] * extent[:, 1] + extent[:, 1] * extent[:, 2] + extent[:, 2] * extent[:, 0]
    inner = (children.inner >= 0).sum(1)
    node_bytes, unit_bytes = 4 * layout.node_words, 4 * layout.triangle_words
    last = 0
    for limit in (0, 1, node_bytes, 6_000, 20_000, 60_000, 10**9):
        cut = cut_nodes(layout, made.nodes, CutRule(top_bytes_max=limit))
        resident = node_bytes * len(cut.top_nodes) + unit_bytes * cut.top_triangle_count
        assert resident <= max(limit, node_bytes)
        assert len(cut.top_nodes) >= last
        last = len(cut.top_nodes)
        # which nodes were opened is known by their number: siblings stay together, the walk goes by largest area
        opened, used, waiting = 0, node_bytes, {0: area[0]}
        while waiting:
            node = max(waiting, key=lambda i: (waiting[i], -i))
            least = waiting.pop(node)
            below = children.inner[node][children.inner[node] >= 0]
            if not len(below):
                continue
            used += node_bytes * len(below) + unit_bytes * int(children.count[node].sum())
            if used > limit:
                break
            opened += 1
            waiting.update({int(child): min(least, area[child]) for child in below})
        assert (cut.top_treelet < 0).sum() == opened
        if limit:  # what just fits is opened
            again = cut_nodes(layout, made.nodes, CutRule(top_bytes_max=resident))
            assert np.array_equal(again.top_treelet, cut.top_treelet)
    assert (cut.top_treelet < 0).sum() == (inner > 0).sum()


@both
def test_treelets_are_numbered_in_depth_first_order(layout):
    made = wide(*sphere(40), layout)
    cut = cut_nodes(layout, made.nodes, CutRule(size=10))
    top = cut.top_nodes.copy()
    if layout is Layout.BOXES:
        child = top.view(BOXES_NODE)[:, 0]["child"]
        child[(child >= 0) & (child != EMPTY_CHILD)] &= ~TREELET_CHILD
    inner = decode_children(layout, top).inner
    found, waiting = [], [0]
    while waiting:
        node = waiting.pop()
        if cut.top_treelet[node] >= 0:
            found.append(int(cut.top_treelet[node]))
        else:
            waiting += [int(child) for child in inner[node][::-1] if child >= 0]
    assert found == list(range(cut.treelet_count))


@both
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_any_rule_on_any_mesh(layout, data):
    count, seed, size = (
        data.draw(st.integers(1, 700)),
        data.draw(st.integers(0, 3)),
        data.draw(st.sampled_from([0.02, 1.0])),
    )
    made = wide(*soup(count, seed, size), layout)
    rule = CutRule(
        data.draw(st.integers(0, 60)),
        data.draw(st.integers(0, 5)),
        data.draw(st.integers(0, 9)),
        data.draw(st.integers(0, 40_000)),
        data.draw(st.sampled_from([0, 1, 5_000, 50_000])),
    )
    cut = cut_nodes(layout, made.nodes, rule)
    check_same(layout, made.nodes, made.triangles, blocks_of(cut, made.triangles))
    check_cut(cut)
    if rule.top_bytes_max:
        resident = len(cut.top_nodes) * layout.node_words + cut.top_triangle_count * layout.triangle_words
        assert 4 * resident <= max(rule.top_bytes_max, 4 * layout.node_words)


# --- what is not a tree, or not cut rightly, is found


@both
def test_what_is_not_a_tree_is_refused(layout):
    made = wide(*soup(500), layout)
    name = "child" if layout is Layout.BOXES else "child_base"
    dtype = BOXES_NODE if layout is Layout.BOXES else QUANTISED_NODE

    def broken(value):
        nodes = made.nodes.copy()
        fields = nodes.view(dtype)[:, 0]
        if layout is Layout.BOXES:
            fields[name][0, np.flatnonzero(fields[name][0] >= 0)[0]] = value
        else:
            fields[name][0] = value
        return nodes

    for value in (0, 2, made.node_count, 2**30):
        with pytest.raises(ValueError, match="node is|child lies"):
            cut_nodes(layout, broken(value), CutRule())
    nodes = made.nodes.copy()
    fields = nodes.view(dtype)[:, 0]
    if layout is Layout.BOXES:
        node, slot = np.argwhere(fields["child"] < 0)[3]
        fields["child"][node, slot] -= 8
    else:
        fields["triangle_base"][np.flatnonzero(decode_children(layout, nodes).count.sum(1))[3]] += 1
    with pytest.raises(ValueError, match="every triangle once"):
        cut_nodes(layout, nodes, CutRule())
    with pytest.raises(ValueError, match="size_min of a cut is -1"):
        CutRule(size_min=-1)


@both
def test_the_walk_finds_what_is_wrong(layout):
    made = wide(*sphere(40), layout)
    blocks = blocks_of(cut_nodes(layout, made.nodes, CutRule(size=20)), made.triangles)
    check_same(layout, made.nodes, made.triangles, blocks)
    sizes = [len(part) for part in blocks.nodes]
    a, b = np.argsort(sizes)[-2:]

    def swapped(parts):
        parts = list(parts)
        parts[a], parts[b] = parts[b], parts[a]
        return parts

    wrong = [
        blocks._replace(triangles=swapped(blocks.triangles)),
        blocks._replace(nodes=swapped(blocks.nodes)),
        blocks._replace(top_treelet=np.where(blocks.top_treelet == a, b, blocks.top_treelet)),
        blocks._replace(top_treelet=np.where(blocks.top_treelet == a, -1, blocks.top_treelet)),
        blocks._replace(nodes=[part[:-1] if k == a else part for k, part in enumerate(blocks.nodes)]),
        blocks._replace(triangles=[part[::-1].copy() if k == a else part for k, part in enumerate(blocks.triangles)]),
    ]
    if layout is Layout.BOXES:
        unmarked = blocks.top_nodes.copy()
        child = unmarked.view(BOXES_NODE)[:, 0]["child"]
        child[(child >= 0) & (child != EMPTY_CHILD)] &= ~TREELET_CHILD
        wrong.append(blocks._replace(top_nodes=unmarked))
    for parts in wrong:
        with pytest.raises((ValueError, IndexError)):
            check_same(layout, made.nodes, made.triangles, parts)


# --- whole scenes
