"""The study of hardware: its machine against a plain twin and against closed forms, and traces against hits."""

import itertools
from dataclasses import asdict, replace

import numpy as np
import pytest
import warp as wp
from benchmarking.rays import CapturedRays, RayType
from benchmarking.scenes import SceneRequest, load_benchmark_scene
from benchmarking.tracers.stages import slot_list, upload_rays
from lib.command import UsageError
from studies.hardware import packets
from studies.hardware.cases import POLICIES
from studies.hardware.machine import ACCUMULATE, BALANCED, QUEUES, Cache, Counts, Machine, Plan
from studies.hardware.plain import Plain, subject_of
from studies.hardware.queues import grouped
from studies.hardware.record import launched, quantised_tree, record
from studies.hardware.reorder import buffer_order
from studies.hardware.results import from_l2, from_memory
from studies.hardware.simulate import simulate
from studies.hardware.traces import Addresses, Traces, load_traces, tree_addresses
from studies.hardware.treelets import TreeShape, breadth_first, by_area, tree_shape
from studies.hardware.twin import LruCache, simulate_twin
from studies.registry import STUDIES
from studies.study import Options

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.counts import counts_of
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.scene.description import Visibility
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage

NODES, TRIANGLES = 60, 90


def random_traces(seed: int, rays: int = 100, most: int = 20) -> Traces:
    """Rays that begin at the root and read other things once, in any order; some read nothing."""
    random = np.random.default_rng(seed)
    pool = np.concatenate([np.arange(1, NODES), ~np.arange(TRIANGLES)])
    parts = [np.concatenate([[0], random.permutation(pool)[:n]])[:n] for n in random.integers(0, most, rays)]
    return Traces(
        items=np.concatenate(parts).astype(np.int32),
        first=np.concatenate([[0], np.cumsum([len(part) for part in parts])]),
        node_count=NODES,
        triangle_count=TRIANGLES,
        origin=random.normal(size=(rays, 3)).astype(np.float32),
        direction=random.normal(size=(rays, 3)).astype(np.float32),
    )


def random_shape(seed: int) -> TreeShape:
    """A tree of any form whose nodes lie behind their parents."""
    random = np.random.default_rng(seed)
    children, parent = np.full((NODES, 8), -1, np.int32), np.full(NODES, -1, np.int32)
    for node in range(1, NODES):
        free = [above for above in range(node) if (children[above] < 0).any()]
        parent[node] = free[random.integers(max(0, len(free) - 8), len(free))]
        children[parent[node], np.flatnonzero(children[parent[node]] < 0)[0]] = node
    area = np.ones(NODES)
    for node in range(1, NODES):
        area[node] = area[parent[node]] * random.uniform(0.2, 0.9)
    order, level = [], [0]
    while level:
        order += level
        level = [child for node in level for child in children[node].tolist() if child >= 0]
    holders = np.sort(random.integers(0, NODES, TRIANGLES)).astype(np.int32)
    return TreeShape(children, parent, np.array(order, np.int32), area, holders)


def plan_of(traces: Traces, machine: Machine, **more) -> Plan:
    return Plan(
        **{
            "traces": traces,
            "addresses": tree_addresses(NODES, TRIANGLES),
            "machine": machine,
            "rays": traces.ray_count,
            **more,
        }
    )


