"""The device's own tree build: complete, with its margins, as good as the CPU's, the same each time."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.binary import BuildOptions
from raybatch_addon.core.bvh.build.collapse import CollapseCost, collapse_mesh
from raybatch_addon.core.bvh.build.cpu.build import build_binary
from raybatch_addon.core.bvh.build.cuda import build as build_cuda
from raybatch_addon.core.bvh.build.cuda.build import LEVELS_MAX, DeviceMesh, build_mesh, build_top
from raybatch_addon.core.bvh.margin import SLAB_MARGIN
from raybatch_addon.core.bvh.node import Layout, WideMesh, aligned_empty, decode_children
from raybatch_addon.core.errors import OutOfMemoryError, SceneError
from tests.support.wide_trees import check_whole, soup, sphere
from tests.twins.tree_walk import walk_tree


def build(device: str, positions: np.ndarray, triangles: np.ndarray, **options) -> DeviceMesh:
    """The tree of a whole mesh."""
    return build_mesh(*uploaded(device, positions, triangles), 0, len(triangles), **options)


def uploaded(device: str, positions: np.ndarray, triangles: np.ndarray) -> tuple[wp.array, wp.array]:
    return wp.array(positions, dtype=wp.vec3, device=device), wp.array(triangles, dtype=wp.vec3i, device=device)


def words(array: wp.array, row: int, dtype: type) -> np.ndarray:
    """The bits of vectors on the device, `row` words in a row."""
    host = array.numpy().reshape(-1, row).view(dtype)
    aligned = aligned_empty(host.shape, dtype)
    aligned[:] = host
    return aligned


def on_host(mesh: DeviceMesh) -> WideMesh:
    """The same tree in the host's form."""
    return WideMesh(
        layout=Layout.QUANTISED,
        nodes=words(mesh.nodes, 20, np.uint32),
        centre=mesh.centre,
        box=mesh.box,
        depth=mesh.depth,
        leaf_count=mesh.leaf_count,
        reference_count=mesh.triangle_count,
        sah=mesh.sah,
        triangles=words(mesh.triangles, 12, np.float32),
        triangle_count=mesh.triangle_count,
    )


def check(mesh: DeviceMesh, positions: np.ndarray, triangles: np.ndarray) -> None:
    """Every triangle once, every box with its margin, levels one after another, a depth that a stack holds."""
    host = on_host(mesh)
    check_whole(host, positions, triangles)
    depth = walk_tree(Layout.QUANTISED, host.nodes).depth
    assert (np.diff(depth) >= 0).all()
    assert mesh.level_first == np.searchsorted(depth, np.arange(mesh.depth + 1)).tolist()
    assert mesh.depth <= LEVELS_MAX


@pytest.mark.parametrize("mesh", [sphere(40), soup(3000), soup(500, size=2.0)], ids=["sphere", "soup", "overlapping"])
def test_every_triangle_is_reached_once_in_boxes_with_their_margin(device, mesh):
    check(build(device, *mesh), *mesh)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 8, 9, 24, 25])
def test_few_triangles(device, count):
    check(build(device, *soup(count)), *soup(count))


def test_no_triangles(device):
    mesh = build(device, *soup(0))
    assert (mesh.node_count, mesh.depth, mesh.triangles.size, mesh.nodes.size) == (0, 0, 0, 0)


def test_a_range_of_shared_triangles(device):
    positions, triangles = soup(700)
    mesh = build_mesh(*uploaded(device, positions, triangles), 250, 300)
    check(mesh, positions, triangles[250:550])


@pytest.mark.parametrize("mesh", [sphere(60), soup(10000), soup(2000, size=1.0)], ids=["sphere", "soup", "overlapping"])
def test_cost_is_near_that_of_the_binned_build(device, mesh):
    binary = build_binary(*mesh, BuildOptions(leaf_group=1, leaf_max=1))
    expected = collapse_mesh(binary, *mesh, Layout.QUANTISED)
    assert build(device, *mesh).sah < 1.25 * expected.sah


def test_reinsertion_lowers_the_cost_and_keeps_a_tree(device, monkeypatch):
    mesh = soup(4000, size=0.05)
    improved = build(device, *mesh)
    monkeypatch.setattr(build_cuda, "reinsert", lambda nodes, links: 0)
    plain = build(device, *mesh)
    check(plain, *mesh)
    assert plain.statistics.reinsert_rounds == 0 and improved.statistics.reinsert_rounds > 3
    assert improved.sah < 0.95 * plain.sah


def test_cost_is_that_of_its_boxes(device):
    mesh = sphere(30)
    cost = CollapseCost(1.5, 0.5)
    built = build(device, *mesh, cost=cost)
    children = decode_children(Layout.QUANTISED, on_host(built).nodes)
    size = np.where(np.isfinite(children.low), children.high - children.low, 0)
    area = size[..., 0] * size[..., 1] + size[..., 1] * size[..., 2] + size[..., 2] * size[..., 0]
    root = (built.box[1] - built.box[0]).astype(np.float64)
    root_area = root[0] * root[1] + root[1] * root[2] + root[2] * root[0]
    expected = 1.5 + (1.5 * area * (children.inner >= 0) + 0.5 * area * children.count).sum() / root_area
    assert built.sah <= expected < 1.05 * built.sah  # boxes lie on a grid of up to 255 steps
    assert built.sah == pytest.approx(1.5 * built.statistics.node_steps + 0.5 * built.statistics.unit_tests)


