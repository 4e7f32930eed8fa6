"""The tracer that batches finds the hits of the unbatched tracer, whatever the settings."""

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.counts import TraceCounts
from raybatch_addon.core.bvh.traverse.options import TopLevelTraversal, VisitOptions
from raybatch_addon.core.bvh.traverse.task import VisitTask
from raybatch_addon.core.bvh.treelets.cut import CutRule
from raybatch_addon.core.bvh.treelets.tree import cut_scene_tree
from raybatch_addon.core.measure.timing import StageTimer, clock_of
from raybatch_addon.core.rays import RayKind, Rays
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.scene.moved import with_motion
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import RayNeeds, allocate_rays
from raybatch_addon.core.wavefront.tracers.buckets.assigned.prefetch import TreeletPrefetch
from raybatch_addon.core.wavefront.tracers.buckets.tracer import (
    BatchingTracer,
    batching_bytes_per_path,
    batching_kernels,
    visit_stages,
)
from raybatch_addon.core.wavefront.tracers.interface import UnbatchedTracer
from raybatch_addon.core.wavefront.tracers.unbatched import tracing_stages
from raybatch_addon.core.wavefront.tracers.visit import VisitStage, quantised_visit_kernel, visit_stage
from raybatch_addon.core.wavefront.tracers.worker_rays import WorkerRays
from tests.core.wavefront.tracers.wandering import PARALLEL, SELECTIONS, drain, slot_list
from tests.support import scenes
from tests.support.paged_scenes import hairy, living
from tests.support.running.shares import each_of, marks_of
from tests.support.under_test import DEVICE
from tests.support.wide_trees import soup, sphere

# with hair, and with things that move too
SCENES = {"hairy": hairy, "living": living}


def met(name: str) -> dict[str, bool]:
    """What tracers are to know of a scene."""
    return {"curves": name in SCENES, "moving": name == "living"}


@functools.cache
def cut_case(name: str, layout: Layout, tier_bytes: int = 0):
    if tier_bytes:
        built, device = cut_case(name, layout)[0], wp.get_device(DEVICE)
        return built, cut_scene_tree(built, CutRule(size=3, tier_bytes=tier_bytes), device)
    rng = np.random.default_rng(5)
    if name == "instances":
        places = [scenes.translation(*rng.uniform(-2, 2, 3), rng.uniform(0.3, 1)) for _ in range(25)]
        objects = [(Mesh("ball", *sphere(10, 1.2)), place, scenes.diffuse()) for place in places]
        objects += [(Mesh("soup", *soup(200, 1, 0.3)), scenes.IDENTITY, scenes.diffuse())]
    else:
        objects = [(Mesh("soup", *soup(900, 3, 0.2)), scenes.IDENTITY, scenes.diffuse())]
    scene = scenes.scene(objects)
    if name in SCENES:
        scene = SCENES[name]()
    device, flat = wp.get_device(DEVICE), flatten(scene)
    geometry = upload_geometry(with_motion(flat), scene, device)
    built = build_scene_tree(flat, geometry, scene.instances.visibility, name != "soup", device, layout)
    return built, cut_scene_tree(built, CutRule(size=12), device)


def rays_at(path_count: int, built) -> Rays:
    rng = np.random.default_rng(8)
    moves = built.tree.motion_steps > 0
    # a shadow ray has the time of its path
    needs = RayNeeds(shadow_rays=True, time=True) if moves else RayNeeds()
    rays = allocate_rays(path_count if moves else 2 * path_count, wp.get_device(DEVICE), needs)
    count = 2 * path_count
    if moves:
        rays.time.assign(rng.random(path_count, np.float32))
    low, high = np.clip(built.box, -3.5, 3.5)
    rays.origin.assign(rng.uniform(low, high, (count, 3)).astype(np.float32))
    direction = rng.normal(size=(count, 3))
    rays.direction.assign((direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32))
    rays.t_max.assign(np.where(np.arange(count) % 3 == 0, rng.uniform(0, 1, count), 1e30).astype(np.float32))
    rays.visibility.fill_(1)
    return rays


