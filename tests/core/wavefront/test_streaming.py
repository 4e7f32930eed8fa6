"""Rays that wait for pages come to the hits of rays that find the whole scene in memory, bit for bit, and each is finished once."""

import functools
import gc
import threading

import numpy as np
import paged_scenes
import pytest
import warp as wp
from under_test import DEVICE

from raybatch_addon.core.bvh.build import build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.page_build import build_paged_scene
from raybatch_addon.core.bvh.residency import Residency, page_line, staging_bytes_of
from raybatch_addon.core.bvh.trace_counts import TraceCounts
from raybatch_addon.core.bvh.treelets import CutRule
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.settings import RenderSettings
from raybatch_addon.core.wavefront.ray_order_paging import RayOrderPager
from raybatch_addon.core.wavefront.rays import RayKind, RayNeeds, Rays, allocate_rays
from raybatch_addon.core.wavefront.stages.trace import TraceFeatures, Traversal, trace_stage
from raybatch_addon.core.wavefront.streaming import StreamingTracer, go_on_stage
from raybatch_addon.core.wavefront.tracer import SlotList

PATHS = 3000
LAYOUTS = list(Layout) if DEVICE == "cpu" else [Layout.QUANTISED]
ONE = LAYOUTS[0]
ON_CPU = pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
CHECKED = RenderSettings(debug_checks="ON")
BUDGET = 250_000


@functools.cache
def scene():
    made = paged_scenes.everything()
    return made, flatten(made)


def device() -> wp.Device:
    return wp.get_device(DEVICE)


@functools.cache
def paged_of(layout: Layout, budget: int = BUDGET, nodes_resident: bool | None = False, many: bool = False):
    """In memory; tests do not change it."""
    made, flat = scene()
    rule = CutRule(size=4, size_min=1) if many else CutRule()
    return build_paged_scene(flat, made.instances.visibility, layout, device(), budget, nodes_resident=nodes_resident, rule=rule)


def new_rays(paths: int = PATHS, seed: int = 3) -> Rays:
    """Extending rays, then as many shadow rays, which end somewhere."""
    rng = np.random.default_rng(seed)
    rays = allocate_rays(paths, device(), RayNeeds(shadow_rays=True))
    count = rays.origin.size
    origin = rng.normal(size=(count, 3)) * 4
    vertices = scene()[1].positions
    aim = np.where(np.arange(count)[:, None] % 2, vertices[rng.integers(0, len(vertices), count)], rng.normal(size=(count, 3)) * 1.5)
    rays.origin.assign(origin.astype(np.float32))
    rays.direction.assign((aim - origin).astype(np.float32))
    shadow = np.arange(count) >= paths
    rays.t_max.assign(np.where(shadow, rng.uniform(0.3, 1.5, count), np.inf).astype(np.float32))
    rays.visibility.assign(rng.choice([1, 255], count).astype(np.int32))
    return rays


def list_of(slots) -> SlotList:
    slots = np.asarray(slots, np.int32)
    return SlotList(wp.array(slots, dtype=int, device=DEVICE), wp.array([len(slots)], dtype=int, device=DEVICE), len(slots))


def hits_of(rays: Rays, paths: int, any_hit: bool) -> list[np.ndarray]:
    """What counts of them."""
    instance = rays.hit_instance.numpy().copy()
    hit = instance >= 0
    last = paths if any_hit else len(instance)
    if any_hit:
        instance[paths:] = hit[paths:]
    closest = hit[:last]
    return [
        instance, rays.hit_t.numpy()[:last][closest], rays.hit_primitive.numpy()[:last][closest], rays.hit_uv.numpy()[:last][closest],
    ]  # fmt: skip