def test_two_builds_give_the_same_bits(device):
    mesh = soup(5000, size=0.3)
    first, second = build(device, *mesh), build(device, *mesh)
    assert np.array_equal(words(first.nodes, 20, np.uint32), words(second.nodes, 20, np.uint32))
    assert np.array_equal(words(first.triangles, 12, np.uint32), words(second.triangles, 12, np.uint32))


@pytest.mark.parametrize("scale", [1e-18, 1e-9, 1.0, 1e9, 1e18])
def test_extents(device, scale):
    positions, triangles = soup(300)
    positions = (positions * np.float32(scale)).astype(np.float32)
    mesh = build(device, positions, triangles)
    check(mesh, positions, triangles)
    assert mesh.sah == pytest.approx(build(device, *soup(300)).sah, rel=1e-3)


@pytest.mark.parametrize("flat", [[1, 1, 0], [0, 1, 0], [0, 0, 0], [1e-3, 1e6, 1]])
def test_far_from_the_origin_and_flat(device, flat):
    positions, triangles = soup(300)
    moved = (positions * flat + np.array([1e6, -3e5, 12.5])).astype(np.float32)
    check(build(device, moved, triangles), moved, triangles)


def test_many_copies_of_one_triangle_make_a_shallow_tree(device):
    positions, _ = soup(1)
    triangles = np.tile(np.arange(3, dtype=np.int32), (20000, 1))
    mesh = build(device, positions, triangles)
    check(mesh, positions, triangles)
    assert mesh.depth <= 8 and mesh.statistics.merge_rounds <= 15
    assert mesh.node_count < 20000 / 12


def test_equal_middles(device):
    positions, triangles = soup(2000)
    corners = positions.reshape(-1, 3, 3)
    corners = corners - (corners.min(1, keepdims=True) + corners.max(1, keepdims=True)) / 2
    positions = np.ascontiguousarray(corners.reshape(-1, 3))
    check(build(device, positions, triangles), positions, triangles)


def graded(count: int, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles in a row, each larger than the one before: every cluster prefers its smaller neighbour."""
    size = ratio ** np.arange(count)
    place = np.cumsum(size) - size
    corners = np.zeros((count, 3, 3))
    corners[:, :, 0] = place[:, None] + size[:, None] * [0, 1, 0]
    corners[:, :, 1] = size[:, None] * [0, 0, 1]
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


@pytest.mark.parametrize("count, ratio", [(4000, 1.002), (600, 1.1), (120, 2.0)])
def test_a_row_of_growing_triangles_takes_few_rounds(device, count, ratio):
    mesh = build(device, *graded(count, ratio))
    check(mesh, *graded(count, ratio))
    assert mesh.statistics.merge_rounds < 80
    binary = build_binary(*graded(count, ratio), BuildOptions(leaf_group=1, leaf_max=1))
    assert mesh.sah < 1.25 * collapse_mesh(binary, *graded(count, ratio), Layout.QUANTISED).sah


def test_a_tree_that_is_too_deep_is_built_again(device, monkeypatch):
    mesh = graded(600, 1.1)
    assert build(device, *mesh).depth > 12
    monkeypatch.setattr(build_cuda, "LEVELS_MAX", 12)
    monkeypatch.setattr(build_cuda, "ROUND_LIMIT_DEEP", 0)
    again = build(device, *mesh)
    check(again, *mesh)
    assert again.depth <= 12
    assert again.statistics.rebuilt and again.statistics.merge_rounds == 10  # halves of the Morton order


@pytest.mark.parametrize("count", [0, 1, 5, 400])
def test_a_tree_over_boxes_lists_each_once_and_alone(device, count):
    corners = soup(count, size=0.2)[0].reshape(-1, 3, 3)
    low, high = corners.min(1), corners.max(1)
    top = build_top(*(wp.array(corner, dtype=wp.vec3, device=device) for corner in (low, high)))
    order = top.order.numpy()
    assert sorted(order) == list(range(count))
    if count == 0:
        assert top.node_count == 0
        return
    nodes = words(top.nodes, 20, np.uint32)
    walk = walk_tree(Layout.QUANTISED, nodes)
    assert walk.depth.max() + 1 == top.depth and (walk.leaf_count == 1).all()
    entry = order[walk.leaf_first]
    margin = SLAB_MARGIN * np.maximum(low[entry] - top.centre, high[entry] - top.centre).astype(np.float64)
    assert (walk.leaf_low <= low[entry].astype(np.float64) - top.centre - margin).all()
    assert (walk.leaf_high >= high[entry].astype(np.float64) - top.centre + margin).all()


def test_what_does_not_fit_is_reported_with_its_size(device, monkeypatch):
    positions, triangles = uploaded(device, *soup(1))
    with pytest.raises(SceneError, match="holds 715,827,882 triangles, not 1,000,000,000"):
        build_mesh(positions, triangles, 0, 10**9)
    monkeypatch.setattr(build_cuda, "free_memory", lambda device: 10**9)
    with pytest.raises(
        OutOfMemoryError, match="268,435,456 triangles needs 33.55 GB while it is built, and .* has 1.00 GB free"
    ):
        build_mesh(positions, triangles, 0, 2**28)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("vertex", [12, 13, 14])
def test_coordinates_that_are_not_finite_are_reported(device, value, vertex):
    positions, triangles = soup(10)
    positions[vertex, 1] = value
    with pytest.raises(SceneError, match="not a finite number"):
        build(device, positions, triangles)
    boxes = [wp.array(corner, dtype=wp.vec3, device=device) for corner in (positions, positions)]
    with pytest.raises(SceneError, match="not a finite number"):
        build_top(*boxes)