HITS = ("hit_t", "hit_instance", "hit_primitive", "hit_uv")


def hits_of(rays: Rays, path_count: int, shadow_kind: RayKind) -> list[np.ndarray]:
    everything = path_count if shadow_kind == RayKind.OCCLUSION else 2 * path_count
    hits = [getattr(rays, name).numpy()[:everything].copy() for name in HITS]
    return [*hits, rays.hit_instance.numpy() >= 0]


@functools.cache
def unbatched_hits(name: str, layout: Layout, path_count: int, shadow_kind: RayKind) -> list[np.ndarray]:
    built, _ = cut_case(name, layout)
    rays = rays_at(path_count, built)
    tracer = UnbatchedTracer(built.tree, rays, tracing_stages(layout, name != "soup", False, **met(name)))
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(path_count)))
    tracer.submit(shadow_kind, slot_list(np.arange(path_count, 2 * path_count)))
    tracer.advance()
    return hits_of(rays, path_count, shadow_kind)


LAYOUTS = (Layout.QUANTISED, Layout.BOXES) if DEVICE == "cpu" else (Layout.QUANTISED,)
STORAGES = ("INDIRECT", "DIRECT")
# the first and the last have each layout and each storage once
PAIRS = [(layout, storage) for layout in LAYOUTS for storage in STORAGES]


def compare(
    name, layout, shadow_kind, parallel, counters=False, capacity=0, shared=True, rays_few=0, stages=None, **settings
):
    paths = 400
    built, cut = cut_case(name, layout, settings.get("treelet_tier_bytes", 0))
    rays, device = rays_at(paths, built), wp.get_device(DEVICE)
    if shared:
        rays.hit_t = rays.t_max
    counts = None
    if counters:
        counts = TraceCounts()
        for field in ("node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued"):
            setattr(counts, field, wp.full(2 * paths, -99, dtype=int, device=device))
        counts.lanes = wp.zeros(6, dtype=wp.int64, device=device)
    timer = StageTimer(clock_of(device))
    tracer = BatchingTracer(
        cut,
        WorkerRays(rays=rays, path_count=paths, shadow_kind=shadow_kind, device=device, timer=timer, counts=counts),
        RenderSettings(**settings),
        name != "soup",
        parallel=parallel,
        capacity=capacity,
        rays_few=rays_few,
        stages=stages,
        **met(name),
    )
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(paths)[::-1]))
    tracer.advance()
    back = {kind: [] for kind in RayKind}
    for kind, listed in tracer.take_finished():
        back[kind] += listed.slots.numpy()[: listed.bound].tolist()
    tracer.submit(shadow_kind, slot_list(np.arange(paths, 2 * paths)))
    for kind, slots in drain(tracer).items():
        back[kind] += slots
    assert sorted(back[RayKind.CLOSEST]) == list(range(paths))
    assert sorted(back[shadow_kind]) == list(range(paths, 2 * paths))
    for mine, theirs in zip(hits_of(rays, paths, shadow_kind), unbatched_hits(name, layout, paths, shadow_kind)):
        np.testing.assert_array_equal(mine, theirs)
    totals = tracer.totals()
    assert totals.rays == totals.finished == 2 * paths
    assert totals.treelet_visits > paths / 2  # some rays miss all
    if counters:
        assert counts.treelet_visits.numpy().sum() == totals.treelet_visits
        assert counts.node_steps.numpy().min() >= 0
        assert counts.queued.numpy().min() >= 0
    times = timer.totals()
    assert times["queue"] > 0
    return totals


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("layout, storage", each_of(3, PAIRS))
@pytest.mark.parametrize("selection", SELECTIONS)
@pytest.mark.parametrize("name", ["soup", "instances"])
def test_hits_are_those_of_the_unbatched_tracer(name, layout, selection, storage, parallel):
    shadow_kind = RayKind.OCCLUSION if selection in ("MOST_FULL", "ALL") else RayKind.TRANSPARENT_SHADOW
    debug = "ON" if name == "soup" else "OFF"
    compare(name, layout, shadow_kind, parallel, bucket_selection=selection, ray_storage=storage, debug_checks=debug)


