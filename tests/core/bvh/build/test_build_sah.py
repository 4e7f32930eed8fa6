"""The CPU builder: sound trees for any mesh, the same for any number of threads, no worse than a plain builder's."""

import dataclasses
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raybatch_addon.core.bvh.build.binary import DEPTH_MAX, BinaryTree, BuildOptions, expected_visits
from raybatch_addon.core.bvh.build.cpu.build import CHUNK_MIN, build_binary, build_binary_from_boxes
from raybatch_addon.core.errors import OutOfMemoryError, SceneError
from tests.support import scenes

WIDE = BuildOptions()
NARROW = BuildOptions(leaf_group=1, leaf_max=3)


def soup(count: int, seed: int = 0, size: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Random triangles of about `size` in the unit cube."""
    random = np.random.default_rng(seed)
    corners = random.random((count, 1, 3)) + size * random.normal(size=(count, 3, 3))
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def sphere(segments: int, rings: int) -> tuple[np.ndarray, np.ndarray]:
    mesh = scenes.sphere(segments=segments, rings=rings)
    return mesh.positions, mesh.triangles


def check_tree(tree: BinaryTree, low: np.ndarray, high: np.ndarray, options: BuildOptions) -> None:
    """Every node has one parent, every box holds what is below it, tightly, every triangle is listed, and the figures
    are true.
    """
    a, count = tree.links
    leaf, inner = np.flatnonzero(count > 0), np.flatnonzero(count == 0)
    children = np.concatenate([a[inner], a[inner] + 1])
    assert np.array_equal(np.sort(children), np.arange(1, len(tree.nodes)))
    assert count.min() >= 0 and count.max() <= options.leaf_max
    order = np.argsort(a[leaf])
    assert np.array_equal(np.cumsum(count[leaf][order])[:-1], a[leaf][order][1:]) and count.sum() == len(
        tree.references
    )
    listed = np.bincount(tree.references, minlength=len(low))
    assert len(listed) == len(low) and listed.min() >= 1

    below_low, below_high = tree.nodes[:, :3].copy(), tree.nodes[:, 4:7].copy()
    below_low[inner] = np.minimum(tree.nodes[a[inner], :3], tree.nodes[a[inner] + 1, :3])
    below_high[inner] = np.maximum(tree.nodes[a[inner], 4:7], tree.nodes[a[inner] + 1, 4:7])
    assert np.array_equal(below_low, tree.nodes[:, :3]) and np.array_equal(below_high, tree.nodes[:, 4:7])
    if not tree.statistics.duplicate_count:
        for node in leaf[:: max(1, len(leaf) // 500)]:
            held = tree.references[a[node] : a[node] + count[node]]
            assert np.array_equal(low[held].min(0), tree.nodes[node, :3]) and np.array_equal(
                high[held].max(0), tree.nodes[node, 4:7]
            )

    depth = np.zeros(len(tree.nodes), int)
    level = np.zeros(1, int)
    deepest = 0
    while len(level := level[count[level] == 0]):
        deepest += 1
        level = np.concatenate([a[level], a[level] + 1])
        depth[level] = deepest
    statistics = tree.statistics
    assert deepest == statistics.depth <= DEPTH_MAX
    assert statistics.triangle_count == len(low) and statistics.node_count == len(tree.nodes)
    assert statistics.reference_count == len(tree.references) == len(low) + statistics.duplicate_count
    assert statistics.leaf_count == len(leaf) and statistics.leaf_largest == count.max()
    assert statistics.memory_peak >= tree.nodes.nbytes + tree.references.nbytes and statistics.seconds > 0
    assert (statistics.node_steps, statistics.group_tests) == expected_visits(tree.nodes, options.leaf_group)


def checked(positions: np.ndarray, triangles: np.ndarray, options: BuildOptions = WIDE) -> BinaryTree:
    tree = build_binary(positions, triangles, options)
    corners = np.asarray(positions, np.float32)[triangles]
    check_tree(tree, corners.min(1), corners.max(1), options)
    return tree


def diagonals(count: int, specks: int = 0, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Long thin triangles in all directions among many small ones, in a cube of size 1."""
    random = np.random.default_rng(seed)
    along = random.normal(size=(count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    start = random.random((count, 3))
    corners = np.stack([start, start + along, start + 0.01 * random.normal(size=(count, 3))], 1)
    positions, _triangles = soup(specks, seed, size=0.01)
    return np.concatenate([corners.reshape(-1, 3).astype(np.float32), positions]), np.arange(
        3 * (count + specks), dtype=np.int32
    ).reshape(-1, 3)


def check_coverage(tree: BinaryTree, positions: np.ndarray, triangles: np.ndarray, samples: int = 60) -> None:
    """Every point of a triangle lies in the box of a leaf that lists the triangle."""
    a, count = tree.links
    leaf = np.flatnonzero(count > 0)
    leaf = np.repeat(leaf[order := np.argsort(a[leaf])], count[leaf][order])
    by_triangle = np.argsort(tree.references, kind="stable")
    triangle, boxes = tree.references[by_triangle], tree.nodes[leaf[by_triangle]].astype(np.float64)
    weights = np.random.default_rng(2).dirichlet((0.5, 0.5, 0.5), samples)
    weights[:3] = np.eye(3)
    weights[3:9, 0] = 0  # along an edge
    weights[3:9] /= weights[3:9].sum(1, keepdims=True)
    points = np.einsum("sc,tck->tsk", weights, positions.astype(np.float64)[triangles])
    rounding = (
        2.0**-50 * np.abs(positions.astype(np.float64)[triangles]).max((1, 2))[triangle, None, None]
    )  # of the points
    inside = (
        (points[triangle] >= boxes[:, None, :3] - rounding) & (points[triangle] <= boxes[:, None, 4:7] + rounding)
    ).all(-1)
    covered = np.logical_or.reduceat(inside, np.searchsorted(triangle, np.arange(len(triangles))))
    assert covered.all(), np.argwhere(~covered)[:5]


def plain_cost(low: np.ndarray, high: np.ndarray, options: BuildOptions) -> float:
    """Cost of a tree that splits at the best of all positions of all axes by the surface area heuristic, with no bins,
    in NumPy.
    """

    def area(low, high):
        x, y, z = np.moveaxis(high - low, -1, 0)
        return x * y + y * z + z * x

    def groups(count):
        return -(-count // options.leaf_group)

    def build(low, high) -> float:
        count = len(low)
        own = float(area(low.min(0), high.max(0)))
        best, choice = np.inf, None
        left_count = np.arange(1, count)
        for axis in range(3) if count > 1 else ():
            order = np.argsort((low + high)[:, axis], kind="stable")
            lows, highs = low[order], high[order]
            left = area(np.minimum.accumulate(lows)[:-1], np.maximum.accumulate(highs)[:-1])
            right = area(np.minimum.accumulate(lows[::-1])[::-1][1:], np.maximum.accumulate(highs[::-1])[::-1][1:])
            costs = left * groups(left_count) + right * groups(count - left_count)
            at = int(costs.argmin())
            if costs[at] < best:
                best, choice = costs[at], (order[: at + 1], order[at + 1 :])
        if choice is None or (count <= options.leaf_max and own * groups(count) <= options.step_cost * own + best):
            return own * groups(count)
        return own * options.step_cost + sum(build(low[side], high[side]) for side in choice)

    low, high = low.astype(np.float64), high.astype(np.float64)
    return build(low, high) / float(area(low.min(0), high.max(0)))


@pytest.mark.parametrize("options", [WIDE, NARROW], ids=["wide", "narrow"])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 8, 9, 50, 1000, 3 * CHUNK_MIN])
def test_random_triangles_make_a_sound_tree(count, options):
    checked(*soup(count), options)


def test_no_triangles_make_no_nodes():
    tree = build_binary(np.zeros((3, 3), np.float32), np.zeros((0, 3), np.int32))
    assert tree.nodes.shape == (0, 8) and tree.references.shape == (0,) and tree.statistics.node_count == 0
    assert len(build_binary_from_boxes(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)).nodes) == 0


@pytest.mark.parametrize("options", [WIDE, NARROW], ids=["wide", "narrow"])
def test_threads_do_not_change_a_bit(options):
    positions, triangles = sphere(400, 200)
    assert len(triangles) > 8 * CHUNK_MIN
    trees = [
        build_binary(positions, triangles, BuildOptions(options.leaf_group, options.leaf_max, thread_count=n))
        for n in (1, 2, 5)
    ]
    for tree in trees[1:]:
        assert tree.nodes.tobytes() == trees[0].nodes.tobytes()
        assert tree.references.tobytes() == trees[0].references.tobytes()


def test_builds_side_by_side_are_each_as_if_alone():
    meshes = [soup(4000 + 9000 * i, seed=i) for i in range(4)]
    alone = [build_binary(*mesh) for mesh in meshes]
    found = [None] * len(meshes)

    def work(i):
        found[i] = build_binary(*meshes[i])

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(meshes))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for tree, again in zip(alone, found):
        assert tree.nodes.tobytes() == again.nodes.tobytes() and tree.references.tobytes() == again.references.tobytes()