@functools.cache
def expected(layout: Layout, any_hit: bool, seed: int = 3) -> list[np.ndarray]:
    """By the tree in memory, each ray at once."""
    made, flat = scene()
    built = build_scene_tree(flat, upload_geometry(flat, made, device()), made.instances.visibility, True, device(), layout)
    rays = new_rays(seed=seed)
    for kind, slots in ((False, np.arange(PATHS)), (any_hit, np.arange(PATHS, 2 * PATHS))):
        trace_stage(TraceFeatures(Traversal.of("OFF", layout), kind, True, False)).launch(built.tree, rays, list_of(slots), None)
    return hits_of(rays, PATHS, any_hit)


@pytest.fixture
def open_pool():
    """Opens pools with so many places for pages of a scene, and `more` bytes; they are closed when the test ends."""
    pools: list[Residency] = []

    def opened(paged, slots: int, more: int = 0, make_line=page_line) -> Residency:
        pools.append(Residency(paged, paged.resident_bytes + slots * paged.page_bytes_max + more, device(), make_line))
        return pools[-1]

    yield opened
    for pool in pools:
        pool.close()


def tracer_of(pool: Residency, rays: Rays, shadow=RayKind.OCCLUSION, settings=CHECKED, kind=StreamingTracer, **more):
    """A tracer of `rays` through a pool."""
    return kind(pool.scene, pool, rays, PATHS, shadow, settings, **more)


def drain(tracer, finished: dict, most: int = 10_000) -> None:
    """Advance until no ray is under way; `finished` counts the times that each (kind, slot) came back."""
    for _ in range(most):
        tracer.advance()
        lists = tracer.take_finished()
        for kind, rays in lists:
            for slot in rays.slots.numpy()[: int(rays.count.numpy()[0])].tolist():
                finished[kind, slot] = finished.get((kind, slot), 0) + 1
            assert rays.bound >= int(rays.count.numpy()[0])
        if not lists:
            return
    raise AssertionError("rays stay under way")


def run(tracer, shadow: RayKind = RayKind.OCCLUSION, paths: int = PATHS) -> None:
    """All rays, submitted in two parts."""
    finished: dict = {}
    half = paths // 2
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(half)))
    tracer.submit(shadow, list_of(paths + np.arange(paths)))
    tracer.advance()
    for kind, rays in tracer.take_finished():
        for slot in rays.slots.numpy()[: int(rays.count.numpy()[0])].tolist():
            finished[kind, slot] = 1
    tracer.submit(RayKind.CLOSEST, list_of(half + np.arange(paths - half)))
    drain(tracer, finished)
    wanted = {(RayKind.CLOSEST, slot) for slot in range(paths)} | {(shadow, paths + slot) for slot in range(paths)}
    assert finished == dict.fromkeys(wanted, 1)


def require_right(rays: Rays, layout: Layout = ONE, any_hit: bool = True, seed: int = 3) -> None:
    """Hits are those of the tree in memory, bit for bit."""
    wanted = expected(layout, any_hit, seed)
    assert (wanted[0] >= 0).sum() > 500
    for a, b in zip(hits_of(rays, PATHS, any_hit), wanted):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("shadow", [RayKind.OCCLUSION, RayKind.TRANSPARENT_SHADOW], ids=["any", "closest"])
