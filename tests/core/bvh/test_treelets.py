"""Trees that are cut into treelets reach what the uncut ones do, wherever the treelets lie, and the cut keeps its rule."""

from dataclasses import replace

import numpy as np
import pytest
import scenes
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from under_test import DEVICE
from wide_trees import OPTIONS, needles, soup, sphere, wide

from raybatch_addon.core.bvh import treelet_tree
from raybatch_addon.core.bvh.build import BuiltTree, build_scene_tree
from raybatch_addon.core.bvh.build_cuda import build_mesh, build_top
from raybatch_addon.core.bvh.build_sah import build_binary
from raybatch_addon.core.bvh.collapse import collapse_mesh
from raybatch_addon.core.bvh.node import BOXES_NODE, EMPTY_CHILD, QUANTISED_NODE, Layout, WideMesh, decode_children, walk_tree
from raybatch_addon.core.bvh.treelet_tree import TreeletTree, cut_scene_tree
from raybatch_addon.core.bvh.treelet_walk import CutBlocks, check_same, walk_treelets
from raybatch_addon.core.bvh.treelets import TREELET_CHILD, Cut, CutRule, cut_nodes, tree_levels
from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry

both = pytest.mark.parametrize("layout", Layout)
scene_layouts = pytest.mark.parametrize("layout", list(Layout) if DEVICE == "cpu" else [Layout.QUANTISED])

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
            rule.bytes_max and 4 * (size[node] * layout.node_words + units[node] * layout.triangle_words) > rule.bytes_max
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
    fields["child_base"] = np.where(fields["inner_mask"] != 0, place[np.minimum(fields["child_base"], len(order) - 1)], 0)
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
    assert cut.node_first[0] == 0 and cut.node_first[-1] == len(cut.nodes) and cut.triangle_first[-1] == len(cut.triangle_order)
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
        # which nodes were opened is told by their number: siblings stay together, the walk goes by largest area
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
    count, seed, size = data.draw(st.integers(1, 700)), data.draw(st.integers(0, 3)), data.draw(st.sampled_from([0.02, 1.0]))
    made = wide(*soup(count, seed, size), layout)
    rule = CutRule(
        data.draw(st.integers(0, 60)), data.draw(st.integers(0, 5)), data.draw(st.integers(0, 9)), data.draw(st.integers(0, 40_000)),
        data.draw(st.sampled_from([0, 1, 5_000, 50_000])),
    )  # fmt: skip
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


def built_scene(layout: Layout, instancing: bool, on_device: bool | None = None) -> BuiltTree:
    """A sphere once, and with `instancing` a soup in five places and a cube in three."""
    ball, parts, cube = scenes.sphere(segments=40, rings=30), Mesh("soup", *soup(700)), scenes.box()
    objects = [(ball, scenes.IDENTITY, scenes.diffuse())]
    if instancing:
        objects += [(parts, scenes.translation(2.0 * i, 1, 0, 0.5 + 0.1 * i), scenes.diffuse()) for i in range(5)]
        objects += [(cube, scenes.translation(0, 3.0 * i, 2), scenes.diffuse()) for i in range(3)]
    scene, device = scenes.scene(objects), wp.get_device(DEVICE)
    flat = flatten(scene)
    geometry = upload_geometry(flat, scene, device)
    return build_scene_tree(flat, geometry, scene.instances.visibility, instancing, device, layout, on_device=on_device)