@pytest.mark.parametrize("options", [WIDE, NARROW], ids=["wide", "narrow"])
@pytest.mark.parametrize("mesh", [soup(600), soup(600, size=0.01), sphere(24, 16)], ids=["soup", "specks", "sphere"])
def test_the_cost_is_close_to_that_of_a_builder_without_bins(mesh, options):
    positions, triangles = mesh
    corners = positions[triangles]
    tree = checked(positions, triangles, options)
    assert tree.statistics.sah_cost <= 1.05 * plain_cost(corners.min(1), corners.max(1), options)


DEGENERATE = {
    "one triangle many times": (np.eye(3, dtype=np.float32), np.tile(np.arange(3, dtype=np.int32), (40_000, 1))),
    "points at one place": (np.ones((3, 3), np.float32), np.zeros((1000, 3), np.int32)),
    "equal centroids": (
        np.concatenate([k * np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 1], [0, 1, -1]]) for k in range(1, 500)]).astype(
            np.float32
        ),
        np.concatenate([4 * k + np.array([[0, 1, 2], [0, 1, 3]]) for k in range(499)]).astype(np.int32),
    ),
    "points along a line": (
        np.linspace(0, 1, 3000, dtype=np.float32)[:, None] * np.array([1, 0, 0], np.float32),
        np.arange(3000, dtype=np.int32).reshape(-1, 3),
    ),
    "a plane": (np.pad(soup(2000)[0][:, :2], ((0, 0), (0, 1))), soup(2000)[1]),
}


