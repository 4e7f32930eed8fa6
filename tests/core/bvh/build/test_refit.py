"""Trees for new positions: boxes hold what they must, and the cost tells when to build again."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from raybatch_addon.core.bvh.build.collapse import collapse_mesh
from raybatch_addon.core.bvh.build.cpu.build import build_binary
from raybatch_addon.core.bvh.build.refit import node_levels, refit_quantised
from raybatch_addon.core.bvh.node import Layout, triangle_faces
from tests.support.under_test import DEVICE
from tests.support.wide_trees import OPTIONS, check_whole, needles, refit_mesh, soup, sphere, wide

both = pytest.mark.parametrize("layout", Layout)


@both
def test_same_positions_give_the_same_tree(layout):
    positions, triangles = sphere(40)
    mesh = wide(positions, triangles, layout)
    again = refit_mesh(mesh, positions, triangles)
    assert np.array_equal(again.nodes.view(np.uint32), mesh.nodes.view(np.uint32))
    assert np.array_equal(again.triangles.view(np.uint32), mesh.triangles.view(np.uint32))
    assert np.array_equal(again.centre, mesh.centre) and np.array_equal(again.box, mesh.box)
    assert again.sah == pytest.approx(mesh.sah, rel=1e-9)


@both
def test_moved_positions(layout):
    positions, triangles = soup(2000)
    mesh = wide(positions, triangles, layout)
    before = mesh.nodes.copy()
    moved = (positions * np.array([3, 0.5, 1]) + np.array([7, -2, 1e3]) + np.sin(9 * positions)).astype(np.float32)
    refitted = refit_mesh(mesh, moved, triangles)
    check_whole(refitted, moved, triangles)
    assert refitted.depth == mesh.depth and refitted.leaf_count == mesh.leaf_count
    assert np.array_equal(mesh.nodes.view(np.uint32), before.view(np.uint32))


@both
def test_cost_grows_when_triangles_mix(layout):
    positions, triangles = sphere(30)
    mesh = wide(positions, triangles, layout)
    turned = refit_mesh(mesh, 2 * positions[:, [1, 2, 0]], triangles)
    assert turned.sah == pytest.approx(mesh.sah, rel=1e-6)
    mixed = refit_mesh(mesh, np.random.default_rng(0).permutation(positions), triangles)
    check_whole(mixed, np.random.default_rng(0).permutation(positions), triangles)
    assert mixed.sah > 3 * mesh.sah


@both
def test_split_triangles_become_whole(layout):
    positions, triangles = needles(2000)
    options = replace(OPTIONS[layout], spatial_splits=True, split_budget=1.0)
    mesh = collapse_mesh(build_binary(positions, triangles, options), positions, triangles, layout)
    assert mesh.reference_count > 1.05 * len(triangles)
    refitted = refit_mesh(mesh, positions, triangles)
    check_whole(refitted, positions, triangles, once=False)
    assert refitted.sah > mesh.sah
    assert np.array_equal(triangle_faces(layout, refitted.triangles), triangle_faces(layout, mesh.triangles))


@both
def test_triangles_that_collapse_to_a_point(layout):
    positions, triangles = soup(100)
    refitted = refit_mesh(wide(positions, triangles, layout), np.full_like(positions, 3.5), triangles)
    check_whole(refitted, np.full_like(positions, 3.5), triangles)
    assert np.isfinite(refitted.sah)


def test_on_the_device_as_on_the_host():
    positions, triangles = soup(2000)
    moved = (positions + np.cos(5 * positions)).astype(np.float32)
    mesh = wide(positions, triangles, Layout.QUANTISED)
    expected = refit_mesh(mesh, moved, triangles)

    def vectors(words: np.ndarray) -> wp.array:
        return wp.array(words.view(np.float32).reshape(-1, 4), dtype=wp.vec4, device=DEVICE)

    # the tree lies among others
    nodes = vectors(np.concatenate([mesh.nodes[:5], mesh.nodes, mesh.nodes[:3]]))
    blocks = vectors(np.concatenate([mesh.triangles[:7], mesh.triangles]))
    result = refit_quantised(
        nodes[25 : 25 + 5 * mesh.node_count],
        blocks[21:],
        node_levels(mesh.nodes, DEVICE),
        wp.array(moved, dtype=wp.vec3, device=DEVICE),
        wp.array(triangles, dtype=wp.vec3i, device=DEVICE),
    )
    written = nodes.numpy().view(np.uint32).reshape(-1, 20)
    assert np.array_equal(written[5:-3], expected.nodes)
    assert np.array_equal(written[:5], mesh.nodes[:5]) and np.array_equal(written[-3:], mesh.nodes[:3])
    assert np.array_equal(blocks.numpy().view(np.uint32).reshape(-1, 12)[7:], expected.triangles.view(np.uint32))
    assert np.array_equal(result.centre, expected.centre) and np.array_equal(result.box, expected.box)
    assert result.sah == pytest.approx(expected.sah, rel=1e-12)


def test_levels_hold_each_node_once_below_the_node_that_holds_it():
    mesh = wide(*soup(3000), Layout.QUANTISED)
    levels = node_levels(mesh.nodes, "cpu")
    assert sorted(levels.nodes.numpy().tolist()) == list(range(mesh.node_count))
    assert levels.first[:2] == [0, 1] and levels.first[-1] == mesh.node_count and len(levels.first) == mesh.depth + 1


@both
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_random_motion(layout, data):
    count = data.draw(st.integers(1, 60))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    positions = rng.normal(size=(count + 2, 3)).astype(np.float32)
    triangles = rng.integers(0, len(positions), (count, 3)).astype(np.int32)
    scale = 10.0 ** rng.uniform(*data.draw(st.sampled_from([(0, 0), (-6, 6), (-18, -17), (17, 18)])), 3)
    grid = data.draw(st.sampled_from([0, 1, 8]))
    moved = rng.normal(size=positions.shape) if grid == 0 else rng.integers(0, grid + 1, positions.shape)
    moved = (moved * scale).astype(np.float32)
    check_whole(refit_mesh(wide(positions, triangles, layout), moved, triangles), moved, triangles)
