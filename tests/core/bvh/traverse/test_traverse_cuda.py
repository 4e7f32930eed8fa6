"""Traversal of quantised trees against brute force, to the bit: on a CPU one ray at a time, on CUDA by warps."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.binary import BuildOptions
from raybatch_addon.core.bvh.traverse.counts import counts_of
from tests.core.bvh.traverse.quantised_scenes import (
    ANY,
    CLOSEST,
    Entry,
    brute,
    make_rays,
    make_tree,
    placed,
    random_rays,
    slivers,
    trace,
    trace_kernel,
)
from tests.support.wide_trees import soup, sphere

VARIANTS = [
    CLOSEST,
    dataclasses.replace(CLOSEST, refill=0),
    dataclasses.replace(CLOSEST, leaf_groups=1),
    dataclasses.replace(CLOSEST, leaf_groups=1, every_triangle=True),
]


@pytest.mark.parametrize("options", VARIANTS, ids=str)
def test_closest_hits_are_those_of_brute_force(device, options):
    entries = [Entry(*soup(600, 1), merged=[(3, 250), (5, 100), (4, 250)])]
    tree = make_tree(entries, device, False)
    rays = make_rays(*random_rays(2000, 2), device)
    found = trace(tree, rays, options)
    expected = brute(entries, rays, tree, False)
    found.check_same(expected)


@pytest.mark.parametrize("refill", (0, 8))
def test_instances_are_met_as_by_brute_force(device, refill):
    entries = placed(25, 5)
    tree = make_tree(entries, device, True)
    visibility = np.random.default_rng(6).integers(1, 4, 3000)
    rays = make_rays(*random_rays(3000, 7, 3.0), device, visibility=visibility)
    found = trace(tree, rays, dataclasses.replace(CLOSEST, instancing=True, refill=refill))
    expected = brute(entries, rays, tree, True)
    found.check_same(expected)
    assert len(set(found.instance.tolist())) > 15
    shadow = trace(tree, rays, dataclasses.replace(ANY, instancing=True, refill=refill))
    assert np.array_equal(shadow.instance >= 0, expected.instance >= 0)


def test_any_hit_agrees_with_closest_hit_and_ends_before_t_max(device):
    tree = make_tree([Entry(*soup(800, 1))], device, False)
    origin, direction = random_rays(3000, 8)
    rays = make_rays(origin, direction, device)
    found = trace(tree, rays, CLOSEST)
    hit = found.instance >= 0
    t = np.where(hit, found.t, np.float32(1))
    for t_max, expected in (
        (np.inf, hit),
        (t, np.zeros(len(t), bool)),
        (np.nextafter(t, np.float32(np.inf)), hit),
        (np.float32(0), 0 * hit > 0),
    ):
        assert np.array_equal(trace(tree, make_rays(origin, direction, device, t_max), ANY).instance >= 0, expected)
        assert np.array_equal(trace(tree, make_rays(origin, direction, device, t_max), CLOSEST).instance >= 0, expected)


def test_of_equal_distances_the_lowest_instance_and_primitive_win(device):
    """The same triangles over and over: in one mesh, and in many entries in one place."""
    positions, triangles = sphere(5)
    copies = np.tile(triangles, (4, 1))
    shuffled = np.random.default_rng(1).permutation(len(copies))
    origin, direction = random_rays(1000, 9, 0.2)
    rays = make_rays(origin, direction, device)
    tree = make_tree([Entry(positions, copies[shuffled])], device, False)
    trace(tree, rays, CLOSEST).check_same(brute([Entry(positions, copies[shuffled])], rays, tree, False))

    count = len(triangles)
    entries = [Entry(positions, triangles, instance=i) for i in (7, 3, 9, 5)]
    entries += [
        Entry(positions, np.tile(triangles, (2, 1)), merged=[(2, count), (8, count)]),
        Entry(positions, triangles, instance=4),
    ]
    tree = make_tree(entries, device, True)
    found = trace(tree, rays, dataclasses.replace(CLOSEST, instancing=True))
    found.check_same(brute(entries, rays, tree, True))
    assert set(found.instance.tolist()) == {2}


def test_the_order_of_work_changes_nothing(device):
    entries = placed(12, 3)
    tree = make_tree(entries, device, True)
    origin, direction = random_rays(2000, 10, 3.0)
    options = dataclasses.replace(CLOSEST, instancing=True)
    first = trace(tree, make_rays(origin, direction, device), options)
    for seed in range(3):
        slots = np.random.default_rng(seed).permutation(2000)
        first.check_same(trace(tree, make_rays(origin, direction, device), options, slots))


def test_only_listed_rays_are_traced(device):
    tree = make_tree([Entry(*sphere(5))], device, False)
    rays = make_rays(np.zeros((100, 3)), random_rays(100, 11)[1], device)
    rays.hit_instance.fill_(-7)
    slots = np.arange(3, 90, 2)
    found = trace(tree, rays, CLOSEST, slots)
    listed = np.isin(np.arange(100), slots)
    assert (found.instance[listed] == 0).all() and (found.instance[~listed] == -7).all()
    assert np.array_equal(trace(tree, rays, CLOSEST, []).instance, found.instance)


@pytest.mark.parametrize("far", (0.0, 1000.0))
def test_no_hit_on_slivers_is_lost(device, far):
    """Rays at points of the triangles themselves, and along them."""
    entries = [Entry(*slivers(400, far))]
    positions, triangles = entries[0].positions, entries[0].triangles
    rng = np.random.default_rng(13)
    weights = rng.dirichlet([0.3] * 3, 4000)
    face = rng.integers(len(triangles), size=4000)
    target = np.einsum("ri,rij->rj", weights, positions[triangles[face]].astype(np.float64))
    origin = far + rng.uniform(-3, 3, (4000, 3))
    origin[:500, 0] = target[:500, 0]
    direction = target - origin.astype(np.float32)
    rays = make_rays(origin, direction, device)
    tree = make_tree(entries, device, False)
    trace(tree, rays, CLOSEST).check_same(brute(entries, rays, tree, False))


def test_closed_surface_has_no_gaps(device):
    """Rays from inside at vertices and edges all hit."""
    positions, triangles = sphere(12)
    corners = positions[triangles].astype(np.float64)
    target = np.concatenate([positions, (corners[:, 0] + corners[:, 1]) / 2, corners.mean(1)])
    origin = np.broadcast_to(np.float32([0.011, -0.023, 0.037]), target.shape)
    rays = make_rays(origin, target - origin, device)
    assert (trace(make_tree([Entry(positions, triangles)], device, False), rays, CLOSEST).instance == 0).all()


def test_deep_trees_fit_on_the_stack(device):
    """Triangles whose sizes and distances double: each split leaves out one."""
    size = 2.0 ** np.arange(-30, 30, 0.25)
    corner = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    positions = (corner[None] * size[:, None, None]).reshape(-1, 3).astype(np.float32)
    entries = [Entry(positions, np.arange(len(positions), dtype=np.int32).reshape(-1, 3))]
    tree = make_tree(entries, device, False, BuildOptions(leaf_group=1, leaf_max=1))
    direction = np.random.default_rng(14).uniform(0, 1, (500, 3)) + [0, 0, 0.5]
    rays = make_rays(np.zeros((500, 3)), direction, device)
    trace(tree, rays, CLOSEST).check_same(brute(entries, rays, tree, False))


def test_nothing_to_hit(device):
    flat = np.zeros((3, 3), np.float32)
    tree = make_tree([Entry(flat, np.array([[0, 1, 2]], np.int32))], device, False)
    rays = make_rays(*random_rays(50, 15), device, t_max=5.0)
    for entry_count in (1, 0):
        tree.entry_count = entry_count
        found = trace(tree, rays, CLOSEST)
        assert (found.instance == -1).all() and (found.t == 5.0).all()
    rays = make_rays(np.zeros((10, 3)), np.zeros((10, 3)), device)  # a ray without direction
    tree = make_tree([Entry(*sphere(5))], device, False)
    assert (trace(tree, rays, CLOSEST).instance == -1).all()


@pytest.mark.parametrize("refill", (0, 8))
def test_counters(device, refill):
    entries = [Entry(*soup(600, 1))]
    tree = make_tree(entries, device, False)
    origin, direction = random_rays(500, 16)
    rays = make_rays(origin, direction, device)
    options = dataclasses.replace(CLOSEST, refill=refill)
    expected = trace(tree, rays, options)
    counts = counts_of(500, device)
    expected.check_same(trace(tree, rays, dataclasses.replace(options, counters=True), counts=counts))
    nodes, boxes, tests = counts.node_steps.numpy(), counts.box_tests.numpy(), counts.triangle_tests.numpy()
    busy, there = counts.lanes.numpy().reshape(3, 2).T
    assert (nodes >= 1).all() and (boxes <= 8 * nodes).all() and (boxes >= nodes).all()
    assert (tests[expected.instance >= 0] >= 1).all()
    assert busy[1] == nodes.sum() and busy[2] == tests.sum()
    assert (busy <= there).all() and busy[0] >= busy[1]


@pytest.mark.parametrize(
    "options",
    [
        *VARIANTS,
        dataclasses.replace(CLOSEST, instancing=True, counters=True),
        dataclasses.replace(ANY, instancing=True),
    ],
    ids=str,
)
def test_the_source_for_cuda_compiles(options, tmp_path):
    """Also on machines without a device."""
    assert wp.compile_aot_module(trace_kernel(options).module, arch=90, module_dir=tmp_path, use_ptx=True)