@pytest.mark.parametrize("options", [WIDE, NARROW], ids=["wide", "narrow"])
@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_meshes(name, options):
    tree = checked(*DEGENERATE[name], options)
    # nothing that one may hope for is lost: as shallow as halving
    assert tree.statistics.depth <= 2 * int(np.ceil(np.log2(len(DEGENERATE[name][1])))) + 2


@pytest.mark.parametrize("scale", [1e-38, 1e-30, 1e-18, 1e-9, 1e9, 1e18, 1e30])
def test_the_tree_does_not_depend_on_the_unit_of_length(scale):
    """Powers of two scale every float exactly, so nothing but the boxes may change."""
    scale = np.float32(2.0 ** np.round(np.log2(scale)))
    positions, triangles = soup(3000, seed=3)
    positions = np.round(positions * 2**10) / 2**10  # no bit is lost in denormal numbers
    if scale < 1e-35:
        positions = positions * 2**12
    tree, scaled = build_binary(positions, triangles), build_binary(positions * scale, triangles)
    assert np.array_equal(tree.references, scaled.references)
    assert all(np.array_equal(x, y) for x, y in zip(tree.links, scaled.links))
    assert np.array_equal(tree.nodes[:, [0, 1, 2, 4, 5, 6]] * scale, scaled.nodes[:, [0, 1, 2, 4, 5, 6]])
    assert scaled.statistics.sah_cost == pytest.approx(tree.statistics.sah_cost)


