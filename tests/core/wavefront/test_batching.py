"""The tracer that batches: every ray is finished exactly once with the hit of the unbatched tracer, whatever the settings."""

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
import pytest
import scenes
import warp as wp
from under_test import DEVICE
from wide_trees import soup, sphere

from raybatch_addon.core.bvh.build import build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.trace_counts import TraceCounts
from raybatch_addon.core.bvh.tree import Tree, Treelets
from raybatch_addon.core.bvh.treelet_tree import cut_scene_tree
from raybatch_addon.core.bvh.treelets import CutRule
from raybatch_addon.core.kernel import KERNEL_OPTIONS
from raybatch_addon.core.report.timing import NoTimer, StageTimer, clock_of
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.settings import RenderSettings
from raybatch_addon.core.wavefront.batching import BatchingTracer, batching_bytes_per_path, batching_kernels
from raybatch_addon.core.wavefront.bucket_blocks import STEP
from raybatch_addon.core.wavefront.rays import RayKind, Rays, allocate_rays
from raybatch_addon.core.wavefront.stages.trace import Traversal, tracing_stages
from raybatch_addon.core.wavefront.stages.visit import VisitTask
from raybatch_addon.core.wavefront.tracer import SlotList, UnbatchedTracer

SELECTIONS = ("MOST_FULL", "NEXT", "RANDOM", "ALL")
PARALLEL = (False, True) if DEVICE == "cpu" else (True,)


# --- queues and scheduler, without a tree: rays go to treelets at random


@wp.kernel(**KERNEL_OPTIONS)
def wander_kernel(
    slots: wp.array(dtype=int), where: wp.array(dtype=int), count: wp.array(dtype=int), task: int, treelets: int,
    visits: wp.array2d(dtype=int),
):  # fmt: skip
    """TOP (0), TREELET (1) or GO_ON (2). `visits` by slot: begun, visits, finished. The ray in slot s visits s % 7 treelets."""
    i = wp.tid()
    if i >= count[0] or where[i] == -1:
        return
    slot = slots[i]
    if where[i] == -2:
        visits[0, slot] = visits[0, slot] + 1
    if task == 1 or (task == 2 and where[i] >= 0):
        visits[1, slot] = visits[1, slot] + 1
    if task == 2:
        visits[1, slot] = slot % 7
    if task != 1:
        if visits[1, slot] >= slot % 7:
            where[i] = -1
            visits[2, slot] = visits[2, slot] + 1
        else:
            mixed = wp.uint32(slot * 7 + visits[1, slot]) * wp.uint32(2654435761)
            where[i] = int((mixed >> wp.uint32(8)) % wp.uint32(treelets))


class Wander:
    """Stands for a `VisitStage`."""

    def __init__(self, task, treelets, visits):
        self.kernels, self._task, self._treelets, self._visits = (wander_kernel,), list(VisitTask).index(task), treelets, visits

    def prepare(self, device):
        pass

    def launch(self, tree, treelets, rays, progress, batch, any_first, counts):
        inputs = [batch.slots, batch.where, batch.count, self._task, self._treelets, self._visits]
        wp.launch(wander_kernel, batch.bound, inputs, device=DEVICE)


@dataclass
class NoTree:
    treelet_count: int
    levels: int = 3
    layout: Layout = Layout.QUANTISED
    tree: Tree = dataclasses.field(default_factory=Tree)
    treelets: Treelets = dataclasses.field(default_factory=Treelets)


def wandering(treelets: int, path_count: int, parallel: bool, rays_few: int | None = 0, capacity: int = 0, **settings):
    device = wp.get_device(DEVICE)
    visits = wp.zeros((3, 2 * path_count), dtype=int, device=device)
    stages = {task: Wander(task, treelets, visits) for task in VisitTask}
    tracer = BatchingTracer(
        NoTree(treelets), allocate_rays(2 * path_count, device), path_count, RayKind.OCCLUSION, RenderSettings(**settings), False,
        NoTimer(), None, device, stages=stages, rays_few=rays_few, parallel=parallel, capacity=capacity,
    )  # fmt: skip
    return tracer, visits


