"""Trees for ranges of time: the same hits as of one, fewer nodes where that pays, and nothing where it does not."""

import numpy as np
import pytest

from raybatch_addon.core.bvh.build.entries import entries_of
from raybatch_addon.core.bvh.build.time_ranges import (
    RANGE_GAIN_LEAST,
    RANGES_MOST,
    best_count,
    bounds,
    vertices_between,
)
from raybatch_addon.core.bvh.build.top_level import Listed, OverTime
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.treelets.cut import CutRule
from raybatch_addon.core.bvh.treelets.tree import cut_scene_tree
from raybatch_addon.core.scene.flatten import flatten
from tests.core.bvh.build.ranges_scenes import crossing, flying, swaying, traced, tree_of
from tests.support import scenes

layouts = pytest.mark.parametrize("layout", list(Layout))


def test_ranges_are_doubled_as_long_as_each_pays():
    assert best_count([10.0]) == 1
    assert best_count([10.0, 9.1, 8.9]) == 1
    assert best_count([10.0, 6.0, 5.8, 5.7]) == 2
    assert best_count([10.0, 9.9, 5.0, 4.9]) == 4, "what pays together counts, not each step alone"
    assert best_count([(1 - 1.01 * RANGE_GAIN_LEAST) ** i for i in range(4)]) == 8


@pytest.mark.parametrize("steps", [2, 3, 4, 6])
@pytest.mark.parametrize("reach", [1.0, 1e5])
def test_boxes_hold_what_traversal_mixes_at_any_time_of_a_range(steps, reach):
    """In the float32 of `native/traverse/motion.h`, at times at and beside the ends of ranges too."""
    rng = np.random.default_rng(1)
    at = (rng.normal(size=(steps, 500, 3)) * rng.choice([1e-6, 1.0, reach], (1, 500, 1))).astype(np.float32)
    at[:, :50] = at[0, :50]  # some stand still
    for count in (1, 2, 4, 8):
        for index in range(count):
            corners = np.stack(vertices_between(at, *bounds(index, count)))
            low, high = corners.min(0), corners.max(0)
            first, last = (np.float32(each) for each in bounds(index, count))
            inside = np.float32(first + (last - first) * rng.random(40, np.float32))
            for time in (first, np.nextafter(first, last), *inside, np.nextafter(last, first), last):
                assert last == 1 or time == last or int(time * np.float32(count)) == index
                place = time * np.float32(steps - 1)
                step = min(int(place), steps - 2)
                a, b, share = at[step], at[step + 1], place - np.float32(step)
                mixed = np.clip(a + share * (b - a), np.minimum(a, b), np.maximum(a, b))
                assert mixed.dtype == np.float32 and ((mixed >= low) & (mixed <= high)).all()
            if count > 1:
                whole = at.max(0) - at.min(0)
                assert (high - low).sum() < 0.9 * whole.sum()


def test_entries_over_ranges_of_their_meshes_are_listed_once_for_each():
    listed = Listed.of(np.array([0, 1, 1, 2]), np.array([1, 4, 2]), 4)
    assert listed.source.tolist() == [0, 1, 2, 3, 1, 1, 1, 2, 2, 2, 3]
    for k, there in enumerate(listed.of_range):
        assert listed.source[there].tolist() == [0, 1, 2, 3]
        assert listed.range[there].tolist() == [0, k, k, k // 2]


SCENES = {
    "flying": flying,
    "flying far": lambda: flying(far=1e5),
    "swaying": swaying,
    "strands": lambda: swaying(segments=True),
    "one of many": crossing,
}


@layouts
@pytest.mark.parametrize("name", SCENES)
def test_hits_are_the_same_in_any_number_of_ranges(layout, name):
    scene = SCENES[name]()
    whole = traced(tree_of(scene, layout, 1))
    assert (whole["hit_instance"] >= 0).mean() > 0.05
    for count in (2, RANGES_MOST):
        built = tree_of(scene, layout, count)
        assert built.tree.top_ranges == count == len(built.top_first) - 1
        found = traced(built)
        for key, values in whole.items():
            np.testing.assert_array_equal(found[key], values, err_msg=key)
        occluded = traced(built, any_hit=True)["hit_instance"]
        np.testing.assert_array_equal(occluded >= 0, whole["hit_instance"] >= 0)


@layouts
def test_rays_visit_fewer_nodes_among_things_that_fly_far(layout):
    scene = flying(200)
    whole, built = traced(tree_of(scene, layout, 1), counted=True), tree_of(scene, layout, None)
    assert built.tree.top_ranges == built.statistics["time_ranges"] > 1
    ranged = traced(built, counted=True)
    assert 1.5 * ranged["node_steps"].sum() < whole["node_steps"].sum()


@layouts
@pytest.mark.parametrize("segments", [False, True])
def test_rays_test_fewer_triangles_of_meshes_that_sway(layout, segments):
    scene = swaying(segments=segments)
    whole, built = traced(tree_of(scene, layout, 1), counted=True), tree_of(scene, layout, None)
    ranged = traced(built, counted=True)
    assert 1.3 * ranged["triangle_tests"].sum() < whole["triangle_tests"].sum()
    (mesh,) = (mesh for mesh in built.meshes if mesh.ranges)
    # both instances of it, once more for each further range
    assert built.tree.entry_count == 3 + 2 * (mesh.ranges.count - 1)
    assert sum(each.nodes is not None for each in mesh.over_time) == 0, "those that are not used are given up"


@layouts
def test_a_large_scene_in_which_one_thing_moves_has_one_top_level(layout):
    built, one = tree_of(crossing(), layout, None), tree_of(crossing(), layout, 1)
    assert built.tree.top_ranges == 1 and built.statistics == {**one.statistics, "seconds": built.statistics["seconds"]}


@layouts
def test_a_still_scene_has_nothing_for_ranges(layout):
    ball = (scenes.sphere(), scenes.IDENTITY, scenes.diffuse(0.5))
    tree = tree_of(scenes.scene([ball, ball]), layout, None).tree
    assert (tree.top_ranges, tree.range_node, tree.range_centre) == (0, None, None)


@layouts
def test_cut_trees_have_the_top_levels_of_all_ranges(layout):
    built = tree_of(swaying(), layout, 4)
    cut = cut_scene_tree(built, CutRule(size=6), built.tree.nodes.device)
    first = cut.tree.range_node.numpy()
    assert len(first) == 4 and (np.diff(first) > 0).all() and first[0] == cut.tree.top_node
    nodes = cut.tree.nodes.numpy().view(layout.node_type).reshape(-1, layout.node_words)
    old = built.tree.nodes.numpy().view(layout.node_type).reshape(-1, layout.node_words)[built.tree.top_node :]
    np.testing.assert_array_equal(nodes[cut.tree.top_node :], old[: built.top_first[-1]])
    assert cut.tree.entry_node.numpy().max() < cut.tree.top_node


def test_there_are_no_more_top_levels_than_there_is_room_for():
    entries = entries_of(flatten(flying(50)), np.full(50, 1))
    count = entries.mesh.max() + 1
    boxes = np.tile(0.05 * np.array([[-1.0] * 3, [1.0] * 3]), (count, 1, 1))
    times = OverTime(entries, boxes, np.ones(count), np.zeros(count, bool))
    assert times.count(1 << 30) == 8
    assert [times.count(64 * 50 * ranges) for ranges in (1, 2, 7, 8)] == [1, 2, 4, 8]