def test_sizes_from_1e_18_to_1e18_in_one_mesh():
    size = np.geomspace(1e-18, 1e18, 4000)[:, None, None]
    corners = size * np.random.default_rng(1).normal(size=(4000, 3, 3))
    positions, triangles = corners.reshape(-1, 3).astype(np.float32), np.arange(12000, dtype=np.int32).reshape(-1, 3)
    for options in (WIDE, NARROW):
        checked(positions, triangles, options)


def test_a_tree_that_wants_to_be_deep_ends_at_depth_63():
    """Each split peels off the largest triangles only, again and again."""
    size = np.float64(2.0) ** -np.arange(0, 230)
    corners = (size[:, None, None] * np.array([[1, 0, 0], [1, 1e-6, 0], [1, 0, 1e-6]])).repeat(2, 0)
    positions, triangles = (
        (corners * 1e30).reshape(-1, 3).astype(np.float32),
        np.arange(len(corners) * 3, dtype=np.int32).reshape(-1, 3),
    )
    tree = checked(positions, triangles, BuildOptions(leaf_group=1, leaf_max=1, traversal_cost=0.01))
    assert tree.statistics.depth == DEPTH_MAX


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_small_mesh(data):
    count = data.draw(st.integers(1, 40))
    grid = data.draw(st.sampled_from([2, 5, 1000]))  # few places: many coincide
    numbers = data.draw(st.lists(st.integers(-grid, grid), min_size=9 * count, max_size=9 * count))
    scale = data.draw(st.sampled_from([1e-18, 1e-6, 1.0, 1e15]))
    positions = (np.array(numbers).reshape(-1, 3) * scale).astype(np.float32)
    options = BuildOptions(
        data.draw(st.integers(1, 8)),
        data.draw(st.integers(1, 8)),
        data.draw(st.sampled_from([0.1, 1.0, 3.0])),
        spatial_splits=data.draw(st.booleans()),
        split_budget=data.draw(st.sampled_from([0.1, 2.0])),
        split_overlap=0.0,
    )
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    check_coverage(checked(positions, triangles, options), positions, triangles)


SPATIAL = BuildOptions(spatial_splits=True)
SPATIAL_NARROW = BuildOptions(leaf_group=1, leaf_max=3, spatial_splits=True)


@pytest.mark.parametrize("options", [SPATIAL, SPATIAL_NARROW], ids=["wide", "narrow"])
def test_spatial_splits_lower_the_cost_of_long_thin_triangles_within_their_budget(options):
    mesh = diagonals(100, 3000)
    costs = [checked(*mesh, dataclasses.replace(options, spatial_splits=False)).statistics.sah_cost]
    for budget in (0.0, 0.03, 0.1, 0.3):
        tree = checked(*mesh, dataclasses.replace(options, split_budget=budget))
        check_coverage(tree, *mesh)
        assert tree.statistics.duplicate_count <= int(budget * 3100)
        costs.append(tree.statistics.sah_cost)
    assert costs[0] == costs[1] > costs[2] > costs[3] > costs[4]
    assert costs[4] < 0.7 * costs[0]


@pytest.mark.parametrize("scale, offset", [(1, 0), (1e-18, 0), (1e18, 0), (1e-3, 1e4), (1e-30, 0), (1.0, 1e6)])
def test_every_point_of_a_triangle_that_was_cut_is_in_a_box_of_its_references(scale, offset):
    positions, triangles = diagonals(400, seed=int(offset))
    positions = (positions * np.float32(scale) + np.array([offset, -offset, 0], np.float32)).astype(np.float32)
    options = BuildOptions(leaf_max=2, leaf_group=1, spatial_splits=True, split_budget=2.0, split_overlap=0.0)
    tree = checked(positions, triangles, options)
    assert tree.statistics.duplicate_count > 0
    check_coverage(tree, positions, triangles)