def slot_list(slots) -> SlotList:
    slots = np.asarray(slots, np.int32)
    return SlotList(wp.array(slots, dtype=int, device=DEVICE), wp.array([len(slots)], dtype=int, device=DEVICE), len(slots))


def drain(tracer) -> dict[RayKind, list[int]]:
    back = {kind: [] for kind in RayKind}
    for _ in range(10_000):
        tracer.advance()
        finished = tracer.take_finished()
        if not finished:
            return back
        for kind, listed in finished:
            back[kind] += listed.slots.numpy()[: int(listed.count.numpy()[0])].tolist()
    raise AssertionError("rays are under way without end")


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("selection", SELECTIONS)
@pytest.mark.parametrize("sizes", [(1, 0, 0), (20, 0, 0), (20, 1, 1), (1, 1, 1), (20, 4, 6), (10_000, 0, 0), (10_000, 8, 3)])
def test_every_ray_is_finished_once(parallel, selection, sizes):
    treelets, queue_size, queue_count = sizes
    paths = 300
    few = 0 if treelets < 100 else 2
    tracer, visits = wandering(
        treelets, paths, parallel, few, seed=3, bucket_selection=selection, queue_size=queue_size, queue_count=queue_count,
        debug_checks="ON" if treelets == 20 else "OFF",
    )  # fmt: skip
    closest, shadow = np.random.default_rng(0).permutation(paths)[:250], paths + np.arange(0, 300, 2)
    tracer.submit(RayKind.CLOSEST, slot_list(closest))
    tracer.submit(RayKind.OCCLUSION, slot_list(shadow))
    back = drain(tracer)
    assert sorted(back[RayKind.CLOSEST]) == sorted(closest.tolist())
    assert sorted(back[RayKind.OCCLUSION]) == shadow.tolist()
    begun, visited, finished = visits.numpy()
    alive = np.isin(np.arange(2 * paths), [*closest, *shadow])
    np.testing.assert_array_equal(begun, alive)
    np.testing.assert_array_equal(finished, alive)
    np.testing.assert_array_equal(visited[alive], np.arange(2 * paths)[alive] % 7)
    totals = tracer.totals()
    assert totals.rays == totals.finished == 400
    assert totals.steps > 0
    assert (totals.blocks_short > 0) == (queue_count > 0)
    if not few and selection != "ALL":
        assert totals.rays_queued == 400 + 2 * visited.sum()  # to begin, before each visit and behind it
        assert totals.rays_unbatched == 0