def check_scene(built: BuiltTree, made: TreeletTree) -> None:
    """Each mesh reaches what it did before, and entries and tables point to it."""
    layout = built.layout
    for k, mesh in enumerate(built.meshes):
        nodes = mesh.nodes.numpy().view(layout.node_type).reshape(-1, layout.node_words)
        triangles = mesh.triangles.numpy().reshape(-1, layout.triangle_words)
        check_same(layout, nodes, triangles, made.read_mesh(k))
    of_node, root = made.treelets.of_node.numpy(), made.treelets.root.numpy()
    assert np.array_equal(of_node[root], np.arange(made.treelet_count)) and (of_node >= 0).sum() == made.treelet_count
    node_align, triangle_align = (64, 64) if layout is Layout.BOXES else (16, 16)
    assert not (made.treelets.nodes.numpy() % node_align).any() and not (made.treelets.triangles.numpy() % triangle_align).any()
    assert made.treelets.nodes.numpy().all() and made.treelets.triangles.numpy().all()
    # the same meshes in the same entries, whose place in the new arrays is that of the mesh
    old_first = np.cumsum([0, *(mesh.nodes.size * 4 // layout.node_words for mesh in built.meshes)])
    mesh_of = np.searchsorted(old_first, built.tree.entry_node.numpy(), side="right") - 1
    assert np.array_equal(made.tree.entry_node.numpy(), made.mesh_node[mesh_of])
    assert np.array_equal(made.tree.entry_triangle.numpy(), made.mesh_triangle[mesh_of])
    assert made.tree.entry_count == built.tree.entry_count
    for name in ("entry_centre", "entry_from_world", "entry_instance", "entry_visibility", "merged_first", "top_entry"):
        assert np.array_equal(getattr(made.tree, name).numpy(), getattr(built.tree, name).numpy()), name
    assert made.bytes >= made.node_bytes + made.triangle_bytes
    roots_twice = 4 * layout.node_words * made.treelet_count
    assert made.treelet_bytes.sum() + made.resident_bytes == made.node_bytes + made.triangle_bytes + roots_twice
    assert made.statistics["treelets"] == made.treelet_count and made.statistics["bytes"] == made.bytes


@scene_layouts
@pytest.mark.parametrize("instancing", [False, True], ids=["baked", "instances"])
@pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
def test_scenes(layout, instancing, rule):
    built = built_scene(layout, instancing)
    before = built.tree.nodes.numpy().tobytes(), built.tree.triangles.numpy().tobytes()
    made = cut_scene_tree(built, rule, wp.get_device(DEVICE))
    check_scene(built, made)
    assert before == (built.tree.nodes.numpy().tobytes(), built.tree.triangles.numpy().tobytes())
    assert (made.tree.entry_count, len(built.meshes)) == ((9, 3) if instancing else (1, 1))
    if rule is RULES["one"]:
        assert made.treelet_count == len(built.meshes) and made.mesh_triangle[-1] == 0
    words = layout.node_words
    if instancing:
        # the top level as it was, behind the resident nodes of the meshes
        top = made.tree.nodes.numpy().view(layout.node_type).reshape(-1, words)[made.tree.top_node :]
        old = built.tree.nodes.numpy().view(layout.node_type).ravel()[words * built.tree.top_node :]
        assert len(top) >= 1 and top.tobytes() == old[: top.size].tobytes()
        walk = walk_tree(layout, top)
        assert walk.leaf_count.sum() == made.tree.entry_count
        assert (made.treelets.of_node.numpy()[made.tree.top_node :] == -1).all()
        assert made.levels >= walk.depth.max() + 1 + 1
    else:
        assert len(made.treelets.of_node) == made.tree.nodes.size * 4 // words


@pytest.mark.parametrize("instancing", [False, True], ids=["baked", "instances"])
def test_trees_of_the_device_builder(instancing):
    built = built_scene(Layout.QUANTISED, instancing, on_device=True)
    for rule in RULES.values():
        check_scene(built, cut_scene_tree(built, rule, wp.get_device(DEVICE)))


@scene_layouts
def test_blocks_can_be_moved(layout):
    device = wp.get_device(DEVICE)
    built = built_scene(layout, True)
    made = cut_scene_tree(built, RULES["nodes"], device)
    before = [made.read_mesh(k) for k in range(len(built.meshes))]
    moved, addresses = [], {"nodes": [], "triangles": []}
    counts = {"nodes": (made.treelet_sizes - 1, layout.node_words), "triangles": (made.treelet_units, layout.triangle_words)}
    for k in np.random.default_rng(0).permutation(made.treelet_count):
        for name, (count, words) in counts.items():
            size = int(count[k]) * words // 4
            block = wp.zeros(size + 16, dtype=wp.vec4, device=device)
            first = -block.ptr % 64 // 16
            if size:
                old = wp.array(ptr=int(getattr(made.treelets, name).numpy()[k]), dtype=wp.vec4, shape=size, device=device)
                wp.copy(block, old, dest_offset=first, count=size)
            moved.append(block)
            addresses[name].append((k, block.ptr + 16 * first))
    for name, pairs in addresses.items():
        setattr(made.treelets, name, wp.array(np.array([a for _, a in sorted(pairs)], np.uint64), dtype=wp.uint64, device=device))
    for block in made.blocks:
        block.fill_(wp.vec4(float("nan")))
    wp.synchronize_device(device)
    check_scene(built, made)
    for k, blocks in enumerate(before):
        assert np.array_equal(walk_treelets(layout, blocks).leaf_first, walk_treelets(layout, made.read_mesh(k)).leaf_first)
    made.treelets.nodes = wp.zeros_like(made.treelets.nodes)
    with pytest.raises(ValueError, match="absent"):
        made.read_mesh(0)


def test_a_leaf_of_the_device_builders_top_level_lists_one_entry():
    """Even where boxes are equal."""
    device = wp.get_device(DEVICE)
    low = np.random.default_rng(0).uniform(-1, 1, (200, 3)).astype(np.float32)
    low[50:150] = low[0]
    top = build_top(wp.array(low, dtype=wp.vec3, device=device), wp.array(low + np.float32(0.5), dtype=wp.vec3, device=device))
    nodes = top.nodes.numpy().view(np.uint32).reshape(-1, Layout.QUANTISED.node_words)
    assert (walk_tree(Layout.QUANTISED, nodes).leaf_count == 1).all()


def test_trees_of_the_device_builder_lie_level_by_level():
    positions, triangles = sphere(30)
    device = wp.get_device(DEVICE)
    positions, indices = wp.array(positions, dtype=wp.vec3, device=device), wp.array(triangles, dtype=wp.vec3i, device=device)
    made = build_mesh(positions, indices, 0, len(triangles))
    nodes = made.nodes.numpy().view(np.uint32).reshape(-1, Layout.QUANTISED.node_words)
    assert np.array_equal(np.concatenate(tree_levels(Layout.QUANTISED, nodes)), np.arange(made.node_count))


def test_what_does_not_fit_is_told(monkeypatch):
    built = built_scene(Layout.QUANTISED, False)
    monkeypatch.setattr(treelet_tree, "free_memory", lambda device: 1000)
    with pytest.raises(OutOfMemoryError, match="treelets needs .* GB more"):
        cut_scene_tree(built, CutRule(), wp.get_device(DEVICE))