def test_cuts_through_corners_and_edges_lose_nothing():
    """Corners on a coarse grid lie on the planes of many bins."""
    random = np.random.default_rng(9)
    positions = random.integers(0, 9, (900, 3)).astype(np.float32) * np.float32(0.125)
    triangles = random.integers(0, 900, (600, 3)).astype(np.int32)
    options = BuildOptions(leaf_max=1, leaf_group=1, spatial_splits=True, split_budget=3.0, split_overlap=0.0)
    check_coverage(checked(positions, triangles, options), positions, triangles, samples=200)


def test_threads_do_not_change_a_bit_of_a_tree_with_spatial_splits():
    mesh = diagonals(500, 5 * CHUNK_MIN)
    trees = [build_binary(*mesh, dataclasses.replace(SPATIAL, thread_count=n)) for n in (1, 2, 5)]
    assert trees[0].statistics.duplicate_count > 0.1 * len(mesh[1])
    corners = mesh[0][mesh[1]]
    check_tree(trees[0], corners.min(1), corners.max(1), SPATIAL)
    check_coverage(trees[0], *mesh, samples=12)
    for tree in trees[1:]:
        assert tree.nodes.tobytes() == trees[0].nodes.tobytes()
        assert tree.references.tobytes() == trees[0].references.tobytes()


@pytest.mark.parametrize("name", DEGENERATE)
def test_spatial_splits_of_degenerate_meshes(name):
    positions, triangles = DEGENERATE[name]
    for options in (SPATIAL, dataclasses.replace(SPATIAL_NARROW, split_overlap=0.0)):
        tree = checked(positions, triangles, options)
        assert tree.statistics.duplicate_count <= 0.3 * len(triangles)
        check_coverage(tree, positions, triangles, samples=10)


@pytest.mark.parametrize("leaf_max", [1, 4, 8])
@pytest.mark.parametrize("count", [1, 7, 500])
def test_a_tree_over_boxes(count, leaf_max):
    random = np.random.default_rng(count)
    low = random.normal(size=(count, 3)).astype(np.float32)
    high = low + random.random((count, 3)).astype(np.float32)
    options = BuildOptions(leaf_group=1, leaf_max=leaf_max, traversal_cost=0.5)
    check_tree(build_binary_from_boxes(low, high, options), low, high, options)


def test_negative_zero_is_zero():
    corners = np.array(
        [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[-0.0, -0.0, -0.0], [-1, -0.0, 0], [-0.0, -1, 0]]], np.float32
    )
    tree = checked(corners.reshape(-1, 3), np.arange(6, dtype=np.int32).reshape(-1, 3), BuildOptions(leaf_max=1))
    assert not np.signbit(tree.nodes[:, [0, 1, 2, 4, 5, 6]][tree.nodes[:, [0, 1, 2, 4, 5, 6]] == 0]).any()


def test_too_many_triangles_are_refused_with_the_figure_needed(monkeypatch):
    with pytest.raises(SceneError, match="1,300,000,000 references"):
        BuildOptions(spatial_splits=True, split_budget=0.3).capacity(10**9)
    monkeypatch.setattr("raybatch_addon.core.bvh.build.cpu.build.free_memory", lambda device: 10_000)
    with pytest.raises(OutOfMemoryError, match="1,000 triangles takes about .* bytes"):
        build_binary(*soup(1000))


def test_options_are_checked():
    for wrong in (
        {"leaf_group": 0},
        {"leaf_max": 65},
        {"traversal_cost": 0},
        {"split_budget": -1},
        {"thread_count": -1},
    ):
        with pytest.raises(ValueError):
            BuildOptions(**wrong)