@pytest.mark.parametrize("parallel", PARALLEL)
def test_rays_come_in_and_go_out_at_any_time(parallel):
    tracer, visits = wandering(15, 200, parallel, capacity=64, debug_checks="ON", queue_size=8)
    rng = np.random.default_rng(4)
    free, alive, sent, back = set(range(400)), set(), 0, 0
    for turn in range(60):
        new = rng.permutation(sorted(free))[: rng.integers(0, 150)] if turn < 40 else np.zeros(0, int)
        for kind, chosen in ((RayKind.CLOSEST, new[new < 200]), (RayKind.OCCLUSION, new[new >= 200])):
            if len(chosen):
                tracer.submit(kind, slot_list(chosen))
        free -= set(new.tolist())
        alive |= set(new.tolist())
        sent += len(new)
        tracer.advance()
        finished = tracer.take_finished()
        assert finished or not alive
        for kind, listed in finished:
            slots = listed.slots.numpy()[: listed.bound].tolist()
            assert listed.bound == int(listed.count.numpy()[0])
            assert alive.issuperset(slots)
            assert all((slot < 200) == (kind == RayKind.CLOSEST) for slot in slots)
            alive -= set(slots)
            free |= set(slots)
            back += len(slots)
        totals = tracer.totals()
        assert (totals.rays, totals.finished) == (sent, back)
    assert sent > 1000
    assert not alive


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("sizes", [(0, 0), (4, 5)])
def test_rays_can_be_forgotten(parallel, sizes):
    """As when a tile is given up."""
    tracer, visits = wandering(30, 200, parallel, debug_checks="ON", queue_size=sizes[0], queue_count=sizes[1])
    for turn in range(3):
        visits.zero_()
        tracer.submit(RayKind.CLOSEST, slot_list(np.arange(200)))
        tracer.advance()
        if turn < 2:
            tracer.forget()
            assert tracer.take_finished() == []
    assert len(drain(tracer)[RayKind.CLOSEST]) == 200
    totals = tracer.totals()
    assert (totals.rays, totals.finished) == (600, 200)


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("selection", SELECTIONS)
def test_an_advance_is_cut_short_by_the_end_of_the_render(parallel, selection):
    """A step each, and in the end every ray is finished all the same."""
    tracer, visits = wandering(50, 500, parallel, bucket_selection=selection)
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(500)))
    turns = []
    while tracer.totals().finished < 500:
        before = tracer.totals().steps
        tracer.advance(lambda: True)
        turns.append(tracer.totals().steps - before)
        tracer.take_finished()
        assert len(turns) < 10_000
    if DEVICE == "cpu" and not parallel:
        assert max(turns) == 1
    np.testing.assert_array_equal(visits.numpy()[2, :500], 1)


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("selection", SELECTIONS)
def test_a_tree_without_treelets(parallel, selection):
    tracer, visits = wandering(0, 100, parallel, bucket_selection=selection, debug_checks="ON" if selection == "NEXT" else "OFF")
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(0, 100, 7)))
    assert len(drain(tracer)[RayKind.CLOSEST]) == 15


def test_few_rays_go_on_unbatched():
    tracer, visits = wandering(50, 100, PARALLEL[0], rays_few=20, bucket_selection="MOST_FULL")
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(100)))
    drain(tracer)
    totals = tracer.totals()
    assert 50 < totals.rays_unbatched < 100
    assert totals.steps == 2
    np.testing.assert_array_equal(visits.numpy()[2, :100], 1)


@pytest.mark.parametrize("parallel", PARALLEL)
def test_more_steps_are_counted_than_32_bits_hold(parallel):
    tracer, _ = wandering(50, 100, parallel, bucket_selection="MOST_FULL")
    tracer._queues.set_step(2**31 - 3)
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(100)))
    drain(tracer)
    assert tracer._queues.fetch_state()[STEP] < 0
    assert 2**31 < tracer.totals().steps < 2**31 + 10_000


def test_waits_and_occupancy_are_told():
    bounded, _ = wandering(40, 500, PARALLEL[0], bucket_selection="MOST_FULL", bucket_wait_max=30)
    free, _ = wandering(40, 500, PARALLEL[0], bucket_selection="MOST_FULL")
    waits = []
    for tracer in (bounded, free):
        for _ in range(40):
            tracer.submit(RayKind.CLOSEST, slot_list(np.arange(500)))
            drain(tracer)
        waits.append(tracer.totals().wait_max)
        points = tracer.totals().occupancy
        assert 10 < len(points) <= 256
        assert points == sorted(points)
        assert len(points) > 100 or tracer.totals().steps < 3000
        assert max(waiting for _, waiting in points) == 500
    assert 30 <= waits[0] <= 30 + 82


# --- hits, in trees


@functools.cache
def cut_case(name: str, layout: Layout):
    rng = np.random.default_rng(5)
    if name == "instances":
        places = [scenes.translation(*rng.uniform(-2, 2, 3), rng.uniform(0.3, 1)) for _ in range(25)]
        objects = [(Mesh("ball", *sphere(10, 1.2)), place, scenes.diffuse()) for place in places]
        objects += [(Mesh("soup", *soup(200, 1, 0.3)), scenes.IDENTITY, scenes.diffuse())]
    else:
        objects = [(Mesh("soup", *soup(900, 3, 0.2)), scenes.IDENTITY, scenes.diffuse())]
    scene = scenes.scene(objects)
    device, flat = wp.get_device(DEVICE), flatten(scene)
    geometry = upload_geometry(flat, scene, device)
    built = build_scene_tree(flat, geometry, scene.instances.visibility, name == "instances", device, layout)
    return built, cut_scene_tree(built, CutRule(size=12), device)


