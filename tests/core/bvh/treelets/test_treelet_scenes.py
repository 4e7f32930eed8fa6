"""Treelets of scenes with several meshes."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.cuda.build import build_mesh, build_top
from raybatch_addon.core.bvh.build.scene_tree import BuiltTree, build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.treelets import tree as treelet_tree
from raybatch_addon.core.bvh.treelets.cut import CutRule
from raybatch_addon.core.bvh.treelets.links import tree_levels
from raybatch_addon.core.bvh.treelets.tree import TreeletTree, cut_scene_tree
from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from tests.support import scenes
from tests.support.under_test import DEVICE
from tests.support.wide_trees import soup, sphere
from tests.twins.tree_walk import walk_tree
from tests.twins.treelet_walk import check_same, mesh_blocks, walk_treelets

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
        check_same(layout, nodes, triangles, mesh_blocks(made, k))
    of_node, root = made.treelets.of_node.numpy(), made.treelets.root.numpy()
    assert np.array_equal(of_node[root], np.arange(made.treelet_count)) and (of_node >= 0).sum() == made.treelet_count
    node_align, triangle_align = (64, 64) if layout is Layout.BOXES else (16, 16)
    assert (
        not (made.treelets.nodes.numpy() % node_align).any()
        and not (made.treelets.triangles.numpy() % triangle_align).any()
    )
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
    before = [mesh_blocks(made, k) for k in range(len(built.meshes))]
    moved, addresses = [], {"nodes": [], "triangles": []}
    counts = {
        "nodes": (made.treelet_sizes - 1, layout.node_words),
        "triangles": (made.treelet_units, layout.triangle_words),
    }
    for k in np.random.default_rng(0).permutation(made.treelet_count):
        for name, (count, words) in counts.items():
            size = int(count[k]) * words // 4
            block = wp.zeros(size + 16, dtype=wp.vec4, device=device)
            first = -block.ptr % 64 // 16
            if size:
                old = wp.array(
                    ptr=int(getattr(made.treelets, name).numpy()[k]), dtype=wp.vec4, shape=size, device=device
                )
                wp.copy(block, old, dest_offset=first, count=size)
            moved.append(block)
            addresses[name].append((k, block.ptr + 16 * first))
    for name, pairs in addresses.items():
        setattr(
            made.treelets,
            name,
            wp.array(np.array([a for _, a in sorted(pairs)], np.uint64), dtype=wp.uint64, device=device),
        )
    for block in made.blocks:
        block.fill_(wp.vec4(float("nan")))
    wp.synchronize_device(device)
    check_scene(built, made)
    for k, blocks in enumerate(before):
        assert np.array_equal(
            walk_treelets(layout, blocks).leaf_first, walk_treelets(layout, mesh_blocks(made, k)).leaf_first
        )
    made.treelets.nodes = wp.zeros_like(made.treelets.nodes)
    with pytest.raises(ValueError, match="absent"):
        mesh_blocks(made, 0)


def test_a_leaf_of_the_device_builders_top_level_lists_one_entry():
    """Even where boxes are equal."""
    device = wp.get_device(DEVICE)
    low = np.random.default_rng(0).uniform(-1, 1, (200, 3)).astype(np.float32)
    low[50:150] = low[0]
    top = build_top(
        wp.array(low, dtype=wp.vec3, device=device), wp.array(low + np.float32(0.5), dtype=wp.vec3, device=device)
    )
    nodes = top.nodes.numpy().view(np.uint32).reshape(-1, Layout.QUANTISED.node_words)
    assert (walk_tree(Layout.QUANTISED, nodes).leaf_count == 1).all()


def test_trees_of_the_device_builder_lie_level_by_level():
    positions, triangles = sphere(30)
    device = wp.get_device(DEVICE)
    positions, indices = (
        wp.array(positions, dtype=wp.vec3, device=device),
        wp.array(triangles, dtype=wp.vec3i, device=device),
    )
    made = build_mesh(positions, indices, 0, len(triangles))
    nodes = made.nodes.numpy().view(np.uint32).reshape(-1, Layout.QUANTISED.node_words)
    assert np.array_equal(np.concatenate(tree_levels(Layout.QUANTISED, nodes)), np.arange(made.node_count))


def test_what_does_not_fit_is_reported(monkeypatch):
    built = built_scene(Layout.QUANTISED, False)
    monkeypatch.setattr(treelet_tree, "free_memory", lambda device: 1000)
    with pytest.raises(OutOfMemoryError, match="treelets needs .* GB more"):
        cut_scene_tree(built, CutRule(), wp.get_device(DEVICE))