MACHINES = {
    "sectors": Machine(processors=3, slots=5, chunk=4, l1=Cache(1024, 2), l2=Cache(4096, 4)),
    "whole lines": Machine(processors=2, slots=9, chunk=3, line=64, sector=64, l1=Cache(768, 3), l2=Cache(0, 4)),
    "no first level": Machine(processors=2, slots=4, line=32, sector=32, l1=Cache(0, 2), l2=Cache(2048, 2)),
    "slow memory": Machine(processors=1, slots=20, l1=Cache(1 << 16, 8), memory_rate=8),
}
MODES = {
    "single": {},
    "few rows": {"mode": ACCUMULATE, "rows": 3, "registers": 2},
    "rows": {"mode": ACCUMULATE, "rows": 20, "registers": 4},
    "lazy": {"mode": QUEUES, "alive": 40, "ray_bytes": 48},
    "balanced": {"mode": QUEUES, "alive": 70, "ray_bytes": 100, "in_memory": True, "selection": BALANCED},
    "prefetching": {"vote_cycles": 10},
    "prefetching by many": {"vote_cycles": 50, "threshold": 0.4},
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("machine", MACHINES)
def test_the_simulation_is_its_twin(machine, mode):
    """Every count to the last, time included."""
    traces, treelets = random_traces(1), breadth_first(random_shape(2), 800)
    plan = plan_of(traces, MACHINES[machine], treelets=treelets, addresses=treelets.addresses(), **MODES[mode])
    assert asdict(simulate(plan)) == asdict(simulate_twin(plan))


def test_the_twins_cache_is_lru():
    """Against a list in the order of use."""
    random, cache, kept = np.random.default_rng(5), LruCache(Cache(4 * 64, 4), 64), []
    for line in random.integers(0, 7, 300).tolist():
        assert (cache.find(line) is not None) == (line in kept)
        cache.get(line)
        kept = [*(each for each in kept if each != line), line][-4:]


def distinct(addresses: Addresses, items: np.ndarray) -> int:
    """Bytes of the sectors that are read at all."""
    return 32 * len(np.unique(addresses.parts(items, 32)[0]))


ENDLESS = Machine(processors=2, slots=8, l1=Cache(1 << 20, 4), l2=Cache(1 << 20, 4))
NONE = Machine(processors=2, slots=8, l1=Cache(0, 4), l2=Cache(0, 4))


@pytest.mark.parametrize("mode", ["single", "rows", "few rows", "lazy", "balanced"])
def test_endless_caches_bring_everything_once_and_none_brings_all(mode):
    traces, treelets = random_traces(3), breadth_first(random_shape(2), 800)
    plan = plan_of(traces, ENDLESS, treelets=treelets, **MODES[mode])
    found = simulate(plan)
    assert found.memory_bytes == distinct(plan.addresses, traces.items)
    assert found.l2_bytes <= 2 * found.memory_bytes
    one = simulate(replace(plan, machine=replace(ENDLESS, processors=1)))
    assert one.l2_bytes == one.memory_bytes == found.memory_bytes
    none = simulate(replace(plan, machine=NONE))
    _, counts = plan.addresses.parts(traces.items, 32)
    if plan.mode == ACCUMULATE:  # rays of a row share what comes
        assert found.memory_bytes <= none.memory_bytes <= 32 * counts.sum()
    else:
        assert none.memory_bytes == none.l2_bytes == 32 * counts.sum()
        assert none.l1_hits == none.l2_hits == 0
    for each in (found, one, none):
        assert each.items == len(traces.items) and each.finished == traces.ray_count


@pytest.mark.parametrize("mode", MODES)
def test_every_line_of_every_ray_is_requested_once(mode):
    """By its ray, in every policy, whatever waits on the way."""
    traces, treelets = random_traces(4), breadth_first(random_shape(2), 800)
    for machine in MACHINES.values():
        plan = plan_of(traces, machine, treelets=treelets, **MODES[mode])
        found = simulate(plan)
        assert found.l1_requests == plan.addresses.parts(traces.items, machine.line)[1].sum()
        assert found.items == len(traces.items) and found.finished == traces.ray_count
        assert found.l1_merged <= found.l1_hits <= found.l1_requests and found.l2_hits <= found.l2_requests
        assert found.prefetched_used <= found.prefetched <= found.l2_bytes
        assert found.memory_bytes <= found.l2_bytes


@pytest.mark.parametrize("size", [1, 4, 16])
def test_packets_read_what_their_rays_read_and_never_more_often(size):
    traces = random_traces(6)
    merged = packets.packed(traces, size)
    if size == 1:
        assert np.array_equal(merged.items, traces.items)
    for packet in range(merged.ray_count):
        own = merged.items[merged.first[packet] : merged.first[packet + 1]].tolist()
        rays = range(packet * size, min((packet + 1) * size, traces.ray_count))
        parts = [traces.items[traces.first[ray] : traces.first[ray + 1]].tolist() for ray in rays]
        assert set(own) == {item for part in parts for item in part}
        for item in set(own):
            assert own.count(item) <= sum(part.count(item) for part in parts)
        for part in parts:  # in its own order
            left = iter(own)
            assert all(item in left for item in part)


def test_rays_of_a_packet_that_go_one_way_fetch_once():
    """A ray that has more to read on the way lets the others wait."""
    parts = [[0, 1, 2, 5, ~3], [0, 5, ~3], [0, 2, 5], []]
    traces = replace(
        random_traces(0, rays=4),
        items=np.array([item for part in parts for item in part], np.int32),
        first=np.concatenate([[0], np.cumsum([len(part) for part in parts])]),
    )
    assert packets.packed(traces, 4).items.tolist() == [0, 1, 2, 5, ~3]


@pytest.mark.parametrize("rule", [breadth_first, by_area])
@pytest.mark.parametrize("size", [100, 800, 4000, 1 << 20])
def test_treelets_are_connected_parts_of_their_size(rule, size):
    shape = random_shape(7)
    found = rule(shape, size)
    assert sorted(set(found.of_node.tolist())) == list(range(found.count))
    roots = [node for node in range(NODES) if node == 0 or found.of_node[shape.parent[node]] != found.of_node[node]]
    assert len(roots) == found.count
    bytes_of = np.bincount(found.of_node, shape.footprint, found.count)
    alone = np.bincount(found.of_node, minlength=found.count) == 1
    assert ((bytes_of <= size) | alone).all()
    assert np.array_equal(found.of_triangle, found.of_node[shape.triangle_node])
    assert found.count == (1 if size == 1 << 20 else found.count)


def test_treelets_by_area_have_smaller_roots():
    total = {}
    for rule in (breadth_first, by_area):
        total[rule] = 0.0
        for seed in range(8):
            shape = random_shape(seed)
            found = rule(shape, 1000)
            roots = {int(found.of_node[node]): node for node in shape.order[::-1].tolist()}
            total[rule] += sum(shape.area[node] for node in roots.values())
    assert total[by_area] < total[breadth_first]


def test_treelets_in_one_piece_overlap_nowhere():
    treelets = breadth_first(random_shape(8), 700)
    addresses = treelets.addresses()
    items = np.concatenate([np.arange(NODES), ~np.arange(TRIANGLES)])
    begin, end = addresses.spans(items)
    order = np.argsort(begin)
    assert (end[order][:-1] <= begin[order][1:]).all() and end.max() <= addresses.word_count
    owner = np.concatenate([treelets.of_node, treelets.of_triangle])[order]
    assert (np.diff(owner) >= 0).all()
    first, lines, masks = treelets.lines(addresses, 128, 32)
    for treelet in range(treelets.count):
        sectors = np.unique(
            addresses.parts(items[np.concatenate([treelets.of_node, treelets.of_triangle]) == treelet], 32)[0]
        )
        part = slice(first[treelet], first[treelet + 1])
        own = [
            4 * line + i for line, mask in zip(lines[part], masks[part], strict=True) for i in range(4) if mask >> i & 1
        ]
        assert own == sectors.tolist()


def test_grouped_rays_come_to_a_treelet_once():
    traces, treelets = random_traces(9), breadth_first(random_shape(9), 800)
    found = grouped(traces, treelets)
    for ray in range(traces.ray_count):
        before, after = (each.items[each.first[ray] : each.first[ray + 1]] for each in (traces, found))
        assert sorted(before.tolist()) == sorted(after.tolist())
        owner = [int(treelets.of_node[i] if i >= 0 else treelets.of_triangle[~i]) for i in after.tolist()]
        assert sum(a != b for a, b in itertools.pairwise(owner)) == max(0, len(set(owner)) - 1)


def test_buffers_sort_within_themselves():
    traces = random_traces(10)
    order = buffer_order(traces, 16, False)
    assert np.array_equal(order // 16, np.arange(100) // 16) and sorted(order.tolist()) == list(range(100))
    assert np.array_equal(buffer_order(traces, 1, True), np.arange(100))
    assert np.array_equal(buffer_order(traces, 1 << 30, False), traces.order("sorted"))


def test_traces_are_saved(tmp_path):
    traces = random_traces(11)
    traces.save(tmp_path / "traces.npz")
    found = load_traces(tmp_path / "traces.npz")
    for name, value in vars(traces).items():
        assert np.array_equal(getattr(found, name), value)
    (tmp_path / "other.npz").write_bytes(b"no archive")
    with pytest.raises(UsageError, match="holds no traces"):
        load_traces(tmp_path / "other.npz")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A soup of triangles, rays in it, and what they read: closest hits, and any hits."""
    random = np.random.default_rng(12)
    corners = random.uniform(-1, 1, (400, 1, 3)) + random.normal(0, 0.1, (400, 3, 3))
    path = tmp_path_factory.mktemp("scene") / "soup.npz"
    faces = np.arange(1200, dtype=np.int32).reshape(-1, 3)
    np.savez(path, v=corners.reshape(-1, 3).astype(np.float32), f=faces)
    scene = load_benchmark_scene(SceneRequest(path), 16)
    built = quantised_tree(scene)
    direction = random.normal(size=(300, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    arrays = (
        random.uniform(-1, 1, (300, 3)).astype(np.float32),
        direction.astype(np.float32),
        np.full(300, 2.0, np.float32),
        np.full(300, int(Visibility.ALL), np.int32),
    )
    rays = {shadow: CapturedRays(RayType("rays", shadow, 1), *arrays) for shadow in (False, True)}
    return built, rays, {shadow: record(built, each) for shadow, each in rays.items()}


@pytest.mark.parametrize("shadow", [False, True])
def test_traces_are_what_rays_read(recorded, shadow):
    """`record` itself compares hits with those of the plain traversal. Items are as many as that counts, each comes
    once, behind the node that holds it, and the triangle that is hit is one of them.
    """
    built, rays, traces = recorded[0], recorded[1][shadow], recorded[2][shadow]
    device = wp.get_device("cpu")
    counts, uploaded = counts_of(len(rays), device), upload_rays(rays, device)
    stage = trace_stage(Layout.QUANTISED, TraceOptions(any_hit=shadow, instancing=False, counters=True))
    stage.launch(built.tree, uploaded, slot_list(slice(0, len(rays)), device), counts)
    ray = np.repeat(np.arange(len(rays)), traces.lengths)
    nodes = np.bincount(ray[traces.items >= 0], minlength=len(rays))
    assert np.array_equal(nodes, counts.node_steps.numpy())
    assert np.array_equal(traces.lengths - nodes, counts.triangle_tests.numpy())
    words = built.tree.nodes.numpy().view(np.uint32).reshape(-1, 20)
    shape = tree_shape(words, traces.triangle_count)
    faces = built.tree.triangles.numpy().view(np.int32).reshape(-1, 12)[:, 3]
    hit = uploaded.hit_instance.numpy() >= 0
    assert 20 < hit.sum() < 280
    for i in range(len(rays)):
        items = traces.items[traces.first[i] : traces.first[i + 1]].tolist()
        assert items[0] == 0 and len(set(items)) == len(items)
        for place, item in enumerate(items[1:], 1):
            assert (shape.parent[item] if item >= 0 else shape.triangle_node[~item]) in items[:place]
        if hit[i] and not shadow:
            assert uploaded.hit_primitive.numpy()[i] in [faces[~item] for item in items if item < 0]


def test_a_profiler_is_shown_the_same_rays(recorded):
    built, rays, _ = recorded
    order = np.random.default_rng(0).permutation(300)
    instance, primitive, t = launched(built, rays[False], order, wp.get_device("cpu"))
    again = launched(built, rays[False], np.arange(300), wp.get_device("cpu"))
    for mine, other in zip((instance, primitive, t), again, strict=True):
        assert np.array_equal(mine, other[order])


@pytest.mark.parametrize("policy", POLICIES, ids=lambda policy: policy.name)
def test_policies_are_simulated(recorded, policy):
    """On a real tree: what is read is what plain reads, but for packets, which read less; and the twin agrees."""
    built, _, traces = recorded
    traces = traces[False].taken(np.arange(120))
    subject = subject_of(tree_shape(built.tree.nodes.numpy().view(np.uint32).reshape(-1, 20), traces.triangle_count))
    machine = Machine(processors=2, slots=8, chunk=4, l1=Cache(4096, 4), l2=Cache(16 << 10, 4))
    plan = policy.plan(subject, traces, machine)
    found, plain = simulate(plan), simulate(Plain().plan(subject, traces, machine))
    assert found == simulate_twin(plan)
    assert found.rays == plain.rays == 120
    assert found.items == plain.items or (found.items < plain.items and "packets" in policy.name)
    assert (found.queue_written > 0) == (policy.name.startswith(("queues", "streams")) or "in memory" in policy.name)
    assert (found.prefetched > 0) == (policy.name == "prefetching, always (Chou)" or "by a quarter" in policy.name)


def test_the_study_has_a_case_for_each_policy_scene_kind_and_cache():
    found = STUDIES["hardware"].cases(Options())
    assert len({case.key for case in found}) == len(found) == 3 * 4 * 2 * len(POLICIES) + 3
    assert [case.group for case in STUDIES["hardware"].cases(Options(is_cuda=True))] == ["check"] * 3


def test_tables_say_what_was_counted():
    queued = {"queue_written": 100, "queue_read": 100}
    row = asdict(Counts(memory_bytes=500, l2_bytes=1000, l1_requests=9, cycles=5, rays=10)) | queued
    for beyond, is_large in ((True, False), (False, False), (True, True)):
        case = row | {"queues_in_memory": beyond, "cache": "large" if is_large else "small"}
        assert (from_memory(case), from_l2(case)) == ((70.0, 100.0) if beyond and not is_large else (50.0, 120.0))
        assert (from_memory(case, False), from_l2(case, False)) == (50.0, 100.0)
    what = {"tree_bytes": 10**6, "queues_in_memory": True}
    rows = [
        row | what | {"scene": "sponza", "kind": "bounce4", "cache": cache, "policy": policy.name}
        for policy in POLICIES
        for cache in ("small", "large")
    ]
    rows += [row | what | {"scene": "bunny", "kind": "bounce1", "cache": "gpu", "policy": "plain", "order": "natural"}]
    text = STUDIES["hardware"].fragment({"cpu": {"rows": rows}})
    assert text.count("| plain |") == 3 and "| sponza | 1 MB | bounce4 | 10 | 0 | 0.9 | 100 | 70 | 50 |" in text