@pytest.mark.parametrize("shadow_kind", each_of(2, [RayKind.TRANSPARENT_SHADOW, RayKind.OCCLUSION]))
@pytest.mark.parametrize("storage", ["INDIRECT", "DIRECT"])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", SCENES)
def test_segments_and_things_that_move(name, layout, storage, shadow_kind):
    cut = cut_case(name, layout)[1]
    deform = cut.treelets.deform.numpy() if name == "living" else np.zeros(1)
    assert (len(np.unique(deform)) > 2) == (name == "living")
    compare(name, layout, shadow_kind, PARALLEL[-1], ray_storage=storage, debug_checks="ON")
    if name == "living":
        hits = unbatched_hits(name, layout, 400, shadow_kind)
        assert len(np.unique(hits[1])) > 7


@pytest.mark.parametrize("layout, storage", each_of(3, PAIRS))
@pytest.mark.parametrize(
    "settings",
    [
        {"queue_size": 1, "queue_count": 1},
        {"queue_size": 16, "queue_count": 3, "bucket_wait_max": 5},
        {"capacity": 32},
        {"rays_few": 10**6},
        {"rays_few": 8, "bucket_selection": "NEXT"},
        {"single_lane": "ON"},
        {"warp_count": 1},
        {"counters": True},
        {"top_level_traversal": "INTERLOCKED"},
        {"top_level_traversal": "SHORT_SEGMENT"},
        {"top_level_traversal": "LONG_HAUL"},
        {"treelet_cache": 1},
        {"treelet_prefetch": "ON"},
        {"treelet_cache": 4000, "bucket_selection": "LAZY", "bucket_processors": 3},
        {"treelet_cache": 10**9, "bucket_selection": "ALL", "bucket_wait_max": 3},
        pytest.param({"block_size": 64, "register_cap": 64}, marks=marks_of(False)),  # a CPU has the same code
        {"shared": False},
    ],
    ids=lambda settings: ",".join(map(str, settings)),
)
def test_settings_change_no_hit(settings, layout, storage):
    totals = compare("instances", layout, RayKind.OCCLUSION, PARALLEL[-1], ray_storage=storage, **settings)
    assert (totals.rays_unbatched > 0) == ("rays_few" in settings)


@functools.cache
def stages_together(name: str, top_level: TopLevelTraversal) -> dict[VisitTask, VisitStage]:
    """With counters, for warps of 8 lanes above treelets."""
    shared = {"instancing": name != "soup", "counters": True, "curves": name in SCENES, "motion": name == "living"}
    options = [VisitOptions(task=task, top_level=top_level, lanes=8, **shared) for task in VisitTask]
    return {each.task: visit_stage(Layout.QUANTISED, each) for each in options}


@pytest.mark.skipif(DEVICE != "cpu", reason="lanes that take turns are of CPUs")
@pytest.mark.parametrize(
    "name, selection, settings",
    [
        pytest.param(name, selection, settings, marks=marks_of(name == "living" or i == 1))
        for name in ("instances", "living")
        for i, (selection, settings) in enumerate(
            (
                ("ALL", {"capacity": 32}),
                ("MOST_FULL", {"ray_storage": "DIRECT", "debug_checks": "ON"}),
                ("MOST_FULL", {"queue_size": 16, "queue_count": 3, "bucket_wait_max": 5}),
                ("NEXT", {"ray_storage": "DIRECT", "rays_few": 8}),
                ("RANDOM", {"debug_checks": "ON", "rays_few": 60}),
                ("ALL", {"ray_storage": "DIRECT"}),
                ("BALANCED", {"treelet_prefetch": "ON"}),
                ("ALL", {"debug_checks": "ON", "rays_few": 50}),
                ("LAZY", {"bucket_processors": 3, "debug_checks": "ON"}),
            )
        )
    ],
    ids=str,
)
def test_rays_of_a_warp_that_go_together(name, selection, settings):
    """Whatever the queues are and who serves them, where some rays pass treelets that others of their warp enter."""
    shadow_kind = RayKind.TRANSPARENT_SHADOW if selection == "NEXT" else RayKind.OCCLUSION
    common = {"counters": True, "bucket_selection": selection, **settings}
    short, alone = (
        compare(name, Layout.QUANTISED, shadow_kind, PARALLEL[-1], stages=stages_together(name, each), **common)
        for each in (TopLevelTraversal.SHORT_SEGMENT, TopLevelTraversal.NAIVE)
    )
    assert short.rays_queued > alone.rays_queued and short.treelet_visits == alone.treelet_visits