@pytest.mark.parametrize("slots", [1, 3, 1000])
@pytest.mark.parametrize("nodes_resident, many", [(False, False), (True, False), (False, True)], ids=["nodes in pages", "nodes there", "treelets"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_hits_are_those_of_the_whole_tree(open_pool, layout, nodes_resident, many, slots, shadow):
    budget = 400_000 if nodes_resident else BUDGET
    paged = paged_of(layout, budget, nodes_resident, many)
    assert len(paged.pages) > 3
    pool = open_pool(paged, min(slots, len(paged.pages)))
    assert pool.slot_count == min(slots, len(paged.pages))
    rays = new_rays()
    tracer = tracer_of(pool, rays, shadow, capacity=700)
    run(tracer, shadow)
    require_right(rays, layout, shadow == RayKind.OCCLUSION)
    totals = tracer.totals()
    assert totals.rays == totals.finished == 2 * PATHS
    assert totals.pages_loaded - totals.pages_evicted <= pool.slot_count
    assert totals.bytes_copied >= totals.pages_loaded * 4096 and totals.treelet_visits > PATHS and totals.rays_queued > 0
    assert paged.resident_bytes < totals.resident_peak <= paged.resident_bytes + pool.slot_count * pool.slot_bytes
    if slots == 1000:
        assert totals.pages_loaded <= len(paged.pages) and totals.pages_evicted == 0
    tracer.close()


@pytest.mark.parametrize("slots", [1, 3])
@pytest.mark.parametrize("store", ["HOST", "DISK"])
@pytest.mark.parametrize("layout, encoded", [*((layout, False) for layout in LAYOUTS), (Layout.QUANTISED, True)])
def test_from_host_memory_and_from_a_file(open_pool, layout, encoded, store, slots, tmp_path):
    made, flat = scene()
    paged = build_paged_scene(flat, made.instances.visibility, layout, device(), BUDGET, store, tmp_path, nodes_resident=False, encoded=encoded)
    assert paged.encoded == encoded and (paged.pages[0].byte_count < paged.pages[0].device_bytes) == encoded
    pool = open_pool(paged, slots, staging_bytes_of(paged, slots, device()))
    rays = new_rays()
    tracer = tracer_of(pool, rays)
    run(tracer)
    require_right(rays, layout)
    tracer.close()


@ON_CPU
@pytest.mark.parametrize("slots", [1, 2, 5])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_workers_share_the_pool(open_pool, layout, slots):
    paged = paged_of(layout)
    pool = open_pool(paged, slots)
    go_on_stage(layout, False, CHECKED)  # compiled before threads start
    warm = tracer_of(pool, new_rays())
    run(warm)
    warm.close()
    results, errors = {}, []

    def work(seed: int) -> None:
        try:
            rays = new_rays(seed=seed)
            tracer = tracer_of(pool, rays, capacity=1500)
            run(tracer)
            results[seed] = rays, tracer.totals()
            tracer.close()
        except BaseException as error:  # noqa: BLE001
            errors.append(error)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (3, 4, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not errors and len(results) == 3
    for seed, (rays, totals) in results.items():
        require_right(rays, layout, seed=seed)
        assert totals.rays == totals.finished == 2 * PATHS


@ON_CPU
@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_control_comes_to_the_same_hits(open_pool, layout):
    paged = paged_of(layout)
    for slots in (1, 4, 1000):
        pool = open_pool(paged, slots)
        rays = new_rays()
        pager = tracer_of(pool, rays, kind=RayOrderPager)
        run(pager)
        require_right(rays, layout)
        totals = pager.totals()
        assert totals.rays == totals.finished == 2 * PATHS
        if slots == 1000:
            assert totals.pages_loaded <= len(paged.pages)


@ON_CPU
def test_streaming_copies_less_than_the_control(open_pool):
    """Rays in no order, a pool of three pages."""
    paged = paged_of(ONE)
    copied = {}
    for kind in (StreamingTracer, RayOrderPager):
        pool = open_pool(paged, 3)
        tracer = tracer_of(pool, new_rays(), settings=RenderSettings(), kind=kind, **({"window": 64} if kind is RayOrderPager else {}))
        run(tracer)
        copied[kind] = tracer.totals().bytes_copied
    assert 3 * copied[StreamingTracer] < copied[RayOrderPager]


def test_given_up_rays_leave_nothing_behind(open_pool):
    paged = paged_of(ONE)
    pool = open_pool(paged, 2)
    given_up = tracer_of(pool, new_rays())
    given_up.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    given_up.advance()
    assert pool.facts().waiting.sum() > 0
    del given_up
    gc.collect()
    assert pool.facts().waiting.sum() == 0
    rays = new_rays()
    tracer = tracer_of(pool, rays)
    run(tracer)
    require_right(rays)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_triangles_that_are_split_among_pages_act_once(open_pool, layout):
    made, flat = scene()
    paged = build_paged_scene(
        flat, made.instances.visibility, layout, device(), BUDGET, nodes_resident=False, spatial_splits=True, encoded=layout is Layout.QUANTISED
    )
    pool = open_pool(paged, 3)
    rays = new_rays()
    run(tracer_of(pool, rays))
    require_right(rays, layout)


def test_an_advance_is_cut_short_by_the_end_of_the_render(open_pool):
    """A step each, and in the end every ray is finished all the same."""
    paged = paged_of(ONE)
    pool = open_pool(paged, 2)
    rays = new_rays()
    tracer = tracer_of(pool, rays)
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    tracer.submit(RayKind.OCCLUSION, list_of(np.arange(PATHS, 2 * PATHS)))
    turns = 0
    while tracer.totals().finished < 2 * PATHS:
        before = tracer.totals().steps
        tracer.advance(lambda: True)
        assert tracer.totals().steps - before <= 1
        tracer.take_finished()
        turns += 1
        assert turns < 10_000
    require_right(rays)


def test_rays_can_be_forgotten(open_pool):
    """As when a tile is given up: some are done, some wait, and some came in last."""
    paged = paged_of(ONE)
    pool = open_pool(paged, 2)
    rays = new_rays()
    tracer = tracer_of(pool, rays)
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    tracer.advance()
    tracer.submit(RayKind.OCCLUSION, list_of(np.arange(PATHS, PATHS + 50)))
    tracer.forget()
    assert tracer.take_finished() == [] and pool.facts().waiting.sum() == 0
    assert (tracer.totals().rays, tracer.totals().finished) == (PATHS + 50, 0)
    run(tracer)
    require_right(rays)
    assert (tracer.totals().rays, tracer.totals().finished) == (3 * PATHS + 50, 2 * PATHS)


def test_one_ray_at_a_time(open_pool):
    paged = paged_of(ONE)
    pool = open_pool(paged, 1)
    rays = new_rays()
    tracer = tracer_of(pool, rays, capacity=1)
    finished: dict = {}
    for slot in (0, 1, PATHS + 1, 2):
        tracer.submit(RayKind.CLOSEST if slot < PATHS else RayKind.OCCLUSION, list_of([slot]))
        drain(tracer, finished)
    assert list(finished.values()) == [1] * 4


def test_debug_checks_find_a_ray_that_comes_in_twice(open_pool):
    paged = paged_of(ONE)
    pool = open_pool(paged, 1)
    tracer = tracer_of(pool, new_rays())
    with pytest.raises(AssertionError, match="twice at once"):
        tracer.submit(RayKind.CLOSEST, list_of([4, 4]))
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    with pytest.raises(AssertionError, match="under way already, the first in slot 7"):
        tracer.submit(RayKind.CLOSEST, list_of([7]))


def test_nothing_to_do(open_pool):
    paged = paged_of(ONE)
    pool = open_pool(paged, 1)
    tracer = tracer_of(pool, new_rays())
    tracer.advance()
    assert tracer.take_finished() == []


@pytest.mark.parametrize("layout", LAYOUTS)
def test_counters_count_every_visit(open_pool, layout):
    paged = paged_of(layout)
    pool = open_pool(paged, 2)
    rays = new_rays()
    counts = TraceCounts()
    for name in ("node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued"):
        setattr(counts, name, wp.full(2 * PATHS, 77, dtype=int, device=DEVICE))
    counts.lanes = wp.zeros(6, dtype=wp.int64, device=DEVICE)
    tracer = tracer_of(pool, rays, counts=counts)
    run(tracer)
    totals = tracer.totals()
    assert counts.treelet_visits.numpy().sum() == totals.treelet_visits
    assert counts.queued.numpy().sum() == totals.rays_queued
    assert 0 < totals.wait_max <= totals.steps


# --- what a CUDA device does, with its marks and without the device


class NotedLine:
    """Fills slots at once, as a device may at the earliest, and notes what its streams were told."""

    def __init__(self, scene, pool, slot_bytes, device):
        self.scene, self.memory, self.slot_bytes = scene, pool.numpy().reshape(-1), slot_bytes
        self.marks = 0  # launches so far
        self.fills: list[tuple[int, int, int, int]] = []  # page, slot, launches that the copy waits for, launches so far
        self.landed: list[tuple[int, int]] = []  # page, launches before
        self.on_their_way = 0

    def fill(self, number, slot, used, arrived):
        page, start = self.scene.pages[number], slot * self.slot_bytes
        self.scene.store.read_into(page, self.memory[start : start + page.byte_count], direct=False)
        self.fills.append((number, slot, used or 0, self.marks))
        arrived(number, len(self.fills), None)

    def room(self):
        return 1000

    def mark(self):
        self.marks += 1
        return self.marks

    def land(self, number, slot, filled):
        assert self.fills[filled - 1][:2] == (number, slot)
        self.landed.append((number, self.marks))

    def close(self):
        pass


def pipelined(open_pool, paged, slots: int, zero_copy: bool = False, monkeypatch=None):
    """A tracer that is run as on CUDA: counts are one step old, and copies are ordered by marks."""
    lines, shown = [], []

    def make_line(*given):
        lines.append(NotedLine(*given))
        return lines[0]

    pool = open_pool(paged, slots, make_line=make_line)
    if zero_copy:
        monkeypatch.setattr(Residency, "has_zero_copy", True)
    rays = new_rays()
    tracer = tracer_of(pool, rays, settings=RenderSettings())
    tracer._lag = 1
    launch = tracer._stage.launch

    class Stage:
        def launch(self, *given):
            shown.append({page: int(pool._slot[page]) for page in tracer._view.shown})
            launch(*given)

    tracer._stage = Stage()
    return rays, tracer, lines[0], shown


@ON_CPU
@pytest.mark.parametrize("slots", [1, 2, 3, 8])
def test_no_copy_overwrites_what_a_launch_sees(open_pool, slots):
    paged = paged_of(ONE, many=True)
    rays, tracer, line, shown = pipelined(open_pool, paged, slots)
    run(tracer)
    require_right(rays)
    assert len(shown) == line.marks > 3 and len(line.fills) > slots
    for page, slot, waits_for, launched in line.fills:
        saw = [i + 1 for i in range(launched) if slot in shown[i].values()]
        assert waits_for >= max(saw, default=0), f"page {page} is copied over what launch {max(saw)} sees"
    for i, pages in enumerate(shown):
        for page in pages:
            last = max(k for k, fill in enumerate(line.fills) if fill[0] == page and fill[3] <= i)
            assert any(number == page and line.fills[last][3] <= before <= i for number, before in line.landed), "a launch sees a page that has not landed"


@ON_CPU
def test_copies_do_not_wait_for_the_launch_that_runs(open_pool):
    """What is chosen while launch i is under way is copied into slots that it does not see."""
    paged = paged_of(ONE, many=True)
    assert len(paged.pages) > 10
    rays, tracer, line, shown = pipelined(open_pool, paged, 8)
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    tracer.submit(RayKind.OCCLUSION, list_of(PATHS + np.arange(PATHS)))
    for _ in range(12):
        tracer._step()
    behind = [launched - waits_for for _, _, waits_for, launched in line.fills]
    assert len(behind) > 8 and min(behind) >= 1


@ON_CPU
def test_too_few_rays_go_on_where_pages_lie(open_pool, monkeypatch):
    paged = paged_of(ONE)
    rays, tracer, line, shown = pipelined(open_pool, paged, 1, True, monkeypatch)
    run(tracer)
    require_right(rays)
    totals = tracer.totals()
    # a page of 31 kB is copied while 4 rays go on
    assert totals.rays_unbatched > 0 and totals.rays == totals.finished == 2 * PATHS