def rays_at(path_count: int, built) -> Rays:
    rng = np.random.default_rng(8)
    rays = allocate_rays(2 * path_count, wp.get_device(DEVICE))
    count = 2 * path_count
    low, high = built.box
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
    traversal = Traversal.BOXES if layout is Layout.BOXES else Traversal.QUANTISED
    tracer = UnbatchedTracer(built.tree, rays, tracing_stages(traversal, name == "instances", False))
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(path_count)))
    tracer.submit(shadow_kind, slot_list(np.arange(path_count, 2 * path_count)))
    tracer.advance()
    return hits_of(rays, path_count, shadow_kind)


LAYOUTS = (Layout.QUANTISED, Layout.BOXES) if DEVICE == "cpu" else (Layout.QUANTISED,)


def compare(name, layout, shadow_kind, parallel, counters=False, capacity=0, shared=True, rays_few=0, **settings):
    paths = 400
    built, cut = cut_case(name, layout)
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
        cut, rays, paths, shadow_kind, RenderSettings(**settings), name == "instances", timer, counts, device, parallel=parallel,
        capacity=capacity, rays_few=rays_few,
    )  # fmt: skip
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
    assert totals.treelet_visits > paths
    if counters:
        assert counts.treelet_visits.numpy().sum() == totals.treelet_visits
        assert counts.node_steps.numpy().min() >= 0
        assert counts.queued.numpy().min() >= 0
    times = timer.totals()
    assert times["queue"] > 0
    return totals


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("storage", ["INDIRECT", "DIRECT"])
@pytest.mark.parametrize("selection", SELECTIONS)
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", ["soup", "instances"])
def test_hits_are_those_of_the_unbatched_tracer(name, layout, selection, storage, parallel):
    shadow_kind = RayKind.OCCLUSION if selection in ("MOST_FULL", "ALL") else RayKind.TRANSPARENT_SHADOW
    debug = "ON" if name == "soup" else "OFF"
    compare(name, layout, shadow_kind, parallel, bucket_selection=selection, ray_storage=storage, debug_checks=debug)


@pytest.mark.parametrize("storage", ["INDIRECT", "DIRECT"])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(
    "settings",
    [
        {"queue_size": 1, "queue_count": 1}, {"queue_size": 16, "queue_count": 3, "bucket_wait_max": 5}, {"capacity": 32},
        {"rays_few": 10**6}, {"rays_few": 8, "bucket_selection": "NEXT"}, {"single_lane": "ON"}, {"warp_count": 1}, {"counters": True},
        {"top_level_traversal": "INTERLOCKED"}, {"block_size": 64, "register_cap": 64}, {"shared": False},
    ],
    ids=lambda settings: ",".join(map(str, settings)),
)  # fmt: skip
def test_settings_change_no_hit(settings, layout, storage):
    totals = compare("instances", layout, RayKind.OCCLUSION, PARALLEL[-1], ray_storage=storage, **settings)
    assert (totals.rays_unbatched > 0) == ("rays_few" in settings)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_kernels_are_known_ahead(layout):
    device = wp.get_device(DEVICE)
    for storage in ("INDIRECT", "DIRECT"):
        kernels = batching_kernels(layout, True, False, RenderSettings(ray_storage=storage), device)
        assert len({kernel.module.name for kernel in kernels}) > 5


def test_memory_of_a_path():
    assert batching_bytes_per_path(RenderSettings(), False, False, 6, True) <= 12
    assert batching_bytes_per_path(RenderSettings(), True, True, 6, False) <= 2 * 16
    assert batching_bytes_per_path(RenderSettings(), True, True, 7, False) > batching_bytes_per_path(RenderSettings(), True, True, 6, False)
    assert batching_bytes_per_path(RenderSettings(ray_storage="DIRECT"), True, True, 6, True) > 100