def test_settings_choose_how_rays_go_through_the_top_level():
    for setting, each in TopLevelTraversal.__members__.items():
        settings = RenderSettings(top_level_traversal=setting)
        for layout in LAYOUTS:
            stages = visit_stages(layout, True, False, settings)
            is_quantised = layout is Layout.QUANTISED
            assert stages[VisitTask.TOP].writes_queues == (is_quantised and each is TopLevelTraversal.SHORT_SEGMENT)
            assert not stages[VisitTask.TREELET].writes_queues and not stages[VisitTask.GO_ON].writes_queues
            if is_quantised:
                options = VisitOptions(task=VisitTask.TOP, instancing=True, top_level=each)
                assert stages[VisitTask.TOP].kernels == (quantised_visit_kernel(options),)


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("size", [{"queue_size": 1}, {}])
@pytest.mark.parametrize("selection", SELECTIONS)
def test_no_ray_is_lost_where_both_queues_of_a_bucket_are_served(selection, size, parallel):
    """The exit queue gets rays from the entry queue in the same step."""
    settings = dict(bucket_selection=selection, bucket_wait_max=1, treelet_prefetch="ON", bucket_processors=2, **size)
    compare("instances", LAYOUTS[0], RayKind.OCCLUSION, parallel, rays_few=1, **settings)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rays_that_pass_at_once_are_queued_less_often(layout):
    queued = [
        compare("instances", layout, RayKind.OCCLUSION, PARALLEL[-1], treelet_cache=cache).rays_queued
        for cache in (0, 1, 4000, 10**9)
    ]
    assert queued == sorted(queued, reverse=True) and queued[0] > queued[1] > queued[3]


def test_the_fullest_treelets_that_are_not_served_are_asked_for():
    tree = cut_case("instances", Layout.QUANTISED)[1]
    prefetch, loads = TreeletPrefetch(tree), np.zeros(tree.treelet_count + 1, int)
    assert tree.treelet_count > 5
    loads[[1, 2, 4, 5]] = 7, 9, 30, 2
    loads[-1] = 99  # new rays
    assert prefetch.ask(loads, np.array([4, tree.treelet_count])).tolist() == [2, 1]
    assert prefetch.ask(loads, np.array([4])).tolist() == [2]
    assert prefetch.ask(loads * 0, np.array([0])).tolist() == []


@pytest.mark.parametrize("layout", LAYOUTS)
def test_kernels_are_known_ahead(layout):
    device = wp.get_device(DEVICE)
    for storage in ("INDIRECT", "DIRECT"):
        kernels = batching_kernels(layout, True, False, RenderSettings(ray_storage=storage), device)
        assert len({kernel.module.name for kernel in kernels}) > 5


def test_memory_of_a_path():
    assert batching_bytes_per_path(RenderSettings(), False, False, 6, True) <= 12
    assert batching_bytes_per_path(RenderSettings(), True, True, 6, False) <= 2 * 16
    assert batching_bytes_per_path(RenderSettings(), True, True, 7, False) > batching_bytes_per_path(
        RenderSettings(), True, True, 6, False
    )
    assert batching_bytes_per_path(RenderSettings(ray_storage="DIRECT"), True, True, 6, True) > 100
