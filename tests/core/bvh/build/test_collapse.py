"""Wide trees made of binary ones: nothing is lost, and boxes hold what they must with their margins."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raybatch_addon.core.bvh.build.binary import BinaryTree, BuildOptions
from raybatch_addon.core.bvh.build.collapse import CollapseCost, collapse_entries, collapse_mesh
from raybatch_addon.core.bvh.build.cpu.build import build_binary, build_binary_from_boxes
from raybatch_addon.core.bvh.margin import SLAB_MARGIN
from raybatch_addon.core.bvh.node import Layout, decode_children, triangle_faces
from tests.support.wide_trees import OPTIONS, check_blocks, check_parts, check_whole, needles, soup, sphere, wide
from tests.twins.tree_walk import walk_tree

both = pytest.mark.parametrize("layout", Layout)


@both
@pytest.mark.parametrize("mesh", [sphere(40), soup(3000), soup(500, size=2.0)], ids=["sphere", "soup", "overlapping"])
def test_every_triangle_is_reached_once_in_boxes_with_their_margin(layout, mesh):
    check_whole(wide(*mesh, layout), *mesh)


@both
def test_a_mesh_takes_less_than_120_bytes_a_triangle(layout):
    positions, mesh_triangles = sphere(120)
    mesh = wide(positions, mesh_triangles, layout)
    assert mesh.byte_count < 120 * len(mesh_triangles)
    assert mesh.byte_count == mesh.nodes.nbytes + mesh.triangles.nbytes


@both
@pytest.mark.parametrize("count", [1, 2, 3, 4, 8, 9, 24, 25])
def test_few_triangles(layout, count):
    check_whole(wide(*soup(count), layout), *soup(count))


@both
def test_children_that_the_binary_tree_has_as_leaves_are_merged_or_kept_apart_as_costs_ask(layout):
    positions, triangles = sphere(30)
    binary = build_binary(positions, triangles, BuildOptions(leaf_group=1, leaf_max=1))
    apart = collapse_mesh(binary, positions, triangles, layout, CollapseCost(node=1e-6, unit=1.0))
    merged = collapse_mesh(binary, positions, triangles, layout, CollapseCost(node=1.0, unit=1e-6))
    check_whole(apart, positions, triangles)
    check_whole(merged, positions, triangles)
    assert merged.leaf_count < apart.leaf_count and merged.node_count < apart.node_count
    if layout is Layout.QUANTISED:
        assert apart.leaf_count == len(triangles)


@both
def test_cost_is_that_of_its_boxes(layout):
    positions, triangles = sphere(30)
    cost = CollapseCost(1.5, 0.5)
    mesh = collapse_mesh(build_binary(positions, triangles, OPTIONS[layout]), positions, triangles, layout, cost)
    children = decode_children(layout, mesh.nodes)
    size = np.where(np.isfinite(children.low), children.high - children.low, 0)
    area = size[..., 0] * size[..., 1] + size[..., 1] * size[..., 2] + size[..., 2] * size[..., 0]
    root = (mesh.box[1] - mesh.box[0]).astype(np.float64)
    root_area = root[0] * root[1] + root[1] * root[2] + root[2] * root[0]
    expected = 1.5 + (1.5 * area * (children.inner >= 0) + 0.5 * area * children.count).sum() / root_area
    # the boxes themselves are a little larger, on a grid of up to 255 steps (QUANTISED)
    assert mesh.sah <= expected * (1 + 1e-9) and expected < mesh.sah * (1.0001 if layout is Layout.BOXES else 1.05)


@both
@pytest.mark.parametrize("scale", [1e-18, 1e-9, 1.0, 1e9, 1e18])
def test_extents(layout, scale):
    positions, triangles = soup(300)
    positions = (positions * np.float32(scale)).astype(np.float32)
    check_whole(wide(positions, triangles, layout), positions, triangles)


@both
def test_far_from_the_origin_and_flat(layout):
    positions, triangles = soup(300)
    for flat in ([1, 1, 0], [0, 1, 0], [1e-3, 1e6, 1]):
        moved = (positions * flat + np.array([1e6, -3e5, 12.5])).astype(np.float32)
        check_whole(wide(moved, triangles, layout), moved, triangles)


@both
def test_points(layout):
    positions = np.full((3, 3), 7.25, np.float32)
    triangles = np.zeros((100, 3), np.int32)
    check_whole(wide(positions, triangles, layout), positions, triangles)
    check_whole(wide(0 * positions, triangles, layout), 0 * positions, triangles)


@both
def test_a_million_copies(layout):
    positions, triangles = soup(1)
    mesh = wide(positions, np.repeat(triangles, 1_000_000, 0), layout)
    walk = walk_tree(layout, mesh.nodes)
    assert mesh.reference_count == 1_000_000 and mesh.depth == walk.depth.max() + 1 < 30
    faces = triangle_faces(layout, mesh.triangles)
    assert (np.bincount(faces[faces >= 0]) == 1).all()
    assert mesh.byte_count < 120 * 1_000_000


@both
def test_a_strip_whose_triangles_grow(layout):
    """Each binary node cuts off one triangle: the deepest trees that builders make."""
    edge = np.float32(1.5) ** np.arange(-40, 40, dtype=np.float32)
    positions = np.stack(
        [
            np.stack([edge, 0 * edge, 0 * edge], 1),
            np.stack([2 * edge, edge, 0 * edge], 1),
            np.stack([edge, edge, edge], 1),
        ],
        1,
    )
    positions = positions.reshape(-1, 3).astype(np.float32)
    triangles = np.arange(len(positions), dtype=np.int32).reshape(-1, 3)
    check_whole(wide(positions, triangles, layout), positions, triangles)


@both
def test_split_triangles(layout):
    positions, triangles = needles(2000)
    options = replace(OPTIONS[layout], spatial_splits=True, split_budget=1.0)
    binary = build_binary(positions, triangles, options)
    mesh = collapse_mesh(binary, positions, triangles, layout)
    check_parts(mesh, positions, triangles)
    faces = triangle_faces(layout, mesh.triangles).reshape(len(mesh.triangles), -1)
    assert mesh.reference_count > 1.05 * len(triangles)
    walk = walk_tree(layout, mesh.nodes)
    for first, count in zip(walk.leaf_first, walk.leaf_count):
        listed = faces[first : first + count]
        listed = listed[listed >= 0]
        assert len(np.unique(listed)) == len(listed)


@both
def test_margins_of_parts_are_those_of_the_whole_triangle(layout):
    """A large triangle in the plane z = 0, cut into cells: even a node over small boxes near the centre needs a large
    margin.
    """
    size = np.float32(1024)
    positions = size * np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]], np.float32)
    triangles = np.array([[0, 1, 2], [1, 3, 2]], np.int32)
    nodes, references, waiting = [np.zeros(8, np.float32)], [], [(0, -size, size, -size, size, 0)]
    while waiting:
        i, x0, x1, y0, y1, level = waiting.pop()
        nodes[i][[0, 1, 4, 5]] = [x0, y0, x1, y1]
        links = nodes[i].view(np.int32)
        if level == 10:
            links[3], links[7] = len(references), 2
            references += [0, 1]
            continue
        links[3] = len(nodes)
        x, y = ((x0 + x1) / 2, y1) if level % 2 else (x1, (y0 + y1) / 2)
        waiting += [(len(nodes), x0, x, y0, y, level + 1)]
        waiting += [(len(nodes) + 1, x if level % 2 else x0, x1, y0 if level % 2 else y, y1, level + 1)]
        nodes += [np.zeros(8, np.float32), np.zeros(8, np.float32)]
    built = build_binary(positions, triangles).statistics
    binary = BinaryTree(
        np.array(nodes), np.array(references, np.int32), replace(built, duplicate_count=len(references) - 2)
    )
    mesh = collapse_mesh(binary, positions, triangles, layout, CollapseCost(node=1e-6, unit=1.0))
    check_parts(mesh, positions, triangles)
    children = decode_children(layout, mesh.nodes)
    there = np.isfinite(children.low[..., 2])
    assert mesh.node_count > 30
    assert (children.low[there][:, 2] <= -SLAB_MARGIN * 1024).all() and (
        children.high[there][:, 2] >= SLAB_MARGIN * 1024
    ).all()


def test_slots_follow_the_octants():
    positions = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    small = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.1]], np.float32)
    # eight corners with four triangles each: more than a leaf
    corners = (
        positions[:, None, None] + small + np.linspace(0, 0.01, 4, dtype=np.float32)[None, :, None, None]
    ).reshape(-1, 3)
    mesh = wide(corners, np.arange(96, dtype=np.int32).reshape(-1, 3), Layout.QUANTISED)
    children = decode_children(Layout.QUANTISED, mesh.nodes[:1])
    middle = (children.low + children.high)[0] / 2
    sides = np.array([[s >> 2 & 1, s >> 1 & 1, s & 1] for s in range(8)])
    assert np.array_equal(middle > 0, sides == 1)


@both
def test_entries(layout):
    rng = np.random.default_rng(3)
    low = rng.uniform(-100, 100, (77, 3)).astype(np.float32)
    high = low + rng.uniform(0, 30, (77, 3)).astype(np.float32)
    top = collapse_entries(build_binary_from_boxes(low, high, BuildOptions(leaf_group=1, leaf_max=1)), layout)
    assert sorted(top.order.tolist()) == list(range(77))
    walk = walk_tree(layout, top.nodes)
    assert sorted(
        np.concatenate([np.arange(a, a + n) for a, n in zip(walk.leaf_first, walk.leaf_count)]).tolist()
    ) == list(range(77))
    box = np.stack([low, high]).astype(np.float64) - top.centre.astype(np.float64)
    margin = SLAB_MARGIN * np.abs(box).max((0, 2))[:, None]
    for first, count, leaf_low, leaf_high in zip(walk.leaf_first, walk.leaf_count, walk.leaf_low, walk.leaf_high):
        listed = top.order[first : first + count]
        assert (leaf_low <= box[0, listed] - margin[listed]).all() and (
            leaf_high >= box[1, listed] + margin[listed]
        ).all()
    assert np.array_equal(top.box, [low.min(0), high.max(0)])


def test_leaves_that_do_not_fit_are_refused():
    positions, triangles = soup(300)
    with pytest.raises(ValueError, match="lists more"):
        collapse_mesh(build_binary(positions, triangles, BuildOptions()), positions, triangles, Layout.QUANTISED)


def test_a_child_before_its_parent_is_refused():
    positions, triangles = soup(300)
    binary = build_binary(positions, triangles, BuildOptions())
    first, count = binary.links
    inner = np.flatnonzero(count == 0)[-1]
    first[inner] = inner - 1
    with pytest.raises(ValueError, match="come after"):
        collapse_mesh(binary, positions, triangles, Layout.BOXES)


@both
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_random_meshes(layout, data):
    count = data.draw(st.integers(1, 60))
    grid = data.draw(st.sampled_from([0, 1, 3, 50]))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    positions = rng.normal(size=(count + 2, 3)) if grid == 0 else rng.integers(0, grid + 1, (count + 2, 3))
    scale = 10.0 ** rng.uniform(*data.draw(st.sampled_from([(0, 0), (-6, 6)])), 3)
    positions = (positions * scale + data.draw(st.sampled_from([0.0, 1e4]))).astype(np.float32)
    triangles = rng.integers(0, len(positions), (count, 3)).astype(np.int32)
    check_whole(wide(positions, triangles, layout), positions, triangles)
    binary = build_binary(positions, triangles, replace(OPTIONS[layout], spatial_splits=True, split_budget=2.0))
    mesh = collapse_mesh(binary, positions, triangles, layout)
    check_blocks(mesh, positions, triangles)
    check_parts(mesh, positions, triangles, samples=20)
