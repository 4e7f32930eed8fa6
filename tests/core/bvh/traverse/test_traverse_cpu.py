"""Traversal of BOXES on the CPU against brute force, to the bit."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.binary import BuildOptions
from raybatch_addon.core.bvh.traverse.counts import NO_COUNTS, TraceCounts
from raybatch_addon.core.bvh.traverse.cpu import make_cpu_traversal, traversal_source
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.bvh.tree import Tree
from raybatch_addon.core.device.kernel import MODULE_OPTIONS
from raybatch_addon.core.rays import DeviceRayList, Rays
from tests.core.bvh.traverse.boxes_scenes import (
    INTERLEAVES,
    MESHES,
    SPLIT,
    Hits,
    Scene,
    both_rays,
    brute_force,
    fill_rays,
    instanced_entries,
    list_of,
    make_scene,
    random_rays,
    scene_of,
    trace,
    trace_kernel,
)
from tests.support.wide_trees import soup, sphere


@pytest.mark.parametrize("name", MESHES)
def test_hits_are_those_of_brute_force(name):
    positions, triangles = MESHES[name]()
    origin, direction = both_rays(positions, triangles, 700)
    scene = scene_of(positions, triangles)
    expected = brute_force(scene, origin, direction)
    for interleave in INTERLEAVES:
        trace(scene, origin, direction, interleave=interleave).check_same(expected)
    # and of other trees, in another order
    for options, shuffle in ((BuildOptions(), 3), (BuildOptions(leaf_max=2, leaf_group=1), 4), (SPLIT, 5)):
        trace(scene_of(positions, triangles, options, shuffle), origin, direction).check_same(expected)


@pytest.mark.parametrize("name", ["soup", "slivers", "tiny"])
def test_any_hit_agrees_with_closest_hit(name):
    positions, triangles = MESHES[name]()
    origin, direction = both_rays(positions, triangles, 4000)
    scene = scene_of(positions, triangles)
    closest = trace(scene, origin, direction)
    hit = closest.instance >= 0
    limit = np.where(hit, closest.t, np.float32(1e30))
    for t_max in (np.inf, limit, np.nextafter(limit, np.float32(np.inf))):
        expected = hit & (closest.t < t_max)
        for interleave in INTERLEAVES:
            found = trace(scene, origin, direction, t_max, interleave=interleave, any_hit=True)
            assert np.array_equal(found.instance, np.where(expected, 0, -1))
        assert np.array_equal(trace(scene, origin, direction, t_max).instance >= 0, expected)


def test_instances_are_met_where_they_are():
    scene, other = (
        make_scene(instanced_entries(), True, options, shuffle)
        for options, shuffle in ((BuildOptions(), 0), (SPLIT, 6))
    )
    origin, direction = random_rays(600, 4, 1.5)
    visibility = np.random.default_rng(1).integers(0, 4, len(origin))
    expected = brute_force(scene, origin, direction, np.inf, visibility)
    assert len(np.unique(expected.instance)) > 20 and 3 in expected.instance
    for interleave in INTERLEAVES:
        trace(scene, origin, direction, visibility=visibility, instancing=True, interleave=interleave).check_same(
            expected
        )
        blocked = trace(
            scene, origin, direction, visibility=visibility, instancing=True, interleave=interleave, any_hit=True
        )
        assert np.array_equal(blocked.instance >= 0, expected.instance >= 0)
    trace(other, origin, direction, visibility=visibility, instancing=True).check_same(expected)


def test_merged_instances_are_distinguished_without_a_top_level():
    entry = instanced_entries()[0]
    scene = make_scene([entry], False)
    origin, direction = random_rays(300, 9, 0.8)
    trace(scene, origin, direction).check_same(brute_force(scene, origin, direction))


def test_only_listed_slots_are_written():
    scene = scene_of(*soup(600))
    origin, direction = random_rays(500)
    slots = np.random.default_rng(0).permutation(500)[:123]
    whole, part = trace(scene, origin, direction), trace(scene, origin, direction, slots=slots)
    assert np.array_equal(part.instance[slots], whole.instance[slots]) and np.array_equal(part.t[slots], whole.t[slots])
    assert (np.delete(part.instance, slots) == -7).all()


@pytest.mark.parametrize("instancing", [False, True])
def test_a_scene_without_entries_is_missed(instancing):
    tree = Tree()
    scene = Scene(tree, [], np.zeros((0, 3, 4)), [])
    origin, direction = random_rays(20)
    for interleave in INTERLEAVES:
        found = trace(scene, origin, direction, 3.0, instancing=instancing, interleave=interleave)
        assert (found.instance == -1).all() and (found.t == 3.0).all()


def test_rays_that_are_no_rays_end():
    scene = scene_of(*sphere(12))
    origin, direction = random_rays(60)
    origin[:10, 1], origin[10:20, 0] = np.nan, np.inf
    direction[20:30], direction[30:40, 2] = 0.0, np.nan
    t_max = np.full(60, np.inf, np.float32)
    t_max[40:45], t_max[45:50], t_max[50:53] = np.nan, -1.0, 0.0
    direction[53:55] = [[np.inf, 0, 0], [-np.inf, np.inf, 1]]
    for interleave in INTERLEAVES:
        found = trace(scene, origin, direction, t_max, interleave=interleave)
        assert (found.instance[:55] == -1).all()
        assert (trace(scene, origin, direction, t_max, interleave=interleave, any_hit=True).instance[:55] == -1).all()


def test_no_ray_leaves_a_closed_mesh():
    positions, triangles = sphere(40)
    rng = np.random.default_rng(3)
    origin = rng.uniform(-0.3, 0.3, (300_000, 3))
    # at vertices and edges above all
    corners = positions[triangles[rng.integers(len(triangles), size=len(origin))]].astype(np.float64)
    share = rng.integers(0, 3, (len(origin), 1)) * rng.random((len(origin), 1)) / 2
    target = corners[:, 0] * (1 - share) + corners[:, 1] * share
    found = trace(scene_of(positions, triangles), origin, target - origin.astype(np.float32))
    assert (found.instance == 0).all()


def test_counters_count_what_is_there():
    positions, triangles = soup(900)
    scene = scene_of(positions, triangles)
    origin, direction = random_rays(500)
    counted = []
    for interleave in (1, 16):
        rays, counts = fill_rays(origin, direction), TraceCounts()
        for name in ("node_steps", "box_tests", "triangle_tests"):
            setattr(counts, name, wp.full(len(origin), -1, dtype=int, device="cpu"))
        wp.launch(
            trace_kernel(False, False, interleave, True),
            1,
            [scene.tree, rays, list_of(np.arange(len(origin))), 0, len(origin), counts],
            device="cpu",
        )
        counted.append([getattr(counts, name).numpy() for name in ("node_steps", "box_tests", "triangle_tests")])
    for alone, together in zip(*counted):
        assert np.array_equal(alone, together)
    steps, boxes, tests = counted[0]
    assert steps.min() == 1 and (boxes <= 8 * steps).all() and (boxes >= 2 * steps).all()
    hit = trace(scene, origin, direction).instance >= 0
    assert (tests[hit] >= 1).all() and tests.mean() < 100


NARROWER = {"AVX2": "-target-cpu haswell", "no vectors": "-target-cpu x86-64 -target-feature +fma"}


@pytest.mark.parametrize("target", NARROWER)
def test_narrower_processors_find_the_same(target):
    """The texts for processors without AVX-512, compiled for one."""
    import platform

    if platform.machine().lower() not in ("x86_64", "amd64"):
        pytest.skip("these are x86 processors")
    trace_native = make_cpu_traversal(TraceOptions(any_hit=False, instancing=False, interleave=8))
    options = {**MODULE_OPTIONS, "cpu_compiler_flags": f"{NARROWER[target]} -Wno-constant-conversion -Wno-psabi"}

    @wp.kernel(module="unique", module_options=options, enable_backward=False)
    def narrow(tree: Tree, rays: Rays, listed: DeviceRayList, first: int, end: int, counts: TraceCounts):
        trace_native(tree, rays, listed, first, end, counts)

    positions, triangles = soup(2000, size=0.3)
    scene = scene_of(positions, triangles)
    origin, direction = both_rays(positions, triangles, 3000)
    rays = fill_rays(origin, direction)
    wp.launch(narrow, 1, [scene.tree, rays, list_of(np.arange(len(origin))), 0, len(origin), NO_COUNTS], device="cpu")
    found = Hits(rays.hit_t.numpy(), rays.hit_instance.numpy(), rays.hit_primitive.numpy(), rays.hit_uv.numpy())
    found.check_same(trace(scene, origin, direction))


def test_the_source_is_for_cpus_alone():
    for any_hit in (False, True):
        text = traversal_source(TraceOptions(any_hit=any_hit, instancing=True, counters=True))
        assert text.strip().startswith("#if !defined(__CUDA_ARCH__)") and text.strip().endswith("#endif")
